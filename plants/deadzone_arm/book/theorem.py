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
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcpc.plants.families.two_link.book.theory import (
    LINKS,
    TwoLinks,
    acting_torque,
    forward_torque,
    motion,
)
from pcpc.plants.lyapunov import Constants, Proof
from pcpc.plants.theorem import (
    MARGIN,
    Cycles,
    Theorem,
    acting,
    fitted_weights,
    inner,
    layered,
    logistic,
    never,
    positive,
    size,
    switched_on,
)
from pcpc.plants.weights import Layer, Vector

JOINTS, ROOM, JUMPS = 2, 40, 2
POINTS = 4001
STATE = "executive:controller."
DRAWN = ("v", "v0", "vi", "v0i")
GAP = ("d_plus_Nm", "d_minus_Nm", "m_plus", "m_minus")


def deadzone(run: Cycles, u: Vector) -> Vector:
    """Return D(u), N m. The shape is that of u."""
    above, below, rise, fall = run.settings("plant:arm.", GAP)
    return rise * np.maximum(u - above, 0.0) + fall * np.minimum(u + below, 0.0)


def added(run: Cycles, tau: Vector) -> Vector:
    """Return D^-1(tau) - tau, N m; 0 of 0. The shape is that of tau."""
    above, below, rise, fall = run.settings("plant:arm.", GAP)
    ahead = np.where(tau < 0.0, tau / fall - below, 0.0)
    return np.where(tau > 0.0, tau / rise + above, ahead) - tau


def points(values: Vector) -> Vector:
    """Return points (POINTS,) over the range of values (n,) that eps is looked for in."""
    most = MARGIN * float(np.abs(values).max())
    return np.linspace(-most, most, POINTS)


@dataclass(frozen=True)
class Joint:
    """u and w_d of a joint (n,), and its networks as drawn, (L,) each."""

    run: Cycles
    u: Vector
    w_d: Vector
    v: Vector
    v0: Vector
    vi: Vector
    v0i: Vector

    def observer(self, u: Vector) -> Vector:
        """Return sgm (n, L) at u (n,)."""
        return logistic(u[:, None] * self.v + self.v0)

    def compensator(self, w_d: Vector) -> Vector:
        """Return s (n, L + 2) at w_d (n,)."""
        right = np.where(w_d >= 0.0, self.run.law("jumps_on"), 0.0)
        nodes = logistic(w_d[:, None] * self.vi + self.v0i)
        return np.column_stack((nodes, right, right * (1.0 - np.exp(-np.abs(w_d)))))

    @property
    def ideal(self) -> tuple[Vector, Vector]:
        """W* (L,) and Wi* (L + 2,) of (2)."""
        return (
            fitted_weights(self.observer(self.u), deadzone(self.run, self.u)),
            fitted_weights(self.compensator(self.w_d), added(self.run, self.w_d)),
        )

    def largest_eps(self, w: Vector, wi: Vector) -> float:
        """Return the largest eps of (2)."""
        u, w_d = points(self.u), points(self.w_d)
        seen = np.abs(deadzone(self.run, u) - self.observer(u) @ w)
        undone = np.abs(deadzone(self.run, w_d + self.compensator(w_d) @ wi) - w_d)
        return float(seen.max() + undone.max())


