"""FMUs that nobody here wrote, stepped through a rig, give the bits of FMPy's own simulation."""

import shutil
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from reference_fmus import columns, fmu, rig

pytestmark = [
    pytest.mark.deep,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here: apt install gcc"),
]

RATE = 100.0


def _bits(values: Any) -> list[int]:
    return list(np.ascontiguousarray(values, np.float64).view(np.int64).tolist())


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(
    ("name", "given", "outputs"),
    [
        ("BouncingBall", {}, ["h", "v"]),
        ("BouncingBall", {"g": -3.7, "e": 0.6, "h": 2.5}, ["h", "v"]),
        ("VanDerPol", {"mu": 2.5, "x0": 0.1}, ["x0", "x1"]),
        ("Stair", {}, ["counter"]),
    ],
)
def test_a_reference_fmu_in_a_rig_equals_fmpys_simulation(
    name: str, version: int, given: dict[str, float], outputs: list[str], tmp_path: Path
) -> None:
    file = fmu(name, version)
    more = f"parameters: {given}" if given else ""
    path = rig(tmp_path, file, "fmu.fmi_status", more, RATE)
    ours = columns(path)
    theirs = fmpy.simulate_fmu(
        str(file),
        stop_time=3.5,
        output_interval=1.0 / RATE,
        start_values=given,
        output=outputs,
        fmi_type="CoSimulation",
    )
    n = len(ours["time.t_s"])
    assert n > 300
    for output in outputs:
        values = ours[f"fmu.{output}"]
        assert _bits(values) == _bits(theirs[output][:n])
        assert len(set(values.tolist())) > 2, "it does not move"


def test_what_the_law_commands_goes_into_the_fmu_and_comes_out_of_it(tmp_path: Path) -> None:
    more = "inputs: {Float64_continuous_input: rx.CMD.command}"
    path = rig(tmp_path, fmu("Feedthrough", 3), "fmu.Float64_continuous_output", more, RATE, 0.2)
    found = columns(path)
    command, answer = found["rx.CMD.command"], found["fmu.Float64_continuous_output"]
    assert _bits(answer) == _bits(command)
    assert len(set(command.tolist())) > 5


@pytest.mark.parametrize("version", [2, 3])
def test_integers_are_rounded_and_booleans_are_0_or_1(version: int, tmp_path: Path) -> None:
    more = "inputs: {Int32_input: rx.CMD.command, Boolean_input: supervisor.gain}"
    path = rig(tmp_path, fmu("Feedthrough", version), "fmu.Int32_output", more, RATE, 0.2)
    found = columns(path)
    wanted = np.floor(found["rx.CMD.command"] + 0.5)
    assert _bits(found["fmu.Int32_output"][1:]) == _bits(wanted[1:])
    assert set(found["fmu.Boolean_output"][1:].tolist()) == {1.0}


def test_arrays_go_element_by_element(tmp_path: Path) -> None:
    file = fmu("StateSpace", 3)
    wires = {"u[1]": "rx.CMD.command", "u[2]": "rx.CMD.mode", "u[3]": "supervisor.gain"}
    given = {"A[1]": -1.0, "A[5]": -2.0, "A[9]": -3.0, "B[2]": 0.5, "x0[3]": 1.5}
    more = f"inputs: {wires}\nparameters: {given}"
    ours = columns(rig(tmp_path, file, "fmu.y_1", more, RATE, 0.5))
    n = len(ours["time.t_s"])
    a, b = np.diag([-1.0, -2.0, -3.0]), np.eye(3)
    b[0, 1] = 0.5
    starts: dict[str, Any] = {"A": a.ravel(), "B": b.ravel(), "x0": [0.0, 0.0, 1.5]}
    theirs = _stepped(file, starts, np.column_stack([ours[source] for source in wires.values()]))
    for i in range(3):
        assert _bits(ours[f"fmu.y_{i + 1}"]) == _bits(theirs[:n, i])


def _stepped(file: Path, starts: dict[str, Any], inputs: Any) -> Any:
    """Return y of StateSpace stepped by FMPy, one row a cycle."""
    about = fmpy.read_model_description(str(file))
    references = {one.name: one.valueReference for one in about.modelVariables}
    folder = fmpy.extract(str(file))
    one = fmpy.fmi3.FMU3Slave(
        guid=about.guid,
        unzipDirectory=folder,
        instanceName="y",
        modelIdentifier=about.coSimulation.modelIdentifier,
    )
    one.instantiate()
    for name, values in starts.items():
        one.setFloat64([references[name]], list(map(float, values)))
    one.enterInitializationMode()
    one.exitInitializationMode()
    one.setFloat64([references["u"]], inputs[0].tolist())
    rows = [one.getFloat64([references["y"]], 3)]
    for k in range(1, len(inputs)):
        one.setFloat64([references["u"]], inputs[k].tolist())
        t = (k - 1) / RATE
        one.doStep(t, k / RATE - t)
        rows.append(one.getFloat64([references["y"]], 3))
    return np.array(rows)
