"""Constants of the books' proofs that have closed forms, as those of runs at rest.

At rest a run is its own compact set; of one row of nodes k, W* = k f/(|k|^2 + ridge).
"""

import math
from typing import Any

import numpy as np
import pytest
from made_arms import links
from made_runs import LAW, N, logistic
from test_proofs import SEEDS, account, made, proof_of

from pcpc.plants.deadzone_arm.book import theorem as deadzone_arm
from pcpc.plants.families.two_link.book.theory import drawn_states, forward_torque, motion
from pcpc.plants.friction_arm.book import theorem as friction_arm
from pcpc.plants.quarter_car.book import theorem as quarter_car
from pcpc.plants.theorem import fitted_weights
from pcpc.plants.weights import Vector


def fitted(nodes: Vector, f: float, ridge: float = 1e-2) -> tuple[float, float]:
    """Return |W*| and what is left of |f|."""
    square = float(nodes @ nodes)
    return f * math.sqrt(square) / (square + ridge), f * ridge / (square + ridge)


def first_row(plant: str, name: str, *shape: int, seed: int = 2) -> Vector:
    """Return the first row of a state."""
    run, count = made(plant, seed), int(np.prod(shape))
    return np.array([run[f"{LAW}{name}_{i}"][0] for i in range(count)]).reshape(shape)


STILL: dict[str, Any] = {
    f".{name}_{j}_{unit}": value
    for j in (1, 2)
    for name, unit, value in (
        ("q", "rad", 0.4 * j),
        ("rate", "rad_s", 0.0),
    )
}
AT_GOAL = {
    f"reference_{j}.{name}": value
    for j in (1, 2)
    for name, value in (("q_d_rad", 0.4 * j), ("q_d_rate_rad_s", 0.0), ("q_d_acc_rad_s2", 0.0))
}
Q = np.array([[0.4, 0.8]])


def in_turn(last: float) -> Vector:
    """Return 1 and -3 in turn, and a last value, which has no next and does not count."""
    return np.append(np.where(np.arange(N - 1) % 2 == 0, 1.0, -3.0), last)


def test_c0_of_the_pendulum_at_rest() -> None:
    names = (".torque_Nm", ".tau_d_Nm", ".u_Nm", ".robust_Nm_s")
    rest = {**dict.fromkeys(names, 0.0), ".network_Nm_s": in_turn(1e3)}
    found = proof_of("backlash_pendulum", 2, rest).constants
    v, x = first_row("backlash_pendulum", "v", 6, 10), first_row("backlash_pendulum", "x", 6)
    w, left = fitted(np.array([1.0, *logistic(v.T @ x)]), 1.0)
    eps = 3.0 - (1.0 - left)  # of a mean of -1
    assert found.c0 == pytest.approx(eps + w * math.sqrt(10.0), rel=1e-4)
    assert found.ideal == pytest.approx(math.hypot(w, np.linalg.norm(v)), rel=1e-4)
    far = (np.linalg.norm(v.T @ x) + w * np.linalg.norm(x)) / 4.0
    assert found.c1 == pytest.approx(far, rel=1e-4)
    off = proof_of("backlash_pendulum", 2, {".robust_on": 0.0}).constants
    assert off.damping == pytest.approx(4.0 - 0.1)


@pytest.mark.parametrize(("row", "holds"), [(50, False), (N - 1, True)])
def test_a_command_that_does_not_act_is_found_in_one_cycle_but_the_last(
    row: int, holds: bool
) -> None:
    command = made("backlash_pendulum", 2)[f"{LAW}u_Nm"] - 1.0 * (np.arange(N) == row)
    asked = proof_of("backlash_pendulum", 2, {".command_Nm": command}).asked
    assert next(one for one in asked if one.what == "what acts is u").holds == holds


