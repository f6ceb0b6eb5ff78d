"""PD and PID: bit for bit the equations of their headers, with the signs that point the barrel."""

import importlib
import math
import re
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcpc.executive.laws.block import Block
from pcpc.executive.rig import law_lookup
from pcpc.plants.atb1000.laws import pd, pid

DETERMINISTIC = settings(max_examples=200, derandomize=True, deadline=None)
GAINS = {
    "kv_Nms_rad": 110.0, "lam_per_s": 16.0, "km_Nms_rad": 60.0, "gear_ratio": 60.0,
    "tau_max_Nm": 115.0, "ki_Nm_rad": 500.0, "r_max_rad_s": 0.3,
}  # fmt: skip
T_S = 1e-3
INPUTS = tuple(port.name for port in pd.Inputs.ports)
LAWS = {"pd": pd.BLOCK, "pid": pid.BLOCK}

gains = st.fixed_dictionaries(
    {
        "kv_Nms_rad": st.floats(0.0, 1000.0), "lam_per_s": st.floats(0.0, 200.0),
        "km_Nms_rad": st.floats(0.0, 1000.0), "gear_ratio": st.floats(1.0, 1000.0),
        "tau_max_Nm": st.floats(0.0, 1e4), "ki_Nm_rad": st.floats(0.0, 1e5),
        "r_max_rad_s": st.floats(0.0, 10.0),
    }
)  # fmt: skip
sample = st.tuples(*(st.floats(-3.0, 3.0) for _ in INPUTS))


class Law:
    """A control law with its gains and state."""

    def __init__(self, block: Block, **changed: float) -> None:
        values = GAINS | changed
        self.block = block
        self.p = np.array([values[port.name] for port in block.settings])
        self.x, self.y = np.zeros(block.size(block.states)), np.zeros(4)

    def step(self, u: Sequence[float]) -> list[float]:
        """Return motor torque, output torque, e and r for the inputs `u` in their order."""
        self.block.step(0.0, T_S, self.p, self.x, np.array(u, float), self.y)
        return [float(value) for value in self.y]


def inputs(**given: float) -> list[float]:
    """Return the inputs by name, zero if not given."""
    assert set(given) <= set(INPUTS), given
    return [given.get(name, 0.0) for name in INPUTS]


def saturated(value: float, bound: float) -> float:
    """Return the value nearest to `value` within +-`bound`."""
    return min(max(value, -bound), bound)


def by_hand(
    p: dict[str, float], u: Sequence[float], s: float, integral: bool
) -> tuple[list[float], float]:
    """Return outputs and next integral by the headers' equations, in plain Python."""
    q_d, q_d_rate, encoder, pitch, hub_rate, hull_rate, motor_speed = u
    e = q_d - (encoder + pitch)  # (1)
    r = (q_d_rate - hub_rate) + p["lam_per_s"] * e  # (2) (3)
    limit = p["tau_max_Nm"]
    wanted = p["kv_Nms_rad"] * r + s if integral else p["kv_Nms_rad"] * r
    tau = saturated(wanted, limit)  # (4) (4')
    twist = motor_speed / p["gear_ratio"] - (hub_rate - hull_rate)
    total = saturated(tau - p["km_Nms_rad"] * twist, limit)  # (5)
    if integral and abs(wanted) < limit and abs(r) < p["r_max_rad_s"]:
        s += T_S * p["ki_Nm_rad"] * r  # (7)
    return [total / p["gear_ratio"], tau, e, r], s  # (6)


@DETERMINISTIC
@given(p=gains, u=sample)
def test_pd_is_its_equations_bit_for_bit(p: dict[str, float], u: tuple[float, ...]) -> None:
    outputs = Law(pd.BLOCK, **p).step(u)
    expected, _ = by_hand(p, u, 0.0, False)
    assert outputs == expected, f"{outputs} instead of {expected}"


@DETERMINISTIC
@given(p=gains, run=st.lists(sample, min_size=1, max_size=20))
def test_pid_is_its_equations_bit_for_bit(
    p: dict[str, float], run: list[tuple[float, ...]]
) -> None:
    law, s = Law(pid.BLOCK, **p), 0.0
    for k, u in enumerate(run):
        outputs = law.step(u)
        expected, s = by_hand(p, u, s, True)
        assert outputs == expected, f"step {k}: {outputs} instead of {expected}"
        assert float(law.x[0]) == s, f"step {k}: integral {law.x[0]} instead of {s}"


@DETERMINISTIC
@given(p=gains, run=st.lists(sample, min_size=1, max_size=5))
def test_pid_without_integral_gain_is_pd(p: dict[str, float], run: list[tuple[float, ...]]) -> None:
    one, other = Law(pid.BLOCK, **(p | {"ki_Nm_rad": 0.0})), Law(pd.BLOCK, **p)
    for u in run:
        assert one.step(u) == other.step(u)


