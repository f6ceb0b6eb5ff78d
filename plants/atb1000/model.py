"""The barrel plant as one block: motor torque command in, unrounded sensor samples and truths out.

    call k of `step` at t = k dt:  k = 0  samples of the initial state; nothing else happens
                                   k > 0  integrate [t - dt, t] with the command held so far,
                                          latch the input, then sample at t

So a command computed from the samples of t_k, an input at the call of t_k+1, acts from t_k+1: one
sample of delay. Classic Runge-Kutta over all 16 states with n whole steps of h = dt/n; hull motion
and firing are functions of time, evaluated at h/2. Equations: dynamics.py; names and units:
ports.py; nominal figures: parameters.yaml. At the start the barrel rests under gravity at theta0,
the gear lies on the flank that carries the load, rotor and hub have no relative rate, and the drive
holds.
"""

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Prepared, stage
from pcpc.executive.laws.emath import clip, cos, sin, sincos, where
from pcpc.plants.atb1000 import dynamics as dyn
from pcpc.plants.atb1000 import hull
from pcpc.plants.atb1000 import ports as at
from pcpc.plants.atb1000.beam import GRAVITY_M_S2, Beam, Tube, modal_data
from pcpc.plants.atb1000.ports import (
    HULL_COMPONENTS,
    INPUTS,
    INTEGRATED,
    NOISY_CHANNELS,
    OUTPUTS,
    PARAMETERS,
    SETTINGS,
    STATES,
    offsets,
)
from pcpc.plants.noise import STREAM_SIZE, seeded
from pcpc.plants.sensors import noisy

PI = 3.141592653589793

_P, _X = offsets(PARAMETERS), offsets(STATES)
SUBSTEPS, DROOP, NOISE = _P["substeps"], _P["horizontal_droop_rad"], _P["hub_gyro_noise_rad_s"]
FIRE, FIRE_HUB, FIRE_MUZZLE = _P["fire"], _P["fire_hub_Nm"], _P["fire_muzzle_N"]
HELD, RNG = _X["x_held_Nm"], _X["rng"]
SLOPES = _X["scratch"]
TOTAL, STAGE_STATE = SLOPES + INTEGRATED, SLOPES + 2 * INTEGRATED
EXTERNAL = SLOPES + 3 * INTEGRATED
SINES = EXTERNAL + dyn.EXTERNAL
WEIGHT = (1.0, 2.0, 2.0, 1.0)  # classic Runge-Kutta: of the slopes, over 6
REACH = (0.5, 0.5, 1.0, 0.0)  # how far a stage's slope carries to the next stage, in steps


@inline
def half_sine(t: float, p: Any, at: int) -> float:
    """Return the impulse whose peak, start and length are p[at], p[at + 1], p[at + 2]."""
    phase = clip((t - p[at + 1]) / p[at + 2], 0.0, 1.0)
    return where(phase < 1.0, p[at] * sin(PI * phase), 0.0)


@inline
def external(t: float, p: Any, sines: Any, w: Any) -> None:
    """Write hull motion and firing at time t to `w`; `sines` stand at t."""
    w[dyn.PITCH], w[dyn.PITCH_RATE], w[dyn.PITCH_ACC], w[dyn.HEAVE_ACC] = hull.motion(p, sines)
    hub_moment, muzzle_force = 0.0, 0.0
    if p[FIRE] > 0.0:
        hub_moment = half_sine(t, p, FIRE_HUB)
        muzzle_force = half_sine(t, p, FIRE_MUZZLE)
    w[dyn.HUB_MOMENT], w[dyn.MUZZLE_FORCE] = hub_moment, muzzle_force


@inline
def integrate(start: float, h: float, p: Any, x: Any) -> None:
    """Advance the first 16 states by steps of `h` from `start`, where the inputs `w` stand."""
    s, k = tail(x, 0), tail(x, SLOPES)
    total, at_stage = tail(x, TOTAL), tail(x, STAGE_STATE)
    w, sines = tail(x, EXTERNAL), tail(x, SINES)
    for n in range(int(p[SUBSTEPS])):
        for i in range(INTEGRATED):
            total[i] = 0.0
            at_stage[i] = s[i]
        for j in range(4):
            dyn.derivative(p, at_stage, w, k)
            for i in range(INTEGRATED):
                total[i] += WEIGHT[j] * k[i]
                at_stage[i] = s[i] + REACH[j] * h * k[i]
            if j == 0 or j == 2:
                hull.advance(p, sines)
                external(start + (n + 0.5 + 0.25 * j) * h, p, sines, w)
        for i in range(INTEGRATED):
            s[i] += h / 6.0 * total[i]


