"""The loop under loss, limits, tunings and stalls: each is counted and has its stated reaction."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine import ARRIVES, CORRUPT, LOST, SHORT, TWICE, Bench, Node, both, puppet_rig, zeroed
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pcpc.drivers.jit import i8, loop
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import supervisor as sv
from pcpc.executive.loop.clock import CLOCKED, GIVEN, arm
from pcpc.executive.loop.cycle import N, finish, next_cycle
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig.reading import load_rig

RUN, HOLD, FAULT, STOP = sv.RUN, sv.HOLD, sv.FAULT, sv.STOP
FEEDBACK = ("FB_A", "FB_B", "FB_C")
PERIOD_NS = 1_000_000
RAMP_CYCLES = 50  # 50 ms
DETERMINISTIC = settings(max_examples=40, derandomize=True, deadline=None)
HEALTH = ("held_cycles", "stale_cycles", "frames_received", "frames_lost", "crc_errors",
          "frames_repeated")  # fmt: skip


@pytest.fixture(scope="module")
def plans(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, Plan]:
    """Return both plans of the puppet rig; the executive has a clock."""
    return both(load_rig(puppet_rig(tmp_path_factory.mktemp("puppet"))))


@pytest.fixture(scope="module")
def clocked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, Plan]:
    """Return both plans of the puppet rig, each node with its own clock."""
    return both(load_rig(puppet_rig(tmp_path_factory.mktemp("puppet"))), "real")


@pytest.fixture
def bench(plans: tuple[Plan, Plan]) -> Bench:
    """Return a closed loop that sends 1 N m and has done ten cycles."""
    made = Bench(plans)
    made.executive["controller.torque_Nm"] = 1.0
    assert made.run(10) == 10 and made.executive.state == "RUN"
    return made


def end(node: Node) -> None:
    """Send the last frames."""
    _finish(node.loop)


@loop(i8(N))
def _finish(n: Any) -> Any:
    finish(n)
    return 0


def counters(node: Node) -> dict[str, int]:
    """Return the health counters after the last pass."""
    return {name: int(node[f"health.{name}"]) for name in HEALTH}


# ------------------------------------------------------------------------------------------ losses


@dataclass
class Receiver:
    """What a node must count and do, written without looking at the engine's code."""

    awaited: tuple[str, ...]
    state: int = sv.INIT
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
    assert node.state == "FAULT" and node.count(sh.FAULT) == sv.INPUT_MISSING
    assert node.events(sh.FAULT_EVENT) == [(12, sv.INPUT_MISSING, 0.0)]
    done = bench.run(100)
    assert done == RAMP_CYCLES, f"{done} cycles after FAULT"
    assert node.count(sh.STATE) == STOP and not bench.alive[0]
    sent = node.series("tx.CMD.motor_torque")[12:]
    steps = -np.diff(sent)
    assert sent[0] == 1.0 and sent[-1] == 0.0, sent
    assert np.abs(steps - 1 / RAMP_CYCLES).max() < 1e-12, f"steps {steps.min()}..{steps.max()}"
    states = [sv.STATE_NAMES[to] for _, to, _ in node.events(sh.STATE_EVENT)]
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
    assert node.count(sh.FAULT) == sv.INPUT_MISSING and node.count(sh.STATE) == STOP
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
    assert bench.executive.count(sh.FAULT) == sv.INPUT_MISSING


def test_in_lockstep_a_missing_frame_means_a_silent_peer(tmp_path: Path) -> None:
    bench = Bench(both(load_rig(puppet_rig(tmp_path)), "lockstep"))
    assert bench.run(10) == 10
    assert bench.run(5, {"FB_A": LOST}) == 0
    assert bench.executive.count(sh.FAULT) == sv.PEER_SILENT
    assert bench.executive.count(sh.STATE) == FAULT


@pytest.mark.parametrize("role", ["executive", "plant"])
def test_each_node_stops_on_request(bench: Bench, role: str) -> None:
    node = getattr(bench, role)
    node.loop.control[sh.STOP] = 1
    bench.run(1)
    assert node.count(sh.STATE) == STOP and bench.alive.tolist() == [
        role != "executive",
        role != "plant",
    ]