def test_c0_of_the_barrel_at_rest() -> None:
    names = (".theta_rad", ".theta_rate_rad_s", ".q_d_rad", ".q_d_rate_rad_s", ".q_d_acc_rad_s2")
    still = {**dict.fromkeys(names, 0.0), **{f"controller.w_{i}": 0.0 for i in range(15)}}
    found = proof_of("atb1000", 2, {**still, "controller.w_0": in_turn(0.0)}).constants  # y
    v, x = first_row("atb1000", "v", 7, 10), first_row("atb1000", "x", 7)
    far = first_row("atb1000", "phi", 15)[11:]
    w, left = fitted(np.array([1.0, *logistic(v.T @ x), *far]), 1.0)
    eps = 3.0 - (1.0 - left)
    assert found.c0 == pytest.approx(eps + w * math.sqrt(10.0), rel=1e-4)


def test_c0_of_the_arm_with_friction_at_rest() -> None:
    nodes = {".friction_1_Nm": 0.0, ".friction_2_Nm": 0.0, ".jump_nodes": 4.0}
    phi = {f"controller.phi_{i}": 1.0 - i % 2 for i in range(4)}
    found = proof_of("friction_arm", 2, {**STILL, **AT_GOAL, **nodes, **phi}).constants
    v = first_row("friction_arm", "v", 11, 16)[:, :3]
    x = np.array([1.0, 0, 0, 0, 0, 0.4, 0.8, 0, 0, 0, 0])
    k = np.array([1.0, *logistic(v.T @ x), 1.0, 0.0, 1.0, 0.0])
    w, eps = fitted(k, float(np.linalg.norm(links().gravity(Q))))
    assert found.c0 == pytest.approx(eps + w * math.sqrt(3.0), rel=1e-6)
    weightless = {".m1_kg": 1e-12, ".m2_kg": 1e-12, ".friction_1_Nm": 0.0, ".friction_2_Nm": 0.0}
    level = {f".{name}_{j}_Nm": 0.0 for name in ("stiction", "viscous") for j in (1, 2)}
    found = proof_of("friction_arm", 2, {**weightless, **level}).constants
    assert found.c0 == pytest.approx(math.hypot(0.3, 0.6), rel=1e-6)
    far = drawn_states(motion(made("friction_arm", 2).cycles(), np.array([2.0, 3.0]))).inputs
    assert found.c1 == pytest.approx(np.linalg.norm(far @ v, axis=1).max() / 4.0)


def test_a_standard_network_has_no_jump_nodes_to_tune() -> None:
    tuned = proof_of("friction_arm", 2, {".jump_nodes": 0.0}).tuned
    assert [one.name for one in tuned] == ["S", "T"]


def test_eps_of_the_arm_with_friction_is_looked_for_where_it_may_go() -> None:
    """Of a run whose friction undoes all else, so that W* is 0."""
    run, arm = made("friction_arm", 2), links()
    one = motion(run.cycles(), np.array([2.0, 3.0]))
    far = drawn_states(one)
    own, wide = (forward_torque(arm, each) + arm.gravity(each.q) for each in (one, far))
    undone = {f".friction_{j + 1}_Nm": -np.append([0.0, 0.0], own[:-1, j]) for j in (0, 1)}
    proof = proof_of("friction_arm", 2, undone)
    eps = np.linalg.norm(wide + friction_arm.friction_torque(run.cycles(), far.v), axis=1).max()
    fit = sum(float(np.sum(layer.ideal**2)) for layer in proof.tuned if layer.name != "T")
    assert fit < 1e-3 and proof.constants.c0 == pytest.approx(float(eps), rel=3e-3)


def test_what_is_asked_for_and_acts_is_no_part_of_w() -> None:
    run = made("friction_arm", 2)
    more = {
        f".{n}_{j}_Nm": 100.0 + run[f"{at}{n}_{j}_Nm"] for j in (1, 2) for n, at in BOTH.items()
    }
    assert proof_of("friction_arm", 2, more).rest == pytest.approx(
        account("friction_arm", 2).proof.rest
    )


BOTH = {"torque": LAW, "acting": "plant:arm."}


