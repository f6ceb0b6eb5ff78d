"""`--at` a host whose answers are odd: each is a line about it, whatever they are."""

import copy
import json
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from hosting import ANSWER_S
from live_run import Screen
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from pcpc.executive.loop import shared as sh
from pcpc.executive.nodes.plan import describe, plan
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main
from pcpc.tools.live.remote import fields
from pcpc.tools.start.rigs import find

EVIL = "\x1b]0;evil\x07\x1b[2J\x9b31m\u202e"
ODD: list[Any] = [
    None, True, -1, 0, 2**70, 1e400, float("nan"), "", EVIL, "x" * 10**5, [], {}, [[]], {"": []},
    [1, 2], ["a"] * 3, [None] * 9, {"a": {"b": {}}}, [["a", "b", "c", "d", "e"]],
]  # fmt: skip
COMMANDS = [
    ["list"], ["get", "controller.gain"], ["list", "-l"],
    ["top", "--once"], ["stop"], ["reset"], ["set", "controller.gain=1"], ["lock", "none"],
    ["fault"], ["save", "x.yaml", "--force"],
    ["scope", "*", "--trigger", "time.t_s > 1e9", "--within", "9ms", "--force", "-o", "b.mcap"],
]  # fmt: skip
ASKING = {"tune": COMMANDS[4:7:2], "lock": [COMMANDS[7]], "rows": [COMMANDS[3], COMMANDS[-1]]}


class Odd:
    """A host with one node that does nothing; `odd` changes its answers."""

    def __init__(self) -> None:
        rig = load_rig(find("probe"), None)
        made = plan(rig, "executive", "real")
        facts = dict.fromkeys(("bus", "controller", "rate_hz"), "b")
        facts |= dict.fromkeys(("clock_wall_ns", "clock_monotonic_ns"), "1")
        about = describe(made, facts | {"pacing": "real"})
        self.about = sh.full_description("probe.b.executive", json.loads(json.dumps(about)))
        self.block = sh.private(about)
        control = self.block.control
        control.ready, control.passes, control.cycle, control.state = 1, 9, 9, 2
        self.odd: Callable[[str, Any], Any] = lambda what, found: found

    def serve(self, line: ServerConnection) -> None:
        try:
            line.recv(timeout=ANSWER_S)
            while True:
                asked = json.loads(line.recv(timeout=ANSWER_S))
                found = self.odd(asked["do"], self.answer(asked))
                line.send(found if isinstance(found, bytes) else json.dumps(found))
        except ConnectionClosed:
            pass

    def answer(self, asked: dict[str, Any]) -> Any:
        number, what = asked["id"], asked["do"]
        if what == "nodes":
            return {"done": number, "version": fields.VERSION, "nodes": ["probe@1"]}
        if what == "describe":
            return {"done": number, "about": copy.deepcopy(self.about)}
        if what == "look":
            arrays = [np.ascontiguousarray(self.block[name]) for name in asked["fields"]]
            head = struct.pack("<4q", number, 1, 0, 0)
            return b"".join([head, *(one.tobytes() for one in arrays)])
        if what == "rows":
            return struct.pack("<4q", number, 0, 0, 0)
        return {"done": number, "cycle": 12}


@pytest.fixture(scope="module")
def node() -> Odd:
    return Odd()


@contextmanager
def at(node: Odd) -> Iterator[str]:
    with serve(node.serve, "127.0.0.1", 0) as server:
        serving = threading.Thread(target=server.serve_forever)
        serving.start()
        yield f"127.0.0.1:{server.socket.getsockname()[1]}"
        server.shutdown()
        serving.join()


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PCPC_TOKEN", "t" * 32)
    monkeypatch.chdir(tmp_path)


def tried(capsys: Screen, place: str, words: list[str]) -> tuple[int, str]:
    """Return exit code and words of a command; it raises nothing, and no terminal obeys it."""
    code = main([*words, "--at", place])
    shown = capsys.readouterr()
    text = shown.out + shown.err
    assert "Traceback" not in text
    assert not [c for c in text if (ord(c) < 32 and c not in "\n\t") or 127 <= ord(c) < 160], text
    return code, text


