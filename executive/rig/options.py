"""`--set NAME=VALUE` put into a rig's data: a key of the rig, or a setting of one of its blocks.

`--set @FILE` puts all of a YAML file `NAME: VALUE`, as `pcpc save` writes it.

`--set 'faults.NAME={kind: ..., ...}'` adds a fault on purpose that the rig file has not.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.conversion import as_data, convert
from pcpc.executive.rig.law_lookup import Use, law_block
from pcpc.executive.rig.placed import PlacedMap
from pcpc.executive.rig.roles import Role
from pcpc.executive.rig.schema import EARLIER, Config
from pcpc.executive.rig.yamlfile import Document, Keys, Place, dotted_path


def apply_options(document: Document, controller: str | None, settings: Sequence[str]) -> None:
    """Put `--controller` and `--set` options into the data of a file that is right without them.

    Keys of the rig come first: one of them may be `controller`. RigError: a wrong option.
    """
    config = convert(document, document.data, Config, ())
    if controller is not None:
        place = Place(document.path, option=f"--controller {controller}")
        document.put(("controller",), controller, place)
    keys_of = dict(_leaves(as_data(config), ()))
    keys_of |= {"xcp": ("xcp",), "bus.bitrates": ("bus", "bitrates")}  # a mapping, or a word
    keys_of |= {dotted_path(earlier): keys for earlier, keys in EARLIER.items()}
    blocks: dict[str, list[Role]] = {}  # plants may have the same
    for role, node in config.sections.items():
        for name in node.blocks:
            blocks.setdefault(name, []).append(role)
    rest: list[tuple[str, Any, Place]] = []
    for name, value, place in _parsed_settings(document, settings):
        section, _, fault = name.partition(".")
        if not place.option:  # of a file: settings of blocks only
            rest.append((name, value, place))
        elif name in keys_of:
            if name == "controller" and controller not in (None, value):
                raise RigError(f"{place}: --controller {controller} is another; leave one out")
            document.put(keys_of[name], value, place)
        elif section == "faults" and fault and isinstance(value, dict):
            document.put((section, fault), value, place)
            keys_of |= {f"{name}.{key}": (section, fault, key) for key in value}
        else:
            rest.append((name, value, place))
    standby = document.data.get("standby")
    for name, value, place in rest:
        block, _, setting = name.partition(".")
        if block == "handover" and name in keys_of:
            document.put(keys_of[name], value, place)
            continue
        if setting and isinstance(standby, list) and block in standby:
            document.put(("controllers", block, "parameters", setting), value, place)
            continue
        if name in keys_of:
            what = "is not a setting of a block; give it with"
            raise RigError(f"{place}: {name} {what} --set {name}=")
        if block not in blocks or not setting:
            raise RigError(f"{place}: no such setting{_cure(document, config, name, keys_of)}")
        chosen = document.data["controller"]
        if block == "controller":
            names = document.data["controllers"]
            document.known(("controller",), str(chosen), names, "controller")
        for role in blocks[block]:
            own: Keys = (role, "blocks", block)
            keys = (*(("controllers", chosen) if block == "controller" else own), "parameters")
            if len(blocks[block]) == 1 or not document.place((*keys, setting)).option:
                document.put((*keys, setting), value, place)  # else one is given by its path


def _parsed_settings(
    document: Document, settings: Sequence[str]
) -> Iterator[tuple[str, Any, Place]]:
    """Yield name, value and place of each setting, also of those in a file, `@FILE`."""
    for setting in settings:
        place = Place(document.path, option=f"--set {setting}")
        name, equals, text = setting.partition("=")
        if setting.startswith("@"):
            file = yamlfile.load(setting[1:])
            document.sources.update(file.sources)
            yield from ((name, one, file.place((name,))) for name, one in file.data.items())
        elif equals:
            yield name, yamlfile.parse_value(text, place), place
        else:
            raise RigError(f"{place}: expected NAME=VALUE")


def rename_earlier_keys(document: Document) -> None:
    """Put what stands under keys of earlier versions, as in their logs, under today's.

    RigError: both keys are there.
    """
    for earlier, keys in EARLIER.items():
        around = document.data.get(earlier[0])
        if not isinstance(around, PlacedMap) or earlier[1] not in around:
            continue
        if keys[1] in around.at:
            where = document.where(keys[:-1])
            raise document.error(earlier, f"is {dotted_path(keys)} today; write it there, {where}")
        document.put(keys, around.pop(earlier[1]), around.at.pop(earlier[1]))


def _cure(document: Document, config: Config, name: str, keys: Mapping[str, Keys]) -> str:
    """Return the suggestion for a setting that is none: only what this rig has."""
    own_settings, rig_data = list(_block_settings(document, config)), as_data(config)
    if same := [setting for setting in own_settings if setting.endswith(f".{name}")]:
        return f"; did you mean {' or '.join(same)}?"
    begun = [
        setting for setting in own_settings if setting.partition(".")[2].startswith(f"{name}_")
    ]
    if len(begun) == 1:  # kv for controller.kv_Nms_rad
        return f"; did you mean {begun[0]}?"
    first, _, rest = name.partition(".")
    missing = first in ("local", "watchdog") and rig_data[first] is None  # sections on request
    if rest and (missing or rig_data.get(first) == {}):  # entries by name, and the rig has none
        entry = (
            "".join(f"{{{key}: " for key in rest.split(".")) + "..." + "}" * len(rest.split("."))
        )
        whole_one = f", or --set '{first}.{rest.partition('.')[0]}={{kind: ...}}'"
        cure = f"; write {first}: {entry} into the rig file, then --set can change it"
        return cure + whole_one * (first == "faults")
    lists = {key for key, at in keys.items() if isinstance(_value_at(rig_data, at), list)}
    return did_you_mean(name, [*(key for key in keys if key not in lists), *own_settings])


def _block_settings(document: Document, config: Config) -> Iterator[str]:
    """Yield the settings of all blocks whose law can be imported."""
    for role, node in config.sections.items():
        for name in node.blocks:
            own: Keys = (role, "blocks", name)
            keys = ("controllers", document.data["controller"]) if name == "controller" else own
            try:
                law = convert(document, _value_at(document.data, (*keys, "law")), str, keys)
                entry = (
                    config.controllers[str(keys[1])] if name == "controller" else node.blocks[name]
                )
                use = Use(entry.parameters, config.rate_hz, config.seed)
                block = law_block(document, keys, law, use)
            except (RigError, KeyError):
                continue  # wrong itself, which is said once the option is mended
            ports = block.settings
            yield from (f"{name}.{setting}" for port in ports for setting in port.names())


def _value_at(data: Any, keys: Keys) -> Any:
    for key in keys:
        data = data[key]
    return data


def _leaves(data: Mapping[str, Any], keys: Keys) -> Iterator[tuple[str, Keys]]:
    for key, child in data.items():
        if isinstance(child, dict):
            yield from _leaves(child, (*keys, key))
        else:
            yield dotted_path((*keys, key)), (*keys, key)
