"""`pcpc jitter`: its figures are the log's, its counts are whole, its yardsticks are real loops.

Times are never asserted, only ratios of loops that ran in turn: the machine may be shared.
"""

import dataclasses
import re
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from json_schemas import holds
from logcommand import Done, run_here
from processes import blocks_left, own_bus

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.plan import cycles_of
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.machine.jitter import figures as jitter_figures
from pcpc.tools.machine.jitter import loops as jitter_loops
from pcpc.tools.machine.jitter import probe as jitter_probe
from pcpc.tools.machine.jitter import report as jitter_report
from pcpc.tools.machine.jitter.figures import LEAST_CYCLES, PCPC, JitterResult, percentiles
from pcpc.tools.machine.jitter.loops import JitterError, Setup
from pcpc.tools.terminal.progress import Progress

QUIET = Progress(quiet=True)
LINE = re.compile(
    r"T: ?(\d+) \( *(\d+)\) P: ?(\d+) I:(\d+) C: *(\d+) Min: *(\d+) Act: *(\d+) Avg: *(\d+) "
    r"Max: *(\d+)"
)


def run(*words: str | Path) -> Done:
    """Run the command in this process, without progress."""
    return run_here("jitter", "-q", *words)


_FOLDER = tempfile.TemporaryDirectory()


@cache
def measured() -> tuple[jitter_probe.Probe, logs.Log, Setup]:
    """Return a round of one second at 1 kHz, and its log."""
    setup = Setup(1_000_000, 1000, 80, bus=own_bus())
    folder = Path(_FOLDER.name) / "round"
    folder.mkdir()
    return jitter_probe.run(setup, folder, QUIET, ""), logs.read(folder / "log.mcap"), setup


@cache
def compared() -> tuple[Done, dict[str, Any], bytes]:
    """Return report, JSON and picture of two short rounds against all yardsticks."""
    data, picture = (Path(_FOLDER.name) / name for name in ("jitter.json", "jitter.png"))
    names = ",".join(jitter_loops.NAMES)
    words = ("-D", "1s", "--rounds", "2", "--against", names, "--bus", own_bus(), "-h", "40")
    done = run(*words, f"--json={data}", "--plot", picture)
    assert done.code == 0, done
    return done, holds("jitter", data.read_text()), picture.read_bytes()


def result(probe: jitter_probe.Probe, setup: Setup) -> JitterResult:
    return JitterResult(setup, 1, [probe])


# The figures


def test_every_cycle_of_the_log_is_counted_and_none_else() -> None:
    probe, log, setup = measured()
    executive, plant = probe.nodes["executive"], probe.nodes["plant"]
    assert executive.cycles == len(log.node["executive"].cycle)
    assert plant.cycles == len(log.node["plant"].cycle) - 1, "its first cycle has no deadline"
    assert executive.cycles + executive.missed == setup.periods


def test_percentiles_are_those_of_numpy_on_the_log() -> None:
    probe, log, _ = measured()
    for name, first in (("executive", 0), ("plant", 1)):
        for stage in jitter_probe.STAGES:
            begin = first + (stage == "publish")
            values = log.node[name].timing[f"timing.{stage}_us"][begin:]
            ours = percentiles(probe.nodes[name].stages_us[stage])
            for figure, q in jitter_figures.PERCENTILES.items():
                assert ours[figure] == np.percentile(values, q), f"{name} {stage} {figure}"


def test_late_and_missed_cycles_are_those_that_the_loop_counted() -> None:
    probe, log, setup = measured()
    node, timing = probe.nodes["executive"], log.node["executive"].timing
    late = int(np.count_nonzero(node.late_ns > 0.1 * setup.interval_ns))
    assert node.late == late, f"{node.late} late, {late} in the log"
    tail = setup.periods - 1 - int(log.node["executive"].cycle[-1])
    assert node.missed == int(timing["health.skipped_cycles"][-1]) + tail


def test_the_first_lines_are_those_of_cyclictest() -> None:
    probe, _, setup = measured()
    for number, name in enumerate(("executive", "plant")):
        node = probe.nodes[name]
        line = jitter_report.thread_line(number, node, result(probe, setup))
        match = LINE.fullmatch(line)
        assert match, line
        thread, pid, priority, interval, cycles, low, act, _, high = map(int, match.groups())
        us = node.late_ns // 1000
        assert (thread, pid, interval) == (number, node.pid, 1000), line
        assert priority == ((80, 70)[number] if probe.fifo else 0), line
        assert (cycles, low, act, high) == (node.cycles, us.min(), us[-1], us.max()), line


