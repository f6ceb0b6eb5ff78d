"""`pcpc set|lock` on a real run, the same from Python, and what the log of that run holds."""

import fcntl
import json
import math
import signal
import sys
import termios
import threading
from dataclasses import replace
from typing import IO

import pytest
from live_run import ERROR, KV, LAM, Run, Screen, said, value
from processes import DEADLINE_S, until

from pcpc.executive.log import reader as logs
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.requests import SLOTS, Refusal
from pcpc.executive.nodes import live

PAIRS = 25


def bytes_ready(pipe: IO[str] | None) -> int:
    """Return how many bytes wait in a pipe of a process."""
    count = bytearray(4)
    assert pipe is not None
    fcntl.ioctl(pipe, termios.FIONREAD, count)
    return int.from_bytes(count, sys.byteorder)


@pytest.fixture(scope="module")
def finished(run: Run) -> logs.Log:
    """End the run with Ctrl-C, once its watcher has seen some of it, and return its log."""
    until(lambda: bytes_ready(run.watcher.stdout) > 400, "lines of the watcher")
    run.host.send_signal(signal.SIGINT)
    output = run.host.communicate(timeout=DEADLINE_S)
    assert run.host.returncode == 130, f"exit code {run.host.returncode}: {output}"
    return logs.read(run.folder / "log.mcap")


# Tuning


@pytest.mark.quick  # another test looks for its value in the log
def test_a_tuning_is_acknowledged_with_its_cycle(run: Run, capsys: Screen) -> None:
    before = value(capsys, run, KV)
    code, out, err = said(capsys, run, "set", f"{KV}=121.5", "--json")
    assert code == 0, err
    answer = json.loads(out)
    block = live.find(run.node).block
    assert 0 < answer["cycle"] <= int(block.control.cycle) + 1, out
    assert answer["values"] == {KV: 121.5}
    assert answer["before"] == {KV: before}
    until(lambda: value(capsys, run, KV) == 121.5, "the value is in the table")


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
        (["=3"], "=3: expected NAME=VALUE"),
        ([""], "'': expected NAME=VALUE"),
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
    requests = int(live.find(run.node).block.mail.request)
    code, out, err = said(capsys, run, "set", "controller.km_Nms_rad=61", *words)
    assert (code, out, err) == (2, "", message + "\n")
    posted = int(live.find(run.node).block.mail.request) - requests
    assert posted == 0, f"{posted} requests in the mailbox"
    assert value(capsys, run, "controller.km_Nms_rad") == 60.0


def test_more_values_than_the_mailbox_holds_are_refused(run: Run) -> None:
    changes = {f"controller.p_{i}": 0.0 for i in range(SLOTS + 1)}
    with pytest.raises(live.LiveError, match="65 values; at most 64 apply at once"):
        live.find(run.node).tune(changes)


@pytest.mark.parametrize("level", ["tune", "all"])
def test_a_lock_forbids_tunings_until_it_is_lifted(run: Run, capsys: Screen, level: str) -> None:
    before = value(capsys, run, KV)
    assert said(capsys, run, "operate", "lock", level) == (0, f"lock {level}\n", "")
    code, out, err = said(capsys, run, "set", f"{KV}=77")
    assert (code, out) == (2, ""), out
    assert f"locked ({level}); `pcpc operate lock none` allows tunings" in err, err
    assert value(capsys, run, KV) == before
    assert said(capsys, run, "operate", "lock", "none")[0] == 0
    assert said(capsys, run, "set", f"{KV}={before}")[0] == 0


def ask(block: sh.NodeMemory, places: list[int], values: list[float]) -> int:
    """Post a request without any check, as a program of somebody else may; return the answer."""
    block["mail_index"][: len(places)], block["mail_value"][: len(values)] = places, values
    block.mail.count = len(places)
    request = int(block.mail.request) + 1
    block.mail.request = request
    until(lambda: int(block.answer.request) == request, "an answer")
    return int(block.answer.refusal)


def test_the_node_refuses_what_a_client_did_not_check(run: Run, capsys: Screen) -> None:
    node = live.find(run.node)
    block = node.block
    table = block.description["variables"]
    places = {row[0]: at for at, row in enumerate(table)}
    before, refused = node.read(), value(capsys, run, "health.requests_refused")
    for wrong in (1e300, math.inf, math.nan, -500.0, 1000.5):
        assert ask(block, [places[LAM], places[KV]], [9.0, wrong]) == Refusal.OUT_OF_RANGE, wrong
    others = [at for at, (_, _, kind, _, _) in enumerate(table) if kind != "parameter"]
    for at in (*others, -1, len(table), 2**62):
        assert ask(block, [places[KV], at], [99.0, 7.0]) == Refusal.NO_PARAMETER, at
    now = value(capsys, run, "health.requests_refused")
    assert now == refused + 5 + len(others) + 3, f"{now - refused} counted"
    after = node.read()
    parameters = [name for name, one in node.variables.items() if one.kind == "parameter"]
    assert parameters and all(after[name] == before[name] for name in parameters)
    assert node.running and not block.control.fault


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
    code, out, err = said(capsys, run, "operate", "lock", "tunes")
    assert (code, out, err) == (2, "", "tunes: no such lock level; did you mean tune?\n")


@pytest.mark.quick  # as well
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


# From Python


def test_all_values_that_are_read_are_of_one_cycle(run: Run) -> None:
    node = live.find(run.node)
    first = node.read()
    later = node.wait_until(lambda now: now.cycle > first.cycle + 3, within_s=DEADLINE_S)
    for now in (first, later):
        assert now.cycle == round(200 * now["time.t_s"]), (now.cycle, now["time.t_s"])
        assert set(now) == set(node.variables) and len(now) == len(node.variables)
    with pytest.raises(live.LiveError, match=f"did you mean {ERROR}"):
        later["controller.e_rat"]


def test_a_wait_ends_with_the_values_for_which_its_condition_holds(run: Run) -> None:
    node = live.find(run.node)
    cycle = node.tune({KV: 123.0})
    now = node.wait_until(lambda now: now[KV] == 123.0, within_s=DEADLINE_S)
    assert now[KV] == 123.0 and now.cycle >= cycle, (now.cycle, cycle)


def test_a_wait_looks_once_a_period(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    node = live.find(run.node)
    looks: list[live.CycleValues] = []
    asked: list[int] = []
    read = node.read

    def looking() -> live.CycleValues:
        looks.append(read())
        return looks[-1]

    def tenth(now: live.CycleValues) -> bool:
        asked.append(now.cycle)
        return len(asked) == 10

    monkeypatch.setattr(node, "read", looking)
    node.wait_until(tenth, within_s=DEADLINE_S)
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

    def miracle(now: live.CycleValues) -> bool:
        if not looks:
            run.host.send_signal(signal.SIGINT)
        looks.append(now.cycle)
        return False

    with pytest.raises(live.LiveError, match="a miracle: the node ended first"):
        node.wait_until(miracle, 60.0, "a miracle")
    assert not node.running and looks, looks


def test_watch_ends_with_the_node(run: Run, finished: logs.Log) -> None:
    out, err = run.watcher.communicate(timeout=DEADLINE_S)
    said = [text for text in err.splitlines() if ": alarm: " not in text]  # the machine was late
    assert (run.watcher.returncode, said) == (0, []), f"{run.watcher.returncode}: {err}"
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
