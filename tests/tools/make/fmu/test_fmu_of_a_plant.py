"""An FMU that `pcpc generate fmu` makes of a plant: valid, and in a rig the bits of the plant."""

import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from reference_fmus import PROBE

from pcpc.executive.errors import RigError
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.make.fmu import cli as fmu

pytestmark = [
    pytest.mark.deep,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here: apt install gcc"),
]

HULL = PROBE.parent / "atb1000" / "rigs" / "hull.yaml"


def written(rig: Rig, file: Path) -> str:
    """Write the FMU of a rig's plant; return the block's name."""
    made = plan(rig, "plant", "lockstep")
    spec = fmu.chosen_block(made, None)
    fmu.write(made, spec, file)
    return spec.name


def with_fmu(rig: Rig, block: str, file: Path) -> Rig:
    """Return the rig with the FMU in the place of its plant's block."""
    data = yamlfile.load(rig.path, rig.resolved()).data
    inputs = data["plant"]["blocks"][block]["inputs"]
    data["plant"]["blocks"][block] = {"law": "fmu", "file": str(file), "inputs": inputs}
    data |= {"dbc": str(rig.dbc), "evaluation": None}
    place = file.with_suffix(".yaml")
    place.write_text(yamlfile.dump(data), encoding="utf-8")
    return load_rig(place)


@pytest.mark.parametrize(
    ("path", "settings", "moves"),
    [
        (HULL, ["duration_s=0.2"], "barrel.encoder_rad"),  # with noise and a hull that moves
        (PROBE / "rig.yaml", ["duration_s=0.2", "lag.tau_s=0.03"], "lag.position"),
    ],
)
def test_in_a_rig_it_has_the_bits_of_the_plant(
    path: Path, settings: list[str], moves: str, tmp_path: Path
) -> None:
    rig = load_rig(path, None, settings)
    block = written(rig, tmp_path / "plant.fmu")
    own, other = in_memory(rig), in_memory(with_fmu(rig, block, tmp_path / "plant.fmu"))
    for node in ("executive", "plant"):
        mine, theirs = own.node[node].columns, other.node[node].columns
        both = [name for name in mine if name in theirs]
        assert len(both) > 10 and (node == "executive" or moves in both)
        different = [name for name in both if mine[name].tobytes() != theirs[name].tobytes()]
        assert not different
    assert len(set(own.node["plant"].columns[moves].tolist())) > 100


def test_it_is_valid_for_fmpy_and_equal_rigs_give_equal_descriptions(tmp_path: Path) -> None:
    rig = load_rig(HULL)
    for name in ("a.fmu", "b.fmu"):
        written(rig, tmp_path / name)
        assert validate_fmu(str(tmp_path / name)) == []
    texts = [
        zipfile.ZipFile(tmp_path / name).read("modelDescription.xml") for name in ("a.fmu", "b.fmu")
    ]
    assert texts[0] == texts[1]
    about = fmpy.read_model_description(str(tmp_path / "a.fmu"))
    units = {one.name: one.unit for one in about.modelVariables}
    assert units["motor_command_Nm"] == "N.m"


def test_fmpy_simulates_it_as_its_step_is(tmp_path: Path) -> None:
    rig = load_rig(PROBE / "rig.yaml")
    written(rig, tmp_path / "lag.fmu")
    found = fmpy.simulate_fmu(
        str(tmp_path / "lag.fmu"),
        stop_time=0.05,
        output_interval=0.001,
        output=["position"],
        start_values={"command": 2.0, "tau_s": 0.02},
    )
    x, wanted = 0.0, [0.0]
    for _ in range(50):
        x += 0.001 / 0.02 * (2.0 - x)
        wanted.append(x)
    assert np.array_equal(found["position"], wanted)