# ------------------------------------------------------------------------------------------ limits


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e305])
def test_a_command_that_is_not_finite_is_replaced_by_the_last_one_and_a_FAULT(
    bench: Bench, value: float
) -> None:
    node = bench.executive
    node["controller.torque_Nm"] = value
    bench.run(1)
    assert node["tx.CMD.motor_torque"] == 1.0, node["tx.CMD.motor_torque"]
    bench.run(1)
    assert node.state == "FAULT" and node.count(sh.FAULT) == sv.COMMAND_NOT_FINITE
    assert bench.run(100) == RAMP_CYCLES
    sent = node.series("tx.CMD.motor_torque")[10:]
    assert np.isfinite(sent).all() and (np.diff(sent) <= 0.0).all() and sent[-1] == 0.0, sent


def test_every_recorded_NaN_is_the_same_one(bench: Bench) -> None:
    node = bench.executive
    odd = np.array([0xFFF8DEADBEEF0001], np.uint64).view(np.float64)
    node.loop.v[node.place("controller.torque_Nm")] = odd[0]
    raw = node.loop.v.view(np.uint64)[node.place("controller.torque_Nm")]
    assert raw == 0xFFF8DEADBEEF0001, f"{raw:x}"
    bench.run(1)
    recorded = node.series("controller.motor_torque_Nm").view(np.uint64)[-1]
    assert recorded == 0x7FF8000000000000, f"{recorded:x}"


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e300])
def test_a_signal_without_limits_that_is_not_finite_is_a_FAULT_that_names_it(
    bench: Bench, value: float
) -> None:
    node = bench.executive
    node["controller.other_Nm"] = value
    bench.run(1)
    assert node.state == "RUN" and node["tx.CMD.motor_torque"] == 1.0
    bench.run(1)
    assert node.state == "FAULT" and node.count(sh.FAULT) == sv.OUTPUT_NOT_FINITE
    ((cycle, place, seen),) = node.events(sh.NOT_FINITE_EVENT)
    assert (cycle, place) == (10, node.place("controller.tau_Nm"))
    assert seen == value or (math.isnan(seen) and math.isnan(value))
    assert bench.run(100) == RAMP_CYCLES, "the command's ramp to its safe value"
    assert node.series("tx.CMD.motor_torque")[-1] == 0.0


def test_a_plant_that_diverges_is_a_fault_of_the_plant(bench: Bench) -> None:
    plant = bench.plant
    for name in (v.name for v in plant.plan.table.variables if v.name.startswith("barrel.x_")):
        plant[name] = math.nan
    bench.run(RAMP_CYCLES + 5)
    assert plant.count(sh.FAULT) == sv.PLANT_NOT_FINITE, sv.FAULT_NAMES[plant.count(sh.FAULT)]
    place = plant.events(sh.NOT_FINITE_EVENT)[0][1]
    assert plant.plan.names[place].startswith("barrel."), plant.plan.names[place]


def test_a_value_that_is_not_finite_in_the_last_cycle_is_a_fault_too(
    plans: tuple[Plan, Plan],
) -> None:
    bench = Bench(plans)
    node = bench.executive
    node["controller.other_Nm"] = math.nan
    node.loop.guard.cycles = 1
    assert bench.run(5) == 0, "the run is over with the first cycle"
    end(node)
    assert node.count(sh.FAULT) == sv.OUTPUT_NOT_FINITE


@pytest.mark.parametrize(("wanted", "sent"), [(5.0, 2.0), (-5.0, -2.0), (2.0, 2.0), (1.5, 1.5)])
def test_a_command_is_clamped_flagged_and_counted(bench: Bench, wanted: float, sent: float) -> None:
    node, clamped = bench.executive, wanted != sent
    node["controller.torque_Nm"] = wanted
    bench.run(1)
    assert node["tx.CMD.motor_torque"] == sent and node["supervisor.saturated"] == clamped
    bench.run(1)
    assert bench.plant["rx.CMD.flags"] == clamped and bench.plant["rx.CMD.motor_torque"] == sent
    assert node.count(sh.SATURATED) == 2 * clamped
    node["controller.torque_Nm"] = 0.5
    bench.run(2)
    assert node["supervisor.saturated"] == 0 and bench.plant["rx.CMD.flags"] == 0


