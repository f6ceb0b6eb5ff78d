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

from dataclasses import replace

import numpy as np

from pcpc.plants.families.two_link.book.theory import (
    LINKS,
    TwoLinks,
    acceleration,
    acting_torque,
    inertia_known,
)
from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.theorem import (
    Cycles,
    NoTheorem,
    Theorem,
    acting,
    around,
    dyads,
    fitted_weights,
    inner,
    layered,
    positive,
    read_out,
    size,
    with_threshold,
)
from pcpc.plants.weights import Layer, Vector

INPUTS, NODES, ROBUST, NETWORK = 5, 20, 3.0, 4.0
P, Q = np.array([[150.0, 10.0], [10.0, 2.0]]), np.diag([500.0, 20.0])
SCALE = float(np.sqrt(P[1, 1]))  # of |st| over the error
WIDTH_RAD_S = 0.05  # of the plant's friction
DRAWN = 4000
SERVO = "local:servo."
ARM = (*LINKS, "gravity_m_s2")


def hidden_nodes(v: Vector, q: Vector, rate: Vector) -> Vector:
    """Return ph (n, 20) at q and q' (n, 2); `v` (5, 20)."""
    return np.tanh(with_threshold(np.concatenate((q, rate), axis=1)) @ v)


def damping(kr: float) -> float:
    """Return K."""
    st = P[:, 1]
    root = np.linalg.inv(np.linalg.cholesky(P))
    return float(np.linalg.eigvalsh(root @ (0.5 * Q + kr * np.outer(st, st)) @ root.T)[0])


def quadratic(vectors: Vector, matrix: Vector) -> Vector:
    """Return the sum of x'Ax over both joints, (n,); `vectors` (n, 2, 2): x of each joint."""
    return np.einsum("nji,ik,njk->n", vectors, matrix, vectors)


def bound(run: Cycles, plain: TwoLinks, v: Vector, f: Vector, w: Layer) -> Constants:
    """Return the constants, of the arm without payload beside f."""
    q, rate = run.columns("plant:arm.q_{}_rad"), run.columns("plant:arm.rate_{}_rad_s")
    draw = np.random.default_rng(0)
    at, moving = around(q, draw, DRAWN), around(rate, draw, DRAWN)
    falls = acceleration(run, plain, at, moving, WIDTH_RAD_S)
    eps = size(falls - hidden_nodes(v, at, moving) @ w.ideal).max()
    payload = size(f - acceleration(run, plain, q, rate, WIDTH_RAD_S)).max()
    kr, kap = run.settings(SERVO, ("kr_per_s", "kap"))
    c0 = SCALE * float(eps + payload)
    return Constants(damping(kr), kap, w.norm, c0, leak="constant")


def prove(run: Cycles) -> Proof:
    """Return the proof of a run; NoTheorem where the robot has no identifier."""
    if run.law("local_law") < ROBUST:
        raise NoTheorem("the robot's node has no identifier with this controller")
    kr, kw, kap = run.settings(SERVO, ("kr_per_s", "kw", "kap"))
    known = TwoLinks(*run.settings(SERVO, ARM))
    plain = TwoLinks(*run.settings("plant:arm.", ARM))
    links = replace(plain, m2=run.after(run.column("plant:arm.mass_kg")))
    q, rate = run.columns("plant:arm.q_{}_rad"), run.columns("plant:arm.rate_{}_rad_s")
    acts, commanded = acting_torque(run), run.columns(f"{SERVO}torque_{{}}_Nm")
    far = q - run.columns(f"{SERVO}model_{{}}_rad")
    far_rate = rate - run.columns(f"{SERVO}model_rate_{{}}_rad_s")
    spread = np.stack((far, far_rate), axis=2)  # x~
    st = spread @ P[:, 1]

    v = np.reshape(run.settings(SERVO, [f"v_{i}" for i in range(INPUTS * NODES)]), (INPUTS, NODES))
    ph, state = hidden_nodes(v, q, rate), run.state(f"{SERVO}w", NODES, 2)
    gain = kr + kw * size(state.w)
    learned, robust = read_out(state.w, ph), gain[:, None] * st
    drive = np.linalg.solve(known.inertia(q), commanded[:, :, None])[:, :, 0] + learned + robust
    f = acceleration(run, links, q, rate, WIDTH_RAD_S, acts) - drive + learned + robust  # (1)
    w = state.layer("Gam", run.rate("gam"), fitted_weights(ph, f), dyads(ph, st), kap)
    rest = f - ph @ w.ideal
    error, missed = np.sqrt(quadratic(spread, P)), float(run.column(f"{SERVO}held_u")[-1])
    return layered(
        run,
        ("Theorem 8.3.1", "sqrt(x~'P x~) of the identifier"),
        (w,),
        v=0.5 * error**2,  # (2)
        damping=0.5 * quadratic(spread, Q) + gain * size(st) ** 2,  # (3)
        terms={
            "st'w, what the network does not cancel": inner(st, rest),
            "leak of the weights": kap * w.leaked,
        },
        error=error,
        rest=SCALE * size(rest),
        constants=bound(run, plain, v, f, w),
        asked=(
            positive("leak kap", kap),
            Assumption(
                "the network is on",
                run.law("local_law") == NETWORK,
                f"local_law {run.law('local_law'):g}",
                needed=True,
            ),
            inertia_known(known.inertia(q), links.inertia(q)),
            Assumption("every u is there in time", missed == 0.0, f"{missed:g} are not"),
            acting(commanded, acts, "N m"),
        ),
    )


THEOREMS = {"telerobot_remote": Theorem(prove, ("servo.w_*",), ("gam",), "servo")}
