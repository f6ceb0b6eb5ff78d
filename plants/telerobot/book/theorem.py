"""Theorem 8.3.1 on runs of the telerobot: the recurrent identifier at the robot, term by term.

    x~ = x - xh,  x~' = As x~ + B (f - W'ph - v),  f = W*'ph + w                             (1)
    V  = x~'P x~/2 + |W~|^2/(2 Gam),  As'P + P As = -Q,  st = B'P x~                         (2)
    V' = -x~'Q x~/2 - (Kr + Kw |W|) |st|^2 + st'w + kap W~'W                                 (3)

of both joints, Q = diag(500, 20). f: what the true arm with its payload and friction does beyond
As and u. Whatever the operator sends, and when, is not in (3), so that the delay is not either: as
the robot then follows the operator is the matter of Theorem 8.5.1, for which the leak is constant.
The error is n = sqrt(x~'P x~): |st| <= sqrt(B'PB) n, and K is the least eigenvalue of Q/2 +
Kr PBB'P against P. c0 from constants: w over states drawn from 1.25 times the ranges of the run
without payload, and the payload's part of the run. rad, rad/s. Source: Lewis, Campos, Selmic (SIAM
2002), chapter 8.
"""

import numpy as np

from pcpc.plants.families.two_link.book.theory import TwoLinks, acceleration
from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.theorem import (
    Cycles,
    NoTheorem,
    Theorem,
    acting,
    fitted_weights,
    inner,
    positive,
    rates_positive,
    read_out,
    size,
    with_threshold,
)
from pcpc.plants.weights import Vector, Weights

INPUTS, NODES, ROBUST, NETWORK = 5, 20, 3.0, 4.0
P, Q = np.array([[150.0, 10.0], [10.0, 2.0]]), np.diag([500.0, 20.0])
WIDTH_RAD_S = 0.05  # of the plant's friction
DRAWN, MARGIN = 4000, 1.25
SERVO = "local:servo."
ARM = ("a1_m", "a2_m", "m1_kg", "m2_kg", "gravity_m_s2")


def hidden_nodes(v: Vector, q: Vector, rate: Vector) -> Vector:
    """Return ph (n, 20) at q and q' (n, 2); `v` (5, 20)."""
    return np.tanh(with_threshold(np.concatenate((q, rate), axis=1)) @ v)


def states_drawn(values: Vector, draw: np.random.Generator) -> Vector:
    """Return values (DRAWN, m) from 1.25 times the ranges of the columns of values (n, m)."""
    middle = 0.5 * (values.max(axis=0) + values.min(axis=0))
    half = 0.5 * MARGIN * (values.max(axis=0) - values.min(axis=0))
    return draw.uniform(middle - half, middle + half, (DRAWN, values.shape[1]))


def damping(kr: float) -> float:
    """Return K."""
    st = P[:, 1]
    root = np.linalg.inv(np.linalg.cholesky(P))
    return float(np.linalg.eigvalsh(root @ (0.5 * Q + kr * np.outer(st, st)) @ root.T)[0])


def prove(run: Cycles) -> Proof:
    """Return the proof of a run; NoTheorem where the robot has no identifier."""
    if run.law("local_law") < ROBUST:
        raise NoTheorem("the robot's node has no identifier with this controller")
    kr, kw, kap = run.settings(SERVO, ("kr_per_s", "kw", "kap"))
    known = TwoLinks(*run.settings(SERVO, ARM))
    plain = TwoLinks(*run.settings("plant:arm.", ARM))
    loaded = run.after(run.column("plant:arm.mass_kg"))
    links = TwoLinks(plain.a1, plain.a2, plain.m1, loaded, plain.g)
    q, rate = run.columns("plant:arm.q_{}_rad"), run.columns("plant:arm.rate_{}_rad_s")
    acts = run.after(run.columns("plant:arm.acting_{}_Nm"))
    asked = run.columns(f"{SERVO}torque_{{}}_Nm")
    far = q - run.columns(f"{SERVO}model_{{}}_rad")
    far_rate = rate - run.columns(f"{SERVO}model_rate_{{}}_rad_s")

    v = run.settings(SERVO, [f"v_{i}" for i in range(INPUTS * NODES)])
    first = np.array(v).reshape(INPUTS, NODES)
    w = run.used(f"{SERVO}w", NODES, 2)
    ph, st = hidden_nodes(first, q, rate), np.stack((far, far_rate), axis=2) @ P[:, 1]
    norm = size(w)
    robust = (kr + kw * norm)[:, None] * st
    learned = read_out(w, ph)
    drive = np.linalg.solve(known.inertia(q), asked[:, :, None])[:, :, 0] + learned + robust
    f = acceleration(run, links, q, rate, WIDTH_RAD_S, acts) - drive + learned + robust
    ideal = fitted_weights(ph, f)
    lacks, rest = ideal - w, f - ph @ ideal
    drive = ph[:, :, None] * st[:, None, :] - kap * w
    moved = run.moved(f"{SERVO}w", NODES, 2)
    weights = Weights("Gam", run.rate("gam"), lacks, moved, drive)

    spread = np.stack((far, far_rate), axis=2)
    error = np.sqrt(np.einsum("nji,ik,njk->n", spread, P, spread))
    draw = np.random.default_rng(0)
    at, moving = states_drawn(q, draw), states_drawn(rate, draw)
    falls = acceleration(run, plain, at, moving, WIDTH_RAD_S)
    eps = size(falls - hidden_nodes(first, at, moving) @ ideal).max()
    payload = size(f - acceleration(run, plain, q, rate, WIDTH_RAD_S)).max()
    scale = float(np.sqrt(P[1, 1]))
    wrong = float(np.abs(known.inertia(q) - links.inertia(q)).max())
    missed = float(run.column(f"{SERVO}held_u")[-1])
    return Proof(
        theorem="Theorem 8.3.1",
        error_is="sqrt(x~'P x~) of the identifier",
        t_s=run.t_s,
        v=0.5 * error**2 + weights.energy,
        tuned=(weights,),
        damping=0.5 * np.einsum("nji,ik,njk->n", spread, Q, spread)
        + (kr + kw * norm) * size(st) ** 2,
        terms={
            "st'w, what the network does not cancel": inner(st, rest),
            "leak of the weights": kap * inner(lacks, w),
        },
        error=error,
        weights=size(lacks),
        rest=scale * size(rest),
        constants=Constants(
            damping=damping(kr),
            kappa=kap,
            ideal=float(np.linalg.norm(ideal)),
            c0=scale * float(eps + payload),
            gamma=weights.metric,
            leak="constant",
        ),
        asked=(
            rates_positive([weights]),
            positive("leak kap", kap),
            Assumption(
                "the network is on",
                run.law("local_law") == NETWORK,
                f"local_law {run.law('local_law'):g}",
                needed=True,
            ),
            Assumption("Mhat is M", wrong < 1e-9, f"they differ by up to {wrong:.3g} kg m2"),
            Assumption("every u is there in time", missed == 0.0, f"{missed:g} are not"),
            acting(asked, acts, "N m"),
        ),
    )


THEOREMS = {"telerobot_remote": Theorem(prove, ("servo.w_*",), ("gam",), "servo")}
