"""The rig file: one experiment, read by every process that takes part in it.

`load_rig` checks all that can be known without the wiring (that is `executive.loop.table`'s), in
the order of its lines:

    load      the file over its bases, as plain data with places    `rig.yamlfile`
    expand    keys of earlier versions, `like:` and `fmu:` become what they stand for
    options   --controller and --set replace values                 `rig.options`
    convert   plain data becomes a `Config` of typed values         `rig.conversion`
    check     what contradicts itself between keys                  `rig.checks`
    nodes     laws imported, settings complete, with their units    `rig.blocks`

Every message says where: `file:line:column: path: what; cure`.

    law: pd              BLOCK of the shipped law pd (plants/*/laws)
    law: pkg.mod:NAME    NAME of a Python module
    law: model.py:NAME   NAME of a file, relative to the YAML file that says so

numba is imported with the first law, so that reading a rig with `resolve=False` is fast.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec

from pcpc.executive.errors import RigError
from pcpc.executive.own_laws.carried_files import (
    CarriedFile,
    Reads,
    add_reads,
    file_entries,
    with_local_imports,
)
from pcpc.executive.rig import checks, effective, yamlfile
from pcpc.executive.rig.blocks import BlockSpec, blocks, entries, law_keys
from pcpc.executive.rig.conversion import convert
from pcpc.executive.rig.file_laws import expand_shorthands
from pcpc.executive.rig.inheritance import inherit_entries
from pcpc.executive.rig.law_lookup import law_source
from pcpc.executive.rig.options import apply_options, rename_earlier_keys
from pcpc.executive.rig.roles import Role
from pcpc.executive.rig.schema import Config, Evaluation, Limit
from pcpc.executive.rig.segments import expand_segments
from pcpc.executive.rig.yamlfile import Document, Keys


@dataclass(frozen=True)
class NodeSpec:
    """One process of a rig: its DBC node name, what it computes, sends, limits, substitutes."""

    name: str
    blocks: list[BlockSpec]
    transmit: dict[str, str]
    limits: dict[str, Limit]
    safe: dict[str, float]


@dataclass(frozen=True)
class Rig:
    """A checked rig; `config` holds its values, `document` their places."""

    config: Config
    document: Document

    @property
    def path(self) -> Path:
        """The rig file."""
        return self.document.path

    @property
    def dbc(self) -> Path:
        """The DBC file."""
        return self.document.file(("dbc",), self.config.dbc)

    @cached_property
    def evaluation(self) -> Evaluation | None:
        """How a run is judged; `file` is an absolute path."""
        return checks.evaluation(self.document, self.config)

    @property
    def drawing(self) -> Path | None:
        """The file that draws the plant: beside the evaluation, else beside the rig file."""
        neighbour = Path(self.evaluation.file) if self.evaluation else self.path
        return file if (file := neighbour.with_name("drawing.py")).is_file() else None

    def changed(self, **keys: Any) -> "Rig":
        """Return the rig with other values of its config."""
        return replace(self, config=msgspec.structs.replace(self.config, **keys))

    def where(self, path: str) -> str:
        """Return `file:line:column` of a path such as `executive.transmit.CMD.motor_torque`."""
        return self.document.where(path)

    def error(self, path: str, what: str) -> RigError:
        """Return the error `file:line:column: path: what` for the caller to raise."""
        return self.document.error(path, what)

    def known(self, path: str, name: str, names: Collection[str], what: str) -> None:
        """Raise RigError `no WHAT NAME; did you mean X?` for a name that is not among `names`."""
        self.document.known(path, name, names, what)

    @property
    def roles(self) -> tuple[Role, ...]:
        """The nodes that this rig has."""
        return tuple(self.config.sections)

    def nodes(self) -> dict[Role, NodeSpec]:
        """Return the nodes by role, with laws imported and settings complete."""
        return self._nodes

    @cached_property
    def _nodes(self) -> dict[Role, NodeSpec]:
        chosen = self.config.controllers[self.config.controller]
        return {
            role: NodeSpec(
                node.node,
                blocks(self.document, self.config, role),
                {**node.transmit, **(chosen.transmit if role == "executive" else {})},
                dict(node.limits),
                dict(getattr(node, "safe", {})),
            )
            for role, node in self.config.sections.items()
        }

    def laws(self) -> list[tuple[Keys, str]]:
        """Return the laws in use: the path of the key that names one, and its value."""
        keys_of_laws = [
            (*law_keys(self.config, role, name), "law")
            for role in self.roles
            for name, _ in entries(self.config, role)
        ]
        return [(keys, str(effective.value_at(self.document.data, keys))) for keys in keys_of_laws]

    def tables(self) -> dict[str, str]:
        """Return tables of all blocks and the drives' EDS as texts, by the names of `resolved`."""
        texts = {
            effective.table_name(role, block, self.config): block.table
            for role, node in self.nodes().items()
            for block in node.blocks
            if block.table
        }
        for role, drive in self.config.drives.items():
            if drive.eds is not None:
                file = self.document.file((role, "drive", "eds"), drive.eds)
                texts[effective.eds_name(role)] = file.read_bytes().decode("latin-1")
        return texts

    def carried_files(self, reads: Reads) -> list[CarriedFile]:
        """Return the entries of evaluation, drawing and laws, and of other files `reads`."""
        files: Reads = {file: set(texts) for file, texts in reads.items()}
        laws: dict[Path, set[str]] = {}
        for keys, law in self.laws():
            file, opened = law_source(self.document, keys, law)
            add_reads(files, opened)
            if file is not None:
                text = effective.rebased_path(self.document, keys, law).partition(":")[0]
                laws.setdefault(file, set()).add(text)
                add_reads(files, {one: set() for one in with_local_imports(file)})
        judges = with_local_imports(Path(self.evaluation.file)) if self.evaluation else []
        draws = with_local_imports(self.drawing) if self.drawing else []
        return file_entries(files, laws, judges, draws, self.path)

    def effective(self) -> dict[str, Any]:
        """Return what `resolved` writes, as plain data with pairs as tuples; not to be changed."""
        return self._effective

    @cached_property
    def _effective(self) -> dict[str, Any]:
        specs = {role: node.blocks for role, node in self.nodes().items()}
        return effective.data(self.document, self.config, specs)

    def resolved(self) -> str:
        """Return the effective rig as YAML, for a log: no base, no parameters file, every setting.

        Paths are relative to the rig file's folder: `load_rig(rig.path, text=...)` reads it back
        with equal values. Imports the laws.
        """
        return self._resolved_yaml

    @cached_property
    def _resolved_yaml(self) -> str:
        return yamlfile.dump(self._effective)


def load_rig(
    path: str | Path,
    controller: str | None = None,
    settings: Sequence[str] = (),
    *,
    resolve: bool = True,
    text: str | None = None,
) -> Rig:
    """Return the rig of file `path` with `--controller` and `--set NAME=VALUE` options applied.

    NAME is a key of the rig (`rate_hz`, `bus.bitrate`) or `<block>.<setting>`. With `resolve` False
    no law is imported and settings are unchecked until `nodes()`. `text` stands in for the file's
    contents. Raises RigError.
    """
    document = yamlfile.load(path, text)
    checks.check_characters(document)
    for expand in (rename_earlier_keys, inherit_entries, expand_shorthands, expand_segments):
        expand(document)
    if controller is not None or settings:
        apply_options(document, controller, settings)
        checks.check_characters(document)
    config = convert(document, document.data, Config, ())
    checks.check(document, config)
    rig = Rig(config, document)
    if resolve:
        rig.nodes()
    return rig
