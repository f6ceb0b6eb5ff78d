"""Hull pitch as a sum of sines, with its exact derivatives and the heave of the trunnion.

    phi     = sum A_i sin(a_i),  a_i = w_i t + p_i                                         (1)
    phi'    = sum A_i w_i cos(a_i),   phi'' = -sum A_i w_i^2 sin(a_i)                      (2)
    heave'' = l sum A_i w_i^2 cos(a_i + b)                                                 (3)
    sin, cos(a_i + w_i h/2) from sin, cos(a_i) by a rotation                               (4)

rad, s, m; l is the lever, b the heave phase. The sines are computed once at the start of a control
period; (4) carries them through its 2 x substeps half steps, so that rounding does not add up.
Record 1 has three given sines; record 2 has 24 with random frequencies and phases:

    A_i ~ 1/sqrt((w0^2 - w_i^2)^2 + (2 zeta w0 w_i)^2), scaled to the rms                  (5)
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.emath import sincos
from pcpc.plants.atb1000.ports import HULL_COMPONENTS, Parameters

NONE, THREE_SINES, RANDOM = 0.0, 1.0, 2.0

Vector = NDArray[np.float64]


def components(settings: Mapping[str, float]) -> tuple[Vector, Vector, Vector]:
    """Return amplitudes (rad), angular frequencies (rad/s) and phases (rad), each (n,), n <= 24.

    Raises ValueError if `hull_motion` is none of 0, 1, 2.
    """
    kind = settings["hull_motion"]
    if kind == NONE:
        return np.empty(0), np.empty(0), np.empty(0)
    if kind == THREE_SINES:
        names = ("amplitude_rad", "frequency_hz", "phase_rad")
        rows = [[settings[f"hull{i}_{name}"] for i in (1, 2, 3)] for name in names]
        return np.array(rows[0]), 2.0 * np.pi * np.array(rows[1]), np.array(rows[2])
    if kind == RANDOM:
        return _random_sea(settings)
    raise ValueError(f"hull_motion is {kind}; expected 0 (none), 1 (three sines) or 2 (random)")


def _random_sea(settings: Mapping[str, float]) -> tuple[Vector, Vector, Vector]:
    rng = np.random.default_rng(int(settings["hullrand_seed"]))
    shift = settings["hullrand_shift_hz"]
    first, last = settings["hullrand_first_hz"], settings["hullrand_last_hz"]
    i = np.arange(HULL_COMPONENTS)
    hz = first + (last - first) * i / (HULL_COMPONENTS - 1)
    hz = hz + rng.uniform(-shift, shift, HULL_COMPONENTS)
    phase = rng.uniform(0.0, 2.0 * np.pi, HULL_COMPONENTS)
    w, w0 = 2.0 * np.pi * hz, 2.0 * np.pi * settings["hullrand_peak_hz"]
    amplitude = 1.0 / np.sqrt((w0**2 - w**2) ** 2 + (2.0 * settings["hullrand_zeta"] * w0 * w) ** 2)
    scale = np.sqrt(2.0) * settings["hullrand_rms_rad"] / np.sqrt(np.sum(amplitude**2))  # (5)
    return amplitude * scale, w, phase


@inline
def start(t: float, p: Parameters, sines: Array) -> None:
    """Write sin(a_i), then cos(a_i), at time t to `sines` (2, 24)."""
    for i in range(int(p.hull_sines)):
        s, c = sincos(p.hull_omega_rad_s[i] * t + p.hull_phase_rad[i])
        sines[0, i] = s
        sines[1, i] = c


@inline
def advance(p: Parameters, sines: Array) -> None:
    """Turn `sines` (2, 24) on by half an integration step: eq. (4)."""
    for i in range(int(p.hull_sines)):
        s, c = sines[0, i], sines[1, i]
        sines[0, i] = s * p.hull_turn_cos[i] + c * p.hull_turn_sin[i]
        sines[1, i] = c * p.hull_turn_cos[i] - s * p.hull_turn_sin[i]


@inline
def motion(p: Parameters, sines: Array) -> tuple[float, float, float, float]:
    """Return pitch, its rate and acceleration, and the heave acceleration: eq. (1) to (3).

    `sines`: (2, 24).
    """
    pitch, rate, sine_sum, cosine_sum = 0.0, 0.0, 0.0, 0.0
    for i in range(int(p.hull_sines)):
        s, c = sines[0, i], sines[1, i]
        amplitude, w = p.hull_amplitude_rad[i], p.hull_omega_rad_s[i]
        pitch += amplitude * s
        rate += amplitude * w * c
        sine_sum += amplitude * w * w * s
        cosine_sum += amplitude * w * w * c
    return pitch, rate, -sine_sum, p.heave_cos_m * cosine_sum - p.heave_sin_m * sine_sum
