"""Whatever is falsified of a run, all who look at it give one answer.

Which is the first difference, how the run is recomputed, what is missing, the verdict and why. The
lies are in `falsified`. `bisect` makes its own runs; it compares as `Run.differences` does.
"""

import json
import math
import shutil
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from falsified import (
    BOTH,
    LOG,
    RIG,
    SUMMARY,
    Lie,
    always,
    attached,
    both,
    columns_swapped,
    copied,
    cut,
    described,
    event,
    facts,
    flipped,
    frame,
    gone,
    later,
    minus,
    of_file,
    part,
    rewritten,
    rig,
    stopped,
    summary,
    swapped,
    ulp,
    value,
)
from logcommand import run_here
from processes import RIGS

import pcpc
from pcpc.drivers.errors import UserError
from pcpc.tools.after.opened import opened
from pcpc.tools.after.report import sections, suite
from pcpc.tools.after.report.record import gather
from pcpc.tools.after.trust import ASKED, FOLDER
from pcpc.tools.after.verify.one import verified_row
from pcpc.tools.terminal.document import Verdict
from pcpc.tools.terminal.progress import Progress

QUIET = Progress(quiet=True)
SHORT = """\
base: {base}
rig: short
duration_s: 0.2
evaluation: {{window_s: [0, 0.2]}}
require: [{{id: R-1, never: abs(controller.e_rad) > 1000}}, {{never: time.t_s > 9}}]
expect: {{pd: {{muzzle_error_rms_mrad: {{low: 0, high: 1000, id: R-2}}}}}}
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a run, one of another seed, and a branch of the first."""
    folder = tmp_path_factory.mktemp("runs")
    file = folder / "rig.yaml"
    file.write_text(SHORT.format(base=RIGS / "step10.yaml"))
    for name, *words in (("run",), ("seed", "--set", "seed=5")):
        assert run_here("simulate", file, "-o", folder / name, "--no-figure", *words).code == 0
    words = ("branch", folder / "run", "--cycle", "50", "-o", folder / "branch", "--no-figure")
    assert run_here(*words).code == 0
    return folder


NO_LOG, UNMET = "no log", "expectation not met"
DOUBT = "summary.json is not of this log: one was changed since"
NOTHING = "nothing to judge: the rig states no requirement and no limit"
OF_A_SUITE, PNG = (NOTHING, "no run: a branch"), b"\x89PNG\r\n\x1a\n"


def compact(data: bytes) -> bytes:
    return json.dumps(json.loads(data)).encode()


class Want(NamedTuple):
    """A lie, and what all say of it.

    first     what differs first from the whole run, "": nothing
    again     what differs first where it is recomputed, or that nothing does: identical, incomplete
    missing   a part of what is missing in the log
    tested    of what a run tests, what does not hold
    """

    lie: Lie
    first: str = ""
    again: str = "identical"
    missing: str = ""
    verdict: str = UNMET
    why: str = DOUBT
    tested: dict[str, str] | None = None


def damaged(lie: Lie, missing: str, verdict: str = "loss", **more: Any) -> Want:
    """Return what is said where the log lacks something."""
    return Want(lie, again="incomplete", missing=missing, verdict=verdict, why=missing, **more)


def agreed(what: str, answers: dict[str, Any]) -> Any:
    """Return the answer that all give."""
    one, *others = answers.values()
    assert all(other == one for other in others), (what, answers)
    return one


def printed(*words: str | Path) -> Any:
    """Return what a command printed as JSON, else that there is no log; it says why in a line."""
    done = run_here(*words, "--quiet", "--json", *["-"] * (words[0] == "compare"))
    assert done.out or (done.code == 2 and done.err.count("\n") == 1), done
    return json.loads(done.out) if done.out else NO_LOG


