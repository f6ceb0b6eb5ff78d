"""Each plant's theorem on runs of its rigs: it holds, and a law that is not the theorem's does not.

Seeds are none of those that any rig, study or page names.
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pcpc.executive.rig.reading import load_rig
from pcpc.plants.lyapunov import Account, Check
from pcpc.tools.bounds import of_rig

PLANTS = Path(__file__).resolve().parents[2] / "plants"
FLIPPED = """
from pcpc.executive.laws.block import Block, Prepared
from pcpc.executive.laws.controllers.{folder} import {name} as law

def prepare(settings, rate_hz, seed):
    own = getattr(law, "prepare", None)
    made = own(settings, rate_hz, seed) if own else Prepared(settings, {{}})
    turned = {{name: -made.parameters[name] for name in {rates}}}
    return Prepared({{**made.parameters, **turned}}, made.states)

BLOCK = Block(law.step, settings=getattr(law, "Settings", law.Parameters), prepare=prepare)
"""


@dataclass(frozen=True)
class Case:
    """A rig with a network, the rates of its tuning, and settings of an unlisted draw."""

    plant: str
    rig: str
    controller: str
    module: str  # of the law, below laws/controllers
    rates: dict[str, float]
    given: tuple[str, ...] = ()
    turned: tuple[str, ...] = ()  # parameters that flip the tuning, where they are not the rates
    power: float = 1.0  # by which a rate goes with what is set

    def account(self, factor: float = 1.0) -> Account:
        """Return the account with all tuning rates times `factor`."""
        rates = [
            f"controller.{name}={factor**self.power * value!r}"
            for name, value in self.rates.items()
        ]
        return self._account(PLANTS / self.plant / "rigs" / f"{self.rig}.yaml", rates)

    def flipped(self, folder: Path) -> Account:
        """Return the account of the law with all tuning rates negative, from a file in `folder`."""
        rates = self.turned or tuple(self.rates)
        folder_of, name = self.module.split(".")
        (folder / "flipped.py").write_text(FLIPPED.format(folder=folder_of, name=name, rates=rates))
        base = PLANTS / self.plant / "rigs" / f"{self.rig}.yaml"
        law = f"controllers: {{{self.controller}: {{law: flipped.py:BLOCK}}}}"
        (folder / "rig.yaml").write_text(f"base: {base}\nrig: flipped\n{law}\n")
        return self._account(folder / "rig.yaml", [])

    def _account(self, path: Path, given: list[str]) -> Account:
        rig = load_rig(path, self.controller, [*given, *self.given])
        with np.errstate(over="ignore", invalid="ignore"):
            return of_rig(rig, self.module.split(".")[-1]).account


CASES = {
    "friction_arm": Case(
        "friction_arm", "friction-c", "nn_ramp", "arm.friction_nn",
        {"s_rate": 10.0, "t_rate": 10.0, "e_rate": 35.0},
        ("controller.network_seed=4711.0", "duration_s=6.0"),
    ),
    "deadzone_arm": Case(
        "deadzone_arm", "deadzone-sine", "nn", "arm.deadzone_nn",
        {"t_rate": 500.0, "s_rate": 24.0},
        ("controller.network_seed=4711.0", "duration_s=6.0", "rate_hz=2000.0"),
    ),
    "payload_arm": Case(
        "payload_arm", "payload-on", "critic", "arm.adaptive_critic", {"gam": 100.0},
        ("controller.network_seed=4711.0", "duration_s=6.0"),
    ),
    "quarter_car": Case(
        "quarter_car", "suspension-8", "fl", "strut.strut_backstepping",
        {"adaptation_rad_s": 120.0}, ("car.road_rad_s=21.0", "duration_s=4.0"), ("gam_m2_N2",), 0.5,
    ),
}  # fmt: skip
each = pytest.mark.parametrize("case", CASES.values(), ids=list(CASES))


def violated(account: Account) -> list[Check]:
    """Return the checks that do not hold."""
    return [check for check in account.checks() if not check.holds]


@each
def test_the_theorem_holds_on_an_unlisted_draw(case: Case) -> None:
    account = case.account()
    assert account.holds, violated(account)
    assert (account.proof.v >= 0.0).all(), account.proof.v.min()
    assert 0.0 < account.unexplained < 0.05, account.unexplained


@each
@pytest.mark.parametrize("factor", [0.0, 100.0])
def test_dead_and_hasty_tuning_violate_it(case: Case, factor: float) -> None:
    account = case.account(factor)
    names = [check.name for check in violated(account)]
    assert "V follows its identity" in names, account.unexplained


@each
def test_flipped_tuning_violates_it(case: Case, tmp_path: Path) -> None:
    account = case.flipped(tmp_path)
    names = [check.name for check in violated(account)]
    assert "V follows its identity" in names, account.unexplained


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
