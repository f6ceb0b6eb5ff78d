"""One log verified: recomputed as `pcpc replay` does it, its digest, and what has changed since.

identical   of every node asked for all was recorded, and was recomputed bit for bit
differs     something was recomputed, and differs
incomplete  nothing differs, but not all could be judged
unreadable  no log
"""

import json
import multiprocessing
import os
import signal
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

from msgspec import Meta, Struct, convert, to_builtins

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.log import reader as logs
from pcpc.executive.log.provenance import facts
from pcpc.executive.nodes.watched import StepError
from pcpc.executive.own_laws import carried_files
from pcpc.tools.after.differences import loop_order
from pcpc.tools.after.log import rig as log_rig
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.replay import comparisons, recomputed_pieces
from pcpc.tools.after.trust import Trust, words_of
from pcpc.tools.after.verify.digest import digest
from pcpc.tools.start.children import end_with
from pcpc.tools.terminal.answer import AnyNode, Count, NodeName, one_of

IDENTICAL, DIFFERS, INCOMPLETE, UNREADABLE = "identical", "differs", "incomplete", "unreadable"
CODES = {IDENTICAL: Exit.OK, DIFFERS: Exit.NOT_MET, INCOMPLETE: Exit.LOSS,
         UNREADABLE: Exit.WRONG_INPUT}  # fmt: skip


class FirstDifference(Struct):
    """Where a log differs first."""

    node: AnyNode
    name: str
    "a variable, or: frames sent, end of the node"
    cycle: int
    ulp: int | None
    "in units of the last place; null: of frames, or NaN"
    recorded: str
    recomputed: str


class VerifiedLog(Struct):
    """What a log is."""

    log: str
    verdict: Annotated[str, one_of(*CODES)] = UNREADABLE
    cycles: Count = 0
    "that were recomputed, of the node with the fewest"
    digest: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")] | None = None
    "SHA-256 of what the log says; null: unreadable"
    nodes: list[AnyNode] = []
    "that were recomputed"
    checked: str = ""
    "which nodes, how many cycles of how many, in words; empty: nothing"
    left_out: list[NodeName] = []
    "nodes that were not asked for"
    versions: dict[str, str] = {}
    "by which it was made"
    first: FirstDifference | None = None
    "null: nothing differs"
    why: list[str] = []
    "why it is not identical, besides a difference"
    changed: list[str] = []
    "versions and laws that are not as when it was made"


def verified_row(log: str, node: str, trust: Trust) -> VerifiedLog:
    """Return what a log is, all of it or a node."""
    path, row = Path(log), VerifiedLog(log)
    run = Opened(path, trust)
    try:
        before = _state_of(path)
        head = run.head
        row.digest = digest(path)
        row.verdict = INCOMPLETE
        row.versions, row.changed = versions(head), list(_changed_inputs(head, trust))
        if log_rig.carried_by(head):  # its Python is not to meet that of another log
            row = _row_from_child(row, run, node)
        else:
            _recompute(row, run, node)
        if _state_of(path) != before:
            row.verdict, why = INCOMPLETE, "the file changed while it was read"
            row.why.insert(0, why)
    except (OSError, StepError, UserError) as error:
        row.why.append(_words(error, log))
    return row


def _words(error: Exception, log: str) -> str:
    """Return an error's words without the log, and without the folder that its rig was laid in."""
    text = error.strerror if isinstance(error, OSError) else words_of(error)
    return (text or "a step does not return").removeprefix(f"{log}: ")


def _state_of(path: Path) -> tuple[int, ...]:
    about = path.stat()
    return about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns


def _recompute(row: VerifiedLog, run: Opened, which: str) -> None:
    """Recompute a log and enter what came of it; UserError, StepError."""
    head = run.head
    with run.rig() as rig:
        nodes = comparisons(head, rig, which)
        wanted = [role for role in rig.nodes() if which in (role, "all")]
    columns: dict[str, set[str]] = {}
    untaken: dict[str, None] = {}
    for piece in recomputed_pieces(head.path, nodes, whole=True):
        for node in nodes:
            if node.role in piece.node and hasattr(node, "both"):
                own, known = piece.node[node.role], node.replay.plan.table.index
                columns.setdefault(node.role, set()).update(own.columns)
                names = (str(one.get("name")) for one in own.tunings)
                untaken |= {
                    f"{node.role}: no parameter {n}, which was tuned": None
                    for n in names
                    if n not in known
                }
    row.nodes = [node.verdict.role for node in nodes]
    row.checked = ", ".join(f"{n.verdict.role} {n.verdict.extent}" for n in nodes)
    row.left_out = [role for role in rig.nodes() if role not in (*wanted, *row.nodes)]
    row.cycles = min(node.verdict.cycles for node in nodes)
    there = {*row.nodes, *(["executive"] if "device" in row.nodes else [])}
    why = [f"no record of the {role}" for role in wanted if role not in there]
    why += [*untaken, *(line for node in nodes for line in node.verdict.missing)]
    for node in nodes:
        about = head.node[node.role].description if hasattr(node, "both") else {}
        why += [
            f"{node.verdict.role}: {line}"
            for line in _unjudged_causes(node, about.get("external", ()), columns)
        ]
    row.why = list(dict.fromkeys(why))
    firsts = [one for node in nodes if (one := node.verdict.first())]
    if firsts:
        one = min(firsts, key=loop_order)
        row.first = FirstDifference(one.node, one.name, one.cycle, one.ulp, *one.texts)
    row.verdict = DIFFERS if firsts else INCOMPLETE if row.why else IDENTICAL


def _unjudged_causes(node: Any, external: Any, columns: dict[str, set[str]]) -> Iterator[str]:
    """Yield why a node's record is not judged as a whole."""
    verdict = node.verdict
    yield from verdict.from_record
    if verdict.dropped:
        yield f"{verdict.dropped} frames or events found no room in the recorder"
    if verdict.incomplete:
        yield verdict.incomplete
    elif not verdict.anything:
        yield "nothing was compared"
    for block in external:
        yield f"{block} was stepped from outside; what it wrote is taken from the log"
    if hasattr(node, "both"):
        own, both = columns.get(node.role, set()), {*node.both}
        for text, names in (
            ("recorded, but not recomputed", own - both),
            ("recomputed, but not recorded", {*node.replay.names} - both),
        ):
            if names:
                yield f"{text}: {min(names)}" + (
                    f" and {len(names) - 1} more" if len(names) > 1 else ""
                )


# What has changed


def versions(head: logs.Log) -> dict[str, str]:
    """Return the versions by which a log was made: of the node that comes first."""
    known = head.metadata[next(iter(head.node))]
    names = {key: key.removeprefix("version_") for key in known if key.startswith("version_")}
    names |= {key: key for key in ("git", "python", "machine") if key in known}
    return {names[key]: known[key] for key in names}


def _changed_inputs(head: logs.Log, trust: Trust) -> Iterator[str]:
    now = facts()
    for name, old in versions(head).items():
        new = now.get(f"version_{name}", now.get(name, "none"))
        if new != old:
            yield f"{name} {old} -> {new}"
    for one in () if trust.trust else log_rig.carried_by(head):
        alike = [text for text in trust.law if Path(text).name == PurePosixPath(one.name).name]
        place = Path([*alike, one.path][0])
        if place.is_file() and (new := carried_files.sha256(place)) != one.sha256:
            yield f"{one.name} sha256 {one.sha256[:16]} -> {new[:16]}"


# A process of its own


def _row_from_child(row: VerifiedLog, run: Opened, node: str) -> VerifiedLog:
    """Recompute a log in a child, which leaves nothing behind; UserError."""
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=_in_the_child, args=(there, os.getpid(), row, run, node))
    child.start()
    there.close()
    try:
        return convert(json.loads(here.recv_bytes()), VerifiedLog)
    except EOFError:
        child.join()
        raise UserError(f"its process ended with {child.exitcode}, before it was judged") from None
    finally:
        child.kill()
        child.join()
        here.close()


def _in_the_child(there: Connection, host: int, row: VerifiedLog, run: Opened, node: str) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with(host, signal.SIGKILL)
    try:
        _recompute(row, run, node)
    except (OSError, StepError, UserError) as error:
        row.why = [_words(error, row.log)]
    there.send_bytes(json.dumps(to_builtins(row)).encode())
