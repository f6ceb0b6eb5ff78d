"""Theorem 3.2.2 on runs of the two-link arm with friction: its proof term by term.

    M r' = -Vm r - tau + f,  f = M (q_d'' + Lam e') + Vm (q_d' + Lam e) + G + F              (1)
    f    = W1*'s(V*'x) + W2*'phi + eps                                                       (2)
    w    = f - fhat - [W1~'(s - s'z) + W1's'V~'x + W2~'phi],   z = V'x                       (3)
         = W1*'(s* - s - s'(z* - z)) + W1~'s'z* + eps
    V    = r'M r/2 + |W1~|^2/(2 S) + |V~|^2/(2 T) + |W2~|^2/(2 E)                            (4)
    V'   = -r'Kv r - Kz (|Z| + Z_B) |r|^2 + r'w + kappa |r| tr(Z~'Z) + r'd                   (5)
    W1'  = S [(s - s'z) r' - kappa |r| W1],  V' = T [x (s'W1 r)' - kappa |r| V],
    W2'  = E [phi r' - kappa |r| W2]                                                         (6)

The bracket of (3) is what the tuning laws (6) cancel. d: what acts differs from what the law
computes. `project` moves a step weight to 0 where it would fall below: another term of V', never
above 0 for W2* >= 0.
F is the friction torque of the step that follows. V* is V as drawn, W1* and W2* come of least
squares: any choice obeys (5). (3) is bounded by |s* - s - s'(z* - z)| <= sqrt(L) + |V~||x|/4 and
s' <= 1/4; x over references of the run, |r| up to 1.25 times the largest of the run.
Source: Lewis, Campos, Selmic (SIAM 2002), chapter 3.
"""

from dataclasses import replace

import numpy as np

from pcpc.plants.book.hidden import Hidden
from pcpc.plants.families.two_link.book.theory import (
    LINKS,
    Motion,
    TwoLinks,
    acting_torque,
    drawn_states,
    forward_torque,
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
    never,
    positive,
    read_out,
    size,
    with_threshold,
)
from pcpc.plants.weights import Layer, Vector, norm

INPUTS, ROOM, JUMPS = 11, 16, 4
STANDARD, PROJECT, CONST = 0.0, 3.0, 4.0
NO_FRICTION, LUGRE = 0.0, 2.0
FRICTION = ("coulomb_{}_Nm", "stiction_{}_Nm", "viscous_{}_Nm", "beta1_{}_s_rad", "beta2_{}_s_rad")
STATE = "executive:controller."


def friction_torque(run: Cycles, v: Vector) -> Vector:
    """Return the friction (n, 2) of joints that move with v (n, 2), N m."""
    made = np.empty_like(v)
    for j in range(2):
        a0, a1, a2, b1, b2 = run.settings("plant:arm.", [name.format(j + 1) for name in FRICTION])
        speed = np.abs(v[:, j])
        level = a0 + a1 * np.exp(-b1 * speed) + a2 * (1.0 - np.exp(-b2 * speed))
        made[:, j] = level * np.sign(v[:, j])
    return made * float(run.setting("plant:arm.friction_model") > 0.0)


def jump_nodes(run: Cycles, v: Vector) -> Vector:
    """Return phi (n, 4) at joint rates v (n, 2)."""
    kind = run.law("jump_nodes")
    if kind in (STANDARD, CONST):
        return np.tile([1.0, 0.0, 1.0, 0.0], (len(v), 1)) * float(kind == CONST)
    ahead = (v >= 0.0).astype(float)
    pairs = [np.stack((ahead[:, j], ahead[:, j] * (1.0 - np.exp(-v[:, j]))), 1) for j in range(2)]
    return np.concatenate(pairs, axis=1)


def frictionless(links: TwoLinks, one: Motion) -> Vector:
    """Return f (1) without friction, (n, 2), N m."""
    return forward_torque(links, one) + links.gravity(one.q)


def projection(run: Cycles, w2: Layer) -> Vector:
    """Return what the projection of own-joint step weights to 0 and more adds to (6), (n, 4, 2)."""
    added = np.zeros_like(w2.driven)
    if run.law("jump_nodes") == PROJECT and w2.rate != 0.0:
        free = w2.w + run.period_s * w2.rate * w2.driven
        for j in range(2):
            own = free[:, 2 * j, j]
            added[:, 2 * j, j] = (np.maximum(own, 0.0) - own) / (w2.rate * run.period_s)
    return added


