"""The compiled steps against C that `pcpc generate c` makes of them: the same arrays and inputs.

    Python         the block's own step, called through its function pointer as the loop calls it
    C libm         with libm's elementary functions          cc -O2
    C same         with the functions of emath.py            cc -O2 -ffp-contract=off: same bits

Inputs are those of a virtual run of the hull rig. Each measurement repeats the run's first
PERIODS control periods from the initial state, in a native loop on both sides, for ROUND_S; a round
is Python, C libm, C same. Times are processor time of the thread, ns per step.
"""

import ctypes
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.in_numba import f8, from_dtype, i8, types
from pcpc.drivers.compiled.jit import compiled
from pcpc.drivers.compiled.stage import call, part
from pcpc.executive.laws.block import Block
from pcpc.executive.laws.idle import idle
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.atb1000 import model
from pcpc.plants.atb1000.laws import nn_backstepping, pd, pd_nn_fast
from pcpc.tools.dev.bench.compiler import address, library
from pcpc.tools.dev.bench.ratio import Measurement, Ratio, interleave, processor_time
from pcpc.tools.terminal.progress import Progress

DRIVE = Path(__file__).with_name("drive.c")
RIG = Path(model.__file__).with_name("rigs") / "hull.yaml"
LAWS = {"pd": pd.BLOCK, "pd_nn_fast": pd_nn_fast.BLOCK, "nn_backstepping": nn_backstepping.BLOCK}
EMPTY = "empty step"  # the loop and the call, in all other figures too
BLOCKS = {"empty_step": Block(idle), **LAWS, "barrel": model.BLOCK}
PERIODS = 2000
ROUND_S = 0.02
PROBE = 3  # runs of the recording that tell how many fill ROUND_S

# As the loop's own record: its table `v` holds parameters, state, inputs and outputs of the step,
# which end at `at`.
TABLE = np.dtype([("v", "<f8", (1024,)), ("at", "<i8", (4,))])

Vector = NDArray[np.float64]
Drive = Callable[[int, int], None]


@dataclass(frozen=True)
class Case:
    """One step with its recorded run.

    `n`: a record of TABLE; `x0` the initial state; `inputs` (periods, inputs).
    """

    name: str
    block: Block
    dt: float
    n: Any
    x0: Vector
    inputs: Vector

    def outputs(self) -> Vector:
        """Return a view of the outputs of the last step."""
        return self.n["v"][self.n["at"][2] : self.n["at"][3]]

    def states(self) -> Vector:
        """Return a view of the state after the last step."""
        return self.n["v"][self.n["at"][0] : self.n["at"][1]]


@compiled(types.void(i8, i8, i8, f8, from_dtype(TABLE), f8[::1], f8[::1]))
def drive(step: Any, repeats: Any, periods: Any, dt: Any, n: Any, x0: Any, inputs: Any) -> None:
    """Do `periods` steps from the state `x0`, `repeats` times; `drive` of drive.c does the same."""
    v = n.v
    x, u, y = n.at[0], n.at[1], n.at[2]  # in locals, as C keeps them in registers
    for _ in range(repeats):
        for i in range(u - x):
            v[x + i] = x0[i]
        for k in range(periods):
            row = part(inputs, k * (y - u))
            call(step, k * dt, dt, part(v, 0), part(v, x), row, part(v, y))


def in_python(case: Case) -> Drive:
    """Return the compiled Python step in its loop, (repeats, periods) -> None."""
    return lambda repeats, periods: drive(
        case.block.step.entry, repeats, periods, case.dt, case.n, case.x0, case.inputs.ravel()
    )


def in_c(case: Case, c: ctypes.CDLL, function: str = "") -> Drive:
    """Return a step in C, that of the case's name, in its loop, on the same arrays as Python's."""
    step = getattr(c, function or case.name.replace(" ", "_"))
    views = [address(a) for a in (case.n["v"], case.n["at"], case.x0, case.inputs)]
    dt, call = ctypes.c_double(case.dt), c.drive
    call.restype = None
    return lambda repeats, periods: call(
        step, ctypes.c_longlong(repeats), ctypes.c_longlong(periods), dt, *views
    )


def record(controller: str, periods: int = PERIODS) -> dict[str, Case]:
    """Return the law's and the plant's step of a virtual run of the hull rig, by name."""
    duration = f"duration_s={periods / 1000.0 + 0.1}"
    rig = load_rig(RIG, controller, [duration])
    log = in_memory(rig)
    law = _case(controller, rig, "executive", "controller", log.node["executive"].columns, periods)
    plant = _case("barrel", rig, "plant", "barrel", log.node["plant"].columns, periods)
    return {controller: law, "barrel": plant}


def _case(
    name: str, rig: Any, role: Any, block_name: str, columns: Mapping[str, Vector], periods: int
) -> Case:
    made = plan(rig, role, "lockstep")
    i = [spec.name for spec in made.spec.blocks].index(block_name)
    spec, views = made.spec.blocks[i], made.views[i]
    sources = [spec.inputs[n] for port in spec.block.inputs for n in port.names()]
    groups = (views.parameters, views.states, views.inputs, views.outputs)
    n = _table([made.values.get(place, 0.0) for group in groups for place in group])
    n["at"] = np.cumsum([len(group) for group in groups])
    x0 = n["v"][n["at"][0] : n["at"][1]].copy()
    inputs = np.stack([columns[source][:periods] for source in sources], axis=1)
    dt = 1e-9 * rig.config.period_ns
    return Case(name, spec.block, dt, n, x0, inputs)


def _table(values: Sequence[float]) -> Any:
    n = np.zeros(1, TABLE)[0]
    n["v"][: len(values)] = values
    return n


def cases() -> list[Case]:
    """Return every step of the table; the plant's is that of the run with PD."""
    runs = {name: case for law in reversed(LAWS) for name, case in record(law).items()}
    n = _table([])
    n["at"] = (1, 2, 3, 4)
    nothing = Case(EMPTY, BLOCKS["empty_step"], 1e-3, n, np.zeros(1), np.zeros((PERIODS, 1)))
    return [nothing, *(runs[name] for name in LAWS), runs["barrel"]]


def c_library(libm: bool = False) -> ctypes.CDLL:
    """Return the steps of BLOCKS in C, and the loop over one; CompilerError."""
    return library([DRIVE], BLOCKS, libm=libm)


def measure(progress: Progress, rounds: int = 15) -> list[Ratio]:
    """Measure every step in `rounds` rounds of three times ROUND_S; CompilerError, RigError."""
    libraries = {"C -O2, libm": c_library(libm=True), "C -O2, the same functions": c_library()}
    progress.show("recording the inputs: three virtual runs")
    found = []
    for case in cases():
        drives = [in_python(case), *(in_c(case, c) for c in libraries.values())]
        own, *others = interleave(progress, case.name, rounds, [*map(step_time, drives)])
        for against, base in zip(libraries, others, strict=True):
            found.append(Ratio.from_rounds("steps", case.name, against, own, base, "ns"))
    return found


def step_time(drive: Drive) -> Measurement:
    """Return a measurement of a step in its loop, ns; as many runs of the recording as ROUND_S."""
    once = processor_time(lambda: drive(1, PERIODS))
    repeats = int(1e9 * ROUND_S / min(once() for _ in range(PROBE))) + 1
    return processor_time(lambda: drive(repeats, PERIODS), repeats * PERIODS)
