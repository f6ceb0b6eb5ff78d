"""Rigs whose plant is a robot's drive: a master in the executive, the same on a bus, replayed."""

import re
from pathlib import Path

import numpy as np
import pytest

from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import in_memory, simulate
from pcpc.executive.rig.buses import check_line
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.verdict.frames import frames_to
from pcpc.tools.after.verdict.masters import mistakes

HERE = Path(__file__).parent
TEMPLATE = HERE.parents[2] / "tools/make/template"
KINDS = ("odrive", "mit", "moteus", "robstride")
ON = {"odrive": 8.0, "mit": 1.0, "moteus": 10.0, "robstride": 2.0}


@pytest.fixture(scope="module", params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    """Return the dialect."""
    return str(request.param)


@pytest.fixture(scope="module")
def run(kind: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a virtual run."""
    path = tmp_path_factory.mktemp("mastered") / "log.mcap"
    simulate(load_rig(HERE / f"{kind}.yaml", settings=["record.keyframe=100ms"]), path)
    return path


def test_the_master_switches_it_on_and_moves_it(kind: str, run: Path) -> None:
    log = logs.read(run)
    plant, on = log.node["plant"].columns, ON[kind]
    assert plant["drive.state"][0] != on and np.all(plant["drive.state"][20:390] == on)
    is_place = kind in ("mit", "robstride")
    reached = plant["motor.angle_rad" if is_place else "motor.speed_rad_s"][380]
    assert abs(reached - 2.0) < (0.02 if kind == "odrive" else 0.15), reached
    assert (plant["drive.state"][-1] != on) == (kind != "robstride"), (
        "which is always told to be on"
    )
    assert abs(plant["drive.command"][-1]) < (0.04 if kind == "robstride" else 1e-9)
    counted = {name: values[-1] for name, values in plant.items() if "drive.master." in name}
    refused = counted.pop("drive.master.command_refused")
    assert len(counted) == 13 and not any(counted.values()) and refused < 3, counted
    answer = {"odrive": "ESTIMATES", "mit": "FEEDBACK", "robstride": "FEEDBACK", "moteus": "REPLY"}[
        kind
    ]
    heard = log.node["executive"].columns[f"rx.{answer}.position"]
    assert min(abs(heard[380] - plant["drive.position"][at]) for at in (379, 380)) < 4e-4


def test_no_more_frames_are_used_than_were_sent(kind: str, run: Path) -> None:
    account = frames_to(load_rig(HERE / f"{kind}.yaml"), logs.read(run), {})
    to_plant = account["plant"]
    assert to_plant["sent"] >= to_plant["used"] > 900 and to_plant["unread"] >= 0, account
    assert account["nobody"]["sent"] < 20, account
    to_executive = account["executive"]
    assert to_executive["used"] > 500 and 0 <= to_executive["unread"] <= 10, account


@pytest.mark.parametrize(("of", "setting", "said"), [
    ("odrive", "plant.drive.node=64", "64 is not one of 0 to 63"),
    ("mit", "plant.drive.node=256", "plant.drive.node"),
    ("odrive", "plant.drive.eds=x.eds", "odrive has no EDS; leave it out"),
    ("mit", "plant.drive.position=motor.encoder", "no variable motor.encoder"),
    ("cia402", "plant.drive.node=0", "0 is not one of 1 to 127"),
    ("odrive", "plant.drive.node=4", "4 has the id of SYNC, 0x080; choose another"),
    ("odrive", "plant.drive.node=5", "5 has the id of CMD, 0x0a0; choose another"),
    ("odrive", "plant.drive.node=9", "9 has the id of FB, 0x120; choose another"),
    ("mit", "plant.drive.node=160", "160 has the id of CMD, 0x0a0; choose another"),
    ("robstride", "plant.drive.node=128", "128 is not one of 1 to 127"),
    ("moteus", "plant.drive.node=0", "0 is not one of 1 to 126"),
    ("moteus", "plant.drive.node=127", "127 is not one of 1 to 126"),
    ("moteus", "plant.drive.eds=x.eds", "moteus has no EDS; leave it out"),
])  # fmt: skip
def test_a_wrong_key_is_named(of: str, setting: str, said: str) -> None:
    with pytest.raises(RigError) as error:
        plan(load_rig(TEMPLATE / f"drive_{of}.yaml", settings=[setting]), "plant", "real")
    assert said in str(error.value), error.value


@pytest.mark.parametrize(("of", "before", "after", "said"), [
    ("moteus", "torque_constant: 0.0274", "torque_constant: 0.0", "0 is not a number from 1e-09"),
    ("mit", "TMAX: 10.0", "TMAX: 0.0", "TMAX: 0 is not a number from 1e-06"),
    ("mit", "MST_ID: 0x11", "MST_ID: 2048", "MST_ID: 2048 is not a whole number from 0 to 2047"),
    ("odrive", "axis0.config.motor.torque_constant", "torque_constant", "no such setting; axis0"),
    ("cia402", '"1017": 100', '"1017": 100.5', "1017: 100.5 is not a whole number"),
])  # fmt: skip
def test_a_wrong_setting_is_named_with_its_place(
    of: str, before: str, after: str, said: str
) -> None:
    file = TEMPLATE / f"drive_{of}.yaml"
    with pytest.raises(RigError) as error:
        plan(load_rig(file, text=file.read_text().replace(before, after)), "plant", "real")
    assert said in str(error.value) and f"drive_{of}.yaml:" in str(error.value), error.value


@pytest.mark.parametrize(("master", "drive", "said"), [
    ("mit", "robstride", "MIT mode's"),
    ("robstride", "odrive", "a RobStride's"), ("moteus", "mit", "a moteus'"),
])  # fmt: skip
def test_a_master_for_another_maker_is_named(master: str, drive: str, said: str) -> None:
    file = HERE / f"{master}.yaml"
    text = re.sub(r"    objects: .*\n", "", file.read_text())
    text = text.replace("  drive:\n", f"  drive:\n    profile: {drive}\n    objects: null\n")
    text = text.replace(f"drive_{master}", f"drive_{drive}")
    log = in_memory(load_rig(file, text=text, settings=["duration_s=0.05"]))
    (line,) = [one for one in mistakes(log.node["plant"]) if "frame to this node" in one]
    assert line.startswith(f"master: frame to this node was {said}"), line
    own = in_memory(load_rig(file, settings=["duration_s=0.05"])).node["plant"].columns
    assert not any(own[name].any() for name in own if ".from_" in name)


def test_the_bus_of_a_drive_of_can_fd_takes_its_frames(tmp_path: Path) -> None:
    for kind in KINDS:
        rig = load_rig(TEMPLATE / f"drive_{kind}.yaml")
        for role in ("plant", "executive"):
            made = plan(rig, role, "real")
            assert made.fd == (kind == "moteus") and made.data_bytes == (64 if made.fd else 8)
    settings = ["bus.emulate=1M", "bus.data_bitrate=null"]
    rig = load_rig(TEMPLATE / "drive_moteus.yaml", settings=settings)
    with pytest.raises(RigError, match=r"a moteus drive switches its bit rate; give bus.data_bit"):
        check_line(rig, "real")
    check_line(load_rig(HERE / "moteus.yaml", settings=["bus.emulate=1M"]), "real")


def test_a_frame_of_can_fd_with_an_id_of_the_drive_is_named(tmp_path: Path) -> None:
    text = (
        (HERE / "moteus.dbc")
        .read_text()
        .replace(
            'BA_ "VFrameFormat" BO_ 256',
            'BA_ "VFrameFormat" BO_ 1793 14;\nBA_ "VFrameFormat" BO_ 256',
        )
    )
    (tmp_path / "fd.dbc").write_text(text)
    rig = load_rig(HERE / "moteus.yaml", settings=[f"dbc={tmp_path / 'fd.dbc'}"])
    with pytest.raises(RigError, match="1 has the id of HB_EXEC, 0x701; choose another"):
        plan(rig, "plant", "real")
