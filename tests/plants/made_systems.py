"""Runs made up for the proofs of all systems, those of arms beside this."""

from collections.abc import Callable

import numpy as np
from made_arms import deadzone_arm, friction_arm, payload_arm, square, telerobot
from made_runs import (
    LAW,
    Free,
    Made,
    N,
    late,
    law,
    logistic,
    state,
    stepped,
    under,
    weights,
)

from pcpc.plants.weights import Vector


def backlash_pendulum(seed: int) -> Made:
    """R' = -Kv r - tt and tt' = -Kb tt - v2 + y - B + (tau_d' - D), with any B and D."""
    free, lam, kv, kb, kappa, s, t_v = Free(seed), 2.0, 5.0, 4.0, 0.7, 3.0, 2.0
    plant, q = "plant:pendulum.", free.wave()
    q_d, q_d_rate, _ = free.waves()
    x, u, tau, tau_d = free.wave(6), free.wave(), free.wave(), free.wave()
    tt = tau_d - tau
    (r,) = stepped((free.numbers(1),), lambda k, r: (-kv * r - tt[k],))

    def slopes(k: int, w: Vector, v: Vector) -> tuple[Vector, Vector]:
        nodes = logistic(v.T @ x[k])
        slope, leak = nodes * (1.0 - nodes), kappa * abs(tt[k])
        flat = np.concatenate(([1.0], nodes - slope * (v.T @ x[k])))
        return (
            -s * (flat * tt[k] + leak * w),
            -t_v * (np.outer(x[k], slope * w[1:] * tt[k]) + leak * v),
        )

    w, v = stepped((free.numbers(11), free.numbers(6, 10)), slopes)
    y = np.array([w[k] @ np.concatenate(([1.0], logistic(v[k].T @ x[k]))) for k in range(N)])
    sizes = np.array([square(w[k], v[k]) for k in range(N)])
    found = weights("w", w) | state(LAW + "x", x)
    found |= weights("v", v, first=free.numbers(6, 10))
    found |= under("executive:reference.", q_d_rad=q_d, q_d_rate_rad_s=q_d_rate)
    found |= under(plant, q_rad=q, rate_rad_s=r[:N, 0] - lam * (q - q_d) + q_d_rate)
    found |= under(plant, torque_Nm=tau, acting_Nm=late(u), time_constant_s=1.5)
    found |= under(plant, mass_kg=2.0, gravity_m_s2=3.0, length_m=0.5)
    found |= law(tau_d_Nm=tau_d, u_Nm=u, command_Nm=u, network_Nm_s=y)
    found |= law(robust_Nm_s=0.3 * (np.sqrt(sizes) + 8.0) * tt)
    found |= law(lam_per_s=lam, kv_Nms_rad=kv, kb_per_s=kb, kz1_per_s=0.3, z_bound=8.0)
    found |= law(kappa=kappa, network_on=1.0, robust_on=1.0)
    found |= law(model_gravity_Nm=3.0, model_time_constant_s=1.5)
    return Made(found, {"s_rate": s, "t_rate": t_v})


def barrel(seed: int) -> Made:
    """Any motion: M r' is what it asks for. r_t is the measured r, clipped or at rest."""
    free, plant = Free(seed), "plant:barrel."
    kv, lam, kappa, kz, z_b, f, fj, g = 5.0, 2.0, 0.7, 0.3, 9.0, 3.0, 4.0, 2.0
    theta, q_d, seen = free.waves(), free.waves(), free.wave(size=0.4)
    error = np.where(np.arange(N) % 7 == 0, 1e-5, 1e-3)
    q_d[2][np.arange(N) % 14 == 0] = 0.0
    rests = np.arange(N) % 14 == 0
    seen[::2] *= -1.0
    engaged = np.arange(N) >= 30
    r_t = np.where(rests | ~engaged, 0.0, np.clip(seen, -0.3, 0.3))
    x, phi = free.wave(7), free.wave(15)
    phi[:, 0], phi[:, 1:11] = 1.0, logistic(phi[:, 1:11])

    def slopes(k: int, w: Vector, v: Vector) -> tuple[Vector, Vector]:
        slope = phi[k, 1:11] * (1.0 - phi[k, 1:11])
        flat = phi[k].copy()
        flat[1:11] -= slope * (v.T @ x[k])
        rates, leak = np.where(np.arange(15) < 11, f, fj), kappa * abs(r_t[k])
        return (
            rates * (flat * r_t[k] - leak * w),
            g * (np.outer(x[k], slope * w[1:11] * r_t[k]) - leak * v),
        )

    w, v = stepped((free.numbers(15), free.numbers(7, 10)), slopes)
    found = under(plant, theta_rad=theta[0], theta_rate_rad_s=theta[1], rigid_inertia_kg_m2=1.5)
    found |= under(plant, motor_inertia_kg_m2=0.01, gear_ratio=7.0, penetration_rad=1.0)
    found |= under(
        "executive:reference.", q_d_rad=q_d[0], q_d_rate_rad_s=q_d[1], q_d_acc_rad_s2=q_d[2]
    )
    found |= law(lam_per_s=lam, kv_Nms_rad=kv, kz=kz, z_bound=z_b, kappa=kappa, tau_max_Nm=9.0)
    found |= law(e_rad=error, r_rad_s=seen, network_on=1.0 * engaged, tau_Nm=free.wave())
    found |= weights("w", w) | state(LAW + "x", x) | state(LAW + "phi", phi)
    found |= weights("v", v, first=free.numbers(7, 10))
    return Made(found, {"f_rate": f, "fj_rate": fj, "g_rate": g})


