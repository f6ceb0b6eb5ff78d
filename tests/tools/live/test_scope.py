"""`pcpc scope`: bursts cut out of rows, and out of real runs whose own logs hold the same bits."""

import json
import os
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import standing
from live_run import Run, Screen, said
from processes import DEADLINE_S, RIGS, Running, own_bus, until
from scoped import CAPTURED, ROWS, WORDS, stepping

from pcpc.executive.laws.units import unit
from pcpc.executive.log import reader as logs
from pcpc.executive.loop import shared as sh
from pcpc.executive.nodes.tap import Rows
from pcpc.executive.rig import expressions as ex
from pcpc.tools.cli import main
from pcpc.tools.live import scope
from pcpc.tools.live.scope import Burst, Trigger

ERROR, TORQUE = "controller.e_rad", "controller.tau_Nm"

# Bursts


def rows_of(x: Sequence[float], first: int = 0, skipped: Sequence[int] = ()) -> Rows:
    """Return cycles from `first` on with the variable a.x, but for the skipped ones."""
    cycle = np.array([k for k in range(first, first + len(x)) if k not in skipped])
    values = np.array(x, float)[cycle - first, None]
    return Rows(cycle, 10 * cycle, values, {"a.x": 0})


def trigger(text: str, pre: int, post: int, armed: int = 0, auto: bool = False) -> Trigger:
    return Trigger(ex.condition(text, lambda name: unit("rad")), 0.001, pre, post, armed, auto)


def bursts(cutter: Trigger, rows: Rows, sizes: Sequence[int]) -> list[Burst]:
    """Feed rows in stretches of these sizes, again and again."""
    found, at, i = list[Burst](), 0, 0
    while at < len(rows):
        part = slice(at, at + sizes[i % len(sizes)])
        some = Rows(rows.cycle[part], rows.stamp_ns[part], rows.values[part], rows.places)
        found += cutter.bursts(some, np.column_stack((some.cycle, some.values.view(np.int64))))
        at, i = part.stop, i + 1
    return found


def told(found: Sequence[Burst]) -> list[tuple[int, bool, list[int]]]:
    return [(one.cycle, one.found, one.rows[:, 0].tolist()) for one in found]


def test_a_burst_lies_around_the_cycle_in_which_the_condition_becomes_true() -> None:
    x = [2.0, 2.0, 0.0, 0.0, 2.0, 2.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0]
    found = bursts(trigger("a.x > 1 rad", pre=2, post=3), rows_of(x), [100])
    # 0 is no edge, 7 lies in the burst of 4, the burst of 11 begins behind it
    assert told(found) == [(4, True, [2, 3, 4, 5, 6, 7]), (11, True, [9, 10, 11, 12, 13, 14])]


def test_no_cycle_is_in_two_bursts_and_skipped_ones_are_in_none() -> None:
    x = [0.0, 2.0, 0.0, 2.0, 2.0, 0.0, 2.0, 2.0]
    found = bursts(trigger("a.x > 1 rad", pre=3, post=1), rows_of(x, skipped=[4]), [1])
    assert told(found) == [(1, True, [0, 1, 2]), (3, True, [3]), (6, True, [5, 6, 7])]


@pytest.mark.parametrize(
    "text", ["a.x > 0 rad", "abs(rate(rate(a.x))) > 1.2e6 rad/s2", "not a.x < 0.5 rad"]
)
def test_bursts_do_not_depend_on_how_the_rows_come(text: str) -> None:
    rng = np.random.default_rng(7)
    rows = rows_of(rng.normal(size=400).tolist(), first=1000, skipped=[1100, 1101, 1250])
    whole = bursts(trigger(text, 7, 5), rows, [400])
    assert len(whole) > 8, len(whole)
    for sizes in ([1], [3, 1, 8], [50, 2]):
        again = bursts(trigger(text, 7, 5), rows, sizes)
        assert told(again) == told(whole), sizes
        for one, other in zip(again, whole, strict=True):
            np.testing.assert_array_equal(one.rows, other.rows)


