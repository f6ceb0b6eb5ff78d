"""Supervisor, requests and limits: what mutants are run on.

Half of the inputs are just on a limit: whole multiples of what a command may change, counters at
the edge. The copies have all mutants in them; number 0 is the code as it is.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np

from pcpc.executive.loop.clock import Time, Trigger
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.limits import limit_commands
from pcpc.executive.loop.supervisor import hear_requests, supervise
from pcpc.executive.loop.variables import DISARMED, RESET_ASKED, STOP_ASKED
from pcpc.tools.dev.evidence import expected
from pcpc.tools.dev.evidence.comparison import EVENT, Compared, Episodes, same

AT, OUTPUTS, WATCHED, ESTOP, MODE = 100, 102, 105, 106, 107  # places in the table
AWAITED, OF_PEERS = 3, 2  # frames of a cycle; those of the nodes below
SEED = 16
EPISODES, CYCLES = 200, 80
FEW = 40  # episodes of code that is not compiled


class ComparedCycle(NamedTuple):
    """What happens in a cycle."""

    k: int
    fresh: int
    fault: int
    ends: int
    reset: int
    stop: int
    arms: int  # -1: nothing is said of it
    taken: int  # what is missing, on purpose
    wishes: Annotated[list[float], "<f8", 2]
    outputs: Annotated[list[float], "<f8", 2]
    told: Annotated[list[float], "<f8", 3]  # watched input, emergency stop, state of the node above
    disarmed: float


def supervised(n: Any, given: ComparedCycle) -> None:
    """Do a cycle."""
    n.k = given.k
    n.rx.fresh = given.fresh
    n.rx.started = 1
    n.wire.muted = 1
    if n.guard.faulted == 0:
        n.guard.faulted = given.fault
    n.control.stop = max(n.control.stop, given.ends)
    for i in range(AWAITED):  # a fault on purpose took all
        n.faults.spoiled[i] = n.faults.on_wire[i].fresh = given.taken
    for i in range(3):
        if i > 0 or given.fresh > 0:
            n.v[WATCHED + i] = given.told[i]
    supervise(n)
    n.v[RESET_ASKED] = given.reset
    n.v[STOP_ASKED] = given.stop
    if given.arms >= 0:
        n.v[DISARMED] = given.disarmed
    hear_requests(n)
    for i in range(2):
        n.v[AT + i] = given.wishes[i]
        n.v[OUTPUTS + i] = given.outputs[i]
    limit_commands(n)


class Supervised(expected.SupervisorModel):
    """The supervisor, its requests and its limits."""

    age = aged = noted = 0
    event = 0, 0

    def step(self, given: ComparedCycle) -> None:
        """Do a cycle."""
        self.age, self.aged = self.age + 1, self.aged + given.taken  # that may be taken alone
        self.fault = self.fault or given.fault
        self.hosts_stop = self.hosts_stop or bool(given.ends)
        watched, pressed, state = given.told
        if given.fresh:
            self.watched = watched
        self.supervise(given.k, given.fresh, pressed, state, bool(given.taken))
        self.noted = self.fault
        self.hear(given.reset, given.stop, given.disarmed if given.arms >= 0 else None)
        self.limit(given.k, given.outputs, given.wishes, AT)
        self.event = self.events[-1] if self.events else (0, 0)


SUPERVISOR = Compared(
    ComparedCycle, supervised,
    whole={
        **same("control.held", "control.stale", "control.saturated", "control.starved",
               "control.odd_bits", "guard.reset", "guard.stop", "rx.awaited"),
        **dict.fromkeys(("rx.fresh", "rx.started", "wire.muted"), lambda m: 0),
        "control.odd_place": lambda m: m.odd[0], "control.odd_cycle": lambda m: m.odd[1],
        "control.fault": lambda m: m.told_fault, "guard.faulted": lambda m: m.fault,
        "control.state": lambda m: expected.NUMBER[m.state],
        "event_ends.head": lambda m: len(m.events),
        f"{EVENT}.code": lambda m: m.event[0], f"{EVENT}.argument": lambda m: m.event[1],
        f"{EVENT}.bits": lambda m: m.odd_bits if m.event[0] == Event.NOT_FINITE else 0,
        "rx.starters": lambda m: OF_PEERS, "rx.state[0].age_cycles": lambda m: m.age,
        "faults.missed": lambda m: m.untaken, "faults.on_wire[1].age_cycles": lambda m: m.aged,
    },
    real={
        "v[STATE]": lambda m: expected.NUMBER[m.state], "v[GAIN]": lambda m: m.gain,
        "v[MISSING]": lambda m: m.missing, "v[NMT]": lambda m: expected.HEARTBEAT[m.state],
        "v[CLAMPED]": lambda m: m.clamped, **same("guard.pace"),
        f"v[{AT}:{OUTPUTS}]": lambda m: [one.sent for one in m.commands],
        "limits.table[0].last": lambda m: m.commands[0].last,
        "limits.table[1].last": lambda m: m.commands[1].last,
        f"v[{WATCHED}]": lambda m: m.watched, "v[RESET_ASKED]": lambda m: 0,
        "v[FAULT]": lambda m: m.noted, "v[ERROR_CODE]": lambda m: list(Fault)[m.noted].code,
        "v[DISARMED]": lambda m: m.disarmed,
    },
)  # fmt: skip


def supervisor(feed: Any, draw: np.random.Generator, count: int) -> Episodes:
    """Feed supervise, hear_requests and limit_commands with `count` episodes."""
    episodes = Episodes(SUPERVISOR, feed)
    for number in range(count):
        has, commands = _settings(draw, number), _commands(draw)
        _install(episodes.new_loop(), has, commands)
        rows = episodes.new_rows(CYCLES)
        _draw_events(rows, draw, number, has)
        episodes.add(rows, Supervised(has, commands, AWAITED, OF_PEERS))
    return episodes


def _settings(draw: np.random.Generator, number: int) -> expected.Settings:
    return expected.Settings(
        hold_cycles=int(draw.integers(2, 4)), fault_after=int(draw.integers(2, 6)), ramp=0.125,
        quick=float(draw.choice([0.25, 0.5])), waits=number % 3 != 0,
        safe_start=number % 4 != 1, clocked=number % 5 != 2, cycles=int(draw.choice([40, 70, 200])),
        odd_output=int(draw.choice([8, 9])), substitute=float(draw.choice([0.0, 0.5])),
        manual=number % 7 in (3, 4),
    )  # fmt: skip


def _commands(draw: np.random.Generator) -> list[expected.BoundedSignal]:
    change = float(draw.choice([0.125, 0.25, math.inf]))
    return [
        expected.BoundedSignal(-1.0, 2.0, change, float(draw.choice([0.0, 0.25, 1.0]))),
        expected.BoundedSignal(-3.0, 3.0, float(draw.choice([0.5, 1.0, math.inf])), 0.0),
    ]


def _install(n: Any, has: expected.Settings, commands: Sequence[expected.BoundedSignal]) -> None:
    guard = n.guard
    n.clock.kind = Time.GIVEN
    n.clock.trigger = Trigger.CLOCKED if has.clocked else Trigger.ON_FRAMES
    guard.cycles, guard.hold_cycles, guard.fault_after = (
        has.cycles,
        has.hold_cycles,
        has.fault_after,
    )
    guard.ramp_step, guard.quick_step, guard.gain = has.ramp, has.quick, 1.0
    guard.manual = has.manual
    guard.waits, guard.safe_start, guard.odd_output = has.waits, has.safe_start, has.odd_output
    guard.estop_index, guard.mode_index, guard.stop_row = ESTOP, MODE, -1
    guard.n_safe, guard.safe_index[0] = 1, WATCHED
    guard.safe[0].safe = has.substitute
    n.rx.n, n.rx.starters, n.rx.awaited = 3, OF_PEERS, AWAITED
    n.rx.role[:3] = [(1, 1, 2, 0), (1, 1, 1, 0), (0, 1, 0, 0)]  # of two plants, and of a third node
    n.tx.first, n.tx.past = AT, OUTPUTS
    n.blocks.n, n.blocks.views[0].y, n.blocks.views[0].y_end = 1, OUTPUTS, OUTPUTS + 2
    n.limits.n = len(commands)
    for i, one in enumerate(commands):
        n.limits.place[i] = AT + i
        n.limits.table[i] = one.low, one.high, one.change, one.safe, one.safe, one.safe
    n.n_variables = 256


def _draw_events(
    given: Any, draw: np.random.Generator, number: int, has: expected.Settings
) -> None:
    """Draw what happens in each cycle of an episode; values on limits."""
    given.k = np.arange(CYCLES)
    bursts = np.repeat(draw.random(CYCLES // 4) < 0.2, 4)
    few = draw.integers(0, AWAITED, CYCLES)
    given.fresh = np.where(bursts | (draw.random(CYCLES) < 0.1), few, AWAITED)
    rare = draw.random((CYCLES, 4))
    given.fault = np.where(rare[:, 0] < 0.02, draw.integers(1, len(Fault), CYCLES), 0)
    given.ends = (rare[:, 1] < 0.005) * (number % 2)
    given.reset = rare[:, 2] < 0.25
    given.stop = np.where(rare[:, 3] < 0.03, draw.integers(1, 3, CYCLES), 0) * (number % 4 == 3)
    arms = np.where(draw.random(CYCLES) < 0.5, 0, 1)
    given.arms = np.where(draw.random(CYCLES) < 0.1 * (number % 7 > 2), arms, -1)
    given.taken = np.random.default_rng(number).random(CYCLES) < 0.3
    if number % 3 == 2:  # silent at the end
        given.fresh[has.cycles - 3 :] = 0
    values = draw.integers(-64, 65, (CYCLES, 7)) / 16.0
    values = np.where(draw.random((CYCLES, 7)) < 0.2, draw.normal(0.0, 1.5, (CYCLES, 7)), values)
    held = np.repeat(values[::8], 8, axis=0)
    values[:, :2] = np.where(draw.random((CYCLES, 1)) < 0.7, held[:, :2], values[:, :2])
    odd = draw.choice([math.nan, math.inf, -math.inf, 1e300, -1e300, 9.9e299, 2e300], (CYCLES, 4))
    values[:, :4] = np.where(draw.random((CYCLES, 4)) < 0.006, odd, values[:, :4])
    values[draw.random(CYCLES) < 0.003, 2:4] = math.inf
    pressed = draw.choice([1.0, -1.0, 0.5], CYCLES)
    values[:, 5] = np.where(draw.random(CYCLES) < 0.01, pressed, 0.0)
    values[:, 6] = np.where(draw.random(CYCLES) < 0.004 * (number % 3), 5.0, draw.integers(0, 5))
    given.wishes, given.outputs, given.told = values[:, :2], values[:, 2:4], values[:, 4:]
    said = draw.choice([1.0, 0.5, -0.5, 2.0], CYCLES)
    given.disarmed = np.where(given.arms > 0, said, 0.0)