@inline
def sample_sensors(p: Any, x: Any, y: Any) -> None:
    """Write the ten sensor samples to `y`, one noise draw per noisy channel."""
    s, w = tail(x, 0), tail(x, EXTERNAL)
    y[at.ENCODER] = s[dyn.THETA] - w[dyn.PITCH]
    y[at.HUB_RATE] = s[dyn.HUB_GYRO]
    y[at.MUZZLE_RATE] = s[dyn.MUZZLE_GYRO]
    y[at.HULL_PITCH] = w[dyn.PITCH]
    y[at.HULL_RATE] = w[dyn.PITCH_RATE]
    y[at.STRAIN] = s[dyn.ROOT_STRAIN]
    y[at.SHAFT_TORQUE] = s[dyn.SHAFT_TORQUE]
    y[at.MOTOR_SPEED] = s[dyn.MOTOR_SPEED]
    y[at.MOTOR_TORQUE] = s[dyn.MOTOR_TORQUE]
    y[at.MOTOR_ANGLE] = s[dyn.MOTOR_ANGLE]
    for i in range(NOISY_CHANNELS):
        channel = at.NOISY + i
        y[channel] = noisy(y[channel], p[NOISE + i], x, RNG + i * STREAM_SIZE)


@inline
def report_truth(p: Any, x: Any, y: Any) -> None:
    """Write the noiseless outputs to `y`, after the ten sensors."""
    s, w = tail(x, 0), tail(x, EXTERNAL)
    q1, q2, q3 = s[dyn.Q], s[dyn.Q + 1], s[dyn.Q + 2]
    elastic = dyn.dot3(p, dyn.SLOPE, q1, q2, q3)
    torque, pen = dyn.gear_state(p, s, w)
    friction, _ = dyn.trunnion_friction(p, s, w)
    y[at.THETA], y[at.THETA_RATE] = s[dyn.THETA], s[dyn.RATE]
    y[at.MUZZLE], y[at.ELASTIC_SLOPE] = s[dyn.THETA] + elastic, elastic
    y[at.SLOPE1] = p[dyn.SLOPE] * q1
    y[at.DROOP] = p[DROOP] * cos(s[dyn.THETA])
    y[at.Q1], y[at.Q2], y[at.Q3] = q1, q2, q3
    y[at.REL], y[at.HULL] = s[dyn.THETA] - w[dyn.PITCH], w[dyn.PITCH]
    y[at.GEAR_TORQUE], y[at.FRICTION_TORQUE], y[at.PENETRATION] = torque, friction, pen
    y[at.ENERGY] = dyn.energy(p, s, w, pen)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Advance the plant from t - dt to t, latch the command, sample; at t = 0 only sample."""
    w, sines = tail(x, EXTERNAL), tail(x, SINES)
    start = 0.0
    if t > 0.0:
        start = t - dt
    hull.start(start, p, sines)
    external(start, p, sines, w)
    h = dt / p[SUBSTEPS]
    w[dyn.COMMAND] = x[HELD]
    w[dyn.STEP_S] = h
    if t > 0.0:
        integrate(start, h, p, x)
        x[HELD] = u[0]
    sample_sensors(p, x, y)
    report_truth(p, x, y)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return parameters and initial state for a control rate in Hz and a noise seed.

    Raises ValueError for a rate that does not divide the integrator's, a bore not inside the tube,
    or a switch with an unknown value.
    """
    ratio = settings["integrator_hz"] / rate_hz
    if ratio != int(ratio) or ratio < 1.0:
        raise ValueError(
            f"integrator_hz {settings['integrator_hz']:g} is not a whole multiple of the rate "
            f"{rate_hz:g} Hz; choose a rate that divides it, such as 500, 1000, 2000 or 4000"
        )
    if not settings["inner_m"] < settings["outer_m"]:
        raise ValueError(
            f"inner_m {settings['inner_m']} is not below outer_m {settings['outer_m']}"
        )
    for name in ("friction_model", "hull_motion", "fire"):
        known = (0.0, 1.0) if name == "fire" else (0.0, 1.0, 2.0)
        if settings[name] not in known:
            raise ValueError(f"{name} is {settings[name]}; expected one of {known}")
    beam = modal_data(Tube(*(settings[field.name] for field in fields(Tube))))
    waves = hull_parameters(settings, 0.5 / settings["integrator_hz"])
    derived = {**beam_parameters(settings, beam), **waves, "substeps": ratio}
    direct = {port.name: settings[port.name] for port in PARAMETERS if port.name not in derived}
    return Prepared(parameters={**direct, **derived}, states=initial_state(settings, beam, seed))


