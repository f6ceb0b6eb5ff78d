"""Theorem 7.3.1 on runs of the arm with the adaptive critic: its proof term by term.

    r' = -Kv r + f - W2's2 + v,  f = W2*'s2 + w                                              (1)
    V  = (|r|^2 + |R|^2 + |W1|^2 + |W2~|^2/Gam)/2                                            (2)
    V' = -D + sc'w + kap2 W2~'W2                                                             (3)
    D  = Kv |r|^2 - beta R'r + |s1|^2 |R|^2 + R'W1's1 + kap1 |W1|^2 + kz |sc|^2/(|sc| + delta)
    sc'w - kz |sc|^2/(|sc| + delta) <= (|r| + |sc - r|) w_k + kz delta,  w_k = |w| - kz     (4)

for alpha = kap1, w_k not below 0. (3) is (11) of adaptive_critic.py with W1* = 0: nothing tells
what the critic ought to have learned, and (3) holds for any W1*. f is what the true arm with its
payload asks for beside what Mhat turns into torque: a function of the state where M = Mhat. Of D,
K |r|^2 is left when R and W1 keep a half of what damps them:

    K = Kv - (B - mu I)^-1_11 beta^2/4,  B = [|s1|^2, |s1|/2; |s1|/2, kap1],  mu = lambda_min(B)/2

|s1| and sc - r are those of the run. c0 from constants takes w without payload over states drawn
from references of the run and |r| up to 1.25 times the largest, and the payload's part of the run.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 7.
"""

from dataclasses import replace

import numpy as np

from pcpc.plants.families.two_link.book.theory import (
    Motion,
    TwoLinks,
    acceleration,
    drawn_states,
    motion,
)
from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.theorem import (
    Cycles,
    Theorem,
    acting,
    fitted_weights,
    inner,
    logistic,
    positive,
    rates_positive,
    read_out,
    size,
    switched_on,
    with_threshold,
)
from pcpc.plants.weights import Vector, Weights

INPUTS, NODES = 11, 10
STATE = "executive:controller."
WIDTH = "plant:arm.smooth_rad_s"


def network_input(one: Motion) -> Vector:
    """Return x (n, 11) of the action network."""
    return with_threshold(
        np.concatenate((one.e, one.e_rate, one.q_d, one.rate_d, one.acc_d), axis=1)
    )


def unknown_part(run: Cycles, links: TwoLinks, one: Motion) -> Vector:
    """Return q_d'' + Lam e' + M^-1 (Vm q' + G + Fr) (n, 2), rad/s2: f for Mhat = M."""
    slowed = acceleration(run, links, one.q, one.v, run.setting(WIDTH))
    return one.forward[0] - slowed


