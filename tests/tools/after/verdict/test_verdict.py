"""The verdict speaks of the whole run: whatever was changed, kept, or ended before its time."""

import dataclasses
import json
import math
import os
import signal
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from processes import RIGS, Done, Running, own_bus, pcpc

from pcpc.executive.log import long_logs
from pcpc.executive.log import reader as logs
from pcpc.executive.log.mcap_reader import Scan
from pcpc.executive.log.run_counts import Absences
from pcpc.executive.loop.timing_layout import Stage
from pcpc.executive.nodes.virtual import VirtualRun, in_memory, simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.log.tally import Tally
from pcpc.tools.after.report import sections
from pcpc.tools.after.report.record import ReportedRun
from pcpc.tools.after.verdict import judge as judging
from pcpc.tools.after.verdict import report, summary_file
from pcpc.tools.after.verdict.conclude import conclude
from pcpc.tools.after.verdict.findings import Finding, FindingKind, lines
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.after.verdict.requirements import JudgedRequirement
from pcpc.tools.after.verdict.summary import Summary, summarise
from pcpc.tools.terminal.arguments import RunFolder
from pcpc.tools.terminal.document import Strong

SLEW10, HULL = str(RIGS / "slew10.yaml"), str(RIGS / "hull.yaml")
RELAY = str(Path(__file__).resolve().parents[3] / "executive" / "relay" / "rig.yaml")
PROBE = str(RIGS.parents[1] / "probe" / "rig.yaml")


def virtual(folder: Path, *words: str, rig: str = SLEW10) -> Done:
    """Return what `pcpc simulate --json` came to."""
    return pcpc("simulate", rig, "-o", str(folder), "--json", "--quiet", "--no-figure", *words)


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_a_figure_that_leaves_out_what_is_no_number_is_not_met(wrong: float) -> None:
    rig = load_rig(SLEW10)
    log = in_memory(rig)
    angle = log.node["plant"].columns["barrel.theta_rad"].copy()
    angle[4000:4010] = wrong
    columns = {**log.node["plant"].columns, "barrel.theta_rad": angle}
    plant = dataclasses.replace(log.node["plant"], columns=columns)
    log = dataclasses.replace(log, node=log.node | {"plant": plant})
    found = summarise(rig, log, Outcome("virtual", "memory"))
    assert found.verdict == "expectation not met", found.metrics
    assert "barrel.theta_rad is not a finite number at 4 s" in found.expectations_failed[0], found
    read = summary_file.from_json(summary_file.plain(found))
    record = ReportedRun(log, Tally(Scan()), "", Judge.of(rig), "", read)
    assert [one.held for one in record.findings] == [False], "its value is within its limits"
    table = sections.metrics(record)
    assert table is not None and table.rows[0][-1] == Strong("not met"), table


def test_a_log_that_was_replaced_while_the_run_went_on_is_a_loss() -> None:
    rig, begin_ns = load_rig(PROBE, settings=["duration_s=0.2"]), 5_000_000_000
    log = in_memory(rig)
    for pacing, said in {"real": "real", "lockstep": "virtual"}.items():
        facts = {**log.metadata["executive"], "pacing": said}
        other = dataclasses.replace(log, metadata={**log.metadata, "executive": facts})
        found = summarise(rig, other, Outcome(pacing, "memory", begin_ns=begin_ns))
        assert found.verdict == "loss", pacing
        assert "that of another run" in found.log_missing[0], found.log_missing


# ------------------------------------------------------------------------- what was changed


def judged(*settings: str, tunings: tuple[tuple[str, float], ...] = ()) -> Summary:
    """Return the summary of a run of slew10 with settings and live tunings."""
    rig = load_rig(SLEW10, settings=settings)
    log = in_memory(rig)
    done = [{"cycle": 5, "name": name, "value": value} for name, value in tunings]
    executive = dataclasses.replace(log.node["executive"], tunings=done)
    log = dataclasses.replace(log, node=log.node | {"executive": executive})
    return summarise(rig, log, Outcome("virtual", "memory", changed=list(settings)))


def test_a_changed_value_does_not_switch_the_limits_off() -> None:
    worse = judged("controller.kv_Nms_rad=30.0")
    assert worse.verdict == "expectation not met", worse
    assert worse.changed == ["controller.kv_Nms_rad=30.0"] and worse.not_judged == {}
    assert worse.expectations_failed[0].startswith("muzzle_error_rms_mrad = "), worse
    assert worse.judged == ["muzzle_error_rms_mrad"], worse.judged


