"""Friction at a fixed step: closed forms, a benchmark, a second way to the same solution."""

import numpy as np
import pytest
from numpy.typing import NDArray

from pcpc.drivers.compiled.jit import compiled
from pcpc.plants.actuators import lugre_implicit, sliding, stick_slip

A0, A1, A2, B1, B2 = 35.0, 1.1, 0.9, 50.0, 65.0
S0, S1, V0 = 1e5, 300.0, 0.01
Vector = NDArray[np.float64]


@compiled()
def _slide(v: float, level: float, dt: float, steps: int, out: Vector) -> None:
    """Let a unit mass slide: out = way, last speed, smallest speed."""
    x, least = 0.0, v
    for _ in range(steps):
        v = stick_slip.velocity(v, dt * level, 1.0)
        x += dt * v
        least = min(least, v)
    out[:] = (x, v, least)


def test_sliding_comes_to_rest_with_an_error_of_half_a_step() -> None:
    for dt in (1e-3, 1e-4, 1e-5):
        out = np.empty(3)
        _slide(1.0, 2.5, dt, round(0.6 / dt), out)  # way v^2/(2 a) = 0.2 m
        assert out[0] == pytest.approx(0.2 - 0.5 * dt, rel=1e-9), f"{out[0]:.7f} m at {dt} s"
        assert out[1] == 0.0 and out[2] == 0.0, f"speeds {out[1:]}, not exactly at rest"


@compiled()
def _belt(dt: float, starts: Vector) -> None:
    """Move a mass on a belt, held by a spring; write when it starts to slip."""
    x, v, t, stuck, n = 0.0, 0.0, 0.0, True, 0
    while n < len(starts):
        level = 1.0 + 0.5 * np.exp(-abs(v) / 0.05)
        v = stick_slip.velocity(v - dt * 100.0 * x, dt * level, 1.0)  # against the belt
        x += dt * (v + 0.1)
        t += dt
        if stuck and v != 0.0:
            starts[n] = t
            n += 1
        stuck = v == 0.0


@pytest.mark.parametrize(("dt", "period"), [(1e-3, 0.66712), (1e-4, 0.66677), (1e-5, 0.66673)])
def test_a_mass_on_a_belt_sticks_and_slips_with_the_known_period(dt: float, period: float) -> None:
    starts = np.empty(12 if dt < 1e-4 else 100)
    _belt(dt, starts)
    found = (starts[-1] - starts[2]) / (len(starts) - 3)
    assert found == pytest.approx(period, abs=3e-5), f"{found:.6f} s"


def _problems(n: int) -> list[tuple[Vector, Vector, Vector]]:
    rng = np.random.default_rng(3)
    found = []
    for _ in range(n):
        a = rng.normal(size=(2, 2))
        c = rng.uniform(0.0, 1.0, 2) * 10.0 ** rng.uniform(-3.0, 1.0)
        found.append((rng.normal(size=2), c, a @ a.T + 0.05 * np.eye(2)))
    return found


def _solved(p: Vector, c: Vector, m: Vector) -> Vector:
    v = stick_slip.velocities(p[0], p[1], c[0], c[1], m[0, 0], m[0, 1], m[1, 1])
    return np.array(v)


def test_two_axes_fulfil_the_inclusion_in_all_nine_states() -> None:
    states = set()
    for p, c, m in _problems(3000):
        v = _solved(p, c, m)
        states.add(tuple(np.sign(v)))
        torque = p - m @ v
        scale = np.abs(p).max() + c.max()
        for i in range(2):
            wrong = abs(torque[i] - np.sign(v[i]) * c[i]) if v[i] else max(0, abs(torque[i]) - c[i])
            assert wrong < 1e-13 * scale, f"{wrong:.1e} at p {p}, c {c}, v {v}"
    assert len(states) == 9, states


def test_projected_gauss_seidel_finds_the_same_velocities() -> None:
    for p, c, m in _problems(200):
        v = np.zeros(2)
        for _ in range(5000):
            before = v.copy()
            for i in range(2):
                free = p[i] - m[i, 1 - i] * v[1 - i]
                v[i] = np.sign(free) * max(abs(free) - c[i], 0.0) / m[i, i]
            if np.abs(v - before).max() < 1e-15:
                break
        error = np.abs(v - _solved(p, c, m)).max()
        assert error < 1e-11 * (1.0 + np.abs(v).max()), f"{error:.1e} at p {p}, c {c}"


def test_one_axis_is_two_axes_without_coupling() -> None:
    for p, c, m in _problems(200):
        v1, v2 = stick_slip.velocities(p[0], p[1], c[0], c[1], m[0, 0], 0.0, m[1, 1])
        assert v1 == pytest.approx(stick_slip.velocity(p[0], c[0], m[0, 0]), rel=1e-15)
        assert v2 == pytest.approx(stick_slip.velocity(p[1], c[1], m[1, 1]), rel=1e-15)