def damping(run: Cycles, s1: Vector) -> tuple[float, float]:
    """Return K and mu for the |s1| of the run, (n,)."""
    kv, beta, kap1 = run.laws("kv_per_s", "beta", "kap1")
    most, left = np.inf, np.inf
    for s in np.linspace(s1.min(), s1.max(), 21):
        both = np.array([[s * s, 0.5 * s], [0.5 * s, kap1]])
        half = 0.5 * float(np.linalg.eigvalsh(both)[0])
        if half <= 0.0:
            return 0.0, 0.0
        most = min(most, half)
        free = np.linalg.inv(both - half * np.eye(2))[0, 0]
        left = min(left, kv - 0.25 * beta**2 * free)
    return left, most


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    kv, lam, kz, delta, beta, kap1, kap2 = run.laws(
        "kv_per_s", "lam_per_s", "kz", "delta_rad_s", "beta", "kap1", "kap2"
    )
    names = ("a1_m", "a2_m", "m1_kg", "m2_kg")
    known = TwoLinks(*run.laws(*names))
    plain = TwoLinks(*run.settings("plant:arm.", (*names, "gravity_m_s2")))
    links = replace(plain, m2=run.after(run.column("plant:arm.outer_mass_kg")))
    one = motion(run, np.array([lam, lam]))
    r, acts = one.r, run.after(run.columns("plant:arm.acting_{}_Nm"))
    moved = acceleration(run, links, one.q, one.v, run.setting(WIDTH), acts)
    r_rate = one.forward[0] - moved

    w1 = run.used(f"{STATE}w1", NODES, 2)
    w2 = run.used(f"{STATE}w2", NODES, 2)
    v2 = run.used(f"{STATE}v2", INPUTS, NODES)[0]
    s1, s2 = run.array(f"{STATE}s1", NODES), logistic(network_input(one) @ v2)
    sc, critic = run.array(f"{STATE}sc", 2), run.columns("executive:controller.critic_{}")
    robust = run.columns("executive:controller.robust_{}_rad_s2")
    learned = run.columns("executive:controller.learned_{}_rad_s2")
    f = r_rate + kv * r + learned + robust
    ideal = fitted_weights(s2, f)
    lacks, rest = ideal - w2, f - s2 @ ideal

    drive = s2[:, :, None] * sc[:, None, :] - kap2 * w2
    moved_w2 = run.moved(f"{STATE}w2", NODES, 2)
    weights = Weights("Gam", run.rate("gam"), lacks, moved_w2, drive)

    error, back, judged = size(r), size(s1), size(sc)
    unhelped = np.maximum(size(rest) - kz, 0.0)
    sway = size(sc - r)
    k, mu = damping(run, back)
    at = drawn_states(one)
    eps = size(unknown_part(run, plain, at) - logistic(network_input(at) @ v2) @ ideal).max()
    payload = size(f - unknown_part(run, plain, one)).max()
    c0 = max(float(eps + payload) - kz, 0.0)
    asked = run.columns("executive:controller.torque_{}_Nm")
    wrong = float(np.abs(known.inertia(one.q) - links.inertia(one.q)).max())
    return Proof(
        theorem="Theorem 7.3.1",
        error_is="|r| [rad/s]",
        t_s=run.t_s,
        v=0.5 * (error**2 + size(critic) ** 2 + size(w1) ** 2) + weights.energy,
        tuned=(weights,),
        damping=kv * error**2
        - beta * inner(critic, r)
        + back**2 * size(critic) ** 2
        + inner(critic, read_out(w1, s1))
        + kap1 * size(w1) ** 2
        + kz * judged**2 / (judged + delta),
        terms={
            "sc'w, what no network cancels": inner(sc, rest),
            "leak of the weights": kap2 * inner(lacks, w2),
        },
        error=error,
        weights=size(lacks),
        rest=unhelped,
        extra=kz * delta + sway * unhelped,
        constants=Constants(
            damping=k,
            kappa=kap2,
            ideal=float(np.linalg.norm(ideal)),
            c0=c0,
            gamma=weights.metric,
            leak="constant",
            extra=kz * delta + float(sway.max()) * c0,
            other_rate=mu,
        ),
        asked=(
            rates_positive([weights]),
            positive("leak kap2", kap2),
            switched_on(run, "both networks are on", "action_on", "critic_on"),
            Assumption(
                "beta^2 < 4 Kv |s1|^2 (1 - 1/(4 kap1)), alpha = kap1",
                k > 0.0 and run.law("alpha") == kap1,
                f"beta {beta:g}, K {k:.3g} of Kv {kv:g}, kap1 {kap1:g}, alpha {run.law('alpha'):g}",
                needed=True,
            ),
            Assumption(
                "kz is above |w|",
                bool((unhelped == 0.0).all()),
                f"kz {kz:g}, |w| up to {size(rest).max():.3g}",
            ),
            Assumption("Mhat is M", wrong < 1e-9, f"they differ by up to {wrong:.3g} kg m2"),
            acting(asked, acts, "N m"),
        ),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w1", "w2", "v2", "s1", "sc"))
THEOREMS = {"adaptive_critic": Theorem(prove, STATES, ("gam",))}
