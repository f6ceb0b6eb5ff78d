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

from pcpc.executive.laws.block import Block, Ports, Prepared, group, inline, port, stage
from pcpc.executive.laws.emath import clip, floor, sqrt, tanh, where
from pcpc.executive.laws.models.double_pole import (
    A21,
    A22,
    JOINTS,
    Joints,
    Sampled,
    advance,
    sampled,
)
from pcpc.executive.laws.models.playout import EMPTY, SLOTS, put, take, tick_of, wire_tick
from pcpc.executive.laws.models.two_link import gravity_torque, motion, solved

NODES, NET_INPUTS = 20, 1 + 2 * JOINTS
UNKNOWN, CANCEL, MODEL, ROBUST, NETWORK = 0.0, 1.0, 2.0, 3.0, 4.0


class Gains(Ports):
    """The robust term, the network, the nominal arm and the limits."""

    kr_per_s = port("1/s", "Kr, robust term", None, 0.0, 1e4)
    kw = port("", "Kw, robust term per norm of W", None, 0.0, 1e3)
    gam = port("", "Gam, tuning rate", None, 0.0, 1e5)
    kap = port("", "kap, leak", None, 0.0, 1e3)
    a1_m = port("m", "nominal length of link 1", None, 1e-3, 100.0)
    a2_m = port("m", "nominal length of link 2", None, 1e-3, 100.0)
    m1_kg = port("kg", "nominal mass at link 1", None, 1e-3, 1e4)
    m2_kg = port("kg", "nominal mass at link 2", None, 1e-3, 1e4)
    gravity_m_s2 = port("m/s2", "nominal g", None, -100.0, 100.0)
    tau_max_Nm = port("N m", "limit of joint #", None, 0.0, 1e4,
                      shape=JOINTS, named="tau_max_#_Nm")  # fmt: skip
    speed_limit_rad_s = port("rad/s", "at which a joint trips", None, 0.0, 1e4)
    brake_Nms_rad = port("N m s/rad", "damping once tripped", None, 0.0, 1e4)


class Settings(Gains):
    """The gains, and what draws the first layer."""

    network_seed = port("", "draws V", 3.0, 0.0, 2.0**31)


class Parameters(Gains):
    """The gains, the model for this rate, and the first layer."""

    model = group(Sampled)
    v = port("", "V (5, 20), row by row", shape=(NET_INPUTS, NODES))


class Inputs(Ports):
    """What the operator sent, and the measured motion."""

    u_rad_s2 = port("rad/s2", "newest u of joint #", 0.0, shape=JOINTS, named="u_#_rad_s2")
    tick = port("", "wire tick of u", 0.0)
    law = port("", "1 cancel, 2 As, 3 robust, 4 network; 0 unknown", 0.0)
    delay = port("", "N", 0.0)
    q_rad = port("rad", "measured q#", shape=JOINTS, named="q_#_rad")
    rate_rad_s = port("rad/s", "measured q#'", shape=JOINTS, named="rate_#_rad_s")


class Outputs(Ports):
    """The torques, what is told to the operator, and what led to it."""

    torque_Nm = port("N m", "to joint #", shape=JOINTS, named="torque_#_Nm")
    sample_tick = port("", "wire tick of this sample")
    echo = port("", "wire tick of the ul in use; 0: N is not known yet")
    ul_rad_s2 = port("rad/s2", "ul of joint #", shape=JOINTS, named="ul_#_rad_s2")
    model_rad = port("rad", "xh, position of joint #", shape=JOINTS, named="model_#_rad")
    model_rate_rad_s = port("rad/s", "xh, rate of joint #",
                            shape=JOINTS, named="model_rate_#_rad_s")  # fmt: skip
    network_rad_s2 = port("rad/s2", "W'ph of joint #", shape=JOINTS, named="network_#_rad_s2")
    norm_w = port("", "Frobenius norm of W")
    held_u = port("", "ticks without a new u, of the whole run")
    tripped = port("", "1 once a joint was too fast")


