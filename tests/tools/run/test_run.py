"""`pcpc run`, `exec`, `plant`, `simulate` end to end: the log, the summary, every way to end."""

import json
import os
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from processes import DEADLINE_S, RIGS, Running, blocks_left, own_bus, pcpc, until

from pcpc.drivers.machine import claim
from pcpc.executive.log import reader as logs
from pcpc.executive.log.schemas import field_names
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

SLEW10 = str(RIGS / "slew10.yaml")
RIGS_OF_EACH_KIND = ("firetrack", "hull")  # all others: tests/contract
SHORT = "duration_s=1.2"  # steps begin at 0.5 s, the gun fires at 1 s
LONG = "duration_s=3600"
TOPICS = [
    f"{node}/{kind}"
    for kind in ("state", "can/frames", "events", "tunings")
    for node in ("", "/plant")
]
PATIENT = ("supervisor.hold_cycles=100000", "supervisor.fault_after_cycles=100000")
ALERT = ("supervisor.fault_after_cycles=300", "supervisor.ramp_s=0.01")
INPUT_MISSING = "no valid input frame for the rig's limit of cycles"
PNG = b"\x89PNG\r\n\x1a\n"


def options(bus: str, pacing: str, *settings: str) -> list[str]:
    """Return the usual options of a run."""
    words = [word for setting in settings for word in ("--set", setting)]
    return ["--bus", bus, "--pacing", pacing, "--json", "--quiet", "--no-figure", *words]


def _untold(words: list[str]) -> list[str]:
    """Return the options of a node that keeps no log."""
    return [word for word in words if word != "--json"]


def payloads(folder: Path) -> list[list[bytes]]:
    return [logs.payloads(folder / "log.mcap", name) for name in TOPICS]


def in_virtual_time(rig: str, folder: Path, settings: Sequence[str]) -> list[list[bytes]]:
    """Return the payloads of both nodes of a virtual run in this process, but for timing."""
    folder.mkdir()
    simulate(load_rig(rig, None, settings), folder / "log.mcap")
    return payloads(folder)


def first_difference(a: list[list[bytes]], b: list[list[bytes]]) -> str:
    """Return "" if both runs hold the same bytes, else where they first differ."""
    for topic, left, right in zip(TOPICS, a, b, strict=True):
        if len(left) != len(right):
            return f"{topic}: {len(left)} and {len(right)} messages"
        for i, (x, y) in enumerate(zip(left, right, strict=True)):
            if x != y:
                return f"{topic}: message {i}"
    return ""


# ---------------------------------------------------------------------------------- the same bytes


@pytest.mark.parametrize("name", RIGS_OF_EACH_KIND)
def test_lockstep_on_the_bus_and_virtual_time_give_the_same_bytes(
    name: str, tmp_path: Path
) -> None:
    rig, bus = str(RIGS / f"{name}.yaml"), own_bus()
    done = pcpc("run", rig, "-o", str(tmp_path / "bus"), *options(bus, "lockstep", SHORT))
    assert done.ran, str(done)
    wanted = in_virtual_time(rig, tmp_path / "virtual", [SHORT])
    assert [len(topic) for topic in wanted[:2]] == [1200, 1201], [len(topic) for topic in wanted]
    different = first_difference(payloads(tmp_path / "bus"), wanted)
    assert not different, f"{name}: {different}\n{done}"
    assert done.summary["records"] == {"written": 2401, "dropped": 0}, str(done)
    assert 0.0 < done.summary["start_to_first_cycle_s"] < DEADLINE_S, str(done)
    compared = pcpc(
        "compare", "--bits", str(tmp_path / "virtual"), str(tmp_path / "bus"), "--json", "-"
    )
    assert compared.code == 0 and compared.summary["equal"], str(compared)
    has_virtual_time(tmp_path / "bus" / "log.mcap")
    assert blocks_left(bus) == [], blocks_left(bus)


