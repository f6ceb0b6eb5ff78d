"""The operator's side of a telerobot: a filtered-error law on a prediction of the delayed robot.

    z+  = Ad z + Bd u_k,  z(0) = x(0)               the robot as it should be, undelayed     (1)
    xf  = x_k-N + z_k - z_k-2N                      Smith's predictor; without it  x_k-N     (2)
    e   = q_d - xf_q,  e' = q_d' - xf_v,  r = e' + Lam e                                     (3)
    u_k = q_d'' + Lam e' + Kv r  [- A21 xf_q - A22 xf_v  where the robot is made to be As]   (4)

N = T/h ticks is the delay of each direction: x_k-N is what `playout.py` gives for the frames with
tick k - N. Index rule: z_k is stored before (1); the robot at its tick j acts on u_j-N, and its
x_j belongs to z_j-N. Each frame of the robot tells the tick of the u in use, the echo; (2) takes z
of the echo of the x in use (`use_echo` 1), or always z_k-2N (0); both are the same while nothing is
lost. `history_offset_ticks` d takes z_k-2N-d instead: a model of the delay that is wrong by d/2.
While x is missing, it and its z are held.

`match` 1 compares the delayed robot with the reference of 2 T ago. u is rounded to `u_lsb` before
it drives (1), because the robot gets what the wire carries. `local_law` and N go to the robot's
node with u, so that both sides always agree:
    1 double integrator (no As in (4))   2 As from a model   3 robust, without network   4 network
each in a file of its own, see telerobot_local.py.

rad, rad/s, rad/s2, s; u becomes a torque, N m, at the robot. The reference is soft_sine.py about
the start, `aim` is it T ago: what the robot should do now. Source: Lewis, Campos, Selmic (SIAM
2002), chapter 8; scenario and numbers are this project's.
"""

from collections.abc import Mapping

from pcpc.executive.laws.block import Block, Ports, Prepared, group, inline, port, stage
from pcpc.executive.laws.emath import clip, floor, where
from pcpc.plants.telerobot.equations import (
    A21,
    A22,
    JOINTS,
    Joints,
    Sampled,
    advance,
    sampled,
)
from pcpc.plants.telerobot.laws.playout import EMPTY, LONGEST, SLOTS, put, take, tick_of, wire_tick
from pcpc.plants.telerobot.laws.robot_node import CANCEL
from pcpc.plants.telerobot.laws.soft_sine import soft_sine

HISTORY = 1100  # ticks of z: twice the longest delay, and the offsets
OFFSET = 40.0
U_LIMIT_RAD_S2 = 524.0  # of the wire


class Gains(Ports):
    """The law, what it is compared with, and the reference."""

    kv_per_s = port("1/s", "Kv, of the filtered error", None, 0.0, 1e3)
    lam_per_s = port("1/s", "Lam, of the error in it", None, 0.0, 1e3)
    local_law = port("", "of the robot's node, see telerobot_local.py", None, 1.0, 4.0)
    predictor = port("", "1 predicts with (2), 0 takes the delayed robot", None, 0.0, 1.0)
    match = port("", "1 compares with the reference of 2 T ago", 0.0, 0.0, 1.0)
    use_echo = port("", "1 looks z up by the echo, 0 by the delay", 1.0, 0.0, 1.0)
    history_offset_ticks = port("", "error of the z that is looked up", 0.0, -OFFSET, OFFSET)
    u_lsb_rad_s2 = port("rad/s2", "quantum of u, 0 none", 0.001, 0.0, 10.0)
    amplitude_rad = port(
        "rad",
        "of the reference of joint #",
        (1.0, 0.8),
        -10.0,
        10.0,
        shape=JOINTS,
        named="amplitude_#_rad",
    )
    omega_rad_s = port(
        "rad/s",
        "of the reference of joint #",
        (1.0, 1.5),
        0.0,
        100.0,
        shape=JOINTS,
        named="omega_#_rad_s",
    )
    rise_s = port("s", "in which the reference begins", 3.0, 1e-3, 1e3)
    start_rad = port(
        "rad",
        "q# of the robot at rest",
        (-1.570796326794897, 0.0),
        -10.0,
        10.0,
        shape=JOINTS,
        named="start_#_rad",
    )


class Settings(Gains):
    """The gains, and the delay in time."""

    delay_s = port("s", "T of each direction; 0: the rig's own", 0.2, 0.0, 10.0)


class Parameters(Gains):
    """The gains, the delay in ticks, and the model for this rate."""

    delay_ticks = port("", "N", None, 0.0, LONGEST)
    model = group(Sampled)


class Inputs(Ports):
    """What the robot told, and when."""

    q_rad = port("rad", "q# told by the robot", 0.0, shape=JOINTS, named="q_#_rad")
    rate_rad_s = port("rad/s", "q#' told by the robot", 0.0, shape=JOINTS, named="rate_#_rad_s")
    position_tick = port("", "wire tick of the positions", 0.0)
    rate_tick = port("", "wire tick of the rates", 0.0)
    echo_tick = port("", "wire tick of the echo", 0.0)
    echo = port("", "wire tick of the u in use at that tick", 0.0)


