"""`pcpc compare OLD NEW` of folders: every run on both sides is accounted for."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from json_schemas import holds
from logcommand import Done, run_here

import pcpc
from pcpc.executive.log import reader as logs
from pcpc.tools.after.compare import pairing
from pcpc.tools.after.verdict import summary_file
from pcpc.tools.start.folder import LOG

HELD = {"require": [{"name": "held", "always": "abs(controller.e_rad) < 9"}]}
SHORT = {"duration_s": 0.2, "evaluation.window_s": [0.0, 0.2], **HELD}
RUNS = {
    "slew": ("slew10", "pd", {}),
    "slew again": ("slew10", "pd", {}),
    "seed 2": ("slew10", "pd", {"seed": 2}),
    "stop": ("slew10", "pd", {"faults.gone": {"kind": "loss", "frame": "FB_A", "from": "50ms"}}),
    "sin": ("sin0.5", "pid", {}),
    "sin stop": ("sin0.5", "pid", {"faults.x": {"kind": "loss", "frame": "FB_A", "from": "50ms"}}),
}
GATES = "any", "metrics", "verdict"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of short runs by name."""
    top = tmp_path_factory.mktemp("made")
    for name, (rig, controller, values) in RUNS.items():
        pcpc.simulate(rig, controller, set=SHORT | values, folder=top / name, quiet=True)
    return top


@pytest.fixture
def lay(made: Path, tmp_path: Path) -> Callable[..., tuple[Path, Path]]:
    """Return what lays runs into two folders, `old` and `new`: place=run, and ..."""

    def laid(old: dict[str, str], new: dict[str, str]) -> tuple[Path, Path]:
        for side, runs in (("old", old), ("new", new)):
            (tmp_path / side).mkdir()
            for place, name in runs.items():
                shutil.copytree(made / name, tmp_path / side / place)
        return tmp_path / "old", tmp_path / "new"

    return laid


def compared(*words: str | Path) -> Done:
    done = run_here("compare", *words, "--quiet")
    assert [line for line in done.out.splitlines() if len(line) > 80] == [] or "-" in words, done
    return done


@pytest.mark.parametrize(
    ("old", "new", "states"),
    [
        ({"a": "slew"}, {"a": "slew again"}, ["equal"]),
        ({"a": "slew"}, {"a": "slew again", "b": "stop"}, ["alone", "equal"]),
        ({"a": "slew"}, {"b": "stop", "c": "slew"}, ["alone", "equal"]),
        ({"a": "slew", "b": "stop"}, {"c": "slew"}, ["alone", "equal"]),
        ({"a": "slew", "b": "seed 2"}, {"y": "seed 2", "z": "slew"}, ["equal", "equal"]),
        ({"a": "slew", "b": "seed 2"}, {"a": "seed 2", "b": "slew"}, ["changed", "changed"]),
        ({"a": "slew", "b": "slew again"}, {"y": "stop", "z": "slew"}, ["changed", "equal"]),
        ({"a": "slew"}, {"a": "slew", "b": "slew again", "c": "seed 2"},
         ["alone", "alone", "equal"]),
        ({"a": "slew", "b": "sin"}, {"a": "slew"}, ["alone", "equal"]),
    ],
)  # fmt: skip
def test_every_run_has_a_partner_or_is_named(
    old: dict[str, str],
    new: dict[str, str],
    states: list[str],
    lay: Callable[..., tuple[Path, ...]],
) -> None:
    words = lay(old, new)
    done = compared(*words, "--json", "-")
    told = holds("compare", done.out)
    assert sorted(pair["state"] for pair in told["pairs"]) == states, done
    logs = [path for p in told["pairs"] for path in (p["old"], p["new"]) if path]
    logs += [p["said"][0].partition(": ")[2] for p in told["pairs"] if p["state"] == "alone"]
    assert sorted(logs) == sorted(str(path) for one in words for path in one.rglob("*.mcap"))
    assert done.code == (states != ["equal"] * len(states))
    alone = "alone" in states
    for gate in GATES:
        code = compared(*words, "--fail-on", gate).code
        assert code == 1 if alone else gate != "any" or code == done.code
    assert compared(*words, "--fail-on", "never").code == 0