class States(Ports):
    """The identifier, the ticks, the play-out and the network."""

    xh = group(Joints, "xh_")
    driving = port("rad/s2", "what drives the identifier until the next tick",
                   shape=JOINTS, recorded=False)  # fmt: skip
    ul = port("rad/s2", "u in use", shape=JOINTS, recorded=False)
    start = port("rad", "q(0)", shape=JOINTS, recorded=False)
    begun = port("", "1 after the first tick", recorded=False)
    xh_tick = port("", "tick of xh", recorded=False)
    ul_tick = port("", "tick of ul", recorded=False)
    ahead = port("", "ticks by which the operator's are ahead of this node's", recorded=False)
    played = port("", "1 after the first u", recorded=False)
    missed = port("", "ticks without a new u", recorded=False)
    trip = port("", "1 once a joint was too fast", recorded=False)
    st = port("", "st (1)", shape=JOINTS, recorded=False)
    learned = port("rad/s2", "W'ph", shape=JOINTS, recorded=False)
    seen = port("", "[1; q; q'] of (2)", shape=NET_INPUTS, recorded=False)
    ph = port("", "ph (2)", shape=NODES, recorded=False)
    w = port("rad/s2", "W (20, 2)", shape=(NODES, JOINTS), recorded=False, adapts=True)
    buffer = port("rad/s2", "play-out of u", EMPTY, shape=(JOINTS, SLOTS), recorded=False)


@inline
def begin(now: float, x: Any, u: Any) -> None:
    """At the first tick, start identifier and reference where the robot is."""
    first = x.begun < 0.5
    for j in range(JOINTS):
        x.start[j] = where(first, u.q_rad[j], x.start[j])
        x.xh.q[j] = where(first, u.q_rad[j], x.xh.q[j])
        x.xh.v[j] = where(first, u.rate_rad_s[j], x.xh.v[j])
    x.xh_tick = where(first, now, x.xh_tick)
    x.begun = 1.0


@inline
def identify(now: float, p: Any, x: Any) -> None:
    """Bring xh to this tick (5)."""
    for _ in range(int(now - x.xh_tick)):
        advance(p.model, x.xh, x.driving)
    x.xh_tick = now


@inline
def follow(now: float, x: Any, u: Any) -> float:
    """Return the tick of this cycle, not behind that of the newest u."""
    own = now + x.ahead
    behind = where(u.tick > 0.5, tick_of(u.tick, own) - own, 0.0)
    x.ahead += where(behind > 0.0, behind, 0.0)
    return now + x.ahead


@inline
def newest(due: float, x: Any, u: Any) -> None:
    """Without a delay, use what came last, whatever its tick."""
    came = u.tick > 0.5
    for j in range(JOINTS):
        x.ul[j] = where(came, u.u_rad_s2[j], x.ul[j])
    x.played = where(came, 1.0, x.played)
    x.ul_tick = due


@inline
def play(now: float, due: float, x: Any, u: Any) -> None:
    """Put what came into the buffer, take the u that is due into ul."""
    missing = 0.0
    for j in range(JOINTS):
        put(x.buffer[j], u.tick, now, u.delay, u.u_rad_s2[j])
        x.ul[j], none = take(x.buffer[j], due, x.ul[j])
        missing += none
    fresh = missing < 0.5
    x.played = where(fresh, 1.0, x.played)
    x.ul_tick = where(fresh | (due < 0.0), due, x.ul_tick)
    x.missed += where(fresh | (due < 0.0), 0.0, 1.0)


@inline
def listen(now: float, x: Any, u: Any) -> None:
    """Use the u of N ticks ago; until the first is due, the one that holds the robot at rest."""
    due = now - u.delay
    if u.delay < 0.5:
        newest(due, x, u)
    else:
        play(now, due, x, u)
    waiting = x.played < 0.5
    bare = abs(u.law - CANCEL) < 0.5
    for j in range(JOINTS):
        resting = where(bare, 0.0, -A21 * x.start[j])
        x.ul[j] = where(waiting, resting, x.ul[j])


@inline
def network(p: Any, x: Any, u: Any) -> float:
    """Write st (1), ph (2) and W'ph; return |W|."""
    x.seen[0] = 1.0
    for j in range(JOINTS):
        q, v = u.q_rad[j], u.rate_rad_s[j]
        x.seen[1 + j], x.seen[1 + JOINTS + j] = q, v
        x.st[j] = 10.0 * (q - x.xh.q[j]) + 2.0 * (v - x.xh.v[j])
        x.learned[j] = 0.0
    total = 0.0
    for n in range(NODES):
        a = 0.0
        for i in range(NET_INPUTS):
            a += p.v[i, n] * x.seen[i]
        x.ph[n] = tanh(a)
        for j in range(JOINTS):
            x.learned[j] += x.w[n, j] * x.ph[n]
            total += x.w[n, j] * x.w[n, j]
    return sqrt(total)


