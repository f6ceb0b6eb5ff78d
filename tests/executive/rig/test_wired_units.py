"""References of any unit take the unit of what they feed; segments of a rig file become numbers."""

from pathlib import Path

import numpy as np
import pytest

import pcpc
from pcpc.executive.errors import RigError
from pcpc.executive.laws import profiles
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig import segments, wired_units
from pcpc.executive.rig.reading import load_rig
from pcpc.tools import cli

LAW = """\
from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage

class Only(Ports):
    v_d = port("m/s", "a rate")

@stage
def only(t, dt, p: Nothing, x: Nothing, u: Only, y: Nothing): pass

ONLY = Block(only)
"""
FED = """
class Inputs{0}(Ports):
    x_d = port("{1}", "desired")
    v_d = port("{2}", "its rate")
    a_d = port("{3}", "its acceleration")

class Outputs{0}(Ports):
    seen = port("{1}", "what came")

@stage
def step{0}(t, dt, p: Nothing, x: Nothing, u: Inputs{0}, y: Outputs{0}):
    y.seen = u.x_d

FED{0} = Block(step{0})
"""
UNITS = ("m", "m/s", "m/s2"), ("", "1/s", "1/s2"), ("m/s", "m/s2", "m/s3")
PROBE = Path(pcpc.__file__).resolve().parents[1] / "plants/probe/rig.yaml"
CART = "    cart: {law: 'FED0', inputs: {x_d: goal.value, v_d: goal.rate, a_d: goal.acc}}\n"
ONLY = "    cart: {law: 'ONLY', inputs: {v_d: goal.rate}}\n"
STEP = "{law: profiles:step, parameters: {amplitude: 0.2, start_s: 0.5}}"


@pytest.fixture(scope="module", autouse=True)
def laws(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file of laws that are fed, by number of UNITS, compiled once."""
    global _laws
    _laws = tmp_path_factory.mktemp("laws") / "laws.py"
    _laws.write_text(LAW + "".join(FED.format(i, *units) for i, units in enumerate(UNITS)))
    return _laws


def written(folder: Path, goal: str, fed: str = CART) -> Path:
    """Write the probe with a block `goal` and one that it feeds; return the rig's file."""
    path = folder / "rig.yaml"
    fed = fed.replace("law: '", f"law: '{_laws}:")
    path.write_text(f"base: {PROBE}\nexecutive:\n  blocks:\n    goal: {goal}\n{fed}")
    return path


def units_of(path: Path) -> dict[str, str]:
    """Return the units of the variables of `goal`, planned and thereby wired."""
    found = plan(load_rig(path), "executive", "virtual").table.variables
    return {v.name.removeprefix("goal."): v.unit for v in found if v.name.startswith("goal.")}


@pytest.mark.parametrize("number", range(len(UNITS)))
def test_units_are_those_of_the_inputs(tmp_path: Path, number: int) -> None:
    units = UNITS[number]
    found = units_of(written(tmp_path, STEP, CART.replace("FED0", f"FED{number}")))
    assert (found["value"], found["rate"], found["acc"]) == units
    assert found["amplitude"] == found["offset"] == units[0] and found["start_s"] == "s"


@pytest.mark.parametrize(
    "units",
    [
        *UNITS, ("rad", "rad/s", "rad/s2"), ("N m", "N m/s", "N m/s2"), ("1/s", "1/s2", "1/s3"),
        ("degC", "degC/s", "degC/s2"), ("kg/m3", "kg/m3/s", "kg/m3/s2"), ("%", "%/s", "%/s2"),
    ],
    ids=lambda units: units[0] or "none",
)  # fmt: skip
def test_each_derivative_leads_back_to_the_unit(units: tuple[str, ...]) -> None:
    for order, mark in enumerate(("?", "?/s", "?/s2")):
        assert wired_units._derived_unit(mark, units[0]) == units[order]
        assert wired_units._integrated_unit(units[order], order) == units[0]
    assert wired_units._derived_unit("Hz", units[0]) == "Hz"
    assert wired_units._integrated_unit("N m", 1) is None is wired_units._integrated_unit("m/s", 2)


def test_a_rate_alone_tells_the_unit_and_so_does_the_rig(tmp_path: Path) -> None:
    assert units_of(written(tmp_path, STEP, ONLY))["value"] == "m"
    said = "{law: profiles:ramp, unit: kPa, parameters: {slope: 1}}"
    found = units_of(written(tmp_path, said, ""))
    assert (found["value"], found["slope"], found["acc"]) == ("kPa", "kPa/s", "kPa/s2")


def test_a_step_of_metres_runs_is_checked_logged_and_replayed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, STEP)
    changes = {"duration_s": 0.6, "goal.offset": 0.1}
    run = pcpc.simulate(path, set=changes, folder=tmp_path / "run", quiet=True)
    cycles = np.arange(600)
    np.testing.assert_array_equal(run["cart.seen"], np.where(cycles >= 500, 0.1 + 0.2, 0.1))
    log = logs.read(tmp_path / "run/log.mcap")
    variables = {row[0]: row[1] for row in log.node["executive"].description["variables"]}
    assert variables["goal.value"] == variables["cart.seen"] == "m"
    assert cli.main(["replay", str(tmp_path / "run")]) == 0
    capsys.readouterr()
    assert cli.main(["check", str(path)]) == 0
    assert "cart.x_d <- goal.value [m]" in " ".join(capsys.readouterr().out.split())


