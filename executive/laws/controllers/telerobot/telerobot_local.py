"""The robot's side of a telerobot: makes the arm behave as a pair of equal poles under u(t - T).

    st  = 10 (q - qh) + 2 (q' - qh')  = B'P (x - xh),  As'P + P As = -diag(500, 500, 20, 20)  (1)
    ph  = tanh(V'[1; q; q'])                           L = 20 nodes, W (20, 2), V (5, 20)     (2)
    v   = (Kr + Kw |W|) st                             robust term                            (3)
    tau = Mhat (ul + A21 q + A22 q' - W'ph - v)        within +-tau_max                       (4)
    xh+ = Ad xh + Bd (ul + Mhat^-1 (tau - tau before the limits)),  xh(0) = x(0)              (5)
    W  += h Gam (ph st' - kap W)                       after (4), which uses the old W        (6)

(4) puts q'' = As-part + u(t - T) + what Mhat, which knows no gravity, friction or payload, leaves;
W'ph learns that, and xh, the recurrent identifier, is then a reference model. kap > 0 has to be a
constant leak: the delay puts W~(t - T) into r' (Theorem 8.5.1).

`law` comes with u: 4 network (1) to (6); 3 robust, W = 0; others from the nominal model alone,
2 As        tau = Mhat (ul + A21 q + A22 q') + Vm q' + G                                      (7)
1 cancel    tau = Mhat ul + Vm q' + G,  a double integrator                                   (8)
0 unknown   tau = 0, until the first frame tells; no start-up kick, as the arm hangs          (9)

ul is u of N ticks ago, by `playout.py`: held, and counted, where its frame is missing. Before the
first it is what holds the robot where it stands: -A21 q(0), or 0 for (8). The frames of a sample
tell its tick and, as echo, that of the ul in use.

Ticks are cycles, and where the operator skipped some that this node did not, as it may where SYNC
starts its cycles, its ticks jump after those that come with u. Time, and so (5), goes on as it was.

A joint faster than `speed_limit_rad_s` trips for good: tau = -brake q'.

rad, rad/s, N m. Source: Lewis, Campos, Selmic (SIAM 2002), chapter 8; numbers are this project's.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.emath import clip, floor, sincos, sqrt, tanh, where
from pcpc.executive.laws.models.double_pole import A21, A22, ENTRIES, advance, sampled
from pcpc.executive.laws.models.playout import EMPTY, SLOTS, put, take, tick_of, wire_tick
from pcpc.executive.laws.models.two_link import gravity_torque, inertia, velocity_torque

JOINTS, NODES, NET_INPUTS = 2, 20, 5
UNKNOWN, CANCEL, MODEL, ROBUST, NETWORK = 0.0, 1.0, 2.0, 3.0, 4.0

GAINS = (
    Port("kr_per_s", "1/s", "Kr, robust term", None, 0.0, 1e4),
    Port("kw", "", "Kw, robust term per norm of W", None, 0.0, 1e3),
    Port("gam", "", "Gam, tuning rate", None, 0.0, 1e5),
    Port("kap", "", "kap, leak", None, 0.0, 1e3),
    Port("a1_m", "m", "nominal length of link 1", None, 1e-3, 100.0),
    Port("a2_m", "m", "nominal length of link 2", None, 1e-3, 100.0),
    Port("m1_kg", "kg", "nominal mass at link 1", None, 1e-3, 1e4),
    Port("m2_kg", "kg", "nominal mass at link 2", None, 1e-3, 1e4),
    Port("gravity_m_s2", "m/s2", "nominal g", None, -100.0, 100.0),
    Port("tau_max_1_Nm", "N m", "limit of joint 1", None, 0.0, 1e4),
    Port("tau_max_2_Nm", "N m", "limit of joint 2", None, 0.0, 1e4),
    Port("speed_limit_rad_s", "rad/s", "at which a joint trips", None, 0.0, 1e4),
    Port("brake_Nms_rad", "N m s/rad", "damping once tripped", None, 0.0, 1e4),
)
SETTINGS = (*GAINS, Port("network_seed", "", "draws V", 3.0, 0.0, 2.0**31))
PARAMETERS = (
    *GAINS,
    Port("model", "", "Ad, Bd", size=ENTRIES),
    Port("v", "", "V (5, 20), row by row", size=NET_INPUTS * NODES),
)
INPUTS = (
    Port("u_1_rad_s2", "rad/s2", "newest u of joint 1", 0.0),
    Port("u_2_rad_s2", "rad/s2", "newest u of joint 2", 0.0),
    Port("tick", "", "wire tick of u", 0.0),
    Port("law", "", "1 cancel, 2 As, 3 robust, 4 network; 0 unknown", 0.0),
    Port("delay", "", "N", 0.0),
    Port("q_1_rad", "rad", "measured q1"),
    Port("q_2_rad", "rad", "measured q2"),
    Port("rate_1_rad_s", "rad/s", "measured q1'"),
    Port("rate_2_rad_s", "rad/s", "measured q2'"),
)
OUTPUTS = (
    Port("torque_1_Nm", "N m", "to joint 1"),
    Port("torque_2_Nm", "N m", "to joint 2"),
    Port("sample_tick", "", "wire tick of this sample"),
    Port("echo", "", "wire tick of the ul in use; 0: N is not known yet"),
    Port("ul_1_rad_s2", "rad/s2", "ul of joint 1"),
    Port("ul_2_rad_s2", "rad/s2", "ul of joint 2"),
    Port("model_1_rad", "rad", "xh, position of joint 1"),
    Port("model_2_rad", "rad", "xh, position of joint 2"),
    Port("model_rate_1_rad_s", "rad/s", "xh, rate of joint 1"),
    Port("model_rate_2_rad_s", "rad/s", "xh, rate of joint 2"),
    Port("network_1_rad_s2", "rad/s2", "W'ph of joint 1"),
    Port("network_2_rad_s2", "rad/s2", "W'ph of joint 2"),
    Port("norm_w", "", "Frobenius norm of W"),
    Port("held_u", "", "ticks without a new u, of the whole run"),
    Port("tripped", "", "1 once a joint was too fast"),
)
STATES = (
    Port("xh", "", "q1, v1, q2, v2 of the identifier", size=4, recorded=False),
    Port("driving", "rad/s2", "what drives the identifier until the next tick", size=JOINTS,
         recorded=False),
    Port("ul", "rad/s2", "u in use", size=JOINTS, recorded=False),
    Port("start", "rad", "q(0)", size=JOINTS, recorded=False),
    Port("begun", "", "1 after the first tick", recorded=False),
    Port("last_tick", "", "tick of xh", recorded=False),
    Port("u_tick", "", "tick of ul", recorded=False),
    Port("ahead", "", "ticks by which the operator's are ahead of this node's", recorded=False),
    Port("played", "", "1 after the first u", recorded=False),
    Port("missed", "", "ticks without a new u", recorded=False),
    Port("trip", "", "1 once a joint was too fast", recorded=False),
    Port("scratch", "", "st, W'ph, x, ph", size=2 * JOINTS + NET_INPUTS + NODES, recorded=False),
    Port("w", "rad/s2", "W (20, 2)", size=NODES * JOINTS, recorded=False),
    Port("buffer", "rad/s2", "play-out of u", EMPTY, size=SLOTS * JOINTS, recorded=False),
)  # fmt: skip
(KR, KW, GAM, KAP, A1, A2, M1, M2, G, TAU_MAX, _, SPEED_LIMIT, BRAKE, AD) = range(14)
V = AD + ENTRIES
(_XH, _DRIVING, _UL, _START, _BEGUN, _LAST, _U_TICK, _AHEAD, _PLAYED, _MISSED, _TRIP, _ST) = (
    0, 4, 6, 8, 10, 11, 12, 13, 14, 15, 16, 17,
)  # fmt: skip
_LEARNED = _ST + JOINTS
_IN = _LEARNED + JOINTS
_PH = _IN + NET_INPUTS
_W = _PH + NODES
_BUFFER = _W + NODES * JOINTS
LAW, DELAY, Q, RATE = 3, 4, 5, 7  # of the inputs


@inline
def begin(now: float, x: Any, u: Any) -> None:
    """At the first tick, start identifier and reference where the robot is."""
    first = x[_BEGUN] < 0.5
    for j in range(JOINTS):
        x[_START + j] = where(first, u[Q + j], x[_START + j])
        x[_XH + 2 * j] = where(first, u[Q + j], x[_XH + 2 * j])
        x[_XH + 2 * j + 1] = where(first, u[RATE + j], x[_XH + 2 * j + 1])
    x[_LAST] = where(first, now, x[_LAST])
    x[_BEGUN] = 1.0


@inline
def follow(now: float, x: Any, u: Any) -> float:
    """Return the tick of this cycle, not behind that of the newest u."""
    own = now + x[_AHEAD]
    behind = where(u[2] > 0.5, tick_of(u[2], own) - own, 0.0)
    x[_AHEAD] += where(behind > 0.0, behind, 0.0)
    return now + x[_AHEAD]


@inline
def listen(now: float, x: Any, u: Any) -> None:
    """Put what came into the buffer, take the u that is due into ul."""
    buffer, ul = tail(x, _BUFFER), tail(x, _UL)
    delay = u[DELAY]
    due = now - delay
    if delay < 0.5:  # the newest, whatever its tick
        for j in range(JOINTS):
            ul[j] = where(u[2] > 0.5, u[j], ul[j])
        x[_PLAYED] = where(u[2] > 0.5, 1.0, x[_PLAYED])
        x[_U_TICK] = due
        return
    put(buffer, JOINTS, u[2], now, delay, u, 0)
    missing = take(buffer, JOINTS, due, ul)
    fresh = missing < 0.5
    x[_PLAYED] = where(fresh, 1.0, x[_PLAYED])
    x[_U_TICK] = where(fresh | (due < 0.0), due, x[_U_TICK])
    x[_MISSED] += where(fresh | (due < 0.0), 0.0, 1.0)


@inline
def prefill(x: Any, u: Any) -> None:
    """Let ul hold the robot at rest until the first u is due."""
    waiting = x[_PLAYED] < 0.5
    bare = abs(u[LAW] - CANCEL) < 0.5
    for j in range(JOINTS):
        resting = where(bare, 0.0, -A21 * x[_START + j])
        x[_UL + j] = where(waiting, resting, x[_UL + j])


@inline
def identify(now: float, p: Any, x: Any) -> None:
    """Bring xh to this tick (5)."""
    d = tail(p, AD)
    for _ in range(int(now - x[_LAST])):
        for j in range(JOINTS):
            at = _XH + 2 * j
            x[at], x[at + 1] = advance(d, x[at], x[at + 1], x[_DRIVING + j])
    x[_LAST] = now


@inline
def network(p: Any, x: Any, u: Any) -> float:
    """Write st (1), ph (2) and W'ph; return |W|."""
    inputs, v = tail(x, _IN), tail(p, V)
    inputs[0] = 1.0
    for j in range(JOINTS):
        inputs[1 + j] = u[Q + j]
        inputs[3 + j] = u[RATE + j]
        off_q, off_v = u[Q + j] - x[_XH + 2 * j], u[RATE + j] - x[_XH + 2 * j + 1]
        x[_ST + j] = 10.0 * off_q + 2.0 * off_v
        x[_LEARNED + j] = 0.0
    total = 0.0
    for n in range(NODES):
        a = 0.0
        for i in range(NET_INPUTS):
            a += v[i * NODES + n] * inputs[i]
        x[_PH + n] = tanh(a)
        for j in range(JOINTS):
            w = x[_W + JOINTS * n + j]
            x[_LEARNED + j] += w * x[_PH + n]
            total += w * w
    return sqrt(total)