@pytest.fixture(scope="module")
def rate_limited(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, Plan]:
    """Return plans whose command changes by at most 0.125 N m a cycle, within -1..2 N m."""
    limit = "executive: {limits: {CMD.motor_torque: {low: -1.0, high: 2.0, rate_per_s: 125.0}}}"
    return both(load_rig(puppet_rig(tmp_path_factory.mktemp("puppet"), limit)))


@DETERMINISTIC
@given(wanted=st.lists(st.floats(-4.0, 4.0), min_size=1, max_size=30))
def test_what_is_sent_is_the_nearest_value_within_range_and_rate(
    rate_limited: tuple[Plan, Plan], wanted: list[float]
) -> None:
    bench = Bench(rate_limited)
    node, last = bench.executive, 0.0
    change = float(node.loop.limits.table[0, sh.RATE])
    assert math.isclose(change, 0.125, rel_tol=1e-12), change
    for value in wanted[:8]:
        node["controller.torque_Nm"] = value
        bench.run(1)
        sent = node["tx.CMD.motor_torque"]
        nearest = min(max(min(max(value, -1.0), 2.0), last - change), last + change)
        assert sent == nearest, f"wanted {value}, last {last}: sent {sent}, not {nearest}"
        assert node["supervisor.saturated"] == (sent != value)
        last = sent


RATE = 0.125  # N m a cycle


def ways(*lines: str) -> str:
    """Return limits of the command: a slow one, and what else the test wants."""
    return ", ".join(("rate_per_s: 125.0", *lines))


@pytest.mark.parametrize(
    ("limits", "safe"),
    [
        (ways("low: -1.0", "high: 2.0"), 0.0),
        (ways("low: -1.0", "high: 2.0", "safe: -0.7"), -0.7),
        (ways("low: 0.3", "high: 2.0"), 0.3),
        (ways("low: -3.0", "high: -0.5"), -0.5),
        ("safe: 0.25", 0.25),
        ("low: 0.5, high: 2.0", 0.5),
    ],
)
@pytest.mark.parametrize("why", ["duration", "stop", "fault"])
def test_a_command_goes_to_its_safe_value_within_range_and_rate(
    tmp_path: Path, limits: str, safe: float, why: str
) -> None:
    text = f"executive: {{limits: {{CMD.motor_torque: {{{limits}}}}}}}"
    made = Bench(both(load_rig(puppet_rig(tmp_path, text, "supervisor: {ramp_s: 0.002}"))))
    node = made.executive
    low, high, rate = (float(node.loop.limits.table[0, c]) for c in (sh.LOW, sh.HIGH, sh.RATE))
    node["controller.torque_Nm"] = -5.0 if safe < 0.0 and low < safe - 1.0 else 1.9
    made.run(40)
    before = node["tx.CMD.motor_torque"]
    assert abs(before - safe) > 1.0, f"{before}: the test has nothing to ramp"
    done = 40
    if why == "duration":
        node.loop.guard.cycles = done
        node.loop.k = done
    elif why == "stop":
        node.loop.control[sh.STOP] = 1
    else:
        node["controller.torque_Nm"] = math.nan
    made.run(100)
    end(node)
    sent = np.append(node.series("tx.CMD.motor_torque"), node["tx.CMD.motor_torque"])
    assert sent[-1] == pytest.approx(safe, abs=1e-12), sent[-5:]
    assert (sent[done:] >= low).all() and (sent[done:] <= high).all()
    # the first cycle begins at the safe value
    change = np.abs(np.diff(sent, prepend=safe))
    assert (change <= rate * (1.0 + 1e-12)).all(), f"{change.max()} a cycle, limit {rate}"
    states = set(node.series("supervisor.state")[done:].astype(int).tolist())
    assert states <= ({RUN, FAULT} if why == "fault" else {RUN}), states
    assert (node.count(sh.FAULT) == sv.NO_FAULT) == (why != "fault")
    assert why == "fault" or math.isfinite(rate) or len(sent) == done + 1, "cycles more"


# ----------------------------------------------------------------------------------------- tunings


