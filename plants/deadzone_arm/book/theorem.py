"""The theorem of chapter 4.2 on runs of the arm behind deadzones: its proof term by term.

    M r' = -Vm r - Kv r + w_d - D(w_d + y),  w_d = f + Kv r                                  (1)
    Wi*'s(w_d) = D^-1(w_d) - w_d + eps,  W*'sgm(V u + v0) = D(u) + eps                       (2)
    w    = w_d - tau + W~'b y - Wi~'s J,  tau: what acts behind the deadzone                 (3)
         = W~'b y* + W*'O^2 + eps,  y* = D^-1(w_d) - w_d
    V    = r'M r/2 + |W~|^2/(2 S) + |Wi~|^2/(2 T)                                            (4)
    V'   = -r'Kv r + r'w + k1 |r| (W~'W + Wi~'Wi) + k2 |r| |Wi| Wi~'Wi                       (5)
    W'   = -S (b y r + k1 |r| W),  Wi' = T (s r J - (k1 + k2 |Wi|) |r| Wi)                   (6)

Joint by joint in (2), (3): W, Wi, b, s as in the law. The two products in (3) are what the tuning
laws (6) cancel. Where it is positive the term with k2 is below k2 |r| |Wi*|^3/2 and counts to w.
(2) by least squares over the run for both joints; eps over u, w_d up to 1.25 times those of the
run. |O^2| <= sqrt(L) + |V| |s| |Wi~|/4 and |b| <= |V|/4 bound (3) from constants.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 4.2.
"""

import math

import numpy as np

from pcpc.plants.families.two_link.book.theory import TwoLinks, motion, times
from pcpc.plants.lyapunov import Constants, Proof
from pcpc.plants.theorem import (
    Cycles,
    Theorem,
    acting,
    fitted_weights,
    inner,
    logistic,
    never,
    positive,
    rates_positive,
    size,
    switched_on,
)
from pcpc.plants.weights import Vector, Weights

JOINTS, ROOM, JUMPS = 2, 40, 2
MARGIN = 1.25  # of the range that eps is looked for in, over that of the run
POINTS = 4001
GAP = ("d_plus_Nm", "d_minus_Nm", "m_plus", "m_minus")


def deadzone(run: Cycles, u: Vector) -> Vector:
    """Return D(u), N m. The shape is that of u."""
    above, below, rise, fall = run.settings("plant:arm.", GAP)
    return rise * np.maximum(u - above, 0.0) + fall * np.minimum(u + below, 0.0)


def inverse(run: Cycles, tau: Vector) -> Vector:
    """Return D^-1(tau), N m; 0 of 0. The shape is that of tau."""
    above, below, rise, fall = run.settings("plant:arm.", GAP)
    ahead = np.where(tau < 0.0, tau / fall - below, 0.0)
    return np.where(tau > 0.0, tau / rise + above, ahead)


def compensator(run: Cycles, vi: Vector, v0i: Vector, w_d: Vector) -> Vector:
    """Return s (n, L + 2) of one joint at w_d (n,); `vi`, `v0i` (L,)."""
    right = np.where(w_d >= 0.0, run.law("jumps_on"), 0.0)
    nodes = logistic(w_d[:, None] * vi + v0i)
    return np.column_stack((nodes, right, right * (1.0 - np.exp(-np.abs(w_d)))))


def points(values: Vector) -> Vector:
    """Return points (POINTS,) over the range of values (n,) that eps is looked for in."""
    most = MARGIN * float(np.abs(values).max())
    return np.linspace(-most, most, POINTS)