@pytest.mark.parametrize("name", LAWS)
@DETERMINISTIC
@given(p=gains, u=sample)
def test_the_motor_is_never_told_more_than_the_limit(
    name: str, p: dict[str, float], u: tuple[float, ...]
) -> None:
    motor = Law(LAWS[name], **p).step(u)[0]
    assert abs(motor) <= p["tau_max_Nm"] / p["gear_ratio"], motor


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize(
    ("given", "sign"),
    [
        ({"q_d_rad": 1e-3}, 1), ({"q_d_rate_rad_s": 1e-2}, 1), ({"encoder_rad": 1e-3}, -1),
        ({"hull_pitch_rad": 1e-3}, -1), ({"hub_rate_rad_s": 1e-2, "motor_speed_rad_s": 0.6}, -1),
        ({"motor_speed_rad_s": 0.6}, -1), ({"hull_rate_rad_s": 1e-2}, -1),
    ],
)  # fmt: skip
def test_torque_acts_against_the_error_and_the_twist(
    name: str, given: dict[str, float], sign: int
) -> None:
    motor = Law(LAWS[name]).step(inputs(**given))[0]
    assert motor * sign > 0.0, f"{given}: {motor} N m"


@pytest.mark.parametrize("name", LAWS)
def test_nothing_to_do_is_no_torque(name: str) -> None:
    moving = inputs(
        q_d_rad=0.5,
        q_d_rate_rad_s=0.25,
        encoder_rad=0.25,
        hull_pitch_rad=0.25,
        hub_rate_rad_s=0.25,
        hull_rate_rad_s=0.125,
        motor_speed_rad_s=7.5,
    )
    assert Law(LAWS[name]).step(moving) == [0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("name", LAWS)
@DETERMINISTIC
@given(hub=st.floats(-1.0, 1.0), hull=st.floats(-1.0, 1.0), km=st.floats(0.0, 1000.0))
def test_shaft_damping_is_nothing_while_the_gear_is_rigid(
    name: str, hub: float, hull: float, km: float
) -> None:
    rigid = inputs(
        q_d_rad=1e-3,
        hub_rate_rad_s=hub,
        hull_rate_rad_s=hull,
        motor_speed_rad_s=64.0 * (hub - hull),
    )
    damped, free = (
        Law(LAWS[name], gear_ratio=64.0, km_Nms_rad=gain).step(rigid)[0] for gain in (km, 0.0)
    )
    assert damped == free, f"{damped - free} N m at a rigid gear"


def test_the_integral_removes_a_constant_error_from_the_right_side() -> None:
    law = Law(pid.BLOCK)
    torques = [law.step(inputs(q_d_rad=1e-3))[1] for _ in range(1000)]
    growth = torques[-1] - torques[0]
    expected = 999 * T_S * 500.0 * 16.0 * 1e-3
    assert math.isclose(growth, expected, rel_tol=1e-12), f"{growth} N m instead of {expected}"


@pytest.mark.parametrize(
    ("given", "frozen"),
    [
        ({"q_d_rate_rad_s": 0.2999}, False),
        ({"q_d_rate_rad_s": 0.3}, True),
        ({"q_d_rate_rad_s": -5.0}, True),
    ],
)
def test_the_integral_is_frozen_at_a_large_filtered_error(
    given: dict[str, float], frozen: bool
) -> None:
    law = Law(pid.BLOCK)
    law.x[0] = 3.0
    law.step(inputs(**given))
    assert (float(law.x[0]) == 3.0) is frozen, law.x[0]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_integral_is_frozen_in_saturation(sign: float) -> None:
    law = Law(pid.BLOCK, tau_max_Nm=20.0)
    last = -1.0
    for _ in range(3000):
        law.step(inputs(q_d_rate_rad_s=sign * 0.1))
        assert abs(law.x[0]) >= last
        last = abs(float(law.x[0]))
    wanted = 11.0 + last
    assert 20.0 <= wanted < 20.0 + T_S * 500.0 * 0.1 + 1e-9, f"{wanted} N m wanted"
    law.step(inputs(q_d_rate_rad_s=-sign * 0.01))
    assert abs(law.x[0]) < last, "it does not come back"


NUMBERED = r"^    .*=.*\(\d+\)$"  # by the numbers of its file, or of the law that it varies
PARTS = {  # of several laws
    "boundary_layer", "fuzzy_widths", "gap_inverse", "network_inputs", "playout", "robot_node",
    "soft_sine", "tracking_network",
}  # fmt: skip
LAW_FILES = {n for n, m in law_lookup.shipped_laws().items() if ".plants." in m} - PARTS
assert len(LAW_FILES) > 30, LAW_FILES


@pytest.mark.parametrize("part", sorted(PARTS))
def test_every_part_of_a_law_says_its_equations(part: str) -> None:
    header = importlib.import_module(law_lookup.shipped_laws()[part]).__doc__ or ""
    assert re.search(NUMBERED, header, re.MULTILINE) and "Source" in header, part


@pytest.mark.parametrize("module", sorted(LAW_FILES))
def test_every_law_says_its_equations_and_has_a_block(module: str) -> None:
    law = importlib.import_module(law_lookup.shipped_laws()[module])
    header = law.__doc__ or ""
    assert isinstance(law.BLOCK, Block), module
    assert re.search(r"\b(N|rad|m)\b|ithout unit", header), f"{module} does not name its units"
    assert re.search(NUMBERED, header, re.MULTILINE), f"{module}: no numbered equation"
    for port in (*law.BLOCK.inputs, *law.BLOCK.outputs, *law.BLOCK.settings, *law.BLOCK.states):
        assert port.help, f"{module}.{port.name}: no meaning"
