"""Constants and helpers of the books' proofs, against closed forms and other ways to them."""

import math
import re
from typing import Any

import numpy as np
import pytest
from made_arms import links
from made_runs import LAW, N, logistic
from made_systems import MADE
from test_proofs import SEEDS, account, made, proof_of

from pcpc.plants.deadzone_arm.book import theorem as deadzone_arm
from pcpc.plants.families.two_link.book.theory import forward_torque, motion
from pcpc.plants.friction_arm.book import theorem as friction_arm
from pcpc.plants.payload_arm.book import theorem as payload_arm
from pcpc.plants.quarter_car.book import theorem as quarter_car
from pcpc.plants.telerobot.book import theorem as telerobot
from pcpc.plants.telerobot.equations import A21, A22
from pcpc.plants.theorem import fitted_weights
from pcpc.plants.weights import Layer, Vector

each = pytest.mark.parametrize("plant", MADE)
UNMET = {
    "atb1000": {"the hub is rigid, tau turns it", "tuning rests in no cycle"},
    "deadzone_map": {"the model is exact"},
    "friction_arm": {"Z_B is above |Z*|", "what acts is what the law computes"},
    "map_chains": {"the model is exact"},
    "payload_arm": {"Mhat is M"},
    "quarter_car": {"e' = -lam e"},
    "telerobot": {"Mhat is M", "what acts is what the law computes"},
}


@each
def test_what_a_made_up_run_does_not_have_and_what_cannot_be_done_without(plant: str) -> None:
    asked = account(plant, 2).proof.asked
    assert {one.what for one in asked if not one.holds} == UNMET.get(plant, set())
    needed = re.compile("above 0$| on( in the end)?$|in use$| < ")
    for one in asked:
        assert one.needed == bool(needed.search(one.what)), one


@each
@pytest.mark.parametrize("seed", SEEDS)
def test_the_proof_is_that_of_its_inequality(plant: str, seed: int) -> None:
    """D >= K |r|^2 of (1) of lyapunov.py, and (2) at every cycle; the barrel's (2) has more."""
    one = account(plant, seed)
    proof, least = one.proof, one.proof.constants.damping * one.proof.error**2
    assert (proof.damping >= least * (1.0 - 1e-9)).all()
    for values in (
        proof.error,
        proof.rest,
        np.zeros(N - 1) if proof.extra is None else proof.extra,
    ):
        assert values.shape == (N - 1,) and (values >= 0.0).all()
    assert plant == "atb1000" or not one.failing[1:].any()


@pytest.mark.parametrize(
    ("plant", "least"),
    [("backlash_map", 0.85), ("quarter_car", 0.99), ("deadzone_map", 0.6), ("map_chains", 0.25)],
)
def test_runs_that_do_their_worst_come_near_the_constants(plant: str, least: float) -> None:
    for seed in SEEDS:
        proof = account(plant, seed).proof
        assert least < float(proof.rest[:-1].max()) / proof.constants.c0 <= 1.0 + 1e-9


def test_what_a_map_forgets_beside_its_leak_is_extra() -> None:
    proof = account("backlash_map", 2).proof
    (w,) = proof.tuned
    assert isinstance(w, Layer) and proof.extra is not None
    more = proof.terms["forgetting of the weights"] - proof.constants.kappa * w.leaked
    assert np.allclose(proof.extra, np.maximum(more, 0.0)) and (more < 0.0).any()
    assert proof.constants.extra == proof.extra.max() > 0.0


def test_maps_know_how_far_they_can_be_off() -> None:
    """0.3 is what both models are off by, 1.25 times that of the run the range."""
    one, two = made("deadzone_map", 2), made("map_chains", 2)
    far = float(np.abs(one["plant:map.x1"][1:]).max())
    assert account("deadzone_map", 2).proof.constants.c0 == pytest.approx(0.3 * 1.25 * far + 0.7)
    names = [f"plant:chains.{chain}_x{i}" for chain in "ab" for i in (1, 2, 3)]
    far = max(float(np.abs(two[name][1:]).max()) for name in names)
    found = account("map_chains", 2).proof.constants.c0
    assert found == pytest.approx(math.sqrt(2.0) * 0.6 * 1.25 * far + math.hypot(0.5, 0.8))


def test_a_barrel_whose_reference_is_smooth_loses_nothing_within_a_cycle() -> None:
    proof = account("atb1000", 2).proof
    inside = np.abs(proof.beyond["r within a cycle, jumps of the reference"])[:-1]
    rests = np.arange(1, N - 1) % 14 == 0  # where the made-up reference jumps
    assert inside[~rests].max() < 1e-4 < 1e-2 < inside[rests].max()


