"""`pcpc list|get|set|watch|lock` on a real run: two nodes, a recorder, one bus of their own.

200 Hz and a patient supervisor: these tests are about the table, on a machine that may be busy.
"""

import json
import math
import os
import pty
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import standing
from copies import program
from free_bus import own_bus

from pcpc.executive.log import reader as logs
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.nodes import live
from pcpc.tools.cli import main

ROOT = Path(__file__).resolve().parents[2]
RIG = ROOT / "plants/atb1000/rigs/hull.yaml"
KV, LAM, ERROR = "controller.kv_Nms_rad", "controller.lam_per_s", "controller.e_rad"
START_S = 180.0  # on a machine that compiles first
ANSWER_S = 10.0
PAIRS = 25


def until(what: str, holds: Callable[[], bool], within_s: float = ANSWER_S) -> None:
    """Return once `holds`; fail after `within_s`."""
    deadline_s = time.monotonic() + within_s
    while not holds():
        assert time.monotonic() < deadline_s, f"not within {within_s:g} s: {what}"
        time.sleep(0.005)


def pcpc(*words: str) -> subprocess.Popen[str]:
    """Start the command with its output in pipes."""
    return subprocess.Popen(
        [program(), *words],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


@dataclass
class Run:
    """A run that goes on until it is told to stop."""

    host: "subprocess.Popen[str]"
    folder: Path
    node: str
    watcher: "subprocess.Popen[str]"


def alone(run: Run, monkeypatch: pytest.MonkeyPatch, beside: str = "") -> None:
    """Leave nodes of other runs of this machine, but for `beside`, out of the search for one."""
    bus, every = run.node.removesuffix(".executive"), live.running

    def known(rig: str = "") -> dict[str, live.Live]:
        return {n: b for n, b in every(rig).items() if n.startswith(f"{bus}.") or n == beside}

    monkeypatch.setattr(live, "running", known)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    folder = tmp_path_factory.mktemp("run")
    bus = own_bus()
    settings = ("duration_s=600", "rate_hz=200", "supervisor.fault_after_cycles=400")
    words = [word for setting in settings for word in ("--set", setting)]
    host = pcpc("run", str(RIG), "--bus", bus, *words, "-o", str(folder), "--no-figure", "--quiet")
    node = sh.block_name("hull", bus, "executive")

    def is_up() -> bool:
        assert host.poll() is None, f"the run ended: {host.communicate()}"
        try:
            return int(sharing.attach(node)["control"][sh.PASSES]) > 0
        except sh.SharedError:
            return False

    try:
        until("first cycle", is_up, START_S)
        watcher = pcpc("watch", ERROR, "--json", "--every", "100ms", "--node", node)
        yield Run(host, folder, node, watcher)
    finally:
        host.send_signal(signal.SIGINT)
        host.communicate(timeout=30)


@pytest.fixture(scope="module")
def finished(run: Run) -> logs.Log:
    """End the run with Ctrl-C and return its log."""
    run.host.send_signal(signal.SIGINT)
    output = run.host.communicate(timeout=30)
    assert run.host.returncode == 130, f"exit code {run.host.returncode}: {output}"
    return logs.read(run.folder / "log.mcap")


Screen = pytest.CaptureFixture[str]


def said(screen: Screen, run: Run, *words: str) -> tuple[int, str, str]:
    """Return exit code, stdout and stderr of a subcommand on the run's executive."""
    code = main([*words, "--node", run.node])
    return code, *screen.readouterr()


def value(screen: Screen, run: Run, name: str) -> float:
    code, out, err = said(screen, run, "get", name, "--json")
    assert code == 0, err
    return float(json.loads(out)[name])


# Reading


def test_list_shows_value_unit_kind_and_range_below_a_header(run: Run, capsys: Screen) -> None:
    code, out, err = said(capsys, run, "list", "controller.k*")
    assert code == 0, err
    firsts = [line.split()[0] for line in out.splitlines()]
    assert firsts == ["name", KV, "controller.km_Nms_rad"], out
    words = out.splitlines()[2].split()
    assert words[1:] == ["60", "N", "m", "s/rad", "parameter", "0..1000"], out


def test_long_list_adds_writer_and_help_within_80_columns(
    run: Run, capsys: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for words in (["list"], ["list", "--long"]):
        code, out, err = said(capsys, run, *words)
        assert code == 0, err
        assert [line for line in out.splitlines() if len(line) > 80] == []
    assert "drive-shaft" in out and "controller:" in out, out


def test_list_without_a_pattern_shows_the_whole_table(run: Run, capsys: Screen) -> None:
    code, out, _ = said(capsys, run, "list", "--json")
    rows = {row["name"]: row for row in json.loads(out)}
    assert code == 0
    assert len(rows) == len(sharing.attach(run.node).description["variables"]), len(rows)
    assert rows[ERROR]["kind"] == "output", rows[ERROR]
    assert rows["rx.FB_A.encoder"]["unit"] == "rad", rows["rx.FB_A.encoder"]
    assert rows["rx.FB_A.encoder"]["writer"] == "FB_A", rows["rx.FB_A.encoder"]
    assert rows[KV]["range"] == [0.0, 1000.0] and rows[ERROR]["range"] is None, rows[KV]


def test_a_pattern_that_matches_nothing_is_wrong_input(run: Run, capsys: Screen) -> None:
    code, out, err = said(capsys, run, "list", "nothing.*")
    assert (code, out) == (2, ""), out
    assert err == "nothing.*: matches no variable; `pcpc list` shows all\n", err


def test_get_prints_value_and_unit(run: Run, capsys: Screen) -> None:
    code, out, _ = said(capsys, run, "get", "controller.gear_ratio", "controller.km_Nms_rad")
    assert code == 0
    assert out == "controller.gear_ratio = 60\ncontroller.km_Nms_rad = 60 N m s/rad\n", out


def test_get_of_an_unknown_name_suggests_the_likely_one(run: Run, capsys: Screen) -> None:
    code, out, err = said(capsys, run, "get", KV, "controller.e_rat")
    assert (code, out) == (2, ""), out
    assert err == "controller.e_rat: no such variable; did you mean controller.e_rad?\n", err


def test_snapshots_never_mix_two_cycles(run: Run) -> None:
    node = live.find(run.node)
    encoder, copied = "rx.FB_A.encoder", "controller.encoder_rad"
    times: set[float] = set()
    deadline_s = time.monotonic() + ANSWER_S
    while len(times) < 60 and time.monotonic() < deadline_s:
        table = node.read()
        assert table[encoder] == table[copied], f"{table[encoder]} became {table[copied]}"
        times.add(table["time.t_s"])
    assert len(times) == 60, f"only {len(times)} cycles seen"


def test_the_plant_of_the_same_run_has_a_table_of_its_own(run: Run, capsys: Screen) -> None:
    plant = run.node.replace(".executive", ".plant")
    assert main(["get", "barrel.fire", "--node", plant]) == 0
    out = capsys.readouterr().out
    assert out.startswith("barrel.fire = 0"), out


@pytest.mark.parametrize(
    ("names", "role"),
    [
        (["barrel.theta_rad"], "plant"), (["barrel.theta*"], "plant"), ([ERROR], "executive"),
        (["time.t_s"], "executive"), (["time.t_s", "barrel.theta_rad"], "plant"), ([], "executive"),
    ],
)  # fmt: skip
def test_the_node_that_has_a_variable_is_found(
    run: Run, names: list[str], role: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone(run, monkeypatch)
    assert live.find_for(names).name.endswith(role)


def test_a_variable_is_found_by_its_node_and_name(
    run: Run, capsys: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone(run, monkeypatch)
    for words in (["plant:barrel.gap_rad"], ["barrel.gap_rad"], [f"executive:{KV}"], [KV]):
        assert main(["get", *words]) == 0, capsys.readouterr().err
        assert capsys.readouterr().out.startswith(words[0].rpartition(":")[2]), words
    code = main(["get", "plant:barrel.gap_rad", f"executive:{KV}"])
    assert code == 2 and "no node has all of them" in capsys.readouterr().err


def test_variables_of_no_single_node_are_refused(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    alone(run, monkeypatch)
    with pytest.raises(live.LiveError, match="no node has all of them"):
        live.find_for([ERROR, "barrel.theta_rad"])
    with pytest.raises(live.LiveError, match=r"did you mean barrel\.theta_rad\?"):
        live.find_for(["barrel.teta_rad"])


# Tuning


def test_a_tuning_is_acknowledged_with_its_cycle(run: Run, capsys: Screen) -> None:
    before = value(capsys, run, KV)
    code, out, err = said(capsys, run, "set", f"{KV}=121.5", "--json")
    assert code == 0, err
    answer = json.loads(out)
    block = live.find(run.node).block
    assert 0 < answer["cycle"] <= int(block["control"][sh.CYCLE]) + 1, out
    assert answer["values"] == {KV: 121.5}
    assert answer["before"] == {KV: before}
    until("the value is in the table", lambda: value(capsys, run, KV) == 121.5)


def test_set_says_old_value_new_value_and_cycle(run: Run, capsys: Screen) -> None:
    code, out, err = said(capsys, run, "set", f"{LAM}=15")
    assert code == 0, err
    assert out.startswith(f"{LAM} = 15 1/s (was "), out
    assert int(out.split(" from cycle ")[1]) > 0, out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([f"{KV}=1000.5"], f"{KV}: 1000.5 is outside 0..1000 N m s/rad"),
        ([f"{KV}=nan"], f"{KV}: nan is outside 0..1000 N m s/rad"),
        ([f"{KV}=high"], f"{KV}=high: 'high' is not a number"),
        ([KV], f"{KV}: expected NAME=VALUE"),
        ([f"{KV}=99", f"{KV}=98"], f"{KV}: given twice"),
        (["controller.kv=99"], f"controller.kv: no such variable; did you mean {KV}?"),
        (
            [f"{ERROR}=0"],
            f"{ERROR}: output, written by controller every cycle; only parameters can be set",
        ),
        (
            ["rx.FB_A.encoder=0"],
            "rx.FB_A.encoder: received, written by FB_A every cycle; only parameters can be set",
        ),
    ],
)
def test_a_wrong_tuning_is_refused_with_all_that_came_with_it(
    run: Run, capsys: Screen, words: list[str], message: str
) -> None:
    requests = int(live.find(run.node).block["mail"][sh.REQUEST])
    code, out, err = said(capsys, run, "set", "controller.km_Nms_rad=61", *words)
    assert (code, out, err) == (2, "", message + "\n")
    posted = int(live.find(run.node).block["mail"][sh.REQUEST]) - requests
    assert posted == 0, f"{posted} requests in the mailbox"
    assert value(capsys, run, "controller.km_Nms_rad") == 60.0


def test_more_values_than_the_mailbox_holds_are_refused(run: Run) -> None:
    changes = {f"controller.p_{i}": 0.0 for i in range(sh.MAIL_SLOTS + 1)}
    with pytest.raises(live.LiveError, match="65 values; at most 64 apply at once"):
        live.find(run.node).tune(changes)


@pytest.mark.parametrize("level", ["tune", "all"])
def test_a_lock_forbids_tunings_until_it_is_lifted(run: Run, capsys: Screen, level: str) -> None:
    before = value(capsys, run, KV)
    assert said(capsys, run, "lock", level) == (0, f"lock {level}\n", "")
    code, out, err = said(capsys, run, "set", f"{KV}=77")
    assert (code, out) == (2, ""), out
    assert f"locked ({level}); `pcpc lock none` allows tunings" in err, err
    assert value(capsys, run, KV) == before
    assert said(capsys, run, "lock", "none")[0] == 0
    assert said(capsys, run, "set", f"{KV}={before}")[0] == 0


def ask(block: sh.Shared, places: list[int], values: list[float]) -> int:
    """Post a request without any check, as a program of somebody else may; return the answer."""
    block["mail_index"][: len(places)], block["mail_value"][: len(values)] = places, values
    block["mail"][sh.COUNT] = len(places)
    request = int(block["mail"][sh.REQUEST]) + 1
    block["mail"][sh.REQUEST] = request
    until("an answer", lambda: int(block["answer"][sh.ACK]) == request)
    return int(block["answer"][sh.REFUSAL])


def test_the_node_refuses_what_a_client_did_not_check(run: Run, capsys: Screen) -> None:
    node = live.find(run.node)
    block = node.block
    table = block.description["variables"]
    places = {row[0]: at for at, row in enumerate(table)}
    before, refused = node.read(), value(capsys, run, "health.requests_refused")
    for wrong in (1e300, math.inf, math.nan, -500.0, 1000.5):
        assert ask(block, [places[LAM], places[KV]], [9.0, wrong]) == sh.OUT_OF_RANGE, wrong
    others = [at for at, (_, _, kind, _, _) in enumerate(table) if kind != "parameter"]
    for at in (*others, -1, len(table), 2**62):
        assert ask(block, [places[KV], at], [99.0, 7.0]) == sh.NO_PARAMETER, at
    now = value(capsys, run, "health.requests_refused")
    assert now == refused + 5 + len(others) + 3, f"{now - refused} counted"
    after = node.read()
    parameters = [name for name, one in node.variables.items() if one.kind == "parameter"]
    assert parameters and all(after[name] == before[name] for name in parameters)
    assert node.running and not block["control"][sh.FAULT]


def test_a_refusal_by_the_node_is_told_in_one_line(run: Run, capsys: Screen) -> None:
    node = live.find(run.node)
    node.variables[KV] = replace(node.variables[KV], range=(-math.inf, math.inf))
    with pytest.raises(live.LiveError) as caught:
        node.tune({LAM: 15.0, KV: -500.0})
    assert str(caught.value) == f"{KV}: refused by the node: it is out of range; nothing was set"
    assert caught.value.code == 2


def test_a_client_cannot_write_what_the_node_publishes(run: Run) -> None:
    block = live.find(run.node).block
    for name in ("control", "seq", "answer", "snapshot", "record", "frame", "event", "stages"):
        with pytest.raises(ValueError, match="read-only"):
            block[name][0] = 0
    private = {"v", "copies", "views", "wire", "limits", "schedule", "tunable_low"}
    assert not private & set(block.arrays), private & set(block.arrays)


def test_an_unknown_lock_level_is_wrong_input(run: Run, capsys: Screen) -> None:
    code, out, err = said(capsys, run, "lock", "tunes")
    assert (code, out, err) == (2, "", "tunes: no such lock level; did you mean tune?\n")


def test_two_hosts_at_once_both_get_their_tunings_through(run: Run) -> None:
    cycles: dict[int, list[int]] = {0: [], 1: []}

    def tune_pairs(host: int) -> None:
        node = live.find(run.node)
        for i in range(PAIRS):
            gain = 100.0 + 2 * i + host
            cycles[host].append(node.tune({KV: gain, LAM: gain / 10.0}))

    hosts = [threading.Thread(target=tune_pairs, args=(host,)) for host in cycles]
    for host in hosts:
        host.start()
    for host in hosts:
        host.join(60.0)
    counts = [len(acknowledged) for acknowledged in cycles.values()]
    assert counts == [PAIRS, PAIRS], f"{counts} of {PAIRS} acknowledged"
    every = [cycle for acknowledged in cycles.values() for cycle in acknowledged]
    assert len(set(every)) == len(every), "two requests were answered with one cycle"


# Watching


def test_watch_prints_a_line_an_interval_and_ends_on_ctrl_c_with_130(run: Run) -> None:
    watching = pcpc("watch", "controller.q_d_*", ERROR, "--every", "10ms", "--node", run.node)
    assert watching.stdout is not None
    head = [watching.stdout.readline() for _ in range(2)]
    lines = [watching.stdout.readline() for _ in range(5)]
    watching.send_signal(signal.SIGINT)
    _, err = watching.communicate(timeout=ANSWER_S)
    assert (watching.returncode, err) == (130, ""), f"{watching.returncode}: {err}"
    cycles = [int(line.split()[0]) for line in lines]
    assert cycles == sorted(set(cycles)), f"cycles {cycles}"
    names = ["cycle", "controller.q_d_rad", "controller.q_d_rate_rad_s", ERROR]
    assert head[0].split() == names and head[1].split() == ["[rad]", "[rad/s]", "[rad]"], head
    assert {len(line) for line in (head[0], *lines)} == {len(head[0])}, (head, lines)


def test_a_watch_that_is_too_wide_for_columns_has_a_line_for_each(run: Run) -> None:
    watching = pcpc("watch", "controller.*_rad", "--every", "10ms", "--node", run.node)
    assert watching.stdout is not None
    lines = [watching.stdout.readline() for _ in range(40)]
    watching.send_signal(signal.SIGINT)
    watching.communicate(timeout=ANSWER_S)
    assert lines[0].startswith("cycle ") and max(map(len, lines)) <= 80, lines
    assert any(line.startswith(f"  {ERROR} ") and line.endswith(" rad\n") for line in lines), lines


def test_watch_on_a_terminal_rewrites_its_lines_in_place(run: Run) -> None:
    ours, theirs = pty.openpty()
    watching = subprocess.Popen(
        [program(), "watch", ERROR, "--every", "10ms", "--node",
         run.node], cwd=ROOT, stdout=theirs,
    )  # fmt: skip
    os.close(theirs)
    seen = b""
    while seen.count(b"\x1b[2A") < 3:
        seen += os.read(ours, 4096)
    watching.send_signal(signal.SIGINT)
    assert watching.wait(ANSWER_S) == 130
    os.close(ours)
    assert seen.count(f"{ERROR} = ".encode()) >= 3, seen


def test_a_watch_that_nobody_reads_any_more_ends_well(run: Run) -> None:
    words = f"{program()} watch {ERROR} --every 10ms --node {run.node}"
    script = f"{words} | head -3 >/dev/null; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("0\n", ""), str(done)


def test_watch_refuses_an_interval_that_is_none(run: Run, capsys: Screen) -> None:
    code, out, err = said(capsys, run, "watch", ERROR, "--every", "5x")
    assert (code, out) == (2, ""), out
    assert err == "5x: not a duration above 0; expected like 500us, 5ms, 10s, 2min\n", err


# Finding


def test_reading_and_tuning_need_no_numba() -> None:
    code = "import sys, pcpc.tools.cli, pcpc.tools.watch; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout == "False\n", done.stdout + done.stderr


def test_an_unknown_node_is_a_missing_environment(run: Run, capsys: Screen) -> None:
    code = main(["get", ERROR, "--node", "hull.nowhere.executive"])
    out, err = capsys.readouterr()
    assert (code, out) == (4, ""), out
    assert err.startswith("hull.nowhere.executive: no such node is running; running: "), err
    assert run.node in err, err


HEAD: dict[str, object] = {
    "variables": [["a.gain", "", "parameter", "a", ""]], "ranges": {"a.gain": [0.0, math.inf]},
    "state_columns": [], "timing_columns": [], "period_ns": 1_000_000, "rig": "stand",
}  # fmt: skip


@pytest.fixture
def stand() -> Iterator[Callable[[str], sh.Shared]]:
    """Return a maker of nodes that only hand out their memory."""
    yield lambda name: standing.stand(name, HEAD)
    standing.end_all()


def test_a_role_that_several_nodes_have_is_refused_with_their_names(
    run: Run, capsys: Screen, stand: Callable[[str], sh.Shared], monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"twin.{os.getpid()}.executive"
    alone(run, monkeypatch, beside=name)
    stand(name)
    code = main(["list"])
    assert live.find_for([ERROR]).name == live.find(run.node).name
    err = capsys.readouterr().err
    assert code == 2, err
    assert name in err and run.node in err and "--node" in err, err


def test_a_node_that_has_ended_is_no_node(stand: Callable[[str], sh.Shared]) -> None:
    name = f"dead.{os.getpid()}.plant"
    stand(name)["control"][sh.DONE] = 1
    for what in ("is leaving", "has left"):
        with pytest.raises(live.LiveError, match="no such node is running") as caught:
            live.find(name)
        assert caught.value.code == 4, f"{what}: exit code {caught.value.code}"
        standing.end(name)


def test_a_node_that_takes_no_tunings_keeps_none_of_them(
    stand: Callable[[str], sh.Shared],
) -> None:
    name = f"stuck.{os.getpid()}.executive"
    block = stand(name)
    block["control"][[sh.PID, sh.PASSES]] = os.getpid(), 1
    with pytest.raises(live.LiveError, match="took no tunings for 2 s; nothing was set"):
        live.find(name).tune({"a.gain": 1.0})
    assert int(block["mail"][sh.COUNT]) == 0, "the request would still apply later"


def test_a_node_that_dies_meanwhile_is_told_to_have_ended(
    stand: Callable[[str], sh.Shared],
) -> None:
    name = f"dying.{os.getpid()}.executive"
    stand(name)["control"][sh.PASSES] = 1
    found = live.find(name)
    standing.end(name)
    with pytest.raises(live.LiveError, match="ended"):
        found.tune({"a.gain": 1.0})


# From Python


def test_all_values_that_are_read_are_of_one_cycle(run: Run) -> None:
    node = live.find(run.node)
    first = node.read()
    later = node.wait_until(lambda now: now.cycle > first.cycle + 3, within_s=ANSWER_S)
    for now in (first, later):
        assert now.cycle == round(200 * now["time.t_s"]), (now.cycle, now["time.t_s"])
        assert set(now) == set(node.variables) and len(now) == len(node.variables)
    with pytest.raises(live.LiveError, match=f"did you mean {ERROR}"):
        later["controller.e_rat"]


def test_a_wait_ends_with_the_values_for_which_its_condition_holds(run: Run) -> None:
    node = live.find(run.node)
    cycle = node.tune({KV: 123.0})
    now = node.wait_until(lambda now: now[KV] == 123.0, within_s=ANSWER_S)
    assert now[KV] == 123.0 and now.cycle >= cycle, (now.cycle, cycle)


def test_a_wait_looks_once_a_period(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    node = live.find(run.node)
    looks: list[live.Values] = []
    asked: list[int] = []
    read = node.read

    def looking() -> live.Values:
        looks.append(read())
        return looks[-1]

    def tenth(now: live.Values) -> bool:
        asked.append(now.cycle)
        return len(asked) == 10

    monkeypatch.setattr(node, "read", looking)
    node.wait_until(tenth, within_s=ANSWER_S)
    assert len(set(asked)) == 10, f"a cycle was judged twice: {asked}"
    assert len(looks) < 40, f"{len(looks)} looks at ten cycles"


def test_a_wait_that_takes_too_long_says_for_what(run: Run) -> None:
    with pytest.raises(live.LiveError, match=r"a miracle: not within 0\.02 s") as caught:
        live.find(run.node).wait_until(lambda now: False, 0.02, "a miracle")
    assert caught.value.code == 1


def test_nodes_are_found_by_rig(run: Run) -> None:
    names = set(live.running("hull"))
    assert {run.node, run.node.replace(".executive", ".plant")} <= names, names
    assert not live.running("no such rig")
    with pytest.raises(live.LiveError, match="no such node is running"):
        live.find("executive", rig="no such rig")


def test_a_variable_says_what_it_is(run: Run) -> None:
    one = live.find(run.node).variables[KV]
    assert (one.unit, one.kind, one.range) == ("N m s/rad", "parameter", (0.0, 1000.0)), one
    assert one.shown(12.5) == "12.5 N m s/rad"


# The end of the run and its log: these come last, they end it


def test_a_wait_ends_with_its_node(run: Run) -> None:
    node, looks = live.find(run.node), []

    def miracle(now: live.Values) -> bool:
        if not looks:
            run.host.send_signal(signal.SIGINT)
        looks.append(now.cycle)
        return False

    with pytest.raises(live.LiveError, match="a miracle: it ended before"):
        node.wait_until(miracle, 60.0, "a miracle")
    assert not node.running and looks, looks


def test_watch_ends_with_the_node(run: Run, finished: logs.Log) -> None:
    out, err = run.watcher.communicate(timeout=ANSWER_S)
    assert (run.watcher.returncode, err) == (0, ""), f"{run.watcher.returncode}: {err}"
    lines = [json.loads(line) for line in out.splitlines()]
    assert len(lines) > 3, out
    executive = finished.node["executive"]
    at = {int(cycle): i for i, cycle in enumerate(executive.cycle)}
    for line in lines[1:-1]:
        logged = float(executive.columns[ERROR][at[line["cycle"]]])
        assert line[ERROR] == logged, f"cycle {line['cycle']}: {line[ERROR]} shown, {logged} logged"


def test_the_log_holds_every_tuning_whole(finished: logs.Log) -> None:
    by_cycle: dict[int, dict[str, float]] = {}
    for entry in finished.node["executive"].tunings:
        by_cycle.setdefault(entry["cycle"], {})[entry["name"]] = entry["value"]
    assert {KV: 121.5} in by_cycle.values(), by_cycle
    assert {LAM: 15.0} in by_cycle.values(), by_cycle
    assert not any("controller.km_Nms_rad" in entry for entry in by_cycle.values()), by_cycle
    pairs = [entry for entry in by_cycle.values() if len(entry) == 2]
    assert len(pairs) == 2 * PAIRS, f"{len(pairs)} pairs"
    torn = [entry for entry in pairs if entry[LAM] != entry[KV] / 10.0]
    assert not torn, f"values of two hosts in one cycle: {torn}"