@inline
def learn(dt: float, p: Any, x: Any, u: Any) -> None:
    """Tune W (6)."""
    rate = where(u.law > ROBUST, dt * p.gam, 0.0)
    for n in range(NODES):
        for j in range(JOINTS):
            x.w[n, j] += rate * (x.ph[n] * x.st[j] - p.kap * x.w[n, j])


@inline
def acceleration(j: int, norm: float, p: Any, x: Any, u: Any) -> float:
    """Return what is asked of joint `j` beside the nominal torques, rad/s2."""
    poles = A21 * u.q_rad[j] + A22 * u.rate_rad_s[j]
    asked = x.ul[j] + where(u.law > CANCEL, poles, 0.0)
    robust = x.learned[j] + (p.kr_per_s + p.kw * norm) * x.st[j]  # (3)
    return asked - where(u.law > MODEL, robust, 0.0)


@inline
def limited(j: int, wanted: float, p: Any, x: Any, u: Any, y: Any) -> float:
    """Write the torque of joint `j`, the brake's once tripped; return what the limits take."""
    asked = where(x.trip > 0.5, -p.brake_Nms_rad * u.rate_rad_s[j], wanted)
    y.torque_Nm[j] = clip(asked, -p.tau_max_Nm[j], p.tau_max_Nm[j])
    return y.torque_Nm[j] - asked


@inline
def drive(norm: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """Write the torques (4) or (7) to (9), and what they leave to drive the identifier (5)."""
    q, v = u.q_rad, u.rate_rad_s
    m11, m12, m22, c1, c2 = motion(p, p.m2_kg, q, v)
    g1, g2 = gravity_torque(q[0], q[1], p.a1_m, p.a2_m, p.m1_kg, p.m2_kg, p.gravity_m_s2)
    on = where(u.law > UNKNOWN, 1.0, 0.0)
    known = where(u.law > MODEL, 0.0, 1.0)
    a1, a2 = acceleration(0, norm, p, x, u), acceleration(1, norm, p, x, u)
    wanted_1 = on * (m11 * a1 + m12 * a2 + known * (c1 + g1))
    wanted_2 = on * (m12 * a1 + m22 * a2 + known * (c2 + g2))
    fast = (abs(v[0]) > p.speed_limit_rad_s) | (abs(v[1]) > p.speed_limit_rad_s)
    x.trip = where(fast, 1.0, x.trip)
    cut_1, cut_2 = limited(0, wanted_1, p, x, u, y), limited(1, wanted_2, p, x, u, y)
    lacking_1, lacking_2 = solved(m11, m12, m22, cut_1, cut_2)
    x.driving[0], x.driving[1] = x.ul[0] + lacking_1, x.ul[1] + lacking_2


@inline
def show(x: Any, y: Any) -> None:
    """Write ul, xh and W'ph."""
    for j in range(JOINTS):
        y.ul_rad_s2[j], y.network_rad_s2[j] = x.ul[j], x.learned[j]
        y.model_rad[j], y.model_rate_rad_s[j] = x.xh.q[j], x.xh.v[j]


@stage
def step(t: float, dt: float, p: Parameters, x: States, u: Inputs, y: Outputs) -> None:
    """One tick; see the module header."""
    now = floor(t / dt + 0.5)
    begin(now, x, u)
    identify(now, p, x)
    now = follow(now, x, u)
    listen(now, x, u)
    y.norm_w = network(p, x, u)
    drive(y.norm_w, p, x, u, y)
    learn(dt, p, x, u)
    y.sample_tick = wire_tick(now)
    y.echo = where(u.law > UNKNOWN, wire_tick(x.ul_tick), 0.0)
    y.held_u, y.tripped = x.missed, x.trip
    show(x, y)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the gains, Ad, Bd and V (5, 20) uniform in +-1, drawn row by row."""
    draw = np.random.default_rng(int(settings["network_seed"])).uniform
    own = {one.name: settings[one.name] for one in Gains.ports}
    v = draw(-1.0, 1.0, (NET_INPUTS, NODES)).ravel().tolist()
    return Prepared({**own, **sampled(1.0 / rate_hz), "v": v})


BLOCK = Block(step, settings=Settings, prepare=prepare)
