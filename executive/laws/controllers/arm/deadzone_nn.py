"""Two neural networks a joint that undo an unknown deadzone in front of the two-link arm.

    e = q_d - q,  e' = q_d' - v,  r = e' + Lam e                                             (1)
    f = M(q)(q_d'' + Lam e') + Vm(q, v)(q_d' + Lam e)        the arm's model                 (2)
    w = f + Kv r                                             all that PD sends               (3)
    s   = [s_1..s_L, p0, p1],  s_j = sgm(Vi_j w + v0i_j)                                     (4)
    p0  = 1 for w >= 0 else 0,  p1 = 1 - exp(-w) for w >= 0 else 0        jump nodes         (5)
    y   = Wi's,  u = clip(w + y, u_max)                      network II, the compensator     (6)
    tau^ = sum_j W_j sgm(V_j u + v0_j)                       network I, the deadzone as seen (7)
    b_j = sgm'(V_j u + v0_j) V_j,  J = W'b                   its slope, u before the clip    (8)

(4) to (8) stand once for each joint i = 1, 2. Tuning, |r| and |Wi| over both joints:

    Wi' =  T s r_i J   - k1 T |r| Wi - k2 T |r| |Wi| Wi                                      (9)
    W'  = -S b y_i r_i - k1 S |r| W                                                         (10)
    gradient terms by an Euler step, decay by 1/(1 + dt ...); all from the old W, Wi, y     (11)

Signs follow from L = r'M r/2 + tr(W~'W~)/2S + tr(Wi~'Wi~)/2T, whose cross terms they cancel. tau^
itself is not needed: only its slope and its gradient enter. The torque is not measured.

Start: for joint 1, then 2: V and v0, W, then Vi and v0i; |V| uniform in 0..1 with random signs, v0
in +-35, W in +-50; Wi = 0. With `positive_slope` 1, W takes the signs of V: the slope (8) then
begins non-negative at every u, as a deadzone's is. V and v0 stay as drawn.

Guard: as soon as |r| or the norm of all tuned weights is no finite number within its limit, both
commands are 0 and tuning ends, for good. rad, rad/s, N m; positive torque raises q.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.2; signs and (11) are derived.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pcpc.drivers.jit import inline
from pcpc.drivers.views import tail
from pcpc.executive.laws.block import Block, Port, Prepared, stage
from pcpc.executive.laws.emath import clip, exp, logistic, sincos, sqrt, where
from pcpc.executive.laws.models.two_link import inertia

JOINTS = 2
MOST_NODES = 40
JUMPS = 2
COLUMN = MOST_NODES + JUMPS  # room of a joint's output weights

INPUTS = tuple(
    Port(f"{name}{joint}_{suffix}", unit, f"{what} of joint {joint}")
    for joint in (1, 2)
    for name, suffix, unit, what in (
        ("q_d", "rad", "rad", "desired angle"),
        ("q_d", "rate_rad_s", "rad/s", "desired rate"),
        ("q_d", "acc_rad_s2", "rad/s2", "desired acceleration"),
        ("q", "rad", "rad", "measured angle"),
        ("v", "rad_s", "rad/s", "measured rate"),
    )
)
OUTPUTS = (
    Port("u1_Nm", "N m", "command of joint 1 (6)"),
    Port("u2_Nm", "N m", "command of joint 2 (6)"),
    Port("w1_Nm", "N m", "wanted torque of joint 1 (3)"),
    Port("w2_Nm", "N m", "wanted torque of joint 2 (3)"),
    Port("e1_rad", "rad", "error of joint 1 as measured"),
    Port("e2_rad", "rad", "error of joint 2 as measured"),
    Port("r1_rad_s", "rad/s", "filtered error of joint 1 (1)"),
    Port("r2_rad_s", "rad/s", "filtered error of joint 2 (1)"),
    Port("diverged", "", "1 once the guard has ended the control"),
)
NETWORK_OUTPUTS = (
    Port("y1_Nm", "N m", "compensator's output of joint 1 (6)"),
    Port("y2_Nm", "N m", "compensator's output of joint 2 (6)"),
    Port("slope1", "", "slope of the deadzone as seen by joint 1 (8)"),
    Port("slope2", "", "slope of the deadzone as seen by joint 2 (8)"),
    Port("norm_wi", "", "Frobenius norm of Wi, both joints"),
    Port("norm_w", "", "Frobenius norm of W, both joints"),
)
GAINS = (
    Port("kv_Nms_rad", "N m s/rad", "gain on the filtered error", None, 0.0, 1e4),
    Port("lam_per_s", "1/s", "slope of the filtered error", None, 0.0, 1e3),
    Port("u_max_Nm", "N m", "limit of the commands", None, 0.0, 1e4),
    Port("a1_m", "m", "length of the first link, as known", None, 1e-3, 100.0),
    Port("a2_m", "m", "length of the second link, as known", None, 1e-3, 100.0),
    Port("m1_kg", "kg", "mass at the end of the first link, as known", None, 1e-3, 1e4),
    Port("m2_kg", "kg", "mass at the end of the second link, as known", None, 1e-3, 1e4),
    Port("r_max_rad_s", "rad/s", "|r| at which control ends", None, 0.0, 1e6),
)
NETWORK = (
    Port("network_on", "", "1 engages both networks, 0 leaves (3) alone", 1.0, 0.0, 1.0),
    Port("t_rate", "", "T, tuning rate of the compensator", None, 0.0, 1e5),
    Port("s_rate", "", "S, tuning rate of network I; 0 freezes it", None, 0.0, 1e5),
    Port("k1", "", "decay of both networks", None, 0.0, 10.0),
    Port("k2", "", "further decay of the compensator", None, 0.0, 10.0),
    Port("jumps_on", "", "1 gives the compensator its jump nodes", 1.0, 0.0, 1.0),
    Port("nodes", "", "L, logistic nodes of each network", 20.0, 1.0, MOST_NODES),
    Port("norm_max", "", "norm of W and Wi at which control ends", None, 0.0, 1e9),
)
START = (
    Port("network_seed", "", "draws the networks", None, 0.0, 2.0**31),
    Port("positive_slope", "", "1 gives W the signs of V at the start", 1.0, 0.0, 1.0),
)
GUARD = (Port("ended", "", "1 once the guard has ended the control"),)
STATES = (
    *GUARD,
    Port("w", "N m", "W, a joint after the other", size=JOINTS * MOST_NODES, recorded=False),
    Port("v", "1/(N m)", "V, alike", size=JOINTS * MOST_NODES, recorded=False),
    Port("v0", "", "v0, alike", size=JOINTS * MOST_NODES, recorded=False),
    Port("vi", "1/(N m)", "Vi, alike", size=JOINTS * MOST_NODES, recorded=False),
    Port("v0i", "", "v0i, alike", size=JOINTS * MOST_NODES, recorded=False),
    Port("wi", "N m", "Wi, jump nodes behind the others", size=JOINTS * COLUMN, recorded=False),
    Port("back", "1/(N m)", "scratch: b of (8)", size=JOINTS * MOST_NODES, recorded=False),
    Port("hidden", "", "scratch: s of (4)", size=JOINTS * COLUMN, recorded=False),
)
KV, LAM, U_MAX, A1, A2, M1, M2, R_MAX = range(len(GAINS))
ON, T, S, K1, K2, JUMPS_ON, NODES, NORM_MAX = range(len(GAINS), len(GAINS) + len(NETWORK))
ENDED = 0
_W = 1
_V, _V0 = _W + JOINTS * MOST_NODES, _W + 2 * JOINTS * MOST_NODES
_VI, _V0I = _W + 3 * JOINTS * MOST_NODES, _W + 4 * JOINTS * MOST_NODES
_WI = _W + 5 * JOINTS * MOST_NODES
_BACK = _WI + JOINTS * COLUMN
_HIDDEN = _BACK + JOINTS * MOST_NODES
WANTED, ERROR, FILTERED, DIVERGED = 2, 4, 6, 8  # in OUTPUTS
COMPENSATOR, SLOPE, NORM_WI, NORM_W = 9, 11, 13, 14  # behind them


@inline
def follow(p: Any, u: Any, y: Any) -> float:
    """Write w (3), e and r (1) of both joints to `y`; return |r|, rad/s."""
    lam, kv = p[LAM], p[KV]
    q_d1, rate1, acc1, q1, v1 = u[0], u[1], u[2], u[3], u[4]
    q_d2, rate2, acc2, q2, v2 = u[5], u[6], u[7], u[8], u[9]
    e1, e2 = q_d1 - q1, q_d2 - q2
    e1_rate, e2_rate = rate1 - v1, rate2 - v2
    r1, r2 = e1_rate + lam * e1, e2_rate + lam * e2  # (1)
    wanted1, wanted2 = acc1 + lam * e1_rate, acc2 + lam * e2_rate
    moving1, moving2 = rate1 + lam * e1, rate2 + lam * e2
    sine, cosine = sincos(q2)
    m11, m12, m22 = inertia(cosine, p[A1], p[A2], p[M1], p[M2])
    h = p[M2] * p[A1] * p[A2] * sine
    c1 = -h * v2 * moving1 - h * (v1 + v2) * moving2
    f1 = m11 * wanted1 + m12 * wanted2 + c1  # (2)
    f2 = m12 * wanted1 + m22 * wanted2 + h * v1 * moving1
    y[WANTED], y[WANTED + 1] = f1 + kv * r1, f2 + kv * r2  # (3)
    y[ERROR], y[ERROR + 1] = e1, e2
    y[FILTERED], y[FILTERED + 1] = r1, r2
    return sqrt(r1 * r1 + r2 * r2)


@inline
def guard(healthy: bool, x: Any, y: Any) -> bool:
    """Latch the end of control; return whether it still goes on."""
    x[ENDED] = where(healthy, x[ENDED], 1.0)
    y[DIVERGED] = x[ENDED]
    return x[ENDED] < 0.5


@inline
def compensate(joint: int, w: float, p: Any, x: Any) -> float:
    """Write s (4) (5) of `joint` to the state and return y (6), N m."""
    n = int(p[NODES])
    s, wi = tail(x, _HIDDEN + joint * COLUMN), tail(x, _WI + joint * COLUMN)
    vi, v0i = tail(x, _VI + joint * MOST_NODES), tail(x, _V0I + joint * MOST_NODES)
    total = 0.0
    for j in range(n):
        s[j] = logistic(vi[j] * w + v0i[j])
        total += wi[j] * s[j]
    right = where(w >= 0.0, p[JUMPS_ON], 0.0)
    s[MOST_NODES] = right
    s[MOST_NODES + 1] = right * (1.0 - exp(-abs(w)))
    return total + wi[MOST_NODES] * s[MOST_NODES] + wi[MOST_NODES + 1] * s[MOST_NODES + 1]


@inline
def slope(joint: int, u: float, p: Any, x: Any) -> float:
    """Write b (8) of `joint` to the state and return J; `u` in N m, before the clip."""
    b, w = tail(x, _BACK + joint * MOST_NODES), tail(x, _W + joint * MOST_NODES)
    v, v0 = tail(x, _V + joint * MOST_NODES), tail(x, _V0 + joint * MOST_NODES)
    total = 0.0
    for j in range(int(p[NODES])):
        z = logistic(v[j] * u + v0[j])
        b[j] = z * (1.0 - z) * v[j]
        total += w[j] * b[j]
    return total


@inline
def norm_of(x: Any, at: int, n: int) -> float:
    """Return the Frobenius norm of x[at..at+n-1]."""
    total = 0.0
    for j in range(n):
        total += x[at + j] * x[at + j]
    return sqrt(total)


@inline
def tune(joint: int, dt: float, r: float, norm_r: float, p: Any, x: Any, y: Any) -> None:
    """One step (11) of both networks of `joint`; `y` holds the compensator's output and slope."""
    s, wi = tail(x, _HIDDEN + joint * COLUMN), tail(x, _WI + joint * COLUMN)
    b, w = tail(x, _BACK + joint * MOST_NODES), tail(x, _W + joint * MOST_NODES)
    fall = 1.0 + dt * p[T] * (p[K1] * norm_r + p[K2] * norm_r * y[NORM_WI])
    rise = dt * p[T] * r * y[SLOPE + joint]
    for j in range(COLUMN):
        wi[j] = (wi[j] + rise * s[j]) / fall  # (9)
    fall = 1.0 + dt * p[S] * p[K1] * norm_r
    rise = dt * p[S] * y[COMPENSATOR + joint] * r
    for j in range(int(p[NODES])):
        w[j] = (w[j] - rise * b[j]) / fall  # (10)


