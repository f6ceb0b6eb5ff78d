"""What a host refuses a client to say: with a word, without a change, going on for all others."""

import json
import os
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hosting import ANSWER_S, LONG, Client, Host, hosting
from processes import own_bus
from websockets.exceptions import ConnectionClosed

import pcpc

GAIN = "controller.kv_Nms_rad"


@pytest.fixture(scope="module")
def run() -> Iterator[pcpc.Live]:
    with pcpc.running("slew10", pacing="real", set=LONG, bus=own_bus()) as live:
        yield live
    tuned = [one for one in live.run.events if one.get("name") == GAIN]
    assert tuned == [], "an attack has tuned the run"


def node(run: pcpc.Live) -> str:
    """Return the full name of a node of the run."""
    return run._nodes["plant"].name


@pytest.fixture(scope="module")
def host(run: pcpc.Live, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Host]:
    with hosting(tmp_path_factory.mktemp("token"), "--write", "--node", node(run)) as one:
        yield one


def first_word(word: str | bytes) -> Callable[[Host], int]:
    """Return what a client with this first word comes to: why it was closed."""

    def tried(host: Host) -> int:
        with host.connect() as line:
            line.send(word)
            with pytest.raises(ConnectionClosed):
                line.recv(timeout=ANSWER_S)
            return line.close_code or 0

    return tried


def read_to_its_end(line: Any) -> None:
    """Take all that comes, for a while: what shows a run goes on and on."""
    end_s = time.monotonic() + ANSWER_S
    while time.monotonic() < end_s:
        line.recv(timeout=ANSWER_S)


def then(*words: str | bytes) -> Callable[[Host], int]:
    """Return what a client with the token and these words comes to."""

    def tried(host: Host) -> int:
        with host.connect() as line:
            line.send(json.dumps({"do": "hello", "token": host.token}))
            with pytest.raises(ConnectionClosed):
                for word in words:
                    line.send(word)
                read_to_its_end(line)
            return line.close_code or 0

    return tried


def raw(*frames: bytes) -> Callable[[Host], int]:
    """Return what a client with these bytes on the line comes to; 1 where it was cut at once."""

    def tried(host: Host) -> int:
        with host.connect() as line:
            line.send(json.dumps({"do": "hello", "token": host.token}))
            line.recv(timeout=ANSWER_S)
            with pytest.raises((ConnectionClosed, OSError)):
                for frame in frames:
                    line.socket.sendall(frame)
                read_to_its_end(line)
            return line.close_code or 1

    return tried


def frame(first: int, body: bytes, masked: bool = True) -> bytes:
    """Return a frame of the protocol whose first byte is `first`."""
    mask = os.urandom(4) if masked else b""
    sealed = bytes(x ^ mask[i % 4] for i, x in enumerate(body)) if masked else body
    return (
        bytes([first, (0x80 if masked else 0) | 127]) + struct.pack(">Q", len(body)) + mask + sealed
    )


def bomb() -> bytes:
    """Return 64 MB of blanks as permessage-deflate sends them."""
    squeezed = zlib.compressobj(9, wbits=-15)
    return squeezed.compress(b" " * (64 << 20)) + squeezed.flush(zlib.Z_SYNC_FLUSH)