def test_commands_and_responses_are_those_of_the_frames_in_the_log() -> None:
    probe, log, setup = measured()
    node, paths = log.node["executive"], probe.nodes["executive"].paths_us
    own = node.frames[node.frames["direction"] == 0]
    sent = [(int(f["cycle"]), int(f["id"]), int(f["stamp_ns"])) for f in own]
    held = np.diff(node.timing["health.held_cycles"], prepend=0.0)
    sync_ns, expected, seen = 0, [], list(node.cycle)
    for cycle, word, stamp_ns in sent:
        if word == 0xA0 and cycle in seen and not held[seen.index(cycle)]:
            expected.append((cycle, 1e-3 * (stamp_ns - sync_ns)))
        sync_ns = stamp_ns if word == 0x80 else sync_ns
    fresh = held[1:] == 0
    assert [us for _, us in expected[1:]] == pytest.approx(paths["response"][fresh])
    assert len(paths["wake"]) == len(paths["command"]) == setup.periods
    commands_ns = {cycle: stamp_ns for cycle, word, stamp_ns in sent if word == 0xA0}
    late = node.timing["timing.wake_late_us"]
    for i, cycle in enumerate(node.cycle):
        # as integers: in a float64 the stamps of a machine that runs for days are rounded
        after_us = 1e-3 * (commands_ns[int(cycle)] - int(node.stamp_ns[i]))
        assert paths["command"][i] == pytest.approx(late[i] + after_us)


def test_a_command_that_is_not_in_the_log_is_an_error_not_a_figure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def without_one(stamps: Any, part: logs.NodeLog) -> None:
        command = np.flatnonzero(part.frames["id"] == 0xA0)[5]
        add(stamps, dataclasses.replace(part, frames=np.delete(part.frames, command)))

    add = jitter_probe._add_stamps
    _, _, setup = measured()
    monkeypatch.setattr(jitter_probe, "_add_stamps", without_one)
    with pytest.raises(JitterError, match="frames are not in the log") as caught:
        jitter_probe.read(Path(_FOLDER.name) / "round" / "log.mcap", setup, {})
    assert caught.value.code == 3


def test_a_cycle_that_is_not_in_the_log_is_an_error_not_a_figure(tmp_path: Path) -> None:
    measured()
    whole = (Path(_FOLDER.name) / "round" / "log.mcap").read_bytes()
    damaged = tmp_path / "log.mcap"
    half = len(whole) // 2
    damaged.write_bytes(whole[:half] + bytes(64) + whole[half + 64 :])
    with pytest.raises(JitterError, match="the log is incomplete") as caught:
        jitter_probe.read(damaged, measured()[2], {})
    assert caught.value.code == 3


# The histograms


def test_counts_and_overflows_of_the_histogram_sum_to_the_cycles() -> None:
    probe, _, _ = measured()
    late = {name: node.stages_us["wake_late"] for name, node in probe.nodes.items()}
    lines = list(jitter_report.full_histogram(late, 20))
    rows = [line.split() for line in lines if line[:1].isdigit()]
    assert [int(row[0]) for row in rows] == list(range(20))
    totals = next(line.split()[2:] for line in lines if line.startswith("# Total:"))
    over = next(line.split()[3:] for line in lines if line.startswith("# Histogram Overflows:"))
    for i, node in enumerate(probe.nodes.values()):
        counted = sum(int(row[1 + i]) for row in rows)
        assert counted == int(totals[i]), f"{counted} in lines, {totals[i]} in total"
        assert counted + int(over[i]) == node.cycles, f"{counted} + {over[i]} of {node.cycles}"


def test_a_latency_falls_into_its_whole_microsecond_as_with_cyclictest() -> None:
    lines = list(jitter_report.full_histogram({"a": np.array([0.9, 1.0, 1.999, 3.0])}, 3))
    assert lines[1:4] == ["000000 000001", "000001 000002", "000002 000000"]
    assert lines[-1] == "# Histogram Overflows: 00001"


