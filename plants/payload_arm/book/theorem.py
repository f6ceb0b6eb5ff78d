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
    LINKS,
    Motion,
    TwoLinks,
    acceleration,
    acting_torque,
    drawn_states,
    inertia_known,
    motion,
)
from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.theorem import (
    Cycles,
    Theorem,
    acting,
    dyads,
    fitted_weights,
    inner,
    layered,
    logistic,
    positive,
    read_out,
    size,
    switched_on,
)
from pcpc.plants.weights import Layer, Vector

INPUTS, NODES = 11, 10
STATE = "executive:controller."
WIDTH = "plant:arm.smooth_rad_s"


def action_nodes(run: Cycles, one: Motion) -> Vector:
    """Return s2 (n, 10) of the action network."""
    return logistic(one.inputs @ run.used(f"{STATE}v2", INPUTS, NODES)[0])


def unknown_part(run: Cycles, links: TwoLinks, states: Motion) -> Vector:
    """Return q_d'' + Lam e' + M^-1 (Vm q' + G + Fr) (n, 2), rad/s2: f for Mhat = M."""
    slowed = acceleration(run, links, states.q, states.v, run.setting(WIDTH))
    return states.forward[0] - slowed


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


def critic(run: Cycles, r: Vector, sc: Vector) -> tuple[Vector, Vector]:
    """Return V (2) without W2, and D of (3)."""
    kv, beta, kap1, kz, delta = run.laws("kv_per_s", "beta", "kap1", "kz", "delta_rad_s")
    w1, s1 = run.used(f"{STATE}w1", NODES, 2), run.array(f"{STATE}s1", NODES)
    critic_signal, error, judged = run.columns(f"{STATE}critic_{{}}"), size(r), size(sc)
    dissipated = (
        kv * error**2
        - beta * inner(critic_signal, r)
        + size(s1) ** 2 * size(critic_signal) ** 2
        + inner(critic_signal, read_out(w1, s1))
        + kap1 * size(w1) ** 2
        + kz * judged**2 / (judged + delta)
    )
    return 0.5 * (error**2 + size(critic_signal) ** 2 + size(w1) ** 2), dissipated


def bound(
    run: Cycles, plain: TwoLinks, states: Motion, f: Vector, w2: Layer, sway: float
) -> Constants:
    """Return the constants, of the arm without payload beside f; `sway`: the largest |sc - r|."""
    kz, delta, kap2 = run.laws("kz", "delta_rad_s", "kap2")
    k, mu = damping(run, size(run.array(f"{STATE}s1", NODES)))
    at = drawn_states(states)
    eps = size(unknown_part(run, plain, at) - action_nodes(run, at) @ w2.ideal).max()
    payload = size(f - unknown_part(run, plain, states)).max()
    c0 = max(float(eps + payload) - kz, 0.0)
    extra = kz * delta + sway * c0
    return Constants(k, kap2, w2.norm, c0, leak="constant", extra=extra, other_rate=mu)


def condition(run: Cycles, k: float) -> Assumption:
    """Return whether K is positive where alpha is kap1."""
    kv, beta, kap1, alpha = run.laws("kv_per_s", "beta", "kap1", "alpha")
    return Assumption(
        "beta^2 < 4 Kv |s1|^2 (1 - 1/(4 kap1)), alpha = kap1",
        k > 0.0 and alpha == kap1,
        f"beta {beta:g}, K {k:.3g} of Kv {kv:g}, kap1 {kap1:g}, alpha {alpha:g}",
        needed=True,
    )


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    kv, lam, kz, delta, kap2 = run.laws("kv_per_s", "lam_per_s", "kz", "delta_rad_s", "kap2")
    plain = TwoLinks(*run.settings("plant:arm.", (*LINKS, "gravity_m_s2")))
    links = replace(plain, m2=run.after(run.column("plant:arm.outer_mass_kg")))
    states, acts = motion(run, np.array([lam, lam])), acting_torque(run)
    r, sc = states.r, run.array(f"{STATE}sc", 2)
    moved = acceleration(run, links, states.q, states.v, run.setting(WIDTH), acts)
    robust = run.columns(f"{STATE}robust_{{}}_rad_s2")
    learned = run.columns(f"{STATE}learned_{{}}_rad_s2")
    f = states.forward[0] - moved + kv * r + learned + robust  # (1)
    s2, state = action_nodes(run, states), run.state(f"{STATE}w2", NODES, 2)
    w2 = state.layer("Gam", run.rate("gam"), fitted_weights(s2, f), dyads(s2, sc), kap2)
    rest, sway = f - s2 @ w2.ideal, size(sc - r)
    unhelped = np.maximum(size(rest) - kz, 0.0)  # w_k of (4)
    constants = bound(run, plain, states, f, w2, float(sway.max()))
    v, dissipated = critic(run, r, sc)
    return layered(
        run,
        ("Theorem 7.3.1", "|r| [rad/s]"),
        (w2,),
        v=v,
        damping=dissipated,
        terms={
            "sc'w, what no network cancels": inner(sc, rest),
            "leak of the weights": kap2 * w2.leaked,
        },
        error=size(r),
        rest=unhelped,
        extra=kz * delta + sway * unhelped,
        constants=constants,
        asked=(
            positive("leak kap2", kap2),
            switched_on(run, "both networks are on", "action_on", "critic_on"),
            condition(run, constants.damping),
            Assumption(
                "kz is above |w|",
                bool((unhelped == 0.0).all()),
                f"kz {kz:g}, |w| up to {size(rest).max():.3g}",
            ),
            inertia_known(TwoLinks(*run.laws(*LINKS)).inertia(states.q), links.inertia(states.q)),
            acting(run.columns(f"{STATE}torque_{{}}_Nm"), acts, "N m"),
        ),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w1", "w2", "v2", "s1", "sc"))
THEOREMS = {"adaptive_critic": Theorem(prove, STATES, ("gam",))}