@pytest.mark.parametrize(
    ("new", "allow", "code"),
    [
        ("sin", "sin0.5", 0),
        ("sin", "sin0.5/pid", 0),
        ("sin", "sin*", 0),
        ("sin", "sin0.5/pd", 2),
        ("sin", "cos0.5", 2),
        ("sin", "slew10", 1),
        ("sin stop", "sin0.5", 1),
    ],
)
def test_what_is_on_one_side_only_fails_but_for_what_is_allowed_and_ok(
    new: str, allow: str, code: int, lay: Callable[..., tuple[Path, ...]]
) -> None:
    words = lay({"a": "slew"}, {"a": "slew", "b": new})
    for gate in GATES:
        done = compared(*words, "--fail-on", gate, "--allow", allow)
        assert done.code == code, done
        assert compared(*words, "--fail-on", gate).code == 1
    if code == 2:
        assert done.err.startswith(f"--allow {allow}: no such rig"), done
    else:
        verdict = "safety stop" if "stop" in new else "ok"
        assert f"verdict {verdict}" in " ".join(done.out.split()), done
    if code == 0:
        assert compared(*reversed(words), "--allow", allow).code == 0, "only in old"


def test_nothing_but_what_is_allowed_is_nothing_compared(
    lay: Callable[..., tuple[Path, ...]],
) -> None:
    words = lay({"a": "slew"}, {"b": "sin"})
    for gate in GATES:
        assert compared(*words, "--allow", "*", "--fail-on", gate).code == 1


def _emptied(run: Path) -> None:
    (run / LOG).write_bytes(b"")


def _lost(run: Path) -> None:
    (run / LOG).unlink()


def _cut(run: Path) -> None:
    (run / LOG).write_bytes((run / LOG).read_bytes()[:-3000])


def _dangling(run: Path) -> None:
    (run / LOG).unlink()
    (run / LOG).symlink_to(run / "nowhere")


def _folder(run: Path) -> None:
    (run / LOG).unlink()
    (run / LOG).mkdir()


def _foreign(run: Path) -> None:
    (run / "other.mcap").write_bytes(b"\x89MCAP0\r\n" * 2)


def _edited(run: Path) -> None:
    file = run / summary_file.NAME
    file.write_text(file.read_text().replace('"late_cycles": 0', '"late_cycles": 1'))


def _of_another(run: Path) -> None:
    shutil.copy(run.parents[1] / "old" / "b" / summary_file.NAME, run / summary_file.NAME)


def _newer(run: Path) -> None:
    shutil.copy(run.parents[1] / "old" / "b" / LOG, run / LOG)


def _unsummed(run: Path) -> None:
    (run / summary_file.NAME).unlink()
    (run / "rest").mkdir()
    shutil.move(run / LOG, run / "rest" / "part.mcap.active")


@pytest.mark.parametrize(
    "spoil",
    [_emptied, _lost, _cut, _dangling, _folder, _foreign, _edited, _of_another, _newer, _unsummed],
)
def test_a_run_that_is_none_any_more_is_no_pass(
    spoil: Callable[[Path], None], lay: Callable[..., tuple[Path, ...]]
) -> None:
    words = lay({"a": "slew", "b": "sin"}, {"a": "slew", "b": "sin"})
    assert compared(*words).code == 0
    spoil(words[1] / "a")
    for gate in GATES:
        done = compared(*words, "--fail-on", gate)
        assert done.code == (3 if spoil is _cut else 1), done
    assert not done.err, done