def test_the_short_histogram_holds_every_cycle() -> None:
    values = measured()[0].nodes["executive"].stages_us["wake_late"]
    counts = [int(x.split()[3]) for x in jitter_report.short_histogram(values) if ".." in x]
    assert sum(counts) == len(values), counts


# The comparison


def test_json_holds_every_loop_round_and_count() -> None:
    _, data, _ = compared()
    assert {
        "interval_us", "periods_per_round", "rounds", "priority", "cpus", "bus", "interrupted",
        "fifo", "absent", "kernel", "clock_source", "machine", "nodes", "loops", "histogram_us",
        "per_round", "ratio", "nines_us", "limits",
    } == set(data)  # fmt: skip
    assert (data["interval_us"], data["periods_per_round"], data["rounds"]) == (1000.0, 500, 2)
    assert {*data["loops"], *data["absent"]} == {PCPC, *jitter_loops.NAMES}
    for name, figures in data["loops"].items():
        each = [one["loops"][name]["cycles"] for one in data["per_round"]]
        assert len(each) == 2 and sum(each) == figures["cycles"], f"{name}: {each}, {figures}"
        assert sum(data["histogram_us"][name].values()) == figures["cycles"], name
        assert figures["cycles"] <= 1000 and set(figures) == {*jitter_figures.PERCENTILES, "cycles"}
    executive = data["nodes"]["executive"]
    assert executive["cycles"] + executive["missed"] == 1000
    for name, found in data["ratio"].items():
        for figure in jitter_figures.COMPARED:
            own, other = (
                [one["loops"][n][figure] for one in data["per_round"]] for n in (PCPC, name)
            )
            assert found[figure]["rounds"] == [a / b for a, b in zip(own, other, strict=True)]


def test_the_report_names_every_loop_and_what_is_absent() -> None:
    done, data, _ = compared()
    for name in data["loops"]:
        for figure in jitter_figures.COMPARED:
            assert re.search(rf"^{name} +{figure} +[\d.]+", done.out, re.MULTILINE), done.out
    assert len(LINE.findall(done.out)) == 2, done.out
    for text in data["absent"].values():
        assert text in done.err


def test_a_picture_is_drawn() -> None:
    assert compared()[2].startswith(b"\x89PNG")


def test_nothing_is_left_of_a_measurement() -> None:
    assert blocks_left(str(compared()[1]["bus"])) == []


def test_a_ratio_is_taken_within_its_round_and_needs_both_loops() -> None:
    theirs = [np.arange(1.0, 101.0), np.arange(1.0, 101.0), np.arange(1.0, 101.0)]
    ours = [2.0 * theirs[0], 4.0 * theirs[1], theirs[2][: LEAST_CYCLES - 1]]
    found = jitter_figures.ratios(ours, theirs)
    for figure in jitter_figures.COMPARED:
        assert found[figure] == jitter_figures.Ratio(3.0, 2.0, 4.0, [2.0, 4.0])
    assert jitter_figures.ratios([], theirs) == {}


@pytest.mark.parametrize("interval_us", [50, 51, 62, 125, 333, 999, 1000, 3003, 1_000_000])
def test_the_rig_runs_exactly_the_interval_and_the_periods(interval_us: int) -> None:
    setup = Setup(1000 * interval_us, 12345, 80)
    rig = load_rig(jitter_probe.RIG, None, jitter_probe.settings_of(setup), resolve=False)
    assert rig.config.period_ns == setup.interval_ns
    assert cycles_of(rig) == setup.periods


def test_processors_go_to_executive_and_plant_in_turn() -> None:
    assert "realtime.executive.cpu=3" in jitter_probe.settings_of(Setup(1_000_000, 10, 80, (3, 5)))
    assert "realtime.plant.cpu=5" in jitter_probe.settings_of(Setup(1_000_000, 10, 80, (3, 5)))
    assert "realtime.plant.cpu=3" in jitter_probe.settings_of(Setup(1_000_000, 10, 80, (3,)))


def test_the_lag_settles_where_its_loop_gain_says() -> None:
    log = in_memory(load_rig(jitter_probe.RIG, None, ["duration_s=1.0"]))
    position = log.node["plant"].columns["lag.position"]
    assert abs(position[-1] - 0.8) < 1e-3, f"{position[-1]:.6f}"