def falling(mass: float) -> Vector:
    """Return q'' of an arm at rest that nothing holds, (2,)."""
    arm = links(np.array([mass]))
    return -np.linalg.solve(arm.inertia(Q)[0], arm.gravity(Q)[0])


MASSES = pytest.mark.parametrize("masses", [(0.8, 0.8), (1.2, 1.2), (0.8, 1.2)])  # in turn


@MASSES
def test_c0_of_the_critic_at_rest(masses: tuple[float, float]) -> None:
    units = {"acting": "Nm", "robust": "rad_s2", "learned": "rad_s2"}
    held = {f".{name}_{j}_{unit}": 0.0 for j in (1, 2) for name, unit in units.items()}
    mass = np.where(np.arange(N) % 2 == 0, *masses)
    own = {**STILL, **AT_GOAL, **held, ".outer_mass_kg": mass, ".kz": 0.01}
    proof = proof_of("payload_arm", 2, own)
    x = np.array([1.0, 0, 0, 0, 0, 0.4, 0.8, 0, 0, 0, 0])
    _, left = fitted(logistic(first_row("payload_arm", "v2", 11, 10).T @ x), 1.0)
    f, plain = [-falling(one) for one in masses], -falling(0.8)
    eps = np.linalg.norm(plain - (f[0] + f[1]) / 2.0 * (1.0 - left))
    payload = max(np.linalg.norm(one - plain) for one in f)
    assert proof.constants.c0 == pytest.approx(float(eps + payload) - 0.01, rel=0.01)
    sway = np.linalg.norm([made("payload_arm", 2)[f"{LAW}sc_{i}"][1:] for i in (0, 1)], axis=0)
    assert proof.constants.extra == pytest.approx(0.002 + sway.max() * proof.constants.c0)
    if masses[0] == masses[1]:
        unhelped = float(np.linalg.norm(f[0])) * left - 0.01
        assert proof.rest == pytest.approx(unhelped)
        assert proof.extra == pytest.approx(0.002 + sway * unhelped)


def test_w_of_one_cycle_is_above_kz() -> None:
    learned = np.where(np.arange(N) == 50, -5.0, 0.0)
    own = {**STILL, **AT_GOAL, ".robust_1_rad_s2": 0.0, ".learned_1_rad_s2": learned}
    held = {f".{name}": 0.0 for name in ("acting_1_Nm", "acting_2_Nm", "learned_2_rad_s2")}
    proof = proof_of("payload_arm", 2, {**own, **held, ".robust_2_rad_s2": 0.0})
    one = next(one for one in proof.asked if one.what == "kz is above |w|")
    assert not one.holds and 4.8 < float(one.found.rpartition(" ")[2]) < 5.2, one.found


@MASSES
def test_c0_of_the_identifier_at_rest(masses: tuple[float, float]) -> None:
    held = {f".{name}_{j}_Nm": 0.0 for j in (1, 2) for name in ("acting", "torque")}
    mass = np.where(np.arange(N) % 2 == 0, *masses)
    found = proof_of("telerobot", 2, {**STILL, **held, ".mass_kg": mass}).constants
    run = made("telerobot", 2)
    v = np.array([run[f"local:servo.v_{i}"][0] for i in range(100)]).reshape(5, 20)
    _, left = fitted(np.tanh(np.array([1.0, 0.4, 0.8, 0.0, 0.0]) @ v), 1.0)
    f, plain = [falling(one) for one in masses], falling(0.8)
    eps = np.linalg.norm(plain - (f[0] + f[1]) / 2.0 * (1.0 - left))
    payload = max(np.linalg.norm(one - plain) for one in f)
    assert found.c0 == pytest.approx(math.sqrt(2.0) * float(eps + payload), rel=0.01)


