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

import math

import numpy as np

from pcpc.plants.families.two_link.book.theory import Motion, TwoLinks, drawn_states, motion, times
from pcpc.plants.lyapunov import Assumption, Constants, Proof
from pcpc.plants.theorem import (
    Cycles,
    Theorem,
    acting,
    fitted_weights,
    inner,
    linearised,
    logistic,
    never,
    positive,
    rates_positive,
    read_out,
    size,
    with_threshold,
)
from pcpc.plants.weights import Vector, Weights

INPUTS, ROOM, JUMPS = 11, 16, 4
STANDARD, PROJECT, CONST = 0.0, 3.0, 4.0
NO_FRICTION, LUGRE = 0.0, 2.0
FRICTION = ("coulomb_{}_Nm", "stiction_{}_Nm", "viscous_{}_Nm", "beta1_{}_s_rad", "beta2_{}_s_rad")
LINKS = ("a1_m", "a2_m", "m1_kg", "m2_kg", "gravity_m_s2")


def network_input(one: Motion) -> Vector:
    """Return x (n, 11)."""
    parts = (one.e, one.e_rate, one.q_d, one.rate_d, one.acc_d)
    return with_threshold(np.concatenate(parts, axis=1))


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
    ahead, along = one.forward
    moved = times(links.inertia(one.q), ahead) + times(links.coriolis(one.q, one.v), along)
    return moved + links.gravity(one.q)


def projection(run: Cycles, w2: Vector, driven: Vector, rate: float) -> Vector:
    """Return what the projection of own-joint step weights to 0 and more adds to `driven` of W2.

    `w2`, `driven` and the result: (n, 4, 2).
    """
    added = np.zeros_like(driven)
    if run.law("jump_nodes") == PROJECT and rate != 0.0:
        free = w2 + run.period_s * rate * driven
        for j in range(2):
            own = free[:, 2 * j, j]
            added[:, 2 * j, j] = (np.maximum(own, 0.0) - own) / (rate * run.period_s)
    return added


def tuning_drives(
    run: Cycles, used: tuple[Vector, ...], nodes: tuple[Vector, ...], r: Vector
) -> list[Vector]:
    """Return (6) over the rates for W1, V, W2; `nodes`: s - s'z, s', x, phi.

    `used` and the results: (n, L + 1, 2), (n, 11, L), (n, 4, 2); `nodes`: (n, L + 1), (n, L),
    (n, 11), (n, 4); `r`: (n, 2).
    """
    flat, slope, x, phi = nodes
    w1, v, w2 = used
    back = slope * np.einsum("njm,nm->nj", w1[:, 1:], r)
    leak = run.law("kappa") * size(r)[:, None, None]
    return [
        flat[:, :, None] * r[:, None, :] - leak * w1,
        x[:, :, None] * back[:, None, :] - leak * v,
        phi[:, :, None] * r[:, None, :] - leak * w2,
    ]


def friction_without_memory(run: Cycles, one: Motion) -> Assumption:
    """Return whether friction is a function of x: without a state of its own, nothing at rest."""
    what, model = "friction is a function of x", run.setting("plant:arm.friction_model")
    if model == NO_FRICTION:
        return Assumption(what, True, "the joints have none")
    if model == LUGRE:
        return Assumption(what, False, "LuGre's bristles are a state of their own")
    return never(what, (one.v == 0.0).any(axis=1), "a joint sticks in {}")


