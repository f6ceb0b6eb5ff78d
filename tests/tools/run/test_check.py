"""`pcpc check`: what it says about a rig is what the rig and its DBC file say."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from json_schemas import holds
from msgspec import to_builtins
from places import ROOT

from pcpc import simulate
from pcpc.drivers.can import dbc
from pcpc.executive.nodes.plan import plan
from pcpc.executive.own_laws.purity import warnings
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.verdict.report import rows
from pcpc.tools.cli import main
from pcpc.tools.make.new import write
from pcpc.tools.run import check

RIGS = ROOT / "plants/atb1000/rigs"
HULL = str(RIGS / "hull.yaml")
Screen = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def hull() -> dict[str, Any]:
    """Return the report of a rig as it is shipped."""
    rig = load_rig(HULL)
    plans = [plan(rig, role, rig.config.pacing) for role in rig.roles]
    return dict(to_builtins(check.describe(rig, plans)))


def report(screen: Screen, *words: str) -> dict[str, Any]:
    code = main(["check", *words, "--json"])
    out, err = screen.readouterr()
    assert code == 0, err
    found: dict[str, Any] = holds("check", out)
    return found


@pytest.mark.parametrize("rig", sorted(RIGS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_shipped_rig_passes(rig: Path, capsys: Screen) -> None:
    code = main(["check", str(rig)])
    out, err = capsys.readouterr()
    assert (code, err) == (0, "")
    assert out.startswith(f"{rig.stem}: "), out


def test_the_schedule_is_in_the_order_of_the_rig_file(capsys: Screen) -> None:
    nodes = report(capsys, HULL, "--controller", "pid")["nodes"]
    assert nodes["executive"]["schedule"] == [
        {"block": "reference", "law": "references:step"},
        {"block": "controller", "law": "pid"},
    ]
    assert [entry["block"] for entry in nodes["plant"]["schedule"]] == ["barrel"]


@pytest.mark.parametrize(
    ("setting", "law"), [("standby=[pid]", "pid"), ("overrun.fallback=pd_star", "pd")]
)
def test_who_may_take_over_is_a_block_with_its_law(setting: str, law: str, capsys: Screen) -> None:
    words = ("--controller", "pd_fast", "--set", setting)
    schedule = report(capsys, HULL, *words)["nodes"]["executive"]["schedule"]
    laws = [entry["law"] for entry in schedule]
    assert sorted(filter(None, laws)) == sorted(["references:step", "pd_fast", law]), schedule


def test_the_wiring_names_input_source_and_unit(hull: dict[str, Any]) -> None:
    wiring = hull["nodes"]["executive"]["wiring"]
    sources = {wire["input"]: (wire["source"], wire["unit"]) for wire in wiring}
    assert sources["controller.hub_rate_rad_s"] == ("rx.FB_A.hub_rate", "rad/s")
    assert sources["tx.CMD.motor_torque"] == ("controller.motor_torque_Nm", "N m")


def test_the_text_shows_wiring_frames_and_load(capsys: Screen) -> None:
    assert main(["check", HULL]) == 0
    words = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    for line in (
        "controller.encoder_rad <- rx.FB_A.encoder [rad]",
        "schedule reference (references:step), then controller (pd)",
        "0x0A0 CMD 8 bytes every cycle counter, crc",
        "0x701 HB_EXEC 1 bytes every 100 ms",
    ):
        assert line in words, f"{line!r} is not in {words}"
    assert [line for line in words if line.endswith("<- this rig")], words


def test_the_frames_both_ways_are_those_of_the_dbc_file(hull: dict[str, Any]) -> None:
    database = dbc.load(hull["dbc"])
    for role in ("executive", "plant"):
        node = hull["nodes"][role]
        expected = {m.name: m.frame_id for m in database.messages if node["node"] in m.senders}
        sent = {frame["name"]: frame["id"] for frame in node["sends"]}
        assert sent == expected, f"{role}: {sent}"
    names = {frame["name"] for frame in hull["nodes"]["plant"]["sends"]}
    received = set(hull["nodes"]["executive"]["receives"])
    assert received <= names, f"received, never sent: {received - names}"


def test_a_bus_that_is_just_fast_enough_passes_and_a_slower_one_is_refused(
    hull: dict[str, Any], capsys: Screen
) -> None:
    bus = hull["bus"]
    load = next(entry["load"] for entry in bus["load"] if entry["rate_hz"] == 1000.0)
    bits_per_s = round(load * bus["bitrate"])
    tight = report(capsys, HULL, "--set", f"bus.bitrate={bits_per_s + 1}")["bus"]
    assert tight["highest_rate_hz"] == 1000, f"{tight['highest_rate_hz']} Hz at {bits_per_s} bit/s"
    code = main(["check", HULL, "--set", f"bus.bitrate={bits_per_s - 100}"])
    out, err = capsys.readouterr()
    assert (code, out) == (2, ""), out
    assert "rate_hz: 1000 Hz loads the bus with 100.0% of" in err, err


def test_without_a_bitrate_no_load_is_claimed(capsys: Screen) -> None:
    assert main(["check", HULL, "--set", "bus.bitrate=null", "--set", "rate_hz=4000"]) == 0
    out = capsys.readouterr().out
    assert "bus load: not checked, the rig gives no bus.bitrate" in out, out


def test_a_sent_signal_that_is_wired_to_nothing_is_a_warning_with_its_place(
    hull: dict[str, Any],
) -> None:
    wired = {wire["input"] for node in hull["nodes"].values() for wire in node["wiring"]}
    bare = [
        f"{frame['name']}.{signal}"
        for node in hull["nodes"].values()
        for frame in node["sends"]
        for signal in frame["signals"]
        if f"tx.{frame['name']}.{signal}" not in wired
    ]
    warned = " ".join(hull["warnings"])
    assert bare, "the shipped rig has such signals"
    assert [name for name in bare if name not in warned] == [], hull["warnings"]
    assert "CMD.motor_torque" not in warned, hull["warnings"]
    assert all(".yaml:" in warning for warning in hull["warnings"]), hull["warnings"]


IMPURE = """
import math as m
from math import sin