def quarter_car(seed: int) -> Made:
    """F' of the pressures P1', P2' of the strut's equations (1) to (7)."""
    from pcpc.plants.quarter_car.book.theorem import memberships

    free = Free(seed)
    k1, kap, half = 500.0, 0.7, 2.0e6
    ac, aa, co, cv, b0, b1, v0 = 5e-4, 3e-4, 2e-9, 1e-6, 8e8, 10.0, 1e-3
    x3, spool, wanted = free.wave(size=0.05), free.wave(size=3e-3), free.wave(size=3e-3)
    body, wheel = free.wave(), free.wave()
    v3, earlier = body - wheel, late(wanted)

    def bulk(pressure: Vector) -> Vector:
        return b0 + b1 * pressure

    def opened(p1: Vector, spool: float) -> Vector:
        return cv * np.sqrt(half + np.clip(spool / 1e-5, -1.0, 1.0) * (half - p1))

    def pressures(k: int, p: Vector) -> tuple[Vector]:
        dp = p[0] - p[1]
        leak, flow = co * dp / (dp**2 + 1e10) ** 0.25, opened(p[0], spool[k]) * spool[k]
        first = bulk(p[0]) / (v0 + ac * x3[k]) * (-ac * v3[k] - leak + flow)
        return (np.array([first, bulk(p[1]) / (v0 - aa * x3[k]) * (aa * v3[k] + leak)]),)

    (p,) = stepped((np.array([1.5e6, 1.1e6]),), pressures)
    desired = 500.0 * free.wave()
    ef = desired - (ac * p[:N, 0] - aa * p[:N, 1])
    known = np.array(
        [ac * bulk(p[k, 0]) / (v0 + ac * x3[k]) * opened(p[k, 0], earlier[k]) for k in range(N)]
    )
    m = memberships(x3, v3, p[:N, 0] - p[:N, 1])
    gam = 1.0 / np.abs(known * ef).max()

    def slopes(k: int, w: Vector) -> tuple[Vector]:
        return (gam * (m[k] * known[k] * ef[k] - kap * abs(known[k] * ef[k]) * w),)

    (w,) = stepped((0.005 * free.numbers(147),), slopes)
    found = under("plant:car.", strut=1.0, strut_N=desired - ef, spool_m=spool, extension_m=x3)
    found |= under("plant:car.", p1_Pa=p[:N, 0], p2_Pa=p[:N, 1])
    found |= under("plant:car.", body_rate_m_s=body, wheel_rate_m_s=wheel)
    found |= under("plant:car.h_", bore_m2=ac, annulus_m2=aa, orifice=co, valve=cv)
    found |= under("plant:car.h_", bulk_Pa=b0, bulk_slope=b1, supply_Pa=2.0 * half, volume_m3=v0)
    found |= weights("theta", w) | law(desired_N=desired, wanted_spool_m=wanted)
    found |= law(k1_per_s=k1, kap_per_m=kap)
    found |= law(lam_per_s=2.0, spool_max_m=1e-2, fl_on=1.0, exact_drift=0.0)
    return Made(found, {"gam_m2_N2": gam})


def forgotten(
    free: Free, f: Vector, width: Vector, tau_d: Vector, alpha: float, gam: float
) -> tuple[Vector, Vector, Vector, Vector]:
    """Return r, d, X and tau of (1) and (2) of plants/book/deadzone.py with Kv 0.4 and F as `f`.

    X is one of both sides; a command that does not leave its deadzone loses the width at most.
    """
    maps = len(width)
    fired = np.eye(2)[free.draw.integers(0, 2, (N, maps))]
    r, d, tau = [free.numbers(maps)], [free.numbers(maps, 2)], [free.numbers(maps)]
    for k in range(N - 1):
        lacks = np.sum(fired[k] * (width[:, None] - d[k]), axis=1)
        tau.append(tau_d[k] - lacks + width * free.draw.uniform(-1.0, 1.0, maps))
        r.append(0.4 * r[k] + f[k] + tau[k + 1] - tau_d[k])
        d.append(d[k] - alpha * fired[k] * r[k + 1][:, None] - gam * d[k])
    return np.array(r), np.array(d), fired, np.array(tau)


