"""The modes of CiA 402 on a mass: where it goes, how fast, what the statusword says."""

import math
from itertools import pairwise

import pytest
from drives import RATE_HZ, SCALE, Bench

from pcpc.drivers.canopen.layout import Od, OperationMode

REACHED, BIT_12, LIMITED = 1 << 10, 1 << 12, 1 << 11


def moved(bench: Bench, target: int, flags: int = 0) -> Bench:
    """Take a setpoint by the handshake of bits 4 and 12."""
    bench[Od.TARGET_POSITION] = target
    bench[Od.CONTROLWORD] = 0x1F | flags
    bench.cycles(1)
    assert bench[Od.STATUSWORD] & BIT_12
    bench[Od.CONTROLWORD] = 0x0F
    bench.cycles(1)
    return bench


def test_a_profile_has_its_velocity_its_time_and_its_end() -> None:
    starts = {"6081": 2000, "6083": 10_000, "6084": 5000, "6067": 20}
    bench = Bench(starts=starts).enabled(OperationMode.PROFILE_POSITION)
    moved(bench, 3000)
    v, left, n = [], [], 0
    while bench.d.state.moves and n < 5000:
        bench.cycles(1)
        v.append(float(bench.d.state.demand_velocity))
        left.append(3.0 - float(bench.d.state.demand_position))
        n += 1
    ideal_s = 3.0 / 2.0 + 0.5 * (2.0 / 10.0 + 2.0 / 5.0)
    assert abs(n / RATE_HZ - ideal_s) < 0.01, n
    assert abs(max(v) - 2.0) < 1e-9 and min(left) > -1e-9, "it does not overshoot"
    steps = [b - a for a, b in pairwise(v)]
    assert max(steps) < 10.0 / RATE_HZ + 1e-9 and min(steps) > -5.0 / RATE_HZ - 1e-9
    assert bench[Od.POSITION_DEMAND] == 3000
    bench.cycles(1000)
    assert abs(bench.q - 3.0) < 0.005 and bench[Od.STATUSWORD] & REACHED


@pytest.mark.parametrize(
    ("velocity", "fast", "slow", "targets"),
    [
        (2000, 10_000, 5000, [3000, -1, 7, 2999]), (10**6, 11_900, 11_900, [1234, 0]),
        (900, 30_000, 4000, [1, 2, 3, 5, 8, 13, 21]), (10**6, 1000, 50_000, [777, -778]),
        (137, 9999, 700, [100, 50]), (10**6, 10**6, 10**6, [1, -1, 1000, 1003]),
    ],
)  # fmt: skip
def test_no_step_of_a_profile_exceeds_its_acceleration(
    velocity: int, fast: int, slow: int, targets: list[int]
) -> None:
    starts = {"6081": velocity, "6083": fast, "6084": slow}
    bench = Bench(starts=starts).enabled(OperationMode.PROFILE_POSITION)
    q = [float(bench.d.state.demand_position)] * 2
    for target in targets:
        bench[Od.TARGET_POSITION], bench[Od.CONTROLWORD] = target, 0x1F
        for _ in range(5000):
            bench.cycles(1)
            q.append(float(bench.d.state.demand_position))
            bench[Od.CONTROLWORD] = 0x0F
            if bench.d.state.moves == 0 and bench.d.state.demand_velocity == 0.0:
                break
        assert q[-1] == target / SCALE, "it ends there"
    v = [(b - a) * RATE_HZ for a, b in pairwise(q)]
    gains = [(abs(b) - abs(a)) * RATE_HZ * SCALE for a, b in pairwise(v) if a * b >= 0.0]
    assert max(gains) <= fast * (1 + 1e-6), f"{max(gains):.1f} of {fast} increments/s2"
    assert -min(gains) <= slow * (1 + 1e-6), f"{-min(gains):.1f} of {slow} increments/s2"
    crossings = [abs(b - a) * RATE_HZ * SCALE for a, b in pairwise(v) if a * b < 0.0]
    assert max(crossings, default=0.0) <= max(fast, slow) * (1 + 1e-6)


def test_a_second_setpoint_waits_or_is_taken_at_once_or_relative() -> None:
    bench = Bench().enabled(OperationMode.PROFILE_POSITION)
    moved(bench, 1000)
    bench[Od.TARGET_POSITION] = 500
    bench[Od.CONTROLWORD] = 0x1F
    bench.cycles(1)
    assert bench.d.state.target == 1.0 and bench.d.state.pending == 0.5
    bench[Od.CONTROLWORD] = 0x0F
    assert bench.cycles(1)[Od.STATUSWORD] & BIT_12, "the place for one more is taken"
    bench.cycles(3000)
    assert abs(bench.q - 0.5) < 0.01 and not bench[Od.STATUSWORD] & BIT_12
    moved(bench, 4000)
    moved(bench, -1000, 1 << 5)
    assert bench.d.state.target == -1.0
    moved(bench.cycles(4000), 250, 1 << 6)
    assert abs(float(bench.d.state.target) + 0.75) < 1e-12


