"""The rig file: one experiment, read by every process that takes part in it.

`load_rig` checks all that can be known without the wiring (that is `executive.loop.table`'s): keys,
types, ranges, files, laws, settings and their units. Every message says where:
`file:line:column: path: what; cure`.

    law: pd              BLOCK of the shipped law pd (plants/*/laws)
    law: pkg.mod:NAME    NAME of a Python module
    law: model.py:NAME   NAME of a file, relative to the YAML file that says so

numba is imported with the first law, so that reading a rig with `resolve=False` is fast.
"""

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec

from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.rig import fmu, standby, tables, yamlfile
from pcpc.executive.rig.alike import take_over
from pcpc.executive.rig.blocks import BlockSpec, blocks, entries, law_keys, parameters_file
from pcpc.executive.rig.carried import Reads, beside, listed, merge
from pcpc.executive.rig.modules import project_file, project_name
from pcpc.executive.rig.options import apply, rename, unknown_controller
from pcpc.executive.rig.resolve import source
from pcpc.executive.rig.roles import ROLES, Role
from pcpc.executive.rig.schema import FALLBACK, Config, Evaluation, Limit
from pcpc.executive.rig.typed import convert
from pcpc.executive.rig.yamlfile import Document, Keys, Place

_STEERS = re.compile(  # a terminal, or the direction of writing
    "[\0-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)
_CURES: dict[Keys, str] = {("dbc",): "; `pcpc dbc` writes one from the wiring"}
_LONGEST_KEEP_NS = 10**15  # the longest run


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
        return _evaluation(self.document, self.config)

    @property
    def drawing(self) -> Path | None:
        """The file that draws the plant: beside the evaluation, else beside the rig file."""
        beside = Path(self.evaluation.file) if self.evaluation else self.path
        return file if (file := beside.with_name("drawing.py")).is_file() else None

    def where(self, path: str) -> str:
        """Return `file:line:column` of a path such as `executive.transmit.CMD.motor_torque`."""
        return self.document.where(path)

    def error(self, path: str, what: str) -> RigError:
        """Return the error `file:line:column: path: what` for the caller to raise."""
        return self.document.error(path, what)

    @property
    def roles(self) -> tuple[Role, ...]:
        """The nodes that this rig has."""
        return tuple(self.config.sections)

    def nodes(self) -> dict[Role, NodeSpec]:
        """Return the nodes by role, with laws imported and settings complete."""
        return self._nodes

    @cached_property
    def _nodes(self) -> dict[Role, NodeSpec]:
        config, document = self.config, self.document
        control, local, plant = config.executive, config.local, config.plant
        found: dict[Role, NodeSpec] = {
            "executive": NodeSpec(
                control.node, blocks(document, config, "executive", {}),
                {**control.transmit, **config.controllers[config.controller].transmit},
                dict(control.limits), {},
            ),
        }  # fmt: skip
        if local is not None:
            found["local"] = NodeSpec(
                local.node, blocks(document, config, "local", {}),
                dict(local.transmit), dict(local.limits), dict(local.safe),
            )  # fmt: skip
        found["plant"] = NodeSpec(
            plant.node, blocks(document, config, "plant", parameters_file(document, plant)),
            dict(plant.transmit), dict(plant.limits), dict(plant.safe),
        )  # fmt: skip
        return found

    def effective(self) -> dict[str, Any]:
        """Return what `resolved` writes, as plain data with pairs as tuples; not to be changed."""
        return self._effective

    def resolved(self) -> str:
        """Return the effective rig as YAML, for a log: no base, no parameters file, every setting.

        Paths are relative to the rig file's folder: `load_rig(rig.path, text=...)` reads it back
        with equal values. Imports the laws.
        """
        return self._resolved

    def laws(self) -> list[tuple[Keys, str]]:
        """Return the laws in use: the path of the key that names one, and its value."""
        return [
            ((*(keys := law_keys(self.config, section, name)), "law"),
             str(_get(self.document.data, (*keys, "law"))))
            for section, node in self.config.sections.items()
            for name, _ in entries(self.config, section)
        ]  # fmt: skip

    def tables(self) -> dict[str, str]:
        """Return the tables of all blocks as texts, by the file names of `resolved`."""
        return {
            _table_name(role, block, self.config): block.table
            for role, node in self.nodes().items()
            for block in node.blocks
            if block.table
        }

    def carried(self, reads: Reads) -> list[Any]:
        """Return what `carried` says of evaluation, drawing and laws, with other files `reads`."""
        found: Reads = {file: set(texts) for file, texts in reads.items()}
        laws: dict[Path, set[str]] = {}
        for keys, law in self.laws():
            file, opened = source(self.document, keys, law)
            merge(found, opened)
            if file is not None:
                text = _rebased(self.document, keys, law).partition(":")[0]
                laws.setdefault(file, set()).add(text)
                merge(found, {one: set() for one in beside(file)})
        judges = beside(Path(self.evaluation.file)) if self.evaluation else []
        draws = beside(self.drawing) if self.drawing else []
        return listed(found, laws, judges, draws, self.path)

    @cached_property
    def _resolved(self) -> str:
        return yamlfile.dump(self._effective)

    @cached_property
    def _effective(self) -> dict[str, Any]:
        data: dict[str, Any] = msgspec.to_builtins(self.config)
        for keys in _file_keys(data):
            _put(data, keys, _rebased(self.document, keys, _get(data, keys)))
        for section, spec in self.nodes().items():
            for block in spec.blocks:
                keys = law_keys(self.config, section, block.name)
                _put(data, (*keys, "parameters"), dict(block.settings))
                if block.table:
                    _put(data, (*keys, "file"), _table_name(section, block, self.config))
                if block.table and not _is_fmu(section, block, self.config):
                    _put(data, (*keys, "signal"), None)
                    interpolation = _get(data, (*keys, "interpolation"))
                    _put(data, (*keys, "interpolation"), interpolation or "hold")
        data["plant"]["parameters_file"] = None
        return data


def load_rig(
    path: str | Path, controller: str | None = None, settings: Sequence[str] = (), *,
    resolve: bool = True, text: str | None = None,
) -> Rig:  # fmt: skip
    """Return the rig of file `path` with `--controller` and `--set NAME=VALUE` options applied.

    NAME is a key of the rig (`rate_hz`, `bus.bitrate`) or `<block>.<setting>`. With `resolve` False
    no law is imported and settings are unchecked until `nodes()`. `text` stands in for the file's
    contents. Raises RigError.
    """
    document = yamlfile.load(path, text)
    _check_texts(document, document.data, ())
    rename(document)
    take_over(document)
    fmu.write_out(document)
    config = convert(document, document.data, Config, ())
    if controller is not None:
        place = Place(document.path, option=f"--controller {controller}")
        document.put(("controller",), controller, place)
    apply(document, config, settings)
    _check_texts(document, document.data, ())
    config = convert(document, document.data, Config, ())
    _check(document, config)
    rig = Rig(config, document)
    if resolve:
        rig.nodes()
    return rig


def _table_name(role: Role, block: BlockSpec, config: Config) -> str:
    return f"{role}-{block.name}.{'json' if _is_fmu(role, block, config) else 'csv'}"


def _is_fmu(role: Role, block: BlockSpec, config: Config) -> bool:
    return config.sections[role].blocks[block.name].law == fmu.LAW


# Checks between keys


def _check_texts(document: Document, data: Any, keys: Keys) -> None:
    """Raise for a character that no file's name, no log and no terminal takes."""
    if isinstance(data, dict | list):
        for key, child in data.items() if isinstance(data, dict) else enumerate(data):
            _check_texts(document, key, (*keys, key))
            _check_texts(document, child, (*keys, key))
    elif isinstance(data, str) and (found := _STEERS.search(data)):
        raise document.error(keys, f"character {found[0]!a} is not allowed")


def _check(document: Document, config: Config) -> None:
    """Raise the first contradiction between the keys of a rig."""
    if config.controller not in config.controllers:
        unknown_controller(document, config.controller, config)
    _check_blocks(document, config)
    _check_overrun(document, config)
    standby.check(document, config)
    if config.record.keep is not None and not 0 < config.record.keep_ns <= _LONGEST_KEEP_NS:
        what = f"{config.record.keep}: expected more than 0 and no more than 12 days"
        raise document.error(("record", "keep"), what)
    _check_limits(document, config)
    patience_s = config.supervisor.peer_timeout_s
    if patience_s * config.rate_hz < 2.0:
        what = f"{patience_s:g} s is less than 2 periods, {2.0 / config.rate_hz:g} s"
        raise document.error(("supervisor", "peer_timeout_s"), what)
    for name, figures in config.expect.items():
        if name not in config.controllers:
            what = f"no such controller{did_you_mean(name, config.controllers)}"
            raise document.error(("expect", name), what)
        for figure, (low, high) in figures.items():
            if not low <= high or -low == high == math.inf:
                what = f"{low:g} is above {high:g}" if high < low else "all is within that"
                raise document.error(("expect", name, figure), what)
    _check_requirements(document, config)
    _evaluation(document, config)
    for keys in _file_keys(msgspec.to_builtins(config)):
        if keys[-1] != "law" and keys[0] != "evaluation":  # which was looked for just now
            document.file(keys, _get(document.data, keys), _CURES.get(keys, ""))


def _check_requirements(document: Document, config: Config) -> None:
    """Refuse requirements that say nothing, whatever the names in them stand for."""
    from pcpc.executive.rig.requirements import RequirementError, timed

    for i, entry in enumerate(config.require):
        for name in entry.controllers or ():
            if name not in config.controllers:
                what = f"no controller {name}{did_you_mean(name, config.controllers)}"
                raise document.error(("require", i, "controllers"), what)
        try:
            timed(entry, lambda name: None)
        except RequirementError as error:
            raise document.error(("require", i, *error.keys), error.what) from None


def _check_limits(document: Document, config: Config) -> None:
    """Refuse bounds without a value between them, and safe values that cannot be sent."""
    for section, node in config.sections.items():
        for name, limit in getattr(node, "limits", {}).items():
            keys: Keys = (section, "limits", name)
            if not limit.low < limit.high:
                what = f"low {limit.low:g} is not below high {limit.high:g}"
                raise document.error(keys, what)
            if limit.rate_per_s is not None and not math.isfinite(limit.rate_per_s):
                what = f"expected a finite number, got {limit.rate_per_s:g}; null is no rate limit"
                raise document.error((*keys, "rate_per_s"), what)
            if limit.safe is not None and not limit.low <= limit.safe <= limit.high:
                what = f"{limit.safe:g} is outside {limit.low:g}..{limit.high:g}"
                raise document.error((*keys, "safe"), what)
            if limit.safe is not None and not math.isfinite(limit.safe):
                what = f"expected a finite number, got {limit.safe:g}"
                raise document.error((*keys, "safe"), what)
        for name, value in getattr(node, "safe", {}).items():
            if not math.isfinite(value):
                what = f"expected a finite number, got {value:g}"
                raise document.error((section, "safe", name), what)


def _check_overrun(document: Document, config: Config) -> None:
    overrun, at = config.overrun, ("overrun", "fallback")
    if overrun.fallback is None:
        return
    if overrun.fault_after is not None:
        raise document.error(at, "fault_after is given too; choose one of the two")
    if overrun.fallback not in config.controllers:
        cure = did_you_mean(overrun.fallback, config.controllers)
        raise document.error(at, f"no controller {overrun.fallback}{cure}")
    if overrun.fallback == config.controller:
        raise document.error(at, f"{overrun.fallback} is the controller itself; name another one")


def _check_blocks(document: Document, config: Config) -> None:
    reserved = {*Config.__struct_fields__, FALLBACK, "rx", "tx", "timing"} - {"controller"}
    first: dict[str, str] = {}
    for section, node in config.sections.items():
        for name, entry in node.blocks.items():
            keys: Keys = (section, "blocks", name)
            if name in reserved:
                raise document.error(keys, "this name is taken; rename the block")
            if name in first:
                where = document.where((first[name], "blocks", name))
                what = f"the {first[name]} has this block, {where}; rename one"
                raise document.error(keys, what)
            first[name] = section
            no_file = entry.file is None or entry.law == fmu.LAW
            if entry.law != tables.LAW and (not no_file or entry.signal or entry.interpolation):
                raise document.error(keys, "only `law: table` takes file, signal, interpolation")
            if section == "executive" and name == "controller":
                for key in ("law", "parameters"):
                    if getattr(entry, key):
                        where = f"controllers.{config.controller}.{key}"
                        raise document.error((*keys, key), f"belongs at {where}")
            elif entry.law is None:
                raise document.error(keys, "key law is missing")
    if "controller" not in config.executive.blocks:
        raise document.error(("executive", "blocks"), "block controller is missing")


def _evaluation(document: Document, config: Config) -> Evaluation | None:
    if config.evaluation is None:
        return None
    given = dict(config.evaluation)
    named = {key: given.pop(key) for key in ("file", "window_s") if key in given}
    named.setdefault("window_s", [0.0, config.duration_s])
    evaluation = convert(document, named, Evaluation, ("evaluation",))
    if not 0 <= evaluation.window_s[0] < evaluation.window_s[1]:
        raise document.error(("evaluation", "window_s"), "expected 0 <= begin < end")
    at: Keys = ("evaluation", "file")
    own = project_file(evaluation.file)
    return Evaluation(
        file=str(document.file(at, evaluation.file) if own is None else own),
        window_s=evaluation.window_s,
        numbers=convert(document, given, dict[str, float], ("evaluation",)),
    )


# Files


def _file_keys(data: Mapping[str, Any]) -> list[Keys]:
    """Return the paths of all values of a rig that name a file."""
    keys: list[Keys] = [("dbc",), ("plant", "parameters_file"), ("evaluation", "file")]
    keys += [("controllers", name, "law") for name in data["controllers"]]
    for section in (role for role in ROLES if data[role] is not None):
        keys += [(section, "blocks", name, "law") for name in data[section]["blocks"]]
    return [key for key in keys if _get(data, key) is not None]


def _rebased(document: Document, keys: Keys, text: str) -> str:
    """Return a file or law as the rig file's own folder names it."""
    is_code = keys[-1] == "law" or keys[0] == "evaluation"
    name, colon, attribute = text.partition(":") if keys[-1] == "law" else (text, "", "")
    if is_code and not name.endswith(".py"):
        return text
    file = os.path.normpath(document.place(keys).folder / name)
    if is_code and (own := project_name(Path(file))) is not None:
        return f"{own}{colon}{attribute}"
    return Path(os.path.relpath(file, document.path.parent)).as_posix() + colon + attribute


def _get(data: Any, keys: Keys) -> Any:
    for key in keys:
        data = data.get(key) if isinstance(data, Mapping) else None
    return data


def _put(data: Any, keys: Keys, value: Any) -> None:
    for key in keys[:-1]:
        data = data[key]
    data[keys[-1]] = value
