"""`pcpc fit` on logs of the motor of `pcpc new` and of the shipped plants."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pcpc
from pcpc.executive.batch.driven import DrivenPlant
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main
from pcpc.tools.make.new import write
from pcpc.tools.start.rigs import find
from pcpc.tools.study.fit import fitting
from pcpc.tools.study.fit.book._identified_seeds import START, true_values
from pcpc.tools.study.fit.estimate import estimate
from pcpc.tools.study.fit.fitting import Model, narrow
from pcpc.tools.study.fit.record import record_of
from pcpc.tools.study.fit.result import Parameter

MOTOR = {"motor.coulomb_Nm": 0.003, "motor.inertia_kg_m2": 25e-6, "motor.resistance_ohm": 3.5}


@pytest.fixture(scope="module")
def motor(tmp_path_factory):
    """Return a motor's folder outside the project, and a run of another specimen of it."""
    folder = tmp_path_factory.mktemp("own") / "motor"
    write(folder)
    run = pcpc.simulate(folder / "rig.yaml", set=MOTOR, folder=folder / "run", quiet=True)
    return folder, run


def test_a_plant_of_ones_own_gets_the_values_of_the_specimen_in_the_log(motor):
    folder, run = motor
    found = pcpc.fit(folder / "rig.yaml", run, list(MOTOR), quiet=True)
    for name, true in MOTOR.items():
        one = found[name]
        assert one.value == pytest.approx(true, rel=0.01), f"{name}: {one}"
        assert abs(one.value - true) < 5.0 * one.error, f"{name}: {one}"
    again = pcpc.simulate(folder / "rig.yaml", set=found.values, quiet=True)
    difference = again["plant:motor.angle_rad"] - run["plant:motor.angle_rad"]
    assert np.abs(difference).max() < 3.2e-3, "a count of the encoder"


def test_the_command_writes_values_that_a_rig_takes_over(motor, tmp_path, capsys):
    folder, _ = motor
    words = ["fit", str(folder / "rig.yaml"), str(folder / "run"), "-o", str(tmp_path / "fitted"),
             "--parameter", "motor.coulomb_Nm", "--parameter", "motor.inertia_kg_m2=1e-6:1e-4",
             "--set", "motor.resistance_ohm=3.5", "--quiet"]  # fmt: skip
    assert main(words) == 0
    said = capsys.readouterr().out
    lines = [one for one in said.splitlines() if not one.startswith(("log ", "folder "))]
    assert "motor.coulomb_Nm" in said and max(map(len, lines)) <= 80
    facts = json.loads((tmp_path / "fitted" / "fit.json").read_text("utf-8"))
    assert [one["name"] for one in facts["parameters"]] == [
        "motor.coulomb_Nm",
        "motor.inertia_kg_m2",
    ]
    assert (tmp_path / "fitted" / "fit.png").stat().st_size > 10_000
    rig = load_rig(folder / "rig.yaml", None, [f"@{tmp_path / 'fitted' / 'fit.yaml'}"])
    value = rig.config.plant.blocks["motor"].parameters["coulomb_Nm"]
    assert value == pytest.approx(0.003, rel=0.01)


def test_a_model_that_is_wrong_is_told_and_is_no_success(motor, tmp_path, capsys):
    folder, _ = motor
    words = ["fit", str(folder / "rig.yaml"), str(folder / "run"), "-o", str(tmp_path / "wrong"),
             "--parameter", "motor.coulomb_Nm", "--parameter", "motor.resistance_ohm",
             "--set", "motor.inertia_kg_m2=60e-6", "--quiet"]  # fmt: skip
    assert main(words) == 1
    said = capsys.readouterr().out
    assert "the residuals exceed the samples' own noise" in said, said
    assert "the model is probably wrong" in " ".join(said.split()), said
    facts = json.loads((tmp_path / "wrong" / "fit.json").read_text("utf-8"))
    assert facts["arrived"] is False and max(s["worst"] for s in facts["sensors"]) > 3.0
    assert "no estimate of the plant" in (tmp_path / "wrong" / "fit.yaml").read_text("utf-8")


