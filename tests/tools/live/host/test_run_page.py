"""`pcpc run --host`: the page beside a run, which the run does not depend on."""

import os
import signal
import sys
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from hosting import ANSWER_S, LONG, Client, Host
from live_run import pcpc as started
from places import PATIENCE_S
from processes import alive, own_bus, until

import pcpc
from pcpc.tools.cli import main

GAIN = "controller.kv_Nms_rad"


def page_of(live: pcpc.Live) -> int:
    """Return the process of the page."""
    command = live._command.process.pid
    children = Path(f"/proc/{command}/task/{command}/children").read_text().split()
    names = {Path(f"/proc/{pid}/comm").read_text().strip(): int(pid) for pid in children}
    return names["pcpc page"]


def client_of(live: pcpc.Live) -> Client:
    url = urlsplit(live.page)
    assert url.port is not None
    return Client(Host(None, url.port, url.fragment))  # type: ignore[arg-type]


def test_the_page_shows_its_run_tunes_it_and_ends_with_it() -> None:
    with pcpc.running("slew10", pacing="real", set=LONG, bus=own_bus(), host=True) as live:
        page = page_of(live)
        with client_of(live) as client:
            while len(client.about["nodes"]) < 2:
                client.about = client.until("about")["about"]
            assert (client.about["rig"], client.about["write"]) == ("slew10", True)
            told = client.ask(do="set", values={GAIN: 111.0})
            assert live[GAIN] == 111.0
            live.stop()
    tuned = [(e["name"], e["value"], e["cycle"]) for e in live.run.events if e.get("name") == GAIN]
    assert tuned == [(GAIN, 111.0, told["cycle"])]
    assert not alive(page)
    assert "ended with the run; its log: pcpc host" in live._command.complaint()[-1]


def test_a_page_that_dies_is_a_line_and_the_run_goes_on() -> None:
    with pcpc.running("slew10", pacing="real", set=LONG, bus=own_bus(), host=True) as live:
        os.kill(page_of(live), signal.SIGKILL)
        until(lambda: "the page has ended" in live._complaint(), "the line")
        cycle = live.cycle
        live.wait_until(lambda now: live.cycle > cycle + 50, within_s=PATIENCE_S)
        run = live.stop()
    assert run.summary["faults"] == [], run.summary["faults"]
    assert live._complaint().count("the page has ended") == 1


def test_it_records_to_where_it_is_told_and_no_more_than_it_may(tmp_path: Path) -> None:
    settings = [f"--set={name}={value}" for name, value in LONG.items()]
    words = ["--recordings", str(tmp_path / "rec"), "--recordings-mb", "1", "--no-figure"]
    run = started(
        "run",
        "slew10",
        "--pacing",
        "real",
        "--bus",
        own_bus(),
        "--host",
        "--write",
        "--port",
        "0",
        "-o",
        str(tmp_path / "run"),
        "--quiet",
        *settings,
        *words,
    )
    assert run.stderr is not None
    try:
        url = urlsplit(run.stderr.readline().removeprefix("page: ").strip())
        assert url.port is not None
        with Client(Host(None, url.port, url.fragment)) as client:  # type: ignore[arg-type]
            while not client.about["nodes"]:
                client.about = client.until("about")["about"]
            path = Path(client.ask(do="record")["file"])
            while (found := client.until("status")["status"]["recording"])["going"]:
                pass
    finally:
        run.send_signal(signal.SIGINT)
        run.communicate(timeout=ANSWER_S)
    assert path.parent == tmp_path / "rec" and "have their size" in found["why"], found


def test_what_is_missing_or_wrong_is_told_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["run", "hull", "--write", "-o", str(tmp_path / "a")]) == 2
    assert capsys.readouterr().err == "--write: options of the page; give --host, too\n"
    assert main(["run", "hull", "--recordings", "x", "--recordings-mb", "9", "-o", "a"]) == 2
    assert capsys.readouterr().err.startswith(
        "--recordings, --recordings-mb: options of the page; "
    )
    (tmp_path / "file").touch()
    words = ["--recordings", str(tmp_path / "file"), "-o", str(tmp_path / "b")]
    assert main(["run", "hull", "--host", *words]) == 2
    assert "file: is not a folder" in capsys.readouterr().err
    (tmp_path / "file").unlink()
    assert main(["run", "hull", "--host", "--port", "70000", "-o", str(tmp_path / "b")]) == 2
    assert "0 to 65535" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "uvicorn", None)  # as where it is not installed
    assert main(["run", "hull", "--host", "-o", str(tmp_path / "c")]) == 4
    assert "-m pip install 'uvicorn" in capsys.readouterr().err
    assert [*tmp_path.iterdir()] == []
