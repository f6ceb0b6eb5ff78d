"""The Runge-Kutta step against closed forms: its order, its coefficients, energy, time."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pcpc.executive.laws.block import Block, Nothing, Ports, group, inline, port, stage
from pcpc.plants.integrate import runge_kutta, scratch

Vector = NDArray[np.float64]


class Motion(Ports):
    """Two undamped oscillators."""

    q_rad = port("rad", "angles", shape=2)
    v_rad_s = port("rad/s", "rates", shape=2)


class Area(Ports):
    """The integral of a polynomial of time."""

    area = port("s", "the integral", recorded=False)


class States(Ports):
    """Both, and what the integrator needs."""

    motion = group(Motion, "x_")
    area = group(Area)
    of_motion = group(scratch(Motion), "motion_")
    of_area = group(scratch(Area), "area_")


class Parameters(Ports):
    """Angular frequencies and powers of time."""

    w_rad_s = port("rad/s", "angular frequency", shape=2)
    power = port("", "of time")


@inline
def swing(t: float, p: Any, w: Any, x: Any, d: Any) -> None:
    """Write q'' = -w^2 q + torque."""
    for j in range(len(x.q_rad)):
        d.q_rad[j] = x.v_rad_s[j]
        d.v_rad_s[j] = w.torque - p.w_rad_s[j] * p.w_rad_s[j] * x.q_rad[j]


@inline
def power_of_time(t: float, p: Any, w: Any, x: Any, d: Any) -> None:
    """Write t^power."""
    d.area = 1.0
    for _ in range(int(p.power)):
        d.area *= t


class Torque(Ports):
    """What is held over a step."""

    torque = port("", "of both")


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Torque, y: Nothing) -> None:
    """Advance both from t to t + dt."""
    runge_kutta(swing, t, dt, p, u, x.motion, x.of_motion)
    runge_kutta(power_of_time, t, dt, p, u, x.area, x.of_area)


W = np.array((1.3, 2.9))
START = np.array((0.4, -0.7, 1.1, 0.2))


def after(h: float, steps: int, torque: float = 0.0, power: float = 0.0) -> Vector:
    """Return q, v and the area after some steps."""
    x = np.zeros(States.size)
    x[:4] = START
    for k in range(steps):
        step(k * h, h, np.array((*W, power)), x, np.array((torque,)), np.zeros(0))
    return x[:5]


def closed(t: float, torque: float) -> Vector:
    """Return q and v of the oscillators at t."""
    rest, s, c = torque / W**2, np.sin(W * t), np.cos(W * t)
    q, v = START[:2] - rest, START[2:]
    return np.concatenate((rest + q * c + v / W * s, v * c - q * W * s))


@pytest.mark.parametrize("torque", [0.0, 0.8])
def test_the_error_goes_with_the_fourth_power_of_the_step(torque: float) -> None:
    counts = (50, 100, 200, 400)
    errors = [np.abs(after(2.0 / n, n, torque)[:4] - closed(2.0, torque)).max() for n in counts]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert errors[0] > 1e-7 and (np.abs(orders - 4.0) < 0.06).all(), f"{orders} of {errors}"


def test_one_step_is_the_taylor_series_to_h4() -> None:
    h = 0.1
    swings = np.kron(np.array(((0.0, 1.0), (0.0, 0.0))), np.eye(2))
    swings[2:, :2] = -np.diag(W**2)
    term, series = START, START.copy()
    for n in range(1, 5):
        term = h / n * swings @ term
        series = series + term
    wrong = np.abs(after(h, 1)[:4] - series).max()
    assert wrong < 4e-16, f"{wrong:.1e}"


def test_the_energy_of_an_oscillator_falls_by_its_sixth_power_over_72() -> None:
    """|R(iz)|^2 = 1 - z^6/72 + z^8/576 a step, z = h w."""
    h, steps = 0.05, 400
    q, v = np.split(after(h, steps)[:4], 2)
    energy = (v**2 + (W * q) ** 2) / (START[2:] ** 2 + (W * START[:2]) ** 2)
    z = h * W
    expected = (1.0 - z**6 / 72.0 + z**8 / 576.0) ** steps
    assert np.abs(energy - expected).max() < 1e-13, f"{energy} of {expected}"


@pytest.mark.parametrize("power", [0, 1, 2, 3])
def test_the_stages_are_at_their_times(power: int) -> None:
    """Simpson's rule is exact for polynomials of degree 3."""
    area = after(0.25, 8, power=float(power))[4]
    assert area == pytest.approx(2.0 ** (power + 1) / (power + 1), rel=1e-15)


def test_its_memory_is_not_recorded_and_has_names_of_its_own() -> None:
    recorded = [one.name for one in Block(step).states if one.recorded]
    assert recorded == ["x_q_rad", "x_v_rad_s"], recorded
    assert scratch(Motion).size == 3 * Motion.size
