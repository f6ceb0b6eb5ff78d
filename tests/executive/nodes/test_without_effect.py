"""What stands in a rig or a `--set` and would do nothing is told before the run."""

from pathlib import Path

import pytest
from places import ROOT

from pcpc.executive.errors import RigError
from pcpc.executive.nodes import without_effect
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import load_rig

PLANTS = ROOT / "plants"
SLEW10, HULLRAND = (PLANTS / f"atb1000/rigs/{name}.yaml" for name in ("slew10", "hullrand"))


def check(
    path: Path, *settings: str, text: str | None = None, controller: str | None = None
) -> None:
    rig = load_rig(path, controller, settings, text=text)
    for role in rig.roles:
        without_effect.check(plan(rig, role, "lockstep"))


def refused(path: Path, *settings: str, text: str | None = None) -> str:
    with pytest.raises(RigError) as caught:
        check(path, *settings, text=text)
    return str(caught.value)


@pytest.mark.parametrize(
    ("setting", "cure"),
    [
        ("barrel.hullrand_seed=5", "it has one with barrel.hull_motion=2"),
        ("barrel.hull2_phase_rad=0.1", "it has one with barrel.hull_motion=1"),
    ],
)
def test_a_setting_without_effect_is_refused_with_the_switch_that_gives_it_one(
    setting: str, cure: str
) -> None:
    said = refused(SLEW10, setting)
    assert said == f"--set {setting}: has no effect in this rig; {cure}", said


def test_the_same_setting_is_taken_where_its_switch_is_on() -> None:
    check(SLEW10, "barrel.hullrand_seed=5", "barrel.hull_motion=2")
    check(HULLRAND, "barrel.hullrand_seed=5", "barrel.hullrand_rms_rad=0.02")


@pytest.mark.parametrize(
    ("rig", "controller", "settings"),
    [
        ("friction_arm/rigs/friction-a", "nn_step", ("arm.step_s=1e-3", "controller.nodes=12")),
        ("deadzone_arm/rigs/deadzone-step", "nn", ("controller.network_seed=3", "rate_hz=500.0")),
        ("atb1000/rigs/slew10", None, ("barrel.gap_rad=0.003", "barrel.zeta3=0.02", "seed=7")),
        ("telerobot/rigs/telerobot-u1", None, ()), ("quarter_car/rigs/suspension-kick", None, ()),
    ],
)  # fmt: skip
def test_settings_with_an_effect_are_taken(
    rig: str, controller: str | None, settings: tuple[str, ...]
) -> None:
    check(PLANTS / f"{rig}.yaml", *settings, controller=controller)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("watch: controller.e_rat", ":2:1: watch: no variable controller.e_rat; did you mean"),
        ("watch: barrel.teta_rad", "did you mean barrel.theta_rad?"),
        ("evaluation: {window_s: [0, 99]}", "window_s: 99 s is after the end of the run at 6 s"),
        ("evaluation: {rest_to_s: 99}", "rest_to_s: 99 s is after the end of the run at 6 s"),
        ("schedule:\n- {at_s: 6.0, set: {controller.kv_Nms_rad: 1.0}}",
         "slew10.yaml:3:4: schedule[0].at_s: 6 s is after the end"),
    ],
)  # fmt: skip
def test_what_lies_behind_the_end_or_is_unknown_is_refused_with_its_place(
    line: str, said: str, tmp_path: Path
) -> None:
    own = tmp_path / "slew10.yaml"
    message = refused(own, text=f"base: {SLEW10}\n{line}\n")
    assert said in message, message
    assert "slew10.yaml:" in message, message


def test_a_run_that_is_shortened_may_end_before_its_window() -> None:
    check(SLEW10, "duration_s=0.1")
    assert "--set evaluation.window_s" in refused(SLEW10, "evaluation.window_s=[0.0, 9.0]")


def test_a_plants_variable_may_be_watched() -> None:
    check(SLEW10, "watch=barrel.theta_rad")
    check(SLEW10, "watch=rx.FB_A.encoder")


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("gap_rad=0.003", "did you mean barrel.gap_rad?"),
        ("barel.gap_rad=0.003", "did you mean barrel.gap_rad?"),
        ("kv_Nms_rad=3", "did you mean controller.kv_Nms_rad?"),
        ("kv=3", "no such setting; did you mean controller.kv_Nms_rad?"),
        ("barel.frequency_hz=0.1", "no such setting"),
        ("frequency=1", "no such setting"),
    ],
)
def test_only_settings_that_exist_are_suggested(setting: str, said: str) -> None:
    with pytest.raises(RigError) as caught:
        load_rig(SLEW10, None, [setting], resolve=False)
    message = str(caught.value)
    assert said in message, message
    if "did you mean" in message:
        suggested = message.partition("did you mean ")[2].rstrip("?").split(" or ")[0]
        load_rig(SLEW10, None, [f"{suggested}=1"], resolve=False)
        with pytest.raises(RigError) as again:
            load_rig(SLEW10, None, [f"{suggested}=nonsense"])
        assert "unknown" not in str(again.value), again.value
