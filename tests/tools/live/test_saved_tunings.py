"""`pcpc save|load|undo` on a real run, and a history that several hosts share."""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import standing
from live_run import KV, LAM, Run, Screen, said
from processes import until

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.events import Event
from pcpc.executive.nodes import live
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main
from pcpc.tools.live.tunings import states
from pcpc.tools.start import rigs

GIVEN = {KV: 110.0, LAM: 16.0}  # by the rig


def parameters(run: Run) -> dict[str, float]:
    node = live.find(run.node)
    return {name: value for name, value in node.read().items() if node.variables[name].range}


@pytest.fixture(autouse=True)
def as_the_rig_has_it(run: Run) -> Iterator[None]:
    yield
    node = live.find(run.node)
    node.tune(GIVEN)
    until(lambda: all(node[name] == value for name, value in GIVEN.items()), "back")


def tuned(run: Run, **changes: float) -> None:
    node = live.find(run.node)
    named = {f"controller.{name}": value for name, value in changes.items()}
    node.tune(named)
    until(lambda: all(node[name] == value for name, value in named.items()), "tuned")


# History


def test_undo_goes_back_tuning_by_tuning_whoever_made_it(run: Run, capsys: Screen) -> None:
    before = parameters(run)
    tuned(run, kv_Nms_rad=121.5, lam_per_s=15.0)
    first = parameters(run)
    tuned(run, kv_Nms_rad=130.0)
    for after in (first, before):
        code, out, err = said(capsys, run, "undo", "--json")
        assert code == 0, err
        until(lambda after=after: parameters(run) == after, f"undone: {out}")
    assert json.loads(out)["before"] == {KV: 121.5, LAM: 15.0}, out


def test_undo_of_several_is_one_tuning(run: Run, capsys: Screen) -> None:
    before = parameters(run)
    for gain in (111.0, 112.0, 113.0):
        tuned(run, kv_Nms_rad=gain)
    requests = int(live.find(run.node).block.mail.request)
    code, out, err = said(capsys, run, "undo", "3")
    assert code == 0 and out.startswith(f"{KV} = 110 N m s/rad (was 113) from cycle "), out + err
    assert int(live.find(run.node).block.mail.request) == requests + 1
    until(lambda: parameters(run) == before, "undone")


def test_more_than_there_was_is_not_undone(run: Run, capsys: Screen) -> None:
    code, out, err = said(capsys, run, "undo")
    assert (code, out, err) == (2, "", f"{run.node}: nothing was tuned\n")
    tuned(run, kv_Nms_rad=120.0)
    code, out, err = said(capsys, run, "undo", "2")
    assert (code, out, err) == (2, "", f"{run.node}: tunings that can be undone: 1\n")


def test_two_hosts_see_the_same_history(run: Run) -> None:
    tuned(run, kv_Nms_rad=140.0)
    mine, theirs = live.find(run.node), live.find(run.node)
    theirs.tune({LAM: 20.0})
    assert states(mine) == states(theirs)
    assert states(mine)[-2:] == [{KV: 140.0, LAM: 16.0}, {KV: 140.0, LAM: 20.0}], states(mine)


HEAD = {
    "variables": [
        ["a.gain", "", "parameter", "a", ""], ["supervisor.reset", "", "parameter", "loop", ""],
        ["a.b", "", "parameter", "a", ""],
    ],
    "ranges": {"a.gain": [0.0, 1e9], "supervisor.reset": [0.0, 1.0], "a.b": [0.0, 1e9]},
    "initial": {"a.gain": 5.0, "a.b": 0.0}, "blocks": ["a"], "rig": "stand",
    "state_columns": [], "timing_columns": [], "period_ns": 1_000_000,
}  # fmt: skip
Put = Callable[..., None]


@pytest.fixture
def stand() -> Iterator[tuple[live.Live, Put]]:
    """Return a node that only hands out its memory, and what puts an event into its ring."""
    name = f"history.{os.getpid()}.executive"
    block = standing.stand(name, HEAD)
    block["snapshot"][:] = 5.0, 0.0, 0.0

    def put(cycle: int, place: int, value: float, code: int = Event.TUNING) -> None:
        row = int(block.ends("event").head) % sh.EVENT_RING_ROWS
        bits = int(np.float64(value).view(np.int64))
        block["event"][row] = 1000 * cycle, cycle, code, place, bits
        block.ends("event").head += 1
        if code == Event.TUNING:
            block["snapshot"][place] = value

    yield live.find(name), put
    standing.end_all()


def test_a_return_to_an_earlier_state_shortens_the_history(stand: tuple[live.Live, Put]) -> None:
    node, put = stand
    assert states(node) == [{}]
    put(7, 0, 6.0)
    put(7, 2, 1.0)
    put(8, 1, 1.0)  # a reset
    put(9, 0, 7.0)
    put(9, 0, 1.0, Event.STATE)
    path = [{"a.gain": 5.0, "a.b": 0.0}, {"a.gain": 6.0, "a.b": 1.0}, {"a.gain": 7.0, "a.b": 1.0}]
    assert states(node) == path
    put(12, 0, 6.0)
    assert states(node) == path[:2]
    put(13, 0, 5.0)
    put(13, 2, 0.0)
    assert states(node) == path[:1]


