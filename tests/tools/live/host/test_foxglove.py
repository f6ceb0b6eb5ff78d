"""Foxglove and Lichtblick on a run: what is sent is the log's, what is set stands in it."""

import json
import re
import socket
import struct
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest
from foxglove_client import ANSWER_S, Client, serving
from hosting import LONG
from mcap.reader import make_reader
from places import PATIENCE_S
from processes import own_bus
from websockets.exceptions import ConnectionClosed, InvalidStatus

import pcpc
from pcpc.tools.cli import main
from pcpc.tools.live.host.foxglove.thinning import RATE_HZ

GAIN, GAP, TOKEN = "controller.kv_Nms_rad", "plant:barrel.gap_rad", "write.token"
ALL = {
    f"{node}/{topic}"
    for node in ("", "/plant")
    for topic in ("state", "timing", "can/frames", "events", "tunings")
}
CLOSE = "https://attacker.example"


def test_what_is_sent_is_what_the_log_holds(tmp_path: Path) -> None:
    with pcpc.running("slew10", pacing="real", set=LONG, bus=own_bus()) as live:
        node = live._nodes["plant"].name
        with serving(tmp_path, "--node", node) as server, Client(server) as client:
            client.know(ALL | {"/log"})
            client.subscribe(*ALL, "/log")
            client.gather(lambda found: len(found.get("/state", ())) >= 10)  # subscribed to all
            live.set({GAIN: 111.0})
            sent = client.gather(
                lambda found: len(found.get("/plant/state", ())) > 150 and "/log" in found
            )
            known = {one["topic"]: one for one in client.channels.values()}
        live.stop()
        run = live.wait(within_s=PATIENCE_S)
    assert_same(run.path, sent, known)
    for topic in ("/state", "/plant/state", "/timing", "/can/frames", "/plant/can/frames"):
        times = [time_ns for time_ns, _ in sent[topic]]
        assert times == sorted(set(times)), topic
        most = 1 + RATE_HZ * 1e-9 * (times[-1] - times[0]) + 1
        assert 100 < len(times) <= most, f"{topic}: {len(times)}, at most {most}"
    frames = sent["/can/frames"]
    often = kinds_in(run.path, frames[0][0], frames[-1][0])
    assert often <= {kind_of(payload) for _, payload in frames}, "a kind of frame is never shown"
    assert known["/log"]["schemaName"] == "foxglove.Log"
    said = b"".join(payload for _, payload in sent["/log"])
    assert re.search(rb"controller\.kv_Nms_rad = 111 N m s/rad from cycle \d+", said), said


def test_without_a_clock_messages_have_the_times_of_the_log(tmp_path: Path) -> None:
    with pcpc.running("slew10", pacing="lockstep", set=LONG, bus=own_bus()) as live:
        with (
            serving(tmp_path, "--node", live._nodes["plant"].name) as server,
            Client(server) as client,
        ):
            client.know(ALL)
            client.subscribe("/plant/state", "/state", "/can/frames")
            sent = client.gather(lambda found: len(found.get("/can/frames", ())) >= 5)
            known = {one["topic"]: one for one in client.channels.values()}
        live.stop()
        run = live.wait(within_s=PATIENCE_S)
    assert_same(run.path, sent, known)


def assert_same(path: Path, sent: dict, known: dict) -> None:  # type: ignore[type-arg]
    """Compare schemas, and each message with the one of the log at its time."""
    times = [time_ns for messages in sent.values() for time_ns, _ in messages]
    with path.open("rb") as file:
        reader, logged = make_reader(file), dict[tuple[str, int], set[bytes]]()
        summary = reader.get_summary()
        assert summary is not None
        of_log = [one for one in summary.channels.values() if not is_keyframes(one.topic)]
        for channel in of_log:
            schema, told = summary.schemas[channel.schema_id], known[channel.topic]
            assert (told["encoding"], told["schemaName"], told["schemaEncoding"]) == (
                channel.message_encoding,
                schema.name,
                schema.encoding,
            )
            assert told["schema"] == schema.data.decode()
        every = reader.iter_messages(
            [*sent], starting_at=min(times), ending_at=max(times), log_time_order=False
        )
        for _, channel, message in every:
            logged.setdefault((channel.topic, message.log_time), set()).add(message.data)
    assert {one.topic for one in of_log} == ALL
    for topic, messages in sent.items():
        for time_ns, payload in messages if topic != "/log" else ():
            assert payload in logged[topic, time_ns], f"{topic} at {time_ns} is not in the log"


