"""`law: fmu`: a Functional Mock-up Unit (FMI 2.0 or 3.0, co-simulation) as a block of a rig.

    plant:
      node: PLANT
      fmu: tank.fmu                      the same as blocks: {fmu: {law: fmu, file: tank.fmu, ...}}
      inputs: {inflow: rx.CMD.inflow}    by the FMU's own names of its variables
      parameters: {area: 2.0}
      transmit: {FB.level: fmu.level}

FMPy reads and checks the description. An FMU is native code: reading a rig does not run it, and a
log holds its description only.
"""

import hashlib
import re
import zipfile
from collections.abc import Iterator, Mapping
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from pcpc.drivers.machine.packages import pip_install
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.laws.units import from_fmi
from pcpc.executive.rig.fmu_model import INPUT, PARAMETER, START, FmuModel, FmuVariable
from pcpc.executive.rig.node_keys import BlockEntry
from pcpc.executive.rig.placed import PlacedMap, child, places_in
from pcpc.executive.rig.roles import PLANTS, Role
from pcpc.executive.rig.yamlfile import Document, Keys, display_path

if TYPE_CHECKING:
    from pcpc.executive.laws.block import Block

LAW = "fmu"
_SHORT = ("fmu", "inputs", "parameters")  # keys of the plant that stand for a block
_HEAD_BYTES = 10_000
_MOST = 4096  # values of an array that are taken
_NUMBERS = {
    "Real", "Integer", "Boolean", "Enumeration", "Float64", "Float32", "Int8", "UInt8", "Int16",
    "UInt16", "Int32", "UInt32", "Int64", "UInt64",
}  # fmt: skip


def needs() -> str:
    """Return what a rig with an FMU lacks without FMPy."""
    return f"FMUs need FMPy: {pip_install('fmpy')}"


def expand_shorthand(document: Document) -> None:
    """Turn `plant: {fmu: FILE, inputs, parameters}` into a block `fmu`, the first; RigError."""
    for role in PLANTS:
        plant = document.data.get(role)
        if isinstance(plant, PlacedMap) and "fmu" in plant:
            _expand(document, role, plant)


def _expand(document: Document, role: Role, plant: PlacedMap) -> None:
    blocks = plant.get("blocks", PlacedMap())
    if not isinstance(blocks, PlacedMap) or "fmu" in blocks:
        raise document.error((role, "fmu"), "a block fmu is there, too; rename that")
    entry = PlacedMap({"law": LAW})
    for key in _SHORT:
        if key in plant:
            entry.take("file" if key == "fmu" else key, plant, key)
            del plant[key]
    plant["blocks"] = PlacedMap({"fmu": entry, **blocks}, {"fmu": entry.at["file"], **blocks.at})


def read_fmu(document: Document, keys: Keys, entry: BlockEntry) -> "tuple[Block, str, BlockEntry]":
    """Return the block of an FMU, its description as text, and `entry` with the names here.

    RigError for what is wrong with the file or with the names of its inputs.
    """
    from pcpc.executive.rig import fmu_block  # here, because it imports numba

    if entry.file is None:
        raise document.error(keys, "law fmu needs `file`, an FMU")
    file = document.file((*keys, "file"), entry.file)
    try:
        model = _model_of_log(file) if file.suffix == ".json" else read_description(file)
    except RigError as error:
        raise document.error((*keys, "file"), str(error)) from None
    inputs = {one.given: one.name for one in model.of(INPUT)}
    settings = {one.given: one.name for one in model.of(PARAMETER, START)}
    for name in entry.inputs:
        if inputs.get(name, name) not in inputs.values():
            raise document.error((*keys, "inputs", name), _no_input(model, name, file))
    renamed = msgspec.structs.replace(
        entry,
        inputs=_by_own_names(document, (*keys, "inputs"), entry.inputs, inputs),
        parameters=_by_own_names(document, (*keys, "parameters"), entry.parameters, settings),
    )
    own = None if file.suffix == ".json" else file
    try:
        block = fmu_block.block(model, own, renamed.inputs)
    except ValueError as error:  # names of a log that somebody else wrote
        raise document.error((*keys, "file"), str(error)) from None
    return block, msgspec.json.encode(model).decode() + "\n", renamed