def test_tunings_of_one_request_take_effect_in_one_cycle(bench: Bench) -> None:
    node = bench.executive
    node.post({"controller.torque_Nm": 1.25, "controller.other_Nm": 40.0})
    bench.run(5)
    torque, other = node.series("controller.motor_torque_Nm"), node.series("controller.tau_Nm")
    changed = [int(np.flatnonzero(np.diff(s))[-1]) + 1 for s in (torque, other)]
    assert changed == [10, 10], changed
    assert (torque[9], torque[10], other[9], other[10]) == (1.0, 1.25, 0.0, 40.0)
    assert node.loop.answer[:3].tolist() == [1, 10, sh.ACCEPTED], node.loop.answer
    places = [node.place(f"controller.{name}_Nm") for name in ("torque", "other")]
    assert node.events(sh.TUNING_EVENT) == [(10, places[0], 1.25), (10, places[1], 40.0)]


def test_values_in_the_mailbox_wait_for_the_request(bench: Bench) -> None:
    node = bench.executive
    node.post({"controller.torque_Nm": 1.25})
    node.loop.mail[sh.REQUEST] -= 1
    bench.run(3)
    assert node["controller.torque_Nm"] == 1.0 and not node.events(sh.TUNING_EVENT)
    node.loop.mail[sh.REQUEST] += 1
    bench.run(3)
    assert node["controller.torque_Nm"] == 1.25
    assert int(node.loop.answer[sh.ACK_CYCLE]) == 13, node.loop.answer


def test_a_request_is_carried_out_once(bench: Bench) -> None:
    node = bench.executive
    node.post({"controller.torque_Nm": 1.25})
    bench.run(1)
    node["controller.torque_Nm"] = 0.5
    bench.run(5)
    assert node["controller.torque_Nm"] == 0.5 and len(node.events(sh.TUNING_EVENT)) == 1


GAIN, OTHER = "controller.torque_Nm", "controller.other_Nm"  # both -1e9 to 1e9
BEYOND = (-1, -(2**63), 2**63 - 1, sh.MAX_VARIABLES, 10**12)


def refused(bench: Bench, places: list[int], values: list[float], **words: int) -> int:
    """Post a request as any client may; check that nothing came of it; return the reason."""
    node = bench.executive
    n, before, told = node.loop, node.loop.v.copy(), len(node.events(sh.REFUSED_EVENT))
    n.mail_index[: len(places)], n.mail_value[: len(values)] = places, values
    n.mail[sh.COUNT], n.mail[sh.LOCK] = words.get("count", len(places)), words.get("lock", 0)
    n.mail[sh.REQUEST] += 1
    bench.run(1)
    assert int(n.answer[sh.ACK]) == int(n.mail[sh.REQUEST]), "no answer"
    parameters = [node.place(v.name) for v in node.plan.table.variables if v.kind == "parameter"]
    assert (n.v[parameters] == before[parameters]).all(), "something was set"
    assert (n.v[int(n.n_variables) :] == 0.0).all(), "written outside of the table"
    assert not node.events(sh.TUNING_EVENT) and node.state == "RUN", node.state
    assert len(node.events(sh.REFUSED_EVENT)) == told + 1, node.events(sh.REFUSED_EVENT)
    assert node.count(sh.REFUSED) == told + 1 == node["health.requests_refused"]
    return int(n.answer[sh.REFUSAL])


def test_only_parameters_are_taken_from_the_mailbox(bench: Bench) -> None:
    node = bench.executive
    gain = node.place(GAIN)
    others = [node.place(v.name) for v in node.plan.table.variables if v.kind != "parameter"]
    assert len(others) > 50, len(others)
    for place in (*others, int(node.loop.n_variables), *BEYOND):
        assert refused(bench, [gain, place], [0.5, 4.0]) == sh.NO_PARAMETER, place
        assert int(node.loop.answer[sh.REFUSED_ENTRY]) == 1, node.loop.answer


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, -1.1e9, 5e300])
def test_a_value_outside_of_its_range_is_refused_with_all_that_came_with_it(
    bench: Bench, value: float
) -> None:
    node = bench.executive
    places = [node.place(GAIN), node.place(OTHER)]
    assert refused(bench, places, [0.5, value]) == sh.OUT_OF_RANGE
    node.post({GAIN: 1e9, OTHER: -1e9})
    bench.run(1)
    assert (node[GAIN], node[OTHER]) == (1e9, -1e9), "the edges are inside"


def test_an_unbounded_parameter_takes_no_infinity(bench: Bench) -> None:
    node = bench.executive
    node.loop.tuning.high[node.place(GAIN)] = math.inf
    assert refused(bench, [node.place(GAIN)], [math.inf]) == sh.OUT_OF_RANGE