SET = {"do": "set", "id": 1, "values": {GAIN: 500.0}}
TOKEN, MESSAGE, FLOOD, PROTOCOL, BIG = 4401, 4400, 4429, 1002, 1009
SAID: dict[str, tuple[Callable[[Host], int], tuple[int, ...]]] = {
    "no token": (first_word(json.dumps(SET)), (TOKEN,)),
    "a wrong token": (first_word('{"do": "hello", "token": "x"}'), (TOKEN,)),
    "an empty token": (first_word('{"do": "hello", "token": ""}'), (TOKEN,)),
    "a token that is no text": (first_word('{"do": "hello", "token": null}'), (TOKEN,)),
    "a token of many letters": (
        first_word(json.dumps({"do": "hello", "token": "x" * 60000})), (TOKEN,)),
    "a token that is no ASCII": (first_word('{"do": "hello", "token": "\u00e4"}'), (TOKEN,)),
    "nonsense": (first_word("hello?"), (TOKEN,)),
    "bytes": (first_word(b"\x00\xff"), (TOKEN,)),
    "no message": (then("nonsense"), (MESSAGE,)),
    "an unknown word": (then('{"do": "shutdown"}'), (MESSAGE,)),
    "an unknown key": (then(json.dumps({**SET, "shell": "x"})), (MESSAGE,)),
    "a value that is no number": (then('{"do": "set", "id": 1, "values": {"a": "1"}}'), (MESSAGE,)),
    "NaN": (then('{"do": "set", "id": 1, "values": {"a": NaN}}'), (MESSAGE,)),
    "infinity": (then('{"do": "set", "id": 1, "values": {"a": Infinity}}'), (MESSAGE,)),
    "nested without end": (then("[" * 30000), (MESSAGE,)),
    "a number of many digits": (then('{"do": "drop", "id": ' + "9" * 30000 + "}"), (MESSAGE,)),
    "a negative id": (then('{"do": "drop", "id": -1}'), (MESSAGE,)),
    "a thousand curves": (
        then(json.dumps({"do": "panel", "id": 1, "names": ["a"] * 1000, "bins": 9})), (MESSAGE,)),
    "a million bins": (
        then(json.dumps({"do": "panel", "id": 1, "names": ["a"], "bins": 10**6})), (MESSAGE,)),
    "a window of a year": (
        then(json.dumps({"do": "panel", "id": 1, "names": [], "bins": 9, "window_s": 3e7})),
        (MESSAGE,)),
    "a recording with a name": (
        then('{"do": "record", "id": 1, "file": "/etc/passwd"}'), (MESSAGE,)),
    "a snapshot with a name": (
        then('{"do": "snapshot", "id": 1, "name": "../../a.mcap"}'), (MESSAGE,)),
    "a snapshot of a year": (then('{"do": "snapshot", "id": 1, "last_s": 3e7}'), (MESSAGE,)),
    "a snapshot of nothing": (then('{"do": "snapshot", "id": 1, "last_s": 0}'), (MESSAGE,)),
    "a recording that ends in words": (then('{"do": "record", "id": 1, "end": "x"}'), (MESSAGE,)),
    "a message of a megabyte": (then("x" * (1 << 20)), (BIG, 1006)),
    "a flood": (then(*['{"do": "drop", "id": 1}'] * 3000), (FLOOD, 1006)),
    "a choice of no text": (then('{"do": "run", "id": 1, "run": 7}'), (MESSAGE,)),
    "a run of many letters": (
        then(json.dumps({"do": "run", "id": 1, "run": "x" * 301})), (MESSAGE,)),
    "a first word with another run": (
        first_word('{"do": "hello", "token": "x", "run": "hull.vcan0"}'), (TOKEN,)),
    "another kind of client": (
        first_word('{"do": "hello", "token": "x", "kind": "root"}'), (TOKEN,)),
    "a question of a terminal": (then('{"do": "nodes", "id": 1}'), (MESSAGE,)),
    "a compressed bomb": (
        lambda host: raw(frame(0xC1, bomb()))(host), (PROTOCOL, BIG, 1, 1006)),
    "a frame that says it is huge": (
        raw(bytes([0x81, 0xFF]) + struct.pack(">Q", 1 << 40) + b"mask"), (BIG, PROTOCOL, 1, 1006)),
    "a message in endless parts": (
        raw(frame(0x01, b" " * 60000), *[frame(0x00, b" " * 60000)] * 20),
        (BIG, PROTOCOL, 1, 1006)),
    "a frame without a mask": (raw(frame(0x81, b"{}", masked=False)), (PROTOCOL, 1, 1006)),
    "a reserved kind": (raw(frame(0x8F, b"")), (PROTOCOL, 1, 1006)),
    "text that is no text": (raw(frame(0x81, b"\xff\xfe")), (1007, MESSAGE, 1, 1006)),
}  # fmt: skip


