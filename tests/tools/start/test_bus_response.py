"""Response times on a CAN bus: as published, and against simulations of arbitration."""

import heapq
import math
import random
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import pytest

from pcpc.drivers.can.frame_bits import classic_bits, transmission_ns
from pcpc.tools.start.bus.phase_bounds import QueuedFrame, Wire, bounds_ns
from pcpc.tools.start.bus.response import Message, responses_ns

MS = 1_000_000

# Davis et al. 2007, table 1: seven bytes each, 125 kbit/s; deadlines 2.5, 3.25, 3.25 ms.
BIT_NS = 8000
SEVEN_BYTES_NS = transmission_ns(7, False, 125e3, None)
A, B, C = (Message(SEVEN_BYTES_NS, period) for period in (5 * MS // 2, 7 * MS // 2, 7 * MS // 2))


def test_the_three_messages_of_the_paper_have_its_response_times() -> None:
    """C is schedulable by its first instance, 3 ms, and misses 3.25 ms by its second one."""
    assert SEVEN_BYTES_NS == MS
    assert responses_ns([A, B, C], BIT_NS) == [2 * MS, 3 * MS, 7 * MS // 2]
    alone = Message(C.transmission_ns, 7 * MS)  # no second instance in the busy period
    assert responses_ns([A, B, alone], BIT_NS)[2] == 3 * MS


def test_the_lowest_frame_waits_for_no_lower_one_and_the_highest_for_one() -> None:
    long, short = Message(135_000, 10 * MS), Message(55_000, 10 * MS)
    assert responses_ns([short], 1000) == [55_000]
    assert responses_ns([short, long], 1000) == [190_000, 190_000]
    assert responses_ns([long, short], 1000) == [190_000, 190_000]


# ----------------------------------------------------------------------------- against a simulation


def simulated(
    messages: Sequence[Message], queued: Sequence[Sequence[tuple[int, int]]], busy_ns: int = 0
) -> list[int]:
    """Return the longest times from event to end of transmission, on a bus busy until `busy_ns`.

    `queued` gives (time of queueing, of the event before it) for each instance of each message.
    The bus takes the most urgent of what waits whenever it is idle.
    """
    coming = sorted((at, m, event) for m, times in enumerate(queued) for at, event in times)
    waiting: list[tuple[int, int, int]] = []
    longest, now = [0] * len(messages), busy_ns
    while coming or waiting:
        if not waiting:
            now = max(now, coming[0][0])
        while coming and coming[0][0] <= now:
            at, m, event = coming.pop(0)
            heapq.heappush(waiting, (m, at, event))
        m, _, event = heapq.heappop(waiting)
        now += messages[m].transmission_ns
        longest[m] = max(longest[m], now - event)
    return longest


def drawn(draw: random.Random) -> list[Message]:
    """Return messages with a load between 40 and 97 %, jitter up to a period, some in bursts."""
    while True:
        messages = [
            Message(
                1000 * classic_bits(draw.randrange(9)),
                period := draw.choice([500, 700, 1000, 2000, 3100, 5000]) * 1000,
                draw.choice([0, 0, draw.randrange(period)]),
                count=draw.choice([1, 1, 1, 2, 5]),
            )
            for _ in range(draw.randint(2, 8))
        ]
        if 0.4 < math.fsum(k.burst_ns / k.period_ns for k in messages) < 0.97:
            return messages


@pytest.mark.parametrize("seed", range(40))
def test_no_simulated_frame_takes_longer_than_its_response_time(seed: int) -> None:
    draw = random.Random(seed)
    messages = drawn(draw)
    bound = responses_ns(messages, 1000)
    for _ in range(10):
        queued = []
        for k in messages:
            first = draw.choice([0, draw.randrange(k.period_ns)])
            events = range(first, first + 20 * MS, k.period_ns)
            queued.append([(e + draw.choice([0, k.jitter_ns]), e) for e in events] * k.count)
        for m, longest in enumerate(simulated(messages, queued)):
            most = bound[m]
            assert most is None or longest <= most, f"{messages[m]}: {longest} ns, bound {most} ns"


@pytest.mark.parametrize("seed", range(40))
def test_the_response_time_is_reached_at_the_critical_instant(seed: int) -> None:
    """All are queued as the longest lower frame has just begun, the first of each late by its J."""
    messages = drawn(random.Random(seed))
    for m, bound in enumerate(responses_ns(messages, 1)):
        blocking = max((k.transmission_ns for k in messages[m + 1 :]), default=0)
        events = [range(-k.jitter_ns, 30 * MS, k.period_ns) for k in messages[: m + 1]]
        pairs = zip(events, messages, strict=False)
        queued = [[(max(e, 0), e) for e in times] * k.count for times, k in pairs]
        reached = simulated(messages[: m + 1], queued, blocking)[m]
        assert reached == bound, f"{m} of {messages}: {reached} ns reached, bound {bound} ns"


@pytest.mark.parametrize("seed", range(10))
def test_slower_bits_more_jitter_and_errors_only_lengthen_responses(seed: int) -> None:
    messages = drawn(random.Random(seed))

    def told(factor: float, jitter_ns: int, error_every_ns: int) -> list[float]:
        changed = [
            replace(
                k,
                transmission_ns=round(factor * k.transmission_ns),
                jitter_ns=k.jitter_ns + jitter_ns,
            )
            for k in messages
        ]
        found = responses_ns(changed, round(1000 * factor), error_every_ns)
        return [math.inf if ns is None else ns for ns in found]

    chain = [told(0.9, 0, 0), told(1.0, 0, 0), told(1.0, 0, 50 * MS), told(1.0, 0, 5 * MS),
             told(1.0, 50_000, 5 * MS), told(1.1, 50_000, 5 * MS)]  # fmt: skip
    for shorter, longer in pairwise(chain):
        assert all(a <= b for a, b in zip(shorter, longer, strict=True)), (shorter, longer)
    assert chain[0] < chain[-1]


def test_an_error_costs_its_frame_and_the_transmission_anew() -> None:
    """31 bits of error frame, then the longest frame that it can have hit, once in 100 ms."""
    alone = Message(100_000, 10 * MS)
    assert responses_ns([alone], 1000, 100 * MS) == [100_000 + 31_000 + 100_000]


def test_without_a_bound_there_is_no_number() -> None:
    half = Message(500, 1000)
    assert responses_ns([half, half, half], 1) == [1000, None, None]
    assert responses_ns([Message(100, 1000)], 1, 100) == [None], "errors alone fill the bus"


# --------------------------------------------------------- phases that are kept, queues in order


CYCLE_NS = 1_000_000


def arranged(draw: random.Random) -> list[QueuedFrame]:
    """Return frames of up to three nodes, of every cycle or slower, with a load up to 80 %."""
    phases = {"A": 0, "B": draw.randrange(CYCLE_NS), "C": draw.randrange(CYCLE_NS)}
    jitter = {node: draw.choice([0, draw.randrange(200_000)]) for node in phases}
    while True:
        nodes = [draw.choice("AABBC") for _ in range(draw.randint(2, 9))]
        places = draw.sample(range(len(nodes)), len(nodes))
        frames = [
            QueuedFrame(
                1000 * classic_bits(draw.randrange(9)),
                CYCLE_NS * draw.choice([1, 1, 3, 10]),
                jitter[node],
                node,
                phases[node],
                place,
                count=draw.choice([1, 1, 1, 3]),
            )
            for node, place in zip(nodes, places, strict=True)
        ]
        if math.fsum(k.burst_ns / k.period_ns for k in frames) < 0.8:
            return frames


def sent_by_nodes(
    frames: Sequence[QueuedFrame], in_order: bool, cycles: int, draw: random.Random
) -> list[int]:
    """Return the longest times of a simulation in which each node has a queue of its own."""
    coming = []
    begins = {k.node: draw.choice([0, 0, 1]) for k in frames}  # cycle in which a node starts
    slow = [draw.randrange(k.period_ns // CYCLE_NS) for k in frames]
    for cycle in range(cycles):
        late = {k.node: draw.choice([0, k.jitter_ns]) for k in frames}
        for m, k in enumerate(frames):
            if cycle >= begins[k.node] and cycle % (k.period_ns // CYCLE_NS) == slow[m]:
                due = cycle * CYCLE_NS + (k.phase_ns or 0)
                coming += [(due + late[k.node], k.place, m, due)] * k.count
    coming.sort()
    queues: dict[str, list[tuple[int, int]]] = {k.node: [] for k in frames}
    longest, now = [0] * len(frames), 0
    while coming or any(queues.values()):
        if not any(queues.values()):
            now = max(now, coming[0][0])
        while coming and coming[0][0] <= now:
            _, _, m, due = coming.pop(0)
            queues[frames[m].node].append((m, due))
        heads = [queue[0] if in_order else min(queue) for queue in queues.values() if queue]
        m, due = min(heads)
        queues[frames[m].node].remove((m, due))
        now += frames[m].transmission_ns
        longest[m] = max(longest[m], now - due)
    return longest


@pytest.mark.parametrize("in_order", [False, True], ids=["by priority", "in order"])
@pytest.mark.parametrize("kept", [False, True], ids=["any phase", "kept"])
@pytest.mark.parametrize("seed", range(30))
def test_no_simulated_frame_of_a_node_takes_longer_than_its_bound(
    seed: int, kept: bool, in_order: bool
) -> None:
    draw = random.Random(seed)
    frames = arranged(draw)
    given = frames if kept else [replace(k, phase_ns=None) for k in frames]
    bounds = bounds_ns(given, Wire(1000, CYCLE_NS, 0, in_order))
    for _ in range(20):
        for m, longest in enumerate(sent_by_nodes(frames, in_order, 24, draw)):
            most = bounds[m]
            assert most is None or longest <= most, f"{frames[m]}: {longest} ns, bound {most} ns"


def test_a_slow_frame_that_outlasts_its_cycle_is_ahead_of_the_next_ones() -> None:
    """The last of A's queue can wait beyond a cycle; a bound without that was found to be wrong."""
    lengths = [
        (135, "A", 1), (85, "A", 3), (135, "A", 1), (75, "B", 1), (125, "A", 1), (95, "B", 3),
        (135, "A", 3), (85, "A", 1), (85, "A", 1), (85, "A", 1),
    ]  # fmt: skip
    frames = [
        QueuedFrame(1000 * us, n * CYCLE_NS, 0, node, {"A": 0, "B": 359_878}[node], 10 * n + m)
        for m, (us, node, n) in enumerate(lengths)
    ]
    bounds = bounds_ns(frames, Wire(1000, CYCLE_NS, 0, in_order=True))
    draw = random.Random(1)
    reached = [
        max(longest)
        for longest in zip(*(sent_by_nodes(frames, True, 24, draw) for _ in range(50)), strict=True)
    ]
    assert reached[6] > CYCLE_NS, reached
    assert all(b is None or ns <= b for ns, b in zip(reached, bounds, strict=True)), reached


@pytest.mark.parametrize("in_order", [False, True], ids=["by priority", "in order"])
def test_the_bounds_of_a_small_rig_are_reached(in_order: bool) -> None:
    """SYNC, command and heartbeat at 0, feedback and heartbeat at half a cycle."""
    lengths = (
        (75, "A", 1, 2),
        (135, "A", 1, 1),
        (135, "B", 1, 1),
        (65, "A", 9, 0),
        (65, "B", 9, 0),
    )
    frames = [
        QueuedFrame(1000 * us, CYCLE_NS * n, 0, node, 0 if node == "A" else CYCLE_NS // 2, place)
        for us, node, n, place in lengths
    ]
    bounds = bounds_ns(frames, Wire(1000, CYCLE_NS, 0, in_order))
    reached = sent_by_nodes(frames, in_order, 100, random.Random(1))
    if in_order:
        assert bounds == reached == [275_000, 200_000, 200_000, 65_000, 65_000]
    else:  # a frame may have begun when the more urgent ones are queued, just behind it
        assert bounds == [210_000, 275_000, 200_000, 275_000, 200_000]
        assert reached == [75_000, 210_000, 135_000, 275_000, 200_000]


def test_an_error_costs_the_same_in_a_bound() -> None:
    alone = QueuedFrame(100_000, 10 * MS, 0, "A", 0)
    assert bounds_ns([alone], Wire(1000, CYCLE_NS, 100 * MS)) == [100_000 + 31_000 + 100_000]
    first, longer = replace(alone, place=1), replace(alone, transmission_ns=130_000)
    wire = Wire(1000, CYCLE_NS, 100 * MS, in_order=True)
    assert bounds_ns([first, longer], wire) == [230_000 + 31_000 + 130_000, 130_000 + 161_000]


@pytest.mark.parametrize("seed", range(20))
def test_phases_that_are_kept_and_urgent_frames_first_are_never_worse(seed: int) -> None:
    frames = arranged(random.Random(seed))

    def told(phases: bool, in_order: bool) -> list[float]:
        given = frames if phases else [replace(k, phase_ns=None) for k in frames]
        found = bounds_ns(given, Wire(1000, CYCLE_NS, 0, in_order))
        return [math.inf if ns is None else ns for ns in found]

    for in_order in (False, True):
        both = zip(told(True, in_order), told(False, in_order), strict=True)
        assert all(kept <= any_ for kept, any_ in both)
    exact = responses_ns(frames, 1000)
    for ns, bound in zip(exact, told(False, False), strict=True):
        assert ns is None or ns <= bound, f"{ns} ns with any phases is exact, {bound} ns not below"
