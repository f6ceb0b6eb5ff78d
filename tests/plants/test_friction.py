"""Actuator parts by themselves: friction, gear and drive."""

import numpy as np
import pytest
from numpy.typing import NDArray

from pcpc.drivers.compiled.jit import compiled
from pcpc.plants.actuators import drive, friction, gear

FC, FS, VS, SIG0, SIG1, SIG2, VD = 2.0, 3.0, 0.01, 2e4, 60.0, 0.8, 0.02
H = 1.0 / 16000.0


@compiled()
def _bristle(v: float, clamp_s: float, steps: int, out: NDArray[np.float64]) -> None:
    """Runge-Kutta of z at constant v; out = z, T; `clamp_s` is the step told to the model."""
    g = friction.sliding(v, FC, FS, VS)
    z = 0.0
    for _ in range(steps):
        k1 = friction.lugre(v, z, g, SIG0, SIG1, SIG2, VD, clamp_s)[1]
        k2 = friction.lugre(v, z + 0.5 * H * k1, g, SIG0, SIG1, SIG2, VD, clamp_s)[1]
        k3 = friction.lugre(v, z + 0.5 * H * k2, g, SIG0, SIG1, SIG2, VD, clamp_s)[1]
        k4 = friction.lugre(v, z + H * k3, g, SIG0, SIG1, SIG2, VD, clamp_s)[1]
        z += H / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    out[0] = z
    out[1] = friction.lugre(v, z, g, SIG0, SIG1, SIG2, VD, clamp_s)[0]


def _settled(v: float, clamp_s: float = H, steps: int = 64000) -> NDArray[np.float64]:
    out = np.empty(2)
    _bristle(v, clamp_s, steps, out)
    return out


@pytest.mark.parametrize("v", [1e-3, -1e-3, 0.01, 0.3, -1.0, 2.5, 4.0, 6.0, -20.0])
def test_lugre_settles_on_the_stribeck_curve_at_any_speed(v: float) -> None:
    g = FC + (FS - FC) * np.exp(-((v / VS) ** 2))
    z, torque = _settled(v)
    assert z == pytest.approx(np.sign(v) * g / SIG0, rel=1e-6), f"bristle {z:.3e} rad"
    assert torque == pytest.approx(np.sign(v) * g + SIG2 * v, rel=1e-6), f"{torque:.6f} N m"


def test_without_the_clamp_lugre_diverges_at_speed() -> None:
    assert not abs(_settled(20.0, clamp_s=1e-9, steps=200)[0]) < 1.0


def test_lugre_is_continuous_where_the_clamp_takes_over() -> None:
    edge = 2.0 / H * FC / SIG0
    z = 0.3 * FC / SIG0
    below = friction.lugre(edge * (1 - 1e-9), z, FC, SIG0, SIG1, SIG2, VD, H)[1]
    above = friction.lugre(edge * (1 + 1e-9), z, FC, SIG0, SIG1, SIG2, VD, H)[1]
    assert above == pytest.approx(below, rel=1e-6), f"{below} and {above} rad/s"


def test_sticking_lugre_is_a_spring() -> None:
    travel_rad = 5e-6
    steps = 1000
    z, torque = _settled(travel_rad / (steps * H), steps=steps)
    assert z == pytest.approx(travel_rad, rel=0.05) and z < travel_rad
    assert torque == pytest.approx(SIG0 * travel_rad, rel=0.1), f"{torque:.4f} N m"


def test_friction_opposes_motion_and_is_odd() -> None:
    for v in (1e-4, 3e-3, 0.05, 2.0):
        g = friction.sliding(v, FC, FS, VS)
        assert friction.sliding(-v, FC, FS, VS) == g and FC <= g <= FS
        torque = friction.stribeck(v, g, 1e-3, SIG2)
        assert torque > 0.0 and friction.stribeck(-v, g, 1e-3, SIG2) == -torque
        motor = friction.coulomb_viscous(v, 0.02, 0.5, 1e-4)
        assert motor > 0.0 and friction.coulomb_viscous(-v, 0.02, 0.5, 1e-4) == -motor
        plus = friction.lugre(v, 1e-5, g, SIG0, SIG1, SIG2, VD, H)
        minus = friction.lugre(-v, -1e-5, g, SIG0, SIG1, SIG2, VD, H)
        assert minus == (-plus[0], -plus[1])


def test_friction_is_strongest_at_breakaway_and_falls_to_coulomb() -> None:
    assert friction.sliding(0.0, FC, FS, VS) == FS
    assert friction.sliding(10 * VS, FC, FS, VS) == pytest.approx(FC, abs=1e-12)


KS, CS, P0, GAP = 6e4, 40.0, 50e-6, 1e-3


def test_play_transmits_nothing_and_flanks_are_half_a_gap_away() -> None:
    for wind_up in (-0.5e-3, -0.2e-3, 0.0, 0.5e-3):
        pen = gear.penetration(wind_up, GAP)
        assert pen == 0.0 and gear.shaft_torque(pen, 1.0, KS, CS, P0) == 0.0
    assert gear.penetration(0.7e-3, GAP) == pytest.approx(0.2e-3, rel=1e-12)
    assert gear.penetration(-0.7e-3, GAP) == pytest.approx(-0.2e-3, rel=1e-12)


def test_gear_torque_is_continuous_at_touch_and_never_pulls() -> None:
    rates = np.linspace(-3.0, 3.0, 61)
    for rate in rates:
        touch = abs(gear.shaft_torque(1e-12, rate, KS, CS, P0))
        assert touch < 1e-5, f"{touch:.1e} N m at touch with {rate:.1f} rad/s"
        for pen in np.linspace(-3e-4, 3e-4, 61):
            torque = gear.shaft_torque(pen, rate, KS, CS, P0)
            assert torque * pen >= 0.0, f"pulls {torque} N m at {pen} rad, {rate} rad/s"
            assert gear.shaft_torque(-pen, -rate, KS, CS, P0) == -torque


def test_gear_is_spring_and_full_damper_beyond_the_touch_zone() -> None:
    torque = gear.shaft_torque(2e-4, 0.1, KS, CS, P0)
    assert torque == pytest.approx(KS * 2e-4 + CS * 0.1, rel=1e-12), f"{torque} N m"


PEAK, STALL, NO_LOAD = 2.0, 2.8, 314.0


@pytest.mark.parametrize(
    ("command", "speed", "expected"),
    [
        (1.0, 0.0, 1.0),
        (5.0, 0.0, 2.0),
        (-5.0, 0.0, -2.0),
        (5.0, 157.0, 1.4),
        (-5.0, 157.0, -2.0),
        (5.0, -157.0, 2.0),
        (-5.0, -157.0, -1.4),
        (5.0, 314.0, 0.0),
        (5.0, 400.0, -2.8 * (400.0 / 314.0 - 1.0)),
        (5.0, 3140.0, -2.0),
    ],
)
def test_drive_gives_what_current_and_voltage_allow(
    command: float, speed: float, expected: float
) -> None:
    torque = drive.available_torque(command, speed, PEAK, STALL, NO_LOAD)
    assert torque == pytest.approx(expected, abs=1e-12), f"{torque} N m"


def test_stall_torque_limits_a_standing_motor_with_ample_current() -> None:
    assert drive.available_torque(9.0, 0.0, 5.0, STALL, NO_LOAD) == STALL


def test_torque_loop_closes_its_error_at_its_time_constant() -> None:
    assert drive.torque_rate(0.5, 2.0, 1e-3) == pytest.approx(1500.0)
    assert drive.torque_rate(2.0, 2.0, 1e-3) == 0.0