@pytest.mark.parametrize("count", [-1, sh.MAIL_SLOTS + 1, 10**6, -(2**63), 2**63 - 1])
def test_a_count_that_no_mailbox_has_is_refused(bench: Bench, count: int) -> None:
    assert refused(bench, [bench.executive.place(GAIN)], [0.5], count=count) == sh.BAD_COUNT


@pytest.mark.parametrize("level", [1, 2, -1, 2**62])
def test_the_loop_itself_keeps_to_the_lock(bench: Bench, level: int) -> None:
    assert refused(bench, [bench.executive.place(GAIN)], [0.5], lock=level) == sh.LOCKED


def test_a_request_that_was_withdrawn_sets_nothing_and_is_no_refusal(bench: Bench) -> None:
    node = bench.executive
    node.post({GAIN: 0.5})
    node.loop.mail[sh.COUNT] = 0
    bench.run(1)
    assert node.loop.answer[[sh.ACK, sh.REFUSAL]].tolist() == [1, sh.ACCEPTED], node.loop.answer
    assert node[GAIN] == 1.0 and node.count(sh.REFUSED) == 0


def test_garbage_in_the_mailbox_changes_neither_outputs_nor_private_memory(
    tmp_path: Path,
) -> None:
    """The fixture's rig twice: alone, and with random bytes in all that clients write."""
    plans, random = both(load_rig(puppet_rig(tmp_path))), np.random.default_rng(26)
    quiet, noisy = Bench(plans), Bench(plans)
    n = noisy.executive.loop
    mailbox = [n[name].view(np.uint8) for name in sh.MAILBOX_FIELDS]
    for i in range(500):
        for words in mailbox:
            words[:] = random.integers(0, 256, len(words), np.uint8)
        n.mail_index[::2] = random.integers(0, int(n.n_variables), 32)
        n.mail_index[0] = noisy.executive.place("supervisor.state")
        n.mail[sh.COUNT] = (i % 66) if i % 3 else random.integers(-(2**63), 2**63)
        n.mail[sh.LOCK] = i % 2
        assert quiet.run(1) == noisy.run(1) == 1, f"round {i}"
        n.record_taken[0] = n.frame_taken[0] = n.event_taken[0] = 0
    ours, theirs = quiet.executive, noisy.executive
    names = ("v", "limits", "blocks", "rx", "tx")
    counted = [theirs.place("health.requests_refused")]
    theirs.loop.v[counted] = 0.0
    different = [x for x in names if ours.loop[x].tobytes() != theirs.loop[x].tobytes()]
    assert not different, different
    assert theirs.count(sh.REFUSED) > 300, theirs.count(sh.REFUSED)


# --------------------------------------------------------------------------------------- deadlines


@pytest.fixture(scope="module")
def clock() -> Any:
    """Return a LOOP record with a clock of 1 kHz and nothing else."""
    n = zeroed()
    n.clock.period_ns, n.clock.trigger, n.clock.kind = PERIOD_NS, CLOCKED, GIVEN
    return n


@DETERMINISTIC
@given(
    deadline=st.integers(0, 10**15),
    late=st.integers(-PERIOD_NS, 10**10),
    k=st.integers(0, 10**9),
    skipped=st.integers(0, 10**6),
)
def test_after_a_stall_whole_periods_are_skipped_and_counted(
    clock: Any, deadline: int, late: int, k: int, skipped: int
) -> None:
    n = clock
    n.clock.deadline, n.timing.done, n.k, n.passes = deadline, deadline + PERIOD_NS + late, k, 7
    n.control[sh.SKIPPED] = skipped
    next_cycle(n)
    after, cycle, behind = int(n.clock.deadline), int(n.k), int(n.clock.behind)
    done = deadline + PERIOD_NS + late
    assert (after - deadline) % PERIOD_NS == 0, "the phase is lost"
    assert after - deadline == (cycle - k) * PERIOD_NS, "k and deadline disagree"
    assert behind == cycle - k - 1 == int(n.control[sh.SKIPPED]) - skipped, f"{behind} skipped"
    assert after >= done, f"the next deadline is over already by {done - after} ns"
    assert behind == 0 or after - done <= PERIOD_NS, f"{after - done} ns: a period too many"
    assert int(n.passes) == 8


