"""`pcpc branch`: the road not taken, from a cycle of a log on.

The oracle of a change is a fresh simulation whose rig has the change in its schedule: it shares
the loop with the branch, but neither the recomputation nor the cycle at which it is left.
"""

import json
import random
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from below_local import below_local
from logcommand import Done, run_here
from processes import RIGS, ROOT, pcpc

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import VirtualRun, simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.branch.branching import frames_until, sender_cycle

ALL_RIGS = sorted(ROOT.glob("plants/*/rigs/*.yaml"))
FAULTS = {
    "stuck": "kind: stuck, at: controller.hub_rate_rad_s",
    "bias": "kind: bias, at: controller.encoder_rad, value: 0.001",
    "gone": "kind: loss, frame: CMD, share: 0.3, from: 200ms, for: 100ms",
    "late": "kind: delay, frame: FB_A, value: 2",
}


def record(path: Path) -> dict[str, Any]:
    """Return what counts of a log, by node: rows' bits, frames, tunings."""
    found: dict[str, Any] = {}
    for role, node in logs.read(path).node.items():
        table = np.stack([node.cycle, *(x.view(np.int64) for x in node.columns.values())])
        frames = Counter(
            (int(f["cycle"]), int(f["id"]), int(f["dlc"]), int(f["direction"]), int(f["e2e"]),
             f["data"].tobytes())
            for f in node.frames
        )  # fmt: skip
        tunings = [(t["cycle"], t["name"], t["value"]) for t in node.tunings]
        found[role] = table.tobytes(), frames, tunings
    return found


def branch(log: Path, out: Path, *words: str) -> Done:
    return run_here("branch", log, "-o", out, "--no-figure", "--quiet", *words)


def branched(log: Path, out: Path, *words: str) -> Path:
    """Return the log of a branch."""
    done = branch(log, out, *words)
    assert done.code in (0, 1), done
    return out / "log.mcap"


def simulated(path: Path, rig: str, *settings: str, controller: str | None = None) -> Path:
    (file,) = [one for one in ALL_RIGS if one.stem == rig]
    simulate(load_rig(file, controller, settings), path)
    return path


def faulty(folder: Path, name: str, **more: str) -> Path:
    """Return the log of a rig with faults, some of which have `more` keys."""
    faults = "".join(f"  {one}: {{{what}{more.get(one, '')}}}\n" for one, what in FAULTS.items())
    rig = folder / f"{name}.yaml"
    rig.write_text(f"base: {RIGS / 'engage.yaml'}\nduration_s: 0.6\nfaults:\n{faults}")
    simulate(load_rig(rig), path := folder / f"{name}.mcap")
    return path


def cycles(count: int, last: int, seed: str) -> list[int]:
    """Return cycles in which to branch: the first ones, the last, and `count` at random."""
    drawn = random.Random(seed)
    return [1, 2, 3, last, *(drawn.randrange(4, last) for _ in range(count))]


@pytest.mark.parametrize("rig", ["engage", "telerobot-u1"])
def test_a_run_in_lockstep_goes_on_with_its_bits(rig: str, tmp_path: Path) -> None:
    done = pcpc(
        "run",
        rig,
        "--pacing",
        "lockstep",
        "--set",
        "duration_s=0.4",
        "--no-figure",
        "--quiet",
        "-o",
        str(tmp_path / "a"),
    )
    assert done.ran, done
    parent = tmp_path / "a/log.mcap"
    for n in (1, 2, 173):
        new = branched(parent, tmp_path / f"b{n}", "--cycle", str(n))
        for role, (rows, frames, _) in record(parent).items():
            assert record(new)[role][0] == rows, (role, n)
            assert record(new)[role][1] == frames, (role, n)