def test_triggers_before_it_was_armed_do_not_count() -> None:
    x = [0.0, 2.0, 0.0, 0.0, 2.0, 0.0, 2.0, 0.0]
    found = bursts(trigger("a.x > 1 rad", 5, 1, armed=3), rows_of(x), [2])
    assert told(found) == [(4, True, [0, 1, 2, 3, 4, 5]), (6, True, [6, 7])]


def test_auto_captures_without_a_trigger_and_prefers_one() -> None:
    x = [0.0] * 10 + [2.0] + [0.0] * 9
    found = bursts(trigger("a.x > 1 rad", 2, 3, auto=True), rows_of(x), [1])
    cycles = [cycle for cycle, *_ in told(found)]
    assert cycles == [2, 10, 16], told(found)
    assert [one.found for one in found] == [False, True, False]
    assert told(found)[0][2] == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("first", [0, 1000])
def test_a_burst_says_how_much_there_was_not_before_it(first: int) -> None:
    x = [0.0] * 4 + [2.0] + [0.0] * 4 + [2.0] + [0.0] * 3
    short, behind = bursts(trigger("a.x > 1 rad", pre=9, post=2), rows_of(x, first), [1])
    assert (short.short, behind.short) == (5, 0), "the second begins behind the first"
    assert [len(short.rows), len(behind.rows)] == [7, 5]
    (whole,) = bursts(trigger("a.x > 1 rad", pre=4, post=8), rows_of(x, first), [3])
    assert whole.short == 0 and len(whole.rows) == 13


# Real runs


def own(log: logs.Log, node: str, captured: logs.Log) -> None:
    """Compare all that was captured with the run's own log, bit by bit."""
    theirs, ours = log.node[node], captured.node[node]
    at = np.searchsorted(theirs.cycle, ours.cycle)
    np.testing.assert_array_equal(theirs.cycle[at], ours.cycle)
    np.testing.assert_array_equal(theirs.stamp_ns[at], ours.stamp_ns)
    for name, values in {**ours.columns, **ours.timing}.items():
        whole = {**theirs.columns, **theirs.timing}[name]
        np.testing.assert_array_equal(whole[at].view(np.int64), values.view(np.int64), name)


def edges(log: logs.Log, node: str, holds: Sequence[bool]) -> list[int]:
    """Return the cycles of a log in which a condition becomes true."""
    mask = np.asarray(holds)
    return [int(k) for k in log.node[node].cycle[1:][mask[1:] & ~mask[:-1]]]


@pytest.fixture
def held(tmp_path: Path) -> Iterator[tuple[Running, str]]:
    """Return a run in lockstep that waits for its recorder, and its bus: a full ring holds it."""
    bus = own_bus()
    words = ["run", str(RIGS / "hull.yaml"), "--pacing", "lockstep", "--bus", bus, "--quiet",
             "--set", "duration_s=40", "--no-figure", "-o", str(tmp_path / "run")]  # fmt: skip
    with Running(*words) as running:
        recorder = running.pid("recorder")
        os.kill(recorder, signal.SIGSTOP)
        yield running, bus
        if running.process.poll() is None:
            os.kill(recorder, signal.SIGCONT)


