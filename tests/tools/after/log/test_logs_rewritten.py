"""Logs that another tool wrote anew: what it lost or doubled is said, and no command ends well."""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from logcommand import PLANT, Done, run, run_here
from mcap.reader import make_reader
from mcap.writer import Writer

from pcpc.executive.log import reader as logs
from pcpc.executive.log.mcap_records import FOOTER, MAGIC, RECORD
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.lyapunov import Account

CYCLES = 300
CHUNK = 6
DATA_END = 15


@dataclass
class Content:
    """What a tool takes out of a log: (topic, message), metadata, attachments."""

    schemas: dict[str, Any] = field(default_factory=dict)
    encodings: dict[str, str] = field(default_factory=dict)
    messages: list[tuple[str, Any]] = field(default_factory=list)
    metadata: list[Any] = field(default_factory=list)
    attachments: list[Any] = field(default_factory=list)


def content(path: Path) -> Content:
    """Read a log with mcap's own reader."""
    found = Content()
    with path.open("rb") as file:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            found.schemas[channel.topic] = schema
            found.encodings[channel.topic] = channel.message_encoding
            found.messages.append((channel.topic, message))
        found.metadata = list(reader.iter_metadata())
        found.attachments = list(reader.iter_attachments())
    return found


def written(given: Content, out: Path) -> Path:
    """Write a log with mcap's own writer, with statistics, index and summary of its own."""
    with out.open("wb") as file:
        writer = Writer(file, chunk_size=64 << 10)
        writer.start("ros2", "another tool")
        for text in given.metadata:
            writer.add_metadata(text.name, text.metadata)
        for one in given.attachments:
            writer.add_attachment(0, 0, one.name, one.media_type, one.data)
        channels: dict[str, int] = {}
        for topic, message in given.messages:
            if topic not in channels:
                own = given.schemas[topic]
                number = writer.register_schema(own.name, own.encoding, own.data)
                channels[topic] = writer.register_channel(topic, given.encodings[topic], number)
            at = channels[topic], message.log_time, message.data, message.log_time
            writer.add_message(*at, message.sequence)
        writer.finish()
    return out


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a run of 300 cycles with a tuning and a fault on purpose."""
    path = tmp_path_factory.mktemp("whole") / "log.mcap"
    settings = ["duration_s=0.3", "schedule=[{at_s: 0.1, set: {controller.kv_Nms_rad: 111.0}}]"]
    simulate(load_rig(PLANT / "rigs" / "slew10.yaml", "pd_nn", settings), path)
    return path


def thinned(keep: Callable[[int, str, Any], bool]) -> Callable[[Content], None]:
    def change(given: Content) -> None:
        some = enumerate(given.messages)
        given.messages = [(topic, one) for i, (topic, one) in some if keep(i, topic, one)]

    return change


def doubled(which: Callable[[str, Any], bool]) -> Callable[[Content], None]:
    def change(given: Content) -> None:
        given.messages = [pair for pair in given.messages for _ in range(2 if which(*pair) else 1)]

    return change


def turned(given: Content) -> None:
    """Put the second half ahead of the first."""
    half = len(given.messages) // 2
    given.messages = given.messages[half:] + given.messages[:half]


def again(given: Content) -> None:
    """Append the middle of the run once more."""
    given.messages += [pair for pair in given.messages if 100 <= pair[1].sequence < 200]


def without_metadata(*names: str) -> Callable[[Content], None]:
    def change(given: Content) -> None:
        given.metadata = [one for one in given.metadata if one.name not in names]

    return change


CHANGES: dict[str, tuple[Callable[[Content], None], str]] = {
    "the tail is cut": (thinned(lambda i, t, m: m.sequence < 100), "/state: 200 of 300 messages"),
    "the last cycle is cut": (
        thinned(lambda i, t, m: m.sequence < 299 or "state" not in t), "/state: 1 of 300 messages",
    ),
    "the middle is cut": (
        thinned(lambda i, t, m: not 100 <= m.sequence < 200), "/timing: 100 of 300 messages",
    ),
    "the begin is cut": (thinned(lambda i, t, m: m.sequence > 50), "/plant/state: 51 of 301"),
    "the states are dropped": (thinned(lambda i, t, m: t != "/state"), "/state: 300 of 300"),
    "the timing is dropped": (thinned(lambda i, t, m: t != "/timing"), "/timing: 300 of 300"),
    "the frames are dropped": (thinned(lambda i, t, m: t != "/can/frames"), "/can/frames: "),
    "a frame is dropped": (thinned(lambda i, t, m: t != "/plant/can/frames" or m.sequence != 77),
                           "/plant/can/frames: "),
    "the tuning is dropped": (thinned(lambda i, t, m: t != "/tunings"), "/events and /tunings: 1"),
    "the plant is dropped": (thinned(lambda i, t, m: "plant" not in t), "/plant/timing: 301 of"),
    "a cycle stands twice": (doubled(lambda t, m: t == "/state" and m.sequence == 9),
                             "twice, or behind later ones: 1 messages of /state"),
    "all stands twice": (doubled(lambda t, m: True), ": 301 messages of /plant/state"),
    "a frame stands twice": (doubled(lambda t, m: t == "/can/frames" and m.sequence == 9),
                             "/can/frames: "),
    "the tuning stands twice": (doubled(lambda t, m: t == "/tunings"), "/events and /tunings: "),
    "the parts changed places": (turned, "behind later ones"),
    "a part stands twice": (again, "twice, or behind later ones: 100 messages of /state"),
    "the counts are dropped": (without_metadata("run"), "the recorder's counts"),
    "all metadata are dropped": (lambda given: given.metadata.clear(), "the recorder's counts"),
}  # fmt: skip


@pytest.mark.parametrize("name", CHANGES)
def test_what_another_tool_lost_or_doubled_is_told_and_no_command_ends_well(
    name: str, log: Path, tmp_path: Path
) -> None:
    change, said = CHANGES[name]
    given = content(log)
    change(given)
    copy = written(given, tmp_path / "log.mcap")
    info = run("info", copy, "--json")
    assert info.code == 3, info
    missing = json.loads(info.out)["missing"]
    assert any(said in line for line in missing), missing
    read = logs.read(copy)
    assert read.missing == missing, "whoever reads it is told the same"
    for node in read.node.values():
        assert (node.cycle[1:] > node.cycle[:-1]).all(), "no row stands twice"
    replayed = run_here("replay", copy)
    assert replayed.code in (1, 2, 3) and "bit-identical (" not in replayed.out, replayed
    assert "DIFFERENT (" not in replayed.out, "the law is not to blame"


def commands(copy: Path, whole: Path, folder: Path) -> Iterable[Done]:
    yield run("export", copy, "-o", folder / "a.csv")
    yield run("plot", copy, "controller.e_rad", "-o", folder / "a.png")
    yield run("export", "-o-", copy)
    yield run_here("compare", "--bits", copy, copy)
    yield run_here("replay", copy)
    yield run_here("report", copy, "-o", folder / "a.html")
    yield run_here("compare", copy, copy)
    yield run_here("bounds", copy)
    yield run_here(
        "fit",
        PLANT / "rigs" / "slew10.yaml",
        copy,
        "-o",
        folder / "fit",
        "--parameter",
        "barrel.hub_inertia_kg_m2",
        "--quiet",
    )


def test_each_command_tells_that_the_tail_is_cut(log: Path, tmp_path: Path) -> None:
    given = content(log)
    CHANGES["the tail is cut"][0](given)
    copy = written(given, tmp_path / "log.mcap")
    for number, done in enumerate(commands(copy, log, tmp_path)):
        assert done.code in (1, 3), (number, done)
        assert "/state: 200 of 300 messages" in " ".join((done.out + done.err).split()), (
            number,
            done,
        )


def test_bounds_that_hold_in_a_log_with_a_cycle_twice_are_no_pass(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Account, "holds", True)
    given = content(log)
    CHANGES["a cycle stands twice"][0](given)
    done = run_here("bounds", written(given, tmp_path / "log.mcap"))
    assert done.code == 3 and "1 messages of" in done.err, done
    assert run_here("bounds", log).code == 0


def test_a_log_written_anew_without_a_change_is_whole(log: Path, tmp_path: Path) -> None:
    copy = written(content(log), tmp_path / "log.mcap")
    assert run("info", copy).code == 0, run("info", copy).out
    assert run_here("replay", copy).code == 0


def records(data: bytes) -> Iterable[tuple[int, bytes]]:
    """Yield opcode and bytes of the records up to DATA_END."""
    place = len(MAGIC)
    while place < len(data):
        opcode, length = RECORD.unpack_from(data, place)
        if opcode == DATA_END:
            return
        yield opcode, data[place : place + RECORD.size + length]
        place += RECORD.size + length


@pytest.mark.parametrize("number", [0, 1, -1])
def test_a_chunk_that_stands_twice_is_told_and_doubles_nothing(
    number: int, log: Path, tmp_path: Path
) -> None:
    parts = list(records(log.read_bytes()))
    chunks = [i for i, (opcode, _) in enumerate(parts) if opcode == CHUNK]
    at = chunks[min(number, len(chunks) - 1)]
    body = [part for i, (_, part) in enumerate(parts) for part in [part] * (1 + (i == at))]
    end = RECORD.pack(DATA_END, 4) + bytes(4) + FOOTER.pack(2, 20, 0, 0, 0, MAGIC)
    copy = tmp_path / "log.mcap"
    copy.write_bytes(MAGIC + b"".join(body) + end)
    whole, read = logs.read(log), logs.read(copy)
    for name, node in whole.node.items():
        assert (read.node[name].cycle == node.cycle).all()
        assert (read.node[name].frames == node.frames).all()
        assert read.node[name].tunings == node.tunings
    assert any("1 chunks" in line for line in read.missing), read.missing
    assert not any("is whole" in line for line in read.missing), read.missing
    assert run("info", copy).code == 3
    assert run_here("replay", copy).code == 3
