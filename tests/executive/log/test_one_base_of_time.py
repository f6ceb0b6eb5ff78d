"""All topics of a log, and all that is exported of it, have one base of time."""

import csv
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from asammdf import MDF
from mcap.reader import make_reader
from mcap.writer import Writer
from processes import RIGS, own_bus, pcpc

from pcpc.executive.log import reader as logs
from pcpc.executive.log.channels import Channels
from pcpc.tools import cli

DURATION_S = 0.6
SETTINGS = ("--set", f"duration_s={DURATION_S}", "--set", "record.keyframe=100ms", "--no-figure")
_DIFFERENT_S = 10.0  # a stall of a busy machine is less; another clock is the machine's uptime


def spans_s(log: Path) -> dict[str, tuple[float, float]]:
    """Return the first and the last time of each topic, since that of the executive's first row."""
    found: dict[str, tuple[int, int]] = {}
    with log.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            assert message.publish_time == message.log_time
            low, high = found.get(channel.topic, (message.log_time, message.log_time))
            found[channel.topic] = min(low, message.log_time), max(high, message.log_time)
    zero = found["/state"][0]
    return {topic: (1e-9 * (a - zero), 1e-9 * (b - zero)) for topic, (a, b) in found.items()}


def check(log: Path) -> None:
    """Compare the topics of a log with each other."""
    found = spans_s(log)
    for name in ("keyframes", "state", "timing", "can/frames", "events"):
        assert {f"/{name}", f"/plant/{name}"} <= found.keys(), sorted(found)
    late = found["/state"][1] - DURATION_S
    assert abs(late) < _DIFFERENT_S, found
    for topic, (first, last) in found.items():
        assert first > -_DIFFERENT_S and last < found["/state"][1] + _DIFFERENT_S, (topic, found)


def run(folder: Path, pacing: str) -> Path:
    """Return the log of a run on a bus."""
    words = ("--pacing", pacing, "--bus", own_bus(), "--quiet", "-o", str(folder))
    pcpc("run", str(RIGS / "slew10.yaml"), *SETTINGS, *words)
    return folder / "log.mcap"


def simulated(folder: Path, pacing: str) -> Path:
    """Return the log of a run in virtual time."""
    assert cli.main(["simulate", "slew10", *SETTINGS, "-o", str(folder)]) == 1, "not judged"
    return folder / "log.mcap"


def branched(folder: Path, pacing: str) -> Path:
    """Return the log of a branch of a run in virtual time."""
    log, words = simulated(folder / "before", pacing), ("--cycle", "300", "-o", str(folder / "b"))
    words = "branch", str(log), "--set", "controller.lam_per_s=11", *words
    assert cli.main([*words]) == 1, "not judged"
    return folder / "b" / "log.mcap"


def frame_times_s(file: Path) -> tuple[float, float]:
    """Return the wall time of the first and the last frame, or row, of an exported file."""
    if file.suffix == ".csv":
        times = [1e-9 * int(row[0]) for row in list(csv.reader(file.open()))[1:]]
    elif file.suffix == ".mf4":
        with MDF(file) as measured:
            start_s = measured.header.start_time.timestamp()
            masters = [measured.get_master(i) for i in range(len(measured.groups))]
        times = [start_s + float(t) for master in masters for t in master]
    else:
        more = {"relative_timestamp": False} if file.suffix == ".asc" else {}
        times = [one.timestamp for one in can.LogReader(file, **more)]
    return min(times), max(times)


def test_what_is_exported_has_the_times_of_the_log(tmp_path: Path) -> None:
    log = simulated(tmp_path / "run", "virtual")
    found = {}
    for suffix in ("csv", "log", "blf", "asc", "mf4"):
        file = tmp_path / f"x.{suffix}"
        assert cli.main(["log", "export", str(log), "-o", str(file), "--quiet"]) == 0
        found[suffix] = frame_times_s(file)
    with log.open("rb") as text:
        rows = [one.log_time for _, _, one in make_reader(text).iter_messages(["/state"])]
    for suffix, (first, last) in found.items():
        assert abs(first - 1e-9 * rows[0]) < 2e-3, (suffix, found)
        assert abs(last - 1e-9 * rows[-1]) < 2e-3, (suffix, found)


def test_a_log_whose_keyframes_have_another_base_is_replayed_and_branched(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Older runs in lockstep have them later by the time since the machine was switched on."""
    log, older = simulated(tmp_path / "run", "virtual"), tmp_path / "older" / "log.mcap"
    older.parent.mkdir()
    with log.open("rb") as text, older.open("wb") as into:
        reader, writer = make_reader(text), Writer(into)
        writer.start(profile="ros2")
        summary, ids = reader.get_summary(), {}
        assert summary is not None
        for number, one in summary.channels.items():
            of = summary.schemas[one.schema_id]
            kind = writer.register_schema(of.name, of.encoding, of.data)
            ids[number] = writer.register_channel(one.topic, one.message_encoding, kind)
        for file in reader.iter_attachments():
            writer.add_attachment(
                file.create_time, file.log_time, file.name, file.media_type, file.data
            )
        for known in reader.iter_metadata():
            writer.add_metadata(known.name, known.metadata)
        for _, one, message in reader.iter_messages(log_time_order=False):
            at = message.log_time + 8224 * 10**9 * one.topic.endswith("keyframes")
            writer.add_message(ids[one.id], at, message.data, at, message.sequence)
        writer.finish()
    assert spans_s(older)["/plant/keyframes"][0] > 8000.0
    assert cli.main(["replay", str(older)]) == 0
    assert cli.main(["replay", str(older), "--from", "0.4"]) == 0
    assert capsys.readouterr().out.count("bit-identical") == 4
    words = ("--cycle", "300", "-o", str(tmp_path / "b"), "--no-figure")
    cli.main(["branch", str(older), "--set", "controller.lam_per_s=11", *words])
    check(tmp_path / "b" / "log.mcap")


@pytest.mark.parametrize(
    ("way", "pacing"),
    [
        (run, "lockstep"),
        (simulated, "virtual"),
        (branched, "virtual"),
        (run, "sync"),
        (run, "real"),
    ],
)
def test_the_topics_of_a_log_have_one_base_of_time(
    tmp_path: Path, way: Callable[[Path, str], Path], pacing: str
) -> None:
    check(way(tmp_path / "run", pacing))


def test_what_the_machines_clock_stamped_counts_from_the_start_without_a_clock(
    tmp_path: Path,
) -> None:
    """For each pacing; `machine_ns` is the time since the machine was switched on."""
    about = logs.head(simulated(tmp_path / "run", "virtual")).node["executive"].description

    class Nowhere:
        def register(self, *words: str) -> int:
            return 1

        def add_metadata(self, name: str, data: dict[str, str]) -> None:
            pass

    for pacing, stamp_ns in {"lockstep": 7_000_000, "virtual": 7_000_000, "real": 10**15}.items():
        facts = {"clock_wall_ns": "5", "clock_monotonic_ns": "0", "pacing": pacing}
        channels = Channels({**about, "metadata": facts}, Nowhere())
        assert channels.stamp(10**15, 7) == stamp_ns, pacing
