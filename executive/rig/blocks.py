"""The blocks of a rig's nodes: laws imported, settings complete, each with the place that gave it.

value of a setting = port's default  <  plant.parameters_file  <  rig file  <  --set
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pcpc.executive.errors import did_you_mean
from pcpc.executive.rig import wired_units, yamlfile
from pcpc.executive.rig.conversion import convert
from pcpc.executive.rig.file_laws import FILE_LAWS
from pcpc.executive.rig.law_lookup import Use, law_block
from pcpc.executive.rig.node_keys import BlockEntry, Plant, Section
from pcpc.executive.rig.roles import Role
from pcpc.executive.rig.schema import FALLBACK, Config, Parameter
from pcpc.executive.rig.yamlfile import Document, Keys

if TYPE_CHECKING:
    from pcpc.executive.laws.block import Block, Port


Shared = tuple[Parameter, Document, Keys]  # an entry of a parameters file, and where it stands


@dataclass(frozen=True)
class BlockSpec:
    """A block of a node: its complete settings, its wiring, and where each was given.

    `table`: what a law of FILE_LAWS makes of its file, as text.
    """

    name: str
    block: "Block"
    settings: dict[str, float]
    inputs: dict[str, str]
    places: dict[str, str] = field(repr=False)
    table: str = field(repr=False, default="")

    def where(self, path: str = "") -> str:
        """Return the place of `law`, `inputs.x` or `parameters.x`, else that of the block."""
        return self.places.get(path, self.places[""])

    @property
    def is_opaque(self) -> bool:
        """Whether its step has a state of its own, which no port shows."""
        return getattr(self.block.step, "is_opaque", False)


@dataclass(frozen=True)
class _RawBlock:
    """A block before its unit is known and its settings are."""

    name: str
    keys: Keys
    entry: BlockEntry
    law: Any
    block: "Block"
    text: str
    inputs: dict[str, str]


def _shared_parameters(document: Document, role: Role, node: Section) -> dict[str, Shared]:
    """Return the entries of a plant's parameters file by name; every block takes those it has."""
    if not isinstance(node, Plant) or node.parameters_file is None:
        return {}
    source = yamlfile.load(document.file((role, "parameters_file"), node.parameters_file))
    groups: dict[str, dict[str, Parameter]] = convert(
        source, source.data, dict[str, dict[str, Parameter]], ()
    )
    flat: dict[str, Shared] = {}
    for group, parameters in groups.items():
        for name, parameter in parameters.items():
            if name in flat:
                first = source.where(flat[name][2])
                raise source.error((group, name), f"given twice, first at {first}; rename one")
            flat[name] = (parameter, source, (group, name))
    return flat


def law_keys(config: Config, section: str, name: str) -> Keys:
    """Return the path of the entry that names the law of a block."""
    controllers = {name: name for name in config.standby} | {"controller": config.controller}
    if config.overrun.fallback is not None:
        controllers[FALLBACK] = config.overrun.fallback
    if section == "executive" and name in controllers:
        return ("controllers", controllers[name])
    return (section, "blocks", name)


def blocks(document: Document, config: Config, section: Role) -> list[BlockSpec]:
    """Return the blocks of a node, with laws imported and settings complete; RigError."""
    specs: list[BlockSpec] = []
    raw_blocks: list[_RawBlock] = []
    shared = _shared_parameters(document, section, config.sections[section])
    unused = dict(shared)
    for name, entry in entries(config, section):
        keys = law_keys(config, section, name)
        law = config.controllers[str(keys[1])] if keys[0] == "controllers" else entry
        given = {setting: parameter.value for setting, (parameter, *_) in shared.items()}
        use = Use(given | law.parameters, config.rate_hz, config.seed)
        text = ""
        if law is entry and entry.law in FILE_LAWS:
            block, text, entry = FILE_LAWS[entry.law].read(document, keys, entry)
            law = entry
        else:
            block = law_block(document, keys, str(law.law), use)
        inputs = {**entry.inputs, **law.inputs}
        raw_blocks.append(_RawBlock(name, keys, entry, law, block, text, inputs))
    for raw in raw_blocks:
        name, keys, entry, law = raw.name, raw.keys, raw.entry, raw.law
        unit = entry.unit if law is entry else None
        block = wired_units.in_its_unit(document, keys, name, raw.block, unit, raw_blocks)
        places = {"": document.where((section, "blocks", name))}
        places |= {"law": document.where((*keys, "law"))}
        for inputs, its_keys in ((entry.inputs, (section, "blocks", name)), (law.inputs, keys)):
            places |= {
                f"inputs.{key}": document.where((*its_keys, "inputs", key)) for key in inputs
            }
        settings = _settings(document, keys, law.parameters, block, shared, places)
        for used in settings:
            unused.pop(used, None)
        specs.append(BlockSpec(name, block, settings, raw.inputs, places, raw.text))
    for name, (_, source, its_keys) in unused.items():
        known = [setting for spec in specs for setting in spec.settings]
        source.known(its_keys, name, known, "block of the plant has")
    return specs


def entries(config: Config, section: Role) -> Iterator[tuple[str, BlockEntry]]:
    """Yield the blocks of a node; those of other controllers follow, and are wired alike."""
    for name, entry in config.sections[section].blocks.items():
        yield name, entry
        if (section, name) == ("executive", "controller"):
            if config.overrun.fallback is not None:
                yield FALLBACK, entry
            yield from ((other, entry) for other in config.standby)


def _settings(
    document: Document,
    keys: Keys,
    values: Mapping[str, float],
    block: "Block",
    shared: Mapping[str, Shared],
    places: dict[str, str],
) -> dict[str, float]:
    """Return all settings of a block in the order of its ports; their places go to `places`."""
    ports = {name: port for port in block.settings for name in port.names()}
    for name in values:
        if name not in ports:
            its_keys = (*keys, "parameters", name)
            raise document.error(its_keys, f"unknown parameter{did_you_mean(name, ports)}")
    settings: dict[str, float] = {}
    for name, port in ports.items():
        source, its_keys = document, (*keys, "parameters", name)
        if name in shared and shared[name][0].unit != port.unit:
            parameter, source, its_keys = shared[name]
            what = f"unit '{parameter.unit}' where block {keys[-1]} has '{port.unit}'"
            raise source.error((*its_keys, "unit"), what)
        if name in values:
            settings[name] = values[name]
        elif name in shared:
            parameter, source, its_keys = shared[name]
            settings[name] = parameter.value
        elif port.default is not None:
            settings[name] = port.default
            continue
        else:
            unit = f" [{port.unit}]" if port.unit else ""
            raise document.error(keys, f"parameter {name}{unit} is missing: {port.help}")
        places[f"parameters.{name}"] = source.where(its_keys)
        _check_range(source, its_keys, name, port, settings[name])
    return settings


def _check_range(source: Document, its_keys: Keys, name: str, port: "Port", value: float) -> None:
    if not (port.low <= value <= port.high and math.isfinite(value)):
        unit = f" {port.unit}" if port.unit else ""
        what = f"{value:.12g} is outside {port.low:.12g}..{port.high:.12g}{unit}"
        raise source.error(its_keys, f"{name}: {what}" if source.place(its_keys).option else what)
