"""Both nodes of a rig over a bus in memory whose frames a test may lose, repeat or corrupt.

    plant's frames -> executive's pass, late if a test says so -> its frames -> plant's pass

The passes are the engine's own compiled `one_pass`, the nodes meet and their frames are carried as
in `executive.loop.exchange`; the clocks and what happens to frames on their way are the test's.
With pacing "sync" the executive has a clock: a missing frame does not end the run.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can.wire_layout import FRAME_BYTES, QUEUE_FRAMES
from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import i8, loop, loop_function, types, u1
from pcpc.drivers.compiled.structures import copy
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import stopping
from pcpc.executive.loop.cycle import STEPS, N, one_pass
from pcpc.executive.loop.exchange import meet, pass_on
from pcpc.executive.loop.ring_layout import RECORD_HEAD
from pcpc.executive.loop.rings import publish_table
from pcpc.executive.loop.states import STATE_NAMES
from pcpc.executive.nodes.install import install_in_memory
from pcpc.executive.nodes.plan import Plan, plan
from pcpc.executive.rig.reading import Rig

ROOT = Path(__file__).resolve().parents[2]
ATB1000 = ROOT / "plants" / "atb1000"
SLEW10 = ATB1000 / "rigs" / "slew10.yaml"

ARRIVES, LOST, CORRUPT, TWICE, SHORT = range(5)  # what can happen to a frame
BOTH = types.UniTuple(N, 2)
PLANT_LAG_NS = 200_000  # the plant's pass behind the executive's
MEET, ALONE, CLOSED = range(3)  # what `_drive` does: with both, the first alone, the closed loop
_NONE, _ROOM = np.zeros(0, np.int64), np.zeros((QUEUE_FRAMES, FRAME_BYTES), np.uint8)

PUPPET = """\
from pcpc.executive.laws.block import Block, Ports, port, stage
from pcpc.plants.atb1000.laws import pd


class Settings(Ports):
    torque_Nm = port("N m", "what is sent as the motor's torque", 0.0, -1e9, 1e9)
    other_Nm = port("N m", "what is sent as the output's torque", 0.0, -1e9, 1e9)


class States(Ports):
    steps = port("", "how often it was stepped")


@stage
def step(t: float, dt: float, p: Settings, x: States, u: pd.Inputs, y: pd.Outputs) -> None:
    y.motor_torque_Nm = p.torque_Nm
    y.tau_Nm = p.other_Nm
    y.e_rad = u.q_d_rad
    y.r_rad_s = 0.0
    x.steps += 1.0


BLOCK = Block(step)
"""


@loop_function
def _disturb(end: Any, ids: Any, fates: Any, kept: Any) -> None:
    """Let frame `ids[i]` of the outbox meet `fates[i]`; `kept` is room for a queue."""
    count = np.int64(0)
    for k in range(end.outbox_put):
        fate = np.int64(0)
        for i in range(ids.shape[0]):
            if np.int64(end.outbox[k, 0]) | np.int64(end.outbox[k, 1]) << 8 == ids[i]:
                fate = np.int64(fates[i])
        for _ in range(0 if fate == 1 else 2 if fate == 3 else 1):
            copy(kept[count], end.outbox[k])
            if fate == 2:
                kept[count, 9] ^= 16
            if fate == 4:
                kept[count, 4] = 7
            count += 1
    for k in range(count):
        copy(end.outbox[k], kept[k])
    end.outbox_put = count


@loop(i8(i8, BOTH, types.UniTuple(STEPS, 2), i8[::1], u1[:, ::1], i8[::1], i8[::1], u1[:, ::1]))
def _drive(
    work: Any, nodes: Any, steps: Any, ids: Any, fates: Any, late: Any, alive: Any, kept: Any
) -> Any:
    """Let the nodes meet, or do a cycle for each row of `fates`; return how many the first did.

    One function for all kinds of work: each further one is the whole loop, compiled again. It
    allocates nothing: what does is compiled twice.
    """
    executive, plant = nodes
    if work == MEET:
        meet(nodes)
        return 0
    for c in range(fates.shape[0]):
        if work == CLOSED:
            _disturb(plant.wire, ids, fates[c], kept)
            pass_on(nodes, 1)
            executive.clock.now_ns = max(executive.clock.now_ns, executive.clock.deadline) + late[c]
        if not one_pass(executive, steps[0]):
            alive[0] = 0
            return c
        if work == CLOSED:
            _disturb(executive.wire, ids, fates[c], kept)
            pass_on(nodes, 0)
            plant.clock.now_ns = executive.clock.now_ns + PLANT_LAG_NS
            if alive[1] != 0 and not one_pass(plant, steps[1]):
                alive[1] = 0
    return fates.shape[0]


@loop(i8(N, i8))
def write_until_stopped(n: Any, burst: Any) -> Any:
    """Publish 1, 2, 3, ... in all variables; return how often.

    After each `burst` of them, if that is not 0, wait until a reader has put the last into `mail`.
    """
    k = 0
    while not stopping(n):
        k += 1
        for i in range(n.n_variables):
            n.v[i] = k
        publish_table(n)
        for _ in range(100 if burst > 0 else 0):  # a reader begins to copy here
            libc.clock_gettime(libc.CLOCK_MONOTONIC, libc.address(n.clock.timespec))
        while burst > 0 and k % burst == 0 and n.mail.request < k and not stopping(n):
            libc.sched_yield()
    return k


def puppet_rig(folder: Path, *lines: str) -> Path:
    """Write a rig outside of the project whose controller sends what its parameters say."""
    (folder / "puppet.py").write_text(PUPPET)
    path = folder / "puppet.yaml"
    head = (
        f"base: {SLEW10}",
        "rig: puppet",
        "controller: puppet",
        "controllers: {puppet: {law: puppet.py}}",
    )
    path.write_text("\n".join([*head, *lines]) + "\n")
    return path


def zeroed() -> Any:
    """Return an empty LOOP record in this process's own memory."""
    scratch = np.recarray(1, sh.LOOP)
    scratch.view(np.uint8)[:] = 0
    return scratch[0]


