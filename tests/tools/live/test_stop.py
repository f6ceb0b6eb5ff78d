"""`pcpc stop` and `pcpc operate reset` on a real run, of a rig whose name nobody else has."""

import fcntl
import json
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from processes import DEADLINE_S, ROOT, own_bus

import pcpc
from pcpc.drivers.compiled.structures import words_of
from pcpc.drivers.errors import Exit
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.requests import SLOTS
from pcpc.executive.nodes.live import LiveError, find, running
from pcpc.tools.cli import main
from pcpc.tools.start import rigs

PATIENT = "hold_cycles: 100000, fault_after_cycles: 100000"
NAME = f"stopped-{os.getpid()}"
LAW = "controllers: {proportional: {law: 'law.py:BLOCK'}}"


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """Write a rig whose faults wait."""
    path = tmp_path / "rig.yaml"
    base = ROOT / "plants/probe/rig.yaml"
    law = base.with_name("law.py").read_text()
    assert ", 0.0, 100.0)" in law
    (tmp_path / "law.py").write_text(law.replace(", 0.0, 100.0)", ", 0.0, 1e308)"))
    stops = f"supervisor: {{{PATIENT}, on_fault: wait}}"
    name, rate = f"rig: {NAME}", "rate_hz: 200.0\nduration_s: 600.0"
    path.write_text(f"base: {base}\n{name}\n{rate}\n{stops}\n{LAW}\n")
    return path


@pytest.fixture
def live(rig: Path, tmp_path: Path) -> Iterator[pcpc.Live]:
    with pcpc.running(rig, bus=own_bus(), folder=tmp_path / "run") as run:
        yield run


def said(screen: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    """Return the exit code of a command and what it printed."""
    code = main(list(words))
    shown = screen.readouterr()
    return code, shown.out + shown.err


def test_a_run_goes_on_after_a_reset_and_ends_with_a_stop_also_when_locked(
    live: pcpc.Live, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, text = said(capsys, "operate", "reset", str(rig))
    assert code == Exit.NOT_MET and "no fault" in text, text
    live.set({"controller.gain": 1e308, "controller.target": 10.0})
    live.wait_until(lambda now: now["supervisor.gain"] == 0.0, within_s=DEADLINE_S)
    assert live.state == "FAULT"
    code, text = said(capsys, "operate", "reset", str(rig))
    assert code == Exit.NOT_MET and "still there: a command was not" in text, text
    live.set({"controller.gain": 4.0, "controller.target": 1.0})
    code, text = said(capsys, "operate", "reset", str(rig), "--json")
    assert code == Exit.OK and next(iter(json.loads(text))).endswith(".executive"), text
    live.wait_until(lambda now: now["supervisor.gain"] == 1.0, within_s=DEADLINE_S)
    assert live.state in ("RUN", "HOLD")
    assert main(["operate", "lock", "all", "--node", find("executive", NAME).name]) == Exit.OK
    code, text = said(capsys, "stop", NAME, "--quick")
    assert code == Exit.OK and "in cycle" in text, text
    live.wait(DEADLINE_S)
    assert live.run.verdict.startswith("safety stop"), "it had a fault"


def test_a_run_is_called_by_its_rigs_name_its_own_or_its_rigs_file(
    live: pcpc.Live,
    rig: Path,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    run = find("executive", NAME).run
    for word in (NAME, run, str(rig), ".", "rig.yaml"):
        code, text = said(capsys, "operate", "reset", word)
        assert code == Exit.NOT_MET and text.startswith("no fault: "), (word, text)
        code, text = said(capsys, "top", word, "--once")
        assert code == Exit.OK and text.startswith(f"{NAME} "), (word, text)
        assert Path(rigs.find(word)).resolve() == rig.resolve(), (
            "what takes a rig takes that of a run"
        )
    code, text = said(capsys, "stop", f"{NAME}.vcan99")
    assert code == Exit.WRONG_INPUT and "no file and no rig of this name" in text, text
    assert find(run).name == find(NAME).name == f"{run}.executive"
    code, text = said(capsys, "save", "my tuned.yaml", "--node", run)
    assert code == Exit.OK, text
    saved = (tmp_path / "my tuned.yaml").read_text()
    assert "# in a new run: pcpc run rig.yaml --set '@my tuned.yaml'\n" in saved, saved


def test_of_two_runs_of_a_rig_each_has_its_name(
    live: pcpc.Live, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pcpc.running(rig, bus=own_bus(), folder=tmp_path / "other") as other:
        runs = sorted(one.run for one in running(NAME).values())[::2]
        code, text = said(capsys, "stop", NAME)
        assert code == Exit.WRONG_INPUT and f"2 runs of this rig; choose {runs[0]} or" in text
        mine = next(run for run in runs if other._nodes["plant"].run == run)
        code, text = said(capsys, "stop", mine, "--quick")
        assert code == Exit.OK, text
        other.wait(DEADLINE_S)
    assert {one.run for one in running(NAME).values()} == {*runs} - {mine}, "the other goes on"


SOME_WORDS = 16  # of a field
EXTREMES = (2**63 - 1, -(2**63), -1, 1, 2**62, SLOTS + 1)


def test_a_stop_ends_a_run_whatever_stands_in_any_word_of_the_mailbox(
    live: pcpc.Live, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    node = find("executive", NAME)
    refused = 0
    for field in sh.MAILBOX_FIELDS:
        words = words_of(node.block[field])
        for place in range(min(len(words), SOME_WORDS)):
            for extreme in EXTREMES:
                words[place] = extreme
                try:
                    assert node.tune({"controller.gain": 3.0}) > 0
                except LiveError as error:
                    assert "locked" in str(error), (field, place, extreme, error)
                    refused += 1
                node.block.mail.lock = 0
    assert refused == len(EXTREMES), "as often as there was a lock"
    for field in sh.MAILBOX_FIELDS:
        words_of(node.block[field])[:] = 2**63 - 1
    code, text = said(capsys, "set", "controller.gain=2", "--node", node.name)
    assert (code, "locked (all)" in text) == (Exit.WRONG_INPUT, True), text
    code, text = said(capsys, "stop", str(rig))
    assert code == Exit.OK and "in cycle" in text, text
    live.wait(DEADLINE_S)


def test_a_stop_ends_a_run_while_another_client_holds_the_mailbox_and_writes(
    live: pcpc.Live, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    node, over = find("executive", NAME), threading.Event()
    assert node.block.client is not None
    holder = os.open(f"/proc/self/fd/{node.block.client.mailbox}", os.O_RDONLY)
    fcntl.flock(holder, fcntl.LOCK_EX)

    def write() -> None:
        while not over.wait(1e-3):
            node.block["mail_index"][:] = -1
            node.block.mail.count = 0
            node.block.mail.request += 1

    writer = threading.Thread(target=write)
    writer.start()
    try:
        code, text = said(capsys, "stop", str(rig))
        assert code == Exit.OK and "in cycle" in text, text
        live.wait(DEADLINE_S)
        fcntl.flock(holder, fcntl.LOCK_UN)
    finally:
        over.set()
        writer.join()
        os.close(holder)


def test_a_request_that_another_client_empties_is_no_stop(
    live: pcpc.Live, rig: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    node, over = find("executive", NAME), threading.Event()

    def write() -> None:
        while not over.is_set():
            node.block.mail.count = 0

    writer = threading.Thread(target=write)
    writer.start()
    try:
        code, text = said(capsys, "stop", str(rig))
        assert code == Exit.OK and "in cycle" in text, text
        live.wait(DEADLINE_S)
    finally:
        over.set()
        writer.join()
