"""The envelope of a command: no law, no fault and no request takes it out of it.

Runs of `envelope.yaml` from their first cycle on, each with another law, faults and requests at
drawn cycles. A law is 64 answers in turn and a gain on the position: numbers, NaN, infinities,
1e300, both zeros, the smallest number there is, limits in turn. In every cycle of the executive:

    range    LOW <= sent <= HIGH, finite
    rate     no more than RATE a cycle
    safe     SAFE in INIT; in FAULT never away from SAFE; SAFE where the run ended,
               unless nobody is heard any more: without a clock nobody waits for its ramp then

The plant is driven by what was sent, to the quantum of the frame, or by its own safe value.
"""

import math
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.loop.states import STATE_NAMES, State
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.dev.evidence.any_law import COUNT
from pcpc.tools.dev.evidence.campaign import Bench
from pcpc.tools.start.pool import each
from pcpc.tools.terminal.progress import Progress

RIG = Path(__file__).with_name("envelope.yaml")
LOW, HIGH, SAFE, RATE, QUANTUM = -1.0, 2.0, 0.25, 0.125, 1e-6
CYCLES, AT_ONCE = 160, 500
ODD = (math.nan, math.inf, -math.inf, 1e300, -1e300, 9.9e299, 1.7e308, 0.0, -0.0, 5e-324, -5e-324,
       LOW, HIGH, math.nextafter(HIGH, 9.0), math.nextafter(LOW, -9.0), 1e6, -1e6)  # fmt: skip
RESET = "supervisor.reset"
REQUESTS = {"executive:supervisor.stop": (1.0, 2.0), RESET: (1.0,)}
Event = tuple[int, str, float]


class Law(NamedTuple):
    """What a run is made of."""

    answers: Sequence[float]
    gain: float
    events: Sequence[Event]
    seed: int = 1


@cache
def bench() -> Bench:
    """Return this process' rig, before its first cycle."""
    return Bench(load_rig(RIG), warm=0)


def faults() -> list[str]:
    """Return the names of the rig's faults."""
    return [*load_rig(RIG).config.faults]


def drawn_law(seed: int, known: Sequence[str]) -> Law:
    """Return a law, faults and requests."""
    draw = np.random.default_rng(seed)
    kind, plain = int(draw.integers(5)), draw.uniform(-3.0, 3.0, COUNT)
    odd = draw.choice(ODD, COUNT)
    answers = (
        plain,
        np.where(draw.random(COUNT) < draw.choice([0.02, 0.2, 1.0]), odd, plain),
        np.where(np.arange(COUNT) % draw.integers(2, 9) == 0, odd[0], odd[1]),  # in turn
        np.cumsum(0.1 * plain),
        np.full(COUNT, odd[0]),
    )[kind]
    gain = float(draw.choice([0.0, 0.0, -1.0, 50.0, -1e300, 5e-324]))
    events: list[Event] = []
    for at in draw.integers(1, CYCLES, int(draw.integers(0, 8))).tolist():
        name = str(draw.choice([*known, *REQUESTS, RESET, RESET, RESET]))
        if name in REQUESTS:
            events.append((at, name, float(draw.choice(REQUESTS[name]))))
        else:
            events.append((at, f"fault.{name}.left", float(draw.integers(1, 30))))
    return Law(answers.tolist(), gain, events, seed)


def run(law: Law) -> list[str]:
    """Do a run; return what left the envelope."""
    one = bench()
    one.restore()
    n, places = one.loops[0], one.places[0]
    first = places["controller.answers_0"]
    n.v[first : first + COUNT] = law.answers
    n.v[places["controller.gain"]] = law.gain
    one.schedule(law.events, law.seed)
    one.advance(CYCLES)
    state = one.column(0, "supervisor.state")
    found = [*commands(one.rows(0)[:, 0], state, one.column(0, "tx.CMD.command"))]
    heard = n.guard.missing < n.guard.fault_after
    if heard and n.control.state == State.STOP and n.v[places["tx.CMD.command"]] != SAFE:
        found.append("not safe at the end")
    driven = one.column(1, "rx.CMD.command")
    if not ((driven >= LOW - QUANTUM) & (driven <= HIGH + QUANTUM)).all():
        found.append("the plant was driven by what is beyond the bounds")
    return found


def commands(cycle: NDArray[Any], state: NDArray[Any], sent: NDArray[Any]) -> Iterator[str]:
    """Yield which promise about the commands of a run is broken."""
    if not ((sent >= LOW) & (sent <= HIGH)).all():  # NaN is not
        yield "range"
    steps = np.abs(np.diff(sent, prepend=SAFE))
    if (steps > RATE * np.diff(cycle, prepend=-1) * (1.0 + 1e-12)).any():
        yield "rate"
    away = np.abs(sent - SAFE)
    if (away[state == State.INIT] != 0.0).any():
        yield "not safe in INIT"
    faulty = (state[1:] == State.FAULT) & (state[:-1] == State.FAULT)
    if (np.diff(away)[faulty] > 1e-12).any():
        yield "away from safe in FAULT"


def envelope(laws: int, seed: int, progress: Progress, jobs: int | None) -> dict[str, Any]:
    """Return how many of so many runs left their envelope, and what they met."""
    tasks = [
        (first, min(first + AT_ONCE, seed + laws)) for first in range(seed, seed + laws, AT_ONCE)
    ]
    found = each(runs_of, tasks, progress, jobs, lambda task: task[1] - task[0])
    met = np.sum([one["met"] for one in found], axis=0)
    broken = {seed: wrong for one in found for seed, wrong in one["broken"].items()}
    return {"laws": laws, "broken": broken,
            "met": dict(zip(STATE_NAMES, met.tolist(), strict=True)),
            "kept": not broken and bool((met > 0).all())}  # fmt: skip


def runs_of(task: tuple[int, int]) -> dict[str, Any]:
    """Return how many runs from one seed to another left their envelope, and what they met."""
    known, broken, met = faults(), dict[str, list[str]](), np.zeros(len(STATE_NAMES), np.int64)
    for seed in range(*task):
        if wrong := run(drawn_law(seed, known)):
            broken[str(seed)] = wrong
        met += np.isin(np.arange(len(met)), bench().column(0, "supervisor.state"))
        met[State.STOP] += bench().loops[0].control.state == State.STOP
    return {"runs": task[1] - task[0], "broken": broken, "met": met.tolist()}