@inline
def learn(dt: float, p: Any, x: Any, u: Any) -> None:
    """Tune W (6)."""
    rate = where(u[LAW] > ROBUST, dt * p[GAM], 0.0)
    for n in range(NODES):
        for j in range(JOINTS):
            at = _W + JOINTS * n + j
            x[at] += rate * (x[_PH + n] * x[_ST + j] - p[KAP] * x[at])


@inline
def acceleration(j: int, norm: float, p: Any, x: Any, u: Any) -> float:
    """Return what is asked of joint `j` beside the nominal torques, rad/s2."""
    asked = x[_UL + j]
    asked += where(u[LAW] > CANCEL, A21 * u[Q + j] + A22 * u[RATE + j], 0.0)
    robust = x[_LEARNED + j] + (p[KR] + p[KW] * norm) * x[_ST + j]
    return asked - where(u[LAW] > MODEL, robust, 0.0)


@inline
def drive(norm: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Write the torques (4) or (7) to (9), and what they leave to drive the identifier (5)."""
    sin_q2, cos_q2 = sincos(u[Q + 1])
    m11, m12, m22 = inertia(cos_q2, p[A1], p[A2], p[M1], p[M2])
    h = p[M2] * p[A1] * p[A2] * sin_q2
    c1, c2 = velocity_torque(h, u[RATE], u[RATE + 1])
    g1, g2 = gravity_torque(u[Q], u[Q + 1], p[A1], p[A2], p[M1], p[M2], p[G])
    known = where(u[LAW] > MODEL, 0.0, 1.0)
    a1, a2 = acceleration(0, norm, p, x, u), acceleration(1, norm, p, x, u)
    wanted_1 = m11 * a1 + m12 * a2 + known * (c1 + g1)
    wanted_2 = m12 * a1 + m22 * a2 + known * (c2 + g2)
    on = where(u[LAW] > UNKNOWN, 1.0, 0.0)
    wanted_1, wanted_2 = on * wanted_1, on * wanted_2
    fast = (abs(u[RATE]) > p[SPEED_LIMIT]) | (abs(u[RATE + 1]) > p[SPEED_LIMIT])
    x[_TRIP] = where(fast, 1.0, x[_TRIP])
    wanted_1 = where(x[_TRIP] > 0.5, -p[BRAKE] * u[RATE], wanted_1)
    wanted_2 = where(x[_TRIP] > 0.5, -p[BRAKE] * u[RATE + 1], wanted_2)
    y[0] = clip(wanted_1, -p[TAU_MAX], p[TAU_MAX])
    y[1] = clip(wanted_2, -p[TAU_MAX + 1], p[TAU_MAX + 1])
    cut_1, cut_2 = y[0] - wanted_1, y[1] - wanted_2
    det = m11 * m22 - m12 * m12
    x[_DRIVING] = x[_UL] + (m22 * cut_1 - m12 * cut_2) / det
    x[_DRIVING + 1] = x[_UL + 1] + (m11 * cut_2 - m12 * cut_1) / det


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One tick; see the module header."""
    now = floor(t / dt + 0.5)
    begin(now, x, u)
    identify(now, p, x)
    now = follow(now, x, u)
    listen(now, x, u)
    prefill(x, u)
    norm = network(p, x, u)
    drive(norm, p, x, u, y)
    learn(dt, p, x, u)
    y[2] = wire_tick(now)
    y[3] = where(u[LAW] > UNKNOWN, wire_tick(x[_U_TICK]), 0.0)
    for j in range(JOINTS):
        y[4 + j] = x[_UL + j]
        y[6 + j], y[8 + j] = x[_XH + 2 * j], x[_XH + 2 * j + 1]
        y[10 + j] = x[_LEARNED + j]
    y[12], y[13], y[14] = norm, x[_MISSED], x[_TRIP]


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the gains, Ad, Bd and V (5, 20) uniform in +-1, drawn row by row."""
    draw = np.random.default_rng(int(settings["network_seed"])).uniform
    own = {port.name: settings[port.name] for port in GAINS}
    v = draw(-1.0, 1.0, (NET_INPUTS, NODES)).ravel().tolist()
    return Prepared({**own, "model": sampled(1.0 / rate_hz), "v": v})


BLOCK = Block(
    step,
    inputs=INPUTS,
    outputs=OUTPUTS,
    settings=SETTINGS,
    parameters=PARAMETERS,
    states=STATES,
    prepare=prepare,
)