@pytest.mark.parametrize("rig", ["engage", "telerobot-u1"])
def test_a_paced_run_goes_on_from_its_bits_and_can_be_replayed(rig: str, tmp_path: Path) -> None:
    """What it went on from is in the log; when frames come afterwards is the machine's affair."""
    done = pcpc(
        "run",
        rig,
        "--pacing",
        "real",
        "--set",
        "duration_s=0.5",
        "--no-figure",
        "--quiet",
        "-o",
        str(tmp_path / "a"),
    )
    parent = tmp_path / "a/log.mcap"
    before = logs.read(parent).node["executive"]
    if 240 not in before.cycle[2:-2]:
        pytest.fail(f"the machine did not come to cycle 240: {done}")
    first = branched(parent, tmp_path / "b", "--cycle", "240")
    again = branched(first, tmp_path / "c", "--cycle", "120")
    later = branched(first, tmp_path / "d", "--cycle", "300")
    for path, n in ((first, 239), (again, 119), (later, 239)):
        rows, old = logs.read(path).node["executive"], before.cycle < n
        for name, values in before.columns.items():
            new = rows.columns[name][rows.cycle < n]
            assert new.tobytes() == values[old].tobytes(), (path, name)
        assert run_here("replay", path, "--quiet").code == 0, path
    assert record(later) == record(first)
    behind = run_here("branch", parent, "--cycle", "99999", "-o", tmp_path / "e", "--quiet")
    assert behind.code == 2 and "is not there, the log ends with cycle" in behind.err, behind


def test_a_cycle_far_before_the_end_of_a_paced_run_is_found(tmp_path: Path) -> None:
    done = pcpc(
        "run",
        "engage",
        "--set",
        "duration_s=6",
        "--no-figure",
        "--quiet",
        "-o",
        str(tmp_path / "a"),
    )
    tried = [
        branch(tmp_path / "a/log.mcap", tmp_path / f"b{n}", "--cycle", str(n))
        for n in (600, 610, 620)
    ]
    assert any(one.code in (0, 1) for one in tried), (done, tried)


def test_a_change_is_what_the_same_change_in_the_schedule_is(tmp_path: Path) -> None:
    parent = simulated(tmp_path / "log.mcap", "engage", "duration_s=1")
    new = branched(parent, tmp_path / "b", "--cycle", "400", "--set", "controller.kv_Nms_rad=150")
    planned = simulated(
        tmp_path / "s.mcap",
        "engage",
        "duration_s=1",
        "schedule=[{at_s: 0.4, set: {controller.kv_Nms_rad: 150}}]",
    )
    assert record(new) == record(planned)
    first = np.flatnonzero(_torque(new) != _torque(parent))[0]
    assert first == 400
    assert run_here("replay", new, "--quiet").code == 0


def test_the_sender_of_a_frame_that_repeats_is_the_last_one_before_it() -> None:
    sent = np.zeros(48, logs.FRAME)
    sent["cycle"], sent["stamp_ns"], sent["id"] = np.arange(48), 1000 * np.arange(48), 0x120
    sent["data"][:, 0] = np.arange(48) % 16  # a plant at rest: only its counter changes
    frame = sent[20].copy()
    frame["stamp_ns"] += 300
    assert sender_cycle(frame, sent, None) == 20
    assert [sender_cycle(frame, sent, near) for near in (6, 19, 27, 40)] == [4, 20, 20, 36]
    frame["data"][1] = 1
    assert sender_cycle(frame, sent, None) == -1


@pytest.mark.parametrize("last", [98, 99, 100, 101])
def test_frames_of_a_cycle_are_found_wherever_a_piece_of_the_log_ends(
    last: int, hull: Path
) -> None:
    whole, parts = logs.read(hull), []
    for first, past in ((0, last + 1), (last + 1, 1000)):
        nodes = dict(whole.node)
        for role, node in nodes.items():
            cycle = node.frames["cycle"]
            nodes[role] = replace(node, frames=node.frames[(first <= cycle) & (cycle < past)])
        parts.append(replace(whole, node=nodes))
    found = frames_until(parts, [*whole.node], 100)
    for role, node in whole.node.items():
        both = [rows[abs(rows["cycle"] - 100) < 2] for rows in (found[role], node.frames)]
        assert len(both[1]) and both[0].tobytes() == both[1].tobytes(), role


def test_a_parameter_of_the_plant_changes_in_its_own_cycle(hull: Path, tmp_path: Path) -> None:
    change = "plant:barrel.coulomb_Nm=4"
    new = logs.read(branched(hull, tmp_path / "b", "--cycle", "100", "--set", change)).node["plant"]
    (tuning,) = new.tunings
    assert (tuning["cycle"], tuning["name"], tuning["value"]) == (100, "barrel.coulomb_Nm", 4.0)
    old = logs.read(hull).node["plant"]
    unequal = [np.flatnonzero(x != new.columns[name]) for name, x in old.columns.items()]
    assert min(at[0] for at in unequal if len(at)) in (100, 101), "acts in the step to the next"


