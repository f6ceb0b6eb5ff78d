"""Several plants below one executive: on one bus, on two, on a line; as drives; with a device."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from json_schemas import holds
from logcommand import run_here
from processes import pcpc

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import VirtualRun, in_memory, simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2] / "drivers/canopen")]
from many import drives  # noqa: E402
from motors import motors  # noqa: E402

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of three motors on one bus, with the log of a virtual run."""
    folder = tmp_path_factory.mktemp("three")
    rig = motors(folder, 3, more="record: {keyframe: 100ms}\n")
    simulate(load_rig(rig, settings=["duration_s=0.5"]), folder / "log.mcap")
    return folder


def equal(a: logs.NodeLog, b: logs.NodeLog, beginning: str) -> bool:
    """Return whether all columns that begin so have equal bits in two records."""
    names = [name for name in a.columns if name.startswith(beginning)]
    assert names, beginning
    return all(np.array_equal(a.columns[n], b.columns[n], equal_nan=True) for n in names)


def test_each_moves_as_if_the_others_were_not_there(three: Path, tmp_path: Path) -> None:
    whole = logs.read(three / "log.mcap")
    assert list(whole.node) == ["executive", "plant", "plant_2", "plant_3"]
    told = holds("log info", run_here("log", "info", three / "log.mcap", "--json").out)
    assert [*told["nodes"]] == list(whole.node)
    alone = in_memory(load_rig(motors(tmp_path, 1), settings=["duration_s=0.5"]))
    assert equal(whole.node["plant"], alone.node["plant"], "motor.")
    two = in_memory(load_rig(motors(tmp_path, 2, 1), settings=["duration_s=0.5"]))
    assert equal(whole.node["plant_2"], two.node["plant_2"], "motor.")
    ends = [whole.node[role].columns["motor.encoder_rad"][-1] for role in list(whole.node)[1:]]
    assert np.abs(np.array(ends) - [3.0, 1.5, 1.0]).max() < 0.013, ends


def test_a_branch_goes_on_with_all_of_them(three: Path, tmp_path: Path, capsys: Capture) -> None:
    log = str(three / "log.mcap")
    same, other = str(tmp_path / "same"), str(tmp_path / "other")
    quiet = ["--quiet", "--no-figure"]
    assert main(["branch", log, "--time", "0.15", "-o", same, *quiet]) == 0
    assert "equal to the bit" in capsys.readouterr().out
    change = ["--set", "plant_2:motor.coulomb_Nm=0.004"]
    assert main(["branch", log, "--time", "0.15", *change, "-o", other, *quiet]) == 0
    a, b = (logs.read(Path(one) / "log.mcap") for one in (same, other))
    assert equal(a.node["plant"], b.node["plant"], "motor.")
    assert not equal(a.node["plant_2"], b.node["plant_2"], "motor.")


def both(rig: Path, folder: Path, *settings: str) -> list[logs.Log]:
    """Return the logs of a virtual run and of one in lockstep on a bus, which are told equal."""
    found, words = [], [word for one in settings for word in ("--set", one)]
    for name, command in (("virtual", ["simulate"]), ("bus", ["run", "--pacing", "lockstep"])):
        done = pcpc(*command, str(rig), "-o", str(folder / name), "--no-figure", *words)
        assert done.code == 0, done
        found.append(logs.read(folder / name / "log.mcap"))
    done = pcpc("compare", "--bits", str(folder / "virtual"), str(folder / "bus"))
    assert done.code == 0 and "equal" in done.out, done
    return found


def test_a_plant_hears_only_its_bus(tmp_path: Path) -> None:
    rig = load_rig(motors(tmp_path, 3, 1))
    plans = {role: plan(rig, role, "real") for role in rig.roles}
    assert plans["executive"].below == {"SYNC_2", "CMD_3", "FB_3", "HB_PLANT_3"}
    described = [block.description["frames"].values() for block in VirtualRun(rig, None).blocks]
    heard = dict(zip(rig.roles, map(set, described), strict=True))
    assert "SYNC" in heard["plant_2"] and "SYNC" not in heard["plant_3"]
    assert plans["plant_3"].receive_ids == [129, 163]