def test_what_stands_before_a_deadzone_undoes_it() -> None:
    run = made("deadzone_arm", 2).cycles()
    u = np.array([-1.0, -0.3, -0.1, 0.0, 0.1, 0.2, 0.5])
    assert deadzone_arm.deadzone(run, u) == pytest.approx([-0.63, 0, 0, 0, 0, 0, 0.36])
    tau = np.array([-2.0, -1e-3, 0.0, 1e-3, 2.0])
    before = deadzone_arm.added(run, tau) + tau
    assert deadzone_arm.deadzone(run, before) == pytest.approx(tau)
    assert before[1] < -0.3 and before[2] == 0.0 and before[3] > 0.2


def test_friction_is_odd_and_between_its_levels() -> None:
    run = made("friction_arm", 2).cycles()
    v = np.array([[-0.5, 0.5], [0.5, -0.5], [1e-9, 1e-9], [1e9, 1e9], [0.0, 0.0]])
    found = friction_arm.friction_torque(run, v)
    middle = 0.3 + 0.2 * math.exp(-2.5) + 0.4 * (1.0 - math.exp(-1.0))
    second = 0.6 + 0.4 * math.exp(-5.0) + 0.8 * (1.0 - math.exp(-2.0))
    wanted = [[-middle, second], [middle, -second], [0.5, 1.0], [0.7, 1.4], [0.0, 0.0]]
    assert found == pytest.approx(np.array(wanted))
    bare = made("friction_arm", 2).cycles(**{".friction_model": 0.0})
    assert not friction_arm.friction_torque(bare, v).any()


def test_jump_nodes_are_those_of_their_kind() -> None:
    ramp = 1.0 - math.exp(-0.5)
    wanted = {0.0: [0, 0, 0, 0], 1.0: [1, ramp, 0, 0], 3.0: [1, ramp, 0, 0], 4.0: [1, 0, 1, 0]}
    for kind, nodes in wanted.items():
        run = made("friction_arm", 2).cycles(**{".jump_nodes": kind})
        assert friction_arm.jump_nodes(run, np.array([[0.5, -0.5]])) == pytest.approx(
            np.array([nodes])
        )


def test_what_the_critic_leaves_of_its_damping_is_all_that_there_is() -> None:
    """D - K |r|^2 - mu (|R|^2 + |W1|^2) is a form that is never below 0, and 0 somewhere."""
    run = made("payload_arm", 2).cycles()
    least, form = [], np.empty((3, 3))
    k, mu = payload_arm.damping(run, np.array([0.9, 1.4]))
    for s in np.linspace(0.9, 1.4, 21):
        form = np.array([[5.0, -0.4, 0.0], [-0.4, s * s, 0.5 * s], [0.0, 0.5 * s, 1.1]])
        half = 0.5 * np.linalg.eigvalsh(form[1:, 1:])[0]
        least.append((half, np.linalg.eigvalsh(form - np.diag([k, half, half]))[0]))
    assert mu == pytest.approx(min(half for half, _ in least))
    assert min(one for _, one in least) == pytest.approx(0.0, abs=1e-12)
    assert payload_arm.damping(run, np.array([0.0, 0.1])) == (0.0, 0.0)


def test_the_identifiers_damping_is_against_p_which_solves_its_equation() -> None:
    system = np.array([[0.0, 1.0], [A21, A22]])
    assert np.allclose(system.T @ telerobot.P + telerobot.P @ system, -telerobot.Q)
    st = telerobot.P[:, 1]
    form = 0.5 * telerobot.Q + 4.0 * np.outer(st, st)
    ratios = [x @ form @ x / (x @ telerobot.P @ x) for x in circle(20_001)]
    assert account("telerobot", 2).proof.constants.damping == pytest.approx(min(ratios), rel=1e-6)
    assert max(x @ st / math.sqrt(x @ telerobot.P @ x) for x in circle(20_001)) == pytest.approx(
        telerobot.SCALE, rel=1e-6
    )


def circle(count: int) -> Vector:
    """Return directions, (count, 2)."""
    angle = np.linspace(0.0, np.pi, count)
    return np.stack((np.cos(angle), np.sin(angle)), axis=1)