def _torque(path: Path) -> np.ndarray[Any, Any]:
    return logs.read(path).node["executive"].columns["controller.motor_torque_Nm"]


def test_a_fault_and_its_length_are_those_of_the_rig_in_that_cycle(tmp_path: Path) -> None:
    parent = faulty(tmp_path, "log")
    for n in cycles(2, 599, "faults"):  # 200 to 300 has lost frames
        new = branched(parent, tmp_path / f"b{n}", "--cycle", str(n))
        assert record(new) == record(parent), n
    new = branched(
        parent, tmp_path / "b", "--time", "0.25", "--fault", "stuck:100ms", "--fault", "late:0.05s"
    )
    planned = faulty(
        tmp_path, "s", stuck=", from: 250ms, for: 100ms", late=", from: 250ms, for: 50ms"
    )
    for role, (rows, *_) in record(planned).items():
        assert record(new)[role][0] == rows, role


def test_a_controller_takes_over_as_from_standby(tmp_path: Path) -> None:
    parent = simulated(tmp_path / "log.mcap", "engage", "duration_s=0.6")
    new = branched(parent, tmp_path / "b", "--cycle", "300", "--controller", "pid")
    planned = simulated(
        tmp_path / "s.mcap",
        "engage",
        "duration_s=0.6",
        "standby=[pid]",
        "schedule=[{at_s: 0.3, handover: pid}]",
    )
    for role, (rows, *_) in record(planned).items():
        assert record(new)[role][0] == rows, role


def test_later_tunings_of_the_log_come_as_they_did(tmp_path: Path) -> None:
    parent = simulated(
        tmp_path / "log.mcap",
        "engage",
        "duration_s=0.6",
        "schedule=[{at_s: 0.2, set: {controller.network_on: 1.0}}, "
        "{at_s: 0.5, set: {controller.kv_Nms_rad: 120}}]",
    )
    for n in (100, 200, 201, 202, 203, 500, 550):
        assert record(branched(parent, tmp_path / f"b{n}", "--cycle", str(n))) == record(parent), n


def test_what_the_rig_begins_behind_the_end_of_its_log_comes_in_a_branch(tmp_path: Path) -> None:
    """A fault and a tuning, of a run that a stop ended before them."""
    rig = tmp_path / "rig.yaml"
    rig.write_text(f"""base: {RIGS / "engage.yaml"}
duration_s: 0.6
faults: {{stuck: {{{FAULTS["stuck"]}, from: 400ms, for: 20ms}}}}
schedule: [{{at_s: 0.5, set: {{controller.kv_Nms_rad: 120}}}}]
""")
    simulate(load_rig(rig), whole := tmp_path / "whole.mcap")
    run = VirtualRun(load_rig(rig), short := tmp_path / "short.mcap")
    run._at_once = 300
    for _ in run.advance():
        run.stop()
    run.close()
    assert logs.read(short).node["executive"].cycle[-1] < 399
    assert record(branched(short, tmp_path / "b", "--cycle", "200")) == record(whole)


def test_a_branch_of_a_branch_and_a_longer_run(tmp_path: Path) -> None:
    parent = simulated(tmp_path / "log.mcap", "hull", "duration_s=0.3")
    first = branched(parent, tmp_path / "b", "--cycle", "100", "--set", "controller.kv_Nms_rad=150")
    again = branched(first, tmp_path / "c", "--cycle", "200")
    assert record(again) == record(first)
    longer = branched(parent, tmp_path / "d", "--cycle", "250", "--duration", "0.5s")
    assert record(longer) == record(simulated(tmp_path / "s.mcap", "hull", "duration_s=0.5"))


