"""`pcpc experiment actuators`: a gallery of all actuator nonlinearities, and what they satisfy.

Fifteen small experiments with the compiled functions of plants/actuators, drawn side by side
in figures/actuators.png; results.md holds the figures with a closed form or a limit to compare.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.plants.actuators import (
    backlash,
    deadzone,
    drive,
    friction,
    gear,
    lugre_implicit,
    sliding,
    stick_slip,
)
from pcpc.plants.pages import BLACK, BLUE, GREEN, GREY, ORANGE, VERMILION
from pcpc.tools.study.book._gallery import Row, gallery
from pcpc.tools.terminal.progress import Progress

Vector = NDArray[np.float64]

# Friction of a small joint, N m and rad/s, with a dip that can be seen
COULOMB, BREAKAWAY, STRIBECK, VISCOUS = 1.0, 1.6, 0.05, 0.4
BRISTLE, BRISTLE_DAMPING = 1e4, 60.0
GAP = (0.4, -0.3)  # of the backlash, and deadzone's edges
SLOPES = (1.5, 0.8)


def run(folder: Path, progress: Progress, jobs: int | None) -> int:
    """Write results.md and the gallery; return 0."""
    progress.show("actuators: compiling and drawing")
    head = ("what", "measured", "exact, or the limit")
    return gallery(
        folder, progress, "actuators", "Actuator nonlinearities", head, PANELS, (13, 17), 5, 7.5
    )


def each(function: Callable[..., float], values: Vector, *rest: float) -> Vector:
    """Return the function at every value."""
    return np.array([function(float(value), *rest) for value in values])


def static_friction(ax: Any) -> None:
    """Draw the four static models with their jump at zero."""
    speed = np.linspace(0.0, 1.0, 300)
    models = {
        "Coulomb": np.full_like(speed, sliding.coulomb(COULOMB)),
        "Coulomb and viscous": each(sliding.viscous, speed, COULOMB, VISCOUS),
        "empirical": each(sliding.empirical, speed, COULOMB, 0.6, 15.0, VISCOUS),
        "exponential": each(sliding.exponential, speed, COULOMB, 0.6, 0.3, 15.0, 4.0),
    }
    both = np.concatenate((-speed[::-1], speed))
    for (name, level), colour in zip(models.items(), (BLACK, BLUE, VERMILION, GREEN), strict=True):
        ax.plot(both, np.concatenate((-level[::-1], level)), color=colour, label=name)
    _label(ax, "static friction", "speed [rad/s]", "torque [N m]")


def smooth_friction(ax: Any) -> None:
    """Draw the smoothed curves that an explicit integrator can take."""
    v = np.linspace(-0.3, 0.3, 600)
    curve = [friction.stribeck(x, _sliding(x), 0.005, VISCOUS) for x in v]
    ax.plot(v, curve, color=VERMILION, label="Stribeck, tanh")
    coulomb = each(friction.coulomb_viscous, v, COULOMB, 0.005, VISCOUS)
    ax.plot(v, coulomb, color=BLACK, label="Coulomb, tanh")
    _label(ax, "smoothed friction: it creeps at rest", "speed [rad/s]", "torque [N m]")


def _sliding(v: float) -> float:
    return float(friction.sliding(v, COULOMB, BREAKAWAY, STRIBECK))


def driven_lugre(speed: Vector, dt: float) -> tuple[Vector, Vector]:
    """Return LuGre torque and bristle deflection under a prescribed speed."""
    torque, deflection, z = np.empty_like(speed), np.empty_like(speed), 0.0
    for k, v in enumerate(map(float, speed)):
        a = lugre_implicit.bristle_rate(v, BRISTLE, COULOMB, BREAKAWAY - COULOMB, STRIBECK)
        slope, offset = lugre_implicit.torque_line(z, a, BRISTLE, BRISTLE_DAMPING, VISCOUS, dt)
        torque[k] = slope * v + offset
        z = deflection[k] = lugre_implicit.bristle(z, v, a, dt)
    return torque, deflection


def lugre_at_speed(ax: Any) -> list[Row]:
    """Draw frictional lag: the loop that widens with frequency."""
    dt, largest = 1e-4, 0.0
    for frequency_hz, colour in ((1.0, BLUE), (5.0, VERMILION)):
        t = np.arange(0.0, 2.0 / frequency_hz, dt)
        v = 0.1 + 0.1 * np.sin(2.0 * np.pi * frequency_hz * t)
        torque, z = driven_lugre(v, dt)
        half = len(t) // 2
        ax.plot(v[half:], torque[half:], color=colour, label=f"LuGre, {frequency_hz:g} Hz")
        largest = max(largest, float(np.abs(z).max()))
    v = np.linspace(0.0, 0.2, 200)
    ax.plot(v, [_sliding(x) + VISCOUS * x for x in v], color=GREY, linestyle="--", label="steady")
    _label(ax, "LuGre: friction lags the speed", "speed [rad/s]", "torque [N m]")
    return [("largest bristle deflection, mrad", f"{1e3 * largest:.4f}",
             f"at most {1e3 * BREAKAWAY / BRISTLE:.4f}")]  # fmt: skip


def lugre_presliding(ax: Any) -> None:
    """Draw the hysteresis of small motions."""
    dt = 1e-4
    t = np.arange(0.0, 3.0, dt)
    amplitude = 1.2e-4 * (0.3 + 0.35 * np.floor(t))
    x = amplitude * np.sin(2.0 * np.pi * t)
    torque, _ = driven_lugre(np.gradient(x, dt), dt)
    ax.plot(1e3 * x, torque, color=GREEN, linewidth=0.9, label="LuGre before it slides")
    _label(ax, "LuGre: presliding", "position [mrad]", "torque [N m]")


def coming_to_rest(ax: Any) -> list[Row]:
    """Draw a mass that slides to rest, with the set-valued step and with sgn in an explicit one."""
    rows = []
    for dt, colour in ((1e-2, ORANGE), (1e-3, BLUE)):
        t = np.arange(0.0, 0.4, dt)
        implicit, explicit = np.full_like(t, 1.0), np.full_like(t, 1.0)
        for k in range(1, len(t)):
            implicit[k] = stick_slip.velocity(float(implicit[k - 1]), dt * 5.0, 1.0)
            explicit[k] = explicit[k - 1] - dt * 5.0 * np.sign(explicit[k - 1])
        place = float(np.argmax(implicit == 0.0) * dt)
        rows.append((f"sliding to rest, s, step {dt:g} s", f"{place:.4f}", "0.2"))
        ax.plot(t, implicit, color=colour, label=f"set-valued step, {1e3 * dt:g} ms")
        if dt > 5e-3:
            ax.plot(t, explicit, color=VERMILION, linewidth=0.8, label="sgn in an explicit step")
    ax.set_ylim(-0.1, 0.6)
    ax.set_xlim(0.08, 0.3)
    rows.append(("velocity at rest, m/s", f"{implicit[-1]:g}", "0 exactly"))
    _label(ax, "coming to rest", "time [s]", "velocity [m/s]")
    return rows


def belt(dt: float, end_s: float) -> tuple[Vector, Vector]:
    """Return time and position of a mass on a belt: m 1 kg, k 100 N/m, belt 0.1 m/s, 1 to 1.5 N."""
    t = np.arange(0.0, end_s, dt)
    x, v, place = 0.0, 0.0, np.empty_like(t)
    for k in range(len(t)):
        slip = v - 0.1
        level = sliding.empirical(abs(slip), 1.0, 0.5, 20.0, 0.0)
        slip = stick_slip.velocity(slip - dt * 100.0 * x, dt * level, 1.0)
        v = slip + 0.1
        x += dt * v
        place[k] = x
    return t, place


def stick_slip_belt(ax: Any) -> list[Row]:
    """Draw the mass on the belt and return its period at two steps."""
    rows = []
    for dt, expected in ((1e-3, 0.66712), (1e-4, 0.66677)):
        t, x = belt(dt, 6.0)
        rising = np.flatnonzero((x[1:] >= 0.005) & (x[:-1] < 0.005) & (t[1:] > 2.0))
        exact = t[rising] + dt * (0.005 - x[rising]) / (x[rising + 1] - x[rising])
        period = float(np.diff(exact).mean())
        rows.append(
            (
                f"belt stick-slip, period in s, step {dt:g} s",
                f"{period:.5f}",
                f"0.666731 exactly; {expected:.5f} of another implementation",
            )
        )
    ax.plot(t, 1e3 * x, color=BLUE, label="spring is stretched, then slips")
    ax.set_xlim(2.0, 4.5)
    ax.set_ylim(-5.0, 30.0)
    _label(ax, "stick-slip on a belt", "time [s]", "position [mm]")
    return rows


def deadzone_curves(ax: Any) -> list[Row]:
    """Draw the deadzone, its inverse and what both come to."""
    u = np.linspace(-2.0, 2.0, 801)
    edges = (GAP[0], -GAP[1], *SLOPES)
    ax.plot(u, each(deadzone.deadzone, u, *edges), color=BLUE, label="deadzone")
    inverse = each(deadzone.deadzone_inverse, u, *edges)
    ax.plot(u, inverse, color=ORANGE, label="its inverse")
    through = each(deadzone.deadzone, inverse, *edges)
    ax.plot(u, through, color=BLACK, linestyle=":", label="one after the other")
    _label(ax, "deadzone", "input", "output")
    worst = float(np.abs(through - u).max())
    return [("deadzone after its inverse, largest error", f"{worst:.1e}", "0 to rounding")]


def deadzone_in_time(ax: Any) -> None:
    """Draw what a deadzone makes of a sine."""
    t = np.linspace(0.0, 2.0, 801)
    w = np.sin(2.0 * np.pi * t)
    edges = (GAP[0], -GAP[1], *SLOPES)
    ax.plot(t, w, color=GREY, linestyle="--", label="wanted")
    ax.plot(t, each(deadzone.deadzone, w, *edges), color=BLUE, label="through the deadzone")
    u = each(deadzone.deadzone_inverse, w, *edges)
    ax.plot(t, u, color=ORANGE, linewidth=0.9, label="precompensated input")
    ax.set_ylim(-2.6, 1.3)
    _label(ax, "a sine through the deadzone", "time [s]", "")


def output_deadzone(ax: Any) -> list[Row]:
    """Draw what is known behind a deadzone at the output."""
    y = np.linspace(-2.0, 2.0, 801)
    edges = (GAP[0], -GAP[1], *SLOPES)
    z = each(deadzone.deadzone, y, *edges)
    guess = each(deadzone.output_estimate, z, *edges)
    ax.plot(y, z, color=BLUE, label="measured")
    ax.plot(y, y, color=GREY, linestyle="--", label="true")
    ax.plot(y, guess, color=ORANGE, label="estimated from it")
    _label(ax, "deadzone at the output: the band is lost", "output", "")
    inside = z == 0.0
    lost, kept = np.abs(guess - y)[inside].max(), np.abs(guess - y)[~inside].max()
    half = 0.5 * (GAP[0] - GAP[1])
    return [
        (
            "output estimated behind a deadzone, largest error in the band",
            f"{lost:.4f}",
            f"{half:.4f}, half of its width",
        ),
        ("the same outside", f"{kept:.1e}", "0 to rounding"),
    ]


def tracking_run(load: float, amplitude: float, estimates: bool) -> tuple[Vector, Vector, Vector]:
    """Return time, reference and output of y' = 20 (r - y^) + r' + load, sensor D(y), slopes 1."""
    dt = 1e-3
    t = np.arange(0.0, 2.0, dt)
    r, y, out = amplitude * np.sin(2.0 * np.pi * t), 0.0, np.empty_like(t)
    edges = (GAP[0], -GAP[1])
    rate = np.gradient(r, dt)
    for k in range(len(t)):
        out[k] = y
        z = deadzone.deadzone(y, *edges)
        known = deadzone.output_estimate(z, *edges) if estimates else z
        y += dt * (20.0 * (r[k] - known) + rate[k] + load)
    return t, r, out


def output_deadzone_loop(ax: Any) -> None:
    """Draw a loop that follows a sine by a sensor with a deadzone, without and with an estimate."""
    t, r, plain = tracking_run(0.0, 1.0, False)
    ax.plot(t, r, color=GREY, linestyle="--", label="reference")
    ax.plot(t, plain, color=BLUE, label="loop on the measurement")
    ax.plot(
        t, tracking_run(0.0, 1.0, True)[2], color=ORANGE, linewidth=0.9, label="on the estimate"
    )
    ax.set_ylim(-1.4, 2.4)
    _label(ax, "a loop with a deadzone in its sensor", "time [s]", "output")


def output_deadzone_rest(ax: Any) -> list[Row]:
    """Draw the same loop at rest: a load drives the output to the edge, whatever is estimated."""
    rows = []
    for estimates, colour in ((False, BLUE), (True, ORANGE)):
        t, r, y = tracking_run(4.0, 0.0, estimates)
        name = "on the estimate" if estimates else "loop on the measurement"
        ax.plot(t, y, color=colour, linewidth=0.9, label=name)
        rows.append(
            (
                f"at rest under a load, {name}: last output",
                f"{y[-1]:.3f}",
                f"not below the edge, {GAP[0]:g}",
            )
        )
    ax.plot(t, r, color=GREY, linestyle="--", label="reference")
    ax.axhspan(*sorted(GAP), color="#F3E8D2", linewidth=0, label="deadzone")
    _label(ax, "the same under a load: the band stays unseen", "time [s]", "output")
    return rows


def backlash_loop(ax: Any) -> None:
    """Draw input and output of the play operator for a growing and a shrinking sine."""
    t = np.linspace(0.0, 4.0, 1601)
    u = (0.3 + 0.35 * t) * np.sin(2.0 * np.pi * t)
    tau, out = 0.0, np.empty_like(u)
    for k, value in enumerate(map(float, u)):
        tau = out[k] = backlash.backlash(tau, value, *GAP)
    ax.plot(u, out, color=BLUE, linewidth=0.9, label="backlash")
    for edge in GAP:
        ax.plot(u, u - edge, color=GREY, linewidth=0.6, linestyle=":")
    _label(ax, "backlash: the play operator", "input", "output")


def backlash_inverse(ax: Any) -> list[Row]:
    """Draw the inverse, which jumps over the gap where the wanted output turns."""
    t = np.linspace(0.0, 2.0, 801)
    w = np.sin(2.0 * np.pi * t)
    u, tau = GAP[0], 0.0
    inputs, outputs, plain = np.empty_like(w), np.empty_like(w), np.empty_like(w)
    lost = 0.0
    for k in range(len(w)):
        u = inputs[k] = backlash.backlash_inverse(u, float(w[max(k - 1, 0)]), float(w[k]), *GAP)
        tau = outputs[k] = backlash.backlash(tau, u, *GAP)
        lost = plain[k] = backlash.backlash(lost, float(w[k]), *GAP)
    ax.plot(t, w, color=GREY, linestyle="--", label="wanted")
    ax.plot(t, plain, color=BLUE, label="through the gap")
    ax.plot(t, inputs, color=ORANGE, linewidth=0.9, label="input by the inverse")
    ax.set_ylim(-1.5, 2.5)
    _label(ax, "a sine through the gap", "time [s]", "")
    worst = float(np.abs(outputs - w).max())
    return [("backlash after its inverse, largest error", f"{worst:.1e}", "0 to rounding")]


def gear_torque(ax: Any) -> None:
    """Draw the torque of a gear with play, at three speeds of wind-up."""
    wind_up = np.linspace(-1.5e-3, 1.5e-3, 600)
    for rate, colour in ((0.0, BLACK), (0.3, BLUE), (-0.3, VERMILION)):
        torque = [
            gear.shaft_torque(gear.penetration(x, 1e-3), rate, 6e4, 40.0, 50e-6) for x in wind_up
        ]
        ax.plot(1e3 * wind_up, torque, color=colour, label=f"{rate:g} rad/s")
    _label(ax, "gear with play, spring and damper", "wind-up [mrad]", "torque [N m]")


def drive_limits(ax: Any) -> None:
    """Draw which torque a drive can give at which speed."""
    speed = np.linspace(-500.0, 500.0, 400)
    for command, colour in ((2.0, BLACK), (1.0, BLUE), (-1.0, VERMILION)):
        torque = [drive.available_torque(command, w, 2.0, 4.0, 400.0) for w in speed]
        ax.plot(speed, torque, color=colour, label=f"command {command:g} N m")
    _label(ax, "drive: peak and voltage limits", "speed [rad/s]", "torque [N m]")


def _label(ax: Any, title: str, x: str, y: str) -> None:
    ax.set_title(title, fontsize=10)
    ax.set_xlabel(x, fontsize=8)
    ax.set_ylabel(y, fontsize=8)


PANELS: tuple[Callable[[Any], list[Row] | None], ...] = (
    static_friction, smooth_friction, lugre_at_speed, lugre_presliding, coming_to_rest,
    stick_slip_belt, deadzone_curves, deadzone_in_time, output_deadzone, output_deadzone_loop,
    output_deadzone_rest, backlash_loop, backlash_inverse, gear_torque, drive_limits,
)  # fmt: skip
