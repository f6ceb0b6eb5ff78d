"""A run writes into its folder and nowhere else, whatever lies there before."""

import json
from pathlib import Path

import pytest
from processes import ROOT

from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main
from pcpc.tools.start.folder import LINE, LOG, run_folder
from pcpc.tools.terminal.outfile import new_file, whole_file

PROBE = str(ROOT / "plants/probe/rig.yaml")
SHORT = ["--set", "duration_s=0.05", "--quiet"]
Screen = pytest.CaptureFixture[str]


@pytest.mark.parametrize("name", ["summary.json", "figure.png", "log.mcap", "anything"])
@pytest.mark.parametrize("there", [True, False])
def test_a_link_in_place_of_a_file_is_refused(
    name: str, there: bool, tmp_path: Path, capsys: Screen
) -> None:
    mine, folder = tmp_path / "mine", tmp_path / "run"
    if there:
        mine.write_text("keep this")
    folder.mkdir()
    (folder / name).symlink_to(mine)
    assert main(["simulate", PROBE, "-o", str(folder), *SHORT]) == 2
    said = f"{folder / name}: is a link; remove it, or choose another folder with -o\n"
    assert capsys.readouterr().err == said
    assert mine.exists() == there and (not there or mine.read_text() == "keep this")
    assert [path.name for path in folder.iterdir()] == [name]


@pytest.mark.parametrize("before", [None, "mine"])
@pytest.mark.parametrize("log", ["", "cycles"])
def test_what_a_line_wrote_stays_with_a_log_only(
    before: str | None, log: str, tmp_path: Path
) -> None:
    """Nodes may have begun when the rig's evaluation is refused, and the line with them."""
    folder = tmp_path / "run"
    if before is not None:
        folder.mkdir()
        (folder / LINE).write_text(before)
    with run_folder(folder, load_rig(PROBE)):
        (folder / LINE).write_text("{}")
        (folder / LOG).write_text(log)
    there = {path.name for path in folder.iterdir()} if folder.exists() else set()
    assert there == ({LOG, LINE} if log else {LINE} if before else set())


def test_a_hard_link_is_replaced_and_not_written_through(tmp_path: Path, capsys: Screen) -> None:
    mine, folder = tmp_path / "mine", tmp_path / "run"
    mine.write_text("keep this")
    folder.mkdir()
    for name in ("summary.json", "figure.png"):
        (folder / name).hardlink_to(mine)
    assert main(["simulate", "hull", "-o", str(folder), *SHORT]) == 1, capsys.readouterr().err
    assert mine.read_text() == "keep this"
    assert json.loads((folder / "summary.json").read_text())["rig"] == "hull"
    assert (folder / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert not [path for path in folder.iterdir() if path.name.startswith(".")]


def test_a_file_is_whole_or_what_it_was(tmp_path: Path) -> None:
    for files in (whole_file, lambda path: new_file(path, force=True)):
        path = tmp_path / "file"
        path.write_text("before")
        with pytest.raises(KeyError), files(path) as unfinished:
            unfinished.write_text("a part")
            raise KeyError
        assert path.read_text() == "before" and [*tmp_path.iterdir()] == [path]
        with files(path) as unfinished:
            unfinished.unlink()
        assert path.read_text() == "before"
        with files(path) as unfinished:
            unfinished.write_text("")
        assert path.read_text() == "", "an empty file is a file"


@pytest.mark.parametrize("title", [r"a\nverdict  ok", r"a\tb"])
def test_a_title_stays_in_its_line(title: str, tmp_path: Path, capsys: Screen) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(f'base: {PROBE}\ntitle: "{title}"\n')
    run = ["simulate", str(rig), "-o", str(tmp_path / "run"), *SHORT[:2]]
    for words in (["check", str(rig)], run):
        main(words)
        assert f"probe: {title}" in capsys.readouterr().out, words


def test_quiet_leaves_what_a_run_comes_to(tmp_path: Path, capsys: Screen) -> None:
    folder = tmp_path / ("long" * 30) / "good"  # in one piece, however long: it is copied
    assert main(["simulate", PROBE, "-o", str(folder), *SHORT]) == 0
    said, err = capsys.readouterr()
    assert [line.split()[0] for line in said.splitlines()] == ["verdict", "folder"], err
    assert said.splitlines()[-1].split()[-1] == str(folder)
    words = ["--judge", "-o", str(tmp_path / "bad"), *SHORT]
    assert main(["simulate", "hull", *words]) == 1
    kinds = [line.split()[0] for line in capsys.readouterr().out.splitlines() if line[0] != " "]
    assert kinds == ["problem", "verdict", "folder"] and json.loads(
        (tmp_path / "bad/summary.json").read_text()
    )
