"""The rig file: one experiment, read by every process that takes part in it.

    value of a setting = port's default  <  plant.parameters_file  <  rig file  <  --set

`load_rig` checks all that can be known without the wiring (that is `executive.table`'s): keys,
types, ranges, files, laws, settings and their units. Every message says where:
`file:line:column: path: what; cure`.

    law: pd              BLOCK of executive.controllers.pd
    law: pkg.mod:NAME    NAME of a Python module
    law: model.py:NAME   NAME of a file, relative to the YAML file that says so

numba is imported with the first law, so that reading a rig with `resolve=False` is fast.
"""

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from executive import yamlfile
from executive.errors import RigError, did_you_mean
from executive.laws import project_name, resolve
from executive.rig_options import apply, unknown_controller
from executive.rig_schema import FALLBACK, Config, Entry, Evaluation, Limit, Parameter, Plant
from executive.typed import convert
from executive.yamlfile import Document, Keys, Place

if TYPE_CHECKING:
    from executive.block import Block, Port


@dataclass(frozen=True)
class BlockSpec:
    """A block of a node: its complete settings, its wiring, and where each was given."""

    name: str
    block: "Block"
    settings: dict[str, float]
    inputs: dict[str, str]
    places: dict[str, str] = field(repr=False)

    def where(self, path: str = "") -> str:
        """Return the place of `law`, `inputs.x` or `parameters.x`, else that of the block."""
        return self.places.get(path, self.places[""])


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
    def source_text(self) -> str:
        """The rig file as given, without its bases (`document.sources` has all files)."""
        return self.document.text

    @property
    def dbc(self) -> Path:
        """The DBC file."""
        return self.document.file(("dbc",), self.config.dbc)

    @property
    def evaluation(self) -> Evaluation | None:
        """How a run is judged; `file` is an absolute path."""
        return _evaluation(self.document, self.config)

    def where(self, path: str) -> str:
        """Return `file:line:column` of a path such as `executive.transmit.CMD.motor_torque`."""
        return self.document.where(path)

    def error(self, path: str, what: str) -> RigError:
        """Return the error `file:line:column: path: what` for the caller to raise."""
        return self.document.error(path, what)

    def nodes(self) -> tuple[NodeSpec, NodeSpec]:
        """Return the executive and the plant, with laws imported and settings complete."""
        return self._nodes

    @cached_property
    def _nodes(self) -> tuple[NodeSpec, NodeSpec]:
        config, document = self.config, self.document
        control, plant = config.executive, config.plant
        return (
            NodeSpec(
                control.node, _blocks(document, config, "executive", {}),
                {**control.transmit, **config.controllers[config.controller].transmit},
                dict(control.limits), {},
            ),
            NodeSpec(
                plant.node, _blocks(document, config, "plant", _parameters(document, plant)),
                dict(plant.transmit), {}, dict(plant.safe),
            ),
        )  # fmt: skip

    def resolved(self) -> str:
        """Return the effective rig as YAML, for a log: no base, no parameters file, every setting.

        Paths are relative to the rig file's folder: `load_rig(rig.path, text=...)` reads it back
        with equal values. Imports the laws.
        """
        return self._resolved

    def law_files(self) -> dict[str, str]:
        """Return the text of each law in use from outside the project, by its path in `resolved`.

        With them a log explains itself. Other files that a law imports are not in it.
        """
        found = {}
        for spec, section in zip(self.nodes(), ("executive", "plant"), strict=True):
            for block in spec.blocks:
                keys = (*_law_keys(self.config, section, block.name), "law")
                name = _rebased(self.document, keys, str(_get(self.document.data, keys)))
                file = name.partition(":")[0]
                if file.endswith(".py"):
                    found[file] = (self.path.parent / file).read_text(encoding="utf-8")
        return found

    @cached_property
    def _resolved(self) -> str:
        data = msgspec.to_builtins(self.config)
        for keys in _file_keys(data):
            _put(data, keys, _rebased(self.document, keys, _get(data, keys)))
        for spec, section in zip(self.nodes(), ("executive", "plant"), strict=True):
            for block in spec.blocks:
                keys = _law_keys(self.config, section, block.name)
                _put(data, (*keys, "parameters"), dict(block.settings))
        data["plant"]["parameters_file"] = None
        return yamlfile.dump(data)


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
    config = convert(document, document.data, Config, ())
    if controller is not None:
        place = Place(document.path, option=f"--controller {controller}")
        document.put(("controller",), controller, place)
    apply(document, config, settings)
    config = convert(document, document.data, Config, ())
    _check(document, config)
    rig = Rig(config, document)
    if resolve:
        rig.nodes()
    return rig