@pytest.mark.parametrize(
    ("verdict", "judged", "left", "then"),
    [
        ("ok", [], {}, "ok"), ("ok", ["m"], {"n": "x"}, "ok"), ("ok", ["timing"], {}, "ok"),
        ("ok", [], {"n": "x"}, "not judged"), ("ok", ["timing"], {"n": "x"}, "not judged"),
        ("loss", [], {"n": "x"}, "loss"), ("safety stop", [], {"n": "x"}, "safety stop"),
        ("expectation not met", [], {"n": "x"}, "expectation not met"),
    ],
)  # fmt: skip
def test_a_run_of_which_nothing_was_judged_is_not_judged_and_no_worse(
    verdict: str, judged: list[str], left: dict[str, str], then: str, tmp_path: Path
) -> None:
    def found() -> Summary:
        summary = Summary(metrics={}, verdict=verdict, judged=judged)
        summary.enter(*(Finding(FindingKind.LIMIT, why, None, name) for name, why in left.items()))
        return summary

    assert found().verdict == then and found().not_judged == left
    if then == "not judged":
        assert report.verdict_text(found()) == "not judged: x (1 limit not judged)"
    unmet, lost = found(), found()
    unmet.enter(*lines(FindingKind.EVALUATION, ["m = 2"]))
    lost.note_missing(tmp_path / "figure.png", OSError())
    graver = verdict if verdict in ("loss", "safety stop") else "expectation not met"
    assert unmet.verdict == graver and lost.verdict == (
        "safety stop" if verdict == "safety stop" else "loss"
    )


@pytest.mark.parametrize(
    ("judged", "metrics", "held", "then"),
    [
        (["timing"], {}, True, "ok"), (["timing"], {}, False, "ok"),
        (["timing"], {}, None, "not judged"), (["timing"], {"m": 1.0}, None, "not judged"),
        (["timing"], {"timing": 1.0}, None, "ok"), ([], {"timing": 1.0}, None, "not judged"),
    ],
)  # fmt: skip
def test_a_limit_may_be_called_timing(
    judged: list[str], metrics: dict[str, float], held: bool | None, then: str
) -> None:
    summary = Summary(metrics=metrics, verdict="ok", judged=judged)
    summary.requirements = [JudgedRequirement("timing", held)]
    summary.enter(Finding(FindingKind.LIMIT, "too short", None, "n"))
    assert summary.verdict == then


@pytest.mark.parametrize(
    ("verdict", "judged", "left", "then"),
    [
        ("ok", [], {"m": "too short"}, "not judged"), ("ok", ["m"], {"n": "x"}, "ok"),
        ("ok", [], {}, "ok"), ("loss", [], {"m": "too short"}, "loss"),
    ],
)  # fmt: skip
def test_an_older_summary_that_says_ok_of_what_nothing_judged_is_read_as_not_judged(
    verdict: str, judged: list[str], left: dict[str, str], then: str
) -> None:
    older = {"metrics": {"m": None}, "verdict": verdict, "judged": judged, "not_judged": left}
    assert summary_file.from_json(older).verdict == then


@pytest.mark.parametrize("way", ["controller=pd", 'controller="pd"', "controller=Python"])
def test_a_controller_that_the_rig_has_is_not_from_outside(way: str) -> None:
    rig = load_rig(SLEW10, "pd", ["controller.kv_Nms_rad=10"])
    found = summarise(rig, in_memory(rig), Outcome("virtual", "memory", changed=[way]))
    assert found.verdict == "expectation not met" and not found.not_judged, found
    if "Python" not in way:
        again = judged(way, "controller.kv_Nms_rad=10")
        assert again.expectations_failed == found.expectations_failed != [], again


