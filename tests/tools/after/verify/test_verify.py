"""`pcpc replay`: logs that can be trusted, and everything that is none of those."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from json_schemas import holds
from logcommand import Done, run_here
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from processes import ROOT

from pcpc.executive.log.mcap_records import CRC_KEY, metadata_crc
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.replayed import Verdict
from pcpc.tools.after.verify import cli, one
from pcpc.tools.after.verify.digest import _hashed_bytes, digest

CYCLES = 60
PROBE = ROOT / "plants/probe/rig.yaml"
EARLIER = ROOT / "tests/earlier_logs"
TUNED = "schedule=[{at_s: 0.02, set: {controller.gain: 5.0}}]"
Edit = Callable[[str, bytes], bytes | None]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a log of the probe with a tuning."""
    return made(tmp_path_factory.mktemp("verify"), TUNED)


def made(folder: Path, *settings: str, name: str = "log.mcap") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    simulate(load_rig(PROBE, None, [f"duration_s={CYCLES / 1000}", *settings]), path)
    return path


def verify(*words: str | Path) -> Done:
    return run_here("replay", "--brief", *words, "--jobs", "1", "--quiet")


def row(path: Path, *words: str) -> dict[str, Any]:
    """Return what `--json` says of one log; its exit code is that of its verdict."""
    done = verify(path, "--json", *words)
    (found,) = holds("replay --brief", done.out)["logs"]
    assert done.code == one.CODES[found["verdict"]], done
    return dict(found)


def rewritten(
    log: Path,
    out: Path,
    edit: Edit = lambda topic, data: data,
    size: int = 1 << 20,
    packed: CompressionType = CompressionType.NONE,
    texts: Edit = lambda name, data: data,
) -> Path:
    """Write a log anew: other chunks, other packing; with what `edit` makes of messages.

    `texts`: of metadata as JSON and of attachments. Of either None leaves it out.
    """
    with log.open("rb") as file, out.open("wb") as target:
        reader, writer = make_reader(file), Writer(target, chunk_size=size, compression=packed)
        writer.start("", "")
        known: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if channel.id not in known:
                kind = 0
                if schema is not None and schema.id:
                    kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                known[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, kind
                )
            if (data := edit(channel.topic, message.data)) is not None:
                writer.add_message(
                    known[channel.id],
                    message.log_time,
                    data,
                    message.publish_time,
                    message.sequence,
                )
        for text in reader.iter_metadata():
            plain = {key: value for key, value in text.metadata.items() if key != CRC_KEY}
            if (new := texts(text.name, json.dumps(plain).encode())) is not None:
                entries = json.loads(new)
                crc = metadata_crc(text.name, entries)
                writer.add_metadata(text.name, entries | {CRC_KEY: crc})
        for kept in reader.iter_attachments():
            if (new := texts(kept.name, kept.data)) is not None:
                writer.add_attachment(0, 0, kept.name, kept.media_type, new)
        writer.finish()
    return out


def nth(topic: str, number: int, change: Callable[[bytes], bytes | None]) -> Edit:
    """Return what changes the message of a topic that has this number."""
    seen = [0]

    def edit(own: str, data: bytes) -> bytes | None:
        seen[0] += own == topic
        return change(data) if own == topic and seen[0] == number + 1 else data

    return edit


def flipped(place: int, bit: int = 0) -> Callable[[bytes], bytes]:
    def change(data: bytes) -> bytes:
        return data[:place] + bytes([data[place] ^ (1 << bit)]) + data[place + 1 :]

    return change


# The verdict


def test_a_whole_log_is_identical(log: Path) -> None:
    found = row(log)
    assert (found["verdict"], found["cycles"], found["nodes"]) == (
        "identical",
        CYCLES,
        ["executive", "plant"],
    )
    assert found["digest"] == digest(log) and found["versions"]["pcpc"]
    assert found["first"] is None and found["why"] == []