# Checks between keys


def _check(document: Document, config: Config) -> None:
    """Raise the first contradiction between the keys of a rig."""
    if config.controller not in config.controllers:
        unknown_controller(document, config.controller, config)
    _check_blocks(document, config)
    _check_overrun(document, config)
    for name, limit in config.executive.limits.items():
        if not limit.low < limit.high:
            what = f"low {limit.low:g} is not below high {limit.high:g}"
            raise document.error(("executive", "limits", name), what)
    for name, figures in config.expect.items():
        if name not in config.controllers:
            what = f"no such controller{did_you_mean(name, config.controllers)}"
            raise document.error(("expect", name), what)
        for figure, (low, high) in figures.items():
            if not low <= high:
                raise document.error(("expect", name, figure), f"{low:g} is above {high:g}")
    _evaluation(document, config)
    for keys in _file_keys(msgspec.to_builtins(config)):
        if keys[-1] != "law":
            document.file(keys, _get(document.data, keys))


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
    for section, node in (("executive", config.executive), ("plant", config.plant)):
        for name, entry in node.blocks.items():
            keys: Keys = (section, "blocks", name)
            if name in reserved:
                raise document.error(keys, "this name is taken; rename the block")
            if section == "plant" and name in config.executive.blocks:
                first = document.where(("executive", "blocks", name))
                raise document.error(keys, f"the executive has this block, {first}; rename one")
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
    return Evaluation(
        file=str(document.file(("evaluation", "file"), evaluation.file)),
        window_s=evaluation.window_s,
        numbers=convert(document, given, dict[str, float], ("evaluation",)),
    )


# Files


def _file_keys(data: Mapping[str, Any]) -> list[Keys]:
    """Return the paths of all values of a rig that name a file."""
    keys: list[Keys] = [("dbc",), ("plant", "parameters_file"), ("evaluation", "file")]
    keys += [("controllers", name, "law") for name in data["controllers"]]
    for section in ("executive", "plant"):
        keys += [(section, "blocks", name, "law") for name in data[section]["blocks"]]
    return [key for key in keys if _get(data, key) is not None]


def _rebased(document: Document, keys: Keys, text: str) -> str:
    """Return a file or law as the rig file's own folder names it."""
    name, colon, attribute = text.partition(":") if keys[-1] == "law" else (text, "", "")
    if keys[-1] == "law" and not name.endswith(".py"):
        return text
    file = os.path.normpath(document.place(keys).folder / name)
    if keys[-1] == "law" and (own := project_name(Path(file))) is not None:
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


def _parameters(document: Document, plant: Plant) -> dict[str, tuple[Parameter, Document, Keys]]:
    """Return the parameters file by name, each with its document and path."""
    if plant.parameters_file is None:
        return {}
    source = yamlfile.load(document.file(("plant", "parameters_file"), plant.parameters_file))
    groups = convert(source, source.data, dict[str, dict[str, Parameter]], ())
    flat: dict[str, tuple[Parameter, Document, Keys]] = {}
    for group, parameters in groups.items():
        for name, parameter in parameters.items():
            if name in flat:
                first = source.where(flat[name][2])
                raise source.error((group, name), f"given twice, first at {first}; rename one")
            flat[name] = (parameter, source, (group, name))
    return flat


