"""Each plant's theorem on runs of its rigs: it holds, and a law that is not the theorem's does not.

Seeds are none of those that any rig, study or page names.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pcpc.executive.log.reader import NodeLog
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.judging import Run
from pcpc.plants.lyapunov import UNEXPLAINED, Account, Check
from pcpc.plants.theorem import Cycles
from pcpc.tools.study.bounds import observed
from pcpc.tools.study.bounds.book._retuned import retuned_rig
from pcpc.tools.study.bounds.bounds import of_rig, theorem_of

PLANTS = Path(__file__).resolve().parents[2] / "plants"


@dataclass(frozen=True)
class Case:
    """A rig with a network, and settings of an unlisted draw."""

    rig: str  # below plants
    controller: str
    given: tuple[str, ...] = ()
    sampled: bool = True  # of a law in continuous time

    def account(self, factor: float = 1.0, *only: str, given: tuple[str, ...] = ()) -> Account:
        """Return the account with all tuning rates, or those of `only`, times `factor`."""
        plant, name = self.rig.split("/")
        path = PLANTS / plant / "rigs" / f"{name}.yaml"
        rig = load_rig(path, self.controller, (*self.given, *given))
        theorem = theorem_of(rig)
        with np.errstate(over="ignore", invalid="ignore"):
            some = replace(theorem, rates=only or theorem.rates)
            return of_rig(retuned_rig(rig, some, factor)).account

    @property
    def rates(self) -> tuple[str, ...]:
        """The tuning rates of the law."""
        plant, name = self.rig.split("/")
        rig = load_rig(PLANTS / plant / "rigs" / f"{name}.yaml", self.controller)
        return tuple(theorem_of(rig).rates)


SEED = "controller.network_seed=4711.0"
CASES = {
    "atb1000": Case("atb1000/lowspeed", "pd_nn_fast", (SEED, "duration_s=6.0")),
    "backlash_map": Case(
        "backlash_map/backlash-map",
        "nn",
        (SEED, "map.d_plus=0.13", "duration_s=6.0"),
        sampled=False,
    ),
    "backlash_pendulum": Case(
        "backlash_pendulum/backlash-pendulum", "nn", (SEED, "duration_s=6.0")
    ),
    "friction_arm": Case("friction_arm/friction-c", "nn_ramp", (SEED, "duration_s=6.0")),
    "deadzone_arm": Case(
        "deadzone_arm/deadzone-sine", "nn", (SEED, "duration_s=3.0", "rate_hz=2000.0")
    ),
    "deadzone_map": Case("deadzone_map/fuzzy-d03", "fuzzy", ("map.d=0.217",), sampled=False),
    "map_chains": Case("map_chains/two-deadzones", "fuzzy", ("chains.a_dead=0.17",), sampled=False),
    "payload_arm": Case("payload_arm/payload-on", "critic", (SEED, "duration_s=6.0")),
    "quarter_car": Case(
        "quarter_car/suspension-8", "fl", ("car.road_rad_s=21.0", "duration_s=2.5")
    ),
    "telerobot": Case(
        "telerobot/telerobot-u1", "rnn", ("servo.network_seed=4711.0", "duration_s=5.0")
    ),
}
each = pytest.mark.parametrize("case", CASES.values(), ids=list(CASES))


def test_forgetting_that_is_large_is_explained_as_well() -> None:
    """As shipped it is 1e-5, and nothing of (5) that goes with it is seen."""
    account = CASES["backlash_map"].account(given=("controller.gamma=0.1",))
    assert account.holds and account.unexplained < 1e-8, account.unexplained


def violated(account: Account) -> list[Check]:
    """Return the checks that do not hold."""
    return [check for check in account.checks() if not check.holds]


@each
def test_the_theorem_holds_on_an_unlisted_draw(case: Case) -> None:
    account = case.account()
    assert account.holds, violated(account)
    assert (account.proof.v >= 0.0).all(), account.proof.v.min()
    assert 0.0 < account.unexplained < (0.05 if case.sampled else 1e-5), account.unexplained


@each
@pytest.mark.parametrize("factor", [0.0, -1.0, 100.0])
def test_dead_flipped_and_hasty_tuning_violate_it(case: Case, factor: float) -> None:
    account = case.account(factor)
    names = [check.name for check in violated(account)]
    assert "V follows its identity" in names, account.unexplained


@each
@pytest.mark.parametrize("factor", [0.0, 30.0])
def test_a_single_rate_that_is_not_the_declared_one_is_found(case: Case, factor: float) -> None:
    for rate in case.rates:
        account = case.account(factor, rate)
        wrong = [check.name for check in violated(account)]
        assert "weights move as the proof has them move" in wrong, (rate, wrong)
        assert account.verdict == "violated"


@each
def test_weights_move_as_the_proof_has_them_move(case: Case) -> None:
    account = case.account()
    for one in account.proof.tuned:
        assert one.apart(account.period_s) < 0.005, (one.name, one.apart(account.period_s))
        assert one.seen(account.period_s) == pytest.approx(one.rate, rel=0.005)


ACCELERATIONS = tuple(
    f"controllers.{{}}.inputs.q_d_acc_{joint}_rad_s2=reference_{3 - joint}.q_d_acc_rad_s2"
    for joint in (1, 2)
)
CROSSED = {
    "friction_arm": tuple(text.format("nn_ramp") for text in ACCELERATIONS),
    "payload_arm": tuple(text.format("critic") for text in ACCELERATIONS),
    "deadzone_arm": (
        "reference_2.phase_rad=1.2",
        *(text.replace("controllers.{}", "executive.blocks.controller") for text in ACCELERATIONS),
    ),
    "quarter_car": (
        "executive.blocks.controller.inputs.p1_Pa=rx.FB_PRESSURE.p2",
        "executive.blocks.controller.inputs.p2_Pa=rx.FB_PRESSURE.p1",
    ),
    "backlash_map": (
        "executive.blocks.controller.inputs.x_d=reference.next",
        "executive.blocks.controller.inputs.x_d_next=reference.now",
    ),
}


@pytest.mark.parametrize("plant", CROSSED)
def test_crossed_inputs_violate_it(plant: str) -> None:
    found = CASES[plant].account(given=CROSSED[plant])
    assert found.verdict == "violated", [check.found for check in found.checks()]


@pytest.mark.parametrize(
    "reference", ["reference_1.amplitude_rad=0.5", "reference_2.phase_rad=1.2"]
)
def test_what_sampling_costs_does_not_violate_it(reference: str) -> None:
    """Of 1 kHz: 12.8 % are not explained without the steps of the tuning, 1.2 % with them."""
    account = Case("deadzone_arm/deadzone-sine", "nn", (reference,)).account()
    assert account.holds, violated(account)
    assert account.unexplained < 0.02, account.unexplained


@pytest.mark.parametrize("given", ["controller.kap1=0.0", "controller.beta=20.0"])
def test_a_condition_that_the_critic_misses_is_the_verdict(given: str) -> None:
    account = CASES["payload_arm"].account(given=(given,))
    names = [check.name for check in violated(account)]
    assert account.verdict == "violated" and any(name.startswith("beta^2 <") for name in names)
    assert not any(check.shown for check in account.checks() if check.name.startswith("ultimate"))


def test_where_the_barrel_violates_its_proof_all_of_it_has_a_named_cause() -> None:
    """Dead tuning has none: what a rig is excused for does not excuse it."""
    case = Case("atb1000/hull", "pd_nn_fast", (SEED, "duration_s=5.0", "seed=4711"))
    alive, dead = case.account(), case.account(0.0)
    assert alive.unexplained > UNEXPLAINED and not alive.holds
    assert alive.unnamed < 1e-9 < 0.5 < dead.unnamed, (alive.unnamed, dead.unnamed)


def test_of_a_log_with_holes_the_longest_whole_stretch_is_taken() -> None:
    """As on clocks: the plant tells nothing at first, and the executive skips three cycles."""
    rig = load_rig(PLANTS / "deadzone_map" / "rigs" / "fuzzy-d03.yaml", "fuzzy")
    theorem = theorem_of(rig)
    log = observed.of_rig(rig, theorem.states)

    def without(node: str, begin: int, end: int) -> NodeLog:
        one = log.node[node]
        left = (one.cycle < begin) | (one.cycle >= end)
        columns = {name: values[left] for name, values in one.columns.items()}
        return replace(one, cycle=one.cycle[left], stamp_ns=one.stamp_ns[left], columns=columns)

    nodes = {"plant": without("plant", 0, 5), "executive": without("executive", 40, 43)}
    told = Cycles(Run(replace(log, node=nodes), 0.1))
    account = Account(theorem.prove(told), 10.0)
    assert account.holds and account.unexplained < 1e-9, violated(account)
    assert told.left_out == 40 and account.proof.t_s[0] == pytest.approx(4.4)


@pytest.mark.parametrize(
    ("model", "holds", "found"),
    [
        ("0.0", True, "the joints have none"),
        ("1.0", False, "sticks in"),
        ("2.0", False, "bristles"),
    ],
)
def test_what_is_said_of_friction_is_that_of_its_model(model: str, holds: bool, found: str) -> None:
    path = PLANTS / "friction_arm" / "rigs" / "friction-c.yaml"
    given = [f"arm.friction_model={model}", "duration_s=1.0"]
    asked = of_rig(load_rig(path, "nn_ramp", given)).account.proof.asked
    one = next(one for one in asked if one.what == "friction is a function of x")
    assert one.holds == holds and found in one.found, one


def test_without_friction_both_derivatives_agree_with_the_order_of_the_sampling() -> None:
    """Friction jumps, and then a sample's value says little of the cycle behind it."""
    found = []
    for rate_hz in (500.0, 1000.0, 2000.0):
        path = PLANTS / "friction_arm" / "rigs" / "friction-c.yaml"
        given = ["arm.friction_model=0.0", "duration_s=2.0", f"rate_hz={rate_hz}"]
        found.append(of_rig(load_rig(path, "nn_standard", given)).account.unexplained)
    for coarse, fine in pairwise(found):
        assert 1.7 < coarse / fine < 2.3, found