def _by_own_names(
    document: Document, keys: Keys, by_fmu_name: Mapping[str, Any], names: Mapping[str, str]
) -> dict[str, Any]:
    """Return a mapping by the names here, where it goes by the FMU's own; places go along."""
    own_names = {name: names.get(name, name) for name in by_fmu_name}
    places = places_in(reduce(child, keys, document.data))
    places |= {own_names[name]: places[name] for name in by_fmu_name if name in places}
    return {own_names[name]: value for name, value in by_fmu_name.items()}


def _no_input(model: FmuModel, name: str, file: Path) -> str:
    """Return what is wrong with a wired name."""
    variable = next((one for one in model.variables if name in (one.given, one.name)), None)
    if variable is not None:
        what = "starts there" if variable.role == START else f"is of causality {variable.role}"
        return f"{variable.given} of {file.name} {what}; only inputs are wired"
    known = [one.given for one in model.of(INPUT)]
    return f"{file.name} has no input {name}{did_you_mean(name, known)}"


def _model_of_log(file: Path) -> FmuModel:
    """Return the model of a log's text; RigError."""
    try:
        return msgspec.json.decode(file.read_bytes(), type=FmuModel)
    except (OSError, msgspec.DecodeError) as error:
        raise RigError(f"{display_path(file)}: no description of an FMU: {error}") from None


# ---------------------------------------------------------------------------- the FMU's own text


def read_description(file: Path) -> FmuModel:
    """Return what an FMU's description says; RigError in a line for what cannot be used."""
    description = _read(file)
    where, simulated = display_path(file), description.coSimulation
    if simulated is None:
        kinds = {
            "model exchange": description.modelExchange,
            "scheduled execution": description.scheduledExecution,
        }
        has = " and ".join(kind for kind, there in kinds.items() if there is not None)
        raise RigError(f"{where}: an FMU for {has} only; export it for co-simulation")
    if simulated.needsExecutionTool:
        raise RigError(
            f"{where}: needs {description.generationTool or 'the tool that made it'} to run"
        )
    with file.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return FmuModel(
        name=description.modelName or simulated.modelIdentifier,
        fmi=description.fmiVersion,
        identifier=simulated.modelIdentifier,
        token=description.guid or "",
        sha256=digest,
        once=bool(simulated.canBeInstantiatedOnlyOncePerProcess),
        made_by=description.generationTool or "",
        variables=tuple(_variables(description)),
    )


def _read(file: Path) -> Any:
    """Return FMPy's model description; RigError."""
    try:
        from fmpy import platform, platform_tuple
        from fmpy.model_description import read_model_description
    except ImportError:
        raise RigError(f"{display_path(file)}: {needs()}") from None
    where = display_path(file)
    try:
        with zipfile.ZipFile(file) as archive:
            inside = archive.namelist()
            broken = archive.testzip()
    except (zipfile.BadZipFile, OSError, EOFError, NotImplementedError) as error:
        raise RigError(f"{where}: not an FMU, which is a zip archive: {error}") from None
    if broken is not None:
        raise RigError(f"{where}: damaged: {broken} in it does not have its checksum")
    if "modelDescription.xml" not in inside:
        raise RigError(f"{where}: not an FMU: there is no modelDescription.xml in it")
    version = _version(file)
    if version not in ("2.0", "3.0"):
        raise RigError(f"{where}: FMI {version}; 2.0 and 3.0 are supported")
    try:
        description = read_model_description(str(file), validate=True)
    except Exception as error:  # lxml's and FMPy's own
        problems = getattr(error, "problems", None) or [str(error)]
        raise RigError(f"{where}: modelDescription.xml: {' '.join(problems[0].split())}") from None
    if description.coSimulation is not None:
        folder = platform if description.fmiVersion == "2.0" else platform_tuple
        library = f"binaries/{folder}/{description.coSimulation.modelIdentifier}.so"
        if library not in inside:
            others = sorted(
                {
                    name.split("/")[1]
                    for name in inside
                    if name.count("/") > 1 and name.startswith("binaries/")
                }
            )
            has = f"; it has {', '.join(others)}" if others else ""
            raise RigError(f"{where}: nothing for this machine, {library}{has}")
    return description