class Outputs(Ports):
    """The command, what the robot's side must know of it, and what led to it."""

    u_rad_s2 = port("rad/s2", "to the robot, joint #", shape=JOINTS, named="u_#_rad_s2")
    tick = port("", "wire tick of u")
    law = port("", "local_law")
    delay = port("", "N")
    aim_rad = port(
        "rad",
        "q_d of joint #, T ago: what the robot should do now",
        shape=JOINTS,
        named="aim_#_rad",
    )
    e_rad = port("rad", "e of joint #", shape=JOINTS, named="e_#_rad")
    r_rad_s = port("rad/s", "r of joint #", shape=JOINTS, named="r_#_rad_s")
    seen_rad = port("rad", "q# in use, T old", shape=JOINTS, named="seen_#_rad")
    off_rad = port(
        "rad", "seen position of joint # against z of its time", shape=JOINTS, named="off_#_rad"
    )
    off_rate_rad_s = port(
        "rad/s",
        "seen rate of joint # against z of its time",
        shape=JOINTS,
        named="off_rate_#_rad_s",
    )
    z_rad = port("rad", "z of joint #", shape=JOINTS, named="z_#_rad")
    held_x = port("", "ticks without a new x, of the whole run")
    looked_up = port("", "ticks of age of the z that x is compared with")


class States(Ports):
    """The model with its past, and what came from the robot."""

    z = group(Joints, "z_")
    past_z_q = port("rad", "positions of z, by tick", shape=(HISTORY, JOINTS), recorded=False)
    past_z_v = port("rad/s", "rates of z, by tick", shape=(HISTORY, JOINTS), recorded=False)
    z_tick = port("", "tick of z", recorded=False)
    u_last = port("rad/s2", "u of the last tick", shape=JOINTS, recorded=False)
    used = group(Joints, "used_")  # the x in use
    used_tick = port("", "its tick", -1.0, recorded=False)
    used_age = port("", "ticks from u to it", recorded=False)
    played = group(Joints, "played_")  # of the frames that were played last
    played_age = port("", "ticks from u to x, played last", recorded=False)
    missed = port("", "ticks without a new x", recorded=False)
    positions = port("rad", "play-out", EMPTY, shape=(JOINTS, SLOTS), recorded=False)
    rates = port("rad/s", "play-out", EMPTY, shape=(JOINTS, SLOTS), recorded=False)
    ages = port("", "play-out of ticks from u to x", EMPTY, shape=SLOTS, recorded=False)


@inline
def history_row(tick: float) -> int:
    """Return the place of z of a tick in the past; ticks below 0 are those before the run."""
    return int(tick - HISTORY * floor(tick / HISTORY))


@inline
def use_newest(now: float, x: States, u: Inputs) -> None:
    """Without a delay, use what came last, whatever its tick."""
    for j in range(JOINTS):
        x.used.q[j] = where(u.position_tick > 0.5, u.q_rad[j], x.used.q[j])
        x.used.v[j] = where(u.rate_tick > 0.5, u.rate_rad_s[j], x.used.v[j])
    x.used_tick = now


@inline
def store_frames(now: float, delay: float, x: States, u: Inputs) -> None:
    """Put what came into the buffers."""
    for j in range(JOINTS):
        put(x.positions[j], u.position_tick, now, delay, u.q_rad[j])
        put(x.rates[j], u.rate_tick, now, delay, u.rate_rad_s[j])
    age = where(u.echo > 0.5, tick_of(u.echo_tick, now) - tick_of(u.echo, now), delay)
    put(x.ages, u.echo_tick, now, delay, age)


@inline
def use_due(due: float, x: States) -> None:
    """Take out what is due; hold x unless all of it is there."""
    missing = 0.0
    for j in range(JOINTS):
        x.played.q[j], no_position = take(x.positions[j], due, x.played.q[j])
        x.played.v[j], no_rate = take(x.rates[j], due, x.played.v[j])
        missing += no_position + no_rate
    x.played_age, _ = take(x.ages, due, x.played_age)
    fresh = missing < 0.5
    for j in range(JOINTS):
        x.used.q[j] = where(fresh, x.played.q[j], x.used.q[j])
        x.used.v[j] = where(fresh, x.played.v[j], x.used.v[j])
    x.used_tick = where(fresh, due, x.used_tick)
    x.used_age = where(fresh, x.played_age, x.used_age)
    x.missed += where(fresh | (due < 0.0), 0.0, 1.0)


@inline
def receive(now: float, delay: float, x: States, u: Inputs) -> None:
    """Use the x of N ticks ago."""
    if delay < 0.5:
        use_newest(now, x, u)
        return
    store_frames(now, delay, x, u)
    use_due(now - delay, x)


@inline
def advance_model(now: float, p: Parameters, x: States) -> None:
    """Bring z from the tick of the last call to `now` under the u of then (1), storing each."""
    for _ in range(int(now - x.z_tick)):
        advance(p.model, x.z, x.u_last)
        x.z_tick += 1.0
        row = history_row(x.z_tick)
        for j in range(JOINTS):
            x.past_z_q[row, j] = x.z.q[j]
            x.past_z_v[row, j] = x.z.v[j]