@pytest.mark.parametrize("attack", SAID.values(), ids=SAID)
def test_a_client_is_cut_off(
    host: Host, attack: tuple[Callable[[Host], int], tuple[int, ...]]
) -> None:
    tried, codes = attack
    assert tried(host) in codes
    with Client(host) as other:  # all others are served as before
        assert other.about["rig"] == "slew10"


def test_a_client_that_says_nothing_is_let_go(host: Host) -> None:
    with host.connect() as line, pytest.raises(ConnectionClosed):
        line.recv(timeout=ANSWER_S)
    assert line.close_code == TOKEN


REFUSED = {
    "out of range": ({"do": "set", "values": {GAIN: 1e9}}, "outside 0..1000"),
    "another name": ({"do": "set", "values": {"controller.kv": 1.0}}, "did you mean"),
    "no parameter": ({"do": "set", "values": {"controller.e_rad": 1.0}}, "only parameters"),
    "of a node that is not there": ({"do": "set", "values": {"local:a": 1.0}}, "no such variable"),
    "of two nodes": (
        {"do": "set", "values": {GAIN: 1.0, "plant:barrel.gap_rad": 0.001}}, "two nodes"),
    "one of several": (
        {"do": "set", "values": {GAIN: 1.0, "controller.lam_per_s": -1e9}}, "outside"),
    "a fault that is not there": ({"do": "fault", "name": "fire"}, "no such fault"),
    "an action that is not there": ({"do": "act", "what": "format"}, "no such action"),
    "a curve of nothing": ({"do": "panel", "names": ["a"], "bins": 9}, "no such variable"),
    "markup": ({"do": "panel", "names": ["<img src=x onerror=alert(1)>"], "bins": 9}, "no such"),
    "nothing to undo": ({"do": "undo"}, "nothing was tuned"),
    "an end of no recording": ({"do": "record", "end": True}, "nothing is being recorded"),
    "no fault to reset": ({"do": "act", "what": "reset"}, "no node is in FAULT"),
}  # fmt: skip


@pytest.mark.parametrize("asked", REFUSED.values(), ids=REFUSED)
def test_a_wrong_wish_is_refused_with_a_word(
    host: Host, run: pcpc.Live, asked: tuple[dict[str, object], str]
) -> None:
    before = run[GAIN]
    with Client(host) as client:
        told = client.ask(**asked[0])
        assert asked[1] in told["why"]
    assert run[GAIN] == before


def test_invented_runs_show_nothing_and_hold_nobody(host: Host, run: pcpc.Live) -> None:
    with Client(host) as client:
        for i in range(100):
            assert client.ask(do="run", run=f"../{i}.<img>")["done"]
        assert "choose one" in client.ask(do="set", values={GAIN: 1.0})["why"]
        client.ask(do="run", run=node(run).rpartition(".")[0])
        while not client.about["nodes"]:
            client.about = client.until("about")["about"]
        assert client.about["rig"] == "slew10"


def test_a_host_without_write_only_shows(run: pcpc.Live, tmp_path: Path) -> None:
    folder = tmp_path / "rec"
    words = ("--node", node(run), "--recordings", str(folder))
    with hosting(tmp_path, *words) as host, Client(host) as client:
        assert client.about["write"] is False
        for wish in (
            SET,
            {"do": "undo"},
            {"do": "act", "what": "stop"},
            {"do": "fault", "name": "a"},
            {"do": "record"},
            {"do": "record", "end": True},
            {"do": "snapshot"},
        ):
            told = client.ask(**{k: v for k, v in wish.items() if k != "id"})
            assert "--write" in told["why"]
    assert not folder.exists()
    assert run.running and oct((tmp_path / "pcpc/host-token").stat().st_mode)[-3:] == "600"