def test_the_first_bit_that_differs_is_named_with_what_has_changed(
    log: Path, tmp_path: Path
) -> None:
    def old(name: str, data: bytes) -> bytes:
        return (
            data.replace(b'"version_pcpc": "', b'"version_pcpc": "9')
            if name in ("executive", "plant")
            else data
        )

    with log.open("rb") as file:
        ((schema, _, _), *_) = make_reader(file).iter_messages(topics=["/state"])
    assert schema is not None
    names = [line.split("# ")[1].split()[0] for line in schema.data.decode().splitlines() if line]
    place = 4 + 8 * names.index("controller.command")
    path = rewritten(log, tmp_path / "a.mcap", nth("/state", 7, flipped(place)), texts=old)
    found = row(path)
    assert found["verdict"] == "differs", found
    first = found["first"]
    assert (first["node"], first["name"], first["cycle"], first["ulp"]) == (
        "executive", "controller.command", 7, 1,
    )  # fmt: skip
    assert [text.partition(" ")[0] for text in found["changed"]] == ["pcpc"]
    done = verify(path)
    assert "1 ULP" in done.out and "changed since: pcpc 9" in done.out, done
    assert all(len(line) <= 80 for line in done.out.splitlines()), done


def test_the_node_that_differs_first_is_named(log: Path, tmp_path: Path) -> None:
    for early, late, node in (
        ("/state", "/plant/state", "executive"),
        ("/plant/state", "/state", "plant"),
    ):
        first, second = nth(early, 3, flipped(11)), nth(late, 30, flipped(11))

        def both(topic: str, data: bytes, first: Edit = first, second: Edit = second) -> Any:
            return second(topic, first(topic, data) or b"")

        found = row(rewritten(log, tmp_path / "a.mcap", both))
        assert (found["first"]["node"], found["first"]["cycle"]) == (node, 3), found


def test_a_flipped_frame_that_was_sent_differs(log: Path, tmp_path: Path) -> None:
    sent = nth("/plant/can/frames", 40, flipped(4 + 24))
    assert row(rewritten(log, tmp_path / "a.mcap", sent))["verdict"] in ("differs", "incomplete")


@pytest.mark.parametrize("name", ["probe-2be7d52.mcap", "motor-b919103.mcap"])
def test_logs_of_earlier_versions(name: str) -> None:
    found = row(EARLIER / name, "--trust")
    assert any(text.startswith("pcpc 0.1.0 -> ") for text in found["changed"]), found
    assert found["first"] is None, found


def test_code_in_a_log_is_run_only_when_it_is_trusted() -> None:
    found = row(EARLIER / "motor-b919103.mcap")
    assert found["verdict"] == "incomplete" and "--trust" in found["why"][0], found


def test_snapshots_cuts_and_damage_are_incomplete(log: Path, tmp_path: Path) -> None:
    ring = made(tmp_path / "ring", TUNED, "record.keep=10ms", "record.on=tuning")
    assert "not with the start" in str(row(ring)["why"])
    data = log.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) - 40])
    assert row(tmp_path / "cut.mcap")["verdict"] == "incomplete"


@pytest.mark.parametrize(("node", "left"), [("plant", "executive"), ("executive", "plant")])
def test_a_log_without_one_of_its_nodes_is_incomplete(
    node: str, left: str, log: Path, tmp_path: Path
) -> None:
    own = ("/state", "/timing", "/can/frames", "/events", "/tunings")
    topics = {f"/{node}{one}" if node == "plant" else one for one in own}

    def texts(name: str, data: bytes) -> bytes | None:
        if name in (node, f"{node}.json", *(f"variables:{one}" for one in topics)):
            return None
        if name == "run":
            kept = {k: v for k, v in json.loads(data).items() if f".{node}." not in k}
            return json.dumps(kept).encode()
        return data

    def edit(topic: str, data: bytes) -> bytes | None:
        return None if topic in topics else data

    path = rewritten(log, tmp_path / "a.mcap", edit, texts=texts)
    assert row(path)["why"] == [f"no record of the {node}"]
    assert row(path)["verdict"] == "incomplete"
    only = row(path, "--node", left)
    assert only["verdict"] == "identical" and only["left_out"] == [node], only
    assert node in str(row(path, "--node", node)["why"])


def described(change: Callable[[dict[str, Any]], None]) -> Edit:
    def texts(name: str, data: bytes) -> bytes:
        if name != "executive.json":
            return data
        about = json.loads(data)
        change(about)
        return json.dumps(about).encode()

    return texts


