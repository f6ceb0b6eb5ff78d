"""`pcpc report`: what stands in the page is what the log and the summary say, of any log."""

import hashlib
import json
import re
import shutil
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from html_page import Page
from logcommand import run, run_here
from places import ROOT
from processes import own_bus, pcpc
from spring import spring_run

import pcpc as package
from pcpc.executive.log import long_logs
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import VirtualRun, simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.report import figures, record
from pcpc.tools.after.verdict import summary_file
from pcpc.tools.terminal.document import Section, markdown
from pcpc.tools.terminal.progress import Progress

RIGS = ROOT / "plants" / "atb1000" / "rigs"
RELAY = ROOT / "tests" / "executive" / "relay" / "rig.yaml"
REQUIRED = "require=[{name: close, always: abs(controller.e_rad) < 1 mrad, after: 0.2s}]"
OWN = f"""base: {RIGS / "slew10.yaml"}
rig: own
supervisor: {{fault_after_cycles: 100}}
errors: {{crc: 1000}}
faults:
  gone: {{kind: loss, frame: FB_A, from: 100ms, for: 20ms}}
schedule:
  - {{at_s: 0.2, set: {{controller.kv_Nms_rad: 77.5}}}}
  - {{at_s: 0.3, set: {{controller.kv_Nms_rad: 80.0}}}}
"""


def page_of(log: Path, *words: str, code: int = 0) -> Page:
    """Return the report of a log, which stands alone whatever the log is."""
    output = log.parent / "written.html"
    done = run_here("report", log, "-o", output, "--quiet", *words)
    assert (done.code, done.err) == (code, ""), done
    page = Page(output)
    page.check_alone()
    return page


def gathered(log: Path) -> record.ReportedRun:
    return record.gather(Opened(log), Progress(quiet=True))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run of slew10 that violates a requirement and meets a limit."""
    place = tmp_path_factory.mktemp("virtual") / "run"
    words = ("--set", REQUIRED, "--quiet", "--no-figure")
    assert run_here("simulate", "slew10", "--controller", "pd", "-o", place, *words).code == 1
    return place


@pytest.fixture(scope="module")
def paced(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run by the clock with a fault on purpose and tunings."""
    place = tmp_path_factory.mktemp("paced")
    (place / "own.yaml").write_text(OWN)
    done = pcpc(
        "run",
        str(place / "own.yaml"),
        "--pacing",
        "real",
        "--bus",
        own_bus(),
        "--quiet",
        "--set",
        "duration_s=0.5",
        "--no-figure",
        "-o",
        str(place / "run"),
    )
    assert (place / "run" / "summary.json").is_file(), done
    return place / "run"


# ------------------------------------------------------------------------- what it says


def test_verdict_metrics_and_requirements_are_those_of_the_summary(folder: Path) -> None:
    page, summary = page_of(folder), summary_file.summary_beside(folder / "log.mcap")
    assert summary is not None
    assert f"Verdict: {summary.verdict}" in page.text
    assert summary.verdict == "expectation not met"
    for name, value in summary.metrics.items():
        assert page.cells("Metrics", name)[0] == f"{value:.4g}", name
    (low, high) = load_rig(RIGS / "slew10.yaml").config.expect["pd"]["muzzle_error_rms_mrad"]
    assert page.cells("Metrics", "muzzle_error_rms_mrad")[1:] == [f"{low:g} to {high:g}", "met"]
    (one,) = summary.requirements
    held, first, margin = page.cells("Requirements", "close")
    assert held == "violated" and first.startswith(f"cycle {one.first_cycle}, "), first
    assert margin == f"{one.margin:.4g} {one.margin_unit} at {one.margin_s} s"
    sha256 = hashlib.sha256((folder / "log.mcap").read_bytes()).hexdigest()
    assert page.cells("Replay", "sha256") == [sha256]
    assert page.commands == [f"pcpc replay {folder / 'log.mcap'}"]
    assert page.tags.count("img") == 2 and "No clock ran" in page.text
    assert page.cells("Versions", "numpy") == [np.__version__]
    assert REQUIRED in page.text and "base: ../rig.yaml" in page.text  # its rig, and what was set


