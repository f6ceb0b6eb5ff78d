"""`pcpc get|watch` on a real run, and how its nodes are found."""

import json
import math
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest
import standing
from copies import program
from live_run import ERROR, KV, Run, Screen, alone, pcpc, said
from processes import DEADLINE_S, ROOT

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.nodes import live
from pcpc.tools.cli import main

# Reading


def test_list_shows_value_unit_kind_and_range_below_a_header(run: Run, capsys: Screen) -> None:
    code, out, err = said(capsys, run, "get")
    assert code == 0, err
    rows = {line.split()[0]: line.split()[1:] for line in out.splitlines()}
    assert next(iter(rows)) == "name" and KV in rows, out
    wanted = ["60", "N", "m", "s/rad", "parameter", "0..1000"]
    assert rows["controller.km_Nms_rad"] == wanted, out
    code, out, err = said(capsys, run, "get", "-l", "controller.k*")
    named = [line.split()[0] for line in out.splitlines() if line.startswith("controller.")]
    assert (code, named) == (0, [KV, "controller.km_Nms_rad"]), out


def test_long_list_adds_writer_and_help_within_80_columns(
    run: Run, capsys: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for words in (["get"], ["get", "--long"]):
        code, out, err = said(capsys, run, *words)
        assert code == 0, err
        assert [line for line in out.splitlines() if len(line) > 80] == []
    assert "drive-shaft" in out and "controller:" in out, out


def test_list_without_a_pattern_shows_the_whole_table(run: Run, capsys: Screen) -> None:
    code, out, _ = said(capsys, run, "get", "--json")
    rows = {row["name"]: row for row in json.loads(out)}
    assert code == 0
    assert len(rows) == len(sharing.attach(run.node).description["variables"]), len(rows)
    assert rows[ERROR]["kind"] == "output", rows[ERROR]
    assert rows["rx.FB_A.encoder"]["unit"] == "rad", rows["rx.FB_A.encoder"]
    assert rows["rx.FB_A.encoder"]["writer"] == "FB_A", rows["rx.FB_A.encoder"]
    assert rows[KV]["range"] == [0.0, 1000.0] and rows[ERROR]["range"] is None, rows[KV]


def test_a_pattern_that_matches_nothing_is_wrong_input(run: Run, capsys: Screen) -> None:
    code, out, err = said(capsys, run, "get", "-l", "nothing.*")
    assert (code, out) == (2, ""), out
    assert err == "nothing.*: matches no variable; `pcpc get` shows all\n", err


def test_get_prints_value_and_unit(run: Run, capsys: Screen) -> None:
    code, out, _ = said(capsys, run, "get", "controller.gear_ratio", "controller.km_Nms_rad")
    assert code == 0
    assert out == "controller.gear_ratio = 60\ncontroller.km_Nms_rad = 60 N m s/rad\n", out


def test_get_of_an_unknown_name_suggests_the_likely_one(run: Run, capsys: Screen) -> None:
    code, out, err = said(capsys, run, "get", KV, "controller.e_rat")
    assert (code, out) == (2, ""), out
    assert err == "controller.e_rat: no such variable; did you mean controller.e_rad?\n", err


def test_what_names_no_variable_is_told(run: Run, capsys: Screen) -> None:
    for words in (["set", ""], ["set", "=5"], ["set", "plant:=5"]):
        told = f"{words[1] or repr('')}: expected NAME=VALUE\n"
        assert said(capsys, run, *words) == (2, "", told), words
    for words in (["get", ""], ["get", "plant:"], ["watch", ""]):
        told = f"{words[1]!r}: names no variable; `pcpc get` shows all\n"
        assert said(capsys, run, *words) == (2, "", told), words


def test_snapshots_never_mix_two_cycles(run: Run) -> None:
    node = live.find(run.node)
    encoder, copied = "rx.FB_A.encoder", "controller.encoder_rad"
    times: set[float] = set()
    deadline_s = time.monotonic() + DEADLINE_S
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


def test_variables_of_several_nodes_are_read_with_their_nodes(
    run: Run, capsys: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone(run, monkeypatch)
    labels = ["plant:barrel.gap_rad", f"executive:{KV}"]
    for words in (labels, [label.rpartition(":")[2] for label in labels]):
        assert main(["get", *words, "--json"]) == 0, capsys.readouterr().err
        assert list(json.loads(capsys.readouterr().out)) == labels
    assert main(["get", *labels]) == 0
    assert [line.split(" = ")[0] for line in capsys.readouterr().out.splitlines()] == labels
    assert main(["set", f"executive:{KV}=1", "plant:barrel.gap_rad=0"]) == 2
    err = capsys.readouterr().err
    told = f"executive:{KV}=1 plant:barrel.gap_rad=0: of several nodes"
    assert err == f"{told}; set those of one node\n"
    assert main(["get", "plant:barrel.gap_rad", "--node", run.node]) == 2
    assert "plant:barrel.gap_rad: contradicts --node" in capsys.readouterr().err


def test_a_watch_of_two_nodes_has_a_column_of_each(run: Run) -> None:
    bus = run.node.removesuffix(".executive")
    labels = ["executive:time.t_s", "plant:time.t_s"]
    words = [f"{bus}.{label}" for label in labels]
    for form in ([], ["--json"]):
        watching = pcpc("watch", *words, "--every", "10ms", *form)
        assert watching.stdout is not None
        lines = [watching.stdout.readline() for _ in range(6)]
        watching.send_signal(signal.SIGINT)
        _, err = watching.communicate(timeout=DEADLINE_S)
        assert watching.returncode == 130, err
        if form:
            rows = [json.loads(line) for line in lines]
            assert list(rows[0]) == ["cycle", *labels], rows[0]
            times = [[row[label] for label in labels] for row in rows]
        else:
            assert lines[0].split() == ["cycle", *labels], lines
            times = [[float(cell) for cell in line.split()[1:]] for line in lines[2:]]
        assert all(abs(one - other) < 0.5 for one, other in times), times
        assert times == sorted(times) and times[0] != times[-1], times


def test_variables_of_no_single_node_are_refused(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    alone(run, monkeypatch)
    with pytest.raises(live.LiveError, match="no node has all of them"):
        live.find_for([ERROR, "barrel.theta_rad"])
    with pytest.raises(live.LiveError, match=r"did you mean barrel\.theta_rad\?"):
        live.find_for(["barrel.teta_rad"])


# Watching


def test_watch_prints_a_line_an_interval_and_ends_on_ctrl_c_with_130(run: Run) -> None:
    watching = pcpc("watch", "controller.q_d_*", ERROR, "--every", "10ms", "--node", run.node)
    assert watching.stdout is not None
    head = [watching.stdout.readline() for _ in range(2)]
    lines = [watching.stdout.readline() for _ in range(5)]
    watching.send_signal(signal.SIGINT)
    _, err = watching.communicate(timeout=DEADLINE_S)
    assert (watching.returncode, err) == (130, "interrupted\n"), f"{watching.returncode}: {err}"
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
    watching.communicate(timeout=DEADLINE_S)
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
    assert watching.wait(DEADLINE_S) == 130
    os.close(ours)
    assert seen.count(f"{ERROR} = ".encode()) >= 3, seen


def test_a_watch_that_nobody_reads_any_more_ends_well(run: Run) -> None:
    words = f"{program()} watch {ERROR} --every 10ms --node {run.node}"
    script = f"{words} | head -3 >/dev/null; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", script], cwd=ROOT, capture_output=True, text=True)
    said = [text for text in done.stderr.splitlines() if ": alarm: " not in text]  # it is late
    assert (done.stdout, said) == ("0\n", []), str(done)


def test_watch_refuses_an_interval_that_is_none(run: Run, capsys: Screen) -> None:
    code, out, err = said(capsys, run, "watch", ERROR, "--every", "5x")
    assert (code, out) == (2, ""), out
    assert err == "--every 5x: not a duration above 0; expected like 500us, 5ms, 10s, 2min\n", err


# Finding


def test_reading_and_tuning_need_no_numba() -> None:
    code = "import sys, pcpc.tools.cli, pcpc.tools.live.variables; print('numba' in sys.modules)"
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
def stand() -> Iterator[Callable[[str], sh.NodeMemory]]:
    """Return a maker of nodes that only hand out their memory."""
    yield lambda name: standing.stand(name, HEAD)
    standing.end_all()


@pytest.mark.parametrize("called", ["", "executive", "{rig}", "{rig}.executive", "{rig}.plant"])
def test_a_node_is_called_by_role_by_rig_or_in_full(
    called: str, stand: Callable[[str], sh.NodeMemory], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = f"lab{os.getpid()}"
    monkeypatch.setitem(HEAD, "rig", rig)
    names = [f"{rig}.vcan9.{role}" for role in ("executive", "plant")]
    for name in names:
        stand(name)
    wanted = names["plant" in called]
    if called == "executive":
        assert live.find(called, rig).name == wanted
    else:
        assert live.find(called.format(rig=rig) or wanted).name == wanted


def test_a_role_that_several_nodes_have_is_refused_with_their_names(
    run: Run, capsys: Screen, stand: Callable[[str], sh.NodeMemory], monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"twin.{os.getpid()}.executive"
    alone(run, monkeypatch, beside=name)
    stand(name)
    code = main(["get", "-l"])
    assert live.find_for([ERROR]).name == live.find(run.node).name
    err = capsys.readouterr().err
    assert code == 2, err
    assert name in err and run.node in err and "--node" in err, err


def test_a_node_that_has_ended_is_no_node(stand: Callable[[str], sh.NodeMemory]) -> None:
    name = f"dead.{os.getpid()}.plant"
    stand(name).control.done = 1
    for what in ("is leaving", "has left"):
        with pytest.raises(live.LiveError, match="no such node is running") as caught:
            live.find(name)
        assert caught.value.code == 4, f"{what}: exit code {caught.value.code}"
        standing.end(name)


def test_a_node_that_takes_no_tunings_keeps_none_of_them(
    stand: Callable[[str], sh.NodeMemory],
) -> None:
    name = f"stuck.{os.getpid()}.executive"
    block = stand(name)
    block.control.pid, block.control.passes = os.getpid(), 1
    with pytest.raises(live.LiveError, match="took no tunings for 2 s; nothing was set"):
        live.find(name).tune({"a.gain": 1.0})
    assert int(block.mail.count) == 0, "the request would still apply later"


def test_a_node_that_dies_meanwhile_is_told_to_have_ended(
    stand: Callable[[str], sh.NodeMemory],
) -> None:
    name = f"dying.{os.getpid()}.executive"
    stand(name).control.passes = 1
    found = live.find(name)
    standing.end(name)
    with pytest.raises(live.LiveError, match="ended"):
        found.tune({"a.gain": 1.0})