def test_a_run_that_waits_for_its_operator_and_one_that_was_stopped(tmp_path: Path) -> None:
    schedule = "schedule=[{at_s: 0.1, set: {supervisor.disarmed: 0}}]"
    parent = simulated(
        tmp_path / "log.mcap", "hull", "duration_s=0.4", "supervisor.arm=manual", schedule
    )
    for n in (50, 100, 101, 200):
        assert record(branched(parent, tmp_path / f"b{n}", "--cycle", str(n))) == record(parent), n


def test_a_branch_says_of_what_it_is_one(tmp_path: Path) -> None:
    parent = simulated(tmp_path / "log.mcap", "hull", "duration_s=0.3")
    done = branch(parent, tmp_path / "b", "--cycle", "100", "--set", "controller.kv_Nms_rad=150")
    what = f"branch at cycle 100 of {tmp_path.name}/log.mcap"
    assert "branch at cycle 100 of" in done.out, done
    told = json.loads((tmp_path / "b/summary.json").read_text())
    assert told["changed"][0] == what
    assert "controller.kv_Nms_rad=150" in told["changed"]
    page = tmp_path / "b/report.html"
    assert run_here("report", tmp_path / "b", "-o", page).code in (0, 1)
    assert "no run: a branch at cycle 100" in page.read_text()
    done = run_here("report", "--suite", tmp_path / "b", "-o", tmp_path / "suite.html")
    assert done.code == 1, "a suite takes no branch for a run"
    assert "no run: a branch at cycle 100" in (tmp_path / "suite.html").read_text()


@pytest.fixture(scope="module")
def hull(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hull") / "log.mcap"
    return simulated(path, "hull", "duration_s=0.3", controller="pd_nn_fast")


def test_a_damaged_a_foreign_and_a_changed_log_are_refused(hull: Path, tmp_path: Path) -> None:
    data = hull.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    done = branch(tmp_path / "cut.mcap", tmp_path / "out", "--cycle", "290")
    assert done.code in (2, 3), done
    assert "cycle" in done.err, done
    (tmp_path / "no.mcap").write_bytes(b"no log")
    assert branch(tmp_path / "no.mcap", tmp_path / "out", "--cycle", "5").code in (2, 3)
    assert branch(tmp_path / "nix.mcap", tmp_path / "out", "--cycle", "5").code == 2
    assert not (tmp_path / "out").exists()


def test_damage_behind_the_cycle_is_no_ok(hull: Path, tmp_path: Path) -> None:
    """A tuning may have been in what is gone."""
    (tmp_path / "cut.mcap").write_bytes(hull.read_bytes()[:-2000])
    done = branch(tmp_path / "cut.mcap", tmp_path / "out", "--cycle", "20")
    assert done.code == 3, done
    assert "cut.mcap:thesummaryattheend" in "".join(done.out.split()), done
    assert json.loads((tmp_path / "out/summary.json").read_text())["verdict"] == "loss"


def test_a_row_that_the_laws_do_not_give_is_refused_with_cycle_and_name(
    hull: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pcpc.executive.nodes import replay, slices

    true = replay.Replay.advance

    def changed(self: Any, part: Any, names: Any) -> Any:
        if "controller.motor_torque_Nm" in names:
            place = slices.HEAD + list(names).index("controller.motor_torque_Nm")
            part.rows[part.rows[:, slices.K] == 57, place] += 1
        return true(self, part, names)

    monkeypatch.setattr(replay.Replay, "advance", changed)
    done = branch(hull, tmp_path / "out", "--cycle", "200")
    assert done.code == 2, done
    assert "controller.motor_torque_Nm in cycle 57 is recorded as" in done.err
    assert not (tmp_path / "out").exists()


@pytest.mark.deep
def test_what_a_drive_sent_to_a_local_node_is_there_in_a_branch(tmp_path: Path) -> None:
    """It comes behind the frame that starts the local node's cycle, so it waits for the next."""
    rig, log = below_local(tmp_path, "tests/drivers/robots/odrive.yaml"), tmp_path / "log.mcap"
    simulate(load_rig(rig), log)
    for cycle in (3, 77, 300):
        out = branched(log, tmp_path / str(cycle), "--cycle", str(cycle))
        assert record(out) == record(log), cycle
    done = branch(log, tmp_path / "bus", "--cycle", "77", "--bus", "udp_multicast")
    assert done.code == 2 and "wait at the local node" in done.err, done