def both(rig: Rig, pacing: str = "sync") -> tuple[Plan, Plan]:
    """Return the plans of executive and plant."""
    return plan(rig, "executive", pacing), plan(rig, "plant", pacing)


def _alive() -> NDArray[np.int64]:
    """Return what `_drive` notes of two nodes that have not ended."""
    return np.ones(2, np.int64)


class Node:
    """One node of a rig: its plan and its LOOP record (zeroed, an own one if not given)."""

    def __init__(self, made: Plan, loop: Any = None) -> None:
        self.plan = made
        self.loop = zeroed() if loop is None else loop
        install_in_memory(made, self.loop)
        self.frames = {f.name: f.can_id for f in (*made.rx_frames, *made.tx_frames)}

    def place(self, name: str) -> int:
        """Return the place of a variable in the table."""
        return self.plan.table.index[name]

    def __getitem__(self, name: str) -> float:
        return float(self.loop.v[self.place(name)])

    def __setitem__(self, name: str, value: float) -> None:
        self.loop.v[self.place(name)] = value

    @property
    def state(self) -> str:
        """Name of the supervisor's state."""
        return STATE_NAMES[int(self["supervisor.state"])]

    def count(self, word: int) -> int:
        """Return one word of `control`."""
        return int(self.loop.control[word])

    def events(self, code: int) -> list[tuple[int, int, float]]:
        """Return (cycle, argument, value) of all events with this code."""
        rows = self.loop.event[: int(self.loop.event_ends.head)]
        rows = rows[rows["code"] == code]
        columns = rows["cycle"], rows["argument"], rows["bits"].view(np.float64)
        return [*zip(*(one.tolist() for one in columns), strict=True)]

    def records(self) -> NDArray[np.int64]:
        """Return the rows of the record ring that nobody has taken, oldest first."""
        columns = RECORD_HEAD + int(self.loop.rings.n_state) + 1 + int(self.loop.rings.n_timing)
        rows = int(self.loop.rings.record_rows)
        ring = self.loop.record[: rows * columns].reshape(rows, columns)
        return ring[
            np.arange(int(self.loop.record_taken[0]), int(self.loop.record_ends.head)) % rows
        ]

    def series(self, name: str) -> NDArray[np.float64]:
        """Return the recorded values of a state or timing variable, a value a pass."""
        state, timing = self.plan.columns(False), self.plan.columns(True)
        place = self.place(name)
        at = RECORD_HEAD + (
            state.index(place) if place in state else len(state) + 1 + timing.index(place)
        )
        return self.records()[:, at].copy().view(np.float64)

    def post(self, values: Mapping[str, float]) -> None:
        """Ask for tunings, as the host does."""
        n = self.loop
        for i, (name, value) in enumerate(values.items()):
            n.mail_index[i], n.mail_value[i] = self.place(name), value
        n.mail.count = len(values)
        n.mail.request += 1

    def go(self, passes: int = 1) -> int:
        """Do passes of this node alone; return how many it did."""
        fates, steps = np.zeros((passes, 0), np.uint8), (self.plan.steps,) * 2
        return int(_drive(ALONE, (self.loop,) * 2, steps, _NONE, fates, _NONE, _alive(), _ROOM))


class Bench:
    """Executive (in `block`, if given) and plant, and the bus between them."""

    def __init__(self, plans: tuple[Plan, Plan], block: sh.NodeMemory | None = None) -> None:
        self.executive = Node(plans[0], None if block is None else block.loop)
        self.plant = Node(plans[1])
        self.frames = self.executive.frames | self.plant.frames
        self.alive = _alive()
        nodes, steps = (self.executive.loop, self.plant.loop), (plans[0].steps, plans[1].steps)
        _drive(MEET, nodes, steps, _NONE, np.zeros((0, 0), np.uint8), _NONE, self.alive, _ROOM)
        self.plant.go()

    def run(
        self, cycles: int, fates: Mapping[str, int] | None = None, late_ns: Sequence[int] = ()
    ) -> int:
        """Do cycles in which the frames named in `fates` meet their fate; return how many."""
        table = np.zeros((cycles, len(self.frames)), np.uint8)
        for name, fate in (fates or {}).items():
            table[:, list(self.frames).index(name)] = fate
        return self.run_table(table, late_ns)

    def run_table(self, table: NDArray[np.uint8], late_ns: Sequence[int] = ()) -> int:
        """Do a cycle for each row of `table` (cycles, frames): the fate of each frame in it."""
        late = np.zeros(len(table), np.int64)
        late[: len(late_ns)] = late_ns
        a, b = self.executive, self.plant
        ids = np.array(list(self.frames.values()), np.int64)
        steps = (a.plan.steps, b.plan.steps)
        return int(_drive(CLOSED, (a.loop, b.loop), steps, ids, table, late, self.alive, _ROOM))