def test_each_changed_pair_has_a_figure_of_its_own(lay: Callable[..., tuple[Path, ...]]) -> None:
    words = lay({"a": "slew", "b": "seed 2"}, {"a": "seed 2", "b": "slew"})
    assert compared(*words, "-o", words[0].parent / "drawn").code == 1
    names = {path.name for path in (words[0].parent / "drawn").glob("*.png")}
    assert names == {"slew10-pd.png", "slew10-pd-2.png"}


def test_a_verdict_that_one_side_lacks_is_not_the_same(made: Path, tmp_path: Path) -> None:
    logs = [shutil.copy(made / "slew" / LOG, tmp_path / f"{n}.mcap") for n in (1, 2)]
    for words, codes in (((made / "slew", logs[0]), (0, 0, 1)), (logs, (0, 0, 0))):
        for gate, code in zip(GATES, codes, strict=True):
            done = compared(*words, "--fail-on", gate)
            assert done.code == code and "verdict not compared" in " ".join(done.out.split()), done


def test_runs_behind_a_link_count(lay: Callable[..., tuple[Path, ...]]) -> None:
    old, new = lay({"a": "slew", "b": "sin"}, {"a": "slew", "b": "sin"})
    shutil.move(new / "b", new.parent / "elsewhere")
    os.symlink(new.parent / "elsewhere", new / "b")
    os.symlink(new, new / "a" / "loop")
    assert compared(old, new).code == 0
    assert compared(old, new).out.count("equal to the bit") == 2


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("a:1 b:2", "d:1 c:2", "a-d b-c"), ("b:1 a:2", "c:2 d:1", "b-d a-c"),
        ("a:1 b:2:7", "c:1:7 d:2", "a-d b-c"), ("a:1:7", "a:1:8", "a- -a"),
        ("a:1:7", "a:1", "a- -a"), ("a:1::5 b:2::6", "c:1::6 d:2::5", "a-d b-c"),
    ],
)  # fmt: skip
def test_partners_are_of_one_kind_in_the_order_in_which_they_began(
    old: str, new: str, expected: str
) -> None:
    def recorded(text: str) -> pairing.Recorded:
        place, begin_ns, cycle, seed = (*text.split(":"), "", "")[:4]
        about = {"rig": "r", "clock_wall_ns": begin_ns, "branch_cycle": cycle}
        node: dict[str, logs.NodeLog] = dict.fromkeys(("executive",))  # type: ignore[arg-type]
        head = logs.Log(
            Path(place), node, {}, {"executive": about}, [], rig={"seed": seed or place}
        )
        return pairing.Recorded(Path(place), place, head)

    sides = [[recorded(text) for text in side.split()] for side in (old, new)]
    found = [f"{a.place if a else ''}-{b.place if b else ''}" for a, b in pairing.partners(*sides)]
    assert sorted(found) == sorted(expected.split())


def test_two_rigs_by_name_pass_no_gate(made: Path) -> None:
    for gate in GATES:
        done = compared(made / "slew", made / "sin", "--fail-on", gate)
        assert done.code == 1 and "two rigs, slew10 and sin0.5" in " ".join(done.out.split()), done


def test_a_branch_is_no_partner_of_a_run(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "slew", tmp_path / "old" / "a")
    branch = tmp_path / "new" / "a"
    words = ("branch", made / "slew", "--cycle", "50", "-o", branch, "--quiet")
    assert run_here(*words).code == 0
    for gate in GATES:
        done = compared(tmp_path / "old", tmp_path / "new", "--fail-on", gate)
        assert done.code == 1 and "branch at cycle 50" in " ".join(done.out.split()), done
        done = compared(made / "slew", branch, "--fail-on", gate)
        assert done.code == 0 and "new is a branch at cycle 50" in " ".join(done.out.split()), done
        assert compared(made / "seed 2", branch, "--fail-on", gate).code == 1
    shutil.copytree(branch, tmp_path / "also" / "b")
    assert compared(tmp_path / "new", tmp_path / "also").code == 0