def test_a_live_tuning_is_named_like_a_setting_and_a_planned_one_is_not() -> None:
    live = judged(tunings=(("controller.kv_Nms_rad", 120.0),))
    assert live.changed == ["controller.kv_Nms_rad=120"] and live.judged, live
    plan = "schedule=[{at_s: 0.005, set: {controller.kv_Nms_rad: 110.0}}]"
    planned = judged(plan, tunings=(("controller.kv_Nms_rad", 110.0),))
    assert planned.changed == [plan], planned.changed


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("duration_s=1.0",
         "the run ends at 1 s, before its window ends at 6 s; duration_s=6 is enough"),
        ("evaluation.window_s=[1.0, 2.0]", "evaluation.window_s was changed"),
    ],
)  # fmt: skip
def test_limits_without_their_window_are_named_and_fail_on_demand(
    setting: str, reason: str, tmp_path: Path
) -> None:
    done = virtual(tmp_path / "a", "--set", setting)
    assert (done.code, done.summary["verdict"]) == (1, "not judged"), done
    (why,) = done.summary["not_judged"].values()
    said = report.verdict_text(summary_file.from_json(done.summary))
    assert why.startswith(reason) and said == f"not judged: {why} (1 limit not judged)", said
    strict = virtual(tmp_path / "b", "--set", setting, "--judge")
    assert strict.code == 1 and reason in strict.summary["expectations_failed"][0], strict


@pytest.mark.parametrize(
    ("settings", "judged"),
    [(("duration_s=6.0",), True), (("duration_s=5.999",), False), (("duration_s=3.5",), False),
     (("duration_s=3.0",), False), (("duration_s=9.0",), True),
     (("duration_s=7.0", "evaluation.window_s=[1.0, 7.5]"), False),
     (("duration_s=7.0", "evaluation.rest_to_s=7.0"), True),
     (("duration_s=7.0", "evaluation.rest_to_s=7.5"), False)],
)  # fmt: skip
def test_limits_are_judged_by_runs_that_reach_the_end_of_every_window(
    settings: tuple[str, ...], judged: bool
) -> None:
    rig = load_rig(SLEW10, settings=settings)
    assert (judging.beyond(rig, ["duration_s=1"]) == "") == judged, settings


def test_a_run_with_nothing_to_judge_says_so(tmp_path: Path) -> None:
    done = virtual(tmp_path / "a", "--set", "duration_s=0.1", rig=PROBE)
    said = report.verdict_text(summary_file.from_json(done.summary))
    assert done.code == 0 and said.startswith("ok (nothing judged: the rig states no limits"), said
    strict = virtual(tmp_path / "b", "--set", "duration_s=0.1", "--judge", rig=PROBE)
    assert strict.code == 1, strict


# ------------------------------------------------------------------------- what was kept


def test_what_is_judged_does_not_depend_on_what_is_kept(tmp_path: Path) -> None:
    lossy = ("--set", "losses.TELL.share=0.1", "--set", "duration_s=2.0")
    whole = virtual(tmp_path / "whole", *lossy, rig=RELAY).summary
    kept = virtual(tmp_path / "kept", *lossy, "--set", "record.keep=100ms", rig=RELAY).summary
    assert whole["frames"]["lost"] > 0, whole["frames"]
    for key in ("frames", "frames_to", "verdict", "cycles"):
        assert kept[key] == whole[key], f"{key}: {kept[key]} and {whole[key]}"
    assert kept["records"]["written"] < whole["records"]["written"], kept["records"]


def test_metrics_of_a_log_that_keeps_nothing_are_those_of_the_whole_run(tmp_path: Path) -> None:
    whole = virtual(tmp_path / "whole").summary
    kept = virtual(tmp_path / "kept", "--set", "record.keep=1s").summary
    assert kept["records"]["written"] == 0 and kept["metrics"] == whole["metrics"], kept
    assert kept["judged"] == whole["judged"] != [], kept
    assert sorted(os.listdir(tmp_path / "kept")) == ["log.mcap", "summary.json"]


# ------------------------------------------------------------------------- how long it was


def test_a_run_that_somebody_ended_is_not_ok(tmp_path: Path) -> None:
    bus = own_bus()
    with Running(
        "run",
        SLEW10,
        "-o",
        str(tmp_path / "run"),
        "--bus",
        bus,
        "--pacing",
        "lockstep",
        "--set",
        "duration_s=3600",
        "--json",
        "--quiet",
        "--no-figure",
    ) as running:
        running.in_the_middle("slew10", bus)
        os.kill(running.pid("executive"), signal.SIGTERM)
        done = running.done()
    assert done.code == 1 and done.summary["verdict"] == "expectation not met", done
    (line,) = [
        text for text in done.summary["expectations_failed"] if "of 3,600,000 cycles" in text
    ]
    assert f"{done.summary['cycles']:,} of" in line and "asked to end" in line, line