def beam_parameters(settings: Mapping[str, float], beam: Beam) -> dict[str, Any]:
    """Return the parameters that follow from the beam."""
    zeta = np.array([settings["zeta1"], settings["zeta2"], settings["zeta3"]])
    upper = np.triu_indices(3)
    return {
        "rigid_inertia_kg_m2": settings["hub_inertia_kg_m2"] + beam.inertia_kg_m2,
        "coupling": beam.coupling.tolist(),
        "gravity": beam.gravity.tolist(),
        "tip": beam.tip.tolist(),
        "slope": beam.slope.tolist(),
        "root_strain_ue": (0.5e6 * settings["outer_m"] * beam.root).tolist(),
        "stiffness_per_s2": (beam.omega_rad_s * beam.omega_rad_s).tolist(),
        "damping_per_s": (2.0 * zeta * beam.omega_rad_s).tolist(),
        "centrifugal": beam.centrifugal[upper].tolist(),
        "horizontal_droop_rad": beam.horizontal_droop_rad(),
    }


def hull_parameters(settings: Mapping[str, float], half_step_s: float) -> dict[str, Any]:
    """Return the hull's sines, filled up with zeros to 24, and their turn in half a step."""
    amplitude, omega, phase = hull.components(settings)
    lead = settings["heave_phase_rad"]
    return {
        "hull_sines": float(omega.size),
        "heave_cos_m": settings["hull_lever_m"] * cos(lead),
        "heave_sin_m": settings["hull_lever_m"] * sin(lead),
        "hull_amplitude_rad": _padded(amplitude),
        "hull_omega_rad_s": _padded(omega),
        "hull_phase_rad": _padded(phase),
        "hull_turn_cos": _padded([cos(w * half_step_s) for w in omega]),
        "hull_turn_sin": _padded([sin(w * half_step_s) for w in omega]),
    }


def _padded(values: Iterable[float]) -> list[float]:
    known = [float(value) for value in values]
    return known + [0.0] * (HULL_COMPONENTS - len(known))


def initial_state(settings: Mapping[str, float], beam: Beam, seed: int) -> dict[str, Any]:
    """Return the resting state; on a moving hull the rotor keeps the hub at rest in space."""
    sine, cosine = sincos(settings["theta0_rad"])
    amplitude, omega, phase = hull.components(settings)
    pitch = sum(a * sin(b) for a, b in zip(amplitude, phase, strict=True))
    pitch_rate = sum(a * w * cos(b) for a, w, b in zip(amplitude, omega, phase, strict=True))
    q = beam.static_sag() * cosine
    load = settings["unbalance_Nm"] * cosine - GRAVITY_M_S2 * sine * float(beam.gravity @ q)
    flank = 0.5 * settings["gap_rad"] if load >= 0.0 else -0.5 * settings["gap_rad"]
    wind_up = flank + load / settings["ks_Nm_rad"]
    ratio = settings["gear_ratio"]
    return {
        "x_theta_rad": settings["theta0_rad"],
        "x_q": q.tolist(),
        "x_motor_angle_rad": float(ratio * (settings["theta0_rad"] - pitch + wind_up)),
        "x_motor_speed_rad_s": float(-ratio * pitch_rate),
        "x_motor_torque_Nm": load / ratio,
        "x_strain_ue": float(0.5e6 * settings["outer_m"] * beam.root @ q),
        "x_shaft_torque_Nm": load,
        "x_held_Nm": load / ratio,
        "rng": [v for channel in range(NOISY_CHANNELS) for v in seeded(seed, channel)],
    }


BLOCK = Block(
    step=step,
    inputs=INPUTS,
    outputs=OUTPUTS,
    parameters=PARAMETERS,
    states=STATES,
    settings=SETTINGS,
    prepare=prepare,
)
