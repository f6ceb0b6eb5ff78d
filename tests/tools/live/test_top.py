"""`pcpc top`: what it shows of a real run, on a terminal and without, and what it finds wrong."""

import fcntl
import os
import pty
import signal
import struct
import subprocess
import termios
from collections.abc import Iterator

import numpy as np
import pytest
import standing
from copies import program
from live_run import ERROR, KV, Run, Screen, pcpc
from processes import DEADLINE_S, ROOT, until

from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.canopen.layout import WARNING, Power
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.faults import FAULT_NAMES, Fault
from pcpc.executive.loop.states import STATE_NAMES, State
from pcpc.executive.nodes import live
from pcpc.tools.cli import main
from pcpc.tools.live.top.meter import Meter
from pcpc.tools.live.top.page import lines

# A real run


def nodes_of(run: Run) -> dict[str, live.Live]:
    bus = run.node.removesuffix("executive")
    return {name: one for name, one in live.running().items() if name.startswith(bus)}


def test_one_screen_tells_states_rates_frames_errors_and_tunings(
    run: Run, capsys: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", "24")
    node = live.find(run.node)
    node.tune({KV: 120.0})
    until(lambda: node[KV] == 120.0, "tuned")
    for _ in range(50):  # on a busy machine a node is in HOLD now and then
        assert main(["top", "--once", "--node", run.node]) == 0
        out = capsys.readouterr().out.splitlines()
        if "HOLD" not in "".join(out):
            break
    assert len(out) <= 24 and max(map(len, out)) <= 80, out
    assert out[0].startswith("hull  pd  real  ") and "of 600 s, cycle " in out[0], out[0]
    found = {line.split()[0]: line.split() for line in out if line.strip()}
    for role in ("executive", "plant"):
        assert found[role][1:3] == ["RUN", "enabled"], out
        assert 100.0 < float(found[role][3]) < 300.0, out
    assert float(found["FB_A"][2]) > 0.0 and int(found["FB_A"][3]) > 0, out
    assert f"{ERROR} [rad]" in "\n".join(out), out
    tuned = next(line for line in out if line.startswith("*"))
    assert tuned.split()[0] == f"*{KV}" and tuned.split()[-2:] == ["120", "110"], out


@pytest.mark.parametrize(("columns", "rows"), [(80, 24), (200, 60), (61, 18), (30, 5)])
def test_the_screen_fits_any_terminal(run: Run, columns: int, rows: int) -> None:
    meter = Meter(nodes_of(run))
    meter.look()
    page = lines(meter, columns, rows)
    assert len(page) <= rows and max(map(len, page)) <= columns, page


@pytest.mark.parametrize(("rows", "least"), [(24, 4), (22, 4), (20, 3), (18, 2)])
def test_a_low_screen_has_parameters_and_says_how_many_more(
    run: Run, rows: int, least: int
) -> None:
    meter = Meter(nodes_of(run))
    meter.look()
    page = lines(meter, 80, rows)
    at = next(i for i, line in enumerate(page) if line.startswith("parameter"))
    whole = len(meter.leader.live.block.description["initial"])
    shown = [line for line in page[at + 1 :] if not line.startswith("...")]
    more = [f"... {whole - len(shown)} more"] if len(shown) < whole else []
    assert len(shown) >= least and page[at + 1 + len(shown) :] == more, page
    assert any(line.startswith("frame ") for line in page), page


def test_a_terminal_is_given_back_as_it_was(run: Run) -> None:
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    before = termios.tcgetattr(theirs)
    environment = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
    top = subprocess.Popen(
        [program(), "top", "--node", run.node, "--every", "100ms"],
        cwd=ROOT,
        stdin=theirs,
        stdout=theirs,
        stderr=subprocess.PIPE,
        env=environment | {"TERM": "xterm"},
    )
    seen = b""

    def until_seen(text: bytes) -> None:
        nonlocal seen
        while text not in seen:
            seen += os.read(ours, 65536)

    until_seen(b"\x1b[?1049h")  # the other screen
    until_seen(b"cycle")
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 12, 40, 0, 0))
    seen = b""
    until_seen(b"executive")
    os.write(ours, b"q")
    until_seen(b"\x1b[?1049l")
    assert top.wait(DEADLINE_S) == 0, top.communicate()
    assert termios.tcgetattr(theirs) == before
    os.close(ours)
    os.close(theirs)


def test_without_a_terminal_it_prints_a_screen_an_interval_until_ctrl_c(run: Run) -> None:
    top = pcpc("top", "--node", run.node, "--every", "50ms")
    assert top.stdout is not None
    heads = 0
    while heads < 3:
        heads += top.stdout.readline().startswith("hull  pd  real")
    top.send_signal(signal.SIGINT)
    _, err = top.communicate(timeout=DEADLINE_S)
    assert (top.returncode, err) == (130, "interrupted\n"), f"{top.returncode}: {err}"