def test_the_levels_are_the_books_at_rest_and_at_speed() -> None:
    def joint_1(speed: float) -> float:
        return float(sliding.exponential(speed, A0, A1, A2, B1, B2))

    assert joint_1(0.0) == pytest.approx(36.1, abs=1e-12), joint_1(0.0)
    assert joint_1(0.02) == pytest.approx(36.06, abs=0.005), joint_1(0.02)
    assert joint_1(0.3) == pytest.approx(35.9, abs=0.005), joint_1(0.3)
    assert joint_1(1e-4) > joint_1(0.0), "the slope at rest is positive: a2 B2 > a1 B1"
    assert sliding.coulomb(A0) == sliding.viscous(0.0, A0, 2.0) == A0
    assert sliding.empirical(0.1, A0, A1, B1, 2.0) == pytest.approx(
        A0 + A1 * np.exp(-5.0) + 0.2, rel=1e-15
    )


@compiled()
def _lugre(torque: float, mass: float, ramp_s: float, dt: float, out: Vector) -> None:
    """Move an inertia by a torque that rises within `ramp_s`, or a sine of 1 Hz where that is 0.

    out = largest angle, last speed, largest |z|.
    """
    v, z, x, way, most = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(int((1.2 * ramp_s or 1.0) / dt)):
        t = k * dt
        tau = torque * min(1.0, t / ramp_s) if ramp_s else torque * np.sin(2.0 * np.pi * t)
        a = lugre_implicit.bristle_rate(v, S0, A0, A1, V0)
        slope, offset = lugre_implicit.torque_line(z, a, S0, S1, A2, dt)
        v = lugre_implicit.velocity(mass * v + dt * tau, slope, offset, mass, dt)
        z = lugre_implicit.bristle(z, v, a, dt)
        x += dt * v
        way, most = max(way, abs(x)), max(most, abs(z))
    out[:] = (way, v, most)


def _bristles(torque: float, mass: float, ramp_s: float, dt: float) -> Vector:
    out = np.empty(3)
    _lugre(torque, mass, ramp_s, dt, out)
    return out


def test_slow_presliding_is_the_closed_form() -> None:
    z_max = (A0 + A1) / S0
    exact = -z_max * np.log(1.0 - 30.0 / (A0 + A1))  # dz/dx = 1 - z/z_max, s0 z = 30 N m
    way, speed, _ = _bristles(30.0, 1.0, 20.0, 1e-3)
    assert way == pytest.approx(exact, rel=6e-3), f"{1e6 * way:.2f} urad, not {1e6 * exact:.2f}"
    assert abs(speed) < 1e-6, f"{speed:.1e} rad/s: it creeps"


@pytest.mark.parametrize(("dt", "urad"), [(1e-3, 671.0), (1e-4, 657.0), (1e-5, 655.5)])
def test_presliding_under_a_sine_has_the_known_amplitude(dt: float, urad: float) -> None:
    way = 1e6 * _bristles(30.0, 2.3, 0.0, dt)[0]
    assert way == pytest.approx(urad, abs=1.0), f"{way:.2f} urad"


@pytest.mark.parametrize("torque", [30.0, 40.0, 3000.0])
def test_the_bristles_stay_within_break_away(torque: float) -> None:
    for dt in (1e-4, 1e-5):
        _, speed, z = _bristles(torque, 1.0, 0.1, dt)
        assert z <= (A0 + A1) / S0, f"s0 |z| {S0 * z:.3f} N m at {dt} s"
    if torque > 1e3:
        assert speed > 100.0, f"{speed:.1f} rad/s"


def test_a_coarse_step_adds_to_the_bristles_what_the_header_says_and_no_more() -> None:
    _, _, z = _bristles(3000.0, 1.0, 0.1, 1e-3)
    excess = z - (A0 + A1) / S0
    assert 0.0 < excess < 1e-3 * 1e-3 * 3000.0, f"{excess:.2e} rad"  # dt (|v+| - |v|) < dt^2 tau/m


def test_two_axes_of_lugre_without_coupling_are_one_axis_each() -> None:
    v1, v2 = lugre_implicit.velocities(0.3 - 1e-3 * 2.0, -0.2, 500.0, 300.0, 2.0, 0.0, 1.5, 1e-3)
    assert v1 == pytest.approx(lugre_implicit.velocity(0.3, 500.0, 2.0, 2.0, 1e-3), rel=1e-15)
    assert v2 == pytest.approx(lugre_implicit.velocity(-0.2, 300.0, 0.0, 1.5, 1e-3), rel=1e-15)
