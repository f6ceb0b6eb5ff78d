"""What the commands about rigs and machines print with --json, held against their schemas.

More outcomes of theirs, and the commands that measure for long: the tests of each command, which
hold what it prints as well.
"""

from pathlib import Path

import pytest
from json_schemas import holds
from logcommand import Done, barrel_log, run_here
from processes import ROOT, own_bus, pcpc

from pcpc.drivers.can import bus as buses

PROBE = ROOT / "plants/probe"


def told(code: int, *words: str | Path) -> Done:
    done = run_here(*words)
    assert done.code == code, done
    return done


def test_a_rig_is_checked() -> None:
    assert holds("check", told(0, "check", "hull", "--json").out)["bus"]["load"]
    assert holds("check", told(0, "check", "probe", "--json").out)["bus"]["load"] == []


def test_a_signal_without_bounds_has_words_for_them(tmp_path: Path) -> None:
    text = (PROBE / "probe.dbc").read_text()
    old = "position : 0|32@1- (1e-06,0) [-2147.483648|2147.483647]"
    assert old in text
    text = text.replace(old, "position : 0|32@1- (1e300,0) [0|0]")
    (tmp_path / "probe.dbc").write_text(f"{text}\nSIG_VALTYPE_ 288 position : 1;\n")
    (tmp_path / "rig.yaml").write_text(f"base: {PROBE / 'rig.yaml'}\ndbc: probe.dbc\n")
    done = told(0, "check", tmp_path / "rig.yaml", "--json")
    (frame,) = (
        one for one in holds("check", done.out)["nodes"]["plant"]["sends"] if one["name"] == "FB"
    )
    assert frame["scales"][0]["range"] == ["-inf", "inf"], frame


def test_a_bus_is_computed_and_emulated() -> None:
    assert holds("bus", told(0, "bus", "hull", "--json").out)["buses"][0]["fits"] is True
    slow = holds("bus", told(1, "bus", "hull", "--bitrate", "125k", "--json").out)
    assert slow["buses"][0]["frames"][-1]["response_us"] is None, "no end"
    first = own_bus()
    second = str(buses.neighbour_of(buses.bus_named(*buses.parse(first))))
    done = pcpc("bus", "emulate", first, second, "--for", "100ms", "--json", "--quiet")
    assert done.code == 0, done  # in a process of its own: it locks its memory
    assert len(holds("bus", done.out)["sides"]) == 2


def test_bounds_of_a_run_of_one_that_diverges_and_of_a_law_without_a_theorem() -> None:
    words = "bounds", "friction-c", "--set", "duration_s=0.5", "--json", "--quiet"
    short = holds("bounds", told(1, *words).out)  # it is over before the error is back in its ball
    assert short["constants"]["other_rate"] is None and short["holds"] is False
    assert holds("bounds", told(1, *words, "--set", "controller.kappa=0.0").out)["holds"] is False
    none = told(0, "bounds", "slew10", "--set", "duration_s=0.1", "--json", "--quiet")
    assert holds("bounds", none.out)["theorem"] is None


@pytest.mark.deep
def test_margins_of_a_loop() -> None:
    words = "margin", "probe", "--json", "--lowest", "5", "--settle", "500ms"
    found = holds("margin", told(0, *words).out)
    assert found["measured"]["coherence"] and found["linearised"]["margins"]["gain_margin"]
    alone = holds("margin", told(0, *words, "--method", "linearised").out)
    assert alone["measured"] is None


@pytest.mark.deep
def test_a_plant_is_fitted(tmp_path: Path) -> None:
    assert run_here("new", tmp_path / "motor").code == 0
    rig, run = tmp_path / "motor/rig.yaml", tmp_path / "run"
    assert run_here("simulate", rig, "-o", run, "--quiet", "--no-figure").code == 0
    words = "fit", rig, run, "--parameter", "motor.coulomb_Nm", "--quiet", "--json"
    found = holds("fit", told(0, *words, "-o", tmp_path / "fitted").out)
    assert found["arrived"] and Path(found["folder"]) == tmp_path / "fitted"


def test_what_a_machine_offers() -> None:
    assert holds("doctor", told(0, "doctor", "--json").out)["can_run"] is True


def test_a_log_is_played() -> None:
    words = "play", str(barrel_log("pd")), "--bus", own_bus(), "--json", "--quiet"
    done = pcpc(*words)  # a process of its own: one that keeps time locks its memory
    assert done.code == 0 and holds("play", done.out)["timing_error_us"], done
    assert holds("play", told(0, *words, "--rate", "0").out)["timing_error_us"] is None


def test_lateness_is_measured(tmp_path: Path) -> None:
    words = "jitter", "-q", "-D", "200ms", "--rounds", "1", "--bus", own_bus()
    told(0, *words, "--json", tmp_path / "jitter.json")
    assert holds("jitter", (tmp_path / "jitter.json").read_text())["loops"]["pcpc"]["cycles"]
