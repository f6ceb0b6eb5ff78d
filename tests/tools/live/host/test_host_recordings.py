"""What the page records has the bits of the log of the run, is bounded, and opens in any case."""

import json
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hosting import ANSWER_S, LONG, Client, Host, hosting
from processes import own_bus

import pcpc
from pcpc.executive.log import reader as logs
from pcpc.tools.cli import main

COLUMNS = [f"{node}/{kind}" for node in ("", "/plant") for kind in ("state", "timing")]
WHOLE = [*COLUMNS, "/can/frames", "/plant/can/frames"]


@pytest.fixture(scope="module")
def run() -> Iterator[pcpc.Live]:
    with pcpc.running("slew10", pacing="real", set=LONG, bus=own_bus()) as live:
        yield live


def recording(run: pcpc.Live, folder: Path, *words: str, before: tuple[str, ...] = ()) -> Any:
    """Start a host of the run that records into `folder`/rec."""
    node = run._nodes["plant"].name
    own = ("--write", "--node", node, "--recordings", str(folder / "rec"))
    return hosting(folder, *own, *words, before=before)


def told(client: Client) -> Any:
    """Return what the next message says of the recording."""
    return client.until("status")["status"]["recording"]


def until(client: Client, holds: Any) -> Any:
    """Return the first word about the recording of which something holds."""
    end_s = time.monotonic() + ANSWER_S
    while not holds(found := told(client)):
        assert time.monotonic() < end_s, found
    return found


def test_a_recording_and_a_snapshot_are_parts_of_the_log(tmp_path: Path) -> None:
    with pcpc.running("slew10", pacing="real", set=LONG, bus=own_bus()) as run:
        with recording(run, tmp_path) as host, Client(host) as client:
            begun = client.ask(do="record")
            assert "is being recorded already" in client.ask(do="record")["why"]
            client.ask(do="set", values={"controller.kv_Nms_rad": 111.0})
            until(client, lambda one: one["cycles"] >= 200)
            ended = client.ask(do="record", end=True)
            assert ended["file"] == begun["file"] and not told(client)["going"]
            last = client.ask(do="snapshot", last_s=0.5)
            every = client.ask(do="snapshot")
            assert "nothing is being recorded" in client.ask(do="record", end=True)["why"]
        run.stop()
    whole = run.run.path
    assert 50 <= last["last"] - last["first"] <= 100  # of 200 a second; some may have been skipped
    for one, least in ((begun, 200), (last, 30), (every, 200)):
        path = Path(one["file"])
        assert path.parent == tmp_path / "rec"
        for topic in WHOLE:
            mine, all_of_it = logs.payloads(path, topic), logs.payloads(whole, topic)
            at = all_of_it.index(mine[0])
            assert mine == all_of_it[at : at + len(mine)], f"{path.name} {topic}"
            assert len(mine) >= least, f"{path.name} {topic}: {len(mine)}"
        told_of = [json.loads(m) for m in logs.payloads(path, "/tunings")]
        assert [one["value"] for one in told_of] == ([] if one is last else [111.0])
    for topic in ("/can/frames", "/plant/can/frames"):  # of 100 cycles, and of 200 at least
        few, many = (len(logs.payloads(Path(one["file"]), topic)) for one in (last, every))
        assert 3 * few < 2 * many, f"{topic}: {few} of {many} frames in the last half second"
    begins = [node.cycle[0] for node in logs.read(Path(begun["file"])).node.values()]
    assert 0 < begun["cycle"] <= min(begins)