def long_and_short(path: Path, part: int) -> list[tuple[dict[str, float], logs.Log]]:
    """Return metrics and log of a run read as a long and as a short one."""
    rig = load_rig(HULL, "pd_nn", ["duration_s=6.0", "evaluation.window_s=[1.5, 6.0]"])
    simulate(rig, path)
    judge = Judge.of(rig)
    long = long_logs.read(path, lambda log: judge.needed_columns(log, True), short=1000, part=part)
    short = long_logs.read(path)
    return [(judge.metrics(log), log) for log in (long, short)]


@pytest.mark.parametrize("part", [700, 1000])
def test_a_log_of_any_length_has_the_metrics_of_the_whole(part: int, tmp_path: Path) -> None:
    (found, long), (expected, short) = long_and_short(tmp_path / "log.mcap", part)
    assert isinstance(long, long_logs.LongLog) and not isinstance(short, long_logs.LongLog)
    assert found == pytest.approx(expected, rel=1e-12), (found, expected)
    columns = long.node["executive"].columns
    whole = short.node["executive"].columns["controller.norm_z"]
    assert np.array_equal(columns["controller.norm_z"], whole), "a column nobody had foreseen"
    rig, outcome = load_rig(HULL, "pd_nn"), Outcome("real", "")
    timing = [summarise(rig, log, outcome, Judge(rig)).timing_us for log in (long, short)]
    for stage, points in timing[1].items():
        assert timing[0][stage]["max"] == points["max"], (stage, timing[0][stage], points)


# ------------------------------------------------------------------------- where frames went


def test_frames_add_up(tmp_path: Path) -> None:
    for rig in (SLEW10, RELAY):
        name = Path(rig).stem
        done = virtual(tmp_path / name, "--set", "duration_s=0.5", rig=rig)
        account = done.summary["frames_to"]
        for role, row in account.items():
            parts = sum(n for what, n in row.items() if what != "sent")
            assert role == "nobody" or row["sent"] == parts, (rig, role, row)
        heard = sum(row["sent"] for role, row in account.items() if role != "nobody")
        assert heard + account["nobody"]["sent"] >= done.summary["frames"]["sent"], account
        log = logs.read(tmp_path / name / "log.mcap")
        frames = log.node["plant"].frames
        used = np.count_nonzero((frames["direction"] == 1) & (frames["e2e"] <= 1))
        assert account["plant"]["used"] == used, account


def with_a_heartbeat_that_ends(path: Path, *settings: str) -> logs.Log:
    """Return the log of a probe whose plant is told after 1000 cycles to send it no more."""
    made = VirtualRun(load_rig(PROBE, settings=["duration_s=4.0", *settings]), path)
    for cycles in made.advance():
        if cycles == 1000:
            sent = made.blocks[1].loop.tx
            sent.frames["every_n"][np.flatnonzero(sent.kind["is_heartbeat"])] = 10**9
    made.close()
    return logs.read(path)


@pytest.mark.parametrize("setting", ["record.keep=null", "record.keep=100ms"])
def test_a_slow_frame_that_stays_away_is_a_loss(setting: str, tmp_path: Path) -> None:
    log = with_a_heartbeat_that_ends(tmp_path / "log.mcap", setting)
    for pacing in ("virtual", "lockstep", "sync", "real"):
        found = summarise(load_rig(PROBE), log, Outcome(pacing, ""))
        (line,) = found.frames_too_many
        assert line == "HB_PLANT stayed away for 3 s; every 0.1 s was expected", line
        assert found.verdict == "loss", found.verdict
    never = dataclasses.replace(log, metadata={**log.metadata, "away": {}})
    said = summarise(load_rig(PROBE), never, Outcome("virtual", "")).frames_too_many
    assert sorted(line.split(";")[0] for line in said) == [
        "HB_EXEC stayed away for 4.001 s",
        "HB_PLANT stayed away for 4 s",
    ]


def test_nodes_with_different_dbc_files_are_told() -> None:
    log = in_memory(load_rig(PROBE, settings=["duration_s=0.1"]))
    other = log.attachments["probe.dbc"].replace("(1e-06", "(1e-05")
    two = dataclasses.replace(log, attachments={**log.attachments, "plant/probe.dbc": other})
    found = [summarise(load_rig(PROBE), one, Outcome("real", "")) for one in (log, two)]
    assert [one.verdict for one in found] == ["ok", "loss"]
    (line,) = found[1].frames_too_many
    assert line.startswith("the nodes have different DBC files, see probe.dbc, plant/probe"), line