def test_markdown_a_terminal_and_python_tell_what_the_page_tells(
    folder: Path, tmp_path: Path
) -> None:
    """Each cell of the page's tables stands in all three; only the page has pictures and files."""
    page = page_of(folder)
    paper = tmp_path / "report.md"
    with pytest.MonkeyPatch.context() as without:  # it draws nothing that nobody sees
        without.setitem(sys.modules, "matplotlib.figure", None)
        assert run_here("report", folder, "-o", paper, "--quiet").out == f"{paper}\n"
        lines = run_here("report", folder, "-o", "-").out
    parts = package.open(folder).parts()
    python = "".join(markdown(part) for part in parts)
    told = [" ".join(re.sub("[`*]", "", t).split()) for t in (paper.read_text(), lines, python)]
    cells = {cell for table in page.tables.values() for row in table[1:] for cell in row}
    assert len(cells) > 50 and "expectation not met" in page.text
    for text in told:
        assert not [cell for cell in cells if cell not in text]
        assert "expectation not met" in text and "img" not in text
    assert max(map(len, lines.splitlines())) <= 80
    assert "base: ../rig.yaml" in told[0] and "base: ../rig.yaml" not in told[1]
    assert sum(type(part) is Section for part in parts) == page.tags.count("h2")


def test_a_log_alone_is_judged_anew_to_the_same_figures(folder: Path, tmp_path: Path) -> None:
    shutil.copy(folder / "log.mcap", tmp_path / "log.mcap")
    alone, whole = page_of(tmp_path / "log.mcap"), page_of(folder)
    assert alone.tables["Metrics"] == whole.tables["Metrics"]
    assert alone.tables["Requirements"] == whole.tables["Requirements"]
    assert "judged from the log alone" in alone.text and "log alone" not in whole.text


def test_a_summary_that_is_none_is_no_summary(folder: Path, tmp_path: Path) -> None:
    shutil.copy(folder / "log.mcap", tmp_path / "log.mcap")
    for text in (
        b"",
        b"[]",
        b'{"verdict": 5}',
        b"\xff",
        b"[" * 100_000,
        b'{"verdict": "ok", "metrics": {"a": {}}}',
    ):
        (tmp_path / "summary.json").write_bytes(text)
        found = gathered(tmp_path / "log.mcap")
        assert found.summary is not None and not found.at_end, text[:40]
        assert found.summary.verdict == "expectation not met", text[:40]


def test_a_summary_that_is_not_of_this_log_is_no_summary(folder: Path, tmp_path: Path) -> None:
    whole = (folder / "summary.json").read_text()
    other = tmp_path / "other"
    assert run_here("simulate", "slew10", "-o", other, "--quiet", "--no-figure").code == 0
    edited = whole.replace('"expectation not met"', '"ok"', 1)
    unbound = {k: v for k, v in json.loads(edited).items() if k != "bound"}
    copied = json.dumps(unbound | {"bound": json.loads(whole)["bound"]})
    shutil.copy(folder / "log.mcap", tmp_path / "log.mcap")
    for text in (edited, copied, json.dumps(unbound), (other / "summary.json").read_text()):
        (tmp_path / "summary.json").write_text(text)
        assert "Verdict: expectation not met" in page_of(tmp_path / "log.mcap").text
        run = package.open(tmp_path)
        assert run.verdict == "expectation not met" and not run.judged_at_its_end
    (tmp_path / "summary.json").write_text(whole)
    assert package.open(tmp_path).judged_at_its_end
    shutil.copy(folder / "log.mcap", other / "log.mcap")
    assert package.open(other).verdict == "expectation not met", "of another log"


def test_a_log_alone_tells_of_faults_and_of_its_end(tmp_path: Path) -> None:
    silent = "--set", "faults.gone={kind: loss, frame: FB_A, from: 200ms}"
    assert run_here("simulate", "slew10", "-o", tmp_path / "a", *silent, "--quiet").code == 5
    (tmp_path / "a" / "summary.json").unlink()
    assert package.open(tmp_path / "a").verdict == "safety stop"


