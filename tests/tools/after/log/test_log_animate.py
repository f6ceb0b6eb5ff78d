"""`pcpc log plot --moving`: a film; whose Python draws it; `pcpc check` of a drawing."""

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from logcommand import barrel_log, run, run_here
from PIL import Image, ImageSequence

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make import new

MARK = "\nopen({mark!r}, 'a').close()\n"


def film(log: Path, folder: Path, *words: str) -> list[np.ndarray]:
    """Return the pictures of a film of the barrel's log."""
    done = run("plot", "--moving", log, "-o", folder / "a.gif", "--quiet", *words)
    assert done.code == 0, done
    with Image.open(folder / "a.gif") as pictures:
        return [np.asarray(one.convert("L")) for one in ImageSequence.Iterator(pictures)]


def test_a_film_has_its_pictures_and_they_move(tmp_path: Path) -> None:
    found = film(barrel_log(), tmp_path, "--end", "0.2s")
    assert len(found) == 5, len(found)
    assert all(0.001 < (one < 250).mean() < 0.5 for one in found), "something is drawn"
    assert all((a != b).any() for a, b in pairwise(found))
    slow = film(barrel_log(), tmp_path, "--end", "0.1s", "--speed", "0.2")
    assert len(slow) == 11, len(slow)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("-o", "a.png"), "a.png: expected a name that ends in .gif"),
        (("-o", "a.gif", "--speed", "0"), "--speed 0: expected more than 0"),
        (("-o", "a.gif", "--start", "9s"), "no cycle between --start and --end"),
        (("-o", "a.gif", "--speed", "1e-3"), "more than 2400; take a part with --start"),
    ],
)
def test_what_cannot_be_filmed_is_told(words: tuple[str, ...], said: str) -> None:
    done = run("plot", "--moving", barrel_log(), *words)
    assert done.code != 0 and said in done.err and "Traceback" not in done.err, done


@pytest.fixture
def own(tmp_path: Path) -> tuple[Path, Path, Path]:
    """Return the folder of a rig of one's own, its log elsewhere, and what its drawing leaves."""
    folder, mark = tmp_path / "motor", tmp_path / "drawn"
    new.write(folder)
    drawing = folder / "drawing.py"
    drawing.write_text(drawing.read_text() + MARK.format(mark=str(mark)))
    log = tmp_path / "log.mcap"
    simulate(load_rig(folder / "rig.yaml", settings=["duration_s=0.02"]), log)
    assert not mark.exists(), "a run draws nothing"
    return folder, log, mark


def test_a_drawing_runs_from_its_place_and_from_the_log_with_trust_only(
    own: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    folder, log, mark = own
    carried = [n for n in logs.read(log).node.values() for n in n.description["files"]]
    assert {one["name"] for one in carried if one["draws"]} == {"drawing.py"}
    film(log, tmp_path)
    assert mark.exists(), "it lies where the log says, unchanged"
    mark.unlink()
    shutil.rmtree(folder)
    done = run("plot", "--moving", log, "-o", tmp_path / "b.gif")
    assert done.code != 0 and "--trust" in done.err and not mark.exists(), done
    assert "drawing.py (sha256" in done.err, done.err
    film(log, tmp_path, "--trust")
    assert mark.exists()


def test_a_drawing_that_changed_does_not_hinder_the_evaluation(
    own: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    folder, log, _ = own
    (folder / "drawing.py").write_text("1/0")
    done = run("plot", log, "-o", tmp_path / "f.png", "--quiet")
    assert done.code == 0 and "the figure of motor" in done.out, done
    done = run("plot", "--moving", log, "-o", tmp_path / "b.gif")
    assert done.code != 0 and "is another file now" in done.err, done


def test_a_drawing_of_the_project_needs_no_trust_wherever_the_rig_lay(tmp_path: Path) -> None:
    folder, log = tmp_path / "motor", tmp_path / "log.mcap"
    new.write(folder)
    simulate(load_rig(folder / "rig.yaml", settings=["duration_s=0.02"]), log)
    shutil.rmtree(folder)
    assert len(film(log, tmp_path)) == 1


def test_check_names_what_a_drawing_needs_in_vain(tmp_path: Path) -> None:
    new.write(folder := tmp_path / "motor")
    file = folder / "drawing.py"
    file.write_text(file.read_text().replace("motor.held_V", "motor.hold_V"))
    done = run_here("check", folder)
    assert done.code == 0 and "did you mean motor.held_V" in " ".join(done.out.split()), done


def test_check_tries_the_drawing(tmp_path: Path) -> None:
    new.write(folder := tmp_path / "motor")
    file = folder / "drawing.py"
    file.write_text(file.read_text().replace('now["angle"]', 'now["angel"]'))
    done = run_here("check", folder)
    assert done.code != 0 and done.err.count("\n") == 1, done
    assert "drawing.py:" in done.err and "KeyError: 'angel'" in done.err, done.err