def test_what_is_captured_of_a_run_in_lockstep_is_what_its_log_holds(
    held: tuple[Running, str], capsys: Screen, tmp_path: Path
) -> None:
    running, bus = held
    blocks = [running.block("hull", bus, role) for role in ("executive", "plant")]

    def full() -> bool:
        return any(
            block.ends(ring).head - block[f"{ring}_taken"][0] == len(block[ring])
            for block in blocks
            for ring in sh.RINGS
        )

    until(lambda: full() or running.over(), "it waits for the recorder")
    node, file = sh.block_name("hull", bus, "executive"), tmp_path / "burst.mcap"
    code = main(["scope", ERROR, TORQUE, "--trigger", f"{ERROR} > 0.5 mrad and {TORQUE} > 1 N m",
                 "--past", "-o", str(file), "--node", node, "--json"])  # fmt: skip
    out, err = capsys.readouterr()
    assert code == 0, out + err
    (burst,) = json.loads(out)["bursts"]
    os.kill(running.pid("recorder"), signal.SIGCONT)
    done = running.done()
    log, captured = logs.read(tmp_path / "run/log.mcap"), logs.read(file)
    assert set(captured.node["executive"].columns) == {ERROR, TORQUE}, done
    own(log, "executive", captured)
    columns = log.node["executive"].columns
    rising = edges(log, "executive", list((columns[ERROR] > 0.5e-3) & (columns[TORQUE] > 1.0)))
    assert burst["cycle"] in rising, (burst, rising[:5])
    span = range(burst["cycle"] - 200, burst["cycle"] + 1001)
    assert captured.node["executive"].cycle.tolist() == [*span]
    assert captured.node["executive"].events[0]["stamp_ns"] == burst["cycle"] * 10**6


# What can go wrong


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([ERROR, "--trigger", "controller.e_rat > 1 rad"], f"did you mean {ERROR}?"),
        (["controller.e_rat", "--trigger", f"{ERROR} > 1 rad"], f"did you mean {ERROR}?"),
        ([ERROR, "--trigger", f"{ERROR} > 1 N m"], "take values of the same unit"),
        ([ERROR, "--trigger", ERROR], f"expected a condition, like {ERROR} > 0"),
        ([ERROR, "--trigger", "1 > 0"], "1 > 0 names no variable"),
        ([ERROR, "--trigger", ""], "--trigger: '' is not an expression; expected one like"),
        ([ERROR, "--trigger", "controller.kv_Nms_rad > 1"], "parameter, not recorded every cycle"),
        ([ERROR, "--trigger", "controller.encoder_rad > 1"], "take its source rx.FB_A.encoder"),
        (["controller.kv_Nms_rad", "--trigger", f"{ERROR} > 1"], "not recorded every cycle"),
        (["plant:barrel.theta_rad", "--trigger", f"{ERROR} > 1"], "plant: a scope covers one node"),
        ([ERROR, "--trigger", f"{ERROR} > 1", "--pre", "5x"], "--pre 5x: not a duration"),
        ([ERROR, "--trigger", f"{ERROR} > 1", "--plot", "a.txt"], "not a picture"),
        ([ERROR, "--trigger", f"{ERROR} > 1", "--plot", "no/a.png"], "there is no folder no"),
        (["", "--trigger", f"{ERROR} > 1"], "'': names no variable"),
        (["executive:", "--trigger", f"{ERROR} > 1"], "names no variable"),
    ],
)  # fmt: skip
def test_what_cannot_be_captured_is_told_in_a_line(
    run: Run, capsys: Screen, tmp_path: Path, words: list[str], message: str
) -> None:
    file = tmp_path / "burst.mcap"
    code, out, err = said(capsys, run, "scope", *words, "-o", str(file))
    assert (code, out) == (2, ""), out
    assert message in err and err.count("\n") == 1, err
    assert not [*tmp_path.iterdir()]


def test_without_a_trigger_there_is_no_file(run: Run, capsys: Screen, tmp_path: Path) -> None:
    words = [ERROR, "--trigger", f"{ERROR} > 9 rad", "--within", "50ms", "--quiet"]
    code, out, err = said(capsys, run, "scope", *words, "-o", str(tmp_path / "a.mcap"))
    assert (code, out) == (1, ""), out
    assert err == f"{ERROR} > 9 rad: not within 0.05 s, no trigger\n", err
    assert not [*tmp_path.iterdir()]


