"""A rougher world around the barrel: each part is off until its switch is 1, `rough` has them all.

    gyros     sample + b_k,  b_0 the bias,  b_k+1 = b_k + sigma sqrt(T) w_k                     (1)
    encoder   rel + A1 sin(rel + p1) + A2 sin(2 rel + p2)                                       (2)
    motor     T_c = A sin(n th_m + p) + tau_m a sin(m th_m + s)        against the rotor        (3)
    bearing   Fc, Fs and sig2 of the trunnion times exp(-alpha u)                               (4)
              C u' = T_f v - sig0 z z' - G (u - u_a),  u(0) = u_a                               (5)
    hull      phi = given + d,  J d'' = -T_s + T_f - (tau_m - T_fm - T_c - T_s/N) - K d - D d'  (6)
    timing    s(t - age), from s at the integrator's steps, straight between them               (7)

rel = theta - phi, v = rel', all else as in dynamics.py. The first term of (3) is conservative, with
the potential -A cos(n th_m + p)/n. (5): what friction takes and the bristle does not store is heat;
u counts from the temperature at which the parameters of friction hold. (6): the whole torque of hub
and rotor turns back on the hull, so that with K = D = 0 the momentum of hull, rotor and barrel only
changes by gravity and shot; the hull that is told moves as without a barrel, and its trunnion
heaves as told. At the start the hull has yielded to the load at rest. (7): before t = 0 all was as
at t = 0. The motion of the world is integrated with that of the barrel, by the same Runge-Kutta.
"""

from collections.abc import Mapping
from typing import Any

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array
from pcpc.executive.laws.block import flat
from pcpc.executive.laws.emath import clip, cos, exp, floor, sin, sqrt, where
from pcpc.plants.atb1000 import dynamics as dyn
from pcpc.plants.atb1000 import hull
from pcpc.plants.atb1000.ports import External, Motion, Outputs, Parameters, States
from pcpc.plants.atb1000.rough_ports import AGES, DEVICES, GYROS, PAST, SIGNALS, SWITCHES, World
from pcpc.plants.noise import normal, seeded


@inline
def is_on(p: Parameters) -> float:
    """Return whether any part is on: above 0."""
    sensors = p.rough_gyros + p.rough_encoder + p.rough_timing
    return p.rough + sensors + p.rough_motor + p.rough_bearing + p.rough_hull


@inline
def cogging(p: Parameters, angle: float, torque: float) -> float:
    """Return T_c of (3) at a motor angle in rad and a motor torque in N m."""
    own = p.cogging_Nm * sin(p.cogging_per_turn * angle + p.cogging_phase_rad)
    return own + torque * p.ripple * sin(p.ripple_per_turn * angle + p.ripple_phase_rad)


@inline
def cogging_energy(p: Parameters, angle: float) -> float:
    """Return the potential of the first term of (3), J."""
    turn = p.cogging_per_turn * angle + p.cogging_phase_rad
    return -p.cogging_Nm / p.cogging_per_turn * cos(turn)


@inline
def runout(p: Parameters, rel: float) -> float:
    """Return the encoder's error of (2), rad."""
    once = p.encoder_once_rad * sin(rel + p.encoder_once_phase_rad)
    return once + p.encoder_twice_rad * sin(2.0 * rel + p.encoder_twice_phase_rad)


@inline
def set_external(p: Parameters, s: Motion, world: World, x: States) -> None:
    """Put around the motion `s` what the state `world` makes of the world."""
    w = x.external
    if p.rough + p.rough_hull > 0.0:
        pitch, rate, _, _ = hull.motion(p, x.sines)
        w.pitch_rad = pitch + world.hull_yield_rad
        w.pitch_rate_rad_s = rate + world.hull_yield_rate_rad_s
    if p.rough + p.rough_bearing > 0.0:
        w.friction_rise = exp(-p.friction_fall_per_K * world.bearing_K) - 1.0  # (4)
    if p.rough + p.rough_motor > 0.0:
        w.cogging_Nm = cogging(p, s.motor_angle_rad, s.motor_torque_Nm)


@inline
def advance_stage(j: int, h: float, weight: float, reach: float, x: States) -> None:
    """Do stage `j` of Runge-Kutta with the rates of the world."""
    world, rates = flat(x.world), flat(x.world_slope)
    total, between = flat(x.world_total), flat(x.world_between)
    for i in range(len(world)):
        total[i] = where(j == 0, 0.0, total[i]) + weight * rates[i]
        between[i] = world[i] + reach * h * rates[i]
        if j == 3:
            world[i] += h / 6.0 * total[i]


