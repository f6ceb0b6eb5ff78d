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

from pcpc.plants.families.two_link.theory import Motion, TwoLinks, drawn, motion, times
from pcpc.plants.lyapunov import Asked, Constants, Proof, Vector
from pcpc.plants.theorem import (
    Theorem,
    Told,
    acting,
    fitted,
    inner,
    logistic,
    rates_positive,
    read_out,
    size,
    with_threshold,
)
from pcpc.plants.weights import Weights

INPUTS, ROOM, JUMPS = 11, 16, 4
STANDARD, PROJECT, CONST = 0.0, 3.0, 4.0
NO_FRICTION, LUGRE = 0.0, 2.0
LINKS = ("a1_m", "a2_m", "m1_kg", "m2_kg", "gravity_m_s2")


def seen(one: Motion) -> Vector:
    """Return x (n, 11)."""
    parts = (one.e, one.e_rate, one.q_d, one.rate_d, one.acc_d)
    return with_threshold(np.concatenate(parts, axis=1))


def sliding(told: Told, v: Vector) -> Vector:
    """Return the friction of joints that move with v, N m."""
    made = np.empty_like(v)
    for j in range(2):
        a0, a1, a2, b1, b2 = (
            told.setting(f"plant:arm.{name}_{j + 1}_{unit}")
            for name, unit in (
                ("coulomb", "Nm"), ("stiction", "Nm"), ("viscous", "Nm"),
                ("beta1", "s_rad"), ("beta2", "s_rad"),
            )
        )  # fmt: skip
        speed = np.abs(v[:, j])
        level = a0 + a1 * np.exp(-b1 * speed) + a2 * (1.0 - np.exp(-b2 * speed))
        made[:, j] = level * np.sign(v[:, j])
    return made * float(told.setting("plant:arm.friction_model") > 0.0)


def jump_nodes(told: Told, v: Vector) -> Vector:
    """Return phi (n, 4) at joint rates v."""
    kind = told.law("jump_nodes")
    if kind in (STANDARD, CONST):
        return np.tile([1.0, 0.0, 1.0, 0.0], (len(v), 1)) * float(kind == CONST)
    ahead = (v >= 0.0).astype(float)
    pairs = [np.stack((ahead[:, j], ahead[:, j] * (1.0 - np.exp(-v[:, j]))), 1) for j in range(2)]
    return np.concatenate(pairs, axis=1)


def wanted(links: TwoLinks, one: Motion) -> Vector:
    """Return f (1) without friction, N m."""
    ahead, along = one.forward
    moved = times(links.inertia(one.q), ahead) + times(links.coriolis(one.q, one.v), along)
    return moved + links.gravity(one.q)


def projected(told: Told, w2: Vector, driven: Vector, rate: float) -> Vector:
    """Return what the projection of own-joint step weights to 0 and more adds to `driven` of W2."""
    added = np.zeros_like(driven)
    if told.law("jump_nodes") == PROJECT and rate != 0.0:
        free = w2 + told.period_s * rate * driven
        for j in range(2):
            own = free[:, 2 * j, j]
            added[:, 2 * j, j] = (np.maximum(own, 0.0) - own) / (rate * told.period_s)
    return added


def driven(told: Told, used: tuple[Vector, ...], nodes: tuple[Vector, ...], r: Vector
           ) -> list[Vector]:  # fmt: skip
    """Return (6) over the rates for W1, V, W2; `nodes`: s - s'z, s', x, phi."""
    flat, slope, x, phi = nodes
    w1, v, w2 = used
    back = slope * np.einsum("njm,nm->nj", w1[:, 1:], r)
    leak = told.law("kappa") * size(r)[:, None, None]
    return [
        flat[:, :, None] * r[:, None, :] - leak * w1,
        x[:, :, None] * back[:, None, :] - leak * v,
        phi[:, :, None] * r[:, None, :] - leak * w2,
    ]


def smooth(told: Told, one: Motion) -> Asked:
    """Return whether friction is a function of x: without a state of its own, nothing at rest."""
    what, model = "friction is a function of x", told.setting("plant:arm.friction_model")
    if model == NO_FRICTION:
        return Asked(what, True, "the joints have none")
    if model == LUGRE:
        return Asked(what, False, "LuGre's bristles are a state of their own")
    sticks = 100.0 * float(np.mean((one.v == 0.0).any(axis=1)))
    return Asked(what, sticks == 0.0, f"a joint sticks in {sticks:.3g} % of the cycles")


