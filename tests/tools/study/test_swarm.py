"""`pcpc swarm`: drawn worlds keep their promises; each is seen to fail; a find is a folder."""

import itertools
import json
import pkgutil
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from json_schemas import strictly_holds
from logcommand import run_here
from places import ROOT

from pcpc.drivers.can.frames import Frame
from pcpc.tools.study.swarm import cli, draws, features, shrink
from pcpc.tools.study.swarm.features import ODD
from pcpc.tools.study.swarm.files import World, write
from pcpc.tools.study.swarm.promises import PROMISES
from tests.swarm.planted import PLANTED as PLANTED_BY_HAND

Spoil = Callable[[Any], Any]  # what is true: what stands in its place
CASES = [  # a loop of seventeen nodes is compiled for one of them
    pytest.param(case, id=case.name, marks=[] if "sixteen" in case.name else pytest.mark.quick)
    for case in sorted(path.parent for path in ROOT.glob("tests/swarm/*/rig.yaml"))
]
PLAIN, SEEDS = 100, 4  # a seed of one plant; how many are tried here
FIRST_TURN = 524289 / 2**20  # of `at.sample`: a log in parts, cut, a branch without a change


def world(**changes: Any) -> World:
    """Return a world of one plant whose rig is valid, with a requirement that is violated."""
    found = draws.world_of(PLAIN)
    keys = found["keys"]
    for name in ("faults", "losses", "bus", "overrun", "standby", "handover"):
        keys.pop(name, None)
    keys["executive"] = {"limits": {"CMD_1.command": {"low": -2.5, "high": 2.5}}}
    keys["supervisor"] = {}
    keys["schedule"] = [{"at_s": 0.02, "set": {"controller.first": 1.5}}]
    keys["require"] = [{"always": "abs(rx.FB_1.position) < 0.0001"}]
    found["plants"][0]["reference"] = draws._reference(features.Drawing(1), "sine", 12.0)
    found["plants"][0]["shape"], found["wrong"] = 2, []
    found |= {key: one for key, one in changes.items() if key != "sample"}
    keys["record"] = {"keyframe": "0.1s"}
    found["at"] |= {"sample": changes.get("sample", 0.5), "keyframe": 0.9}
    return found


def _a_bit_off(since: int) -> Spoil:
    """Install a gain that is off by a unit in the last place, from one of the nodes on."""

    def spoil(true: Any) -> Any:
        count = itertools.count()

        def installed(made: Any, loop: Any) -> None:
            true(made, loop)
            place = made.table.index.get("controller.first")
            if next(count) >= since and place is not None:
                loop.v[place] = np.nextafter(loop.v[place], np.inf)

        return installed

    return spoil


