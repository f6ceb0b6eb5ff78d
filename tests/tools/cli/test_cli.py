"""The command line itself: help that fits and is true, rigs by name, logs by folder."""

import argparse
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
from logcommand import barrel_log
from processes import ROOT, pcpc

from pcpc.executive.errors import RigError
from pcpc.tools import cli
from pcpc.tools.after.log import recorded
from pcpc.tools.after.verdict.judge import changes
from pcpc.tools.cli import main
from pcpc.tools.cli.commands import COMMANDS, GROUPS, of_group
from pcpc.tools.cli.earlier import present_words
from pcpc.tools.start import rigs
from pcpc.tools.terminal.command import Command

PARTS = [(name, part) for name, command in COMMANDS.items() for part in command.parts]
HELPS = [(), *((name,) for name in COMMANDS), *((name, part.name) for name, part in PARTS)]
Screen = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")


def help_of(words: tuple[str, ...], screen: Screen) -> str:
    assert main([*words, "--help"]) == 0
    return screen.readouterr().out


@pytest.mark.parametrize("words", HELPS, ids=" ".join)
def test_help_fits_80_columns_and_its_examples_are_right(
    words: tuple[str, ...], capsys: Screen
) -> None:
    text = help_of(words, capsys)
    assert [line for line in text.splitlines() if len(line) > 80] == []
    for example in examples(text):
        said = check(example)
        assert not said, f"{example}: {said}"
    assert any(examples(text)) or not words, text


def examples(text: str) -> Iterator[list[str]]:
    """Yield the words of each example in a help, comments and pipes cut off."""
    for found in re.finditer(
        r"^(?:examples?:)? *(pcpc \S.*(?:\n {4,}(?!pcpc)\S.*)*)", text, re.MULTILINE
    ):
        yield shlex.split(" ".join(found[1].split()), comments=True)[1:]


def check(words: list[str]) -> str:
    """Return what is wrong with a command line; nothing is carried out."""
    try:
        options = cli.parsed_options(words)
    except SystemExit:
        return "it does not parse"
    if words[0] == "vm":
        return "" if options.rest else "no command"
    if words[0] == "rigs":
        return "" if rigs.command(options) == 0 else "matches none"
    if (rig := getattr(options, "rig", None)) is not None:
        data = rigs.yamlfile.load(rigs.find(rig)).data
        controller = getattr(options, "controller", None)
        if words[0] == "local" and "local" not in data:
            return "this rig has no local node"
        if controller is not None and controller not in data["controllers"]:
            return f"no controller {controller}"
    if words[0] == "experiment":
        from pcpc.tools.study.experiment.cli import names

        return "" if options.name in names() else "no such experiment"
    return ""


def test_every_command_is_in_the_help_and_parses(capsys: Screen) -> None:
    text = of_group("all")
    registered = next(
        action.choices
        for action in cli.parser()._actions
        if isinstance(action, argparse._SubParsersAction)
    )
    assert set(registered) == set(COMMANDS)
    assert [name for name in COMMANDS if f"\n  {name} " not in text] == []
    first = help_of((), capsys)
    begin = [name for name, one in COMMANDS.items() if f"\n  {name} " in first and one.first]
    assert len(begin) == 13 and all(f"\n  {group} " in first for group in GROUPS)


@pytest.mark.parametrize("command", [*COMMANDS.values(), *(part for _, part in PARTS)])
def test_what_carries_a_command_out_is_there(command: Command) -> None:
    if command.parts:
        return
    carried_out = import_module(f"pcpc.tools.{command.module}").command
    taken = next(iter(get_type_hints(carried_out).values()))
    known = get_args(taken) or (taken,)
    assert command.asked in known


def places(found: argparse.ArgumentParser) -> Iterator[tuple[list[str], argparse.Action]]:
    """Yield of each command the words and the actions that take a file or a folder."""
    for action in found._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, part in action.choices.items():
                yield from (([name, *words], own) for words, own in places(part))
        elif re.match(r"(DIR|FILE|OUT|LOG)\b", str(action.metavar)) or action.type is Path:
            yield [], action