def test_inertia_is_within_its_eigenvalues_at_both_ends_of_the_elbow() -> None:
    for plant in ("friction_arm", "deadzone_arm"):
        found = account(plant, 2).proof.constants
        ends = np.linalg.eigvalsh(links().inertia(np.array([[0.0, 0.0], [0.0, np.pi]])))
        assert (found.low, found.high) == pytest.approx((ends.min(), ends.max()))


# At rest a run is its own compact set; of one row of nodes k, W* = k f/(|k|^2 + ridge).


def fitted(nodes: Vector, f: float, ridge: float = 1e-2) -> tuple[float, float]:
    """Return |W*| and what is left of |f|."""
    square = float(nodes @ nodes)
    return f * math.sqrt(square) / (square + ridge), f * ridge / (square + ridge)


def first_row(plant: str, name: str, *shape: int) -> Vector:
    """Return the first row of a state."""
    run, count = made(plant, 2), int(np.prod(shape))
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


def test_c0_of_the_pendulum_at_rest() -> None:
    names = (".torque_Nm", ".tau_d_Nm", ".u_Nm", ".robust_Nm_s")
    rest = {**dict.fromkeys(names, 0.0), ".network_Nm_s": 1.0}
    found = proof_of("backlash_pendulum", 2, rest).constants
    v, x = first_row("backlash_pendulum", "v", 6, 10), first_row("backlash_pendulum", "x", 6)
    w, eps = fitted(np.array([1.0, *logistic(v.T @ x)]), 1.0)
    assert found.c0 == pytest.approx(eps + w * math.sqrt(10.0), rel=1e-4)
    assert found.ideal == pytest.approx(math.hypot(w, np.linalg.norm(v)), rel=1e-4)
    far = (np.linalg.norm(v.T @ x) + w * np.linalg.norm(x)) / 4.0
    assert found.c1 == pytest.approx(far, rel=1e-4)


def test_c0_of_the_barrel_at_rest() -> None:
    names = (".theta_rad", ".theta_rate_rad_s", ".q_d_rad", ".q_d_rate_rad_s", ".q_d_acc_rad_s2")
    still = {**dict.fromkeys(names, 0.0), **{f"controller.w_{i}": 0.0 for i in range(15)}}
    found = proof_of("atb1000", 2, {**still, "controller.w_0": 1.0}).constants  # y is 1
    v, x = first_row("atb1000", "v", 7, 10), first_row("atb1000", "x", 7)
    far = first_row("atb1000", "phi", 15)[11:]
    w, eps = fitted(np.array([1.0, *logistic(v.T @ x), *far]), 1.0)
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


def falling(mass: float) -> Vector:
    """Return q'' of an arm at rest that nothing holds, (2,)."""
    arm = links(np.array([mass]))
    return -np.linalg.solve(arm.inertia(Q)[0], arm.gravity(Q)[0])


@pytest.mark.parametrize("mass", [0.8, 1.2])
def test_c0_of_the_critic_at_rest(mass: float) -> None:
    held = {
        f".{name}_{j}_{unit}": 0.0
        for j in (1, 2)
        for name, unit in (("acting", "Nm"), ("robust", "rad_s2"), ("learned", "rad_s2"))
    }
    own = {**STILL, **AT_GOAL, **held, ".outer_mass_kg": mass, ".kz": 0.1}
    proof = proof_of("payload_arm", 2, own)
    x = np.array([1.0, 0, 0, 0, 0, 0.4, 0.8, 0, 0, 0, 0])
    s2 = logistic(first_row("payload_arm", "v2", 11, 10).T @ x)
    _, left = fitted(s2, 1.0)
    f, plain = -falling(mass), -falling(0.8)
    eps = np.linalg.norm(plain - f * (1.0 - left)) + np.linalg.norm(f - plain)
    assert proof.constants.c0 == pytest.approx(max(float(eps) - 0.1, 0.0), rel=1e-9)
    sway = np.linalg.norm([made("payload_arm", 2)[f"{LAW}sc_{i}"][1:] for i in (0, 1)], axis=0)
    assert proof.constants.extra == pytest.approx(0.02 + sway.max() * proof.constants.c0)
    unhelped = max(float(np.linalg.norm(f)) * left - 0.1, 0.0)
    assert proof.rest == pytest.approx(unhelped) and proof.extra == pytest.approx(
        0.02 + sway * unhelped
    )


