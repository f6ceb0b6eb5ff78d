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

from pcpc.plants.families.two_link.theory import TwoLinks, motion, times
from pcpc.plants.lyapunov import Asked, Constants, Proof, Vector
from pcpc.plants.theorem import (
    Theorem,
    Told,
    acting,
    fitted,
    inner,
    logistic,
    rates_positive,
    size,
)
from pcpc.plants.weights import Weights

JOINTS, ROOM, JUMPS = 2, 40, 2
MARGIN = 1.25  # of the range that eps is looked for in, over that of the run
POINTS = 4001
GAP = ("d_plus_Nm", "d_minus_Nm", "m_plus", "m_minus")


def behind(told: Told, u: Vector) -> Vector:
    """Return D(u), N m."""
    above, below, rise, fall = (told.setting(f"plant:arm.{name}") for name in GAP)
    return rise * np.maximum(u - above, 0.0) + fall * np.minimum(u + below, 0.0)


def before(told: Told, tau: Vector) -> Vector:
    """Return D^-1(tau), N m; 0 of 0."""
    above, below, rise, fall = (told.setting(f"plant:arm.{name}") for name in GAP)
    ahead = np.where(tau < 0.0, tau / fall - below, 0.0)
    return np.where(tau > 0.0, tau / rise + above, ahead)


def compensator(told: Told, vi: Vector, v0i: Vector, w_d: Vector) -> Vector:
    """Return s (n, L + 2) of one joint at w_d (n,)."""
    right = np.where(w_d >= 0.0, told.law("jumps_on"), 0.0)
    nodes = logistic(w_d[:, None] * vi + v0i)
    return np.column_stack((nodes, right, right * (1.0 - np.exp(-np.abs(w_d)))))


def reach(values: Vector) -> Vector:
    """Return points over the range that eps is looked for in."""
    most = MARGIN * float(np.abs(values).max())
    return np.linspace(-most, most, POINTS)


def eps_of(told: Told, u: Vector, w_d: Vector, nets: tuple[Vector, ...]) -> float:
    """Return the largest eps of (2) of one joint; `nets`: V, v0, W*, Vi, v0i, Wi*."""
    v, v0, w, vi, v0i, wi = nets
    over_u, over_w = reach(u), reach(w_d)
    seen = np.abs(behind(told, over_u) - logistic(over_u[:, None] * v + v0) @ w)
    undone = np.abs(behind(told, over_w + compensator(told, vi, v0i, over_w) @ wi) - over_w)
    return float(seen.max() + undone.max())


def prove(told: Told) -> Proof:
    """Return the proof of a run."""
    nodes = int(told.law("nodes"))
    kv, lam = told.law("kv_Nms_rad"), told.law("lam_per_s")
    k1, k2 = told.law("k1"), told.law("k2")
    names = ("a1_m", "a2_m", "m1_kg", "m2_kg")
    links = TwoLinks(*(told.setting(f"plant:arm.{name}") for name in names))
    one = motion(told, np.array([lam, lam]))
    r, m = one.r, links.inertia(one.q)
    ahead, along = one.forward
    w_d = times(m, ahead) + times(links.coriolis(one.q, one.v), along) + kv * r
    tau = told.after(told.columns("plant:arm.acting_{}_Nm"))
    y = told.columns("executive:controller.y_{}_Nm")
    seen_slope = told.columns("executive:controller.slope_{}")
    u = told.columns("executive:controller.tau_d_{}_Nm") + y
    state = "executive:controller."
    w = told.used(f"{state}w", JOINTS, ROOM)[:, :, :nodes]
    keep = np.r_[:nodes, ROOM : ROOM + JUMPS]
    wi = told.used(f"{state}wi", JOINTS, ROOM + JUMPS)[:, :, keep]
    b = told.array(f"{state}b", JOINTS, ROOM)[:, :, :nodes]
    first = [told.used(f"{state}{name}", JOINTS, ROOM)[0, :, :nodes] for name in
             ("v", "v0", "vi", "v0i")]  # fmt: skip

    s = np.stack([compensator(told, first[2][j], first[3][j], w_d[:, j]) for j in range(JOINTS)], 1)
    w_ideal, wi_ideal = np.empty((JOINTS, nodes)), np.empty((JOINTS, nodes + JUMPS))
    eps, spread, most = np.zeros(JOINTS), 0.0, 0.0
    for j in range(JOINTS):
        v, v0, vi, v0i = (values[j] for values in first)
        w_ideal[j] = fitted(logistic(u[:, j, None] * v + v0), behind(told, u[:, j])[:, None])[:, 0]
        missing = before(told, w_d[:, j]) - w_d[:, j]
        wi_ideal[j] = fitted(s[:, j], missing[:, None])[:, 0]
        nets = (v, v0, w_ideal[j], vi, v0i, wi_ideal[j])
        eps[j] = eps_of(told, u[:, j], w_d[:, j], nets)
        spread = max(spread, float(np.linalg.norm(v)))
        edge = reach(w_d[:, j])
        most = max(most, float(np.abs(before(told, edge) - edge).max()))
    w_lacks, wi_lacks = w_ideal - w, wi_ideal - wi
    rest = w_d - tau + np.sum(w_lacks * b, axis=2) * y - np.sum(wi_lacks * s, axis=2) * seen_slope

    error, norm = size(r), size(wi)
    done_w = told.array(f"{state}w", JOINTS, ROOM)[:, :, :nodes]
    done_wi = told.array(f"{state}wi", JOINTS, ROOM + JUMPS)[:, :, keep]
    leak, leak_wi = k1 * error[:, None, None], (error * (k1 + k2 * norm))[:, None, None]
    drive = -b * (y * r)[:, :, None] - leak * w
    drive_wi = s * (r * seen_slope)[:, :, None] - leak_wi * wi
    weights = (
        Weights("T", told.rate("t_rate"), wi_lacks, done_wi - wi, drive_wi),
        Weights("S", told.rate("s_rate"), w_lacks, done_w - w, drive),
    )
    further = norm * inner(wi_lacks, wi)
    outer, wide = float(np.linalg.norm(w_ideal)), float(np.linalg.norm(wi_ideal))
    low, high = links.inertia_range()
    clipped = np.clip(u, -told.law("u_max_Nm"), told.law("u_max_Nm"))
    return Proof(
        theorem="theorem of chapter 4.2",
        error_is="|r| [rad/s]",
        t_s=told.t_s,
        v=0.5 * np.einsum("ni,nij,nj->n", r, m, r) + sum(one.stored for one in weights),
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
            Asked("leak k1 above 0", k1 > 0.0, f"k1 {k1:g}", needed=True),
            Asked(
                "W, Wi, y, u are in use",
                told.law("network_on") > 0.5,
                f"network_on {told.law('network_on'):g}",
                needed=True,
            ),
            acting(behind(told, u), tau, "N m"),
            Asked(
                "u is not limited",
                bool((clipped == u).all()),
                f"limited in {100.0 * float(np.mean((clipped != u).any(axis=1))):.3g} % "
                "of the cycles",
            ),
        ),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w", "wi", "v", "v0", "vi", "v0i", "b"))
THEOREMS = {"deadzone_nn": Theorem(prove, STATES, ("t_rate", "s_rate"))}