def test_a_search_that_is_lost_gives_no_interval_and_is_no_success(
    motor, tmp_path, capsys, monkeypatch
):
    folder, run = motor

    def lost(*given):
        found = estimate(*given)
        return replace(found, explained=100, worst=9.0 + found.worst, alike=False)

    monkeypatch.setattr(fitting, "estimate", lost)
    words = ["fit", str(folder / "rig.yaml"), str(folder / "run"), "-o", str(tmp_path / "lost"),
             "--parameter", "motor.coulomb_Nm", "--quiet"]  # fmt: skip
    assert main(words) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "the search did not converge" in said and "search is lost or the model is wrong" in said
    assert "the first 0.1 s of" in said and " .. " not in said, said
    facts = json.loads((tmp_path / "lost" / "fit.json").read_text("utf-8"))
    assert facts["parameters"][0]["low"] is None and facts["parameters"][0]["error"] is None
    assert "no interval" in (tmp_path / "lost" / "fit.yaml").read_text("utf-8")
    found = pcpc.fit(folder / "rig.yaml", run, ["motor.coulomb_Nm"], quiet=True)
    assert not found.arrived and "did not converge" in found.notes[0]


def test_a_barrel_on_a_moving_hull_is_found_from_far_off():
    run = pcpc.simulate("hull", seed=301, quiet=True)
    found = pcpc.fit("hull", run, set=START, quiet=True)
    assert found.arrived, found.notes
    for one, true in zip(found.parameters, true_values(), strict=True):
        assert one.low < true < one.high, f"{one}, true {true}"


@pytest.mark.parametrize("words, told", [
    (["--parameter", "motor.colomb_Nm"], "coulomb_Nm"),
    (["--parameter", "motor.coulomb_Nm=2:1"], "lower bound first"),
    (["--parameter", "motor.coulomb_Nm=-1:1"], "not within 0..1000"),
    (["--parameter", "motor.coulomb_Nm=a:b"], "expected NAME, or NAME=lo:hi"),
    (["--parameter", "motor.coulomb_Nm", "--parameter", "motor.coulomb_Nm"], "twice"),
    (["--set", "motor.coulomb_Nm=0", "--parameter", "motor.coulomb_Nm"], "give NAME=lo:hi"),
    (["--sensor", "FB.encode"], "FB.encoder"),
    (["--set", "rate_hz=500"], "1000 cycles a second"),
])  # fmt: skip
def test_what_cannot_be_fitted_is_told_in_a_line(motor, refused, words, told):
    folder, _ = motor
    begin = ["fit", folder / "rig.yaml", folder / "run", "-o", "no", "--quiet"]
    refused([*begin, *words], told)


def test_a_log_of_another_plant_is_refused(motor, tmp_path):
    _, run = motor
    with pytest.raises(pcpc.Error, match=r"it has no CMD\.motor_torque.*give the rig of the log"):
        pcpc.fit("slew10", run, quiet=True)


def test_a_log_that_is_too_short_is_refused(motor):
    folder, _ = motor
    run = pcpc.simulate(folder / "rig.yaml", set={"duration_s": 0.03}, quiet=True)
    with pytest.raises(pcpc.Error, match="a fit takes 50"):
        pcpc.fit(folder / "rig.yaml", run, quiet=True)


def test_a_log_that_excites_nothing_says_what_would(motor, tmp_path, capsys):
    folder, _ = motor
    still = pcpc.simulate(
        folder / "rig.yaml",
        set={"reference.amplitude_rad": 0.0},
        quiet=True,
        folder=tmp_path / "still",
    )
    found = pcpc.fit(folder / "rig.yaml", still, quiet=True)
    assert found.values == {}
    assert any(
        "motor.inertia_kg_m2: this log does not determine" in note and "a fast move" in note
        for note in found.notes
    ), found.notes
    words = ["fit", str(folder / "rig.yaml"), str(tmp_path / "still"), "-o", str(tmp_path / "of"),
             "--parameter", "motor.inertia_kg_m2", "--quiet"]  # fmt: skip
    assert main(words) == 1
    assert "does not determine it" in capsys.readouterr().out
    assert main([*words[:3], "-o", str(tmp_path / "all"), "--quiet"]) == 1, "nothing was estimated"