@pytest.mark.parametrize("ahead", [0, 2, 50])
@pytest.mark.parametrize("part", [1, 3, 7, 100])
def test_an_absence_is_counted_in_cycles_that_the_node_ran(part: int, ahead: int) -> None:
    cycles = np.r_[0:20, 400:440]  # a stall of 380 periods
    words = {k: [0x80] for k in cycles}  # sent
    for k in (0, 10, 400, 410, 425):
        words[k].append(0x202 | 1 << 40)
    words[430].append(0x202 | 1 << 40 | 4 << 48)  # a wrong CRC: not used
    rows = np.array([(0, 0, k, word, 0) for k, own in words.items() for word in own])
    absences, seen = Absences(), -1
    for own in np.array_split(cycles, range(part, len(cycles), part)):
        absences.add_cycles(own)
        new = rows[(rows[:, 2] > seen) & (rows[:, 2] <= own[-1] + ahead)]
        if len(new):
            absences.add_frames(new)
            seen = new[-1, 2]
    assert absences.longest() == {0x202: 15}, absences.longest()
    absences.add_cycles(np.arange(440, 450))
    assert absences.longest() == {0x202: 25}, "and at the end"


# ------------------------------------------------------------------------- on the screen


def summary_of(metrics: int, problems: int) -> Summary:
    """Return a summary as a paced run gives it, with many metrics and problems."""
    rig = load_rig(HULL, settings=["duration_s=0.05"])
    found = summarise(rig, in_memory(rig), Outcome("real", "udp_multicast:239.74.163.2:43113"))
    found.metrics = {f"error_transient_of_joint_{i}_mrad": 1.0 / (i + 1) for i in range(metrics)}
    found.faults = ["executive: " + "a reason with many words " * 8] * problems
    late = {"cycle": 81234, "wake_late_us": 6285.1, "cause": "another process took the processor"}
    found.latest_cycles = [late] * 8
    account = {"sent": 65409, "used": 62643, "lost": 2000, "repeated": 700, "unread": 66}
    found.frames_to = dict.fromkeys(("executive", "local", "plant"), account)
    return found


@pytest.mark.parametrize("width", [40, 60, 80, 132])
@pytest.mark.parametrize(("metrics", "problems"), [(6, 0), (18, 2), (40, 9)])
def test_no_line_is_wider_than_the_terminal(width: int, metrics: int, problems: int) -> None:
    shown = report.rows(summary_of(metrics, problems), Path("runs") / ("x" * 20), width)
    lines = [f"{label:9}{line}" for label, own in shown.items() for line in own]
    wide = [line for line in lines if len(line) > width]
    assert not wide, "\n".join(wide)


@pytest.mark.parametrize(
    ("entries", "verdict", "said"),
    [
        ({"faults": ["plant: died"]}, "safety stop", "safety stop: plant: died"),
        ({"lost": ["plant: 3 frames lost"]}, "loss", "loss: plant: 3 frames lost (2 limits"),
        ({"frames_too_many": ["5 wrong"]}, "loss", "loss: 5 wrong (2 limits"),
        ({"log_missing": ["figure.png: full"]}, "loss", "loss: figure.png: full (2 limits"),
        (
            {"expectations_failed": ["a = 3", "b = 4"]},
            "expectation not met",
            "expectation not met: a = 3, and 1 more above (2 limits",
        ),
        (
            {"expectations_failed": ["a = 3"], "lost": ["plant: 3 frames lost"]},
            "loss",
            "loss: plant: 3 frames lost, and 1 more above (2 limits",
        ),
        ({"cycles": 5}, "interrupted", "interrupted: asked to end in cycle 5 (Ctrl-C or a signal)"),
        ({}, "ok", "ok (2 limits judged)"),
    ],
)
def test_a_verdict_says_why_on_its_own_line(
    entries: dict[str, object], verdict: str, said: str
) -> None:
    found = Summary(metrics={}, verdict=verdict, judged=["a", "b"])
    for name, entry in entries.items():
        setattr(found, name, entry)
    assert report.verdict_text(found).startswith(said), report.verdict_text(found)
    shown = report.rows(found, Path("runs/x"), 80)
    assert ("problem" in shown) == (len(found.problems()) > 1), shown
    assert all(
        line in " ".join(shown.get("problem", shown["verdict"])) for line in found.problems()
    )