def test_an_empty_name_of_a_file_or_folder_is_refused_by_every_command(capsys: Screen) -> None:
    count, written = 0, set(Path().iterdir())
    for words, action in places(cli.parser()):
        ahead = action.option_strings[:1]
        if action.nargs is not None:
            continue
        count += 1
        given = [*words, *ahead, ""] if ahead else [*words, *[""] * 3]
        assert main(given) == 2, given
        out, err = capsys.readouterr()
        said = re.escape(ahead[0] if ahead else str(action.dest))
        assert re.fullmatch(rf"{said} '': expected a (file|folder|log|path)\n|.*'': .*\n", err), (
            given,
            err,
        )
        assert out == "", given
    assert count > 30 and set(Path().iterdir()) == written, count


def test_neither_the_help_nor_a_mistake_brings_numpy_or_numba() -> None:
    code = "import sys, pcpc.tools.cli as c; c.main(sys.argv[1:]); print(sys.modules.keys())"
    for words in (["--version"], ["run", "--help"], ["rnu"], ["log", "export", "--help"]):
        done = subprocess.run(
            [sys.executable, "-c", code, *words], capture_output=True, text=True, cwd=ROOT
        )
        assert done.returncode == 0 and not re.search("'num(py|ba)'", done.stdout), str(done)


def test_version_names_pcpc_python_and_numba(capsys: Screen) -> None:
    assert main(["--version"]) == 0
    out = capsys.readouterr().out
    assert re.fullmatch(r"pcpc \d+\.\d+\.\d+, Python 3\.\d+\.\d+\S*, numba \d\S+\n", out), out


def test_a_fault_of_no_kind_is_told_all_kinds(capsys: Screen, tmp_path: Path) -> None:
    fault = "{at: executive:rx.FB_A.encoder, kind: offset, value: 1.0}"
    file = tmp_path / "rig.yaml"
    file.write_text(f"base: {ROOT}/plants/atb1000/rigs/hull.yaml\nfaults: {{wrong: {fault}}}\n")
    assert main(["check", str(file)]) == 2
    err = capsys.readouterr().err
    assert "no kind offset; known: " in err and "stall" in err and "flood" in err, err


@pytest.mark.parametrize(
    ("then", "now"),
    [
        ("exec hull --x", "run --only executive hull --x"), ("plant", "run --only plant"),
        ("local a -- b", "run --only local a -- b"), ("list a.*", "get --long a.*"),
        ("a2l hull", "generate a2l hull"), ("step L --cycle 1", "replay L --cycle 1"),
        ("verify L M", "replay --brief L M"), ("log cat L", "log export -o - L"),
        ("log diff A B --json v", "compare --bits A B --json - v"),
        ("log require L", "report --requirements L"), ("log animate L", "log plot --moving L"),
        ("reset", "operate reset"), ("arm", "operate arm"), ("hold", "operate hold"),
        ("resume", "operate resume"), ("lock tune", "operate lock tune"),
        ("handover pd", "operate handover pd"),
    ],
)  # fmt: skip
def test_an_earlier_word_is_the_present_one_and_names_it(then: str, now: str) -> None:
    words, note = present_words(then.split())
    assert words == now.split() and present_words(words) == (words, "")
    name = re.match(r"pcpc (.+): is `pcpc (.+)` now$", note)
    assert name and then.startswith(name[1]) and now.startswith(name[2]) and len(note) < 80
    assert then.split()[0] not in COMMANDS or then.startswith("log ")


def test_an_earlier_word_still_works(capsys: Screen) -> None:
    log = str(barrel_log("pd"))
    for then, now in (
        ("step", "replay"),
        ("log cat", "log export -o -"),
        ("verify", "replay --brief"),
    ):
        more = [log, "--quiet", *["--cycle", "7"] * (then == "step")]
        assert main([*now.split(), *more]) == 0
        out = capsys.readouterr().out
        assert main([*then.split(), *more]) == 0
        told = capsys.readouterr()
        assert (told.out, told.err) == (out, f"pcpc {then}: is `pcpc {now}` now\n") and out


@pytest.mark.parametrize("name", ["bench", "evidence", "soak"])
def test_a_command_that_the_repository_has_now_names_its_place(capsys: Screen, name: str) -> None:
    assert main([name]) == 2
    found = re.search(r"`python -m (\S+)`", capsys.readouterr().err)
    assert found and find_spec(found[1]) is not None, found