@inline
def compared_tick(now: float, p: Parameters, x: States) -> float:
    """Return the tick of the z that belongs to the x in use (2)."""
    age = where(p.use_echo > 0.5, x.used_age, p.delay_ticks)
    oldest = now - (HISTORY - 1.0)
    return clip(x.used_tick - age - p.history_offset_ticks, oldest, now)


@inline
def compare_with_model(tick: float, x: States, y: Outputs) -> None:
    """Write how far the x in use is from the z of its tick."""
    row = history_row(tick)
    for j in range(JOINTS):
        y.off_rad[j] = x.used.q[j] - x.past_z_q[row, j]
        y.off_rate_rad_s[j] = x.used.v[j] - x.past_z_v[row, j]


@inline
def reference(j: int, t: float, p: Parameters) -> tuple[float, float, float]:
    """Return q_d, q_d', q_d'' of joint `j`."""
    q_d, rate, acceleration = soft_sine(t, p.amplitude_rad[j], p.omega_rad_s[j], p.rise_s)
    return p.start_rad[j] + q_d, rate, acceleration


@inline
def desired(j: int, t: float, delay_s: float, p: Parameters) -> tuple[float, float, float]:
    """Return q_d, q_d' that the robot is compared with, and q_d'' of now."""
    q_d, rate, acceleration = reference(j, t, p)
    if p.match > 0.5:
        q_d, rate, _ = reference(j, t - 2.0 * delay_s, p)
    return q_d, rate, acceleration


@inline
def predicted(j: int, p: Parameters, x: States, y: Outputs) -> tuple[float, float]:
    """Return xf (2): with the predictor, or the delayed robot."""
    smith = p.predictor > 0.5
    q = where(smith, x.z.q[j] + y.off_rad[j], x.used.q[j])
    v = where(smith, x.z.v[j] + y.off_rate_rad_s[j], x.used.v[j])
    return q, v


@inline
def wire_value(u: float, p: Parameters) -> float:
    """Return u as the robot gets it: within the wire's range, in whole quanta."""
    u = clip(u, -U_LIMIT_RAD_S2, U_LIMIT_RAD_S2)
    if p.u_lsb_rad_s2 > 0.0:
        u = p.u_lsb_rad_s2 * floor(u / p.u_lsb_rad_s2 + 0.5)
    return u


@inline
def command_joint(j: int, t: float, dt: float, p: Parameters, x: States, y: Outputs) -> None:
    """Write u of joint `j` by (2) to (4), with what is shown of it."""
    delay_s = p.delay_ticks * dt
    q_d, v_d, a_d = desired(j, t, delay_s, p)
    q, v = predicted(j, p, x, y)  # (2)
    e, e_rate = q_d - q, v_d - v
    r = e_rate + p.lam_per_s * e  # (3)
    bare = a_d + p.lam_per_s * e_rate + p.kv_per_s * r
    u = wire_value(where(p.local_law > CANCEL, bare - A21 * q - A22 * v, bare), p)  # (4)
    aim, _, _ = reference(j, t - delay_s, p)
    y.u_rad_s2[j] = x.u_last[j] = u
    y.aim_rad[j], y.e_rad[j], y.r_rad_s[j] = aim, e, r
    y.seen_rad[j], y.z_rad[j] = x.used.q[j], x.z.q[j]


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One tick; see the module header."""
    now = floor(t / dt + 0.5)
    advance_model(now, p, x)
    receive(now, p.delay_ticks, x, u)
    compared = compared_tick(now, p, x)
    compare_with_model(compared, x, y)
    for j in range(JOINTS):
        command_joint(j, t, dt, p, x, y)
    y.tick, y.law, y.delay = wire_tick(now), p.local_law, p.delay_ticks
    y.held_x, y.looked_up = x.missed, now - compared


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return N, Ad, Bd and buffers that hold the robot at rest for all ticks before the run.

    Raises ValueError if delay_s is too long.
    """
    ticks = float(round(settings["delay_s"] * rate_hz))
    if ticks > LONGEST:
        raise ValueError(
            f"delay_s {settings['delay_s']:g}: {ticks:.0f} cycles; at most {LONGEST:.0f}"
        )
    gains = {one.name: settings[one.name] for one in Gains.ports}
    start = [settings["start_1_rad"], settings["start_2_rad"]]
    resting = 0.0 if settings["local_law"] == CANCEL else -A21
    states: dict[str, float | list[float]] = {
        "z_q": start,
        "past_z_q": start * HISTORY,
        "u_last": [resting * q for q in start],
        "used_q": start,
        "played_q": start,
        "used_tick": -ticks,
        "used_age": ticks,
        "played_age": ticks,
    }
    return Prepared({**gains, "delay_ticks": ticks, **sampled(1.0 / rate_hz)}, states)


BLOCK = Block(step, settings=Settings, prepare=prepare)
