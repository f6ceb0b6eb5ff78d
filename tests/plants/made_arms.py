"""Runs made up for the proofs of arms: motion is drawn, and torques follow."""

import numpy as np
from made_runs import (
    LAW,
    Columns,
    Free,
    Made,
    N,
    T,
    each,
    late,
    law,
    logistic,
    state,
    stepped,
    under,
    weights,
)

from pcpc.plants.families.two_link.book.theory import LINKS, TwoLinks, times
from pcpc.plants.telerobot.equations import A21, A22
from pcpc.plants.weights import Vector

SIZES = dict(zip(LINKS, (0.9, 0.7, 1.1, 0.8), strict=True))


def links(mass: Vector | None = None, g: float = 9.0) -> TwoLinks:
    """Return an arm."""
    a1, a2, m1, m2 = SIZES.values()
    return TwoLinks(a1, a2, m1, m2 if mass is None else mass, g)


def arm(free: Free, lam: Vector) -> tuple[Columns, list[Vector], Vector, Vector]:
    """Return the columns of an arm on its way, q, q', q'', what the networks take, and r."""
    q, q_d = free.waves(2), free.waves(2)
    found = {f"plant:arm.{name}": value for name, value in SIZES.items()}
    for name, values in zip(("q_{}_rad", "rate_{}_rad_s"), q[:2], strict=True):
        found |= each("plant:arm." + name, values)
    for name, values in zip(
        ("q_d_{}_rad", "q_d_rate_{}_rad_s", "q_d_acc_{}_rad_s2"), q_d, strict=True
    ):
        joint, end = "executive:reference_{}.", name.replace("_{}", "")
        found |= each(joint + end, values)
    e, e_rate = q_d[0] - q[0], q_d[1] - q[1]
    x = np.concatenate((np.ones((N, 1)), e, e_rate, *q_d), axis=1)
    return found, list(q), x, e_rate + lam * e


def inverse_dynamics(one: TwoLinks, q: list[Vector]) -> Vector:
    """Return M q'' + Vm q' + G, (N, 2)."""
    return (
        times(one.inertia(q[0]), q[2]) + times(one.coriolis(q[0], q[1]), q[1]) + one.gravity(q[0])
    )


def square(*parts: Vector) -> float:
    """Return the sum of all squares."""
    return float(sum(np.sum(one**2) for one in parts))


def friction_arm(seed: int) -> Made:
    """M r' = -Vm r - tau + f, where friction is what makes it so."""
    free, nodes = Free(seed), 3
    lam, kv = np.array([2.0, 3.0]), np.array([4.0, 6.0])
    s, t, e, kappa, kz, z_b = 3.0, 2.0, 5.0, 0.7, 0.3, 9.0
    found, q, x, r = arm(free, lam)
    phi, project = free.wave(4), seed % 4 == 0
    own = np.array([[1, 0], [0, 0], [0, 1], [0, 0]]) * project > 0

    def own_kept(w2: Vector, slope: Vector) -> Vector:
        """Return w2' where no own-joint step falls below 0, if it is to be kept from that."""
        return np.where(own, np.maximum(slope, -w2 / T), slope)

    def slopes(k: int, w1: Vector, v: Vector, w2: Vector) -> tuple[Vector, Vector, Vector]:
        nodes = logistic(v.T @ x[k])
        slope, leak = nodes * (1.0 - nodes), kappa * np.sqrt(square(r[k]))
        flat = np.concatenate(([1.0], nodes - slope * (v.T @ x[k])))
        return (
            s * (np.outer(flat, r[k]) - leak * w1),
            t * (np.outer(x[k], slope * (w1[1:] @ r[k])) - leak * v),
            own_kept(w2, e * (np.outer(phi[k], r[k]) - leak * w2)),
        )

    first = np.where(own, 0.0, free.numbers(4, 2))
    w1, v, w2 = stepped((free.numbers(nodes + 1, 2), free.numbers(11, nodes), first), slopes)
    asked = np.array(
        [
            kv * r[k]
            + w1[k].T @ np.concatenate(([1.0], logistic(v[k].T @ x[k])))
            + w2[k].T @ phi[k]
            + kz * (np.sqrt(square(w1[k], v[k], w2[k])) + z_b) * r[k]
            for k in range(N)
        ]
    )
    acts = asked - free.wave(2, size=0.3)
    found |= each("plant:arm.acting_{}_Nm", late(acts))
    found |= each("plant:arm.friction_{}_Nm", late(acts - inverse_dynamics(links(), q)))
    found |= each(LAW + "torque_{}_Nm", asked)
    found |= weights("w1", w1, 17, 2) | weights("w2", w2, 4, 2)
    found |= weights("v", v, 11, 16, first=free.numbers(11, nodes))
    found |= state(LAW + "phi", phi)
    found |= law(nodes=3.0, kappa=kappa, kz=kz, z_bound=z_b)
    found |= law(jump_nodes=3.0 if project else 1.0)
    found |= {"plant:arm.gravity_m_s2": 9.0, "plant:arm.friction_model": 1.0}
    sizes = {"coulomb_{}_Nm": 0.3, "stiction_{}_Nm": 0.2, "viscous_{}_Nm": 0.4}
    sizes |= {"beta1_{}_s_rad": 5.0, "beta2_{}_s_rad": 2.0}
    for j in range(2):
        found |= law(**{f"kv_{j + 1}_Nms_rad": kv[j], f"lam_{j + 1}_per_s": lam[j]})
        found |= under(
            "plant:arm.", **{n.format(j + 1): value * (j + 1) for n, value in sizes.items()}
        )
    return Made(found, {"s_rate": s, "t_rate": t, "e_rate": e})


