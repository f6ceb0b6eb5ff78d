"""`pcpc generate fmu RIG -o FILE`: a block of a rig's plant as an FMU, FMI 2.0 for co-simulation.

    parameters    those of the step, as the rig and `prepare` give them; all tunable
    inputs        those of the block;  outputs  those of the block
    states        the recorded ones, as local variables with a start

The block's C is that of `pcpc generate c`, with `fmu2.c` around it; both lie in the FMU's
`sources`, its library is compiled here. The communication step is the rig's period. Seeds of noise
are those of the rig. Equal rigs give equal files, but for what the compiler does.
"""

import hashlib
import shutil
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.sax.saxutils import quoteattr

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.laws.block import Port
from pcpc.executive.laws.units import in_fmi
from pcpc.executive.nodes.plan import Plan, plan
from pcpc.executive.rig import fmu
from pcpc.executive.rig.blocks import BlockSpec
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make.fmu.commands import FmuRequest
from pcpc.tools.make.generate.library import PLAIN, WARNINGS, compiler, run
from pcpc.tools.make.generate.translator import elementary
from pcpc.tools.make.generate.translator.kinds import number_text
from pcpc.tools.make.generate.translator.law import LETTERS, ROLES, law_files, signature
from pcpc.tools.make.generate.words import identifier
from pcpc.tools.terminal.extras import need
from pcpc.tools.terminal.outfile import new_file

_AROUND = Path(__file__).with_name("fmu2.c")
_TIME = (1980, 1, 1, 0, 0, 0)  # of the files in it
_NO_STATE = 0  # the roles of fmu2.c, in its order
_ROLE_OF = {"parameters": 1, "states": 2, "inputs": 3, "outputs": 4}


@dataclass(frozen=True)
class _Value:
    """One double of the block: where it lies, what it is, what it starts with."""

    place: int
    kind: str  # of ROLES
    name: str
    port: Port
    start: float


def command(request: FmuRequest) -> int:
    """Write an FMU; say what it holds and how a rig takes it."""
    need("an FMU needs", "fmpy")
    output = request.output and Path(request.output)
    rig = load_rig(request.rig, None, request.set)
    made = plan(rig, "plant", "lockstep")
    spec = chosen_block(made, request.block)
    output = output or Path(f"{identifier(spec.name)}.fmu")
    write(made, spec, output)
    print(f"{output}: FMI 2.0, co-simulation, step {1.0 / rig.config.rate_hz:g} s")
    print(f"in a rig: {spec.name}: {{law: fmu, file: {output.name}, inputs: ...}}")
    return Exit.OK


def chosen_block(made: Plan, name: str | None) -> BlockSpec:
    """Return the block of a plant, by name where there are several; RigError."""
    blocks = {spec.name: spec for spec in made.spec.blocks}
    if name is None and len(blocks) == 1:
        return next(iter(blocks.values()))
    if name not in blocks:
        known = f"; the plant has {', '.join(blocks)}"
        what = "say which with --block" if name is None else f"no block {name}"
        cure = did_you_mean(name, blocks) if name else known
        raise RigError(f"{made.rig.path}: {what}{cure}")
    return blocks[name]


def write(made: Plan, spec: BlockSpec, output: Path) -> None:
    """Write the FMU of a block; RigError, UserError, Untranslatable."""
    try:
        import fmpy
        from fmpy.validation import validate_fmu
    except ImportError:
        raise UserError(fmu.needs(), Exit.ENVIRONMENT) from None
    values = list(_values(made, spec))
    name = identifier(spec.name)
    texts = _sources(made, spec, values)
    token = hashlib.sha256("".join(texts[key] for key in sorted(texts)).encode()).hexdigest()[:32]
    texts["fmu_block.h"] += f'#define PLANT_GUID "{token}"\n'
    headers = Path(fmpy.__file__).parent / "c-code"
    standard = sorted(headers.glob("fmi2*.h"))
    about = _description(made, spec, values, token, [t for t in sorted(texts) if t.endswith(".c")])
    with new_file(output, force=True) as whole, TemporaryDirectory() as text:
        folder = Path(text)
        for file, content in texts.items():
            (folder / file).write_text(content, encoding="utf-8")
        library = folder / f"{name}.so"
        parts = [folder / file for file in sorted(texts) if file.endswith(".c")]
        warnings = (*WARNINGS, "-Wno-unused-but-set-variable")
        run(
            [
                compiler(),
                *elementary.FLAGS,
                *warnings,
                *PLAIN,
                "-shared",
                "-fPIC",
                "-fvisibility=hidden",
                "-isystem",
                headers,
                "-o",
                library,
                *parts,
            ]
        )
        draft = folder / output.name
        with zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as archive:
            _put(archive, "modelDescription.xml", about.encode())
            _put(archive, f"binaries/{fmpy.platform}/{name}.so", library.read_bytes())
            for file, content in sorted(texts.items()):
                _put(archive, f"sources/{file}", content.encode())
            for header in standard:
                _put(archive, f"sources/{header.name}", header.read_bytes())
        if problems := validate_fmu(str(draft)):
            raise UserError(f"{output}: FMPy finds it invalid: {' '.join(problems[0].split())}")
        shutil.copyfile(draft, whole)