def test_what_a_log_does_not_let_be_recomputed_is_no_pass(log: Path, tmp_path: Path) -> None:
    """A description that takes a law's outputs from the record, or hides columns."""

    def outside(about: dict[str, Any]) -> None:
        about["external"] = ["controller"]

    def fewer(about: dict[str, Any]) -> None:
        about["state_columns"].remove("controller.command")

    for change, why in ((outside, "stepped from outside"), (fewer, "recorded, but not recomputed")):
        found = row(rewritten(log, tmp_path / "a.mcap", texts=described(change)))
        assert found["verdict"] == "incomplete" and why in str(found["why"]), found


def test_a_column_that_nobody_recorded_is_no_pass(log: Path, tmp_path: Path) -> None:
    """The recorded columns, their schema and their description lack one alike."""
    found = row(log)
    node: Any = SimpleNamespace(
        role="executive",
        both=["a"],
        verdict=Verdict("executive", 1000.0, cycles=1, variables=1),
        replay=SimpleNamespace(names=["a", "b", "c"]),
    )
    assert [*one._unjudged_causes(node, (), {"executive": {"a"}})] == [
        "recomputed, but not recorded: b and 1 more"
    ]
    node.verdict.cycles = 0
    node.replay.names = ["a"]
    assert [*one._unjudged_causes(node, (), {"executive": {"a"}})] == ["nothing was compared"]
    node.verdict.cycles, node.verdict.dropped = 1, 3
    assert "3 frames or events" in str([*one._unjudged_causes(node, (), {"executive": {"a"}})])
    assert found["verdict"] == "identical"


def test_a_tuning_of_no_parameter_is_no_pass(log: Path, tmp_path: Path) -> None:
    edit = nth("/tunings", 0, lambda data: data.replace(b"controller.gain", b"controller.nain"))
    found = row(rewritten(log, tmp_path / "a.mcap", edit))
    assert found["verdict"] == "differs" and "controller.nain" in str(found["why"]), found


def test_what_is_no_log_is_unreadable_and_the_others_are_verified(
    log: Path, tmp_path: Path
) -> None:
    runs = tmp_path / "runs"
    (runs / "folder.mcap").mkdir(parents=True)
    (runs / "empty.mcap").touch()
    (runs / "text.mcap").write_text("no log")
    (runs / "lost").mkdir()
    (runs / "lost/summary.json").write_text("{}")
    (runs / "broken.mcap").symlink_to(runs / "nowhere")
    os.mkfifo(runs / "pipe.mcap")
    shutil.copy(log, runs / "whole.mcap")
    done = verify(runs, "--json", "--junit", tmp_path / "a.xml")
    found = {
        Path(each["log"]).relative_to(runs).as_posix(): each["verdict"]
        for each in holds("replay --brief", done.out)["logs"]
    }
    assert done.code == 2 and found.pop("whole.mcap") == "identical", done
    assert {*found} == {"broken.mcap", "empty.mcap", "folder.mcap", "lost/log.mcap", "pipe.mcap",
                        "text.mcap"}  # fmt: skip
    assert {*found.values()} == {"unreadable"}
    top = ET.parse(tmp_path / "a.xml").getroot()
    assert (top.get("tests"), top.get("errors"), top.get("failures")) == ("7", "6", "0")