@pytest.mark.parametrize(("share", "v3"), [(0.0, 0.2), (0.5, 0.2), (2.0, 0.2), (0.5, -0.2)])
def test_c0_of_the_strut_at_rest(share: float, v3: float) -> None:
    """The spool is wanted on either side in turn: what Gh is beyond its least is surplus.

    `share`: of what the rules are to say, that they say.
    """
    wanted = np.where(np.arange(N) % 2 == 0, 3e-3, -3e-3)
    leak = 2e-9 * 4e5 / ((4e5) ** 2 + 1e10) ** 0.25
    first, second = 8.15e8 / (1e-3 + 5e-6), 8.11e8 / (1e-3 - 3e-6)
    drift = 5e-4 * first * (-5e-4 * v3 - leak) - 3e-4 * second * (3e-4 * v3 + leak)
    gain, other = (5e-4 * first * 1e-6 * math.sqrt(p) for p in (2.5e6, 1.5e6))
    m = quarter_car.memberships(*(np.array([one]) for one in (0.01, v3, 4e5)))[0]
    says = share * -drift / gain
    theta = {f"controller.theta_{i}": says * one / (m @ m) for i, one in enumerate(m)}
    still = {
        ".extension_m": 0.01,
        ".body_rate_m_s": 0.1 + v3,
        ".wheel_rate_m_s": 0.1,
        ".spool_m": 2e-3,
    }
    pressed = {".p1_Pa": 1.5e6, ".p2_Pa": 1.1e6, ".desired_N": 400.0, ".strut_N": 400.0}
    proof = proof_of("quarter_car", 2, {**theta, **still, **pressed, ".wanted_spool_m": wanted})
    w, left = fitted(m, -drift / gain, 1e-4)
    missing = -drift / gain - left - says
    apart = [-drift - gain * 2e-3 - known * missing for known in (gain, other)]
    off = max(abs(a - known * left) for a, known in zip(apart, (gain, other), strict=True))
    surplus, leaks = 0.7 * abs(gain - other), max(missing * says / (m @ m), 0.0)
    constants = proof.constants
    assert constants.kappa == pytest.approx(0.7 * min(gain, other))
    assert constants.c0 == pytest.approx(abs(gain * left) + off + surplus * w**2 / 4.0)
    rest = (abs(apart[0]) + surplus * leaks, abs(apart[1]))  # Gh of the cycle before
    assert proof.rest[:2] == pytest.approx(rest) and proof.rest[2] == proof.rest[0]


def test_the_spool_is_on_its_way_as_the_law_wants_it_or_not() -> None:
    t = made("quarter_car", 2).t_s
    still = {".spool_m": 1e-3, ".lam_per_s": 2e4}
    for rate, holds in ((2e4, True), (2.1e4, False), (-2e4, False)):
        wanted = 1e-3 + 1e-3 * np.exp(-rate * t)
        asked = proof_of("quarter_car", 2, {**still, ".wanted_spool_m": wanted}).asked
        assert next(one for one in asked if one.what == "e' = -lam e").holds == holds


def test_the_rate_of_the_rules_is_what_the_rig_gives_over_the_struts_gain() -> None:
    """G = Ac B/V0 Cv sqrt(P0), V0 = B Ar^2/(2 K): the bulk modulus goes out."""
    sizes = {"ac_m2": 5e-4, "ar_m2": 1.5e-4, "ao_m2": 1e-5, "liquid_rate_N_m": 16000.0}
    oil = {"fluid_kg_m3": 800.0, "discharge": 0.6, "bulk_Pa": 8e8, "bulk_slope": 10.0}
    own = {"port_width_m": 0.02, "mass_kg": 300.0, "gravity_m_s2": 9.0, "adaptation_rad_s": 30.0}
    jet, p0 = 0.6 * 0.02 * math.sqrt(2.0 / 800.0), 2700.0 / 1.5e-4
    gain = 5e-4 * 2.0 * 16000.0 / 1.5e-4**2 * jet * math.sqrt(p0)
    found = quarter_car.declared_rate({**sizes, **oil, **own})
    assert found == pytest.approx((30.0 / gain) ** 2)


