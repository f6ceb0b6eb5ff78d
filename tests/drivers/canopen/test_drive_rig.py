"""A rig whose plant is a drive: in virtual time with a master in the executive, and replayed."""

from pathlib import Path

import numpy as np
import pytest
from processes import pcpc

from pcpc.executive.batch.driven import DrivenPlant
from pcpc.executive.batch.group import LaneGroup, NotInLanes
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

HERE = Path(__file__).parent
MASTERED = HERE / "mastered.yaml"
DRIVE = HERE.parents[2] / "tools/make/template/drive_cia402.yaml"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a virtual run."""
    path = tmp_path_factory.mktemp("mastered") / "log.mcap"
    simulate(load_rig(MASTERED, settings=["record.keyframe=100ms"]), path)
    return path


def test_the_master_brings_the_motor_to_its_velocity(run: Path) -> None:
    plant = logs.read(run).node["plant"]
    power = plant.columns["drive.statusword"].astype(int) & 0x6F
    first = [int(np.argmax(power == state)) for state in (0x40, 0x21, 0x23, 0x27)]
    assert first == sorted(first) and first[-1] < 12, first
    v = plant.columns["motor.speed_rad_s"]
    assert abs(v[380] - 2.0) < 0.02, v[380]
    assert power[-1] == 0x40 and plant.columns["drive.command"][-1] == 0.0
    assert plant.columns["drive.nmt"][10] == 5


def test_its_frames_are_in_the_log(run: Path) -> None:
    frames = logs.read(run).node["plant"].frames
    sent, taken = (frames[frames["direction"] == way]["id"].tolist() for way in (0, 1))
    assert sent[0] == 0x702 and 0x705 in sent and sent.count(0x485) >= 500
    assert taken.count(0x505) >= 500 and taken.count(0x080) >= 500


@pytest.mark.parametrize(("setting", "said"), [
    ("plant.drive.position=motor.encoder", "no variable motor.encoder"),
    ("plant.drive.velocity=motor.speed", "no variable motor.speed"),
    ("plant.drive.node=128", "plant.drive.node"),
    ("plant.drive.profile=cia401", "plant.drive.profile"),
    ("plant.blocks.motor.inputs.voltage_V=rx.CMD.voltage", "takes drive.command"),
])  # fmt: skip
def test_a_wrong_key_is_named(setting: str, said: str) -> None:
    with pytest.raises(RigError) as error:
        plan(load_rig(DRIVE, settings=[setting]), "plant", "real")
    assert said in str(error.value), error.value


@pytest.mark.parametrize(("entry", "said"), [
    ("6041: 1", "cannot be written"), ("2000: 1", "no such object"),
    ("6072: 1001", "outside 0..1000"), ("6060: x", "expected a whole number"),
])  # fmt: skip
def test_a_wrong_object_is_named_with_its_place(entry: str, said: str) -> None:
    text = DRIVE.read_text().replace('objects: {"1017": 100, ', f"objects: {{{entry}, ")
    with pytest.raises(RigError) as error:
        plan(load_rig(DRIVE, text=text), "plant", "real")
    assert said in str(error.value) and "drive_cia402.yaml:13:" in str(error.value), error.value


def test_lanes_and_fits_which_step_blocks_alone_leave_it_out() -> None:
    with pytest.raises(NotInLanes, match=r"its plant is a drive|nothing is compiled"):
        LaneGroup(load_rig(MASTERED), {})
    with pytest.raises(RigError, match="the drive moves this plant"):
        DrivenPlant(load_rig(MASTERED))


REFUSED = {
    "C": (["generate", "c"], "generated C has no drive"),
    "a watchdog": (["watchdog"], "does not know the frames of a drive"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_does_not_know_a_drive_says_so(name: str, tmp_path: Path) -> None:
    words, said = REFUSED[name]
    done = pcpc(*words, str(DRIVE), cwd=tmp_path)
    assert done.code == 2 and said in done.err, done
    assert not list(tmp_path.iterdir())


def test_a_check_says_what_the_bus_load_lacks() -> None:
    done = pcpc("check", str(DRIVE))
    said = " ".join(done.out.split())
    assert done.code == 0 and "the bus load is without the frames of the drive" in said, done