def differences(folder: Path, whole: Path) -> tuple[Any, str]:
    """Return what is missing in the log, and what differs first from the whole run."""
    log = folder / LOG
    about, bits = printed("log", "info", log), printed("compare", "--bits", whole / LOG, log)
    pair = printed("compare", whole / LOG, log)
    if NO_LOG in (about, bits, pair):
        return (agreed("no log", {"info": about, "bits": bits, "compare": pair}),) * 2
    run, old = map(pcpc.open, (folder, whole))
    (pair,) = pair["pairs"]
    lines = [one.removeprefix(f"{log}: ") for one in pair["missing"]]
    lines = [one for one in lines if "nothing was compared" not in one]
    missing = {"info": about["missing"], "run": run.log.missing, "compare": lines}
    ours = [(one.label, one.cycle) for one in old.differences(run)]
    theirs = [(one["name"], one["cycle"]) for one in bits["differences"]]
    both = [(one["name"], one["cycle"]) for one in [pair["first"]] if one]
    first = agreed("first", {"run": ours[:1], "bits": theirs[:1], "compare": both})
    equal = bits["equal"], pair["state"] in ("equal", "failed")
    assert not ours or equal == (False, False), (ours, equal)
    return agreed("missing", missing), first[0][0] if first else ""


def recomputed(log: Path) -> str:
    """Return the first variable that differs where a log is recomputed, else what it is."""
    row = verified_row(str(log), "all", ASKED)
    first = row.first and (row.first.name, row.first.cycle)
    nodes = printed("replay", log)
    if nodes == NO_LOG:
        assert row.verdict in ("incomplete", "unreadable"), row
        return row.verdict
    assert all(one["identical"] for one in nodes) or row.verdict != "identical", (row, nodes)
    firsts = [(one["first"]["name"], one["first"]["cycle"]) for one in nodes if one["first"]]
    assert (first in firsts) == bool(firsts) == (row.verdict == "differs"), (row, nodes)
    return first[0] if first else row.verdict


def verdicts(folder: Path) -> tuple[str, list[str], dict[str, str]]:
    """Return what the run came to, what speaks against it, and what became of what it tests."""
    try:
        with opened(folder / LOG) as opener:
            page = sections.verdict(gather(opener, QUIET))
    except UserError as error:
        page = Verdict(NO_LOG, [str(error)], False)
    found = suite.gather([str(folder)], [], Namespace(), QUIET)
    (one,) = found.runs
    words = {"page": page.word, "suite": one.verdict}
    try:
        run = pcpc.open(folder)
        words["run"], why = run.verdict, run.result.problems()
        assert why == [line for line in one.problems if not line.startswith(OF_A_SUITE)], one
        assert {*why} <= {*page.reasons}, (why, page)
    except UserError:
        assert page.word in (NO_LOG, "not judged"), page
    assert not any(FOLDER in line for line in (*page.reasons, *one.problems)), (page, one)
    assert (DOUBT in page.reasons) == (DOUBT in one.problems) or page.word == NO_LOG, (page, one)
    code = run_here("report", folder, "--requirements", "--quiet").code
    assert code or DOUBT not in one.problems
    assert page.good == (page.word == "ok" and not one.problems) == (found.code == 0), (page, found)
    return agreed("verdict", words), one.problems, {x.key: x.verdict for x in one.tested}


def executive(name: str, cycle: int, how: Any, **more: Any) -> Want:
    """Return what is said where a value of the executive is another one."""
    return Want(value("executive", name, cycle, how), name, name, **more)