def test_make_help_lists_every_target_in_80_columns() -> None:
    # Of its own: a make around this one would have it say which folder it enters.
    alone = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    done = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, env=alone)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    phony = re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert phony and {line.split()[0] for line in lines} == set(phony[1].split()), lines
    assert [line for line in lines if len(line) > 80] == []


# Rigs by name


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("hull", "atb1000/rigs/hull.yaml"), ("atb1000/hull", "atb1000/rigs/hull.yaml"),
        ("sin0.5", "atb1000/rigs/sin0.5.yaml"), ("probe", "probe/rig.yaml"),
        ("telerobot/telerobot-u1", "telerobot/rigs/telerobot-u1.yaml"),
    ],
)  # fmt: skip
def test_a_rig_is_found_by_name_from_any_folder(
    name: str, file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert rigs.find(name) == str(ROOT / "plants" / file)


def test_a_path_wins_over_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("hull").write_text("rig: own\n")
    assert rigs.find("hull") == "hull"
    Path("probe").mkdir()
    assert rigs.find("probe") == str(ROOT / "plants/probe/rig.yaml"), "an empty folder hides it"
    Path("probe/rig.yaml").write_text("rig: own\n")
    assert rigs.find("probe") == "probe/rig.yaml"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hul", "hul: no file and no rig of this name; did you mean hull?"),
        ("atb1000/hul", "did you mean atb1000/hull?"),
        ("hull.yaml", "hull.yaml: no such file; the rig that comes with pcpc is called hull"),
        ("zzz.yaml", "zzz.yaml: no such file"),
        ("a\0b", "no file and no rig"),
    ],
)
def test_an_unknown_rig_is_refused_with_the_likely_one(
    text: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RigError, match=re.escape(said)):
        rigs.find(text)


def test_what_is_no_rig_is_never_meant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No run has such a name, as another test's beside this one may have of a motor."""
    monkeypatch.chdir(tmp_path)
    for folder in ("tmp", "wobbler", "wobblers", "cart"):
        (tmp_path / folder).mkdir()
    (tmp_path / "cart/rig.yaml").touch()
    for text in ("tmp", "./tmp", "wobbler", str(tmp_path / "wobbler"), "/", "wobbler.yaml"):
        with pytest.raises(RigError) as caught:
            rigs.find(text)
        assert "did you mean" not in str(caught.value), caught.value
    with pytest.raises(RigError, match=r"mean cart\?"):
        rigs.find("./carts")


def test_a_name_of_two_rigs_is_refused_with_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for plant in ("one", "two"):
        (tmp_path / plant / "rigs").mkdir(parents=True)
        (tmp_path / plant / "rig.yaml").write_text("rate_hz: 1.0\n")
        (tmp_path / plant / "rigs/calm.yaml").write_text("base: ../rig.yaml\nrig: calm\n")
    monkeypatch.setattr(rigs, "_PLANTS", tmp_path)
    with pytest.raises(RigError, match="calm: 2 rigs have this name; choose one/calm or two/calm"):
        rigs.find("calm")
    assert rigs.find("two/calm") == str(tmp_path / "two/rigs/calm.yaml")


def test_names_of_the_shipped_rigs_are_unique() -> None:
    names = [name for rig in rigs.shipped_rigs() for name in rig.names]
    assert len(names) == len(set(names)), sorted(n for n in names if names.count(n) > 1)
    assert {rig.path for rig in rigs.shipped_rigs()} >= set((ROOT / "plants").glob("*/rigs/*.yaml"))


