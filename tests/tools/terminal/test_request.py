"""A class of fields as the declaration of a command: its options, and what a command line gives."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest

from pcpc.drivers.errors import UserError
from pcpc.tools.terminal import request as requests
from pcpc.tools.terminal.option_notes import note_options
from pcpc.tools.terminal.parsing import Parser
from pcpc.tools.terminal.request import HIDDEN, WORD, Offers, Request


class Louder(argparse.Action):
    """What is done in place of setting a field."""

    def __call__(self, parser: Any, options: Any, text: Any, *_: Any) -> None:
        options.words = [*options.words, text.upper()]


class Place(Request):
    """A request within another."""

    folder: Annotated[Path | None, "-o", "DIR", "where"] = None
    force: Annotated[bool, "overwrite"] = False


class Named(Request):
    """What another derives from."""

    rig: Annotated[str, "RIG", "a rig"]
    count: Annotated[int, "N", "first"] = 1


class Beside(Request):
    """What a room offers."""

    host: Annotated[bool, "a page"] = False


def halves(text: str) -> list[float]:
    return [float(one) / 2 for one in text.split(",")]


class Whole(Named):
    """A field of each kind."""

    more: Annotated[Sequence[int], WORD, "N", "numbers"] = ()
    count: Annotated[int, "-n", "N", "how many"] = 2
    at_s: Annotated[float | None, "--at", "TIME", "when"] = None
    words: Annotated[Sequence[str], "WORD", "--at: said then"] = ()
    loud: Annotated[None, Louder, "WORD", "the same"] = None
    kind: Annotated[Literal["a", "b"] | None, "of which kind"] = None
    bits: Annotated[Literal[8, 16], "of a CRC"] = 8
    factors: Annotated[Sequence[float] | None, halves, "F,...", "twice as large"] = None
    files: Annotated[Sequence[str] | None, "FILE", "some", {"nargs": "+"}] = None
    goal: Annotated[str, "--goal", "what for"]
    place: Place = Place()
    beside: Annotated[Offers, "BESIDE_WHOLE"] = Offers()
    old: Annotated[str | None, HIDDEN] = None
    begin_ns: int = 0


class Optional(Request):
    """Words without an option."""

    name: Annotated[str | None, WORD, "NAME", "one"] = None
    names: Annotated[Sequence[str], "NAMES", "some"]


@pytest.fixture(autouse=True)
def offered(monkeypatch: pytest.MonkeyPatch) -> None:
    there = {"BESIDE_WHOLE": [Beside]}
    monkeypatch.setattr(requests, "offers", lambda name: there.get(name, []))


def made(kind: type[Request]) -> list[tuple[list[str], dict[str, Any]]]:
    found: list[tuple[list[str], dict[str, Any]]] = []
    kind.add_to(lambda *names, **more: found.append((list(names), more)))  # type: ignore[arg-type]
    return found


def read(kind: type[Any], *words: str, **more: Any) -> Any:
    parser = Parser(prog="p")
    note_options(parser)
    kind.add_to(parser.add_argument)
    return kind.from_options(parser.parse_args(words, argparse.Namespace(**more)))


def test_fields_make_what_a_parser_takes_those_of_the_base_first() -> None:
    def option(name: str, help: str, *short: str, **more: Any) -> tuple[list[str], dict[str, Any]]:
        return [*short, name], {"help": help, **more}

    assert made(Whole) == [
        (["rig"], {"metavar": "RIG", "help": "a rig"}),
        option("--count", "how many", "-n", metavar="N", type=int, default=2),
        (["more"], {"metavar": "N", "help": "numbers", "type": int, "nargs": "*"}),
        option("--at", "when", metavar="TIME", type=float, dest="at_s"),
        option("--words", "--at: said then", metavar="WORD", action="append", default=[]),
        option("--loud", "the same", metavar="WORD", action=Louder),
        option("--kind", "of which kind", choices=("a", "b")),
        option("--bits", "of a CRC", choices=(8, 16), type=int, default=8),
        option("--factors", "twice as large", metavar="F,...", type=halves),
        option("--files", "some", metavar="FILE", nargs="+"),
        option("--goal", "what for", required=True),
        option("--folder", "where", "-o", metavar="DIR", type=Path),
        option("--force", "overwrite", action="store_true"),
        option("--host", "a page", action="store_true"),
        option("--old", HIDDEN),
    ]
    assert made(Optional) == [
        (["name"], {"metavar": "NAME", "help": "one", "nargs": "?"}),
        (["names"], {"metavar": "NAMES", "help": "some", "nargs": "+"}),
    ]


def test_a_command_line_gives_the_fields_their_values() -> None:
    line = "hull 3 4 --goal g --at 1.5 --words a --loud b --kind b --bits 16 --factors 2,3 --host"
    found = read(Whole, *line.split(), "-o", "x", begin_ns=7)
    assert (found.rig, found.more, found.goal, found.at_s) == ("hull", [3, 4], "g", 1.5)
    assert (found.words, found.loud, found.kind, found.bits) == (["a", "B"], None, "b", 16)
    assert (found.factors, found.files, found.begin_ns) == ([1.0, 1.5], None, 7)
    assert (found.place.folder, found.place.force) == (Path("x"), False)
    assert found.beside.of(Beside).host and found.beside.value("host") is True
    bare = read(Whole, "hull", "--goal", "g")
    assert (bare.count, bare.more, bare.words, bare.bits, bare.begin_ns) == (2, [], [], 8, 0)
    assert read(Optional, "a", "b", "c").names == ["b", "c"]


def test_a_caller_gives_them_by_name_and_has_the_defaults_of_the_others() -> None:
    asked = Whole(rig="hull", goal="g", place=Place(force=True))
    assert (asked.count, asked.more, asked.at_s, asked.place.force) == (2, (), None, True)
    with pytest.raises(TypeError, match="Whole has no contrast"):
        Whole(rig="hull", goal="g", contrast=1)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="Whole needs goal"):
        Whole(rig="hull")  # type: ignore[call-arg]
    assert not asked.are_given("rig", "count")
    other = asked.changed(count=5)
    assert (other.count, other.goal, other.place.force, asked.count) == (5, "g", True, 2)


def test_what_a_command_line_gives_is_refused_by_its_field() -> None:
    found = read(Whole, "hull", "--goal", "g", "--at", "0", "--force", "-n", "2")
    assert found.are_given("words", "at_s") and not found.are_given("words", "kind")
    with pytest.raises(UserError, match="--at: not here"):
        found.refuse("not here", "words", "at_s")
    with pytest.raises(UserError, match="--force: not here"):
        found.changed(count=9).refuse("not here", "force")
    found.refuse("not here", "words", "kind")


def test_offers_of_a_room_that_is_not_there_are_as_if_not_given(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(requests, "offers", lambda name: [])
    found = read(Whole, "hull", "--goal", "g")
    assert found.beside.value("host") is None and found.beside.of(Beside).host is False
    with pytest.raises(UserError, match="no option --host"):
        read(Whole, "hull", "--goal", "g", "--host")