E, R, TIME, STATE = "controller.e_rad", "controller.r_rad_s", "time.t_s", "supervisor.state"
RATE, THETA, HUB = "reference.q_d_rate_rad_s", "barrel.theta_rad", "barrel.hub_rate_rad_s"
LIMIT, BROKEN = {"low": 0, "high": 1000, "id": "R-2"}, {"R-1": "violated"}
OPEN = {"R-1": "not judged", "R-2": "not judged", "never time.t_s > 9": "not judged"}
GONE = dict.fromkeys(OPEN, "")
NO = NO_LOG, "unreadable", NO_LOG, NO_LOG  # first, again, missing, verdict
SYNC = "frame plant.SYNC received"
LIES: dict[str, Want] = {
    "nothing": Want(lambda folder: None, verdict="ok", why=""),
    "the log is written anew": Want(rewritten(lambda given: None)),
    # what was recorded
    "an ulp": executive(E, 100, ulp),
    "another sign": executive(E, 100, minus),
    "-0 for 0": executive(RATE, 7, minus),
    "the first row": executive(E, 0, ulp),
    "the last row": executive(E, 199, ulp),
    "the time": executive(TIME, 50, ulp),
    "the state": executive(STATE, 100, always(4.0)),
    "a NaN": executive(E, 100, always(math.nan), why="= nan rad, limit 1000", tested=BROKEN),
    "an infinity": executive(E, 100, always(math.inf), why="= inf rad", tested=BROKEN),
    "too much": executive(E, 100, always(2000.0), why="= 2000 rad", tested=BROKEN),
    "an ulp of the plant": Want(value("plant", THETA, 100, ulp), f"plant.{THETA}", THETA),
    "a NaN in both": Want(
        both(value("plant", THETA, 100, always(math.nan)), value("executive", E, 100, ulp)),
        f"plant.{THETA}",
        THETA,
        why=f"plant:{THETA} is not a finite number at 0.1 s",
        tested={"R-2": "violated"},
    ),
    "two, the later cycle first": Want(
        both(value("executive", E, 60, ulp), value("executive", R, 59, minus)), R, R
    ),
    "a count of lost frames": Want(
        value("executive", "health.frames_lost", 199, always(3.0)), again="health.frames_lost"
    ),
    "frames that were missed": Want(
        value("executive", "health.frames_missed", 199, always(3.0)),
        again="health.frames_missed",
        verdict="loss",
        why="3 frames lost, first at 0.199 s",
    ),
    "a measured time": Want(value("executive", "timing.step_us", 199, always(math.nan))),
    "late cycles": Want(value("executive", "health.late_cycles", 199, always(7.0))),
    "a received byte": Want(
        frame("executive", 100, -1), "frame MOTPOS received", "health.frames_received"
    ),
    "a byte that the plant received": Want(
        frame("plant", 100, -1), "frame plant.CMD received", "rx.CMD.motor_torque"
    ),
    "the cycle of a frame": Want(
        frame("executive", 100, 12), "frame MOTPOS received", "incomplete"
    ),
    "the stamp of a frame": Want(frame("executive", 100, 8)),
    "all stamps": Want(rewritten(later)),
    "a fault": damaged(
        event("/events", name="INPUT_MISSING"),
        "/events and /tunings: 4 messages",
        "safety stop",
        tested=OPEN,
    ),
    "a fault of the plant": damaged(
        event("/plant/events", name="INPUT_MISSING"),
        "/plant/events and /plant/tunings: 4",
        "safety stop",
        tested=OPEN,
    ),
    "an alarm": damaged(event("/events", event="alarm", name="late"), "4 messages where"),
    "a tuning": damaged(
        event("/tunings", name="controller.kv_Nms_rad", value=111.0), "4 messages where"
    ),
    "no end": damaged(rewritten(stopped), "/events and /tunings: 1 of 3 messages"),
    "each node said what the other did": damaged(
        rewritten(swapped), "/state: 201 messages", first=SYNC, tested=OPEN
    ),
    "the tail": damaged(
        part("the tail is cut"), "/state: 100 of 200 messages", first=SYNC, tested=OPEN
    ),
    "the middle": damaged(
        part("the middle is cut"), "/timing: 100 of 200 messages", first=SYNC, tested=OPEN
    ),
    "the states": damaged(
        part("the states are dropped"), "/state: 200 of 200 messages", tested=OPEN
    ),
    "the timing": damaged(part("the timing is dropped"), "/timing: 200 of 200 messages"),
    "a frame": damaged(part("a frame is dropped"), "/plant/can/frames: 5 of 1057", first=SYNC),
    "the plant": damaged(
        part("the plant is dropped"),
        "/plant/state: 201 of 201",
        first=SYNC,
        tested={"R-2": "violated"},
    ),
    "a cycle twice": damaged(
        part("a cycle stands twice"), "behind later ones: 1 messages of /state"
    ),
    "parts that changed places": damaged(
        part("the parts changed places"), "/can/frames: 1083 of 1101", first="frame FB_A received"
    ),
    "no counts": damaged(part("the counts are dropped"), "the recorder's counts"),
    "no metadata": damaged(part("all metadata are dropped"), "the recorder's counts"),
    # what is told of it
    "it is a branch": Want(
        facts(BOTH, branch_of="/x/run/log.mcap", branch_cycle="50", branch_sha256="0" * 64),
        why="no run: a branch at cycle 50",
    ),
    "the rig's name": Want(facts(BOTH, rig="other")),
    "the rig's name in one node": Want(facts(["plant"], rig="other")),
    "the controller's name": Want(facts(BOTH, controller="pid")),
    "without its checksum": damaged(facts(BOTH, False, controller="pid"), "metadata at byte "),
    "the seed": Want(facts(BOTH, seed="9")),
    "the commit": Want(facts(BOTH, git="0" * 12)),
    "the version": Want(facts(BOTH, version_pcpc="9.9")),
    "the pacing": Want(facts(BOTH, pacing="real")),
    "the period": Want(facts(BOTH, period_ns="2000000")),
    "the rate": Want(facts(BOTH, rate_hz="500.0")),
    "the clock": Want(facts(BOTH, clock_wall_ns="17")),
    "no facts": Want(facts(BOTH, rig=None, controller=None, seed=None)),
    "fewer rows": damaged(facts(["run"], written__executive__record="100"), "/state: 200 messages"),
    "more rows": damaged(facts(["run"], written__executive__record="300"), "/state: 100 of 300"),
    "rows were dropped": Want(
        facts(["run"], dropped__executive__record="5"), verdict="loss", why="5 rows found a ring"
    ),
    "frames were dropped": Want(
        facts(["run"], dropped__executive__frame="5"),
        again="incomplete",
        verdict="loss",
        why="5 rows found a ring",
    ),
    "messages were discarded": damaged(facts(["run"], discarded="7"), "cycles and frames: "),
    "frames of an id": Want(facts(["frames"], executive__sent__80="300")),
    # its copies of files
    "no requirement": Want(rig(require=[]), tested={"R-1": "", "never time.t_s > 9": ""}),
    "no limit": Want(rig(expect__pd={}), tested={"R-2": ""}),
    "neither": Want(rig(require=[], expect__pd={}), why=NOTHING, tested=GONE),
    "a limit is widened": Want(rig(expect__pd__muzzle_error_rms_mrad={**LIMIT, "high": 1e9})),
    "a limit is narrowed": Want(
        rig(expect__pd__muzzle_error_rms_mrad={**LIMIT, "high": 0.0}),
        why="R-2 muzzle_error_rms_mrad = 0.2095, expected 0 to 0",
        tested={"R-2": "violated"},
    ),
    "another requirement": Want(
        rig(require__0__never="abs(controller.e_rad) >= 0"), why="R-1 never", tested=BROKEN
    ),
    "a gain": Want(
        rig(controllers__pd__parameters__kv_Nms_rad=120.0), again="controller.motor_torque_Nm"
    ),
    "the seed of the rig": Want(rig(seed=9), again=HUB),
    "the rate of the rig": Want(rig(rate_hz=500.0), again=TIME),
    "the duration of the rig": Want(
        rig(duration_s=0.1), again="end of the node", tested={"R-2": "not judged"}
    ),
    "the window": Want(rig(evaluation__window_s=[0, 9]), tested={"R-2": "not judged"}),
    "the title": Want(rig(title="x")),
    "an unknown key": Want(
        rig(nonsense=1),
        again="incomplete",
        verdict="not judged",
        why="nonsense: unknown key",
        tested=GONE,
    ),
    "no rig": Want(
        attached(RIG, lambda data: None),
        again="incomplete",
        verdict="not judged",
        tested=GONE,
    ),
    "no YAML": Want(
        attached(RIG, lambda data: b"{{{"),
        again="incomplete",
        verdict="not judged",
        why="rig.yaml:1:4: ",
        tested=GONE,
    ),
    "the evaluation's code": Want(attached("evaluation.py", lambda data: b"import os\n" + data)),
    "no evaluation": Want(attached("evaluation.py", lambda data: None)),
    "no database": Want(attached(".dbc", lambda data: None), again="incomplete"),
    "fewer cycles": Want(described(cycles=100)),
    "more cycles": Want(described(cycles=1000), why="200 of 1,000 cycles: the log", tested=OPEN),
    "another period": Want(described(period_ns=2_000_000)),
    "no description": damaged(attached("executive.json", lambda data: None), "its description is"),
    "half a description": damaged(
        attached("executive.json", lambda data: data[:500]), "its description is not readable"
    ),
    "columns of one another": Want(attached("executive.json", columns_swapped)),
    "a law from outside": Want(described(external=["controller"]), again="incomplete", tested=OPEN),
    # its files
    "half the log": damaged(cut(0.5), "the end: nothing is readable", first=SYNC, tested=OPEN),
    "its last byte": damaged(cut(0.99999), "the summary at the end is damaged"),
    "a bit of it": damaged(flipped(0.5), "damaged", first=SYNC, tested=OPEN),
    "a bit of its head": damaged(flipped(0.09), "attachment at byte", "not judged", tested=GONE),
    "a bit of its tail": damaged(flipped(0.97), "damaged"),
    "a byte more": damaged(of_file(LOG, lambda data: data + b"x"), "the summary at the end"),
    "an empty log": Want(cut(0), *NO, "not an MCAP file", GONE),
    "a text": Want(of_file(LOG, lambda data: b"x"), *NO, "not an MCAP", GONE),
    "a folder": Want(gone(LOG, Path.mkdir), *NO, "Is a directory", GONE),
    "no log": Want(gone(LOG), *NO, "No such file", GONE),
    "the log of another seed": Want(copied("seed", LOG), f"plant.{HUB}"),
    "all of another seed": Want(copied("seed", LOG, SUMMARY), f"plant.{HUB}", verdict="ok", why=""),
    "a branch": Want(copied("branch", LOG, SUMMARY), verdict="ok", why="no run: a branch at"),
    "a branch as a run": Want(
        both(
            copied("branch", LOG),
            facts(BOTH, branch_of=None, branch_cycle=None, branch_sha256=None),
        )
    ),
    # what lies beside the log
    "a figure": Want(of_file("figure.png", lambda data: PNG), verdict="ok", why=""),
    "the summary is written anew": Want(of_file(SUMMARY, compact), verdict="ok", why=""),
}
PAPERS: dict[str, Lie] = {  # what is done to summary.json alone: its bits and the log stay
    "of another seed": copied("seed", SUMMARY),
    "a folder": gone(SUMMARY, Path.mkdir),
    "a link to nothing": gone(SUMMARY, lambda path: path.symlink_to("nowhere")),
    "empty": of_file(SUMMARY, lambda data: b""),
    "cut": of_file(SUMMARY, lambda data: data[:900]),
    "a list": of_file(SUMMARY, lambda data: b"[]"),
    "a key twice, the first true": of_file(SUMMARY, lambda data: data[:-3] + b',"verdict":"ok"}'),
    "a key twice, the last true": of_file(SUMMARY, lambda data: b'{"verdict":"loss",' + data[1:]),
    "a key more": summary(extra=1),
    "not bound": summary(bound=None),
    "bound to another log": summary(bound={LOG: "0" * 64, SUMMARY: "0" * 64}),
    **{f"{key}: {new!r}": summary(**{key: new}) for key, new in (
        ("rig", "x"), ("title", "x"), ("controller", "pid"), ("pacing", "real"), ("bus", "can0"),
        ("seed", 7), ("rate_hz", 1.0), ("rig_git", "0" * 12), ("cycles", 7), ("late_cycles", 7),
        ("skipped_cycles", 7), ("held_cycles", 7), ("metrics", {"muzzle_error_rms_mrad": 0.1}),
        ("timing_us", {"step": {}}), ("timing_level", "WARN"), ("timing_share", 0.1),
        ("latest_cycles", [{}]), ("frames", {}), ("frames_too_many", ["x"]), ("lost", ["x"]),
        ("warned", ["x"]), ("most_cut", "x"), ("frames_to", {}), ("records", {"written": 7}),
        ("faults", ["x"]), ("injected", ["x"]), ("changed", ["a=1"]), ("judged", []),
        ("not_judged", {"x": "y"}), ("expectations_failed", ["x"]), ("requirements", []),
        ("realtime", True), ("start_to_first_cycle_s", 1.0), ("log_missing", ["x"]),
        ("verdict", "loss"), ("ids", {}),
    )},
}  # fmt: skip


