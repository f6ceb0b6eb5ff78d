"""The effective rig: plain data that stands for itself, as a log holds it.

Every default and every setting is written out, the parameters file and the settings of `prepare`'s
tables among them; a file or law is named as the rig file's own folder names it.
"""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pcpc.executive.own_laws.modules import project_name
from pcpc.executive.rig.blocks import BlockSpec, law_keys
from pcpc.executive.rig.conversion import as_data
from pcpc.executive.rig.file_laws import FILE_LAWS, FileLaw
from pcpc.executive.rig.roles import PLANTS, ROLES, Role
from pcpc.executive.rig.schema import Config
from pcpc.executive.rig.yamlfile import Document, Keys


def data(
    document: Document, config: Config, specs: Mapping[Role, Sequence[BlockSpec]]
) -> dict[str, Any]:
    """Return a rig's data with all values of its blocks."""
    rig_data = as_data(config)
    for keys in file_keys(rig_data):
        value_at(rig_data, keys[:-1])[keys[-1]] = rebased_path(
            document, keys, value_at(rig_data, keys)
        )
    for role, blocks in specs.items():
        for block in blocks:
            entry = value_at(rig_data, law_keys(config, role, block.name))
            entry["parameters"] = dict(block.settings)
            if block.table:
                entry["file"] = table_name(role, block, config)
                _file_law(role, block, config).resolve(entry)
    if config.xcp is None:
        del rig_data["xcp"]
    for role in config.plants:
        plant = rig_data[role]
        plant["parameters_file"] = None
        if plant["drive"] is not None and plant["drive"]["eds"] is not None:
            plant["drive"]["eds"] = eds_name(role)
        if plant["bus"] is None:
            del plant["bus"]
    return rig_data


def eds_name(role: Role) -> str:
    """Return the name that a log gives to the EDS of a plant's drive."""
    return f"{role}-drive.eds"


def table_name(role: Role, block: BlockSpec, config: Config) -> str:
    """Return the name of the file that holds a block's table."""
    return f"{role}-{block.name}.{_file_law(role, block, config).kept_as}"


def _file_law(role: Role, block: BlockSpec, config: Config) -> FileLaw:
    return FILE_LAWS[config.sections[role].blocks[block.name].law]


def file_keys(rig_data: Mapping[str, Any]) -> list[Keys]:
    """Return the paths of all values of a rig that name a file or a law."""
    keys: list[Keys] = [("dbc",), ("evaluation", "file")]
    keys += [(role, "parameters_file") for role in PLANTS]
    keys += [("controllers", name, "law") for name in rig_data["controllers"]]
    for role in (role for role in ROLES if rig_data.get(role) is not None):
        keys += [(role, "blocks", name, "law") for name in rig_data[role]["blocks"]]
    return [key for key in keys if value_at(rig_data, key) is not None]


def rebased_path(document: Document, keys: Keys, text: str) -> str:
    """Return a file or law as the rig file's own folder names it."""
    is_code = keys[-1] == "law" or keys[0] == "evaluation"
    name, colon, attribute = text.partition(":") if keys[-1] == "law" else (text, "", "")
    if is_code and not name.endswith(".py"):
        return text
    file = os.path.normpath(document.place(keys).folder / name)
    if is_code and (own := project_name(Path(file))) is not None:
        return f"{own}{colon}{attribute}"
    return Path(os.path.relpath(file, document.path.parent)).as_posix() + colon + attribute


def value_at(value: Any, keys: Keys) -> Any:
    """Return the value at a path; None where there is none."""
    for key in keys:
        value = value.get(key) if isinstance(value, Mapping) else None
    return value