def test_the_host_of_this_test_answers_as_others_do(node: Odd, capsys: Screen) -> None:
    node.odd = lambda what, found: found
    with at(node) as place:
        for words in COMMANDS[:4]:
            code, text = tried(capsys, place, words)
            assert code == 0, (words, text)


def places_of(about: Any, depth: int = 2) -> Iterator[tuple[Any, ...]]:
    """Yield where something stands in what a node says about itself."""
    items = about.items() if isinstance(about, dict) else enumerate(about[:2])
    for key, value in items:
        yield (key,)
        if (
            depth
            and isinstance(value, dict | list)
            and value
            and key not in ("attachments", "files")
        ):
            more = dict(list(value.items())[:2]) if isinstance(value, dict) else value
            yield from ((key, *rest) for rest in places_of(more, depth - 1))


def put(about: Any, place: tuple[Any, ...], value: Any) -> Any:
    changed = copy.deepcopy(about)
    inner = changed
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    return changed


def test_whatever_a_node_says_about_itself_is_shown_or_refused(node: Odd, capsys: Screen) -> None:
    codes = set()
    with at(node) as place:
        for number, where in enumerate(places_of(node.about)):
            for value in ODD[number % 9 :: 9]:
                about = put(node.about, where, value)
                node.odd = lambda what, found, about=about: (
                    found | {"about": about} if what == "describe" else found
                )
                words = COMMANDS[(number + len(repr(value))) % len(COMMANDS)]
                codes.add(tried(capsys, place, words)[0])
    assert 4 in codes and codes <= {0, 1, 2, 3, 4}, codes


@pytest.mark.parametrize("key", ["variables", "period_ns", "state_names", "metadata", "node"])
def test_a_key_that_is_missing_is_told(key: str, node: Odd, capsys: Screen) -> None:
    about = {name: value for name, value in node.about.items() if name != key}
    node.odd = lambda what, found: found | {"about": about} if what == "describe" else found
    with at(node) as place:
        for words in COMMANDS:
            code, text = tried(capsys, place, words)
            assert (code, text.count("\n")) == (4, 1) and "does not answer as" in text, text


def test_whatever_is_published_is_shown_or_refused(node: Odd, capsys: Screen) -> None:
    random = np.random.default_rng(7)
    with at(node) as place:
        for turn in range(44):

            def odd(what: str, found: Any, turn: int = turn) -> Any:
                if not isinstance(found, bytes):
                    return found
                if turn % 4 == 0:
                    return found[: int(random.integers(0, len(found)))]
                if turn % 4 == 1:
                    return found + random.bytes(int(random.integers(1, 64)))
                body = np.frombuffer(found, np.uint8).copy()
                where = random.integers(0, len(body), 1 if turn % 4 == 2 else len(body) // 2)
                body[where] = random.integers(0, 256, len(where))
                return body.tobytes()

            node.odd = odd
            code, text = tried(capsys, place, COMMANDS[turn % len(COMMANDS)])
            assert code in (0, 1, 2, 3, 4), text


@pytest.mark.parametrize("what", ["nodes", "describe", "look", "rows", "tune", "lock"])
def test_whatever_is_answered_is_a_line(what: str, node: Odd, capsys: Screen) -> None:
    with at(node) as place:
        for value in [
            *ODD,
            b"",
            b"x" * 31,
            {"refused": 1, "why": EVIL, "code": 4},
            {"nodes": ["a"] * 3, "version": fields.VERSION},
            {"nodes": {}, "version": fields.VERSION},
            {"about": 1},
            {"cycle": "x"},
        ]:
            node.odd = lambda asked, found, value=value: value if asked == what else found
            for words in ASKING.get(what, COMMANDS[:3]):
                code, text = tried(capsys, place, words)
                assert code in (0, 1, 2, 4), (value, text)


def test_a_terminal_obeys_nothing_of_a_host(node: Odd, capsys: Screen) -> None:
    about = json.loads(
        json.dumps(node.about).replace('"controller.gain"', json.dumps(f"gain{EVIL}"))
    )
    node.odd = lambda what, found: found | {"about": about} if what == "describe" else found
    with at(node) as place:
        code, text = tried(capsys, place, ["list", "gain*"])
    assert code == 0 and r"gain\x1b]0;evil\x07\x1b[2J\x9b31m\u202e" in text, text
