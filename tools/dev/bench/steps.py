"""The compiled steps against plain C: `steps.c` built twice, the same arrays, the same inputs.

    Python         the block's own step, called through its function pointer as the loop calls it
    C libm         steps.c as it is                          cc -O2
    C same         steps.c with the functions of emath.py    cc -O2 -ffp-contract=off: same bits

Inputs are those of a virtual run of the hull rig. Each measurement repeats the run's first
PERIODS control periods from the initial state, in a native loop on both sides, for ROUND_S; a round
is Python, C libm, C same. Times are processor time of the thread, ns per step.
"""

import ctypes
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.jit import VIEW, compiled, f8, from_dtype, i8, types
from pcpc.drivers.stage import ENTRY, call, part
from pcpc.executive.laws.block import Block, Port
from pcpc.executive.laws.idle import idle
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.atb1000 import model
from pcpc.plants.atb1000.laws import (
    boundary_layer,
    nn_backstepping,
    pd,
    pd_nn_fast,
    tracking_network,
)
from pcpc.plants.atb1000.ports import HULL_COMPONENTS, Motion
from pcpc.tools.dev.bench.c_library import library
from pcpc.tools.dev.bench.cli import Ratio
from pcpc.tools.machine.jitter.compiler import CompilerError as CompilerError
from pcpc.tools.terminal.progress import Progress

SOURCE = Path(__file__).with_name("steps.c")
RIG = Path(model.__file__).with_name("rigs") / "hull.yaml"
LAWS = ("pd", "pd_nn_fast", "nn_backstepping")
UNRECORDED = {"w", "v", "w2", "v2", "rng"}  # states that C has too; scratch it has on its stack
EMPTY = "empty step"  # the loop and the call, in all other figures too
PERIODS = 2000
ROUNDS = 15
ROUND_S = 0.02
PROBE = 3  # runs of the recording that tell how many fill ROUND_S

LIBM = ("-O2",)
SAME = ("-O2", "-ffp-contract=off", "-DPORTABLE_MATH")

# As the loop's own record: its table `v` holds parameters, state, inputs and outputs of the step,
# which end at `at`.
TABLE = np.dtype([("v", "<f8", (1024,)), ("at", "<i8", (4,))])

Vector = NDArray[np.float64]
Drive = Callable[[int, int], None]


@dataclass(frozen=True)
class Case:
    """One step with its recorded run.

    `n`: a record of TABLE; `x0` the initial state; `inputs` (periods, inputs); `function` its name
    in steps.c.
    """

    name: str
    function: str
    step: Any
    block: Block | None
    dt: float
    n: Any
    x0: Vector
    inputs: Vector

    def outputs(self) -> Vector:
        """Return a view of the outputs of the last step."""
        return self.n["v"][self.n["at"][2] : self.n["at"][3]]

    def state(self) -> Vector:
        """Return a copy of the state after the last step, without scratch space."""
        ports = self.block.states if self.block else ()
        kept = [
            port.recorded or port.name in UNRECORDED for port in ports for _ in range(port.size)
        ]
        return self.n["v"][self.n["at"][0] : self.n["at"][1]][np.array(kept, bool)]


@compiled(types.void(ENTRY, i8, i8, f8, from_dtype(TABLE), VIEW, VIEW))
def drive(step: Any, repeats: Any, periods: Any, dt: Any, n: Any, x0: Any, inputs: Any) -> None:
    """Do `periods` steps from the state `x0`, `repeats` times; `drive` of steps.c does the same."""
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
        case.step.entry, repeats, periods, case.dt, case.n, case.x0, case.inputs.ravel()
    )


def in_c(case: Case, library: ctypes.CDLL) -> Drive:
    """Return the step of a build of steps.c in its loop, on the same arrays as Python's."""
    step = ctypes.cast(getattr(library, case.function), ctypes.c_void_p)
    views = [
        ctypes.c_void_p(a.ctypes.data) for a in (case.n["v"], case.n["at"], case.x0, case.inputs)
    ]
    dt = ctypes.c_double(case.dt)
    call = library.drive
    call.restype = None
    return lambda repeats, periods: call(
        step, ctypes.c_longlong(repeats), ctypes.c_longlong(periods), dt, *views
    )


# The recorded runs


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
    dt = 1e-9 * round(1e9 / rig.config.rate_hz)
    return Case(name, name, spec.block.step, spec.block, dt, n, x0, inputs)