def test_a_history_that_is_cut_tells_what_it_does_not_know(
    stand: tuple[live.Live, Put], capsys: Screen
) -> None:
    node, put = stand
    put(1, 2, 3.0)
    for cycle in range(sh.EVENT_RING_ROWS):
        put(cycle + 2, 0, float(cycle))
    path = states(node)
    assert len(path) == sh.EVENT_RING_ROWS and path[0] == {}, (len(path), path[0])
    assert main(["undo", str(sh.EVENT_RING_ROWS - 1), "--node", node.name]) == 2
    assert "a.gain: its previous value is no longer known" in capsys.readouterr().err
    put(9999, 0, 8.0, Event.LATE)
    standing._standing[node.name].block["snapshot"][0] = 77.0  # a tuning that was dropped
    assert main(["undo", "--node", node.name]) == 2
    assert "no longer hold all tunings" in capsys.readouterr().err


# Files


def test_what_was_tuned_is_saved_and_loaded_with_every_bit(
    run: Run, capsys: Screen, tmp_path: Path
) -> None:
    file = tmp_path / "tuned.yaml"
    tuned(run, kv_Nms_rad=0.1 + 0.2, lam_per_s=15.0)
    after = parameters(run)
    code, out, err = said(capsys, run, "save", str(tmp_path), "--force")
    assert (code, out, err) == (2, "", f"{tmp_path}: is no file; choose another name\n")
    code, out, err = said(capsys, run, "save", str(file))
    assert code == 0 and f"2 parameters of {run.node}, 2 changed" in out, out + err
    text = file.read_text()
    assert "N m s/rad; rig 110\ncontroller.kv_Nms_rad: 0.30000000000000004\n" in text, text
    tuned(run, kv_Nms_rad=110.0, lam_per_s=16.0)
    code, out, err = said(capsys, run, "load", str(file), "--json")
    assert code == 0 and json.loads(out)["values"] == {KV: 0.1 + 0.2, LAM: 15.0}, out + err
    until(lambda: parameters(run) == after, "loaded")
    code, out, _ = said(capsys, run, "load", str(file))
    assert (code, out) == (0, f"{run.node}: already has these values\n"), out


def test_a_file_is_not_overwritten_unless_told(run: Run, capsys: Screen, tmp_path: Path) -> None:
    file = tmp_path / "all.yaml"
    assert said(capsys, run, "save", str(file))[0] == 0
    code, out, err = said(capsys, run, "save", str(file), "--all")
    assert (code, out) == (2, "") and "overwrite it with --force" in err, err
    assert said(capsys, run, "save", str(file), "--all", "--force")[0] == 0
    assert "\ncontroller.km_Nms_rad: 60.0\n" in file.read_text(), file.read_text()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{KV}: 99.0\ncontroller.kv: 1\n", "2:1: controller.kv: no such variable; did you"),
        (f"{LAM}: 9\n{KV}: 1000.5\n", f"2:1: {KV}: 1000.5 is outside 0..1000 N m s/rad"),
        (f"{LAM}: 9\n{KV}: high\n", f"2:1: {KV}: expected a number, got 'high'"),
        (f"{LAM}: 9\n{LAM}: 8\n", "2:1: controller.lam_per_s: given twice, first at"),
        ("controller.e_rad: 0\n", "1:1: controller.e_rad: output, written by controller every"),
        ("- 1\n", "1:1: expected a mapping"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_with_its_line_and_nothing_is_set(
    run: Run, capsys: Screen, tmp_path: Path, text: str, message: str
) -> None:
    file, before = tmp_path / "wrong.yaml", parameters(run)
    file.write_text(text)
    requests = int(live.find(run.node).block.mail.request)
    code, out, err = said(capsys, run, "load", str(file))
    assert (code, out) == (2, ""), out
    assert f"{file}:{message}" in err and err.count("\n") == 1, err
    assert int(live.find(run.node).block.mail.request) == requests
    assert parameters(run) == before


# A rig takes them over


def test_a_rig_takes_over_what_was_saved(run: Run, capsys: Screen, tmp_path: Path) -> None:
    file = tmp_path / "tuned.yaml"
    tuned(run, kv_Nms_rad=123.0)
    assert said(capsys, run, "save", str(file))[0] == 0
    rig = load_rig(rigs.find("hull"), None, [f"@{file}", "controller.lam_per_s=14.0"])
    (controller,) = (one for one in rig.nodes()["executive"].blocks if one.name == "controller")
    assert (controller.settings["kv_Nms_rad"], controller.settings["lam_per_s"]) == (123.0, 14.0)
    assert file.read_text() in rig.document.sources.values(), "the log would not have it"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{KV}: 1e4\n", "1:1: controllers.pd.parameters.kv_Nms_rad: 10000 is outside 0..1000"),
        ("controller.kv: 1\n", "1:1: controllers.pd.parameters.kv: unknown parameter; did"),
        ("barrel.gap: 1\n", "1:1: plant.blocks.barrel.parameters.gap: unknown parameter; did you"),
        ("duration_s: 1\n", "1:1: duration_s is not a setting of a block; give it with --set"),
        ("nothing: 1.0\n", "1:1: no such setting"),
    ],
)  # fmt: skip
def test_a_rig_refuses_what_is_not_its_own(
    tmp_path: Path, text: str, message: str, capsys: Screen
) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text(text)
    assert main(["check", "hull", "--set", f"@{file}"]) == 2
    err = capsys.readouterr().err
    assert f"{file}:{message}" in err and err.count("\n") == 1, err
