"""A plant, a law, a study in a folder of their own, outside the project: all four ways and back."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from processes import PATIENT, Running, own_bus, pcpc
from spring import EVALUATION, LAW, MODEL, RIG, spring_dbc

from pcpc.executive.log import reader as logs

STUDY = '''\
from pathlib import Path

from pcpc.plants.study import Case, markdown

CHAPTER = 0
TITLE = "Stiffness of a spring"
RIG = str(Path(__file__).with_name("spring.yaml"))


def cases():
    """Three springs."""
    return [Case("k", RIG, "integral", str(k), (f"spring.spring_N_m={k}.0",)) for k in (10, 20, 40)]


def report(results):
    """A table."""
    rows = [(r.case.label, f"{r.metric('end_m'):.2f}") for r in results]
    return markdown(("k [N/m]", "end [m]"), rows)


def draw(results, folder):
    """Nothing to see."""
'''


@pytest.fixture(scope="module")
def spring(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the rig file of a folder that the project does not know."""
    folder = tmp_path_factory.mktemp("elsewhere") / "my spring"
    folder.mkdir()
    texts = {
        "model.py": MODEL, "law.py": LAW, "spring.yaml": RIG, "spring.dbc": spring_dbc(),
        "evaluation.py": EVALUATION, "study.py": STUDY,
    }  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder / "spring.yaml"


def states(folder: Path) -> list[list[bytes]]:
    return [logs.payloads(folder / "log.mcap", name) for name in ("/state", "/plant/state")]


def test_it_runs_all_four_ways_and_the_unclocked_three_have_the_same_bytes(
    spring: Path, tmp_path: Path
) -> None:
    quiet = ("--quiet", "--no-figure", "--json")
    rig = (str(spring), *quiet)
    virtual = pcpc("simulate", *rig, "-o", str(tmp_path / "virtual"))
    assert virtual.code == 0, str(virtual)
    assert 0.45 < virtual.summary["metrics"]["end_m"] < 0.55, str(virtual)
    bus = ("--bus", own_bus(), "--pacing", "lockstep")
    one = pcpc("run", *rig, *bus, "-o", str(tmp_path / "bus"))
    assert one.code == 0, str(one)
    with Running("run", "--only=plant", str(spring), *bus) as plant:
        two = pcpc("run", "--only=executive", *rig, *bus, "-o", str(tmp_path / "two"))
        assert (two.code, plant.done().code) == (0, 0), f"{two}\n{plant}"
    wanted = states(tmp_path / "virtual")
    assert [len(topic) for topic in wanted] == [1500, 1501]
    assert states(tmp_path / "bus") == wanted, "lockstep on the bus and virtual time differ"
    assert states(tmp_path / "two")[0] == wanted[0], "two terminals and virtual time differ"
    clocked = ("--bus", own_bus(), "--set", "duration_s=0.5", "-o", str(tmp_path / "real"))
    real = pcpc("run", *rig, *clocked, *PATIENT)
    assert real.ran and real.summary["pacing"] == "real", str(real)


def test_its_log_is_recomputed_after_its_folder_is_gone(spring: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(spring.parent, folder)
    done = pcpc("simulate", str(folder / "spring.yaml"), "-o", str(tmp_path / "run"), "--quiet")
    assert done.code == 0, str(done)
    shutil.rmtree(folder)
    again = pcpc("replay", str(tmp_path / "run" / "log.mcap"), "--json", "--quiet", "--trust")
    assert again.code == 0, str(again)


def test_its_study_runs_from_its_path(spring: Path, tmp_path: Path) -> None:
    words = ("experiment", str(spring.with_name("study.py")), "--quiet", "-o", str(tmp_path / "s"))
    done = pcpc(*words)
    assert done.code == 0, str(done)
    text = (tmp_path / "s" / "results.md").read_text()
    assert "# Stiffness of a spring" in text and "| 20 | 0.51 |" in text, text


def test_an_experiment_that_is_none_is_refused_with_the_names(tmp_path: Path) -> None:
    for name in ("chapter12", str(tmp_path / "study.py")):
        done = pcpc("experiment", name)
        assert done.code == 2 and "no such experiment" in done.err, str(done)
        assert len(done.err.splitlines()) == 1 and "chapter" in done.err, str(done)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("1 +", "study.py:1: SyntaxError"), ("CHAPTER = 1", "no TITLE, cases, report, draw"),
        ("\nimport nosuch", "study.py:2: ModuleNotFoundError"),
        ("exit(3)", "study.py:1: ends the process"),
        ("CHAPTER, TITLE = 1, ''\ncases = list\nreport = draw = print", "cases() has no run"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_study_is_refused_in_a_line(
    text: str, why: str, refused: Callable[..., None], tmp_path: Path
) -> None:
    (tmp_path / "study.py").write_text(text)
    refused("experiment study.py -o out", why)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [("[Case(", "[Csae(", "12: NameError"), ("in results]", "in rslts]", "17: NameError")],
)
def test_what_a_study_raises_is_told_in_a_line(
    old: str, new: str, place: str, spring: Path, tmp_path: Path
) -> None:
    for name in ("model.py", "law.py", "spring.yaml", "spring.dbc", "evaluation.py"):
        shutil.copy(spring.with_name(name), tmp_path)
    (tmp_path / "study.py").write_text(STUDY.replace(old, new))
    words = ("experiment", str(tmp_path / "study.py"), "-o", str(tmp_path / "out"), "--quiet")
    done = pcpc(*words)
    assert done.code == 2 and f"study.py:{place}" in done.err, str(done)
    assert "Traceback" not in done.err and len(done.err.splitlines()) == 1, str(done)


def test_json_of_check_names_the_files_outside(spring: Path) -> None:
    done = pcpc("check", str(spring), "--json")
    assert done.code == 0 and json.loads(done.out)["rig"] == "spring", str(done)