def _put(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    archive.writestr(zipfile.ZipInfo(name, _TIME), content, zipfile.ZIP_DEFLATED)


def _values(made: Plan, spec: BlockSpec) -> Iterator[_Value]:
    """Yield the doubles of a block in the order of memory."""
    views = made.views[made.spec.blocks.index(spec)]
    place = 0
    for kind in ROLES:
        ports = [(port, name) for port in getattr(spec.block, kind) for name in port.names()]
        for (port, name), at in zip(ports, getattr(views, kind), strict=True):
            yield _Value(place, kind, name, port, made.values.get(at, 0.0))
            place += 1


# ------------------------------------------------------------------------------------ its sources


def _sources(made: Plan, spec: BlockSpec, values: list[_Value]) -> dict[str, str]:
    """Return the texts of its C files by name."""
    starts = tuple(
        [(one.name, one.start) for one in values if one.kind == kind]
        for kind in ("parameters", "states")
    )
    texts = elementary.files() | law_files(spec.block, "plant", (starts[0], starts[1]))
    has = signature(spec.block)
    given = "".join(f", &values->{LETTERS[role]}" for role in has)
    initial = ", ".join(f"&values->{LETTERS[role]}" for role in ROLES[:2] if role in has)
    period_s = made.rig.config.period_ns * 1e-9
    texts["fmu_block.h"] = "\n".join(
        [
            "/* The values of the block, its calls, and which of them a user may see or set. */",
            '#include "plant.h"',
            "",
            "typedef struct {",
            *(f"    plant_{role} {LETTERS[role]};" for role in has),
            "} plant_values;",
            "",
            "static inline void plant_begin(plant_values *values)",
            "{",
            "    (void)values;",
            f"    plant_init({initial});",
            "}",
            "",
            "static inline void plant_call(double t, double dt, plant_values *values)",
            "{",
            f"    plant_step(t, dt{given});",
            "}",
            "",
            f"#define PLANT_PERIOD_S {number_text(period_s)}",
            f'#define PLANT_PERIOD_TEXT "{period_s!r}"',
            f"#define PLANT_VALUES {len(values)}U",
            f"#define PLANT_ROLES {{{', '.join(str(_role(one)) for one in values)}}}",
            "",
        ]
    )
    texts["fmu2.c"] = _AROUND.read_text(encoding="utf-8")
    return texts


def _role(one: _Value) -> int:
    shown = one.kind != "states" or one.port.recorded
    return _ROLE_OF[one.kind] if shown else _NO_STATE


# -------------------------------------------------------------------------------- its description


def _description(
    made: Plan, spec: BlockSpec, values: list[_Value], token: str, sources: list[str]
) -> str:
    """Return modelDescription.xml."""
    shown = [one for one in values if _role(one) != _NO_STATE]
    config, name = made.rig.config, identifier(spec.name)
    units = sorted({in_fmi(one.port.unit) for one in shown} - {""})
    outputs = [n for n, one in enumerate(shown, 1) if one.kind == "outputs"]
    unknowns = [f'      <Unknown index="{n}"/>' for n in outputs]
    period = repr(config.period_ns * 1e-9)
    about = config.title or config.rig
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(spec.name)} '
            f'guid="{token}" description={quoteattr(f"{spec.name} of {about}")} '
            'generationTool="pcpc" variableNamingConvention="flat">',
            f'  <CoSimulation modelIdentifier="{name}" canGetAndSetFMUstate="true" '
            'canSerializeFMUstate="true">',
            "    <SourceFiles>",
            *(f'      <File name="{file}"/>' for file in sources),
            "    </SourceFiles>",
            "  </CoSimulation>",
            *(
                [
                    "  <UnitDefinitions>",
                    *(f"    <Unit name={quoteattr(unit)}/>" for unit in units),
                    "  </UnitDefinitions>",
                ]
                if units
                else []
            ),
            f'  <DefaultExperiment startTime="0" stopTime="{config.duration_s!r}" '
            f'stepSize="{period}"/>',
            "  <ModelVariables>",
            *(line for one in shown for line in _variable(one)),
            "  </ModelVariables>",
            "  <ModelStructure>",
            *(["    <Outputs>", *unknowns, "    </Outputs>"] if outputs else []),
            *(["    <InitialUnknowns>", *unknowns, "    </InitialUnknowns>"] if outputs else []),
            "  </ModelStructure>",
            "</fmiModelDescription>",
            "",
        ]
    )


_CAUSALITY = {
    "parameters": 'causality="parameter" variability="tunable" initial="exact"',
    "states": 'causality="local" variability="continuous" initial="exact"',
    "inputs": 'causality="input" variability="continuous"',
    "outputs": 'causality="output" variability="continuous" initial="calculated"',
}


def _variable(one: _Value) -> Iterator[str]:
    help = quoteattr(one.port.help)
    yield (
        f'    <ScalarVariable name="{one.name}" valueReference="{one.place}" '
        f"{_CAUSALITY[one.kind]} description={help}>"
    )
    parts = []
    if unit := in_fmi(one.port.unit):
        parts.append(f" unit={quoteattr(unit)}")
    for side, value in (("min", one.port.low), ("max", one.port.high)):
        if abs(value) < float("inf") and one.kind != "states":
            parts.append(f' {side}="{value!r}"')
    if one.kind != "outputs":
        parts.append(f' start="{one.start!r}"')
    yield f"      <Real{''.join(parts)}/>"
    yield "    </ScalarVariable>"