def has_virtual_time(path: Path) -> None:
    """Assert that a log is stamped k T from its start, and keeps wall time beside that."""
    log = logs.read(path)
    facts = log.metadata["plant"]
    assert facts["clock_wall_ns"] == log.metadata["executive"]["clock_wall_ns"], facts
    for node in log.node.values():
        assert node.stamp_ns.tolist() == (node.cycle * 1_000_000).tolist()
        at_most = (node.frames["cycle"] * 1_000_000 - node.frames["stamp_ns"]).max()
        assert at_most == 0, f"a frame is stamped {at_most} ns before its cycle"
        wall_s = node.timing["timing.wall_s"] - 1e-9 * int(facts["clock_wall_ns"])
        assert 0.0 <= wall_s[0] < wall_s[-1] < DEADLINE_S, wall_s
        assert (np.diff(wall_s) >= 0.0).all(), wall_s
    report = pcpc("log", "info", str(path), "--json").summary
    assert report["duration_s"] == pytest.approx(1.199), report["duration_s"]


def test_repeated_commands_give_the_same_bytes(tmp_path: Path) -> None:
    rig, found = str(RIGS / "hullrand.yaml"), {}
    for name in ("run1", "run2", "simulate1", "simulate2"):
        folder, usual = tmp_path / name, options(own_bus(), "lockstep", SHORT)
        own = usual[4:] if name.startswith("simulate") else usual  # no bus, no pacing
        done = pcpc(name[:-1], rig, "-o", str(folder), *own)
        assert done.ran, str(done)
        found[name] = payloads(folder)
    for name, bytes_found in found.items():
        different = first_difference(bytes_found, found["run1"])
        assert not different, f"{name} is not run1: {different}"


@pytest.mark.parametrize("order", [("plant", "exec"), ("exec", "plant")])
def test_two_terminals_give_the_bytes_of_one(order: tuple[str, str], tmp_path: Path) -> None:
    bus, folder = own_bus(), tmp_path / "two"
    usual = options(bus, "lockstep", SHORT)
    words = {
        "exec": ["run", "--only=executive", SLEW10, "-o", str(folder), *usual],
        "plant": ["run", "--only=plant", SLEW10, *_untold(usual)],
    }
    with Running(*words[order[0]]) as first:
        role = {"exec": "executive", "plant": "plant"}[order[0]]
        block = first.block("slew10", bus, role)
        until(lambda: block.control.ready or first.over(), f"{role} is ready\n{first}")
        with Running(*words[order[1]]) as second:
            done = [second.done(), first.done()]
    assert all(one.ran for one in done), "\n".join(map(str, done))
    wanted = in_virtual_time(SLEW10, tmp_path / "virtual", [SHORT])
    different = first_difference(payloads(folder), wanted)
    assert not different, f"{different}\n" + "\n".join(map(str, done))
    assert blocks_left(bus) == [], blocks_left(bus)


def test_settings_take_effect(tmp_path: Path) -> None:
    usual = in_virtual_time(SLEW10, tmp_path / "usual", [SHORT])
    for i, setting in enumerate(
        (
            "seed=2",
            "controller.kv_Nms_rad=120.0",
            "barrel.tip_mass_kg=0.2",
            "rate_hz=500",
            "duration_s=0.8",
        )
    ):
        changed = in_virtual_time(SLEW10, tmp_path / str(i), [SHORT, setting])
        assert first_difference(changed, usual), f"{setting} changes nothing"


@pytest.mark.parametrize(("rate_hz", "gain"), [(500, 120.0), (2000, 130.0)])
def test_settings_are_in_the_log_and_hold_on_the_bus(
    rate_hz: int, gain: float, tmp_path: Path
) -> None:
    settings = [
        f"rate_hz={rate_hz}", f"controller.kv_Nms_rad={gain}", "seed=7", "duration_s=0.8",
        "barrel.tip_mass_kg=0.2",
    ]  # fmt: skip
    done = pcpc("run", SLEW10, *options(own_bus(), "lockstep", *settings), cwd=tmp_path)
    assert done.ran, str(done)
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name.endswith("Z-slew10"), folder.name
    assert sorted(os.listdir(folder)) == ["log.mcap", "summary.json"], os.listdir(folder)
    wanted = in_virtual_time(SLEW10, tmp_path / "virtual", settings)
    different = first_difference(payloads(folder), wanted)
    assert not different, f"{rate_hz} Hz: {different}\n{done}"
    log = logs.read(folder / "log.mcap")
    resolved = load_rig(SLEW10, text=log.attachments["rig-resolved.yaml"])
    control, plant = resolved.nodes().values()
    found = {
        "rate_hz": resolved.config.rate_hz, "seed": resolved.config.seed,
        "duration_s": resolved.config.duration_s,
        "gain": control.blocks[1].settings["kv_Nms_rad"],
        "tip": plant.blocks[0].settings["tip_mass_kg"],
    }  # fmt: skip
    expected = {"rate_hz": rate_hz, "seed": 7, "duration_s": 0.8, "gain": gain, "tip": 0.2}
    assert found == expected, found
    summary = done.summary
    seen = (summary["rate_hz"], summary["cycles"], summary["seed"])
    assert seen == (rate_hz, round(0.8 * rate_hz), 7), str(done)