@pytest.fixture
def lag(tmp_path: Path) -> Callable[[], Any]:
    """Return what makes an instance of the probe's plant, initialised."""
    file = tmp_path / "lag.fmu"
    written(load_rig(PROBE / "rig.yaml"), file)
    about = fmpy.read_model_description(str(file))
    folder = fmpy.extract(str(file), tmp_path / "lag")

    def make() -> Any:
        one = fmpy.fmi2.FMU2Slave(
            guid=about.guid,
            unzipDirectory=folder,
            instanceName="lag",
            modelIdentifier=about.coSimulation.modelIdentifier,
        )
        one.instantiate()
        one.setupExperiment(startTime=0.0)
        one.enterInitializationMode()
        one.exitInitializationMode()
        one.references = {v.name: v.valueReference for v in about.modelVariables}
        return one

    return make


def test_a_state_that_was_kept_goes_on_with_the_same_bits(lag: Callable[[], Any]) -> None:
    one, other = lag(), lag()
    place = [one.references["position"]]
    one.setReal([one.references["command"]], [1.0])
    one.doStep(0.0, 0.001)
    kept = one.serializeFMUstate(one.getFMUstate())
    one.doStep(0.001, 0.001)
    other.setFMUstate(other.deSerializeFMUstate(kept))
    other.doStep(0.001, 0.001)
    assert one.getReal(place) == other.getReal(place) != [0.0]
    one.reset()
    assert one.getReal(place) == [0.0]


@pytest.mark.parametrize("step", [(0.0, 0.002), (0.001, 0.001), (0.0, float("nan"))])
def test_a_step_that_is_not_the_rigs_is_an_error(
    step: tuple[float, float], lag: Callable[[], Any]
) -> None:
    with pytest.raises(FMICallException, match="error"):
        lag().doStep(*step)


def test_what_cannot_be_set_is_refused(lag: Callable[[], Any]) -> None:
    one = lag()
    for name in ("position", "x"):
        with pytest.raises(FMICallException, match="error"):
            one.setReal([one.references[name]], [1.0])
    with pytest.raises(FMICallException, match="error"):
        one.getReal([10_000])


def test_built_with_other_bits_it_refuses_to_begin(tmp_path: Path) -> None:
    if not _has_fma():
        pytest.skip("this processor cannot join a product and a sum")
    written(load_rig(PROBE / "rig.yaml"), tmp_path / "lag.fmu")
    folder = Path(fmpy.extract(str(tmp_path / "lag.fmu"), tmp_path / "lag"))
    (library,) = folder.glob("binaries/*/lag.so")
    sources = [str(file) for file in folder.glob("sources/*.c")]
    subprocess.run(["gcc", "-std=gnu99", "-O2", "-mfma", "-ffp-contract=fast", "-shared", "-fPIC",
                    "-o", str(library), *sources], check=True)  # fmt: skip
    shutil.make_archive(str(tmp_path / "other"), "zip", folder)
    (tmp_path / "other.zip").rename(tmp_path / "other.fmu")
    rig = with_fmu(load_rig(PROBE / "rig.yaml"), "lag", tmp_path / "other.fmu")
    with pytest.raises(RigError, match="Compiled with other bits: -ffp-contract=off is needed"):
        in_memory(rig)


def _has_fma() -> bool:
    return " fma " in Path("/proc/cpuinfo").read_text(encoding="utf-8")


def test_a_plant_of_several_blocks_says_which(tmp_path: Path) -> None:
    text = (PROBE / "rig.yaml").read_text(encoding="utf-8")
    other = "{law: model.py:BLOCK, parameters: {tau_s: 1.0}, inputs: {command: rx.CMD.command}}"
    text = text.replace("    lag:\n", f"    other: {other}\n    lag:\n")
    text = text.replace("model.py", f"{PROBE}/model.py").replace("law.py", f"{PROBE}/law.py")
    (tmp_path / "rig.yaml").write_text(text.replace("probe.dbc", f"{PROBE}/probe.dbc"))
    made = plan(load_rig(tmp_path / "rig.yaml"), "plant", "lockstep")
    with pytest.raises(RigError, match="say which with --block; the plant has other, lag"):
        fmu.chosen_block(made, None)
    assert fmu.chosen_block(made, "lag").name == "lag"