@pytest.mark.parametrize(("jump", "more"), [(0, []), (300_000, []), (300_000, ["--json"])])
def test_rows_that_were_overwritten_are_a_loss(
    jump: int, more: list[str], capsys: Screen, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, file = f"scoped.{os.getpid()}.executive", tmp_path / "burst.mcap"
    block, go_on = stepping(name, jump)
    monkeypatch.setattr(scope, "time", SimpleNamespace(sleep=go_on, monotonic=lambda: 0.0))
    try:
        code = main([*WORDS, "-o", str(file), "--node", name, *more])
    finally:
        standing.end_all()
    out, err = capsys.readouterr()
    lost = jump + ROWS - len(block["record"]) + 1 if jump else 0
    assert code == (3 if jump else 0), out
    assert (f"{lost} cycles lost" in (err if more else out)) == bool(jump), (out, lost)
    assert not more or json.loads(out)["lost"] == lost, "nothing but JSON on stdout"
    if not jump:
        assert logs.read(file).node["executive"].cycle.tolist() == CAPTURED


@pytest.mark.parametrize(
    ("first", "why"), [(0, "the run began there"), (700, "the node's ring buffer holds no more")]
)
def test_more_before_a_trigger_than_there_was_is_a_line(
    first: int, why: str, capsys: Screen, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"scoped.pre{os.getpid()}.executive"
    _, go_on = stepping(name, first=first)
    monkeypatch.setattr(scope, "time", SimpleNamespace(sleep=go_on, monotonic=lambda: 0.0))
    words = ["scope", "a.*", "--trigger", "a.x > 0.5 rad", "--pre", "2s", "--post", "4ms"]
    try:
        for more in ([], ["--json"]):
            file = str(tmp_path / f"burst{len(more)}.mcap")
            assert main([*words, "-o", file, "--node", name, "--quiet", "--past", *more]) == 0
    finally:
        standing.end_all()
    plain, line, last = capsys.readouterr().out.splitlines()
    assert plain.endswith(": 1 burst, 31 cycles"), plain
    assert line == f"--pre 2s: only 0.026 s, from cycle {first} on: {why}", line
    assert json.loads(last)["bursts"][0]["missing_before"] == 1974, last


# The end of the run: this comes last


def test_what_is_captured_of_a_paced_run_is_what_its_log_holds(
    run: Run, capsys: Screen, tmp_path: Path
) -> None:
    file, picture = tmp_path / "burst.mcap", tmp_path / "burst.png"
    words = ["scope", "controller.*", "time.t_s", "timing.wake_late_us", "--trigger",
             "controller.e_rad > 0.2 mrad", "--pre", "100ms", "--post", "200ms", "--mode", "normal",
             "--count", "2", "-o", str(file), "--plot", str(picture), "--json"]  # fmt: skip
    code, out, err = said(capsys, run, *words)
    answer = json.loads(out.splitlines()[-1])
    assert (code, answer["lost"]) == (0, 0), out + err
    assert picture.stat().st_size > 10_000
    run.host.send_signal(signal.SIGINT)
    run.host.communicate(timeout=DEADLINE_S)
    log, captured = logs.read(run.folder / "log.mcap"), logs.read(file)
    assert captured.missing == [] and set(captured.node) == {"executive"}
    own(log, "executive", captured)
    node, found = log.node["executive"], answer["bursts"]
    assert ERROR in captured.node["executive"].columns
    rising = edges(log, "executive", list(node.columns[ERROR] > 0.2e-3))
    events = captured.node["executive"].events
    assert [one["cycle"] for one in found] == [event["cycle"] for event in events]
    first, second = (one["cycle"] for one in found)
    assert first in rising, (first, rising)
    assert second == next(k for k in rising if k > found[0]["last"]), (found, rising)
    every = [
        int(k)
        for one in found
        for k in node.cycle
        if max(one["first"], one["cycle"] - 20) <= k <= one["cycle"] + 40
    ]
    assert captured.node["executive"].cycle.tolist() == every
    assert main(["log", "export", str(file), "-o-", "--topics", "/state", "--quiet"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1 + sum(one["rows"] for one in found)
