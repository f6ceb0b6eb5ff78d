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

rad, rad/s, rad/s2, s; u becomes a torque, N m, at the robot. The reference is soft_sine.py about
the start, `aim` is it T ago: what the robot should do now. Source: Lewis, Campos, Selmic (SIAM
2002), chapter 8; scenario and numbers are this project's.
"""

from collections.abc import Mapping
from typing import Any

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.emath import clip, floor, where
from pcpc.executive.laws.models.double_pole import A21, A22, ENTRIES, advance, sampled
from pcpc.executive.laws.models.playout import EMPTY, LONGEST, SLOTS, put, take, tick_of, wire_tick
from pcpc.executive.laws.models.soft_sine import soft_sine

JOINTS = 2
HISTORY = 1100  # ticks of z: twice the longest delay, and the offsets
OFFSET = 40.0
U_LIMIT_RAD_S2 = 524.0  # of the wire

GAINS = (
    Port("kv_per_s", "1/s", "Kv, of the filtered error", None, 0.0, 1e3),
    Port("lam_per_s", "1/s", "Lam, of the error in it", None, 0.0, 1e3),
    Port("local_law", "", "of the robot's node, see telerobot_local.py", None, 1.0, 4.0),
    Port("predictor", "", "1 predicts with (2), 0 takes the delayed robot", None, 0.0, 1.0),
    Port("match", "", "1 compares with the reference of 2 T ago", 0.0, 0.0, 1.0),
    Port("use_echo", "", "1 looks z up by the echo, 0 by the delay", 1.0, 0.0, 1.0),
    Port("history_offset_ticks", "", "error of the z that is looked up", 0.0, -OFFSET, OFFSET),
    Port("u_lsb_rad_s2", "rad/s2", "quantum of u, 0 none", 0.001, 0.0, 10.0),
    Port("amplitude_1_rad", "rad", "of the reference of joint 1", 1.0, -10.0, 10.0),
    Port("amplitude_2_rad", "rad", "of the reference of joint 2", 0.8, -10.0, 10.0),
    Port("omega_1_rad_s", "rad/s", "of the reference of joint 1", 1.0, 0.0, 100.0),
    Port("omega_2_rad_s", "rad/s", "of the reference of joint 2", 1.5, 0.0, 100.0),
    Port("rise_s", "s", "in which the reference begins", 3.0, 1e-3, 1e3),
    Port("start_1_rad", "rad", "q1 of the robot at rest", -1.570796326794897, -10.0, 10.0),
    Port("start_2_rad", "rad", "q2 of the robot at rest", 0.0, -10.0, 10.0),
)
SETTINGS = (
    *GAINS,
    Port("delay_s", "s", "T of each direction; 0: the rig's own", 0.2, 0.0, 10.0),
)
PARAMETERS = (
    *GAINS,
    Port("delay_ticks", "", "N", None, 0.0, LONGEST),
    Port("model", "", "Ad, Bd", size=ENTRIES),
)
INPUTS = (
    Port("position_1_rad", "rad", "q1 told by the robot", 0.0),
    Port("position_2_rad", "rad", "q2 told by the robot", 0.0),
    Port("rate_1_rad_s", "rad/s", "q1' told by the robot", 0.0),
    Port("rate_2_rad_s", "rad/s", "q2' told by the robot", 0.0),
    Port("position_tick", "", "wire tick of the positions", 0.0),
    Port("rate_tick", "", "wire tick of the rates", 0.0),
    Port("echo_tick", "", "wire tick of the echo", 0.0),
    Port("echo", "", "wire tick of the u in use at that tick", 0.0),
)
OUTPUTS = (
    Port("u_1_rad_s2", "rad/s2", "to the robot, joint 1"),
    Port("u_2_rad_s2", "rad/s2", "to the robot, joint 2"),
    Port("tick", "", "wire tick of u"),
    Port("law", "", "local_law"),
    Port("delay", "", "N"),
    Port("aim_1_rad", "rad", "q_d of joint 1, T ago: what the robot should do now"),
    Port("aim_2_rad", "rad", "q_d of joint 2, T ago"),
    Port("e_1_rad", "rad", "e of joint 1"),
    Port("e_2_rad", "rad", "e of joint 2"),
    Port("r_1_rad_s", "rad/s", "r of joint 1"),
    Port("r_2_rad_s", "rad/s", "r of joint 2"),
    Port("seen_1_rad", "rad", "q1 in use, T old"),
    Port("seen_2_rad", "rad", "q2 in use, T old"),
    Port("off_1_rad", "rad", "seen position of joint 1 against z of its time"),
    Port("off_2_rad", "rad", "of joint 2"),
    Port("off_rate_1_rad_s", "rad/s", "seen rate of joint 1 against z of its time"),
    Port("off_rate_2_rad_s", "rad/s", "of joint 2"),
    Port("z_1_rad", "rad", "z of joint 1"),
    Port("z_2_rad", "rad", "z of joint 2"),
    Port("held_x", "", "ticks without a new x, of the whole run"),
    Port("looked_up", "", "ticks of age of the z that x is compared with"),
)
STATES = (
    Port("z", "", "q1, v1, q2, v2 of the model", size=4, recorded=False),
    Port("u_last", "rad/s2", "u of the last tick", size=JOINTS, recorded=False),
    Port("x_used", "", "q1, q2, v1, v2 in use", size=4, recorded=False),
    Port("waiting", "", "q1, q2, v1, v2 of the last frames that were played", 0.0, size=4,
         recorded=False),
    Port("x_tick", "", "tick of the x in use", -1.0, recorded=False),
    Port("ages_at_hand", "", "ticks from u to x: of the x in use, come in, played last", size=3,
         recorded=False),
    Port("last_tick", "", "tick of z", recorded=False),
    Port("missed", "", "ticks without a new x", recorded=False),
    Port("positions", "", "play-out", EMPTY, size=SLOTS * JOINTS, recorded=False),
    Port("rates", "", "play-out", EMPTY, size=SLOTS * JOINTS, recorded=False),
    Port("ages", "", "play-out", EMPTY, size=SLOTS, recorded=False),
    Port("history", "", "z of the last ticks", size=HISTORY * 4, recorded=False),
)  # fmt: skip
(KV, LAM, LOCAL_LAW, PREDICTOR, MATCH, USE_ECHO, HISTORY_OFFSET, U_LSB, SIZE, _, OMEGA, _, RISE,
 START, _, DELAY, MODEL) = range(17)  # fmt: skip
CANCEL = 1.0  # the local law of a bare double integrator
_Z, _U, _USED, _WAITING, _X_TICK, _AGE, _LAST, _MISSED, _POSITIONS = 0, 4, 6, 10, 14, 15, 18, 19, 20
_RATES = _POSITIONS + SLOTS * JOINTS
_AGES = _RATES + SLOTS * JOINTS
_HISTORY = _AGES + SLOTS


@inline
def remembered(tick: float) -> int:
    """Return where z of a tick begins in the history; ticks below 0 are those before the run."""
    return int(tick - HISTORY * floor(tick / HISTORY)) * 4


@inline
def listen(now: float, p: Any, x: Any, u: Any) -> None:
    """Put what came into the buffers, take out what is due; hold x unless all of it is there."""
    delay = p[DELAY]
    positions, rates, ages = tail(x, _POSITIONS), tail(x, _RATES), tail(x, _AGES)
    waiting, used, age = tail(x, _WAITING), tail(x, _USED), tail(x, _AGE)
    if delay < 0.5:  # the newest, whatever its tick
        for i in range(4):
            used[i] = where(u[4 + i // 2] > 0.5, u[i], used[i])
        x[_X_TICK] = now
        return
    put(positions, JOINTS, u[4], now, delay, u, 0)
    put(rates, JOINTS, u[5], now, delay, u, 2)
    age[1] = where(u[7] > 0.5, tick_of(u[6], now) - tick_of(u[7], now), delay)
    put(ages, 1, u[6], now, delay, age, 1)
    due = now - delay
    missing = take(positions, JOINTS, due, waiting) + take(rates, JOINTS, due, tail(waiting, 2))
    take(ages, 1, due, tail(age, 2))
    fresh = missing < 0.5
    for i in range(4):
        used[i] = where(fresh, waiting[i], used[i])
    x[_X_TICK] = where(fresh, due, x[_X_TICK])
    age[0] = where(fresh, age[2], age[0])
    x[_MISSED] += where(fresh | (due < 0.0), 0.0, 1.0)


@inline
def keep_model(now: float, p: Any, x: Any) -> None:
    """Bring z from the tick of the last call to `now` under the u of then (1), storing each."""
    history, d = tail(x, _HISTORY), tail(p, MODEL)
    for _ in range(int(now - x[_LAST])):
        for j in range(JOINTS):
            x[_Z + 2 * j], x[_Z + 2 * j + 1] = advance(d, x[2 * j], x[2 * j + 1], x[_U + j])
        x[_LAST] += 1.0
        at = remembered(x[_LAST])
        for i in range(4):
            history[at + i] = x[_Z + i]


@inline
def compared_tick(now: float, p: Any, x: Any) -> float:
    """Return the tick of the z that belongs to the x in use (2)."""
    age = where(p[USE_ECHO] > 0.5, x[_AGE], p[DELAY])
    oldest = now - (HISTORY - 1.0)
    return clip(x[_X_TICK] - age - p[HISTORY_OFFSET], oldest, now)


@inline
def control(
    j: int, t: float, dt: float, off_q: float, off_v: float, p: Any, x: Any, y: Any
) -> None:
    """Write u of joint `j` (0 or 1) by (2) to (4), with what is shown of it."""
    size, omega, start, rise = p[SIZE + j], p[OMEGA + j], p[START + j], p[RISE]
    delay_s = p[DELAY] * dt
    q_d, v_d, a_d = soft_sine(t, size, omega, rise)
    if p[MATCH] > 0.5:
        q_d, v_d, _ = soft_sine(t - 2.0 * delay_s, size, omega, rise)
    q, v = x[_USED + j], x[_USED + JOINTS + j]
    if p[PREDICTOR] > 0.5:
        q, v = x[_Z + 2 * j] + off_q, x[_Z + 2 * j + 1] + off_v
    e, e_rate = start + q_d - q, v_d - v
    r = e_rate + p[LAM] * e
    u = a_d + p[LAM] * e_rate + p[KV] * r
    if p[LOCAL_LAW] > CANCEL:
        u = u - A21 * q - A22 * v
    u = clip(u, -U_LIMIT_RAD_S2, U_LIMIT_RAD_S2)
    if p[U_LSB] > 0.0:
        u = p[U_LSB] * floor(u / p[U_LSB] + 0.5)
    aim, _, _ = soft_sine(t - delay_s, size, omega, rise)
    y[j] = x[_U + j] = u
    y[5 + j], y[7 + j], y[9 + j], y[11 + j] = start + aim, e, r, x[_USED + j]
    y[13 + j], y[15 + j], y[17 + j] = off_q, off_v, x[_Z + 2 * j]


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One tick; see the module header."""
    now = floor(t / dt + 0.5)
    keep_model(now, p, x)
    listen(now, p, x, u)
    compared = compared_tick(now, p, x)
    z = tail(x, _HISTORY)
    at = remembered(compared)
    for j in range(JOINTS):
        off_q = x[_USED + j] - z[at + 2 * j]
        off_v = x[_USED + JOINTS + j] - z[at + 2 * j + 1]
        control(j, t, dt, off_q, off_v, p, x, y)
    y[2], y[3], y[4] = wire_tick(now), p[LOCAL_LAW], p[DELAY]
    y[19], y[20] = x[_MISSED], now - compared


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return N, Ad, Bd and buffers that hold the robot at rest for all ticks before the run."""
    ticks = float(round(settings["delay_s"] * rate_hz))
    if ticks > LONGEST:
        raise ValueError(
            f"delay_s {settings['delay_s']:g}: {ticks:.0f} cycles; at most {LONGEST:.0f}"
        )
    at_rest = [settings["start_1_rad"], 0.0, settings["start_2_rad"], 0.0]
    own = {port.name: settings[port.name] for port in GAINS}
    used = [at_rest[0], at_rest[2], 0.0, 0.0]
    resting = 0.0 if settings["local_law"] == CANCEL else -A21
    states: dict[str, float | list[float]] = {
        "z": at_rest, "x_used": used, "waiting": used, "ages_at_hand": [ticks] * 3,
        "x_tick": -ticks, "history": at_rest * HISTORY,
        "u_last": [resting * at_rest[0], resting * at_rest[2]],
    }  # fmt: skip
    return Prepared({**own, "delay_ticks": ticks, "model": sampled(1.0 / rate_hz)}, states)


BLOCK = Block(
    step,
    inputs=INPUTS,
    outputs=OUTPUTS,
    settings=SETTINGS,
    parameters=PARAMETERS,
    states=STATES,
    prepare=prepare,
)