def test_segments_are_the_parameters_that_they_stand_for(tmp_path: Path) -> None:
    goal = (
        "\n      law: profiles:sequence\n      parameters: {begin: 0.1, repeat: 1}\n"
        "      segments:\n        - {over_s: 0.1}\n        - {to: 0.2, by: quintic, over_s: 0.2}\n"
        "        - {to: -1, by: step, over_s: 0.05}\n        - {to: 0.1, by: line, over_s: 0.05}"
    )
    path = written(tmp_path, goal)
    rig = load_rig(path, settings=["goal.to_2=0.3"])
    spec = next(s for s in rig.nodes()["executive"].blocks if s.name == "goal")
    assert spec.settings["to_2"] == 0.3 and spec.settings["over_2_s"] == 0.2
    assert [spec.settings[f"shape_{i}"] for i in range(1, 6)] == [0, 3, 1, 2, 0]
    assert spec.where("parameters.to_3").startswith(f"{path}:10:")
    again = load_rig(path, text=rig.resolved())
    assert again.resolved() == rig.resolved() and "segments" not in rig.resolved()
    run = pcpc.simulate(path, set={"duration_s": 0.8}, quiet=True)
    seen = run["cart.seen"]
    assert seen[[0, 99, 200, 300, 349, 375]] == pytest.approx([0.1, 0.1, 0.15, -1, -1, -0.45])
    np.testing.assert_allclose(seen[400:], seen[:400], atol=1e-9)
    (tmp_path / "over.yaml").write_text(
        "base: rig.yaml\nexecutive: {blocks: {goal: {segments: null}}}\n"
    )
    specs = load_rig(tmp_path / "over.yaml").nodes()["executive"].blocks
    assert next(s for s in specs if s.name == "goal").settings["over_1_s"] == 0.0


SEQUENCE = "{law: profiles:sequence, segments: %s}"
WRONG = {
    "no input": (STEP, "", "no input defines its unit: wire its value to one, or give `unit: m`"),
    "another unit": (
        STEP, CART.replace("v_d: goal.rate", "v_d: goal.value"),
        "cart.v_d is in 'm/s' but goal.value is in 'm'; wire a variable of the same unit; value, "
        "rate and acc are in its unit, unit/s and unit/s2",
    ),
    "no rate": (
        STEP, "    cart: {law: 'ONLY', inputs: {v_d: goal.acc}}\n",
        "goal.acc feeds cart.v_d, whose unit 'm/s' is not an acceleration; give `unit: ...`",
    ),
    "a unit that is not the input's": (
        STEP.replace("step,", "step, unit: rad,"), CART,
        "cart.x_d is in 'm' but goal.value is in 'rad'",
    ),
    "a unit for others": (
        "{law: references:step, unit: m, parameters: {amplitude_rad: 1, start_s: 0}}", "",
        "only references of any unit take it, as law: profiles:step",
    ),
    "a reference in rad": (
        "{law: references:step, parameters: {amplitude_rad: 1, start_s: 0}}",
        "    cart: {law: 'ONLY', inputs: {v_d: goal.q_d_rad}}\n",
        "these references are angles; for another unit: law: profiles:step",
    ),
    "no such output": (STEP, CART.replace("goal.acc", "goal.accel"), "no variable 'goal.accel'"),
    "a misspelt law": (STEP.replace(":step", ":stop"), CART, "did you mean step?"),
    "amplitude missing": ("{law: profiles:step}", CART, "parameter amplitude [m] is missing"),
    "beyond its range": (
        "{law: profiles:sine, parameters: {amplitude: 1, frequency_hz: 2e4}}", CART,
        "20000 is outside 0..10000 Hz",
    ),
    "segments of others": (
        "{law: profiles:step, segments: [{over_s: 1}]}", CART,
        "only `law: profiles:sequence` takes segments, got profiles:step",
    ),
    "none": (SEQUENCE % "[]", CART, "0 segments, expected 1 to 16"),
    "too many": (SEQUENCE % f"[{', '.join(17 * ['{over_s: 1}'])}]", CART, "more: law: table"),
    "no list": (SEQUENCE % "{to: 1}", CART, "expected a list, got to: 1"),
    "no time": (SEQUENCE % "[{to: 1, by: line}]", CART, "key over_s is missing"),
    "a shape": (SEQUENCE % "[{to: 1, by: lin, over_s: 1}]", CART, "did you mean line?"),
    "a key": (SEQUENCE % "[{too: 1, over_s: 1}]", CART, "unknown key; did you mean to?"),
    "to alone": (SEQUENCE % "[{to: 1, over_s: 1}]", CART, "`to: VALUE` goes with `by: step`"),
    "by alone": (SEQUENCE % "[{by: line, over_s: 1}]", CART, "`to: VALUE` goes with `by: step`"),
    "backwards": (SEQUENCE % "[{over_s: -1}]", CART, "-1 is outside 0..1e+06 s"),
    "a line at once": (SEQUENCE % "[{to: 1, by: line, over_s: 0}]", CART, "0 s is `by: step`"),
    "not a number": (SEQUENCE % "[{to: .nan, by: line, over_s: 1}]", CART, "nan"),
    "twice": (
        "{law: profiles:sequence, parameters: {to_1: 2}, segments: [{to: 1, by: step, over_s: 1}]}",
        CART, "segment 1 gives it; change that one",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_told_with_its_place_and_cure(tmp_path: Path, name: str) -> None:
    goal, watch, words = WRONG[name]
    with pytest.raises(RigError) as caught:
        units_of(written(tmp_path, goal, watch))
    assert words in str(caught.value) and "rig.yaml:" in str(caught.value), str(caught.value)


def test_segments_of_a_rig_are_those_of_the_law() -> None:
    shapes = {name: getattr(profiles, name.upper()) for name in segments._SHAPES}
    assert shapes == segments._SHAPES and segments._MOST == profiles.SEGMENTS