@pytest.fixture(scope="module")
def recorded(run: pcpc.Live, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a file that was recorded."""
    with recording(run, tmp_path_factory.mktemp("host")) as host, Client(host) as client:
        client.ask(do="record")
        until(client, lambda one: one["cycles"] >= 100)
        return str(client.ask(do="record", end=True)["file"])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["log", "info"], "slew10"), (["log", "export", "-o-"], "controller.e_rad"),
        (["log", "plot", "-o", "a.png"], "a.png"), (["log", "export", "-o", "a.csv"], "a.csv"),
        (["log", "export", "-o", "a.log"], "frames"), (["log", "recover", "-o", "b.mcap"], "plant"),
        (["compare", "--bits"], "equal"), (["report", "-o", "a.html"], "a.html"),
    ],
    ids=lambda words: " ".join(words[:2]) if isinstance(words, list) else "",
)  # fmt: skip
def test_all_commands_about_logs_open_it(
    recorded: str,
    words: list[str],
    said: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    files = [recorded, recorded] if "--bits" in words else [recorded]
    place = 1 if words[0] == "report" else 2
    assert main([*words[:place], *files, *words[place:]]) == 0
    assert said in capsys.readouterr().out


def test_the_page_opens_it(recorded: str, tmp_path: Path) -> None:
    with hosting(tmp_path, recorded) as host, Client(host) as client:
        first = next(iter(logs.read(Path(recorded)).node["executive"].cycle))
        assert client.about["rig"] == "slew10" and first > 0
        wanted = {"names": ["controller.e_rad"], "bins": 50, "from_s": 0.0, "to_s": 9e5}
        client.say(do="panel", id=1, **wanted)
        assert client.panel(1)[0][3] > 0


def test_a_host_that_is_killed_leaves_what_it_had_recorded(run: pcpc.Live, tmp_path: Path) -> None:
    with recording(run, tmp_path) as host, Client(host) as client:
        path = Path(client.ask(do="record")["file"])
        found = until(client, lambda one: one["cycles"] > 300)  # of which most were handed over
        host.process.send_signal(signal.SIGKILL)
        host.process.wait()
    left = logs.read(path)
    assert left.missing and len(left.node["plant"].cycle) > 50, found


def test_recordings_end_where_they_have_their_size(run: pcpc.Live, tmp_path: Path) -> None:
    with recording(run, tmp_path, "--recordings-mb", "1") as host, Client(host) as client:
        path = Path(client.ask(do="record")["file"])
        found = until(client, lambda one: not one["going"])
        assert "have their size" in found["why"] and 1.0 <= found["mb"] < 2.5, found
        for wish in ({"do": "record"}, {"do": "snapshot"}):
            why = client.ask(**wish)["why"]
            assert "delete some" in why and "--recordings-mb" in why
        assert not logs.read(path).missing
        path.unlink()
        assert "file" in client.ask(do="snapshot", last_s=0.1)


def test_a_disk_without_room_ends_a_recording_with_a_line(run: pcpc.Live, tmp_path: Path) -> None:
    full = ("prlimit", "--fsize=300000", "--")
    with recording(run, tmp_path, before=full) as host, Client(host) as client:
        path = Path(client.ask(do="record")["file"])
        found = until(client, lambda one: not one["going"])
        assert found["why"] == "File too large; what was written until then opens", found
        assert len(logs.read(path).node["plant"].cycle) > 50
        assert "cannot be written" in client.ask(do="snapshot")["why"]
        assert [*path.parent.iterdir()] == [path], "half a snapshot is left"
        client.until("status")


def test_a_folder_that_cannot_be_made_is_told(run: pcpc.Live, tmp_path: Path) -> None:
    with recording(run, tmp_path) as host, Client(host) as client:
        (tmp_path / "rec").write_text("a file, since the start")
        for wish in ({"do": "record"}, {"do": "snapshot"}):
            while "no cycle yet" in (why := client.ask(**wish)["why"]):
                client.until("status")
            assert "File exists; see --recordings" in why


def test_two_who_record_see_the_same(run: pcpc.Live, tmp_path: Path) -> None:
    host: Host
    with recording(run, tmp_path) as host, Client(host) as one, Client(host) as other:
        assert told(one) is None
        begun = one.ask(do="record")
        assert until(other, lambda seen: seen)["file"] == begun["file"]
        assert other.ask(do="record", end=True)["file"] == begun["file"]
        assert until(one, lambda seen: not seen["going"])["why"] == ""


def test_the_load_is_that_of_the_frames_of_the_rig(run: pcpc.Live, tmp_path: Path) -> None:
    with recording(run, tmp_path) as host, Client(host) as client:
        end_s = time.monotonic() + ANSWER_S
        while not is_of_the_rig(found := client.until("status")["status"]):
            assert time.monotonic() < end_s, (found["load"], found["nodes"]["executive"]["frames"])


def is_of_the_rig(status: dict[str, Any]) -> bool:
    """Return whether load and periods, each of a time of its own, are those of a rig of 200 Hz."""
    load, frames = status["load"], status["nodes"]["executive"]["frames"]
    cycle = [one for one in frames if one["name"] in ("CMD", "FB_A") and "period_ms" in one]
    if not load or len(cycle) < 2:
        return False
    both = load["sent"]["executive"] + load["sent"]["plant"]
    least = 200 * 5 * 55 * 0.8  # five frames a cycle at least, of 55 bits at least
    return (
        all(4.9 < one["period_ms"] < 6.0 and one["jitter_ms"] >= 0.0 for one in cycle)
        and load["bitrate"] == 1_000_000
        and 0.9 * both <= load["bits_per_s"] <= 1.1 * both
        and least < load["bits_per_s"] < 0.2 * load["bitrate"]
    )