def _keyframe_off(true: Any) -> Any:
    def restored(loop: Any, held: Any, state: bytes) -> None:
        true(loop, held, state)
        values = loop.v[: held[0][3] // 8]
        places = values != np.trunc(values)
        values[places] = np.nextafter(values[places], np.inf)

    return restored


def _a_lane_off(true: Any) -> Any:
    def begun(group: Any) -> None:
        true(group)
        values = group.seats["plant"].values[:, -1]
        places = values != np.trunc(values)
        values[places] = np.nextafter(values[places], np.inf)

    return begun


def _wider(true: Any) -> Any:
    def installed(part: Any, made: Any, loop: Any) -> None:
        true(part, made, loop)
        loop.limits.table[0].high *= 1.5
        loop.limits.table[0].low *= 1.5

    return installed


INSTALL = "pcpc.executive.nodes.virtual.install_in_memory"
PLANTED: list[tuple[str, World, str, Spoil]] = [
    ("bits", {}, INSTALL, _a_bit_off(2)),
    ("replayed", {}, "pcpc.executive.nodes.slices.tuning_of",
     lambda true: lambda entry: (true(entry)[0] + 1, *true(entry)[1:])),
    ("keyframe", {}, "pcpc.executive.nodes.planned_keyframes.put_back", _keyframe_off),
    ("branched", {}, "pcpc.tools.after.branch.branching._tune_later",
     lambda true: lambda node, later: None),
    ("in_lanes", {}, "pcpc.executive.batch.group.LaneGroup.begin", _a_lane_off),
    ("in_parts", {"sample": FIRST_TURN}, "pcpc.executive.log.long_logs._column_slice",
     lambda true: lambda columns, begin, end: true(columns, max(begin - 1, 0), end - 1)),
    ("verdict", {}, "pcpc.tools.after.verdict.summary.verdict_of", lambda true: lambda *_: "ok"),
    ("frames", {}, "pcpc.drivers.can.dbc._signal_row",
     lambda true: lambda one, place, dlc: (*true(one, place, dlc)[:-4], one.factor * 1.25,
                                           *true(one, place, dlc)[-3:])),
    ("limits", {}, "pcpc.executive.nodes.planned_commands.Commands.install", _wider),
    ("interpreted", {"sample": 0.0}, INSTALL, _a_bit_off(0)),
    ("lockstep", {"sample": 1.0}, INSTALL, _a_bit_off(0)),
    ("refusal", {"wrong": [[["title"], "nothing is wrong with it"]]}, "math.tau", float),
]  # fmt: skip


@cache
def _found_in_truth(text: str) -> dict[str, list[str]]:
    """Return what all promises find in a world, whose text this is, before anything is spoilt."""
    return cli.checked(json.loads(text)).found


@pytest.mark.parametrize(
    ("name", "changes", "place", "spoil"), PLANTED, ids=lambda one: str(one)[:12]
)
def test_each_promise_is_seen_to_fail(
    name: str, changes: World, place: str, spoil: Spoil, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert _found_in_truth(json.dumps(world(**changes | {"wrong": []}))) == {}
    monkeypatch.setattr(place, spoil(pkgutil.resolve_name(place)))
    assert name in cli.checked(world(**changes), [name]).found


def test_a_wrong_value_of_a_damaged_log_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that makes one up for what is missing."""
    true = pkgutil.resolve_name("pcpc.executive.log.reader.read")

    def read(path: Path) -> Any:
        found = true(path)
        if path.name == "damaged.mcap":
            found.missing.clear()
        return found

    def found() -> list[bool]:
        worlds = [world(sample=FIRST_TURN) for _ in range(5)]
        for i, one in enumerate(worlds):
            one["at"]["cut"] = 0.5 + 0.1 * i
        return [bool(cli.checked(one, ["damage"]).found) for one in worlds]

    assert not any(found())
    monkeypatch.setattr("pcpc.executive.log.reader.read", read)
    assert any(found())


@pytest.mark.parametrize(
    ("act", "place", "spoil"),
    [
        ({"send": 2}, "pcpc.tools.after.verdict.summary.verdict_of", lambda true: lambda *_: "ok"),
        ({"set": {"controller.first": 2.0}}, "pcpc.tools.study.swarm.oracle.TUNABLE", tuple),
        ({"set": {"controller.first": 1e9}}, "pcpc.executive.nodes.planned_keyframes._REFUSALS",
         lambda true: set()),
    ],
)  # fmt: skip
@pytest.mark.quick
def test_what_others_do_is_taken_as_it_must_be(
    act: World, place: str, spoil: Spoil, monkeypatch: pytest.MonkeyPatch
) -> None:
    acts = [{"cycle": 5, **act}]
    assert cli.checked(world(acts=acts)).found == {}
    monkeypatch.setattr(place, spoil(()))
    assert cli.checked(world(acts=acts)).found


def test_slow_frames_that_come_late_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    one = world()
    slow = draws._frame(features.Drawing(1), ["slow"], False, 0)
    one["plants"][0]["slow"] = slow | {"ms": 20}
    assert cli.checked(one).found == {}
    true = Frame.every_n
    monkeypatch.setattr(Frame, "every_n", lambda *of: true(*of) + (of[0].name == "SLOW_1"))
    assert "SLOW_1 came in cycles" in str(cli.checked(one, ["frames"]).found)


def test_every_promise_has_a_planted_fault() -> None:
    assert {*PROMISES, "refusal"} == {"damage", *(name for name, *_ in PLANTED)}


@pytest.mark.quick
def test_seeds_keep_every_promise_and_are_summed_up(tmp_path: Path) -> None:
    done = run_here("swarm", "--seeds", SEEDS, "-j", 1, "--json", "-q", "-o", tmp_path / "found")
    told = strictly_holds("swarm", done.out)
    assert (done.code, told["broken"], told["seeds"]) == (0, [], SEEDS), done
    assert told["cycles"] > 10_000 and len(told["pairs"]) > 100
    met, never = {*told["pairs"]}, {*told["never"]}
    possible = {" + ".join(two) for two in features.possible_pairs()}
    assert (met | never, met & never) == (possible, set())


def test_the_same_seed_is_the_same_world_and_others_are_others() -> None:
    texts = [json.dumps(draws.world_of(seed)) for seed in (*range(20), *range(20))]
    assert texts[:20] == texts[20:] and len({*texts}) == 20


@pytest.mark.deep
def test_all_pairs_of_features_that_a_rig_may_have_are_met_within_some_thousand_seeds() -> None:
    drawn = [sorted({*draws.world_of(seed)["features"]}) for seed in range(1, 5001)]
    met = {two for one in drawn for two in itertools.combinations(one, 2)}
    assert met == features.possible_pairs(), met ^ features.possible_pairs()


@pytest.mark.parametrize("name", draws.WRONG)
def test_a_wrong_rig_is_refused_in_a_line(name: str) -> None:
    path, value = draws.WRONG[name]
    row = cli.checked(world(wrong=[[list(path), value]]))
    assert row.found == {} and row.refused and "\n" not in row.refused


def test_any_entry_of_faults_is_run_or_refused_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(draws, "MOST_CYCLES", 300)
    monkeypatch.setattr(draws, "TIMES", (1,))
    worlds = [one for seed in range(1, 101) if ODD in (one := draws.world_of(seed))["features"]]
    rows = [cli.checked(one, ["limits"]) for one in worlds]
    assert [row for row in rows if row.found] == []
    assert sum(bool(row.refused) for row in rows) > 2 and sum(row.cycles > 0 for row in rows) > 2


def test_what_raises_an_error_of_python_is_a_find(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcpc.tools.study.swarm.case.load_rig", lambda path: path.none)
    assert "no attribute" in cli.checked(world()).found["refusal"][0]


def test_what_is_found_is_made_small_and_its_folder_repeats_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place, spoil = "pcpc.tools.after.verdict.summary.verdict_of", lambda *_: "ok"
    monkeypatch.setattr(place, spoil)
    monkeypatch.setattr(cli, "world_of", lambda seed, base: world())
    monkeypatch.setattr("pcpc.tools.study.swarm.counts.judged", lambda case: ())
    row = cli.row_of(PLAIN, None, str(tmp_path))
    assert [*row.found] == ["verdict"]
    done = run_here("swarm", "--replay", row.folder)
    assert done.code == 1 and "verdict ok, not expectation not met" in done.out, done
    text = Path(row.folder, "rig.yaml").read_text()
    assert "schedule" not in text and "require" in text and "limits" not in text, text
    monkeypatch.undo()
    assert run_here("swarm", "--replay", row.folder).code == 0


def test_nothing_is_left_out_that_is_needed() -> None:
    def needs(one: World) -> bool:
        return "require" in one["keys"] and one["cycles"] >= 100

    small = shrink.smallest(world(), needs)
    assert needs(small) and small["cycles"] < 200 and len(small["plants"]) == 1, small


def test_faults_planted_by_hand_have_their_place() -> None:
    for name, (file, was, becomes) in PLANTED_BY_HAND.items():
        text = (ROOT / file).read_text()
        assert text.count(was) == 1 and was != becomes, name
        compile(text.replace(was, becomes), file, "exec")


@pytest.mark.parametrize(("name", "seed"), [  # a little before one that finds it
    ("replay: no ramp", 51), ("branch: a tuning", 21), ("judge: repeated frames", 1),
])  # fmt: skip
@pytest.mark.deep
def test_faults_planted_by_hand_are_found(name: str, seed: int) -> None:
    command = [sys.executable, "-m", "tests.swarm.planted", name, "--seed", str(seed)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.stdout and json.loads(done.stdout)["found"], done


@pytest.mark.deep
def test_a_cluster_does_the_seeds_too(tmp_path: Path) -> None:
    words = ("swarm", "--dask", "local:1", "--seeds", 2, "-q", "-o", tmp_path / "found")
    done = run_here(*words)
    assert (done.code, "2 seeds from 1 on" in done.out) == (0, True), done


def test_worlds_are_drawn_around_rigs_of_mine_in_turn(tmp_path: Path) -> None:
    """One of them a drive with its master: faults of its PDOs, tunings of the master's law."""
    rigs = f"probe,{ROOT / 'tests/drivers/canopen/mastered.yaml'}"
    words = ("swarm", "--rig", rigs, "--seeds", 4, "-j", 1, "-q", "-o", tmp_path / "found")
    done = run_here(*words)
    assert (done.code, "4 seeds from 1 on" in done.out) == (0, True), done


@pytest.mark.parametrize("case", CASES)
def test_what_was_found_once_stays_mended(case: Path) -> None:
    done = run_here("swarm", "--replay", case)
    assert done.code == 0, done.out


def test_a_folder_without_a_world_is_refused(tmp_path: Path) -> None:
    assert run_here("swarm", "--replay", tmp_path).code == 2
    write(world(), tmp_path)
    assert run_here("swarm", "--replay", tmp_path).code == 0


def test_no_promise_that_was_checked_is_no_pass(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = world()
    one["keys"]["faults"] = {"x": {"kind": "los", "frame": "FB_1"}}
    one["features"].append(ODD)
    write(one, tmp_path / "folder")
    again = run_here("swarm", "--replay", tmp_path / "folder")
    assert again.code == 1 and again.out.startswith("refused: "), again
    monkeypatch.setattr(cli, "_rows", lambda *_: iter([cli.checked(one)]))
    every = run_here("swarm", "--seeds", 1, "-q")
    assert every.code == 1 and "0 promises checked, 0 seeds broke one" in every.out, every
    monkeypatch.undo()
    assert run_here("swarm", "--for", "1us", "-q").code == 1, "no seed was begun"
