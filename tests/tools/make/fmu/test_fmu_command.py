"""Runs with an FMU as the plant through the commands: every pacing, its log, its replay."""

import json
import shutil
from pathlib import Path

import pytest
from json_schemas import holds
from processes import own_bus, pcpc
from reference_fmus import fmu, rig

pytestmark = [
    pytest.mark.deep,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here: apt install gcc"),
]

MORE = "inputs: {Float64_continuous_input: rx.CMD.command}"
OUTPUT = "fmu.Float64_continuous_output"


@pytest.fixture(scope="module")
def echo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a rig whose plant answers with its command."""
    folder = tmp_path_factory.mktemp("echo")
    path = rig(folder, fmu("Feedthrough", 3), OUTPUT, MORE, 200.0, 0.5)
    path.write_text(path.read_text().replace("gain: 4.0", "gain: 0.5"), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def run(echo: Path) -> Path:
    """Return its folder of a run in virtual time."""
    folder = echo.parent / "virtual"
    done = pcpc("simulate", str(echo), "-o", str(folder), "--quiet")
    assert done.code == 0, done
    return folder


def test_virtual_time_and_lockstep_processes_write_the_same(run: Path, echo: Path) -> None:
    folder = echo.parent / "lockstep"
    done = pcpc(
        "run", str(echo), "--pacing", "lockstep", "--bus", own_bus(), "-o", str(folder), "--quiet"
    )
    assert done.code == 0, done
    done = pcpc("compare", "--bits", str(run), str(folder))
    assert done.code == 0 and "equal" in done.out, done


def test_a_replay_does_not_run_the_fmu_unasked(run: Path, echo: Path) -> None:
    file = echo.parent / fmu("Feedthrough", 3).name
    away = file.rename(file.with_suffix(".away"))
    try:
        done = pcpc("replay", str(run), "--json", "--quiet")
    finally:
        away.rename(file)
    executive, plant = json.loads(done.out)
    assert done.code == 0 and executive["identical"] and plant["identical"], done
    assert executive["from_record"] == []
    assert "the FMU Feedthrough" in plant["from_record"][0]
    assert "--fmu FILE runs it" in plant["from_record"][0]


def test_a_replay_with_the_fmu_recomputes_it(run: Path, echo: Path) -> None:
    file = str(echo.parent / fmu("Feedthrough", 3).name)
    done = pcpc("replay", str(run), "--node", "plant", "--fmu", file, "--json", "--quiet")
    (plant,) = json.loads(done.out)
    assert done.code == 0 and plant["identical"] and plant["from_record"] == [], done
    changed = ("--set", "fmu.Float64_continuous_input_start=1")
    assert pcpc("replay", str(run), "--fmu", file, *changed).code == 2  # it is wired
    other = pcpc("replay", str(run), "--fmu", str(fmu("VanDerPol", 3)))
    assert other.code == 2 and "another FMU: the run's Feedthrough has sha256" in other.err, other
    none = pcpc("replay", str(run), "--fmu", "none.fmu")
    assert none.code == 2 and "--fmu none.fmu: no such file" in none.err, none


def test_a_wrong_fmu_is_one_line(tmp_path: Path) -> None:
    path = rig(tmp_path, tmp_path / "x.fmu", "fmu.x")
    (tmp_path / "x.fmu").write_text("no")
    for command in ("check", "simulate"):
        done = pcpc(command, str(path))
        assert done.code == 2 and "not an FMU" in done.err.splitlines()[-1], done


def test_check_tells_what_it_is_and_whether_it_keeps_up(echo: Path) -> None:
    done = pcpc("check", str(echo), "--json")
    (about,) = holds("check", done.out)["nodes"]["plant"]["fmus"]
    assert (about["model"], about["fmi"], about["period_us"]) == ("Feedthrough", "3.0", 5000.0)
    text = pcpc("check", str(echo)).out
    assert "real-time capable: " in text and "FMU Feedthrough, FMI 3.0" in text
    assert "outputs: Float32_continuous_output, " in text and " more, see --json" in text
    assert "parameters: Float64_fixed_parameter = 0, " in " ".join(text.split())
    given = {one["given"]: one["role"] for one in about["variables"]}
    assert given["Float64_fixed_parameter"] == "parameter"


def test_a_copy_of_the_rig_elsewhere_needs_its_fmu(echo: Path, tmp_path: Path) -> None:
    shutil.copy(echo, tmp_path)
    done = pcpc("check", str(tmp_path / echo.name))
    assert done.code == 2 and "no such file" in done.err, done


def test_an_fmu_of_a_plant_is_made_and_taken(tmp_path: Path) -> None:
    file = tmp_path / "lag.fmu"
    done = pcpc("generate", "fmu", "probe", "-o", str(file), "--set", "lag.tau_s=0.05")
    assert done.code == 0 and "FMI 2.0, co-simulation, step 0.001 s" in done.out, done
    wires = "inputs: {command: rx.CMD.command}\nparameters: {tau_s: 0.05}"
    path = rig(tmp_path, file, "fmu.position", wires, 1000.0, 0.1)
    done = pcpc("check", str(path))
    assert done.code == 0 and "FMU lag, FMI 2.0, pcpc" in done.out, done
    other = rig(tmp_path, file, "fmu.position", wires, 500.0, 0.1)
    done = pcpc("check", str(other))
    assert done.code == 2 and "The communication step has to be 0.001 s." in done.err, done
    done = pcpc("generate", "fmu", "probe", "--block", "leg")
    assert done.code == 2 and "no block leg; did you mean lag?" in done.err, done
    done = pcpc("generate", "fmu", "probe", "-o", str(tmp_path / "none" / "lag.fmu"))
    assert done.code == 2 and "there is no folder" in done.err, done
