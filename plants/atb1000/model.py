"""The barrel plant as one block: motor torque command in, unrounded sensor samples and truths out.

    call k of `step` at t = k dt:  k = 0  samples of the initial state; nothing else happens
                                   k > 0  integrate [t - dt, t] with the command held so far,
                                          latch the input, then sample at t

So a command computed from the samples of t_k, an input at the call of t_k+1, acts from t_k+1: one
sample of delay, and `delay_samples` more. Classic Runge-Kutta over all 16 states with n whole steps
of h = dt/n; hull motion and firing are functions of time, evaluated at h/2. Equations: dynamics.py;
names and units: ports.py; nominal figures: parameters.yaml; what makes the world rougher: rough.py.
At the start the barrel rests under gravity at theta0, the gear lies on the flank that carries the
load, rotor and hub have no relative rate, and the drive holds.
"""

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from pcpc.drivers.compiled.jit import compiled
from pcpc.executive.laws.block import Block, Prepared, flat, inline, stage
from pcpc.executive.laws.emath import clip, cos, sin, sincos, where
from pcpc.plants.atb1000 import dynamics as dyn
from pcpc.plants.atb1000 import hull, rough
from pcpc.plants.atb1000.beam import GRAVITY_M_S2, Beam, Tube, modal_data
from pcpc.plants.atb1000.ports import (
    HULL_COMPONENTS,
    NOISY_CHANNELS,
    Inputs,
    Outputs,
    Parameters,
    Settings,
    States,
)
from pcpc.plants.noise import seeded
from pcpc.plants.sensors import noisy
from pcpc.plants.transport import DELAY_SIZE, delayed

PI = 3.141592653589793
WEIGHT = (1.0, 2.0, 2.0, 1.0)  # classic Runge-Kutta: of the slopes, over 6
REACH = (0.5, 0.5, 1.0, 0.0)  # how far a stage's slope carries to the next stage, in steps


@inline
def half_sine(t: float, peak: float, start: float, lasts: float) -> float:
    """Return an impulse at time t: half a sine."""
    phase = clip((t - start) / lasts, 0.0, 1.0)
    return where(phase < 1.0, peak * sin(PI * phase), 0.0)


@inline
def external(t: float, p: Parameters, x: States) -> None:
    """Write hull motion and firing at time t, where the sines stand at t."""
    w = x.external
    w.pitch_rad, w.pitch_rate_rad_s, w.pitch_acc_rad_s2, w.heave_acc_m_s2 = hull.motion(p, x.sines)
    w.hub_moment_Nm, w.muzzle_force_N = 0.0, 0.0
    if p.fire > 0.0:
        w.hub_moment_Nm = half_sine(t, p.fire_hub_Nm, p.fire_hub_start_s, p.fire_hub_lasts_s)
        w.muzzle_force_N = half_sine(
            t, p.fire_muzzle_N, p.fire_muzzle_start_s, p.fire_muzzle_lasts_s
        )


def _integration(rougher: bool) -> Any:
    """Return the motion's integration, in the world of rough.py or without all of its code."""

    def integrate(start: float, h: float, p: Parameters, x: States) -> None:
        """Advance the motion by steps of `h` from `start`, where the external inputs stand."""
        s, k, total, between = flat(x.motion), flat(x.slope), flat(x.total), flat(x.between)
        for n in range(int(p.substeps)):
            for i in range(len(s)):
                total[i] = 0.0
                between[i] = s[i]
            for j in range(4):
                if rougher:
                    rough.set_stage(n, j, h, WEIGHT[j], REACH[j], p, x)
                dyn.derivative(p, x.between, x.external, x.slope)
                if rougher:
                    rough.subtract_cogging(p, x)
                for i in range(len(s)):
                    total[i] += WEIGHT[j] * k[i]
                    between[i] = s[i] + REACH[j] * h * k[i]
                if j == 0 or j == 2:
                    hull.advance(p, x.sines)
                    external(start + (n + 0.5 + 0.25 * j) * h, p, x)
            for i in range(len(s)):
                s[i] += h / 6.0 * total[i]

    return integrate


integrate = inline(_integration(False))
integrate_rougher = compiled()(_integration(True))  # a function apart: it costs others nothing