def deadzone_map(seed: int) -> Made:
    """r+ = Kv r + F - Fhat + tau - tau_d, from step to step."""
    free, alpha, gam, lam, c, known = Free(seed), 0.3, 0.2, 0.5, 0.9, 0.6
    x1, x2, goal, tau_d = (free.numbers(N) for _ in range(4))
    f = (known - c) * x1 / (1.0 + x2**2)
    made = forgotten(free, f[:, None], np.array([0.7]), tau_d[:, None], alpha, gam)
    r, d, fired, tau = (values[:, 0] for values in made)
    for k in range(1, N):
        goal[k] = x2[k] + lam * (x1[k] - goal[k - 1]) - r[k]
    found = under("plant:map.", c=c, d=0.7, x1=x1, x2=x2, tau=tau)
    found |= law(kv=0.4, gam=gam, lam=lam, model_c=known, tau_d=tau_d, command=1.0 + x1**2)
    for i, side in enumerate(("plus", "minus")):
        found |= law(**{f"width_{side}": d[:, i], f"fired_{side}": fired[:, i]})
    return Made(found | {"executive:reference.now": goal}, {"alpha": alpha})


def map_chains(seed: int) -> Made:
    """As deadzone_map, of two chains of two or three."""
    free, alpha, gam, lam, lam_2, order = Free(seed), 0.3, 0.2, 0.5, 0.3, 2.0 + seed // 2 % 2
    c, kappa, known_c, known_kappa = 0.9, 0.4, 0.6, 0.1
    x1, x2, x3, tau_d, previous, older = (free.numbers(N, 2) for _ in range(6))
    first = {2.0: x2, 3.0: x1}[order]
    f = ((known_c - c) * first + (kappa - known_kappa) * x3[:, ::-1]) / (1.0 + x3**2)
    r, d, fired, tau = forgotten(free, f, np.array([0.5, 0.8]), tau_d, alpha, gam)
    now = x3 + lam * (x2 - previous) + lam_2 * (x1 - older) - r
    found = law(kv=0.4, gam=gam, lam=lam, lam_2=lam_2, order=order)
    found |= law(model_c=known_c, model_coupling=known_kappa)
    found |= under("plant:chains.", c=c, coupling=kappa, order=order)
    for j, chain in enumerate("ab"):
        plant = {"x1": x1, "x2": x2, "x3": x3, "tau": tau}
        found |= under(f"plant:chains.{chain}_", gap=0.0, dead=0.5 + 0.3 * j)
        found |= under(f"plant:chains.{chain}_", **{n: v[:, j] for n, v in plant.items()})
        goals = {"now": now, "previous": previous, "older": older}
        found |= under(f"executive:reference_{chain}.", **{n: v[:, j] for n, v in goals.items()})
        found |= law(**{f"{chain}_tau_d": tau_d[:, j], f"{chain}_command": 1.0 + x1[:, j] ** 2})
        for i, side in enumerate(("plus", "minus")):
            own = {"width": d[:, j, i], "fired": fired[:, j, i]}
            found |= law(**{f"{chain}_{name}_{side}": value for name, value in own.items()})
    return Made(found, {"alpha": alpha})


WIDE = 21  # a seed of nodes that the theorem does not have, |s|^2 above 2/alpha


def backlash_map(seed: int) -> Made:
    """W by (3) of the proof; of tau (2), where play does the most it can."""
    free, alpha, gam, m, lam, kb, cr = Free(seed), 0.05, 0.3, 1.3, 0.5, 0.4, -0.2
    x1, x2, goal, foretold = (free.numbers(N) for _ in range(4))
    s, tau_d, tau = free.numbers(N, 12) / 2.0, free.numbers(N), free.numbers(N)
    s *= 4.0 if seed == WIDE else 1.0
    r = x2 - goal + lam * (x1 - late(goal))
    w = [free.numbers(12)]
    for k in range(N - 1):
        play = 0.5 * m * 0.5 * free.draw.choice((-1.0, 1.0))
        tau[k + 1] = m * (foretold[k] - kb * (tau_d[k] - tau[k]) + w[k] @ s[k]) - play
        after = tau_d[k + 1] - tau[k + 1] + cr * r[k + 1]
        off = np.eye(12) - alpha * np.outer(s[k], s[k])
        w.append(w[k] + alpha * s[k] * after - gam * np.linalg.norm(off, 2) * w[k])
    found = under("plant:map.", x1=x1, x2=x2, tau=tau, slope=m, d_plus=0.2, d_minus=-0.3, c=0.9)
    found |= law(lam=lam, kb=kb, cr=cr, kv=0.4, gamma=gam, model_c=0.9, u_max=9.0, network_on=1.0)
    found |= law(tau_d=tau_d, foretold=foretold, command=-np.abs(x1))
    found |= state(LAW + "w", np.array(w)) | state(LAW + "s", np.insert(s, 0, 0.0, axis=1))
    return Made(found | {"executive:reference.now": goal}, {"alpha": alpha})


MADE: dict[str, Callable[[int], Made]] = {
    "atb1000": barrel,
    "backlash_map": backlash_map,
    "backlash_pendulum": backlash_pendulum,
    "deadzone_arm": deadzone_arm,
    "deadzone_map": deadzone_map,
    "friction_arm": friction_arm,
    "map_chains": map_chains,
    "payload_arm": payload_arm,
    "quarter_car": quarter_car,
    "telerobot": telerobot,
}