def layers(
    run: Cycles, r: Vector, f: Vector, hidden: Hidden, phi: Vector
) -> tuple[Layer, Layer, Layer]:
    """Return W1, V, W2 as (6) tunes them, W2 without its projection."""
    nodes = hidden.nodes.shape[1]
    w1, w2 = run.state(f"{STATE}w1", ROOM + 1, 2)[:, :nodes], run.state(f"{STATE}w2", JUMPS, 2)
    both = fitted_weights(np.concatenate((hidden.known, phi), axis=1), f)
    flat, slope, _ = hidden.linear
    back = slope * np.einsum("njm,nm->nj", w1.w[:, 1:], r)
    leak = run.law("kappa") * size(r)
    return (
        w1.layer("S", run.rate("s_rate"), both[:nodes], dyads(flat, r), leak),
        hidden.layer("T", run.rate("t_rate"), back, leak),
        w2.layer("E", run.rate("e_rate"), both[nodes:], dyads(phi, r), leak),
    )


def bound(
    run: Cycles, links: TwoLinks, states: Motion, hidden: Hidden, w: tuple[Layer, Layer]
) -> Constants:
    """Return the constants; `w`: W1, W2."""
    far, both = drawn_states(states), np.concatenate([one.ideal for one in w])
    nodes = with_threshold(logistic(far.inputs @ hidden.ideal))
    known = np.concatenate((nodes, jump_nodes(run, far.v)), axis=1)
    eps = size(frictionless(links, far) + friction_torque(run, far.v) - known @ both).max()
    layer_constants = replace(hidden, x=far.inputs).constants(
        float(np.linalg.norm(both)), float(eps)
    )
    kv = min(run.laws("kv_1_Nms_rad", "kv_2_Nms_rad"))
    low, high = links.inertia_range()
    k = kv + run.law("kz") * run.law("z_bound")
    return Constants(k, run.law("kappa"), *layer_constants, low=low, high=high)


def friction_without_memory(run: Cycles, states: Motion) -> Assumption:
    """Return whether friction is a function of x: without a state of its own, nothing at rest."""
    claim, model = "friction is a function of x", run.setting("plant:arm.friction_model")
    if model == NO_FRICTION:
        return Assumption(claim, True, "the joints have none")
    if model == LUGRE:
        return Assumption(claim, False, "LuGre's bristles are a state of their own")
    return never(claim, (states.v == 0.0).any(axis=1), "a joint sticks in {}")


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    nodes = int(run.law("nodes"))
    kv = np.array(run.laws("kv_1_Nms_rad", "kv_2_Nms_rad"))
    kappa, kz, z_bound = run.laws("kappa", "kz", "z_bound")
    links = TwoLinks(*run.settings("plant:arm.", (*LINKS, "gravity_m_s2")))
    states = motion(run, np.array(run.laws("lam_1_per_s", "lam_2_per_s")))
    r, error = states.r, size(states.r)
    f = frictionless(links, states) + run.after(run.columns("plant:arm.friction_{}_Nm"))  # (1)
    hidden = Hidden.of(run.state(f"{STATE}v", INPUTS, ROOM)[:, :, :nodes], states.inputs)
    phi = run.array(f"{STATE}phi", JUMPS)
    w1, v, w2 = layers(run, r, f, hidden, phi)
    projected = projection(run, w2)
    all_layers = w1, v, replace(w2, driven=w2.driven + projected)
    flat, _, turned = hidden.linear
    learned = read_out(w1.w, hidden.nodes) + read_out(w2.w, phi)
    cancelled = read_out(w1.lacks, flat) + read_out(w1.w[:, 1:], turned) + read_out(w2.lacks, phi)
    rest = f - learned - cancelled  # (3)
    commanded = run.columns(f"{STATE}torque_{{}}_Nm")
    acts = acting_torque(run)
    constants = bound(run, links, states, hidden, (w1, w2))
    return layered(
        run,
        ("Theorem 3.2.2", "|r| [rad/s]"),
        all_layers,
        rates=all_layers[: 2 if run.law("jump_nodes") == STANDARD else 3],
        v=0.5 * np.einsum("ni,nij,nj->n", r, links.inertia(states.q), r),  # (4)
        damping=np.sum(r * kv * r, axis=1) + kz * (norm(w1.w, v.w, w2.w) + z_bound) * error**2,
        terms={
            "r'w, what no network cancels": inner(r, rest),
            "leak of the weights": kappa * error * (w1.leaked + v.leaked + w2.leaked),
            **({"projection": -inner(w2.lacks, projected)} if projected.any() else {}),
        },
        beyond={"limits, quanta, delay": inner(r, commanded - acts)},
        error=error,
        rest=size(rest + commanded - acts),
        constants=constants,
        asked=(
            positive("leak kappa", kappa),
            Assumption(
                "Z_B is above |Z*|",
                z_bound >= constants.ideal,
                f"Z_B {z_bound:g}, |Z*| {constants.ideal:.3g}",
            ),
            acting(commanded, acts, "N m"),
            friction_without_memory(run, states),
        ),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w1", "w2", "v", "phi"))
THEOREMS = {"friction_nn": Theorem(prove, STATES, ("s_rate", "t_rate", "e_rate"))}