def layers(run: Cycles, joints: Sequence[Joint], r: Vector) -> tuple[Layer, Layer, Vector, Vector]:
    """Return Wi, W as (6) tunes them, and both products of (3) that this cancels, (n, 2)."""
    nodes, (k1, k2) = len(joints[0].v), run.laws("k1", "k2")
    y, jacobian = run.columns(f"{STATE}y_{{}}_Nm"), run.columns(f"{STATE}slope_{{}}")
    kept = np.r_[:nodes, ROOM : ROOM + JUMPS]
    wi = run.state(f"{STATE}wi", JOINTS, ROOM + JUMPS)[:, :, kept]
    w = run.state(f"{STATE}w", JOINTS, ROOM)[:, :, :nodes]
    b = run.array(f"{STATE}b", JOINTS, ROOM)[:, :, :nodes]
    s = np.stack([one.compensator(one.w_d) for one in joints], 1)
    ideal, ideal_i = (np.array(found) for found in zip(*(one.ideal for one in joints), strict=True))
    leak, drive = k1 * size(r), -b * (y * r)[:, :, None]
    observer = w.layer("S", run.rate("s_rate"), ideal, drive, leak)
    leak, drive = size(r) * (k1 + k2 * size(wi.w)), s * (r * jacobian)[:, :, None]
    compensator = wi.layer("T", run.rate("t_rate"), ideal_i, drive, leak)
    seen = np.sum(observer.lacks * b, axis=2) * y
    return compensator, observer, seen, np.sum(compensator.lacks * s, axis=2) * jacobian


def bound(run: Cycles, links: TwoLinks, joints: Sequence[Joint], wi: Layer, w: Layer) -> Constants:
    """Return the constants."""
    eps = [one.largest_eps(*pair) for one, *pair in zip(joints, w.ideal, wi.ideal, strict=True)]
    most = max(float(np.abs(added(run, points(one.w_d))).max()) for one in joints)
    spread = max(float(np.linalg.norm(one.v)) for one in joints)
    nodes, (low, high) = len(joints[0].v), links.inertia_range()
    return Constants(
        damping=run.law("kv_Nms_rad"),
        kappa=run.law("k1"),
        ideal=math.hypot(w.norm, wi.norm),
        c0=float(np.linalg.norm(eps))
        + w.norm * math.sqrt(nodes)
        + 0.5 * run.law("k2") * wi.norm**3,
        c1=spread * (most + w.norm * math.sqrt(nodes + JUMPS)) / 4.0,
        low=low,
        high=high,
    )


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    nodes = int(run.law("nodes"))
    kv, lam, k1, k2 = run.laws("kv_Nms_rad", "lam_per_s", "k1", "k2")
    links = TwoLinks(*run.settings("plant:arm.", LINKS))
    one = motion(run, np.array([lam, lam]))
    r, m, error = one.r, links.inertia(one.q), size(one.r)
    w_d = forward_torque(links, one) + kv * r  # (1)
    u = run.columns(f"{STATE}tau_d_{{}}_Nm") + run.columns(f"{STATE}y_{{}}_Nm")
    drawn = np.array([run.used(STATE + name, JOINTS, ROOM)[0, :, :nodes] for name in DRAWN])
    joints = [Joint(run, u[:, j], w_d[:, j], *drawn[:, j]) for j in range(JOINTS)]
    wi, w, seen, undone = layers(run, joints, r)
    tau, further = acting_torque(run), size(wi.w) * wi.leaked
    rest = w_d - tau + seen - undone  # (3)
    clipped = np.clip(u, -run.law("u_max_Nm"), run.law("u_max_Nm"))
    return layered(
        run,
        ("theorem of chapter 4.2", "|r| [rad/s]"),
        (wi, w),
        v=0.5 * np.einsum("ni,nij,nj->n", r, m, r),  # (4)
        damping=kv * error**2,  # (5)
        terms={
            "r'w, what no network cancels": inner(r, rest),
            "leak of the weights": error * (k1 * (w.leaked + wi.leaked) + k2 * further),
        },
        error=error,
        rest=size(rest) + k2 * np.maximum(further, 0.0),
        constants=bound(run, links, joints, wi, w),
        asked=(
            positive("leak k1", k1),
            switched_on(run, "W, Wi, y, u are in use", "network_on"),
            acting(deadzone(run, u), tau, "N m"),
            never("u is not limited", (clipped != u).any(axis=1), "limited in {}"),
        ),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w", "wi", *DRAWN, "b"))
THEOREMS = {"deadzone_nn": Theorem(prove, STATES, ("t_rate", "s_rate"))}