def largest_eps(run: Cycles, u: Vector, w_d: Vector, nets: tuple[Vector, ...]) -> float:
    """Return the largest eps of (2) of one joint; `nets`: V, v0, W*, Vi, v0i, Wi*.

    `u`, `w_d` (n,); `nets` (L,) each, the last (L + 2,).
    """
    v, v0, w, vi, v0i, wi = nets
    over_u, over_w = points(u), points(w_d)
    seen = np.abs(deadzone(run, over_u) - logistic(over_u[:, None] * v + v0) @ w)
    undone = np.abs(deadzone(run, over_w + compensator(run, vi, v0i, over_w) @ wi) - over_w)
    return float(seen.max() + undone.max())


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    nodes = int(run.law("nodes"))
    kv, lam, k1, k2 = run.laws("kv_Nms_rad", "lam_per_s", "k1", "k2")
    links = TwoLinks(*run.settings("plant:arm.", ("a1_m", "a2_m", "m1_kg", "m2_kg")))
    one = motion(run, np.array([lam, lam]))
    r, m = one.r, links.inertia(one.q)
    ahead, along = one.forward
    w_d = times(m, ahead) + times(links.coriolis(one.q, one.v), along) + kv * r
    tau = run.after(run.columns("plant:arm.acting_{}_Nm"))
    y = run.columns("executive:controller.y_{}_Nm")
    seen_slope = run.columns("executive:controller.slope_{}")
    u = run.columns("executive:controller.tau_d_{}_Nm") + y
    state = "executive:controller."
    w = run.used(f"{state}w", JOINTS, ROOM)[:, :, :nodes]
    keep = np.r_[:nodes, ROOM : ROOM + JUMPS]
    wi = run.used(f"{state}wi", JOINTS, ROOM + JUMPS)[:, :, keep]
    b = run.array(f"{state}b", JOINTS, ROOM)[:, :, :nodes]
    first = [
        run.used(f"{state}{name}", JOINTS, ROOM)[0, :, :nodes] for name in ("v", "v0", "vi", "v0i")
    ]

    s = np.stack([compensator(run, first[2][j], first[3][j], w_d[:, j]) for j in range(JOINTS)], 1)
    w_ideal, wi_ideal = np.empty((JOINTS, nodes)), np.empty((JOINTS, nodes + JUMPS))
    eps, spread, most = np.zeros(JOINTS), 0.0, 0.0
    for j in range(JOINTS):
        v, v0, vi, v0i = (values[j] for values in first)
        w_ideal[j] = fitted_weights(
            logistic(u[:, j, None] * v + v0), deadzone(run, u[:, j])[:, None]
        )[:, 0]
        missing = inverse(run, w_d[:, j]) - w_d[:, j]
        wi_ideal[j] = fitted_weights(s[:, j], missing[:, None])[:, 0]
        nets = (v, v0, w_ideal[j], vi, v0i, wi_ideal[j])
        eps[j] = largest_eps(run, u[:, j], w_d[:, j], nets)
        spread = max(spread, float(np.linalg.norm(v)))
        edge = points(w_d[:, j])
        most = max(most, float(np.abs(inverse(run, edge) - edge).max()))
    w_lacks, wi_lacks = w_ideal - w, wi_ideal - wi
    rest = w_d - tau + np.sum(w_lacks * b, axis=2) * y - np.sum(wi_lacks * s, axis=2) * seen_slope

    error, norm = size(r), size(wi)
    moved = run.moved(f"{state}w", JOINTS, ROOM)[:, :, :nodes]
    moved_wi = run.moved(f"{state}wi", JOINTS, ROOM + JUMPS)[:, :, keep]
    leak, leak_wi = k1 * error[:, None, None], (error * (k1 + k2 * norm))[:, None, None]
    drive = -b * (y * r)[:, :, None] - leak * w
    drive_wi = s * (r * seen_slope)[:, :, None] - leak_wi * wi
    weights = (
        Weights("T", run.rate("t_rate"), wi_lacks, moved_wi, drive_wi),
        Weights("S", run.rate("s_rate"), w_lacks, moved, drive),
    )
    further = norm * inner(wi_lacks, wi)
    outer, wide = float(np.linalg.norm(w_ideal)), float(np.linalg.norm(wi_ideal))
    low, high = links.inertia_range()
    clipped = np.clip(u, -run.law("u_max_Nm"), run.law("u_max_Nm"))
    return Proof(
        theorem="theorem of chapter 4.2",
        error_is="|r| [rad/s]",
        t_s=run.t_s,
        v=0.5 * np.einsum("ni,nij,nj->n", r, m, r) + sum(one.energy for one in weights),
        tuned=weights,
        damping=kv * error**2,
        terms={
            "r'w, what no network cancels": inner(r, rest),
            "leak of the weights": error
            * (k1 * (inner(w_lacks, w) + inner(wi_lacks, wi)) + k2 * further),
        },
        error=error,
        weights=np.sqrt(size(w_lacks) ** 2 + size(wi_lacks) ** 2),
        rest=size(rest) + k2 * np.maximum(further, 0.0),
        constants=Constants(
            damping=kv,
            kappa=k1,
            ideal=math.hypot(outer, wide),
            c0=float(np.linalg.norm(eps)) + outer * math.sqrt(nodes) + 0.5 * k2 * wide**3,
            c1=spread * (most + outer * math.sqrt(nodes + JUMPS)) / 4.0,
            low=low,
            high=high,
            gamma=min(one.metric for one in weights),
        ),
        asked=(
            rates_positive(weights),
            positive("leak k1", k1),
            switched_on(run, "W, Wi, y, u are in use", "network_on"),
            acting(deadzone(run, u), tau, "N m"),
            never("u is not limited", (clipped != u).any(axis=1), "limited in {}"),
        ),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w", "wi", "v", "v0", "vi", "v0i", "b"))
THEOREMS = {"deadzone_nn": Theorem(prove, STATES, ("t_rate", "s_rate"))}