@DETERMINISTIC
@given(now=st.integers(0, 10**15), phase=st.integers(0, PERIOD_NS))
def test_the_first_deadline_is_soon_and_on_the_common_grid(
    clock: Any, now: int, phase: int
) -> None:
    n = clock
    n.clock.now_ns, n.clock.phase_ns = now, phase
    arm(n.clock)
    ahead = int(n.clock.deadline) - now
    assert (int(n.clock.deadline) - phase) % PERIOD_NS == 0, "off the grid"
    assert PERIOD_NS // 8 < ahead <= PERIOD_NS + PERIOD_NS // 8, f"{ahead} ns ahead"


def deadlines_of(node: Node) -> NDArray[np.int64]:
    """Return the deadline of each pass, ns."""
    late_ns = np.rint(1000.0 * node.series("timing.wake_late_us")).astype(np.int64)
    return np.asarray(node.records()[:, 1] - late_ns, np.int64)


@DETERMINISTIC
@given(late=st.lists(st.one_of(st.just(0), st.integers(0, 6 * PERIOD_NS)), max_size=40))
def test_under_random_stalls_no_period_has_two_cycles_and_none_is_uncounted(
    plans: tuple[Plan, Plan], late: list[int]
) -> None:
    bench = Bench(plans)
    bench.run(3)
    assert bench.run(len(late) + 3, late_ns=late) == len(late) + 3
    node = bench.executive
    cycle, wake, due = node.records()[:, 0], node.records()[:, 1], deadlines_of(node)
    assert (due == (cycle + 1) * PERIOD_NS).all(), "a deadline is off its cycle's place"
    assert (np.diff(cycle) >= 1).all() and (wake[1:] >= due[1:]).all()
    assert len(set((wake[1:] // PERIOD_NS).tolist())) == len(wake) - 1, "two cycles in a period"
    passes = np.arange(len(cycle))
    assert (node.series("health.skipped_cycles")[1:] == (cycle - passes)[1:]).all()
    assert node.count(sh.LATE) == sum(ns > PERIOD_NS // 10 for ns in late)
    assert sum(n for _, n, _ in node.events(sh.SKIP_EVENT)) == cycle[-1] - passes[-1]


def test_the_plant_makes_up_the_periods_it_owes_and_the_executive_does_not(
    clocked: tuple[Plan, Plan],
) -> None:
    steady, stalled = Bench(clocked), Bench(clocked)
    steady.run(40)
    stalled.run(20)
    stalled.run(13, late_ns=[7_100_000])
    a, b = steady.plant, stalled.plant
    skipped = b.count(sh.SKIPPED)
    assert skipped == stalled.executive.count(sh.SKIPPED) == 7, f"{skipped} periods"
    both_have, rows, others = np.intersect1d(
        a.records()[:, 0], b.records()[:, 0], return_indices=True
    )
    assert both_have[-1] == 40 and len(both_have) == 41 - 7, both_have
    for name in (v.name for v in b.plan.table.variables if v.name.startswith("barrel.x_")):
        one, other = a.series(name)[rows], b.series(name)[others]
        assert (one == other).all(), f"{name}: cycle {both_have[np.argmax(one != other)]}"
    steps = stalled.executive.series("controller.steps")[-1]
    cycles = stalled.executive.records()[-1, 0] + 1
    assert (steps, cycles) == (33, 40), f"{steps} steps, {cycles} cycles"
    phase = deadlines_of(b)[2:] % PERIOD_NS
    assert (phase == PERIOD_NS // 2).all(), f"phase {phase}"


def test_an_executive_that_dies_after_its_first_command_does_not_leave_the_plant_with_it(
    plans: tuple[Plan, Plan],
) -> None:
    bench = Bench(plans)
    bench.executive["controller.torque_Nm"] = 1.5
    bench.run(1)
    assert (bench.plant.state, bench.plant["rx.CMD.motor_torque"]) == ("READY", 1.5)
    bench.run(60, {"CMD": LOST})
    held, fault = bench.plant["barrel.x_held_Nm"], bench.plant.count(sh.FAULT)
    assert fault == sv.INPUT_MISSING and held == 0.0, f"fault {fault}, {held} N m held"