@inline
def helper(a: float) -> float:
    return sin(a) + m.pi

def unused(a: float) -> float:
    return m.cos(a)

@stage
def other(t: float, dt: float, p: Gains, x: States, u: Inputs, y: Outputs) -> None:
    print(1)
    y.e_rad = m.exp(p.kp_V_rad) + np.hypot(1.0, 2.0)
    y.e_rad **= 0.5
    y.speed_rad_s = math.pi * helper(u.q_d_rad) + u.q_d_rad * u.q_d_rad
"""


def test_what_has_other_bits_elsewhere_is_a_warning_with_its_line(
    tmp_path: Path, capsys: Screen
) -> None:
    assert warnings(IMPURE) == [(7, "sin"), (14, "print"), (15, "m"), (15, "np"), (16, "**")]
    write(tmp_path / "motor")
    law = tmp_path / "motor" / "laws/pid.py"
    text = law.read_text("utf-8")
    law.write_text(
        text.replace(
            "y.e_rad = u.q_d_rad - u.encoder_rad", "y.e_rad = math.sin(u.q_d_rad)"
        ).replace("from pcpc", "import math\nfrom pcpc", 1)
    )
    (slow, warning) = report(capsys, str(tmp_path / "motor" / "rig.yaml"))["warnings"]
    assert "a sweep runs it one by one" in slow, slow
    assert "pid.py:70: math in a step, in `y.e_rad = math.sin(u.q_d_rad)" in warning, warning
    assert "not the same on every machine" in warning, warning


def narrow(folder: Path) -> Path:
    """Return a rig whose current travels in 8 bits of 0.01 A, of a port that goes to 30 A."""
    write(folder / "motor")
    file = folder / "motor" / "motor.dbc"
    text = file.read_text("utf-8")
    assert " SG_ current : 32|16@1- (0.001,0) [-30|30]" in text
    file.write_text(text.replace("32|16@1- (0.001,0) [-30|30]", "32|8@1+ (0.01,0) [-30|30]"))
    return folder / "motor" / "rig.yaml"


def test_a_scale_that_cannot_hold_its_ports_range_is_a_warning(
    tmp_path: Path, capsys: Screen
) -> None:
    rig = narrow(tmp_path)
    (warning,) = report(capsys, str(rig))["warnings"]
    line = rig.with_name("motor.dbc").read_text("utf-8").split(" SG_ current")[0].count("\n") + 1
    assert warning == (
        f"{rig.with_name('motor.dbc')}:{line}: FB.current holds 0 to 2.55 A, "
        "motor.sample_current_A goes from -30 to 30 A: it will be cut"
    )
    assert main(["check", str(rig)]) == 0
    words = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "FB.current 0.01 A 0 to 2.55" in words and "FB.encoder 1e-06 rad -1000 to 1000" in words
    bound = ["--set", "executive.limits.CMD.voltage.high=24"]
    assert len(report(capsys, str(rig), *bound)["warnings"]) == 1


def test_the_summary_names_the_signal_that_was_cut_most(tmp_path: Path) -> None:
    run = simulate(narrow(tmp_path), quiet=True)
    current = run["plant:motor.sample_current_A"]
    above, below = (current > 2.555).sum(), (current < -0.005).sum()
    assert above < below, "it brakes for longer"
    first_s = 1e-3 * int(np.argmax(current < -0.005))
    said = f"FB.current was cut to 0 A in {below} cycles, first at {first_s:.4g} s"
    assert run.summary["most_cut"] == said, run.summary["most_cut"]
    lines = [line for own in rows(run.result, tmp_path, 80).values() for line in own]
    assert said in lines, lines
    whole = simulate(narrow(tmp_path / "b").parent / "rig.yaml", set={"duration_s": 0.05})
    assert whole.summary["most_cut"] == "", "it has not moved"