def is_keyframes(topic: str) -> bool:
    """Return whether a topic is that of keyframes, which only logs have."""
    return topic.endswith("/keyframes")


def kind_of(payload: bytes) -> tuple[int, int]:
    """Return id and direction of a frame."""
    number, direction = struct.unpack_from("<IxB", payload, 20)
    return number, direction


def kinds_in(path: Path, first_ns: int, last_ns: int) -> set[tuple[int, int]]:
    """Return the kinds of frames that came at least 20 times in that time."""
    with path.open("rb") as file:
        found = make_reader(file).iter_messages(
            ["/can/frames"], starting_at=first_ns, ending_at=last_ns
        )
        counts = Counter(kind_of(message.data) for _, _, message in found)
    return {kind for kind, count in counts.items() if count >= 20}


def test_a_parameter_is_set_with_the_token_and_stands_in_the_log(tmp_path: Path) -> None:
    with pcpc.running("slew10", pacing="real", set=LONG, bus=own_bus()) as live:
        node = live._nodes["plant"].name
        with (
            serving(tmp_path, "--write", "--node", node) as server,
            Client(server) as client,
            Client(server) as other,
        ):
            client.know(ALL)
            every = client.get()
            assert every[GAIN] == 110.0 and every[GAP] > 0.0 and every[TOKEN] == ""
            assert refused(client, {GAIN: 111.0}) == (
                f"set {TOKEN} to the token that `pcpc host` printed, then tune"
            )
            assert "not the token" in refused(client, {TOKEN: server.token[:-1], GAIN: 111.0})
            assert client.set({TOKEN: server.token}) == {TOKEN: ""}
            assert "may tune" in client.status()
            other.say(op="subscribeParameterUpdates", parameterNames=[GAIN, TOKEN])
            assert client.set({GAIN: 111.0, "controller.lam_per_s": 11.0}) == {
                GAIN: 111.0,
                "controller.lam_per_s": 11.0,
            }
            told = client.status()
            assert live[GAIN] == 111.0
            seen = other.until(lambda said: said["op"] == "parameterValues")
            assert seen["parameters"][0]["name"] == GAIN
            assert seen["parameters"][0]["value"] == 111.0
            refusals = {
                "0..1000": {GAIN: 1e9}, "expected a number": {GAIN: "much"},
                "no such variable": {"controller.kv": 1.0}, "only parameters": {"time.t_s": 1.0},
                "one node's at a time": {GAIN: 112.0, GAP: 0.001}, "a number; ": {GAIN: True},
                "no such parameter": {"x" * 5000: 1.0},
                "more than 64": {f"x{i}": 1.0 for i in range(70)},
            }  # fmt: skip
            for why, values in refusals.items():
                assert why in refused(client, values)
            assert "then tune" in refused(other, {GAIN: 112.0}), "a right is of one connection"
            assert live[GAIN] == 111.0 and client.get(GAIN) == {GAIN: 111.0}
            assert client.set({GAP: 0.002}) == {GAP: 0.002}
            live.set({GAIN: 113.0})  # by somebody else
            other.until(lambda said: (GAIN, 113.0) in parameters(said))
            assert server.token not in "".join(client.heard + other.heard)
        live.stop()
        run = live.wait(within_s=PATIENCE_S)
    found = re.fullmatch(
        rf"{re.escape(GAIN)} = 111 .*, controller.lam_per_s = 11 .* from cycle (\d+)", told
    )
    assert found, told
    tuned = [(e["name"], e["value"]) for e in run.events if e["cycle"] == int(found[1])]
    assert tuned == [(GAIN, 111.0), ("controller.lam_per_s", 11.0)], run.events


def refused(client: Client, values: dict[str, object]) -> str:
    """Ask for values; return why that is refused."""
    client.set(values)
    return client.status()


def parameters(said: dict) -> list[tuple[str, float]]:  # type: ignore[type-arg]
    return [(one["name"], one["value"]) for one in said.get("parameters", ())]