def test_what_happened_stands_with_its_time_and_what_it_was_before(paced: Path) -> None:
    page, log = page_of(paced), logs.read(paced / "log.mcap")
    executive = log.node["executive"]
    tuned = [entry for entry in executive.tunings if entry["name"].startswith("controller.")]
    rows = page.tables["Tunings"][1:]
    assert [row[1] for row in rows] == [str(entry["cycle"]) for entry in tuned] and len(rows) == 2
    changes = ["110 → 77.5 N m s/rad", "77.5 → 80 N m s/rad"]
    assert [row[4] for row in rows] == changes, rows
    (fault,) = page.tables["Faults on purpose"][1:]
    (left,) = [entry for entry in executive.tunings if entry["name"] == "fault.gone.left"]
    span = [f"{1e-3 * (left['cycle'] + 1 + cycles):.4f}" for cycles in (0, left["value"])]
    assert fault == [*span, "executive", "gone", "loss", "FB_A"]
    states = {tuple(row[:2]): row[2:] for row in page.tables["States of the supervisor"][1:]}
    runs = [e for e in executive.events if (e["event"], e.get("name")) == ("state", "RUN")]
    assert states["executive", "RUN"][0] == f"{len(runs)}" and ("executive", "HOLD") in states
    alarms = [e for node in log.node.values() for e in node.events if e["event"] == "alarm"]
    assert len(page.tables.get("Alarms", [""])) - 1 == len(alarms)


def test_lateness_is_that_of_the_log_and_its_histogram_has_every_cycle(
    paced: Path, tmp_path: Path
) -> None:
    page, log = page_of(paced), logs.read(paced / "log.mcap")
    late = log.node["executive"].timing["timing.wake_late_us"]
    told = dict(zip(page.tables["Timing"][0][1:], page.cells("Timing", "wake_late"), strict=True))
    for name, share in (("p50", 50), ("p99", 99), ("max", 100)):
        assert float(told[name]) == pytest.approx(np.percentile(late, share), abs=0.1), name
    counts = figures._counts(gathered(paced / "log.mcap"))
    assert counts["wake_late"].sum() == counts["work"].sum() == len(late)
    edge = np.searchsorted(figures._EDGES_US, np.median(late)) - 1
    assert (
        counts["wake_late"][: edge + 1].sum() >= len(late) / 2 >= counts["wake_late"][:edge].sum()
    )
    assert page.tags.count("img") == 3