def test_a_log_that_changes_while_it_is_read_is_no_pass(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Path(shutil.copy(log, tmp_path / "a.mcap"))
    original = one._recompute

    def then_changed(*given: Any) -> None:
        original(*given)
        path.write_bytes(path.read_bytes() + b"\0")

    monkeypatch.setattr(one, "_recompute", then_changed)
    assert row(path)["why"] == ["the file changed while it was read"]
    monkeypatch.setattr(one, "_recompute", lambda *given: path.unlink())
    found = row(path)
    assert found["verdict"] == "incomplete" and found["why"], found


def test_a_law_that_kills_its_process_is_no_pass_and_meets_no_other_log(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(one, "_recompute", lambda *given: os.kill(os.getpid(), signal.SIGKILL))
    found = row(EARLIER / "motor-b919103.mcap", "--trust")
    assert found["verdict"] == "incomplete" and "process ended with -9" in found["why"][0], found


# The digest


def test_the_digest_does_not_see_chunks_packing_or_the_clock(log: Path, tmp_path: Path) -> None:
    again = made(tmp_path / "again", TUNED)
    assert again.read_bytes() != log.read_bytes()
    assert digest(again) == digest(log)
    for size in (300, 20_000):
        for packed in (CompressionType.NONE, CompressionType.ZSTD):
            assert digest(rewritten(log, tmp_path / "a.mcap", size=size, packed=packed)) == digest(
                log
            )
    other = made(tmp_path / "other", TUNED, "seed=2")
    assert digest(other) != digest(log)


def test_each_bit_of_a_value_a_frame_and_a_tuning_is_in_the_digest(
    log: Path, tmp_path: Path
) -> None:
    seen = {digest(log)}

    def new(edit: Edit, texts: Edit = lambda name, data: data) -> None:
        found = digest(rewritten(log, tmp_path / "a.mcap", edit, texts=texts))
        assert found not in seen
        seen.add(found)

    for topic, places in (
        ("/state", (4, 11, 12)),
        ("/plant/state", (4, 27)),
        ("/can/frames", (12, 20, 24, 25, 26, 28, 35)),
        ("/plant/can/frames", (12, 28)),
    ):
        for number in (0, CYCLES - 1):
            for place in places:
                for bit in (0, 7):
                    new(nth(topic, number, flipped(place, bit)))
    new(nth("/tunings", 0, lambda data: data.replace(b"5.0", b"5.5")))
    new(nth("/tunings", 0, lambda data: data.replace(b".gain", b".gaim")))
    new(nth("/state", CYCLES - 1, lambda data: None))
    for topic in ("/tunings", "/can/frames"):
        new(nth(topic, 0, lambda data: None))

    def same(topic: str, data: bytes) -> bytes:
        return data

    facts = ("seed", "rig", "controller", "pacing", "period_ns", "rate_hz", "python", "git")
    for name, old, changed in (
        *(("executive", f'"{key}": "'.encode(), f'"{key}": "1'.encode()) for key in facts),
        ("executive", b'"version_numba": "', b'"version_numba": "1'),
        ("plant", b'"git": "', b'"git": "1'),
        ("rig-resolved.yaml", b"gain", b"gaim"),
        ("probe.dbc", b"BU_", b"BU-"),
    ):
        new(
            same,
            lambda own, data, name=name, old=old, changed=changed: (  # type: ignore[misc]
                data.replace(old, changed) if own == name else data
            ),
        )


def test_stamps_are_not_in_the_digest(log: Path, tmp_path: Path) -> None:
    def later(topic: str, data: bytes) -> bytes:
        if topic == "/tunings":
            assert b'"stamp_ns": ' in data
            return data.replace(b'"stamp_ns": ', b'"stamp_ns": 1')
        return flipped(4, 3)(data) if topic.endswith(("can/frames", "timing")) else data

    assert digest(rewritten(log, tmp_path / "a.mcap", later)) == digest(log)


def test_the_cycle_of_a_state_is_in_the_digest_but_not_its_channel_and_times() -> None:
    rows = np.arange(60, dtype=np.uint8)[None]
    for place, told in (
        (1, True),
        (11, True),
        (14, True),
        (31, True),
        (59, True),
        (9, False),
        (15, False),
        (23, False),
    ):
        other = rows.copy()
        other[0, place] ^= 1
        assert (_hashed_bytes("state", other) != _hashed_bytes("state", rows)) == told, place


def test_the_length_of_a_frames_message_is_in_the_digest() -> None:
    rows = np.arange(80, dtype=np.uint8)[None]
    other = rows.copy()
    other[0, 1] ^= 1
    assert _hashed_bytes("can/frames", other) != _hashed_bytes("can/frames", rows)


# The table


@pytest.fixture
def runs(log: Path, tmp_path: Path) -> Path:
    """Return a folder of two logs and their table."""
    folder = tmp_path / "runs"
    (folder / "b").mkdir(parents=True)
    shutil.copy(log, folder / "a.mcap")
    shutil.copy(log, folder / "b/log ä.mcap")
    done = verify(folder, "--table", folder / "t.txt")
    assert done.code == 0, done
    return folder


def checked(runs: Path, *words: str | Path) -> Done:
    return verify("--check", runs / "t.txt", *words)


def test_a_table_holds_where_its_folder_goes(runs: Path, tmp_path: Path) -> None:
    moved = tmp_path / "elsewhere"
    runs.rename(moved)
    assert checked(moved).code == 0
    lines = (moved / "t.txt").read_bytes().splitlines(keepends=True)
    assert len(lines) == 4 and lines[2].endswith(b"  b/log \\xe4.mcap\n"), lines
    assert lines[1].split()[:2] == [digest(moved / "a.mcap").encode(), b"identical"]
    assert b"pcpc=0.2.0" in lines[1] and b",python=3." in lines[1]
    assert lines[-1].split()[0].decode() == hashlib.sha256(b"".join(lines[:-1])).hexdigest()


def test_logs_that_are_not_as_in_the_table(runs: Path, tmp_path: Path) -> None:
    shutil.copy(runs / "a.mcap", runs / "c.mcap")
    done = checked(runs)
    assert done.code == 1 and "additional  c.mcap: here, but not in" in done.out, done
    (runs / "c.mcap").unlink()
    (runs / "b/log ä.mcap").unlink()
    done = checked(runs, "--junit", tmp_path / "a.xml")
    assert done.code == 3 and "missing     b/log ä.mcap: in the table" in done.out, done
    assert "failure" in (tmp_path / "a.xml").read_text()
    shutil.copy(made(tmp_path / "other", "seed=2"), runs / "a.mcap")
    done = checked(runs, "--json")
    told = holds("replay --brief", done.out)
    assert done.code == 1 and [each["what"] for each in told["table"]] == ["changed", "missing"]
    assert all(each["verdict"] == "identical" for each in told["logs"]), "else it shows nothing"


def test_a_table_for_another_folder(runs: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    shutil.copy(runs / "a.mcap", tmp_path / "other/x.mcap")
    shutil.copy(runs / "t.txt", tmp_path / "other/t.txt")
    done = checked(tmp_path / "other")
    assert done.code == 1 and "additional" in done.out and done.out.count("missing") == 2, done


def test_a_verdict_that_is_another_one_now(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = one._recompute

    def worse(row: one.VerifiedLog, *given: Any) -> None:
        original(row, *given)
        row.verdict = one.INCOMPLETE

    monkeypatch.setattr(one, "_recompute", worse)
    done = checked(runs)
    assert done.code == 1 and "judged      a.mcap: identical in the table" in done.out, done


@pytest.mark.parametrize("was", ["differs", "incomplete", "unreadable"])
def test_a_verdict_that_has_become_better_is_not_as_in_the_table(was: str, runs: Path) -> None:
    text = (runs / "t.txt").read_bytes().replace(b"identical", was.encode(), 1)
    (runs / "t.txt").write_bytes(sealed(text.splitlines(keepends=True)[:-1]))
    done = checked(runs)
    assert done.code == 1 and f"judged      a.mcap: {was} in the table, identical" in done.out, done


def test_a_line_says_which_nodes_and_how_many_cycles_were_recomputed(log: Path) -> None:
    done = verify(log)
    assert "\n  recomputed: executive 60 of 60 cycles, plant 61 of 61 cycles\n" in done.out
    assert done.out.endswith("1 log recomputed: 1 identical\n"), done
    done = verify(log, "--node", "executive")
    told = "recomputed: executive 60 of 60 cycles; not asked for: plant"
    assert told in " ".join(done.out.split()), done
    assert done.out.endswith("1 log recomputed, without the plant: 1 identical\n"), done


def sealed(lines: list[bytes]) -> bytes:
    above = b"".join(lines)
    return above + f"{hashlib.sha256(above).hexdigest()}  all lines above\n".encode()


@pytest.mark.parametrize(
    "change",
    [
        lambda x: b"".join(x[:-1]), lambda x: b"", lambda x: b"\0", lambda x: b"\n",
        lambda x: b"".join(x).replace(b"\n", b"\r\n"), lambda x: b"".join(x)[:-1],
        lambda x: b"".join([x[0], x[2], x[3]]), lambda x: b"".join([x[0], x[2], x[1], x[3]]),
        lambda x: flipped(70)(b"".join(x)), lambda x: b"".join([*x, b"\n"]),
        lambda x: sealed([x[0]]), lambda x: sealed(x[1:3]), lambda x: sealed([*x[:2], x[1]]),
        lambda x: sealed([x[0], b"x\n"]), lambda x: sealed([x[0], b"\n"]),
        lambda x: sealed([x[0], x[1].replace(b"a.mcap", b"../a.mcap")]),
        lambda x: sealed([x[0], x[1].replace(b"a.mcap", b"/a.mcap")]),
        lambda x: sealed([x[0], x[1].replace(b"a.mcap", b"./a.mcap")]),
        lambda x: sealed([x[0], x[1].replace(b"a.mcap", b"b/../a.mcap")]),
        lambda x: sealed([x[0], x[1].replace(b"a.mcap", b"\\x61.mcap")]),
        lambda x: sealed([x[0], x[1].replace(b"a.mcap", b"a.mcap\\")]),
        lambda x: sealed([x[0], x[1].replace(b"identical", b"fine")]),
        lambda x: sealed([x[0], x[1].upper()]), lambda x: sealed([x[0], b"-" + x[1]]),
        lambda x: sealed([x[0], x[1].replace(b"a.mcap", "ä.mcap".encode())]),
    ],
)  # fmt: skip
def test_a_damaged_table_is_a_line(change: Callable[[list[bytes]], bytes], runs: Path) -> None:
    table = runs / "t.txt"
    table.write_bytes(change(table.read_bytes().splitlines(keepends=True)))
    done = checked(runs)
    assert done.code == 2 and done.err.count("\n") == 1 and not done.out, done
    assert "t.txt" in done.err and "table" in done.err, done
    assert ("Windows line ends" in done.err) == (b"\r" in table.read_bytes()), done


# The signature


@cache
def keys() -> Path:
    folder = Path(os.environ["PYTEST_KEYS"])
    for name in ("me", "other"):
        subprocess.run(
            ["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / name], check=True
        )
    public = (folder / "me.pub").read_text()
    (folder / "signers").write_text(f'me namespaces="pcpc" {public}')
    return folder


@pytest.fixture
def signed(
    runs: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> tuple[Path, Path]:
    """Return a folder with a signed table, and one of keys."""
    if shutil.which("ssh-keygen") is None:
        pytest.skip("without ssh-keygen nothing is signed")
    if "PYTEST_KEYS" not in os.environ:
        os.environ["PYTEST_KEYS"] = str(tmp_path_factory.mktemp("keys"))
    (runs / "t.txt").unlink()
    done = verify(runs, "--table", runs / "t.txt", "--sign", keys() / "me")
    assert done.code == 0 and (runs / "t.txt.sig").read_text().startswith("-----BEGIN SSH"), done
    return runs, keys()


def test_a_signed_table(signed: tuple[Path, Path]) -> None:
    runs, keys = signed
    by_me = "--signers", keys / "signers", "--identity", "me"
    done = checked(runs, *by_me)
    assert done.code == 0 and done.out.endswith("signed by me\n"), done
    done = checked(runs)
    assert done.code == 0 and "t.txt.sig is not checked; --signers" in done.out, done
    done = checked(runs, "--signers", keys / "signers", "--identity", "you")
    assert done.code == 1 and "not signed by you" in done.err and not done.out, done
    text = (runs / "t.txt").read_bytes()
    forged = sealed(text.replace(b"identical", b"differs", 1).splitlines(keepends=True)[:-1])
    (runs / "t.txt").write_bytes(forged)
    assert checked(runs, *by_me).code == 1
    (runs / "t.txt").write_bytes(text)
    command = ["ssh-keygen", "-Y", "sign", "-n", "pcpc", "-f", str(keys / "other")]
    other = subprocess.run(command, input=text, capture_output=True, check=True).stdout
    command[4] = "git"
    wrong = subprocess.run(
        [*command[:-1], str(keys / "me")], input=text, capture_output=True, check=True
    ).stdout
    for data in (other, wrong, b"", b"x"):
        (runs / "t.txt.sig").write_bytes(data)
        done = checked(runs, *by_me)
        assert done.code == 1 and done.err.count("\n") == 1 and not done.out, done
    (runs / "t.txt.sig").unlink()
    done = checked(runs, *by_me)
    assert done.code == 2 and "t.txt.sig: no such file" in done.err, done


def test_a_key_that_cannot_sign_leaves_no_table(signed: tuple[Path, Path], tmp_path: Path) -> None:
    runs, keys = signed
    before = sorted(runs.iterdir())
    for key in (keys / "signers", keys / "absent"):
        done = verify(runs / "a.mcap", "--table", runs / "new.txt", "--sign", key)
        assert done.code == 2 and done.err.count("\n") == 1, done
        assert sorted(runs.iterdir()) == before


def test_without_ssh_keygen_the_cure_is_said(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    done = verify(runs, "--table", runs / "new.txt", "--sign", runs / "a.mcap")
    assert done.code == 4 and "install openssh-client" in done.err and not done.out, done
    (runs / "t.txt.sig").touch()
    done = checked(runs, "--signers", runs / "a.mcap", "--identity", "me")
    assert done.code == 4 and "install openssh-client" in done.err, done


@pytest.mark.parametrize(
    ("status", "words", "code"),
    [
        (0, ["--check", "T", "--signers", "S", "--identity", "me"], 0),
        (1, ["--check", "T", "--signers", "S", "--identity", "me"], 1),
        (255, ["--check", "T", "--signers", "S", "--identity", "me"], 1),
        (0, ["--check", "T", "--signers", "none", "--identity", "me"], 2),
        (1, ["R", "--table", "U", "--sign", "S"], 2),
    ],
)
def test_what_ssh_keygen_answers_is_the_exit_code(
    status: int, words: list[str], code: int, runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = runs / "ssh-keygen"
    program.write_text(f"#!/bin/sh\ncat > /dev/null\necho no >&2\nexit {status}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(runs), prepend=os.pathsep)
    files = {"T": "t.txt", "U": "u.txt", "S": "signers", "none": "none", "R": ""}
    for name in ("signers", "t.txt.sig"):
        (runs / name).write_text("x")
    done = verify(*(runs / files[word] if word in files else word for word in words))
    assert done.code == code, done
    assert done.err.count("\n") == (code > 0) and not (runs / "u.txt").exists(), done


# Words, and processes


def test_a_full_disk_is_a_line(log: Path, tmp_path: Path) -> None:
    done = verify(log, "--junit", "/dev/full")
    assert done.code in (2, 3, 4) and done.err.count("\n") == 1, done


def test_rows_have_the_order_of_names_and_each_log_is_one(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("b", "a", "c"):
        made_text(tmp_path / name)
    (tmp_path / "d").symlink_to(tmp_path)
    given = []

    def backwards(judge: Any, names: Any, progress: Any, jobs: int) -> list[one.VerifiedLog]:
        given.append(jobs)
        return [judge(name) for name in names[::-1]][::-1]

    monkeypatch.setattr(cli, "each", backwards)
    same = tmp_path / "b/../a/log.mcap"
    done = run_here(
        "replay", "--brief", tmp_path / "c", tmp_path, same, "--jobs", "2", "--quiet", "--json"
    )
    found = [Path(each["log"]).parent.name for each in holds("replay --brief", done.out)["logs"]]
    assert (done.code, found, given) == (2, ["a", "b", "c"], [2]), done


def test_small_logs_are_verified_in_one_process(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [str(log), str(tmp_path / "no")]
    assert cli._processes(names) == 1, "it takes a process as long to start"
    monkeypatch.setattr(cli, "_BYTES_A_PROCESS", log.stat().st_size)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1, 2})
    assert [cli._processes([str(log)] * n) for n in (0, 1, 2, 9)] == [1, 1, 2, 3]


def made_text(folder: Path) -> None:
    folder.mkdir()
    (folder / "log.mcap").write_text("no log")


def test_a_process_that_dies_is_no_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made_text(tmp_path / "a")
    made_text(tmp_path / "b")
    monkeypatch.setattr(cli, "verified_row", killed)
    done = run_here(
        "replay", "--brief", tmp_path, "--jobs", "2", "--table", tmp_path / "t", "--quiet"
    )
    assert done.code == 4 and "was killed" in done.err and not done.out, done
    assert not (tmp_path / "t").exists()


def killed(log: str, **_: object) -> one.VerifiedLog:
    os.kill(os.getpid(), signal.SIGKILL)
    return one.VerifiedLog(log, one.IDENTICAL)
