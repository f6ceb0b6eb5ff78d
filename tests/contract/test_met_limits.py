"""Every controller meets the limits of its rig: all plants, rigs and controllers that are judged.

A golden run has its figures in tests/golden, where a test holds their bits; all others are run.
"""

from pathlib import Path

import pytest
from golden import ROOT, blessed, whole

from pcpc.executive.rig.reading import load_rig

RIGS = {path.stem: path for path in sorted((ROOT / "plants").glob("*/rigs/*.yaml"))}
PLANTS = sorted({path.parents[1].name for path in RIGS.values()})
UNJUDGED = {  # controllers that no rig limits, and why
    "atb1000": {  # rivals.md compares them, tests/plants/test_rivals.py holds its figures
        "pd_tuned", "pid_tuned", "pd_fast_tuned", "pd_nn_tuned", "pd_nn_fast_tuned",
        "pd_feedforward", "pd_observer", "super_twisting", "pd_adaptive", "lqg",
    },
}  # fmt: skip
JUDGED_ON_EACH_RIG = "friction_arm", "payload_arm", "telerobot"  # of these plants: all controllers


def golden_figures(rig: Path) -> dict[str, dict[str, float]]:
    """Return the figures of a rig's golden runs by their controllers."""
    entries = blessed(rig.parents[1].name).items()
    own = [entry for name, entry in entries if name.partition("+")[0] == rig.stem]
    return {entry["controller"]: entry["figures"] for entry in own}


def misses(rig: Path, golden: bool) -> list[str]:
    """Return which limits are not met, by golden runs or by all other controllers."""
    known, found = golden_figures(rig), []
    for controller, limits in load_rig(rig, resolve=False).config.expect.items():
        assert limits, f"{rig.stem}: {controller} is judged by nothing"
        if (controller in known) is golden:
            figures = known[controller] if golden else whole(rig, controller)["figures"]
            found += [
                f"{controller} {name}: {figures.get(name)}"
                for name, (low, high) in limits.items()
                if not low <= figures.get(name, float("nan")) <= high
            ]
    return found


@pytest.mark.parametrize("rig", RIGS)
def test_a_golden_run_meets_the_limits_of_its_rig(rig: str) -> None:
    assert misses(RIGS[rig], golden=True) == []


@pytest.mark.deep
@pytest.mark.parametrize("rig", RIGS)
def test_every_controller_meets_the_limits_of_its_rig(rig: str) -> None:
    assert misses(RIGS[rig], golden=False) == []


@pytest.mark.parametrize("plant", PLANTS)
def test_every_rig_and_every_controller_is_judged(plant: str) -> None:
    rigs = {name: load_rig(path, resolve=False).config for name, path in RIGS.items()
            if path.parents[1].name == plant}  # fmt: skip
    assert [name for name, config in rigs.items() if not config.expect] == []
    controllers = {name for config in rigs.values() for name in config.controllers}
    judged = {controller for config in rigs.values() for controller in config.expect}
    assert controllers - judged == UNJUDGED.get(plant, set())
    if plant in JUDGED_ON_EACH_RIG:
        without = {name: controllers - {*config.expect} for name, config in rigs.items()}
        assert not any(without.values()), without
