"""Wrong words to every command that the registry knows: one line, its place, a cure, exit code.

What no command can read is made up of what each says that it takes. What it can read and cannot
follow is in refused_words: a command without rows there fails. Nothing is left behind.
"""

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from logcommand import barrel_log
from refused_words import FILES, TABLES

from pcpc.tools import cli
from pcpc.tools.cli import main

Words = tuple[str, ...]
Screen = pytest.CaptureFixture[str]
PARTS = argparse._SubParsersAction
READ_ON = "vm", "slcan"  # behind the words that they know they take a program
DEEP = "branch", "generate", "replay"  # but for their first rows
ROWS = [(f"{command} {words}", *more) for command, rows in TABLES.items() for words, *more in rows]
REFUSED = [
    pytest.param(
        (f"{command} {words}", *more),
        marks=pytest.mark.deep if k > 2 and command.startswith(DEEP) else pytest.mark.quick,
        id=" ".join([*command.split()[:2], words])[:50],
    )
    for command, rows in TABLES.items()
    for k, (words, *more) in enumerate(rows)
]


def leaves(parser: argparse.ArgumentParser, path: Words = ()) -> Iterator[tuple[Words, list]]:
    """Yield each command that can be carried out with what it takes, but for its help."""
    parts = [action for action in parser._actions if isinstance(action, PARTS)]
    for name, one in (parts[0].choices if parts else {}).items():
        yield from leaves(one, (*path, name))
    if not parts:
        yield path, [a for a in parser._actions if a.dest != "help" and a.help != "==SUPPRESS=="]


LEAVES = dict(leaves(cli.parser()))


def option(action: argparse.Action) -> str:
    return max(action.option_strings, key=len, default="")


def kind(action: argparse.Action) -> str:
    return str(action.metavar or "").partition(".")[0]


def wrong_words() -> Iterator[tuple[Words, str]]:
    """Yield command lines, and what the answer has to say; an option that many share once."""
    seen = set[tuple[str, str]]()
    for path, actions in LEAVES.items():
        needed = [a for a in actions if not a.option_strings and a.nargs in (None, "+", 1)]
        if needed:
            yield path, f"required: {needed[0].metavar or needed[0].dest}"
        yield (*path, "--nosuchoption"), "no option --nosuchoption"
        places = [a for a in actions if not a.option_strings]
        if all(a.nargs in (None, 1, "?") for a in places) and path[-1] not in READ_ON:
            filled = (
                str(next(iter(a.choices or ["1" if a.metavar == "N" else "model.py"])))
                for a in places
            )
            needed = [f"{option(a)}=a.csv" for a in actions if a.option_strings and a.required]
            yield (*path, *filled, "extra", *needed), "'extra' is a word too many"
        new = [a for a in actions if (option(a), str(a.metavar)) not in seen]
        seen |= {(option(a), str(a.metavar)) for a in new if a.option_strings}
        for action in (a for a in new if a.option_strings):
            name = option(action)
            if len(name) > 5:
                yield (*path, f"{name[:4]}{name[5:]}"), "no option"
            if action.nargs is None:
                yield (*path, name), "expected"
        for action in new:
            for value, said in wrong_values(action):
                word = f"{option(action)}={value}" if action.option_strings else value
                others = rest(actions, action) if action.option_strings else ()
                yield (*path, word, *others), said


def rest(actions: list[argparse.Action], one: argparse.Action) -> Words:
    """Return what else a command needs beside an option."""
    needed = (a for a in actions if a is not one and (a.required and a.nargs != "*"))
    return tuple(f"{option(a)}=model.py" if a.option_strings else "bash" for a in needed)