# Blocks


def _law_keys(config: Config, section: str, name: str) -> Keys:
    if section == "executive" and name == FALLBACK and config.overrun.fallback is not None:
        return ("controllers", config.overrun.fallback)
    if section == "executive" and name == "controller":
        return ("controllers", config.controller)
    return (section, "blocks", name)


def _blocks(
    document: Document, config: Config, section: str,
    shared: Mapping[str, tuple[Parameter, Document, Keys]],
) -> list[BlockSpec]:  # fmt: skip
    """Return the blocks of a node; `shared` goes to every block that has such a setting."""
    specs: list[BlockSpec] = []
    unused = dict(shared)
    for name, entry in _entries(config, section):
        keys = _law_keys(config, section, name)
        law = config.controllers[str(keys[1])] if keys[0] == "controllers" else entry
        block = resolve(document, keys, str(law.law))
        places = {"": document.where((section, "blocks", name))}
        places |= {"law": document.where((*keys, "law"))}
        for inputs, at in ((entry.inputs, (section, "blocks", name)), (law.inputs, keys)):
            places |= {f"inputs.{key}": document.where((*at, "inputs", key)) for key in inputs}
        settings = _settings(document, keys, law.parameters, block, shared, places)
        for used in settings:
            unused.pop(used, None)
        specs.append(BlockSpec(name, block, settings, {**entry.inputs, **law.inputs}, places))
    for name, (_, source, at) in unused.items():
        known = [setting for spec in specs for setting in spec.settings]
        raise source.error(at, f"no block of the plant has {name}{did_you_mean(name, known)}")
    return specs


def _entries(config: Config, section: str) -> Iterator[tuple[str, Entry]]:
    """Yield the blocks of a node; a fallback follows its controller and is wired alike."""
    blocks = config.executive.blocks if section == "executive" else config.plant.blocks
    for name, entry in blocks.items():
        yield name, entry
        if section == "executive" and name == "controller" and config.overrun.fallback is not None:
            yield FALLBACK, entry


def _settings(
    document: Document, keys: Keys, given: Mapping[str, float], block: "Block",
    shared: Mapping[str, tuple[Parameter, Document, Keys]], places: dict[str, str],
) -> dict[str, float]:  # fmt: skip
    """Return all settings of a block in the order of its ports; their places go to `places`."""
    ports = {name: port for port in block.settings or block.parameters for name in port.names()}
    for name in given:
        if name not in ports:
            at = (*keys, "parameters", name)
            raise document.error(at, f"unknown parameter{did_you_mean(name, ports)}")
    settings: dict[str, float] = {}
    for name, port in ports.items():
        source, at = document, (*keys, "parameters", name)
        if name in shared and shared[name][0].unit != port.unit:
            parameter, source, at = shared[name]
            what = f"unit '{parameter.unit}' where block {keys[-1]} has '{port.unit}'"
            raise source.error((*at, "unit"), what)
        if name in given:
            settings[name] = given[name]
        elif name in shared:
            parameter, source, at = shared[name]
            settings[name] = parameter.value
        elif port.default is not None:
            settings[name] = port.default
            continue
        else:
            unit = f" [{port.unit}]" if port.unit else ""
            raise document.error(keys, f"parameter {name}{unit} is missing: {port.help}")
        places[f"parameters.{name}"] = source.where(at)
        _check_range(source, at, name, port, settings[name])
    return settings


def _check_range(source: Document, at: Keys, name: str, port: "Port", value: float) -> None:
    if not (port.low <= value <= port.high and math.isfinite(value)):
        unit = f" {port.unit}" if port.unit else ""
        what = f"{value:.12g} is outside {port.low:.12g}..{port.high:.12g}{unit}"
        raise source.error(at, f"{name}: {what}" if source.place(at).option else what)
