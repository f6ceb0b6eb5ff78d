"""The loop when frames are lost, late, wrong or repeated: counted, held, then a FAULT."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from engine import ARRIVES, CORRUPT, LOST, SHORT, TWICE, Bench, Node, both, puppet_rig
from hypothesis import given, settings
from hypothesis import strategies as st

from pcpc.executive.loop.events import Event
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.states import STATE_NAMES, State
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig.reading import load_rig

RUN, HOLD, FAULT, STOP = State.RUN, State.HOLD, State.FAULT, State.STOP
FEEDBACK = ("FB_A", "FB_B", "FB_C")
PERIOD_NS = 1_000_000
RAMP_CYCLES = 50  # 50 ms
DETERMINISTIC = settings(max_examples=40, derandomize=True, deadline=None)
HEALTH = ("held_cycles", "stale_cycles", "frames_received", "frames_lost", "crc_errors",
          "frames_repeated")  # fmt: skip


def counters(node: Node) -> dict[str, int]:
    """Return the health counters after the last pass."""
    return {name: int(node[f"health.{name}"]) for name in HEALTH}


@dataclass
class Receiver:
    """What a node must count and do, written without looking at the engine's code."""

    awaited: tuple[str, ...]
    state: int = State.INIT
    missing: int = 0
    gain: float = 1.0
    count: dict[str, int] = field(default_factory=lambda: dict.fromkeys(HEALTH, 0))
    last: dict[str, int] = field(default_factory=dict)

    def hear(self, name: str, counter: int, fate: int) -> bool:
        """Take one frame sent in a cycle; return whether it is used."""
        if fate == LOST:
            return False
        if fate in (CORRUPT, SHORT):
            self.count["crc_errors"] += 1
            return False
        self.count["frames_repeated"] += fate == TWICE
        gap = (counter - self.last.get(name, counter - 1)) % 16
        self.last[name] = counter
        if gap == 0:  # 16 lost in a row look like a repetition
            self.count["frames_repeated"] += 1
            return False
        self.count["frames_lost"] += gap - 1
        self.count["frames_received"] += gap <= 4
        return gap <= 4

    def cycle(self, heard: list[tuple[str, int, int]]) -> bool:
        """Take a cycle's (name, counter, fate); return False once the node is to stop."""
        used = {name for name, counter, fate in heard if self.hear(name, counter, fate)}
        self.missing = 0 if used >= set(self.awaited) else self.missing + 1
        closed = self.state in (RUN, HOLD)
        self.count["held_cycles"] += closed and self.missing > 0
        self.count["stale_cycles"] += closed and self.missing > 2
        if self.state == FAULT:
            self.state = STOP if self.gain <= 0.0 else FAULT
            self.gain = max(self.gain - 1 / RAMP_CYCLES, 0.0)
        elif closed:
            self.state = FAULT if self.missing == 3 else HOLD if self.missing else RUN
        elif not self.missing:
            self.state += 1
        return self.state != STOP


def expected(
    awaited: tuple[str, ...], sent: list[list[tuple[str, int, int]]], greeting: int
) -> tuple[list[int], list[dict[str, int]]]:
    """Return state and counters after each pass for the frames `sent` in each."""
    receiver = Receiver(awaited)
    receiver.count["frames_received"] = greeting
    states, counts = [], []
    for heard in sent:
        if not receiver.cycle(heard):
            break
        states.append(receiver.state)
        counts.append(dict(receiver.count))
    return states, counts


def compare(node: Node, states: list[int], counts: list[dict[str, int]]) -> None:
    """Assert that the node's records are what was expected."""
    passes = len(states)
    assert node.series("supervisor.state").tolist()[:passes] == states
    for name in HEALTH:
        seen = node.series(f"health.{name}").astype(int).tolist()[:passes]
        wanted = [count[name] for count in counts]
        assert seen == wanted, f"{name}: {seen} instead of {wanted}"


FATES = st.sampled_from((ARRIVES,) * 12 + (LOST, LOST, CORRUPT, TWICE, SHORT))