@inline
def sample_sensors(p: Parameters, x: States, y: Outputs) -> None:
    """Write the ten sensor samples, one noise draw per noisy channel."""
    s, w, rng = x.motion, x.external, x.rng
    y.encoder_rad = s.theta_rad - w.pitch_rad
    y.hub_rate_rad_s = noisy(s.hub_rate_rad_s, p.hub_gyro_noise_rad_s, rng[0])
    y.muzzle_rate_rad_s = noisy(s.muzzle_rate_rad_s, p.muzzle_gyro_noise_rad_s, rng[1])
    y.hull_pitch_rad = noisy(w.pitch_rad, p.hull_pitch_noise_rad, rng[2])
    y.hull_rate_rad_s = noisy(w.pitch_rate_rad_s, p.hull_rate_noise_rad_s, rng[3])
    y.strain_ue = noisy(s.strain_ue, p.strain_noise_ue, rng[4])
    y.shaft_torque_Nm = noisy(s.shaft_torque_Nm, p.torque_noise_Nm, rng[5])
    y.motor_speed_rad_s = s.motor_speed_rad_s
    y.motor_torque_Nm = s.motor_torque_Nm
    y.motor_angle_rad = s.motor_angle_rad


@inline
def report_truth(p: Parameters, x: States, y: Outputs) -> None:
    """Write the noiseless outputs, after the ten sensors."""
    s, w = x.motion, x.external
    elastic = dyn.dot3(p.slope, s.q[0], s.q[1], s.q[2])
    y.gear_torque_Nm, y.penetration_rad = dyn.gear_state(p, s, w)
    y.friction_torque_Nm, _ = dyn.trunnion_friction(p, s, w)
    y.theta_rad, y.theta_rate_rad_s = s.theta_rad, s.theta_rate_rad_s
    y.muzzle_rad, y.elastic_slope_rad = s.theta_rad + elastic, elastic
    y.slope1_rad = p.slope[0] * s.q[0]
    y.droop_rad = p.horizontal_droop_rad * cos(s.theta_rad)
    y.q1, y.q2, y.q3 = s.q[0], s.q[1], s.q[2]
    y.rel_rad, y.hull_rad = s.theta_rad - w.pitch_rad, w.pitch_rad
    y.energy_J = dyn.energy(p, s, w, y.penetration_rad)


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """Advance the plant from t - dt to t, latch the command, sample; at t = 0 only sample."""
    start = 0.0
    if t > 0.0:
        start = t - dt
    hull.start(start, p, x.sines)
    external(start, p, x)
    x.external.command_Nm = x.held_Nm
    x.external.step_s = dt / p.substeps
    x.external.friction_rise, x.external.cogging_Nm = 0.0, 0.0
    rougher = rough.is_on(p)
    if t > 0.0:
        if rougher > 0.0:
            integrate_rougher(start, x.external.step_s, p, x)
        else:
            integrate(start, x.external.step_s, p, x)
        x.held_Nm = delayed(u.motor_command_Nm, p.delay_samples, x.sent_Nm)
    if rougher > 0.0:
        rough.set_external(p, x.motion, x.world, x)
    sample_sensors(p, x, y)
    report_truth(p, x, y)
    if rougher > 0.0:
        rough.add_errors(t, dt, p, x, y)
        rough.write_truths(p, x, y)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return parameters and initial state for a control rate in Hz and a noise seed.

    Raises ValueError for a rate that does not divide the integrator's, a bore not inside the tube,
    a switch with an unknown value, or a sample older than is remembered.
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
    rough.check(settings, rate_hz)
    beam = modal_data(Tube(*(settings[field.name] for field in fields(Tube))))
    waves = hull_parameters(settings, 0.5 / settings["integrator_hz"])
    derived = {**beam_parameters(settings, beam), **waves, "substeps": ratio}
    direct = {
        port.name: settings[port.name] for port in Parameters.ports if port.name not in derived
    }
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
        "hull_amplitude_rad": _padded_values(amplitude),
        "hull_omega_rad_s": _padded_values(omega),
        "hull_phase_rad": _padded_values(phase),
        "hull_turn_cos": _padded_values([cos(w * half_step_s) for w in omega]),
        "hull_turn_sin": _padded_values([sin(w * half_step_s) for w in omega]),
    }


def _padded_values(values: Iterable[float]) -> list[float]:
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
    yielded = rough.resting_yield(settings, load)
    return {
        "x_theta_rad": settings["theta0_rad"],
        "x_q": q.tolist(),
        "x_motor_angle_rad": float(ratio * (settings["theta0_rad"] - pitch - yielded + wind_up)),
        "x_motor_speed_rad_s": float(-ratio * pitch_rate),
        "x_motor_torque_Nm": load / ratio,
        "x_strain_ue": float(0.5e6 * settings["outer_m"] * beam.root @ q),
        "x_shaft_torque_Nm": load,
        "x_held_Nm": load / ratio,
        "rng": [v for channel in range(NOISY_CHANNELS) for v in seeded(seed, channel)],
        "sent_Nm": [load / ratio] * DELAY_SIZE,
        "world_hull_yield_rad": yielded,
        **rough.initial_state(settings, seed, NOISY_CHANNELS),
    }


BLOCK = Block(step, settings=Settings, prepare=prepare)