# ------------------------------------------------------------------------------ what a run leaves


def test_real_run_leaves_log_summary_and_figure(tmp_path: Path) -> None:
    bus, folder = own_bus(), tmp_path / "run"
    done = pcpc(
        "run",
        SLEW10,
        "-o",
        str(folder),
        "--bus",
        bus,
        "--json",
        "--quiet",
        "--set",
        "duration_s=1.2",
        "--set",
        "evaluation.window_s=[0.2, 1.2]",
        "--set",
        "evaluation.rest_from_s=0.3",
        "--set",
        "evaluation.rest_to_s=0.5",
        "--set",
        PATIENT[0],
        "--set",
        PATIENT[1],
    )
    summary = done.summary
    assert done.code == {"not judged": 1, "loss": 3}[summary["verdict"]], str(done)
    assert json.loads((folder / "summary.json").read_text()) == summary, str(done)
    assert (folder / "figure.png").read_bytes()[:8] == PNG, os.listdir(folder)
    known = {"rig": "slew10", "controller": "pd", "pacing": "real", "bus": bus, "seed": 1}
    assert {key: summary[key] for key in known} == known, str(done)
    assert 1000 < summary["cycles"] <= 1200 and summary["late_cycles"] >= 0, str(done)
    metrics = {
        key: summary["metrics"][key]
        for key in ("muzzle_error_rms_mrad", "muzzle_error_max_mrad", "hub_error_rms_mrad")
    }
    assert all(0.0 < value < 500.0 for value in metrics.values()), metrics
    assert set(summary["frames"]) >= {"sent", "received", "lost", "stale", "crc_errors"}, str(done)
    assert set(summary["records"]) == {"written", "dropped"}, str(done)
    _check_log(folder / "log.mcap", summary)
    assert blocks_left(bus) == [], blocks_left(bus)