def deadzone_arm(seed: int) -> Made:
    """M r' = -Vm r - Kv r + w_d - tau, with whatever the networks say."""
    free, nodes = Free(seed), 3
    kv, lam, k1, k2, s, t = 5.0, 2.0, 0.6, 0.4, 3.0, 2.0
    found, q, _, r = arm(free, np.array([lam, lam]))
    level = links(g=0.0)
    # w_d = M (q_d'' + Lam e') + Vm (q_d' + Lam e) + Kv r = M (q'' + r') + Vm (q' + r) + Kv r
    r_rate = np.gradient(r, T, axis=0, edge_order=2)
    acts = inverse_dynamics(level, q)
    w_d = acts + times(level.inertia(q[0]), r_rate) + times(level.coriolis(q[0], q[1]), r) + kv * r
    y, jacobian, b = free.wave(2), free.wave(2), free.wave(2, nodes)
    vi, v0i = free.numbers(2, nodes), free.numbers(2, nodes)
    right = np.where(w_d >= 0.0, 1.0, 0.0)
    jumps = np.stack((right, right * (1.0 - np.exp(-np.abs(w_d)))), axis=2)
    nodes_i = np.concatenate((logistic(w_d[:, :, None] * vi + v0i), jumps), axis=2)

    def slopes(k: int, w: Vector, wi: Vector) -> tuple[Vector, Vector]:
        size = np.sqrt(square(r[k]))
        leak = (k1 + k2 * np.sqrt(square(wi))) * size
        return (
            -s * (b[k] * (y[k] * r[k])[:, None] + k1 * size * w),
            t * (nodes_i[k] * (r[k] * jacobian[k])[:, None] - leak * wi),
        )

    w, wi = stepped((free.numbers(2, nodes), free.numbers(2, nodes + 2)), slopes)
    found |= each("plant:arm.acting_{}_Nm", late(acts))
    u = np.where(acts > 0.0, acts / 1.2 + 0.2, acts / 0.9 - 0.3)  # so that D(u) acts
    for name, values in (("y_{}_Nm", y), ("slope_{}", jacobian), ("tau_d_{}_Nm", u - y)):
        found |= each(LAW + name, values)
    room = np.full((N, 2, 42), 7.0)
    room[:, :, :nodes], room[:, :, 40:] = wi[1:, :, :nodes], wi[1:, :, nodes:]
    found |= state(LAW + "wi", room) | weights("w", w, 2, 40)
    drawn = {
        "b": b,
        "vi": vi,
        "v0i": v0i,
        "v": free.numbers(2, nodes),
        "v0": free.numbers(2, nodes),
    }
    for name, values in drawn.items():
        whole = np.full((N, 2, 40), 7.0)
        whole[:, :, :nodes] = values
        found |= state(LAW + name, whole)
    found |= law(kv_Nms_rad=kv, lam_per_s=lam, k1=k1, k2=k2, u_max_Nm=1e4)
    found |= law(nodes=3.0, jumps_on=1.0, network_on=1.0)
    found |= under("plant:arm.", d_plus_Nm=0.2, d_minus_Nm=0.3, m_plus=1.2, m_minus=0.9)
    return Made(found, {"s_rate": s, "t_rate": t})


