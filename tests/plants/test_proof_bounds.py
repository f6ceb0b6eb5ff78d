"""Constants and helpers of the books' proofs, against closed forms and other ways to them."""

import math
import re
from typing import Any

import numpy as np
import pytest
from made_arms import links
from made_runs import LAW, N
from made_systems import MADE
from test_proofs import SEEDS, account, made, proof_of

from pcpc.plants.deadzone_arm.book import theorem as deadzone_arm
from pcpc.plants.families.two_link.book.theory import drawn_states, inertia_known, motion
from pcpc.plants.friction_arm.book import theorem as friction_arm
from pcpc.plants.payload_arm.book import theorem as payload_arm
from pcpc.plants.telerobot.book import theorem as telerobot
from pcpc.plants.telerobot.equations import A21, A22
from pcpc.plants.theorem import NoTheorem
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


@pytest.mark.parametrize("x1", [None, -9.0])
def test_maps_know_how_far_they_can_be_off(x1: float | None) -> None:
    """0.3 is what both models are off by, 1.25 times that of the run the range."""
    one, two = made("deadzone_map", 2), made("map_chains", 2)
    far = float(np.abs(one["plant:map.x1"][1:]).max()) if x1 is None else 9.0
    found = proof_of("deadzone_map", 2, {} if x1 is None else {".x1": x1}).constants.c0
    assert found == pytest.approx(0.3 * 1.25 * far + 0.7)
    names = [f"plant:chains.{chain}_x{i}" for chain in "ab" for i in (1, 2, 3)]
    far = max(float(np.abs(two[name][1:]).max()) for name in names) if x1 is None else 9.0
    found = proof_of("map_chains", 2, {} if x1 is None else {".b_x1": x1}).constants.c0
    assert found == pytest.approx(math.sqrt(2.0) * 0.6 * 1.25 * far + math.hypot(0.5, 0.8))


@pytest.mark.parametrize("r", [1.0, 1.2, -1.0, -1.2])
def test_the_error_of_a_map_is_below_that_of_its_sum(r: float) -> None:
    """Of a run in which all rests: 0.9/(1 - |0.4 - 0.2|) is 1.125."""
    still = {".now": 0.0, ".x1": 0.0, ".tau_d": 0.0, ".x2": r}
    asked = proof_of(
        "backlash_map", 2, {**still, "map.tau": -math.copysign(0.9, r) - 0.2 * r}
    ).asked
    (found,) = (one for one in asked if one.what.startswith("|r| <="))
    assert found.holds == (abs(r) < 1.125) and found.found.endswith("of 1.12"), found


@pytest.mark.parametrize(
    ("plant", "changed"),
    [
        ("map_chains", {".a_gap": 0.1}),
        ("map_chains", {".b_gap": 0.1}),
        ("quarter_car", {".strut": 0.0}),
        ("telerobot", {".local_law": 2.0}),
    ],
)
def test_another_system_or_law_has_no_theorem(plant: str, changed: dict[str, Any]) -> None:
    with pytest.raises(NoTheorem):
        proof_of(plant, 2, changed)


@pytest.mark.parametrize(
    ("plant", "name", "field", "place"),
    [
        *((p, ".acting_2_Nm", "rest", 48) for p in ("deadzone_arm", "payload_arm", "telerobot")),
        ("friction_arm", ".acting_2_Nm", "rest", 48),
        ("friction_arm", ".friction_2_Nm", "rest", 48),
        ("payload_arm", ".outer_mass_kg", "rest", 48),
        ("telerobot", ".mass_kg", "rest", 48),
        ("payload_arm", ".s1_3", "damping", 49),
        ("payload_arm", ".w1_3", "v", 50),
        ("payload_arm", ".w2_3", "v", 50),
        ("quarter_car", ".wanted_spool_m", "rest", 50),
        ("quarter_car", ".theta_3", "v", 50),
        ("telerobot", "servo.w_3", "v", 50),
    ],
)
def test_what_a_record_tells_belongs_to_its_cycle(
    plant: str, name: str, field: str, place: int
) -> None:
    """A proof begins with row 1. What acts is told by the next row, weights used by the last."""
    own = next(values for one, values in made(plant, 2).columns.items() if one.endswith(name))
    hit = {name: np.where(np.arange(N) == 50, 1e3, own)}
    if name == ".wanted_spool_m":  # Gh alone: a spool on its other side
        hit = {name: np.where(np.arange(N) == 50, -own, own), ".spool_m": own}
    values = getattr(proof_of(plant, 2, {**QUIET.get(plant, {}), **hit}), field)
    assert int(np.argmax(np.abs(values - np.median(values)))) == place


QUIET = {"payload_arm": {".kz": 0.0}}


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


def test_the_critic_counts_what_it_adds_to_the_error() -> None:
    proof, run = account("payload_arm", 2).proof, made("payload_arm", 2)
    r = motion(run.cycles(), np.array([2.0, 2.0])).r
    sc = np.stack([run[f"{LAW}sc_{i}"][1:] for i in (0, 1)], axis=1)
    sway = float(np.linalg.norm(sc - r, axis=1).max())
    assert proof.constants.extra == pytest.approx(0.7 * 0.2 + sway * proof.constants.c0)
    s1 = np.array([run[f"{LAW}s1_{i}"][1:] for i in range(10)])
    _, mu = payload_arm.damping(run.cycles(), np.linalg.norm(s1, axis=0))
    assert proof.constants.other_rate == mu < np.inf


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


def test_states_are_drawn_from_where_the_error_may_go() -> None:
    """|r| up to 1.25 times the run's, |e| up to that over Lam; r = e' + Lam e."""
    lam = np.array([2.0, 3.0])
    one = motion(made("friction_arm", 2).cycles(), lam)
    far, reach = drawn_states(one), 1.25 * float(np.linalg.norm(one.r, axis=1).max())
    size, e = np.linalg.norm(far.r, axis=1), far.q_d - far.q
    assert 0.99 * reach < size.max() <= reach * (1.0 + 1e-9)
    assert np.mean(size < reach / 2.0) == pytest.approx(0.25, abs=0.05), "even over the disc"
    assert (np.abs(e) <= reach / lam).all() and (np.abs(e).max(axis=0) > 0.99 * reach / lam).all()
    known = {tuple(row) for row in np.concatenate((one.q_d, one.rate_d, one.acc_d), axis=1)}
    assert {tuple(row) for row in np.concatenate((far.q_d, far.rate_d, far.acc_d), axis=1)} <= known


def test_one_entry_of_an_inertia_is_enough_to_differ() -> None:
    true = links().inertia(np.zeros((3, 2)))
    off = true.copy()
    off[1, 0, 1] += 1e-3
    assert inertia_known(true, true).holds and not inertia_known(off, true).holds
    heavy = links(np.array([0.8, 1.2, 0.5])).inertia_range()
    assert heavy == links(np.array([1.2])).inertia_range()