def _version(file: Path) -> str:
    """Return what the description says of its version, before it is checked by that."""
    with zipfile.ZipFile(file) as archive, archive.open("modelDescription.xml") as text:
        found = re.search(rb'fmiVersion\s*=\s*["\']([^"\']{1,20})', text.read(_HEAD_BYTES))
    return found[1].decode(errors="replace") if found else "of no version"


def _variables(description: Any) -> Iterator[FmuVariable]:
    """Yield the numbers of a description that are inputs, outputs, parameters or starts."""
    used_names: set[str] = {"fmi_address", "fmi_status"}
    for variable in description.modelVariables:
        if variable.type not in _NUMBERS or variable.alias is not None:
            continue
        roles = [*_roles(variable)]
        for element, name in _elements(variable):
            for role, ending in roles:
                yield _variable(
                    variable, role, element, name, _unique_name(name + ending, used_names)
                )


def _roles(variable: Any) -> Iterator[tuple[str, str]]:
    """Yield each role of a variable, and the ending of its name there."""
    if variable.causality in ("input", "output"):
        yield variable.causality, ""
    if variable.causality == "parameter":
        yield "parameter", ""
    elif variable.start is not None and (
        variable.causality == "input"
        or (
            variable.initial == "exact"
            and variable.variability != "constant"
            and variable.causality in ("output", "local")
        )
    ):
        yield "start", "_start"


def _elements(variable: Any) -> Iterator[tuple[int, str]]:
    """Yield place and name of each element: 0 and the name, or those of an array."""
    size = 1
    for dimension in variable.dimensions:
        by = dimension.start
        if by is None and dimension.variable is not None:
            by = dimension.variable.start
        size *= int(by or 0)
    if not variable.dimensions:
        yield 0, variable.name
    elif 0 < size <= _MOST:
        yield from ((i, f"{variable.name}[{i + 1}]") for i in range(size))


def _variable(variable: Any, role: str, element: int, name: str, own_name: str) -> FmuVariable:
    declared = variable.declaredType
    text = variable.unit or (declared.unit if declared is not None else "") or ""
    description = " ".join((variable.description or "").split())
    low, high = (
        _number(end if end is not None else getattr(declared, side, None))
        for end, side in ((variable.min, "min"), (variable.max, "max"))
    )
    if variable.type == "Boolean":
        low, high = 0.0, 1.0
    start = None if role == "output" else _number(variable.start, element)
    if role == "parameter" and start is None:
        start = 0.0
    return FmuVariable(
        name=own_name,
        given=name,
        role=role,
        kind=variable.type,
        reference=variable.valueReference,
        element=element,
        unit=from_fmi(text),
        start=start,
        low=low,
        high=high,
        help=description or f"{name} of the FMU",
        tunable=role == "parameter" and variable.variability == "tunable",
    )


def _number(text: Any, element: int = 0) -> float | None:
    """Return a number of the description, or one of a list; None for none."""
    if text is None:
        return None
    parts = str(text).split()
    word = parts[element] if element < len(parts) else parts[0] if len(parts) == 1 else ""
    if word in ("true", "false"):
        return float(word == "true")
    try:
        return float(word)
    except ValueError:
        return None


def _unique_name(name: str, used_names: set[str]) -> str:
    """Return the name of a variable as an identifier, with a number if that is taken."""
    word = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")
    word = word if re.match("[A-Za-z]", word) else f"v_{word}"
    unique, number = word, 1
    while unique in used_names:
        number += 1
        unique = f"{word}_{number}"
    used_names.add(unique)
    return unique
