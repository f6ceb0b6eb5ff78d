"""Recorded runs recomputed from their log alone, bit for bit, through the command."""

import os
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest
from json_schemas import holds
from processes import PATIENT, RIGS, ROOT, Running, own_bus, pcpc, until
from replays import replayed

from pcpc.executive.log import reader as logs
from pcpc.executive.log.mcap_records import MAGIC, RECORD
from pcpc.executive.nodes.virtual import VirtualRun, simulate
from pcpc.executive.rig.reading import load_rig

ENGAGED = ("duration_s=0.5", "schedule=[{at_s: 0.2, set: {controller.network_on: 1.0}}]")


def replay(log: Path, *words: str) -> tuple[int, dict[str, dict[str, Any]]]:
    """Return exit code and verdict by node of `pcpc replay --json`."""
    done = pcpc("replay", str(log), "--json", "--quiet", *words)
    assert done.code in (0, 1), done
    return done.code, {verdict["node"]: verdict for verdict in holds("replay", done.out)}


@pytest.fixture(scope="module")
def engaged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a virtual run in which a scheduled tuning engages the network."""
    path = tmp_path_factory.mktemp("engaged") / "log.mcap"
    simulate(load_rig(RIGS / "engage.yaml", settings=ENGAGED), path)
    return path


def test_a_virtual_run_is_recomputed_bit_for_bit(engaged: Path) -> None:
    code, nodes = replay(engaged)
    assert code == 0, nodes
    assert nodes["executive"]["cycles"] == 500
    assert nodes["plant"]["cycles"] == 501
    assert nodes["executive"]["variables"] > 60
    assert nodes["executive"]["frames"] > 2 * 500, "SYNC and CMD of every cycle"
    assert nodes["plant"]["frames"] > 3 * 500


def test_the_log_alone_is_enough(engaged: Path, tmp_path: Path) -> None:
    alone = shutil.copy(engaged, tmp_path / "alone.mcap")
    done = pcpc("replay", str(alone), cwd=tmp_path)
    assert done.code == 0, done
    assert done.out.count("bit-identical") == 2, done


def test_a_gain_a_billionth_off_is_found_in_the_first_cycles(engaged: Path) -> None:
    change = "controller.kv_Nms_rad=110.0000001"
    code, nodes = replay(engaged, "--node", "executive", "--set", change)
    assert code == 1
    first = nodes["executive"]["first"]
    assert first["name"] == "controller.motor_torque_Nm", first
    assert first["cycle"] < 10, first
    assert 0 < first["ulp"] < 1e8, first
    assert {d["name"] for d in nodes["executive"]["differences"]} >= {
        "controller.tau_Nm",
        "tx.CMD.motor_torque",
    }
    assert "reference.q_d_rad" not in {d["name"] for d in nodes["executive"]["differences"]}


def test_another_controller_is_recomputed_in_open_loop(engaged: Path) -> None:
    done = pcpc("replay", str(engaged), "--controller", "pid", "--node", "executive")
    assert done.code == 1, done
    assert "changed, in open loop" in done.out
    assert "controller.motor_torque_Nm" in done.out


@pytest.mark.parametrize("pacing", ["real", "sync", "lockstep"])
def test_a_run_on_a_bus_is_recomputed_with_tunings_that_came_while_it_ran(
    pacing: str, tmp_path: Path
) -> None:
    bus, log = own_bus(), tmp_path / "r" / "log.mcap"
    with Running(
        "run",
        str(RIGS / "engage.yaml"),
        "--bus",
        bus,
        "--pacing",
        pacing,
        "--no-figure",
        "--set",
        "duration_s=60.0",
        "--quiet",
        "-o",
        str(log.parent),
        "--set",
        "schedule=[{at_s: 0.2, set: {controller.network_on: 1.0}}]",
        *PATIENT,
    ) as run:
        block = run.in_the_middle("engage", bus)
        changes = ("controller.kv_Nms_rad=117", "controller.lam_per_s=15")
        tuned = pcpc("set", *changes, "--node", block.name)
        assert tuned.code == 0, tuned
        acknowledged = int(block.answer.cycle)
        until(lambda: block.control.cycle > acknowledged + 300, "300 cycles more")
        os.kill(run.process.pid, signal.SIGINT)
        assert run.done().code == 130
    tunings = {t["name"]: t["value"] for t in logs.read(log).node["executive"].tunings}
    assert tunings["controller.kv_Nms_rad"] == 117.0, tunings
    code, nodes = replay(log)
    assert code == 0, nodes
    assert nodes["executive"]["cycles"] > acknowledged + 300


def test_the_fault_after_the_death_of_the_plant_is_recomputed(tmp_path: Path) -> None:
    bus, log = own_bus(), tmp_path / "r" / "log.mcap"
    with Running(
        "run",
        str(RIGS / "slew10.yaml"),
        "--bus",
        bus,
        "--no-figure",
        "--quiet",
        "-o",
        str(log.parent),
        "--set",
        "supervisor.fault_after_cycles=300",  # a stall is no death
    ) as run:
        run.in_the_middle("slew10", bus)
        os.kill(run.pid("plant"), signal.SIGKILL)
        assert run.done().code == 5
    ends = logs.read(log).node["executive"].columns["supervisor.state"][-1]
    assert ends == 4.0, f"the last cycle of the record is in state {ends}, not in FAULT"
    code, nodes = replay(log, "--node", "executive")
    assert code == 0, nodes


def test_a_controller_from_outside_the_project_comes_from_the_log(tmp_path: Path) -> None:
    outside = tmp_path / "elsewhere"
    outside.mkdir()
    shutil.copy(ROOT / "plants/atb1000/laws/pd.py", outside / "mine.py")
    (outside / "rig.yaml").write_text(
        f"base: {RIGS / 'slew10.yaml'}\nrig: mine\nduration_s: 0.1\n"
        "controllers: {pd: {law: mine.py}}\n"
    )
    log = tmp_path / "log.mcap"
    simulate(load_rig(outside / "rig.yaml"), log)
    shutil.rmtree(outside)
    refused = pcpc("replay", str(log))
    assert refused.code == 2 and "mine.py (sha256 " in refused.err, refused
    code, nodes = replay(log, "--trust")
    assert code == 0, nodes
    assert nodes["executive"]["cycles"] == 100


def test_a_log_that_begins_later_is_refused_with_the_reason(tmp_path: Path) -> None:
    settings = ("duration_s=1.0", "record.keep=200ms", "record.on=tuning",
                "schedule=[{at_s: 0.6, set: {controller.network_on: 1.0}}]")  # fmt: skip
    log = tmp_path / "log.mcap"
    simulate(load_rig(RIGS / "engage.yaml", settings=settings), log)
    done = pcpc("replay", str(log))
    assert done.code == 3, done
    assert "not with the start of the run" in done.out, done


def test_a_cut_log_is_compared_as_far_as_it_goes_and_never_called_different(
    tmp_path: Path,
) -> None:
    tunings = ", ".join(
        f"{{at_s: {0.1 * i}, set: {{controller.gain: {1 + i}}}}}" for i in range(1, 24)
    )
    log, cut = tmp_path / "log.mcap", tmp_path / "cut.mcap"
    probe = load_rig(
        RIGS.parents[1] / "probe/rig.yaml", None, ("duration_s=2.3", f"schedule=[{tunings}]")
    )
    simulate(probe, log)
    data, place, found = log.read_bytes(), len(MAGIC), []
    while place + RECORD.size < len(data):
        place += RECORD.size + RECORD.unpack_from(data, place)[1]
        cut.write_bytes(data[:place])
        try:
            verdicts = replayed(cut)
        except logs.LogError:
            continue  # not even the rig is in it
        wrong = [v.first() for v in verdicts if v.differences]
        assert not wrong, f"cut at byte {place}: {wrong}"
        found += [(v.cycles, v.incomplete) for v in verdicts if v.role == "executive"]
    reached = {cycles for cycles, _ in found}
    assert {0, 2300} < reached, f"{reached}"
    assert not [why for _, why in found if "until -1" in why], found
    assert all("missing" in why or "no cycle" in why for n, why in found if n < 2300), found


def test_a_log_that_was_never_flushed_is_answered_in_a_line(tmp_path: Path) -> None:
    run = VirtualRun(load_rig(RIGS / "slew10.yaml"), tmp_path / "log.mcap")
    assert run.recorder is not None
    run.recorder.writer.file.flush()
    done = pcpc("replay", str(tmp_path / "log.mcap"))
    assert done.code == 3 and done.out.count("no cycle") == 2 and "Traceback" not in done.err, done


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [("supervisor.state", 1e18, "no parameter"), ("controller.e_rad", 0.0, "no parameter"),
     ("controller.kv_Nms_rad", 1e300, "outside"), ("controller.kv_Nms_rad", "nan", "outside")],
)  # fmt: skip
def test_a_made_up_tuning_is_refused(
    name: str, value: Any, why: str, engaged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = {"cycle": 5, "stamp_ns": 5_000_000, "name": name, "value": value}
    original = logs._objects

    def forged(found: Any, topic: str, notes: list[str]) -> list[dict[str, Any]]:
        return [entry] if topic == "/tunings" else original(found, topic, notes)

    monkeypatch.setattr(logs, "_objects", forged)
    with pytest.raises(logs.LogError, match=why):
        replayed(engaged)