def test_what_is_not_there_is_told(capsys: Screen) -> None:
    assert main(["top", "--once", "--node", "nowhere.executive"]) == 4
    assert capsys.readouterr().err.startswith("nowhere.executive: no such node is running")
    capsys.readouterr()
    assert main(["top", "--every", "5x"]) == 2
    assert capsys.readouterr().err.startswith("--every 5x: not a duration")
    assert main(["top", "", "--once"]) == 2
    assert capsys.readouterr().err.startswith("'' is not a rig; ")
    assert main(["top", "no such rig"]) == 2
    assert "no file and no rig" in capsys.readouterr().err


# A node that only hands out its memory

NAMES = ["supervisor.status_word", *(f"timing.wake_late_{x}_us" for x in ("p50", "p99", "max")),
         "a.e_rad", "a.gain"]  # fmt: skip
HEAD = {
    "variables": [
        *([name, "", "supervisor", "loop", ""] for name in NAMES[:4]),
        ["a.e_rad", "rad", "output", "a", ""], ["a.gain", "", "parameter", "a", ""],
    ],
    "ranges": {"a.gain": [0.0, 9.0]}, "initial": {"a.gain": 1.0}, "blocks": ["a"],
    "state_columns": ["a.e_rad"], "timing_columns": [], "period_ns": 1_000_000, "rig": "stand",
    "node": "executive", "watch": None, "cycles": 5000, "frames": {"16": "FB", "32": "CMD"},
    "metadata": {"controller": "pd", "pacing": "real", "bus": "vcan9"},
    "state_names": list(STATE_NAMES), "fault_names": list(FAULT_NAMES),
    "attachments": {"rig-resolved.yaml": "bus: {bitrate: 1000000}\n"},
}  # fmt: skip


@pytest.fixture
def stand() -> Iterator[str]:
    yield f"shown.{os.getpid()}.executive"
    standing.end_all()


def begin(name: str) -> sh.NodeMemory:
    block = standing.stand(name, HEAD)
    block.control.passes = 1
    block["snapshot"][0] = Power.OPERATION_ENABLED.word | WARNING
    block.control.state = State.RUN
    return block


def test_frames_are_counted_by_what_the_check_made_of_them(stand: str) -> None:
    block = begin(stand)
    meter = Meter({stand: live.find(stand)})
    states = [(16, 1, FrameState.OK)] * 7 + [
        (16, 1, FrameState.OK_SOME_LOST),
        (16, 1, FrameState.REPEATED),
        (16, 1, FrameState.ERROR),
    ]
    for i, (number, received, state) in enumerate(
        [*states, (32, 0, FrameState.OK), (32, 1, FrameState.OK)]
    ):
        block["frame"][i, 3] = number | 8 << 32 | received << 40 | state << 48
    block.ends("frame").head = 12
    for i, x in enumerate((0.5, -3.0, 0.25)):
        block["record"][i] = i, 0, sh.CDR_HEADER, np.float64(x).view(np.int64), sh.CDR_HEADER
    block.ends("record").head = 3
    block["snapshot"][4] = 0.25
    meter.look()
    page = [line.split() for line in lines(meter, 80, 24)]
    frames = {words[0]: words[3:] for words in page if words[:1] in (["FB"], ["CMD"])}
    assert frames == {"FB": ["8", "1", "1", "1"], "CMD": ["1", "0", "0", "0"]}, page
    assert ["a.e_rad", "[rad]", "0.25", "3", "3"] in page, page
    assert meter.bits_per_s() * meter.over_s == 12 * 135, "a frame of 8 bytes has at most 135 bits"


def test_a_fault_is_told_in_its_words(stand: str) -> None:
    block = begin(stand)
    block.control.state, block.control.fault = State.FAULT, Fault.BUS_FAILED
    block["snapshot"][0] = Power.FAULT_REACTION_ACTIVE.word
    meter = Meter({stand: live.find(stand)})
    meter.look()
    page = lines(meter, 80, 24)
    assert "fault: executive: the bus failed" in page, page
    assert any(line.startswith("executive FAULT fault reaction") for line in page), page


def test_it_goes_on_with_the_next_run(stand: str) -> None:
    begin(stand)
    top = pcpc("top", "--node", stand.removesuffix(".executive"), "--every", "20ms")
    assert top.stdout is not None

    def until_line(begins: str) -> str:
        assert top.stdout is not None
        while not (line := top.stdout.readline()).startswith(begins):
            assert line, top.communicate()
        return line

    until_line("stand  pd  real")
    standing.end(stand)
    told = until_line(stand.removesuffix(".executive"))
    assert told.endswith(": ended in cycle 0; waiting for a run\n"), told
    begin(stand)
    until_line("stand  pd  real")
    top.send_signal(signal.SIGINT)
    top.communicate(timeout=DEADLINE_S)
    assert top.returncode == 130