def test_a_page_of_another_site_reads_but_sets_nothing_and_the_next_run_is_found(
    tmp_path: Path,
) -> None:
    """What docs/howto/foxglove.md says of it: the SDK judges no Origin."""
    bus = own_bus()
    with pcpc.running("slew10", pacing="real", set=LONG, bus=bus) as live:
        node = live._nodes["plant"].name
        with serving(tmp_path, "--node", node) as server:
            with Client(server, origin=CLOSE) as foreign:
                foreign.know(ALL)
                foreign.subscribe("/state")
                foreign.gather(lambda found: len(found.get("/state", ())) >= 5)
                assert foreign.get(GAIN) == {GAIN: 110.0}
                assert TOKEN not in foreign.get()
                for values in ({GAIN: 1.0}, {TOKEN: "x"}):
                    assert "read-only" in refused(foreign, values)
                assert live[GAIN] == 110.0
            with Client(server) as client:
                client.know(ALL)
                before = client.info["sessionId"]
                first = {i for i, one in client.channels.items() if one["topic"] in ALL}
                live.stop()
                live.wait(within_s=PATIENCE_S)
                with pcpc.running("slew10", pacing="real", set=LONG, bus=bus) as again:
                    assert again._nodes["plant"].name == node
                    told = client.until(lambda said: said["op"] == "serverInfo")
                    assert told["sessionId"] != before
                    while first & set(client.channels):
                        client.next()
                    client.know(ALL)
                    client.subscribe("/plant/state")
                    client.gather(lambda found: len(found.get("/plant/state", ())) >= 5)


def test_nonsense_and_floods_end_nothing(tmp_path: Path) -> None:
    """What a client says that speaks otherwise than it should; another one notices nothing."""
    with pcpc.running("slew10", pacing="real", set=LONG, bus=own_bus()) as live:
        node = live._nodes["plant"].name
        with serving(tmp_path, "--write", "--node", node) as server, Client(server) as client:
            client.know(ALL)
            client.subscribe("/state")
            for wrong in NONSENSE:
                with Client(server) as other, suppress(ConnectionClosed):
                    other.socket.send(wrong)
                    other.socket.ping().wait(ANSWER_S)
                client.gather(lambda found: "/state" in found)
                assert client.get(GAIN) == {GAIN: 110.0}, wrong[:200]
            assert live[GAIN] == 110.0
            with Client(server) as other:
                answers = [other.get(GAIN) for _ in range(400)]
                assert answers[0] == {GAIN: 110.0} and {} in answers, "nobody counts"
                assert client.get(GAIN) == {GAIN: 110.0}
            for protocols in (None, ["foxglove.websocket.v1"]):
                with pytest.raises(InvalidStatus, match="400"):
                    Client(server, subprotocols=protocols)
        live.stop()


def _saying(**message: object) -> str:
    return json.dumps(message)


NONSENSE: list[str | bytes] = [
    "", "{", "[]", "null", "1e999", '"' + "x" * 100_000, "[" * 100_000, b"", b"\xff" * 9,
    b"\x01" + b"\xff" * 64, b"\x01", b"\x02\x00", b"x" * (20 << 20),
    _saying(op="none"), _saying(op=["subscribe"]), _saying(op="subscribe"),
    _saying(op="subscribe", subscriptions=[{"id": 1, "channelId": 10**9}]),
    _saying(op="subscribe", subscriptions=[{"id": -1, "channelId": -1}]),
    _saying(op="subscribe", subscriptions=[{"id": 1, "channelId": 2}] * 9),
    _saying(op="unsubscribe", subscriptionIds=[77]),
    _saying(op="advertise", channels=[{"id": 1, "topic": "/state", "encoding": "json"}]),
    _saying(op="getParameters", parameterNames="all"),
    _saying(op="getParameters", parameterNames=["x" * 1000] * 1000, id="a"),
    _saying(op="setParameters", parameters=[{"name": GAIN}], id="a"),
    _saying(op="setParameters", parameters=[{"name": GAIN, "value": None}], id="a"),
    _saying(op="setParameters", parameters=[{"name": GAIN, "value": {"a": [1, {}]}}]),
    _saying(op="setParameters", parameters=[{"name": GAIN, "value": "!", "type": "byte_array"}]),
    _saying(op="setParameters", parameters=[{"name": "write.token", "value": 7}], id="a"),
    _saying(op="setParameters", parameters=[{"name": "write.token", "value": "\ud800\u0000"}]),
    _saying(op="setParameters", parameters=[{"name": "\x1b[2J", "value": 1.0}], id="a"),
    _saying(op="callService", serviceId=1, callId=1, encoding="json"),
    _saying(op="fetchAsset", uri="file:///etc/passwd", requestId=1),
    _saying(op="playbackControlRequest", playbackCommand=0, playbackSpeed=1e308, requestId="a"),
    _saying(op="subscribeConnectionGraph"),
]  # fmt: skip


def test_a_port_in_use_is_named_with_the_cure(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main(["host", "--foxglove", str(taken.getsockname()[1])]) == 4
        assert "choose another --foxglove PORT" in capsys.readouterr().err