@pytest.mark.parametrize("seed", SEEDS)
def test_constants_of_the_arm_behind_deadzones_joint_by_joint(seed: int) -> None:
    proof, run = account("deadzone_arm", seed).proof, made("deadzone_arm", seed)
    drawn = {
        n: first_row("deadzone_arm", n, 2, 40, seed=seed)[:, :3] for n in ("v", "v0", "vi", "v0i")
    }
    one = motion(run.cycles(), np.array([2.0, 2.0]))
    w_d = forward_torque(links(g=0.0), one) + 5.0 * one.r
    eps, most, sizes = [], [], [0.0, 0.0]
    for j in range(2):
        v, v0, vi, v0i = (drawn[name][j] for name in ("v", "v0", "vi", "v0i"))
        u = sum(run[f"{LAW}{name}_{j + 1}_Nm"][1:] for name in ("tau_d", "y"))

        def behind(u: Vector) -> Vector:
            return np.where(u > 0.2, 1.2 * (u - 0.2), np.where(u < -0.3, 0.9 * (u + 0.3), 0.0))

        def before(t: Vector) -> Vector:
            return np.where(t > 0.0, t / 1.2 + 0.2, np.where(t < 0.0, t / 0.9 - 0.3, 0.0))

        def observer(u: Vector, v: Vector = v, v0: Vector = v0) -> Vector:
            return logistic(np.multiply.outer(u, v) + v0)

        def compensator(t: Vector, v: Vector = vi, v0: Vector = v0i) -> Vector:
            ahead = (t >= 0.0) * 1.0
            jumps = np.stack((ahead, ahead * (1.0 - np.exp(-np.abs(t)))), axis=1)
            return np.concatenate((logistic(np.multiply.outer(t, v) + v0), jumps), axis=1)

        w = fitted_weights(observer(u), behind(u))
        wi = fitted_weights(compensator(w_d[:, j]), before(w_d[:, j]) - w_d[:, j])
        far, wide = (1.25 * np.abs(x).max() * np.linspace(-1, 1, 4001) for x in (u, w_d[:, j]))
        undone = behind(wide + compensator(wide) @ wi) - wide
        eps.append(np.abs(behind(far) - observer(far) @ w).max() + np.abs(undone).max())
        most.append(np.abs(before(wide) - wide).max())
        sizes = [a + float(np.sum(b**2)) for a, b in zip(sizes, (w, wi), strict=True)]
    size, size_i = np.sqrt(sizes)
    found, spread = proof.constants, max(np.linalg.norm(drawn["v"], axis=1))
    assert found.ideal == pytest.approx(math.hypot(size, size_i))
    c0 = np.linalg.norm(eps) + size * math.sqrt(3.0) + 0.2 * size_i**3
    assert found.c0 == pytest.approx(float(c0))
    assert found.c1 == pytest.approx(float(spread * (max(most) + size * math.sqrt(5.0)) / 4.0))


@pytest.mark.parametrize("share", [0.1, 2.0])
def test_where_it_drives_the_second_leak_counts_to_w(share: float) -> None:
    """Wi~'Wi is share (1 - share) |Wi*|^2."""
    ideal = account("deadzone_arm", 2).proof.tuned[0].ideal
    rows = {
        f"controller.wi_{42 * j + i + 37 * (i > 2)}": share * w
        for (j, i), w in np.ndenumerate(ideal)
    }
    proof, without = (proof_of("deadzone_arm", 2, {**rows, ".k2": k2}) for k2 in (0.4, 0.0))
    size = float(np.linalg.norm(ideal))
    found = 0.4 * share * size * max(share * (1.0 - share), 0.0) * size**2
    assert proof.rest == pytest.approx(without.rest + found)


def test_jumps_of_the_compensator_are_on_its_right_side_alone() -> None:
    run, one = made("deadzone_arm", 2).cycles(), np.ones(3)
    joint = deadzone_arm.Joint(run, one, one, one, one, one, one)
    found = joint.compensator(np.array([-2.0, 0.0, 0.5]))[:, 3:]
    assert found == pytest.approx(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0 - math.exp(-0.5)]]))