def test_rigs_are_listed_with_titles_in_80_columns(capsys: Screen) -> None:
    assert main(["rigs"]) == 0
    out = capsys.readouterr().out
    assert [line for line in out.splitlines() if len(line) > 80] == []
    assert re.search(r"^  hull +12 s  hold 0 deg while the hull pitches", out, re.MULTILINE), out
    assert main(["rigs", "telerobot", "friction-?", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert {rig["plant"] for rig in listed} == {"telerobot", "friction_arm"}
    assert all(Path(rig["file"]).is_file() and rig["title"] for rig in listed)


@pytest.fixture(scope="module")
def user_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder outside of the project with one run in it."""
    folder = tmp_path_factory.mktemp("user")
    words = ["--set", "duration_s=0.05", "--no-figure", "--quiet", "-o"]
    gain = ["--set", "controller.gain=0.2"]
    for more in (["runs/second", *gain], ["runs/first"]):
        done = pcpc("simulate", "probe", *words, *more, cwd=folder)
        assert done.code == 0, str(done)
    return folder


@pytest.mark.parametrize(
    "words",
    [
        ["check", "hull"],
        ["log", "info", "latest"],
        ["replay", "latest"],
        ["replay", "runs/first"],
        ["report", "latest"],
    ],
    ids=" ".join,
)
def test_a_rig_by_name_and_the_latest_run_outside_of_the_project(
    words: list[str], user_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(user_folder)
    assert main(words) == 0


@pytest.mark.parametrize(
    "words",
    [
        ["check", "hull"], ["check", "friction-a"], ["check", "telerobot-u2"], ["rigs"],
        ["log", "info", "latest"], ["compare", "--bits", "runs/first", "runs/second"],
        ["replay", "latest"], ["replay", "latest", "--set", "controller.gain=0.3"],
        ["bus", "hull"], ["doctor"], ["compare", "runs/first", "runs/second"],
        ["report", "latest", "--require", "always: abs(controller.command) < 1e9"],
        ["simulate", "probe", "--set", "duration_s=0.05", "--no-figure", "--quiet"],
        ["simulate", "telerobot-u1", "--set", "duration_s=0.05", "--no-figure", "--quiet"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_what_a_command_prints_fits_80_columns(
    words: list[str], user_folder: Path, capsys: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(user_folder)
    assert main(words) in (0, 1)
    out = capsys.readouterr().out
    assert out and [line for line in out.splitlines() if len(line) > 80] == [], out


@pytest.mark.parametrize(
    ("settings", "title"),
    [
        ([], ""), (["a.b=1"], "; a.b=1"), (["a=1", "b=2", "c=3", "d=4"], "; a=1; b=2; 2 more"),
        (["x" * 40 + "=1"], "; " + "x" * 36 + "..."),
    ],
)  # fmt: skip
def test_a_figures_title_says_what_was_changed(settings: list[str], title: str) -> None:
    assert changes(settings) == title


# Logs by folder


def test_a_log_is_a_file_a_run_folder_or_the_latest_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RigError, match=r"latest: no run below .*runs; name a log or a run folder"):
        recorded.log_of("latest")
    for age, name in enumerate(("20260102-b", "20260101-a")):
        folder = Path("runs", name)
        folder.mkdir(parents=True)
        (folder / "log.mcap").write_bytes(b"log")
        os.utime(folder / "log.mcap", ns=(0, 10**9 * (2 - age)))
    Path("runs/20260103-c").mkdir()
    Path("runs/20260103-c/log.mcap").touch()  # a run that has not begun
    assert recorded.log_of("latest") == Path("runs/20260102-b/log.mcap")
    assert recorded.log_of("runs/20260101-a") == Path("runs/20260101-a/log.mcap")
    with pytest.raises(RigError, match=r"2026010-a: no such log; did you mean runs/20260101-a\?"):
        recorded.log_of("2026010-a")
    with pytest.raises(RigError, match=r"runs: this folder holds no log.mcap"):
        recorded.log_of("runs")
    with pytest.raises(
        RigError, match=r"an empty name is not a log"
    ):  # of a variable that is not set
        recorded.log_of("")
    Path("latest").write_bytes(b"own")
    assert recorded.log_of("latest") == Path("latest")


def test_every_command_that_takes_a_log_takes_a_run_folder(
    user_folder: Path, tmp_path: Path, capsys: Screen
) -> None:
    name = str(user_folder / "runs/first")
    for words in (
        ["replay", name, "--quiet"],
        ["play", name, "--duration", "0.001", "--bus", "nosuch"],
        ["log", "info", name],
        ["compare", "--bits", name, name],
        ["log", "export", name, "-o-", "--quiet"],
        ["log", "export", name, "-o", str(tmp_path / "a.csv")],
        ["log", "recover", name, "-o", str(tmp_path / "b.mcap")],
        ["log", "plot", name, "time.t_s", "-o", str(tmp_path / "a.png")],
    ):
        code = main(words)
        err = capsys.readouterr().err
        assert "no such file" not in err and "folder" not in err, f"{words}: {err}"
        assert code == 0 or "nosuch" in err, f"{words}: {code} {err}"