def test_frames_and_load_are_those_on_the_bus(folder: Path) -> None:
    page, log = page_of(folder), logs.read(folder / "log.mcap")
    frames, names = log.node["executive"].frames, logs.frame_names(log)
    for number in np.unique(frames["id"]):
        count = int((frames["id"] == number).sum())
        assert page.cells("Bus", names[int(number)])[2] == f"{count:,}", names[int(number)]
    length = 34 + 8 * frames["dlc"].astype(int)  # as in `drivers.can.frame_bits`, of 11-bit ids
    bits = int((length + (length - 1) // 4 + 13).sum())
    seconds = 1e-9 * float(frames["stamp_ns"].max() - frames["stamp_ns"].min())
    assert f"Load: {bits / seconds / 1e6:.1%} of 1 Mbit/s" in page.text


# ------------------------------------------------------------------------- of any log


def test_a_log_that_is_cut_says_what_is_missing_and_ends_with_its_code(
    folder: Path, tmp_path: Path
) -> None:
    whole = (folder / "log.mcap").read_bytes()
    for share in (0.05, 0.5, 0.99):
        (tmp_path / "cut.mcap").write_bytes(whole[: int(share * len(whole))])
        page = page_of(tmp_path / "cut.mcap", code=3)
        assert "Verdict: loss" in page.text and "nothing is readable after byte" in page.text
        done = run_here("report", tmp_path / "cut.mcap")
        assert done.code == 3 and "cut.mcap: missing: the end: nothing is readable" in done.err
    shutil.copy(folder / "summary.json", tmp_path / "summary.json")
    (tmp_path / "log.mcap").write_bytes(whole[: len(whole) // 2])  # damaged after its verdict
    page = page_of(tmp_path / "log.mcap", code=3)
    assert "Verdict: loss" in page.text and 'class="verdict"' in page.source
    assert "nothing is readable after byte" in page.text


def test_a_log_without_a_cycle_has_a_report(tmp_path: Path) -> None:
    VirtualRun(load_rig(RIGS / "slew10.yaml", "pd"), tmp_path / "log.mcap").close()
    page = page_of(tmp_path / "log.mcap")
    assert "0 cycles recorded" in page.text and "Configuration" in page.tables | {
        "Configuration": 0
    }


def test_an_imported_recording_is_shown_and_not_judged(folder: Path, tmp_path: Path) -> None:
    assert run("export", folder, "-o", tmp_path / "drive.log", "--quiet").code == 0
    dbc = ("--dbc", RIGS.parent / "atb1000.dbc", "--quiet")
    done = run("import", tmp_path / "drive.log", *dbc, "-o", tmp_path / "drive.mcap")
    assert done.code == 0, done
    page = page_of(tmp_path / "drive.mcap")
    assert "Verdict: not judged" in page.text and "holds no rig" in page.text
    assert page.tags.count("img") == 1 and "assumed" in page.text and "SYNC" in page.text


def test_three_nodes_have_their_states_and_both_buses(tmp_path: Path) -> None:
    simulate(load_rig(RELAY), tmp_path / "log.mcap")
    page = page_of(tmp_path / "log.mcap")
    nodes = [row[0] for row in page.tables["States of the supervisor"][1:]]
    assert list(dict.fromkeys(nodes)) == ["executive", "local", "plant"]
    assert page.text.count("Load: ") == 2 and "by the plant" in page.text


def test_a_long_log_in_pieces_has_the_report_of_the_whole(
    paced: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = page_of(paced)
    pieces = partial(long_logs.read, short=100, part=64)
    monkeypatch.setattr(long_logs, "read", pieces)
    found = page_of(paced)
    assert isinstance(pieces(paced / "log.mcap"), long_logs.LongLog)
    assert found.tables == whole.tables and found.tags == whole.tags


def test_variables_of_a_long_log_are_drawn_as_those_of_a_short_one(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record, "_draws", lambda judge: False)
    whole = gathered(folder / "log.mcap")
    monkeypatch.setattr(long_logs, "read", partial(long_logs.read, short=5000, part=640))
    found = gathered(folder / "log.mcap")
    assert found.groups == whole.groups and "controller.e_rad" in found.groups[0]
    ours, theirs = found.source().series, whole.source().series
    assert ours.keys() == theirs.keys()
    for name, one in ours.items():
        values = theirs[name].values
        assert len(one.values) < len(values), name
        assert (one.values.min(), one.values.max()) == (values.min(), values.max()), name


def test_an_evaluation_from_outside_runs_unasked_only_in_its_place(tmp_path: Path) -> None:
    log = spring_run(tmp_path / "spring")
    own = page_of(log)
    assert own.cells("Metrics", "end_m") == ["not told", "0.45 to 0.55", "not judged"]
    moved = (tmp_path / "spring").rename(tmp_path / "moved")
    log = moved / "log.mcap"
    foreign = page_of(log)
    assert "Verdict: not judged" in foreign.text and "or run the log's own copies" in foreign.text
    assert 'alt="variables over time"' in foreign.source
    page = page_of(log, "--trust")
    assert page.tables["Metrics"] == own.tables["Metrics"]
    (moved / "figure.png").write_bytes(b"\x89PNG\r\n\x1a\n")  # as a run's end leaves it
    told = {"verdict": "ok", "metrics": {"end_m": 0.5}}
    summary_file.write_json(summary_file.from_json(told), moved / "summary.json")
    found = page_of(log)
    assert "Verdict: ok" in found.text and found.cells("Metrics", "end_m")[0] == "0.5"
    assert "or run the log's own copies" in found.text  # why there are no limits
    assert "the figure of the run&#x27;s end" in found.source


# ------------------------------------------------------------------------- how to get it


def test_the_run_says_how_to_get_it_and_python_writes_it(folder: Path, tmp_path: Path) -> None:
    done = run_here(
        "simulate", "slew10", "-o", tmp_path / "a b", "--no-figure", "--set", "duration_s=0.02"
    )
    told = f"pcpc report '{tmp_path / 'a b'}'".replace(" ", "")  # folded where the path is long
    assert told in "".join(done.out.split()), done
    assert run_here("report", folder, "--quiet").out == f"{folder / 'report.html'}\n"
    path = package.open(folder).report(tmp_path / "api.html")
    assert Page(path).tables == Page(folder / "report.html").tables
    live = package.simulate("slew10", "pd", set={"duration_s": 0.05, "seed": 3}, quiet=True)
    page = Page(live.report(tmp_path / "memory.html"))
    assert "seed=3" not in page.text and "duration_s=0.05" in page.text
    assert f"Verdict: {live.verdict}" in page.text