def test_input_that_was_lost_says_how_late_the_machine_was_and_a_full_ring_says_so() -> None:
    rig = load_rig(PROBE, settings=["duration_s=0.1"])
    log = in_memory(rig)
    starved = np.minimum(np.arange(len(log.node["plant"].cycle)) // 40, 1.0)
    timing = {**log.node["plant"].timing, "health.starved_cycles": starved}
    plant = dataclasses.replace(log.node["plant"], timing=timing)
    well, log = log, dataclasses.replace(log, node={**log.node, "plant": plant})
    outcome = Outcome("real", "", stall="executive: a cycle woke 9.1 ms late; run it otherwise")
    whole = summarise(rig, well, outcome)
    assert (whole.verdict, whole.lost) == ("ok", []), "a stall that cost nothing"
    outcome.health = {"plant": {"starved": 33, "missed": 1}}
    outcome.dropped = 7
    found = summarise(rig, log, outcome)
    first_s = 40 / rig.config.rate_hz
    assert found.verdict == "loss" and found.lost == [
        f"plant: 1 frames lost, 33 cycles with stale input, first at {first_s:g} s",
        "executive: a cycle woke 9.1 ms late; run it otherwise",
        "7 rows found a ring full and are not in the log",
    ], found.lost


@pytest.mark.parametrize(
    ("skipped", "held", "changes", "level"),
    [
        (0, 0, {}, "OK"), (1, 0, {}, "WARN"), (0, 10, {}, "OK"), (0, 11, {}, "WARN"),
        (9, 0, {"error": 0.9}, "WARN"), (11, 0, {"error": 0.9}, "ERROR"),
        (11, 0, {"error": 1.1}, "WARN"), (11, 0, {"warn": None, "error": 1.1}, "OK"),
        (11, 99, {"warn": None}, "not judged"), (10**15, 0, {"error": 0.9}, "ERROR"),
    ],
)  # fmt: skip
def test_timing_is_judged_by_what_was_skipped_and_held(
    skipped: int, held: int, changes: dict[str, float | None], level: str
) -> None:
    rig = load_rig(PROBE, settings=["duration_s=10.0", "rate_hz=1000"])
    rig = rig.changed(timing=msgspec.structs.replace(rig.config.timing, **changes))
    cycle = np.arange(10_000)
    quick = {f"timing.{stage}_us": np.full(len(cycle), 10.0) for stage in Stage.words()}
    about: Any = {"period_ns": 1_000_000, "variables": []}
    frames = np.empty(0, logs.FRAME)
    node = logs.NodeLog(cycle, cycle * 1_000_000, {}, quick, frames, [], [], about)
    log = logs.Log(Path("log.mcap"), {"executive": node}, {}, {}, [])
    counts = {"skipped_cycles": skipped, "held_cycles": held}
    found = summarise(rig, log, Outcome("real", "", health={"executive": counts}))
    assert found.timing_level == level, found
    told = report.timing_text(found)
    assert ("periods skipped" in told) == (skipped > 0 and level != "OK"), told
    assert (f"{held:,} periods held of 10,000" in told) == (held > 0 and level != "OK"), told


def test_metrics_and_verdict_are_seen_on_24_lines() -> None:
    shown = report.fitted_rows(report.rows(summary_of(18, 1), Path("runs/x"), 80), 22)
    kinds = list(shown)
    assert sum(map(len, shown.values())) <= 22, kinds
    assert kinds[-2:] == ["verdict", "folder"] and "metrics" in kinds, kinds


def test_no_space_for_the_columns_of_a_long_log_costs_no_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = load_rig(SLEW10, settings=["duration_s=0.3"])
    simulate(rig, tmp_path / "log.mcap")
    whole = (tmp_path / "log.mcap").read_bytes()
    short = partial(long_logs.read, short=100)
    monkeypatch.setattr(long_logs, "read", short)
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: open("/dev/full", "wb"))  # noqa: SIM115
    kept = RunFolder(no_figure=True, json=True)
    code = conclude(Judge.of(rig), tmp_path, Outcome("virtual", "memory"), kept, {})
    assert code == 3 and (tmp_path / "log.mcap").read_bytes() == whole
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert "No space left" in " ".join(summary["log_missing"]), summary["log_missing"]