@pytest.mark.parametrize("mass", [0.8, 1.2])
def test_c0_of_the_identifier_at_rest(mass: float) -> None:
    held = {f".{name}_{j}_Nm": 0.0 for j in (1, 2) for name in ("acting", "torque")}
    found = proof_of("telerobot", 2, {**STILL, **held, ".mass_kg": mass}).constants
    run = made("telerobot", 2)
    v = np.array([run[f"local:servo.v_{i}"][0] for i in range(100)]).reshape(5, 20)
    _, left = fitted(np.tanh(np.array([1.0, 0.4, 0.8, 0.0, 0.0]) @ v), 1.0)
    f, plain = falling(mass), falling(0.8)
    eps = np.linalg.norm(plain - f * (1.0 - left)) + np.linalg.norm(f - plain)
    assert found.c0 == pytest.approx(math.sqrt(2.0) * float(eps), rel=1e-9)


def test_c0_of_the_strut_at_rest() -> None:
    """The spool is wanted on either side in turn: what Gh is beyond its least is surplus."""
    wanted = np.where(np.arange(N) % 2 == 0, 3e-3, -3e-3)
    theta = {f"controller.theta_{i}": 0.0 for i in range(147)}
    still = {".extension_m": 0.01, ".body_rate_m_s": 0.3, ".wheel_rate_m_s": 0.1, ".spool_m": 2e-3}
    pressed = {".p1_Pa": 1.5e6, ".p2_Pa": 1.1e6, ".desired_N": 400.0, ".strut_N": 400.0}
    found = proof_of("quarter_car", 2, {**theta, **still, **pressed, ".wanted_spool_m": wanted})
    leak = 2e-9 * 4e5 / ((4e5) ** 2 + 1e10) ** 0.25
    first, second = 8.15e8 / (1e-3 + 5e-6), 8.11e8 / (1e-3 - 3e-6)
    drift = 5e-4 * first * (-5e-4 * 0.2 - leak) - 3e-4 * second * (3e-4 * 0.2 + leak)
    gain, other = (5e-4 * first * 1e-6 * math.sqrt(p) for p in (2.5e6, 1.5e6))
    m = quarter_car.memberships(*(np.array([one]) for one in (0.01, 0.2, 4e5)))[0]
    w, left = fitted(m, abs(drift) / gain, 1e-4)
    off = max(abs(drift * (known / gain - 1.0) - gain * 2e-3) for known in (gain, other))
    surplus = 0.7 * abs(gain - other)
    constants = found.constants
    assert constants.kappa == pytest.approx(0.7 * min(gain, other))
    assert constants.c0 == pytest.approx(gain * left + off + surplus * w**2 / 4.0, rel=1e-6)
    assert found.asked[3].what == "e' = -lam e" and not found.asked[3].holds


def test_the_spool_is_on_its_way_as_the_law_wants_it_or_not() -> None:
    t = made("quarter_car", 2).t_s
    still = {".spool_m": 0.0, ".lam_per_s": 2e4}
    for rate, holds in ((2e4, True), (2.1e4, False), (-2e4, False)):
        wanted = 1e-3 * np.exp(-rate * t)
        (one,) = (
            one
            for one in proof_of("quarter_car", 2, {**still, ".wanted_spool_m": wanted}).asked
            if one.what == "e' = -lam e"
        )
        assert one.holds == holds, one


def test_the_rate_of_the_rules_is_what_the_rig_gives_over_the_struts_gain() -> None:
    """G = Ac B/V0 Cv sqrt(P0), V0 = B Ar^2/(2 K): the bulk modulus goes out."""
    sizes = {"ac_m2": 5e-4, "ar_m2": 1.5e-4, "ao_m2": 1e-5, "liquid_rate_N_m": 16000.0}
    oil = {"fluid_kg_m3": 800.0, "discharge": 0.6, "bulk_Pa": 8e8, "bulk_slope": 10.0}
    own = {"port_width_m": 0.02, "mass_kg": 300.0, "gravity_m_s2": 9.0, "adaptation_rad_s": 30.0}
    jet, p0 = 0.6 * 0.02 * math.sqrt(2.0 / 800.0), 2700.0 / 1.5e-4
    gain = 5e-4 * 2.0 * 16000.0 / 1.5e-4**2 * jet * math.sqrt(p0)
    found = quarter_car.declared_rate({**sizes, **oil, **own})
    assert found == pytest.approx((30.0 / gain) ** 2)


def test_constants_of_the_arm_behind_deadzones_joint_by_joint() -> None:
    proof, run = account("deadzone_arm", 2).proof, made("deadzone_arm", 2)
    drawn = {n: first_row("deadzone_arm", n, 2, 40)[:, :3] for n in ("v", "v0", "vi", "v0i")}
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
