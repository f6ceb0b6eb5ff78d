"""`pcpc doctor --bus` on a real vcan0: sockets, queues and states of SocketCAN, no adapter."""

import io
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import Any

import can
import pytest

from pcpc.drivers.can import bus
from pcpc.tools.cli import main

pytestmark = pytest.mark.vcan
PCPC = [sys.executable, "-m", "pcpc.tools.cli"]
FEW = "60"  # frames: an emulated processor sends slowly


@pytest.fixture(scope="module", autouse=True)
def interfaces() -> Iterator[None]:
    """Make vcan4 to vcan7, which no other test uses; vcan6 is down, vcan7 has no CAN FD."""
    for number in range(4, 8):
        assert bus.vcan_ready(f"vcan{number}")
    for words in ("vcan6 down", "vcan7 down", "vcan7 mtu 16", "vcan7 up"):
        subprocess.run(f"ip link set {words}".split(), check=True)
    yield
    for number in range(4, 8):
        subprocess.run(f"ip link del vcan{number}".split(), check=True)


def examined(channels: str) -> tuple[int, dict[str, Any], str]:
    """Return the exit code, the JSON and the errors of a short examination, in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(["doctor", "--bus", channels, "--frames", FEW, "--json"])
    found = json.loads(out.getvalue()) if out.getvalue() else {}
    return code, found, err.getvalue()


def rows(found: dict[str, Any]) -> dict[str, dict[str, str]]:
    return {row["name"]: row for row in found["rows"]}


@contextmanager
def line(*words: str) -> Iterator[None]:
    """Make one line of vcan4 and vcan5."""
    command = [*PCPC, "bus", "emulate", "vcan4", "vcan5", *words]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        while "are one line" not in process.stderr.readline():
            assert process.poll() is None
        try:
            yield
        finally:
            process.kill()


def test_one_channel_hears_itself_with_stamps_of_the_kernel() -> None:
    code, found, err = examined("vcan4")
    assert code in (1, 3) and found["software"] is True, (code, err)
    told = rows(found)
    assert told["wiring"]["state"] == "held", told
    assert {told[name]["state"] for name in ("once", "whole", "in order", "CAN FD")} == {"held"}
    assert "outside" not in told["stamps"]["found"] and "of the kernel" in told["stamps"]["found"]
    assert told["loss"]["state"] == "not judged", "so few frames show nothing"
    assert told["error counters"]["state"] == told["adapter"]["state"] == "not judged"
    assert found["channels"][0]["kind"] == "vcan" and found["channels"][0]["queue"] is not None
    assert found["verdict"] != "good" and found["long"]["lost"] == 0


def test_two_channels_that_are_not_wired_are_named() -> None:
    code, found, _ = examined("vcan4,vcan5")
    told = rows(found)["wiring"]
    assert (code, told["state"]) == (1, "violated"), found["rows"]
    assert told["found"].startswith("vcan5 hears nothing of vcan4, nor the other way"), told
    assert found["long"] is None and found["verdict"] == "not good"


def test_nothing_is_sent_where_another_program_of_pcpc_is() -> None:
    with line("--bitrate", "500k"):
        code, found, err = examined("vcan4,vcan5")
    assert (code, found) == (4, {}) and "another program of pcpc is on it" in err, err


def test_an_interface_that_is_down_and_one_that_is_not_there_are_named() -> None:
    for name, what in (("vcan6", "is down"), ("can66", "no such interface")):
        code, found, err = examined(name)
        assert (code, found) == (4, {}) and what in err and "ip link set" in err, err


def test_an_interface_without_fd_takes_classic_frames_only() -> None:
    _, found, _ = examined("vcan7")
    told = rows(found)["CAN FD"]
    assert (told["state"], found["channels"][0]["fd"]) == ("not judged", False), told
    assert rows(found)["wiring"]["state"] == "held"


def test_nothing_is_sent_where_others_talk() -> None:
    words = ["cangen", "vcan5", "-I", "123", "-g", "20"]
    with subprocess.Popen(words) as other:
        code, found, err = examined("vcan5")
        other.kill()
    assert (code, found) == (4, {}) and "others talk" in err and "123" in err, err
    with can.Bus(interface="socketcan", channel="vcan5") as ear:
        assert ear.recv(0.5) is None