def prove(told: Told) -> Proof:
    """Return the proof of a run."""
    nodes = int(told.law("nodes"))
    kv = np.array([told.law(f"kv_{j}_Nms_rad") for j in (1, 2)])
    lam = np.array([told.law(f"lam_{j}_per_s") for j in (1, 2)])
    kappa, kz, z_bound = told.law("kappa"), told.law("kz"), told.law("z_bound")
    links = TwoLinks(*(told.setting(f"plant:arm.{name}") for name in LINKS))
    one = motion(told, lam)
    r, inertia = one.r, links.inertia(one.q)

    w1 = told.used("executive:controller.w1", ROOM + 1, 2)[:, : nodes + 1]
    w2 = told.used("executive:controller.w2", JUMPS, 2)
    v = told.used("executive:controller.v", INPUTS, ROOM)[:, :, :nodes]
    x, phi = seen(one), told.array("executive:controller.phi", JUMPS)
    z = np.einsum("nij,ni->nj", v, x)
    s = with_threshold(logistic(z))
    slope = s[:, 1:] * (1.0 - s[:, 1:])
    friction = told.after(told.columns("plant:arm.friction_{}_Nm"))
    f = wanted(links, one) + friction

    v_ideal = v[0]
    both = fitted(np.concatenate((with_threshold(logistic(x @ v_ideal)), phi), axis=1), f)
    w1_lacks, w2_lacks, v_lacks = both[: nodes + 1] - w1, both[nodes + 1 :] - w2, v_ideal - v
    learned = read_out(w1, s) + read_out(w2, phi)
    turned = slope * np.einsum("nij,ni->nj", v_lacks, x)
    flat = np.concatenate((s[:, :1], s[:, 1:] - slope * z), axis=1)
    cancelled = read_out(w1_lacks, flat) + read_out(w1[:, 1:], turned) + read_out(w2_lacks, phi)
    rest = f - learned - cancelled  # (3)

    used, lacks = (w1, v, w2), (w1_lacks, v_lacks, w2_lacks)
    state = "executive:controller."
    after = (
        told.array(f"{state}w1", ROOM + 1, 2)[:, : nodes + 1],
        told.array(f"{state}v", INPUTS, ROOM)[:, :, :nodes],
        told.array(f"{state}w2", JUMPS, 2),
    )
    drives = driven(told, used, (flat, slope, x, phi), r)
    held = projected(told, w2, drives[2], told.rate("e_rate"))
    drives[2] = drives[2] + held
    names = "ST" if told.law("jump_nodes") == STANDARD else "STE"
    weights = [
        Weights(name, told.rate(f"{name.lower()}_rate"), lack, new - old, drive)
        for name, lack, new, old, drive in zip(names, lacks, after, used, drives, strict=False)
    ]
    lack = np.sqrt(sum(size(one) ** 2 for one in lacks))
    norm = np.sqrt(size(w1) ** 2 + size(v) ** 2 + size(w2) ** 2)
    lyapunov = 0.5 * np.einsum("ni,nij,nj->n", r, inertia, r)
    error = size(r)
    asked = told.columns("executive:controller.torque_{}_Nm")
    acts = told.after(told.columns("plant:arm.acting_{}_Nm"))
    leak = sum(inner(a, b) for a, b in zip(lacks, used, strict=True))

    far = drawn(one)
    far_x = seen(far)
    known = np.concatenate(
        (with_threshold(logistic(far_x @ v_ideal)), jump_nodes(told, far.v)), axis=1
    )
    eps = size(wanted(links, far) + sliding(told, far.v) - known @ both).max()
    outer, reach = float(np.linalg.norm(both)), float(size(far_x).max())
    ideal = math.hypot(outer, float(np.linalg.norm(v_ideal)))
    low, high = links.inertia_range()
    return Proof(
        theorem="Theorem 3.2.2",
        error_is="|r| [rad/s]",
        t_s=told.t_s,
        v=lyapunov + sum(one.stored for one in weights),
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
            Asked("leak kappa above 0", kappa > 0.0, f"kappa {kappa:g}", needed=True),
            Asked(
                "Z_B is above |Z*|",
                z_bound >= ideal,
                f"Z_B {z_bound:g}, |Z*| {ideal:.3g}",
            ),
            acting(asked, acts, "N m"),
            smooth(told, one),
        ),
    )


STATES = tuple(f"controller.{name}_*" for name in ("w1", "w2", "v", "phi"))
THEOREMS = {"friction_nn": Theorem(prove, STATES, ("s_rate", "t_rate", "e_rate"))}