@stage
def pd_step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period of (1) to (3) alone."""
    norm_r = follow(p, u, y)
    good = guard(norm_r <= p[R_MAX], x, y)
    for i in range(JOINTS):
        y[i] = where(good, clip(y[WANTED + i], -p[U_MAX], p[U_MAX]), 0.0)


@stage
def step(t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
    """One control period; see the module header."""
    norm_r = follow(p, u, y)
    y[NORM_WI] = norm_of(x, _WI, JOINTS * COLUMN)
    y[NORM_W] = norm_of(x, _W, JOINTS * MOST_NODES)
    weights = sqrt(y[NORM_WI] * y[NORM_WI] + y[NORM_W] * y[NORM_W])
    good = guard((norm_r <= p[R_MAX]) & (weights <= p[NORM_MAX]), x, y)  # false for NaN
    engaged = p[ON] > 0.5
    period = where(good & engaged, dt, 0.0)
    for i in range(JOINTS):
        w = y[WANTED + i]
        learned = compensate(i, w, p, x)
        y[COMPENSATOR + i] = where(engaged, learned, 0.0)
        total = w + y[COMPENSATOR + i]
        y[i] = where(good, clip(total, -p[U_MAX], p[U_MAX]), 0.0)  # (6)
        y[SLOPE + i] = slope(i, total, p, x)
    for i in range(JOINTS):
        tune(i, period, y[FILTERED + i], norm_r, p, x, y)


def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
    """Return the parameters as given and the networks as drawn from `network_seed`.

    Raises ValueError for a number of nodes that is not whole.
    """
    n = int(settings["nodes"])
    if n != settings["nodes"]:
        raise ValueError(f"nodes is {settings['nodes']:g}; expected a whole number")
    draw = np.random.default_rng(int(settings["network_seed"]))
    drawn = {name: np.zeros((JOINTS, MOST_NODES)) for name in ("v", "v0", "w", "vi", "v0i")}
    for joint in range(JOINTS):
        for first, bias in (("v", "v0"), ("vi", "v0i")):
            size = draw.uniform(0.0, 1.0, n)
            drawn[first][joint, :n] = size * np.where(draw.random(n) < 0.5, -1.0, 1.0)
            drawn[bias][joint, :n] = draw.uniform(-35.0, 35.0, n)
            if first == "v":
                drawn["w"][joint, :n] = draw.uniform(-50.0, 50.0, n)
    if settings["positive_slope"] > 0.5:
        drawn["w"] = np.abs(drawn["w"]) * np.sign(drawn["v"])
    states = {name: values.ravel().tolist() for name, values in drawn.items()}
    return Prepared({port.name: settings[port.name] for port in (*GAINS, *NETWORK)}, states)


PD = Block(pd_step, inputs=INPUTS, outputs=OUTPUTS, settings=GAINS, states=GUARD)
BLOCK = Block(
    step,
    inputs=INPUTS,
    outputs=(*OUTPUTS, *NETWORK_OUTPUTS),
    settings=(*GAINS, *NETWORK, *START),
    parameters=(*GAINS, *NETWORK),
    states=STATES,
    prepare=prepare,
)