@pytest.fixture
def folder(runs: Path) -> Iterator[Path]:
    """Return a copy of the run, beside the others."""
    shutil.copytree(runs / "run", made := runs / "lie")
    yield made
    shutil.rmtree(made)


@pytest.mark.parametrize("name", LIES)
def test_all_who_look_at_a_run_say_the_same(name: str, folder: Path) -> None:
    want = LIES[name]
    want.lie(folder)
    missing, first = differences(folder, folder.with_name("run"))
    assert first == want.first and bool(missing) == bool(want.missing), (missing, first)
    assert missing == NO_LOG or not missing or any(want.missing in one for one in missing), missing
    assert recomputed(folder / LOG) == want.again
    word, problems, tested = verdicts(folder)
    assert word == want.verdict, (word, problems)
    assert any(want.why in line for line in problems) if want.why else not problems, problems
    told = {key: tested.get(key, "") for key in (*OPEN, *tested) if tested.get(key) != "ok"}
    assert told == (want.tested or {})


@pytest.mark.parametrize("name", PAPERS)
def test_who_reads_a_summary_says_when_it_is_of_another_run(name: str, folder: Path) -> None:
    PAPERS[name](folder)
    word, problems, tested = verdicts(folder)
    assert (word, problems, {*tested.values()}) == (UNMET, [DOUBT], {"ok"})
    (pair,) = printed("compare", folder.with_name("run") / LOG, folder / LOG)["pairs"]
    assert pair["doubts"] == [f"{folder / LOG}: {DOUBT}"] and pair["state"] == "failed"