def wrong_values(action: argparse.Action) -> Iterator[tuple[str, str]]:
    """Yield values that an argument cannot have, and what the answer has to say."""
    if action.choices is not None and action.type is None:
        name = str(next(iter(action.choices)))
        yield f"{name}x", f"did you mean {name}?"
        yield "0", "is not known; known: " if len(list(action.choices)) < 9 else "is not known"
    elif action.type is int and action.nargs is None:
        yield from ((value, "expected a whole number from 0 on") for value in ("x", "1.5", "-3"))
    elif action.type is float:
        yield from ((value, "expected a number") for value in ("x", "nan", "inf", "1,5"))
    elif kind(action) in ("FILE", "OUT") and action.option_strings:
        yield "no/such/file", "file"
        yield "folder", "is a folder"
        yield "", "expected a file"
    elif kind(action) == "DIR" and action.option_strings and action.nargs is None:
        yield "model.py", "is not a folder"
        yield "", "expected a folder"
    elif action.type not in (None, str, Path) and kind(action) not in ("LOG", "A", "B", "FILE"):
        yield from ((value, "") for value in ("x", "-1") if action.nargs is None)


CASES = list(wrong_words())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Stand in a folder with a file, a folder and a log; nothing comes beside them."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "mylog").mkdir()
    (tmp_path / "mylog/log.mcap").touch()
    (tmp_path / "model.py").touch()
    before = sorted(map(str, tmp_path.rglob("*")))
    yield tmp_path
    assert sorted(map(str, tmp_path.rglob("*"))) == before


def answer(words: Words, screen: Screen) -> str:
    """Return the line with which words are refused."""
    code = main([*words])
    out, err = screen.readouterr()
    assert (code, out, err.count("\n")) == (2, "", 1), (words, code, out, err)
    assert "usage" not in err and "Traceback" not in err, err
    return err


def test_wrong_words_are_answered_in_a_line(
    folder: Path, capsys: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cli, "import_module", None)  # no command is carried out
    assert len(CASES) > 400, len(CASES)
    wrong = []
    for words, said in CASES:
        try:
            text = answer(words, capsys)
        except AssertionError as error:
            wrong.append(str(error))
            continue
        if said not in text or not text.startswith(("pcpc " + words[0], "-")):
            wrong.append(f"{words}: {said!r} is not in {text}")
    assert not wrong, "\n".join(wrong)


def near_names() -> Iterator[tuple[Words, str]]:
    """Yield command lines with a wrong rig or log where one is taken, and what was meant."""
    for path, actions in LEAVES.items():
        places = [a for a in actions if not a.option_strings and a.nargs != "*"]
        for place in places:
            kinds = str(place.metavar).replace("|", " ").split()
            for one, near, meant in (("RIG", "hul", "hull"), ("LOG", "mylg", "mylog")):
                if one in kinds:
                    rest = {id(a): "hull" if a.metavar == "RIG" else "mylog" for a in places}
                    rest[id(place)] = near
                    needed = [a for a in actions if a.option_strings and a.required]
                    more = [f"{option(a)}=x.csv" for a in needed]
                    yield (*path, *rest.values(), *more), f"did you mean {meant}?"


@pytest.mark.parametrize(("words", "said"), list(near_names()))
def test_a_near_name_is_proposed(words: Words, said: str, folder: Path, capsys: Screen) -> None:
    assert said in answer(words, capsys)


def test_every_command_has_words_of_both_kinds() -> None:
    made_up = {words[: len(path)] for words, _ in CASES for path in LEAVES}
    assert not LEAVES.keys() - made_up
    written = tuple(f"{line} ".lstrip() for line, *_ in ROWS)
    names = {" ".join(path) for path in LEAVES}
    without = {name for name in names if not any(row.startswith(f"{name} ") for row in written)}
    assert not without, "write rows for them into refused_words"


@pytest.mark.parametrize("row", REFUSED)
@pytest.mark.quick
def test_words_that_cannot_be_followed_are_a_line(
    row: tuple[str, ...], refused: Callable[..., None], tmp_path: Path
) -> None:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(text.encode("latin-1"))
    (tmp_path / "empty").mkdir()
    (tmp_path / "log.mcap").hardlink_to(barrel_log("pd"))
    refused(*row)


def test_an_option_given_twice_with_one_value_is_no_mistake(capsys: Screen) -> None:
    assert main(["bus", "hull", "--rate", "500Hz", "--rate", "500", "--json", "--json"]) == 0
    assert '"rate_hz": 500.0' in capsys.readouterr().out