def test_on_a_line_all_frames_take_their_turn(tmp_path: Path) -> None:
    rig = motors(tmp_path, 3)
    words = ["--set", "bus.emulate=500000", "--set", "rate_hz=200", "--json", "--no-figure"]
    done = pcpc("simulate", str(rig), *words, "-o", str(tmp_path / "run"))
    assert done.code == 0, done
    line = json.loads((tmp_path / "run/line.json").read_text())
    log = logs.read(tmp_path / "run/log.mcap")
    assert [side["bus"] for side in line["sides"]] == list(log.node)
    sent = {role: int((log.node[role].frames["direction"] == 0).sum()) for role in log.node}
    for side in line["sides"]:
        assert 0 <= sent[side["bus"]] - side["sent"] <= 12, (side, sent)
    assert 0.3 < line["load"] < 0.4, line["load"]
    assert main(["replay", str(tmp_path / "run")]) == 0


WRONG: list[tuple[Callable[[str], str], str]] = [
    (lambda text: text.replace("like: plant\n", "like: plants\n", 1), "no plant plants"),
    (lambda text: text.replace("like: plant\n", "like: plant_2\n", 1), "build on each other"),
    (lambda text: text.replace("node: PLANT_3", "node: PLANT_2"), "PLANT_2 is plant_2"),
    (lambda text: text.replace("node: PLANT_3", "node: PLANT_7"), "node PLANT_7: not in the DBC"),
    (lambda text: text.replace("plant_3:", "plant_17:"), "plant_17: unknown key"),
    (lambda text: text + "plant: {bus: {channel: vcan4}}\nplant_2: {bus: {channel: vcan5}}\n",
     "plant_2"),
    (lambda text: text + "faults: {f: {kind: stall, node: plant_2}}\n", "a rig of two nodes"),
    (lambda text: text + "faults: {f: {kind: flood, node: plant_4}}\n", "no node plant_4"),
]  # fmt: skip


@pytest.mark.parametrize("case", range(len(WRONG)))
def test_what_cannot_be_is_said_with_its_place(case: int, tmp_path: Path) -> None:
    change, said = WRONG[case]
    path = motors(tmp_path, 3)
    path.write_text(change(path.read_text()))
    with pytest.raises(UserError) as error:
        rig = load_rig(path)
        for role in rig.roles:
            plan(rig, role, "real")
    assert said in str(error.value) and "motors." in str(error.value), error.value


def test_a_third_bus_a_shared_frame_and_a_plant_without_heartbeat_are_named(tmp_path: Path) -> None:
    path = motors(tmp_path, 3, more="plant: {bus: {channel: vcan4}}\n")
    text = path.read_text().replace("node: PLANT_2", "node: PLANT_2\n  bus: {channel: vcan5}")
    path.write_text(text)
    with pytest.raises(RigError, match=r"plant_2\.bus: differs from plant\.bus; a rig has two"):
        load_rig(path)
    path.write_text(text.replace("plant: {bus: {channel: vcan4}}\n", ""))
    with pytest.raises(RigError, match="frame HB_EXEC is on both buses"):
        plan(load_rig(path), "executive", "real")
    path = motors(tmp_path, 3)
    database = tmp_path / "motors.dbc"
    beat = 'HB_PLANT_3: 1 PLANT_3\n SG_ nmt_state : 0|8@1+ (1,0) [0|255] "" '
    database.write_text(database.read_text().replace(f"{beat}EXEC", f"{beat}PLANT"))
    with pytest.raises(RigError, match=r"plant_3\.node: PLANT_3 sends no heartbeat that EXEC"):
        plan(load_rig(path), "executive", "real")


def test_two_buses_are_no_line(tmp_path: Path) -> None:
    rig = load_rig(motors(tmp_path, 3, 1), settings=["bus.emulate=1M"])
    with pytest.raises(RigError, match="second bus; only one can be emulated"):
        in_memory(rig)


def test_a_setting_of_a_block_is_that_of_all_plants_a_path_that_of_one(tmp_path: Path) -> None:
    path = motors(tmp_path, 3)
    settings = ["motor.coulomb_Nm=0.005", "plant_3.blocks.motor.parameters.coulomb_Nm=0.001"]
    rig = load_rig(path, settings=settings)
    values = [rig.nodes()[role].blocks[0].settings["coulomb_Nm"] for role in rig.config.plants]
    assert values == [0.005, 0.005, 0.001]
    again = load_rig(path, text=rig.resolved())
    assert again.resolved() == rig.resolved() and list(again.roles) == list(rig.roles)