def payload_arm(seed: int) -> Made:
    """R' and R' by (11) of adaptive_critic.py; V1 D1 W1 is any matrix."""
    free = Free(seed)
    kv, lam, beta, kap1, kap2, gam, kz, delta = 5.0, 2.0, 0.8, 1.1, 0.6, 3.0, 0.7, 0.2
    found, q, x, r = arm(free, np.array([lam, lam]))
    v2, s1, turn = free.numbers(11, 10) / 3.0, free.wave(10), free.numbers(2, 2)
    s2 = logistic(x @ v2)
    r_rate = np.gradient(r, T, axis=0, edge_order=2)

    def robust(k: int, critic: Vector) -> tuple[Vector, Vector]:
        sc = r[k] + turn @ critic
        return sc, kz * sc / (np.sqrt(square(sc)) + delta)

    def slopes(k: int, critic: Vector, w1: Vector, w2: Vector) -> tuple[Vector, Vector, Vector]:
        sc, _ = robust(k, critic)
        moves = turn.T @ (r_rate[k] + kv * r[k]) - square(s1[k]) * critic + beta * r[k]
        return moves, -np.outer(s1[k], critic) - kap1 * w1, gam * (np.outer(s2[k], sc) - kap2 * w2)

    critic, w1, w2 = stepped((free.numbers(2), free.numbers(10, 2), free.numbers(10, 2)), slopes)
    both = np.array([robust(k, critic[k]) for k in range(N)])
    mass = 0.8 + 0.1 * free.wave(size=0.5)
    slowed = 0.3 * q[1] + 0.2 * np.tanh(q[1] / 0.5)
    acts = inverse_dynamics(links(mass), q) + slowed
    found |= each("plant:arm.acting_{}_Nm", late(acts)) | each(LAW + "torque_{}_Nm", acts)
    found |= each(LAW + "critic_{}", critic[:N]) | state(LAW + "sc", both[:, 0])
    found |= each(LAW + "robust_{}_rad_s2", both[:, 1])
    found |= each(LAW + "learned_{}_rad_s2", np.einsum("nkj,nk->nj", w2[:N], s2))
    found |= weights("w1", w1) | weights("w2", w2) | state(LAW + "s1", s1)
    found |= state(LAW + "v2", np.broadcast_to(v2, (N, 11, 10)))
    found |= law(kv_per_s=kv, lam_per_s=lam, beta=beta, kap1=kap1, kap2=kap2, kz=kz)
    found |= law(delta_rad_s=delta, alpha=kap1, action_on=1.0, critic_on=1.0, **SIZES)
    found |= under("plant:arm.", gravity_m_s2=9.0, smooth_rad_s=0.5, outer_mass_kg=late(mass))
    found |= under("plant:arm.", viscous_Nms_rad=0.3, coulomb_Nm=0.2)
    return Made(found, {"gam": gam})


def telerobot(seed: int) -> Made:
    """x~' = As x~ + B (f - W'ph - v), where the identifier is what makes it so."""
    free, servo = Free(seed), "local:servo."
    kr, kw, kap, gam = 4.0, 0.3, 0.6, 3.0
    q, v, p = free.waves(2), free.numbers(5, 20) / 2.0, np.array([10.0, 2.0])
    mass, asked = 0.8 + 0.1 * free.wave(size=0.5), free.wave(2)
    known = links()
    f = q[2] - np.linalg.solve(known.inertia(q[0]), asked[:, :, None])[:, :, 0]
    ph = np.tanh(np.concatenate((np.ones((N, 1)), *q[:2]), axis=1) @ v)

    def slopes(k: int, far: Vector, w: Vector) -> tuple[Vector, Vector]:
        st = far @ p
        moves = f[k] - w.T @ ph[k] - (kr + kw * np.sqrt(square(w))) * st
        pulled = A21 * far[:, 0] + A22 * far[:, 1] + moves
        return np.stack((far[:, 1], pulled), axis=1), gam * (np.outer(ph[k], st) - kap * w)

    far, w = stepped((free.numbers(2, 2) / 3.0, free.numbers(20, 2)), slopes)
    slowed = 0.3 * q[1] + 0.2 * np.tanh(q[1] / 0.05)
    found = under("plant:arm.", **SIZES, gravity_m_s2=9.0, viscous_Nms_rad=0.3, coulomb_Nm=0.2)
    found |= under(servo, **SIZES, gravity_m_s2=9.0, kr_per_s=kr, kw=kw, kap=kap, held_u=0.0)
    found |= each("plant:arm.q_{}_rad", q[0]) | each("plant:arm.rate_{}_rad_s", q[1])
    found |= each("plant:arm.acting_{}_Nm", late(inverse_dynamics(links(mass), list(q)) + slowed))
    found |= each(servo + "torque_{}_Nm", asked)
    found |= each(servo + "model_{}_rad", q[0] - far[:N, :, 0])
    found |= each(servo + "model_rate_{}_rad_s", q[1] - far[:N, :, 1])
    found |= state(servo + "w", w[1:]) | state(servo + "v", np.broadcast_to(v, (N, 5, 20)))
    found |= {"plant:arm.mass_kg": late(mass)}
    return Made(found | law(local_law=4.0), {"gam": gam})