def test_a_halt_stops_on_the_way_and_goes_on() -> None:
    bench = moved(Bench().enabled(OperationMode.PROFILE_POSITION), 3000)
    bench.cycles(500)
    bench[Od.CONTROLWORD] = 0x10F
    there = float(bench.cycles(500).d.state.demand_position)
    assert bench.d.state.demand_velocity == 0.0 and 0.2 < there < 1.0
    assert bench.cycles(500).d.state.demand_position == there
    bench[Od.CONTROLWORD] = 0x0F
    bench.cycles(5000)
    assert abs(bench.q - 3.0) < 0.01


def test_software_limits_hold_a_target() -> None:
    bench = Bench(starts={"607D.1": -200, "607D.2": 400}).enabled(OperationMode.PROFILE_POSITION)
    assert moved(bench, 9000).d.state.target == 0.4
    cyclic = Bench(starts={"607D.1": -200, "607D.2": 400}).enabled(OperationMode.CYCLIC_POSITION)
    cyclic[Od.TARGET_POSITION] = -9000
    cyclic.cycles(2000)
    assert abs(cyclic.q + 0.2) < 0.01 and cyclic[Od.STATUSWORD] & LIMITED


@pytest.mark.parametrize("target", [1500, -1500])
def test_profile_velocity_accelerates_as_told(target: int) -> None:
    bench = Bench(starts={"6083": 3000, "606D": 30}).enabled(OperationMode.PROFILE_VELOCITY)
    bench[Od.TARGET_VELOCITY] = target
    bench.cycles(250)
    assert math.isclose(abs(bench.d.state.demand_velocity), 0.75)
    bench.cycles(1250)
    assert abs(bench.w - target / 1000) < 0.01 and bench[Od.STATUSWORD] & REACHED
    bench[Od.CONTROLWORD] = 0x10F
    assert abs(bench.cycles(1000).w) < 0.02 and bench[Od.STATUSWORD] & BIT_12


def test_cyclic_modes_follow_their_targets() -> None:
    bench = Bench().enabled(OperationMode.CYCLIC_VELOCITY)
    bench[Od.TARGET_VELOCITY], bench[Od.VELOCITY_OFFSET] = 500, 200
    assert abs(bench.cycles(1500).w - 0.7) < 0.01
    bench[Od.TARGET_TORQUE], bench[Od.TORQUE_OFFSET] = 250, -50
    bench[Od.MODE] = OperationMode.CYCLIC_TORQUE
    assert math.isclose(bench.cycles(1).u, 24.0 * 0.2)
    assert bench[Od.TORQUE_ACTUAL] == 200
    bench[Od.VELOCITY_OFFSET], bench[Od.TARGET_POSITION] = 0, 100
    bench[Od.MODE] = OperationMode.CYCLIC_POSITION
    assert abs(bench.cycles(5000).q - 0.1) < 0.01


def test_no_torque_is_above_the_largest() -> None:
    bench = Bench(starts={"6072": 100}).enabled(OperationMode.CYCLIC_TORQUE)
    bench[Od.TARGET_TORQUE] = -900
    assert math.isclose(bench.cycles(1).u, -2.4) and bench[Od.STATUSWORD] & LIMITED
    bench[Od.TARGET_TORQUE] = 50
    assert not bench.cycles(1)[Od.STATUSWORD] & LIMITED


@pytest.mark.parametrize("method", [35, 37])
def test_homing_gives_the_place_its_number(method: int) -> None:
    bench = Bench(starts={"6098": method, "607C": -1234})
    bench.q = 0.7
    bench.cycles(1).enabled(OperationMode.HOMING)
    assert bench[Od.POSITION_ACTUAL] == 700 and not bench[Od.STATUSWORD] & BIT_12
    bench[Od.CONTROLWORD] = 0x1F
    bench.cycles(2)
    assert bench[Od.STATUSWORD] & (BIT_12 | REACHED) == BIT_12 | REACHED
    assert bench[Od.POSITION_ACTUAL] == -1234
    assert bench.write(0x6098, 0, 17, 1) != 0, "switches are not there"


def test_a_motor_without_power_is_not_driven() -> None:
    bench = Bench()
    bench[Od.MODE], bench[Od.TARGET_TORQUE] = OperationMode.CYCLIC_TORQUE, 500
    for word in (0x00, 0x06, 0x07):
        bench[Od.CONTROLWORD] = word
        assert bench.cycles(3).u == 0.0


def test_a_measured_value_beyond_all_numbers_saturates() -> None:
    bench = Bench()
    bench.q = 1e30
    assert bench.cycles(1)[Od.POSITION_ACTUAL] == 2**31 - 1
    bench.q = float("nan")
    assert bench.cycles(1)[Od.POSITION_ACTUAL] == 2**31 - 1, "the last one stays"


def test_a_cyclic_position_is_reached_in_its_period() -> None:
    bench = Bench(starts={"60C2.1": 2, "60C2.2": -2}).enabled(OperationMode.CYCLIC_POSITION)
    bench[Od.TARGET_POSITION] = 100
    demand = [bench.cycles(1)[Od.POSITION_DEMAND] for _ in range(25)]
    assert demand == [*range(5, 101, 5), *[100] * 5]


def test_no_profile_is_faster_than_the_largest_velocity() -> None:
    bench = Bench(starts={"607F": 300}).enabled(OperationMode.PROFILE_VELOCITY)
    bench[Od.TARGET_VELOCITY] = 5000
    assert bench.cycles(1000)[Od.VELOCITY_DEMAND] == 300