@inline
def set_stage(
    n: int, j: int, h: float, weight: float, reach: float, p: Parameters, x: States
) -> None:
    """Put the world around stage `j` of step `n` of the barrel, and carry it on."""
    s, w, world, rates = x.between, x.external, x.world_between, x.world_slope
    if j == 0:
        start, now = flat(x.world_between), flat(x.world)
        for i in range(len(now)):
            start[i] = now[i]
    set_external(p, s, world, x)
    if j == 0:
        sample_signals(n, p, s, x)
    rates.hull_yield_rad, rates.hull_yield_rate_rad_s, rates.bearing_K = 0.0, 0.0, 0.0
    torque, _ = dyn.gear_state(p, s, w)
    opposing, bristle_rate = dyn.trunnion_friction(p, s, w)
    if p.rough + p.rough_hull > 0.0:
        _, _, pitch_acc, _ = hull.motion(p, x.sines)
        back = opposing - torque - (dyn.rotor_torque(p, s, w, torque) - w.cogging_Nm)
        held = p.hull_spring_Nm_rad * world.hull_yield_rad
        held = held + p.hull_damper_Nms_rad * world.hull_yield_rate_rad_s
        rates.hull_yield_rad = world.hull_yield_rate_rad_s
        rates.hull_yield_rate_rad_s = (back - held) / p.hull_inertia_kg_m2  # (6)
        w.pitch_acc_rad_s2 = pitch_acc + rates.hull_yield_rate_rad_s
    if p.rough + p.rough_bearing > 0.0:
        v = s.theta_rate_rad_s - w.pitch_rate_rad_s
        heat = opposing * v - p.sig0_Nm_rad * s.bristle_rad * bristle_rate
        lost = p.bearing_W_K * (world.bearing_K - p.ambient_K)
        rates.bearing_K = (heat - lost) / p.bearing_J_K  # (5)
    advance_stage(j, h, weight, reach, x)


@inline
def subtract_cogging(p: Parameters, x: States) -> None:
    """Take from the rotor's acceleration what T_c of (3) does."""
    x.slope.motor_speed_rad_s -= x.external.cogging_Nm / p.motor_inertia_kg_m2


@inline
def sample_weight(n: int, age: float, p: Parameters, period: float) -> float:
    """Return with which weight a sample of this age has the signals after `n` steps (7)."""
    place = p.substeps * (1.0 - (age / period - floor(age / period)))
    return clip(1.0 - abs(n - place), 0.0, 1.0)


@inline
def add_signals(weights: Array, s: Motion, w: External, seen: Array) -> None:
    """Add to `seen` the sensors' signals, each with its device's weight, in the order of AGES.

    `weights`: (6,), `seen`: (10,).
    """
    encoder, gyro, told = weights[0], weights[1], weights[2]
    strain, torque, motor = weights[3], weights[4], weights[5]
    seen[0] += encoder * (s.theta_rad - w.pitch_rad)
    seen[1] += gyro * s.hub_rate_rad_s
    seen[2] += gyro * s.muzzle_rate_rad_s
    seen[3] += told * w.pitch_rad
    seen[4] += told * w.pitch_rate_rad_s
    seen[5] += strain * s.strain_ue
    seen[6] += torque * s.shaft_torque_Nm
    seen[7] += motor * s.motor_speed_rad_s
    seen[8] += motor * s.motor_torque_Nm
    seen[9] += motor * s.motor_angle_rad


@inline
def sample_signals(n: int, p: Parameters, s: Motion, x: States) -> None:
    """Look at the signals after `n` steps of the period."""
    if p.rough + p.rough_timing > 0.0:
        if n == 0:
            for c in range(SIGNALS):
                x.seen[c] = 0.0
        period = p.substeps * x.external.step_s
        x.shares[0] = sample_weight(n, p.encoder_age_s, p, period)
        x.shares[1] = sample_weight(n, p.gyro_age_s, p, period)
        x.shares[2] = sample_weight(n, p.hull_age_s, p, period)
        x.shares[3] = sample_weight(n, p.strain_age_s, p, period)
        x.shares[4] = sample_weight(n, p.torque_age_s, p, period)
        x.shares[5] = sample_weight(n, p.motor_age_s, p, period)
        add_signals(x.shares, s, x.external, x.seen)


@inline
def lateness(c: int, age: float, period: float, x: States) -> float:
    """Return by how much signal `c` differs from now at this age (7)."""
    back, found = floor(age / period), 0.0
    for i in range(PAST):
        found = where(back == i, x.past[c, i], found)
    return found - x.seen[c]


