"""The step of an FMU: parameters that change while it runs, interpreted, at its end, in turn."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from reference_fmus import columns, fmu, made, rig

from pcpc.executive.nodes.plan import failures
from pcpc.executive.nodes.virtual import VirtualRun, in_memory
from pcpc.executive.rig.reading import load_rig

pytestmark = [
    pytest.mark.deep,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here: apt install gcc"),
]

RATE = 100.0


def test_a_tunable_parameter_reaches_it_in_its_cycle(tmp_path: Path) -> None:
    path = rig(tmp_path, fmu("BouncingBall", 2), "fmu.fmi_status", rate=RATE, duration=2.0)
    soft = "faults:\n  soft: {kind: value, at: 'plant:fmu.e', value: 0.2, from: 0.8s}\n"
    path.write_text(path.read_text(encoding="utf-8") + soft, encoding="utf-8")
    found = columns(path)
    changed = 80
    wanted = _bounced(len(found["fmu.h"]), {changed: 0.2})
    assert found["fmu.h"].tobytes() == wanted.tobytes()
    assert found["fmu.h"].tobytes() != _bounced(len(wanted), {}).tobytes()


def _bounced(cycles: int, changes: dict[int, float]) -> Any:
    """Return the height in each cycle by FMPy, with `e` set before steps as `changes` says."""
    file = fmu("BouncingBall", 2)
    about = fmpy.read_model_description(str(file))
    at = {one.name: [one.valueReference] for one in about.modelVariables}
    one = fmpy.fmi2.FMU2Slave(
        guid=about.guid,
        unzipDirectory=fmpy.extract(str(file)),
        instanceName="ball",
        modelIdentifier=about.coSimulation.modelIdentifier,
    )
    one.instantiate()
    one.setupExperiment(startTime=0.0)
    one.enterInitializationMode()
    one.exitInitializationMode()
    heights = one.getReal(at["h"])
    for k in range(1, cycles):
        if k in changes:
            one.setReal(at["e"], [changes[k]])
        t = (k - 1) / RATE
        one.doStep(t, k / RATE - t)
        heights += one.getReal(at["h"])
    return np.array(heights)


DIGEST = """
import sys
from reference_fmus import columns
from pathlib import Path
import hashlib
found = columns(Path(sys.argv[1]))
print(hashlib.sha256(b"".join(found[name].tobytes() for name in sorted(found))).hexdigest())
"""


@pytest.mark.parametrize("name", ["Feedthrough-3", "VanDerPol-2"])
def test_interpreted_it_has_the_same_bits(name: str, tmp_path: Path) -> None:
    model, version = name.split("-")
    wires = "inputs: {Float32_continuous_input: rx.CMD.command, Int8_input: rx.CMD.mode}"
    more = wires if model == "Feedthrough" else "parameters: {mu: 3.0}"
    path = rig(tmp_path, fmu(model, int(version)), "fmu.fmi_status", more, RATE, 0.1)
    found = columns(path)
    own = hashlib.sha256(b"".join(found[name].tobytes() for name in sorted(found))).hexdigest()
    folders = os.pathsep.join((str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")))
    done = subprocess.run(
        [sys.executable, "-c", DIGEST, str(path)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": folders},
    )
    assert done.stdout.split() == [own], done.stderr[-800:]


def test_two_fmus_in_one_plant_speak_for_themselves(tmp_path: Path) -> None:
    cold = {
        r"case vr_x0:\n            ASSERT_NVALUES\(1\);": "case vr_x0:\n ASSERT_NVALUES(1);\n"
        ' if (comp->time > 0.5) { logError(comp, "It is cold."); return Error; }'
    }
    made("VanDerPol", 2, tmp_path / "cold.fmu", code=cold)
    more = "blocks:\n  other: {law: fmu, file: cold.fmu}"
    path = rig(tmp_path, fmu("VanDerPol", 2), "other.x0", more, RATE, 1.0)
    run = VirtualRun(load_rig(path), None)
    for _ in run.advance():
        pass
    (line,) = failures(run.plans[1])
    assert re.fullmatch(r"other: .* in cycle 51 returned error: It is cold\.", line)
    found = run.memory.log().node["plant"].columns
    assert np.isfinite(found["fmu.x0"]).all() and np.isnan(found["other.x0"][-1])


def test_an_fmu_that_asks_to_end_is_told_so(tmp_path: Path) -> None:
    path = rig(tmp_path, fmu("Stair", 3), "fmu.counter", rate=10.0, duration=12.0)  # at 9 s
    run = VirtualRun(load_rig(path), None)
    for _ in run.advance():
        pass
    (line,) = failures(run.plans[1])
    assert "its step in cycle" in line and "returned an end of the simulation" in line
    assert [block.description["keyframe_passes"] for block in run.blocks] == [10, 0], "elsewhere"
    run.close()
    assert run.plans[1].opened == [] == list(failures(run.plans[1]))


def test_only_one_instance_in_a_process_is_enough(tmp_path: Path) -> None:
    once = {"<CoSimulation": '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true"'}
    file = made("VanDerPol", 2, tmp_path / "once.fmu", once)
    path = rig(tmp_path, file, "fmu.x0", rate=RATE, duration=0.1)
    first, second = (in_memory(load_rig(path)).node["plant"].columns["fmu.x0"] for _ in range(2))
    assert first.tobytes() == second.tobytes() and len(set(first.tolist())) > 5


def test_two_names_of_one_value_are_both_there(tmp_path: Path) -> None:
    copy = (
        '<ScalarVariable name="a copy" valueReference="1" causality="output"><Real/>'
        "</ScalarVariable></ModelVariables>"
    )
    file = made("VanDerPol", 2, tmp_path / "two.fmu", {"</ModelVariables>": copy})
    found = columns(rig(tmp_path, file, "fmu.a_copy", "parameters: {x0: 1.5}", RATE, 0.1))
    assert found["fmu.a_copy"].tobytes() == found["fmu.x0"].tobytes()
    assert found["fmu.x0"][0] == 1.5 and (found["fmu.x1"] != found["fmu.x0"]).all()