def prove(run: Cycles) -> Proof:
    """Return the proof of a run."""
    nodes = int(run.law("nodes"))
    kv = np.array(run.laws("kv_1_Nms_rad", "kv_2_Nms_rad"))
    lam = np.array(run.laws("lam_1_per_s", "lam_2_per_s"))
    kappa, kz, z_bound = run.laws("kappa", "kz", "z_bound")
    links = TwoLinks(*run.settings("plant:arm.", LINKS))
    one = motion(run, lam)
    r, inertia = one.r, links.inertia(one.q)

    w1 = run.used("executive:controller.w1", ROOM + 1, 2)[:, : nodes + 1]
    w2 = run.used("executive:controller.w2", JUMPS, 2)
    v = run.used("executive:controller.v", INPUTS, ROOM)[:, :, :nodes]
    x, phi = network_input(one), run.array("executive:controller.phi", JUMPS)
    s = with_threshold(logistic(np.einsum("nij,ni->nj", v, x)))
    friction = run.after(run.columns("plant:arm.friction_{}_Nm"))
    f = frictionless(links, one) + friction

    v_ideal = v[0]
    both = fitted_weights(np.concatenate((with_threshold(logistic(x @ v_ideal)), phi), axis=1), f)
    w1_lacks, w2_lacks, v_lacks = both[: nodes + 1] - w1, both[nodes + 1 :] - w2, v_ideal - v
    learned = read_out(w1, s) + read_out(w2, phi)
    flat, slope, turned = linearised(s, v, x, v_lacks)
    cancelled = read_out(w1_lacks, flat) + read_out(w1[:, 1:], turned) + read_out(w2_lacks, phi)
    rest = f - learned - cancelled  # (3)

    used, lacks = (w1, v, w2), (w1_lacks, v_lacks, w2_lacks)
    state = "executive:controller."
    moved = (
        run.moved(f"{state}w1", ROOM + 1, 2)[:, : nodes + 1],
        run.moved(f"{state}v", INPUTS, ROOM)[:, :, :nodes],
        run.moved(f"{state}w2", JUMPS, 2),
    )
    drives = tuning_drives(run, used, (flat, slope, x, phi), r)
    held = projection(run, w2, drives[2], run.rate("e_rate"))
    drives[2] = drives[2] + held
    names = "ST" if run.law("jump_nodes") == STANDARD else "STE"
    weights = [
        Weights(name, run.rate(f"{name.lower()}_rate"), *parts)
        for name, *parts in zip(names, lacks, moved, drives, strict=False)
    ]
    lack = np.sqrt(sum(size(one) ** 2 for one in lacks))
    norm = np.sqrt(size(w1) ** 2 + size(v) ** 2 + size(w2) ** 2)
    lyapunov = 0.5 * np.einsum("ni,nij,nj->n", r, inertia, r)
    error = size(r)
    asked = run.columns("executive:controller.torque_{}_Nm")
    acts = run.after(run.columns("plant:arm.acting_{}_Nm"))
    leak = sum(inner(a, b) for a, b in zip(lacks, used, strict=True))

    far = drawn_states(one)
    far_x = network_input(far)
    known = np.concatenate(
        (with_threshold(logistic(far_x @ v_ideal)), jump_nodes(run, far.v)), axis=1
    )
    eps = size(frictionless(links, far) + friction_torque(run, far.v) - known @ both).max()
    outer, reach = float(np.linalg.norm(both)), float(size(far_x).max())
    ideal = math.hypot(outer, float(np.linalg.norm(v_ideal)))
    low, high = links.inertia_range()
    return Proof(
        theorem="Theorem 3.2.2",
        error_is="|r| [rad/s]",
        t_s=run.t_s,
        v=lyapunov + sum(one.energy for one in weights),
        tuned=weights,
        damping=np.sum(r * kv * r, axis=1) + kz * (norm + z_bound) * error**2,
        terms={
            "r'w, what no network cancels": inner(r, rest),
            "leak of the weights": kappa * error * leak,
            **({"projection": -inner(w2_lacks, held)} if held.any() else {}),
        },
        beyond={"limits, quanta, delay": inner(r, asked - acts)},
        error=error,
        weights=lack,
        rest=size(rest + asked - acts),
        constants=Constants(
            damping=float(kv.min()) + kz * z_bound,
            kappa=kappa,
            ideal=ideal,
            c0=float(eps) + outer * np.sqrt(nodes),
            c1=float(size(far_x @ v_ideal).max()) / 4.0 + outer * reach / 4.0,
            low=low,
            high=high,
            gamma=min(one.metric for one in weights),
        ),
        asked=(
            rates_positive(weights),
            positive("leak kappa", kappa),
            Assumption(
                "Z_B is above |Z*|",
                z_bound >= ideal,
                f"Z_B {z_bound:g}, |Z*| {ideal:.3g}",
            ),
            acting(asked, acts, "N m"),
            friction_without_memory(run, one),
        ),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w1", "w2", "v", "phi"))
THEOREMS = {"friction_nn": Theorem(prove, STATES, ("s_rate", "t_rate", "e_rate"))}