def test_a_plant_that_was_tuned_in_the_log_is_refused(motor):
    folder, _ = motor
    rig = folder / "rig.yaml"
    run = pcpc.open(folder / "run")
    tuning = {"cycle": 300, "name": "motor.coulomb_Nm", "value": 0.001}
    run.log.node["plant"].tunings.append(tuning)  # as `pcpc set --node` leaves it in a log
    with pytest.raises(pcpc.Error, match="was tuned"):
        pcpc.fit(rig, run, quiet=True)


def test_a_plant_without_an_identification_file_is_fitted_to_all_that_it_sends(motor, tmp_path):
    folder, _ = motor
    other = tmp_path / "bare"
    shutil.copytree(folder, other, ignore=shutil.ignore_patterns("run"))
    (other / "identification.py").unlink()
    model = Model(load_rig(other / "rig.yaml"))
    assert set(model.sensors) == {"FB.encoder", "FB.current"}
    assert "motor.counts_per_turn" not in model.names and "motor.inertia_kg_m2" in model.names


def test_an_identification_file_that_is_wrong_is_told_with_its_place(motor, tmp_path):
    folder, run = motor
    other = tmp_path / "wrong"
    shutil.copytree(folder, other, ignore=shutil.ignore_patterns("run"))
    (other / "identification.py").write_text("PARAMETERS = ['motor.coulomb_Nm']\n", "utf-8")
    with pytest.raises(pcpc.Error, match=r"identification\.py: PARAMETERS: expected"):
        pcpc.fit(other / "rig.yaml", run, quiet=True)


@pytest.mark.parametrize("rig", ["slew10", "telerobot-u1"])
def test_the_driven_plant_gives_the_bits_of_the_run(rig):
    run = pcpc.simulate(rig, set={"duration_s": 0.4}, quiet=True)
    plant = DrivenPlant(load_rig(Path(find(rig))))
    node = run.log.node["plant"]
    given = np.stack([node.columns[f"rx.{name}"] for name in plant.received], axis=1)
    names = list(plant.sources.values())
    own = [name for name in names if name.partition(".")[0] in plant.blocks]
    rows = len(given) - 1  # the last one is the end's
    expected = np.stack([node.columns[name] for name in own], axis=1)[:rows]
    seed = plant.rig.config.seed
    np.testing.assert_array_equal(plant.signals([{}], own, given[:rows], 0, seed)[0], expected)
    both = plant.signals([{}, {}], own, given[:rows], 0, seed)
    np.testing.assert_array_equal(both[1], expected)


def test_the_models_samples_are_those_of_the_log_where_a_sensor_only_rounds():
    run = pcpc.simulate("slew10", set={"duration_s": 0.8}, quiet=True)
    model = Model(load_rig(Path(find("slew10"))))
    record = record_of(run.log, model.plant, list(model.sensors))
    smooth, samples = model.samples(model.start, record.given, record.first)
    there = np.isfinite(record.measured)
    for name in ("FB_A.encoder", "FB_C.motor_speed", "MOTPOS.motor_angle"):
        j = list(model.sensors).index(name)
        rows = there[:, j]
        heard = record.measured[rows, j]
        np.testing.assert_allclose(samples[rows, j], heard, rtol=1e-12, atol=1e-15)
        assert np.abs(smooth[rows, j] - heard).max() > 0.3 * model.quantum[j], name


def test_an_interval_too_narrow_to_be_believed_is_named():
    sharp, usual, unknown = (
        Parameter(name, "m", 2.0, 2.0, error, 1.9, 2.1, excited)
        for name, error, excited in (("a.b", 1e-7, True), ("a.c", 1e-4, True), ("a.d", 0.0, False))
    )
    (note,) = narrow([sharp, usual, unknown])
    assert note.startswith("a.b: ") and "a.c" not in note and "a.d" not in note
    assert narrow([usual, unknown]) == []