def test_a_branch_of_a_run_that_was_changed_is_told(folder: Path) -> None:
    executive(E, 100, ulp).lie(folder)
    out = folder / "branch"
    done = run_here("branch", folder, "--cycle", "50", "-o", out, "--no-figure", "--quiet")
    assert done.code == 1 and DOUBT in " ".join(done.out.split()), done
    executive(E, 40, ulp).lie(folder)
    done = run_here("branch", folder, "--cycle", "50", "-o", out / "b", "--no-figure", "--quiet")
    assert done.code == 2 and "laws or versions have changed" in done.err, done


def test_a_folder_with_a_lie_in_it_is_not_ok(folder: Path, tmp_path: Path) -> None:
    def answers() -> tuple[int, int]:
        words = "report", "--suite", folder.parent, "-o", folder.parent / "a.html", "--quiet"
        return run_here(*words).code, run_here("compare", folder.parent, folder.parent).code

    out = shutil.move(folder.with_name("branch"), tmp_path)
    assert answers() == (0, 0)
    for lie in (gone(LOG), of_file(SUMMARY, lambda data: data + b"x")):
        lie(folder)
        assert all(answers())
        shutil.copytree(folder.with_name("run"), folder, dirs_exist_ok=True)
    assert answers() == (0, 0)
    shutil.move(out, folder.parent)
    assert answers() == (1, 0), "a branch is no run"