def test_a_generated_device_is_the_executive_of_all(tmp_path: Path, capsys: Capture) -> None:
    rig = motors(tmp_path, 3)
    assert main(["generate", "c", str(rig), "--device", "-o", str(tmp_path / "c")]) == 0
    subprocess.run(["make", "-s", "-C", str(tmp_path / "c")], check=True)
    words = [
        "run",
        "--only=plant",
        str(rig),
        "--pacing",
        "lockstep",
        "-o",
        str(tmp_path / "run"),
        "--no-figure",
    ]
    words += ["--set", "duration_s=0.3"]
    done = pcpc(*words, "--device", str(tmp_path / "c/linux"), "{bus}")
    assert done.code == 0, done
    assert main(["replay", str(tmp_path / "run")]) == 0
    told = capsys.readouterr().out
    assert told.count("bit-identical") == 4 and "device" in told, told


def test_nine_drives_are_one_master_s_in_virtual_time_on_a_bus_and_replayed(
    tmp_path: Path, capsys: Capture
) -> None:
    rig = drives(tmp_path, 9)
    virtual, _ = both(
        rig, tmp_path, "duration_s=0.2", "controller.until_s=0.15", "controller.wanted_rad_s=20"
    )
    for i, (role, node) in enumerate(list(virtual.node.items())[1:]):
        speed = node.columns["motor.speed_rad_s"][145]
        assert abs(speed * (i + 1) / 20.0 - 1.0) < 0.1, (role, speed)
        assert node.columns["drive.statusword"].astype(int)[145] & 0x6F == 0x27
    assert main(["replay", str(tmp_path / "bus")]) == 0
    assert capsys.readouterr().out.count("bit-identical") == 10


def test_one_drive_of_several_moves_as_alone(tmp_path: Path) -> None:
    found: dict[int, Any] = {}
    for count in (1, 3):
        (folder := tmp_path / str(count)).mkdir()
        found[count] = in_memory(load_rig(drives(folder, count))).node["plant"]
    assert equal(found[1], found[3], "motor.") and equal(found[1], found[3], "drive.")


def test_a_plant_of_several_is_started_alone_and_a_wrong_name_is_named(tmp_path: Path) -> None:
    rig = drives(tmp_path, 3)
    done = pcpc("run", "--only=plant", str(rig), "--node", "plant_4", cwd=tmp_path)
    assert done.code == 2 and "--node plant_4: no such plant" in done.err, done


def test_a_requirement_says_whose_variable_it_is_about(tmp_path: Path) -> None:
    entry = 'require: [{{always: "abs({}motor.encoder_rad) < 1 rad"}}]\n'
    for whose, code, said in (
        ("", 2, "is one of plant, plant_2, plant_3; say whose, as plant_3:motor.encoder_rad"),
        ("plant_2:", 1, "plant_2:motor.encoder_rad) < 1 rad: violated first"),
        ("plant_3:", 0, "ok (1 limit judged)"),
    ):
        rig = motors(tmp_path, 3)
        rig.write_text(rig.read_text().replace("require: null\n", entry.format(whose)))
        words = ["--set", "duration_s=0.5", "--no-figure", "--set", "reference_3.amplitude_rad=0.9"]
        done = pcpc("simulate", str(rig), *words, "-o", str(tmp_path / f"run{code}"))
        assert done.code == code and said in " ".join((done.out + done.err).split()), done


@pytest.mark.parametrize(("change", "said"), [
    (("node: 6,", "node: 5,"), "plant_2.drive.node: 0x085 is an id of plant on this bus"),
    (('"1803.1": 1158', '"1803.1": 1157'), "0x485 is an id of plant"),
    (('"1403.1": 1286', '"1403.1": 1285'), ""),  # one order to two drives
    (("node: 6,", "node: 66,"), "0x742 is an id of plant_2 on this bus"),
])  # fmt: skip
def test_two_plants_never_send_one_id_on_a_bus(
    change: tuple[str, str], said: str, tmp_path: Path
) -> None:
    """In virtual time they do not hear each other: nothing else would tell."""
    path = drives(tmp_path, 3)
    text = path.read_text()
    assert change[0] in text
    path.write_text(text.replace(*change))
    if not said:
        plan(load_rig(path), "plant_2", "real")
        return
    with pytest.raises(RigError, match=r"drive\.node") as error:
        plan(load_rig(path), "plant_3", "real")
    assert said in str(error.value), error.value