@inline
def age_samples(t: float, dt: float, p: Parameters, x: States, y: Outputs) -> None:
    """Make the samples `y` as old as their devices are slow."""
    for c in range(SIGNALS):
        for i in range(PAST - 1, 0, -1):
            x.past[c, i] = x.past[c, i - 1]
        x.past[c, 0] = x.seen[c]
        x.seen[c] = 0.0
    for i in range(DEVICES):
        x.shares[i] = 1.0
    add_signals(x.shares, x.motion, x.external, x.seen)
    if t <= 0.0 or t - x.seen_s > 1.5 * dt:  # there is no past yet
        for c in range(SIGNALS):
            for i in range(PAST):
                x.past[c, i] = x.seen[c]
    x.seen_s = t
    y.encoder_rad += lateness(0, p.encoder_age_s, dt, x)
    y.hub_rate_rad_s += lateness(1, p.gyro_age_s, dt, x)
    y.muzzle_rate_rad_s += lateness(2, p.gyro_age_s, dt, x)
    y.hull_pitch_rad += lateness(3, p.hull_age_s, dt, x)
    y.hull_rate_rad_s += lateness(4, p.hull_age_s, dt, x)
    y.strain_ue += lateness(5, p.strain_age_s, dt, x)
    y.shaft_torque_Nm += lateness(6, p.torque_age_s, dt, x)
    y.motor_speed_rad_s += lateness(7, p.motor_age_s, dt, x)
    y.motor_torque_Nm += lateness(8, p.motor_age_s, dt, x)
    y.motor_angle_rad += lateness(9, p.motor_age_s, dt, x)


@inline
def add_errors(t: float, dt: float, p: Parameters, x: States, y: Outputs) -> None:
    """Add the errors of clocks, encoder and gyros to the samples `y`, in this order."""
    if p.rough + p.rough_timing > 0.0:
        sample_signals(int(p.substeps), p, x.motion, x)
        age_samples(t, dt, p, x, y)
    if p.rough + p.rough_encoder > 0.0:
        y.encoder_error_rad = runout(p, y.encoder_rad)
        y.encoder_rad += y.encoder_error_rad
    if p.rough + p.rough_gyros > 0.0:
        y.hub_rate_rad_s += x.gyro_bias_rad_s[0]
        y.muzzle_rate_rad_s += x.gyro_bias_rad_s[1]
        y.hull_rate_rad_s += x.gyro_bias_rad_s[2]
        y.hub_gyro_error_rad_s = x.gyro_bias_rad_s[0]
        for i in range(GYROS):
            drawn = normal(x.walk_rng[i])
            x.gyro_bias_rad_s[i] += p.gyro_walk_rad_s_rts * sqrt(dt) * drawn  # (1)


@inline
def write_truths(p: Parameters, x: States, y: Outputs) -> None:
    """Write the truths of the world, and add its energy to that of the barrel."""
    world, w = x.world, x.external
    y.bearing_K, y.cogging_torque_Nm = world.bearing_K, w.cogging_Nm
    if p.rough + p.rough_hull > 0.0:
        d, rate = world.hull_yield_rad, world.hull_yield_rate_rad_s
        y.hull_yield_rad = d
        y.energy_J += 0.5 * (p.hull_inertia_kg_m2 * rate * rate + p.hull_spring_Nm_rad * d * d)
    if p.rough + p.rough_motor > 0.0:
        y.energy_J += cogging_energy(p, x.motion.motor_angle_rad)


def check(settings: Mapping[str, float], rate_hz: float) -> None:
    """Refuse a switch that is neither 0 nor 1, and an age that is not remembered: ValueError."""
    for name in SWITCHES:
        if settings[name] not in (0.0, 1.0):
            raise ValueError(f"{name} is {settings[name]}; expected 0 (off) or 1 (on)")
    late = settings["rough"] + settings["rough_timing"] > 0.0
    for name in AGES:
        if late and settings[name] * rate_hz >= PAST:
            raise ValueError(
                f"{name} {settings[name]:g} s is {settings[name] * rate_hz:g} periods of "
                f"{rate_hz:g} Hz; expected less than {PAST}"
            )


def resting_yield(settings: Mapping[str, float], load: float) -> float:
    """Return how far the hull has yielded at rest to `load`, N m on the hub; 0 without a spring."""
    on = settings["rough"] + settings["rough_hull"] > 0.0
    spring = settings["hull_spring_Nm_rad"]
    return -load / spring if on and spring > 0.0 else 0.0


def initial_state(settings: Mapping[str, float], seed: int, first_stream: int) -> dict[str, Any]:
    """Return the initial states but for the hull's; noise streams from `first_stream` on."""
    gyros = ("hub", "muzzle", "hull")
    return {
        "world_bearing_K": settings["ambient_K"],
        "gyro_bias_rad_s": [settings[f"{one}_gyro_bias_rad_s"] for one in gyros],
        "walk_rng": [v for i in range(GYROS) for v in seeded(seed, first_stream + i)],
    }