def _check_log(path: Path, summary: dict[str, Any]) -> None:
    """Read a log with mcap's own reader: each cycle, both stamps, frames, attachments."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        state = [(m, d) for _, _, m, d in reader.iter_decoded_messages(topics=["/state"])]
        frames = [(m, d) for _, _, m, d in reader.iter_decoded_messages(topics=["/can/frames"])]
        attached = {file.name for file in reader.iter_attachments()}
        notes = {note.name: note.metadata for note in reader.iter_metadata()}
    cycles = np.array([m.sequence for m, _ in state])
    skipped = summary["cycles"] - len(cycles)
    assert (np.diff(cycles) > 0).all(), "cycles are not in order"
    assert cycles[0] == 0 and skipped == summary["skipped_cycles"], (cycles[0], skipped, summary)
    (error,) = field_names(["controller.e_rad"])
    errors = np.array([getattr(d, error) for _, d in state])
    assert errors.any() and np.isfinite(errors).all(), errors
    facts = notes["executive"]
    ahead_ns = int(facts["clock_wall_ns"]) - int(facts["clock_monotonic_ns"])
    stray = [m.log_time - d.stamp_ns for m, d in frames if m.log_time - d.stamp_ns != ahead_ns]
    assert frames and not stray, f"{len(frames)} frames, {len(stray)} of them with odd stamps"
    wall_s = (state[-1][0].log_time - state[0][0].log_time) * 1e-9
    span_s = 0.001 * float(cycles[-1] - cycles[0])
    assert abs(wall_s - span_s) < 0.5, f"{wall_s} s of log time for {span_s} s of cycles"
    directions = {d.direction for _, d in frames}
    assert directions == {0, 1}, directions
    wanted = {"slew10.yaml", "rig.yaml", "rig-resolved.yaml", "atb1000.dbc"}
    assert wanted <= attached, attached


def test_sync_pacing_runs_clean(tmp_path: Path) -> None:
    folder, usual = tmp_path / "run", options(own_bus(), "sync", "duration_s=0.5", *PATIENT)
    done = pcpc("run", SLEW10, "-o", str(folder), *usual)
    assert done.ran, str(done)
    log = logs.read(folder / "log.mcap")
    cycles = {role: len(node.cycle) for role, node in log.node.items()}
    done_cycles = done.summary["cycles"] - done.summary["skipped_cycles"]
    assert cycles == {"executive": done_cycles, "plant": done_cycles + 1}, (cycles, str(done))


def test_folder_that_holds_a_log_is_refused_and_the_log_untouched(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes(b"precious")
    for command in ("run", "exec", "simulate"):
        usual = options(own_bus(), "lockstep")[4 if command == "simulate" else 0 :]
        done = pcpc(command, SLEW10, "-o", str(tmp_path), *usual)
        assert done.code == 2 and "holds a log already" in done.err, str(done)
    assert log.read_bytes() == b"precious" and os.listdir(tmp_path) == ["log.mcap"]


# ------------------------------------------------------------------------------------- early ends


def test_interrupt_ends_a_run_in_order(tmp_path: Path) -> None:
    bus, folder = own_bus(), tmp_path / "run"
    usual = options(bus, "real", LONG, *PATIENT)
    with Running("run", SLEW10, "-o", str(folder), *usual) as running:
        running.in_the_middle("slew10", bus)
        running.process.send_signal(signal.SIGINT)
        done = running.done(20.0)
        assert running.left() == [], running.left()
    assert done.code == 130 and done.summary["verdict"] == "interrupted", str(done)
    log = logs.read(folder / "log.mcap")
    assert log.missing == [] and len(log.node["executive"].cycle) > 100, (log.missing, str(done))
    last = log.node["executive"].events[-1]
    assert last["name"] == "STOP", last
    assert blocks_left(bus) == [], blocks_left(bus)


def test_interrupt_before_the_first_cycle_leaves_nothing(tmp_path: Path) -> None:
    bus, folder = own_bus(), tmp_path / "new" / "run"
    with Running("run", SLEW10, "-o", str(folder), *options(bus, "real", LONG)) as running:
        running.pid("executive")
        running.process.send_signal(signal.SIGINT)
        done = running.done(30.0)
        assert running.left() == [], running.left()
    assert done.code == 130 and "Traceback" not in done.err, str(done)
    assert done.err.endswith("interrupted before a cycle was seen; nothing is recorded\n"), done
    assert os.listdir(tmp_path) == [], os.listdir(tmp_path)
    assert blocks_left(bus) == [], blocks_left(bus)


KILLS = [
    ("executive", "real"), ("plant", "real"), ("recorder", "real"),
    ("executive", "lockstep"), ("recorder", "lockstep"),
]  # fmt: skip


@pytest.mark.quick
@pytest.mark.parametrize(("victim", "pacing"), KILLS)
def test_killed_process_ends_the_others_and_is_named(
    victim: str, pacing: str, tmp_path: Path
) -> None:
    bus, folder = own_bus(), tmp_path / "run"
    log_file = folder / "log.mcap"
    usual = options(bus, pacing, LONG, *ALERT)
    with Running("run", SLEW10, "-o", str(folder), *usual) as running:
        running.in_the_middle("slew10", bus)

        def on_the_disk() -> int:
            return sum(map(len, logs.scan(log_file).pieces_of("/state")))

        until(lambda: on_the_disk() > 50 or running.over(), "records on the disk")
        os.kill(running.pid(victim), signal.SIGKILL)
        done = running.done(20.0)
        assert running.left() == [], running.left()
    assert done.code == 5 and done.summary["verdict"] == "safety stop", str(done)
    faults = "\n".join(done.summary["faults"])
    assert f"{victim}: ended by SIGKILL" in faults, faults
    log = logs.read(log_file)
    assert len(log.node["executive"].cycle) > 50, (log.missing, str(done))
    assert bool(log.missing) == (victim == "recorder"), log.missing
    survivor = {"executive": "plant", "plant": "executive"}.get(victim)
    if pacing == "real" and survivor:
        said = [e["name"] for e in log.node[survivor].events if e["event"] == "fault"]
        assert said == [INPUT_MISSING] and f"{survivor}: {INPUT_MISSING}" in faults, (said, faults)
    assert blocks_left(bus) == [], blocks_left(bus)


@pytest.mark.parametrize("pacing", ["real", "lockstep"])
def test_killed_host_ends_its_processes_and_leaves_a_whole_log(pacing: str, tmp_path: Path) -> None:
    bus, folder = own_bus(), tmp_path / "run"
    usual = options(bus, pacing, LONG, *PATIENT)
    with Running("run", SLEW10, "-o", str(folder), *usual) as running:
        running.in_the_middle("slew10", bus)
        os.kill(running.process.pid, signal.SIGKILL)
        assert running.left() == [], running.left()
    log = logs.read(folder / "log.mcap")
    assert log.missing == [] and len(log.node["plant"].cycle) > 50, log.missing
    assert log.node["executive"].events[-1]["name"] == "STOP", log.node["executive"].events
    assert blocks_left(bus) == [], blocks_left(bus)


def test_bus_of_a_killed_host_is_not_free_before_its_nodes_have_ended(tmp_path: Path) -> None:
    bus = own_bus()

    def seats() -> list[str]:
        return [name for name in claim.held_names("seat/") if f"/{bus}/" in name]

    usual = options(bus, "lockstep", LONG)
    with Running("run", SLEW10, "-o", str(tmp_path / "run"), *usual) as run:
        run.in_the_middle("slew10", bus)
        nodes = [run.pid(role) for role in ("executive", "plant")]
        for node in nodes:
            os.kill(node, signal.SIGSTOP)  # as long as a loaded machine may take to end them
        run.process.kill()
        run.process.wait()
        assert len(seats()) == 2, seats()
        for node in nodes:
            os.kill(node, signal.SIGCONT)
        assert run.left() == [], run.left()
    until(lambda: not seats(), "the seats are free")


def test_host_killed_at_once_leaves_no_process(tmp_path: Path) -> None:
    bus = own_bus()
    usual = options(bus, "real", LONG)
    with Running("run", SLEW10, "-o", str(tmp_path / "run"), *usual) as running:
        for role in ("plant", "executive"):
            running.pid(role)
        os.kill(running.process.pid, signal.SIGKILL)
        assert running.left() == [], running.left()
    assert blocks_left(bus) == [], blocks_left(bus)


@pytest.mark.parametrize("then", ["plant", "recorder"])
def test_executive_killed_at_its_start_is_named(then: str, tmp_path: Path) -> None:
    usual = options(own_bus(), "lockstep", LONG)
    with Running("run", SLEW10, "-o", str(tmp_path / "run"), *usual) as running:
        executive = running.pid("executive")
        running.pid(then)
        os.kill(executive, signal.SIGKILL)
        done = running.done(60.0)
        assert running.left() == [], running.left()
    assert done.code == 5, str(done)
    assert "executive: ended by SIGKILL" in str(done), str(done)


def test_executive_gives_up_a_silent_plant_in_lockstep(tmp_path: Path) -> None:
    bus, folder = own_bus(), tmp_path / "run"
    usual = options(bus, "lockstep", LONG)
    with (
        Running("run", "--only=plant", SLEW10, *_untold(usual)) as plant,
        Running("run", "--only=executive", SLEW10, "-o", str(folder), *usual) as control,
    ):
        plant.pid("plant")
        control.pid("recorder")
        block = control.block("slew10", bus, "executive")
        until(lambda: block["record_taken"][0] > 100 or control.over(), f"it runs\n{control}")
        os.kill(plant.pid("plant"), signal.SIGKILL)
        ends = [plant.done(20.0), control.done(20.0)]
        left = plant.left() + control.left()
    assert left == [], left
    assert [done.code for done in ends] == [5, 5], "\n".join(map(str, ends))
    assert "ended by SIGKILL" in ends[0].err, str(ends[0])
    faults = ends[1].summary["faults"]
    assert len(faults) == 1 and "the other node fell silent" in faults[0], faults
    assert logs.read(folder / "log.mcap").missing == [], str(ends[1])
    assert blocks_left(bus) == [], blocks_left(bus)