@DETERMINISTIC
@given(pattern=st.lists(st.tuples(FATES, FATES, FATES), min_size=1, max_size=40))
def test_feedback_under_random_loss_is_counted_exactly(
    plans: tuple[Plan, Plan], pattern: list[tuple[int, int, int]]
) -> None:
    bench = Bench(plans)
    table = np.zeros((len(pattern) + 64, len(bench.frames)), np.uint8)
    columns = [list(bench.frames).index(name) for name in FEEDBACK]
    table[4 : 4 + len(pattern), columns] = pattern
    done = bench.run_table(table)
    slow = {"MOTPOS": 10, "DRV": 10}
    sent = [
        [(name, k, int(table[k, c])) for name, c in zip(FEEDBACK, columns, strict=True)]
        + [(name, k // n, ARRIVES) for name, n in slow.items() if k % n == 0]
        + [(f"HB{k}", 0, ARRIVES)] * (k % 100 == 0)
        for k in range(len(table))
    ]
    states, counts = expected(FEEDBACK, sent, greeting=1)
    assert done == len(states), f"{done} cycles instead of {len(states)}"
    compare(bench.executive, states, counts)


@DETERMINISTIC
@given(pattern=st.lists(FATES, min_size=1, max_size=60))
def test_commands_under_random_loss_are_counted_exactly(
    plans: tuple[Plan, Plan], pattern: list[int]
) -> None:
    bench = Bench(plans)
    table = np.zeros((len(pattern) + 10, len(bench.frames)), np.uint8)
    table[4 : 4 + len(pattern), list(bench.frames).index("CMD")] = pattern
    bench.run_table(table)
    fates = [int(row[list(bench.frames).index("CMD")]) for row in table]
    sent: list[list[tuple[str, int, int]]] = [[("SYNC", 0, ARRIVES), ("HB", 0, ARRIVES)]]
    sent += [
        [("CMD", k, fate), ("SYNC", k + 1, ARRIVES)] + [(f"HB{k}", 0, ARRIVES)] * (k % 100 == 0)
        for k, fate in enumerate(fates)
    ]
    states, counts = expected(("CMD",), sent, greeting=0)
    compare(bench.plant, states, counts)


@pytest.mark.parametrize("lost", [1, 2])
@pytest.mark.parametrize("frame", FEEDBACK)
def test_one_or_two_missing_cycles_are_held_and_the_loop_goes_on(
    bench: Bench, frame: str, lost: int
) -> None:
    assert bench.run(lost, {frame: LOST}) == lost
    assert bench.executive.state == "HOLD"
    assert bench.executive["supervisor.missing_cycles"] == lost
    assert bench.run(5) == 5 and bench.executive.state == "RUN"
    health = counters(bench.executive)
    seen = (health["held_cycles"], health["stale_cycles"], health["frames_lost"])
    assert seen == (lost, 0, lost), health


def test_a_held_input_is_stale_and_starved_from_the_first_cycle_beyond_the_limit(
    tmp_path: Path,
) -> None:
    limits = "supervisor: {hold_cycles: 4, fault_after_cycles: 8}"
    bench = Bench(both(load_rig(puppet_rig(tmp_path, limits))))
    node = bench.executive
    bench.run(10)
    bench.run(3, {"FB_A": LOST})  # of one frame no more: the next one would be no successor
    bench.run(3, {"FB_B": LOST})
    bench.run(1)
    for name, counted in (
        ("held_cycles", [1, 2, 3, 4, 5, 6, 6]),
        ("stale_cycles", [0, 0, 0, 0, 1, 2, 2]),
        ("starved_cycles", [0, 0, 0, 0, 1, 2, 2]),
    ):
        assert node.series(f"health.{name}")[10:].tolist() == counted, name
    assert node.state == "RUN" and node["supervisor.missing_cycles"] == 0


def test_a_missing_frame_leaves_the_last_valid_values(bench: Bench) -> None:
    bench.executive["controller.torque_Nm"] = 0.0  # the plant is let go, and moves
    bench.run(20)
    bench.run(2, {"FB_A": LOST})
    encoder = bench.executive.series("rx.FB_A.hub_rate")[-4:]
    speed = bench.executive.series("rx.FB_C.motor_speed")[-4:]
    assert encoder[1] == encoder[2] == encoder[3] != encoder[0], encoder
    assert len(set(speed.tolist())) == 4, f"other frames of the cycle are used: {speed}"


@pytest.mark.parametrize("fate", [CORRUPT, SHORT])
def test_a_frame_with_a_wrong_CRC_or_length_is_counted_and_not_used(
    bench: Bench, fate: int
) -> None:
    before = bench.executive["rx.FB_A.encoder"], bench.executive["rx.FB_A.hub_rate"]
    bench.run(1, {"FB_A": fate})
    after = bench.executive["rx.FB_A.encoder"], bench.executive["rx.FB_A.hub_rate"]
    assert after == before and bench.executive.state == "HOLD"
    assert counters(bench.executive)["crc_errors"] == 1
    bench.run(1)
    assert bench.executive.state == "RUN" and counters(bench.executive)["frames_lost"] == 1


def test_a_repeated_frame_is_counted_and_does_no_harm(bench: Bench) -> None:
    received = counters(bench.executive)["frames_received"]
    bench.run(1, dict.fromkeys(FEEDBACK, TWICE))
    health = counters(bench.executive)
    assert health["frames_repeated"] == 3 and health["held_cycles"] == 0, health
    assert health["frames_received"] - received == 5, "three of feedback, MOTPOS and DRV"


def test_a_repeated_frame_does_not_stand_in_for_a_missing_one(bench: Bench) -> None:
    bench.run(1, {"FB_A": TWICE, "FB_B": LOST})
    assert bench.executive.state == "HOLD", bench.executive.state


def test_two_samples_of_one_frame_do_not_stand_in_for_another_frame(
    clocked: tuple[Plan, Plan],
) -> None:
    bench = Bench(clocked)
    bench.run(10)
    assert bench.executive.state == "RUN"
    bench.plant.loop.clock.now_ns += PERIOD_NS
    assert bench.plant.go() == 1, "the plant's second sample before the executive's next cycle"
    received = counters(bench.executive)["frames_received"]
    bench.run(1, {"FB_B": LOST})
    used = counters(bench.executive)["frames_received"] - received
    assert used >= 4 and bench.executive.state == "HOLD", (
        f"{bench.executive.state} on {used} frames"
    )


def test_three_missing_cycles_are_a_FAULT_that_ramps_to_zero_in_50_ms(bench: Bench) -> None:
    assert bench.run(3, {"FB_B": LOST}) == 3
    node = bench.executive
    assert node.state == "FAULT" and node.count("fault") == Fault.INPUT_MISSING
    assert node.events(Event.FAULT) == [(12, Fault.INPUT_MISSING, 0.0)]
    done = bench.run(100)
    assert done == RAMP_CYCLES, f"{done} cycles after FAULT"
    assert node.count("state") == STOP and not bench.alive[0]
    sent = node.series("tx.CMD.motor_torque")[12:]
    steps = -np.diff(sent)
    assert sent[0] == 1.0 and sent[-1] == 0.0, sent
    assert np.abs(steps - 1 / RAMP_CYCLES).max() < 1e-12, f"steps {steps.min()}..{steps.max()}"
    states = [STATE_NAMES[to] for _, to, _ in node.events(Event.STATE)]
    assert states == ["READY", "RUN", "HOLD", "FAULT", "STOP"], states


def test_the_controller_cannot_talk_itself_out_of_a_FAULT(bench: Bench) -> None:
    bench.run(3, {"FB_A": LOST})
    bench.executive["controller.torque_Nm"] = -2.0
    bench.run(10)
    sent = bench.executive.series("tx.CMD.motor_torque")[13:]
    assert np.abs(sent - (1.0 - np.arange(1, 11) / RAMP_CYCLES)).max() < 1e-12, sent


def test_the_plant_holds_then_ramps_to_the_safe_value_when_commands_stay_away(bench: Bench) -> None:
    bench.run(60, {"CMD": LOST})
    node = bench.plant
    held = node.series("barrel.x_held_Nm")
    first = 11  # the plant's pass that misses the command of cycle 10
    assert (held[first - 1 : first + 3] == 1.0).all(), held[first - 1 : first + 3]
    steps = -np.diff(held[first + 2 : first + 3 + RAMP_CYCLES])
    assert np.abs(steps - 1 / RAMP_CYCLES).max() < 1e-12, f"steps {steps.min()}..{steps.max()}"
    assert held[-1] == 0.0 and len(held) == first + 3 + RAMP_CYCLES, len(held)
    assert node.count("fault") == Fault.INPUT_MISSING and node.count("state") == STOP
    assert not bench.alive[1]


def test_a_command_that_comes_back_too_late_does_not_move_the_plant(bench: Bench) -> None:
    bench.run(3, {"CMD": LOST})
    bench.executive["controller.torque_Nm"] = 2.0
    bench.run(30)
    held = bench.plant.series("barrel.x_held_Nm")[13:]
    assert (np.diff(held) < 0.0).all(), held


def test_a_plant_that_is_gone_is_noticed(bench: Bench) -> None:
    bench.alive[1] = 0
    bench.run(4)
    assert bench.executive.count("fault") == Fault.INPUT_MISSING


def test_in_lockstep_a_missing_frame_means_a_silent_peer(tmp_path: Path) -> None:
    bench = Bench(both(load_rig(puppet_rig(tmp_path)), "lockstep"))
    assert bench.run(10) == 10
    assert bench.run(5, {"FB_A": LOST}) == 0
    assert bench.executive.count("fault") == Fault.PEER_SILENT
    assert bench.executive.count("state") == FAULT


@pytest.mark.parametrize("role", ["executive", "plant"])
def test_each_node_stops_on_request(bench: Bench, role: str) -> None:
    node = getattr(bench, role)
    node.loop.control.stop = 1
    bench.run(1)
    assert node.count("state") == STOP and bench.alive.tolist() == [
        role != "executive",
        role != "plant",
    ]