def _table(values: Sequence[float]) -> Any:
    n = np.zeros(1, TABLE)[0]
    n["v"][: len(values)] = values
    return n


def cases() -> list[Case]:
    """Return every step of the table; the plant's is that of the run with PD."""
    runs = {name: case for law in reversed(LAWS) for name, case in record(law).items()}
    n = _table([])
    n["at"] = (1, 2, 3, 4)
    nothing = Case(EMPTY, "idle", idle, None, 1e-3, n, np.zeros(1), np.zeros((PERIODS, 1)))
    return [nothing, *(runs[name] for name in LAWS), runs["barrel"]]


# The C side


def build(flags: Sequence[str]) -> ctypes.CDLL:
    """Return steps.c compiled with `flags`; CompilerError."""
    return library([SOURCE], flags, {"layout.h": layout()})


def layout() -> str:
    """Return layout.h: the ports of the blocks as structs of doubles, and the views' sizes."""
    inner, outer, plant = nn_backstepping.BLOCK, pd_nn_fast.BLOCK, model.BLOCK
    split = _ports_within(plant.states, Motion.size)
    groups: dict[str, Sequence[Port]] = {
        "pd_parameters": pd.Gains.ports,
        "pd_inputs": pd.Inputs.ports,
        "pd_outputs": pd.Outputs.ports,
        "network_parameters": tracking_network.Parameters.ports,
        "network_states": tracking_network.States.ports,
        "network_outputs": tracking_network.Outputs.ports,
        "fast_parameters": boundary_layer.Parameters.ports,
        "fast_states": boundary_layer.States.ports,
        "fast_inputs": boundary_layer.Inputs.ports,
        "inner_parameters": inner.parameters[len(outer.parameters) :],
        "inner_states": inner.states[len(outer.states) :],
        "inner_inputs": inner.inputs[len(outer.inputs) :],
        "inner_outputs": inner.outputs[len(outer.outputs) :],
        "motion": plant.states[:split],
        "barrel_rest": plant.states[split:],
        "barrel_parameters": plant.parameters,
        "barrel_outputs": plant.outputs,
    }
    lines = [_struct(name, ports) for name, ports in groups.items()]
    for name, block in (("pd_nn_fast", outer), ("nn_backstepping", inner), ("barrel", plant)):
        for view in ("parameters", "states", "inputs", "outputs"):
            size = block.size(getattr(block, view))
            lines.append(f"#define {name.upper()}_{view.upper()} {size}")
    return "\n".join([*lines, f"#define HULL_COMPONENTS {HULL_COMPONENTS}", ""])


def _struct(name: str, ports: Sequence[Port]) -> str:
    members = [f"{p.name}[{p.size}]" if p.size > 1 else p.name for p in ports]
    return f"struct {name} {{ double {', '.join(members)}; }};"


def _ports_within(ports: Sequence[Port], size: int) -> int:
    """Return how many leading ports have `size` elements together."""
    return int(np.cumsum([port.size for port in ports]).tolist().index(size)) + 1


# The table


def measure(progress: Progress, rounds: int = ROUNDS) -> list[Ratio]:
    """Measure every step in `rounds` rounds of three times ROUND_S; CompilerError, RigError."""
    libraries = {"C -O2, libm": build(LIBM), "C -O2, the same functions": build(SAME)}
    progress.show("recording the inputs: three virtual runs")
    found = []
    for case in cases():
        drives = [in_python(case), *(in_c(case, library) for library in libraries.values())]
        repeats = [repeats_of(once) for once in drives]
        times = np.empty((rounds, len(drives)))
        for i in range(rounds):
            progress.show(f"{case.name}: round {i + 1} of {rounds}")
            for j, once in enumerate(drives):
                times[i, j] = 1e9 * time_s(once, repeats[j]) / (repeats[j] * PERIODS)
        for j, against in enumerate(libraries, 1):
            found.append(Ratio.of("steps", case.name, against, times[:, 0], times[:, j], "ns"))
    return found


def time_s(once: Drive, repeats: int) -> float:
    """Return the processor time of so many runs of the recording."""
    start = time.thread_time_ns()
    once(repeats, PERIODS)
    return 1e-9 * (time.thread_time_ns() - start)


def repeats_of(once: Drive) -> int:
    """Return how often the recording must be run for ROUND_S; also warms up."""
    shortest = min(time_s(once, 1) for _ in range(PROBE))
    return int(ROUND_S / shortest) + 1
