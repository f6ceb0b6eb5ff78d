"""The digest of what all blocks of a run came to, in which a page of `pcpc generate web` ends too.

SHA-256 over the recorded states and outputs of all blocks: node after node from the executive down,
a row a cycle, little-endian doubles, NaN as 7FF8000000000000. Equal for equal bits, whatever the
clock, the pacing and the bus were.
"""

import hashlib
from collections.abc import Mapping, Sequence

import numpy as np

from pcpc.executive.log.description import NodeDescription
from pcpc.executive.log.reader import Log

NAN = 0x7FF8000000000000


def run_digest(log: Log) -> str:
    """Return the digest of a recorded run."""
    names = {role: _block_columns(node.description) for role, node in log.node.items()}
    return digest_of(log, names, max(one.description["cycles"] for one in log.node.values()))


def digest_of(log: Log, names: Mapping[str, Sequence[str]], cycles: int) -> str:
    """Return the digest of these columns of the nodes, in this order, and of so many cycles."""
    digest = hashlib.sha256()
    for role, columns in names.items():
        if not columns:
            continue
        table = np.stack([log.node[role].columns[name] for name in columns])[:, :cycles].T
        words = np.ascontiguousarray(table, "<f8").view(np.uint64)
        digest.update(np.where(np.isnan(table), np.uint64(NAN), words).tobytes())
    return digest.hexdigest()


def _block_columns(description: NodeDescription) -> list[str]:
    """Return what is digested of a node."""
    recorded = {*description["state_columns"]}
    named = [(name, kind, writer) for name, _, kind, writer, *_ in description["variables"]]
    return [name for name in in_order(named) if name in recorded]


def in_order(named: Sequence[tuple[str, str, str]]) -> list[str]:
    """Return the states, then the outputs, of block after block.

    `named`: name, kind and writer of the variables of a node.
    """
    kinds = ("state", "output")
    blocks = dict.fromkeys(writer for _, kind, writer in named if kind in kinds)
    return [
        name
        for block in blocks
        for wanted in kinds
        for name, kind, writer in named
        if kind == wanted and writer == block
    ]
