"""Claims: one holder on the machine, known, gone with its process; no turn is awaited for ever."""

import os
import signal
import subprocess
import sys
import threading

import pytest
from places import ROOT

from pcpc.drivers.machine import claim

HOLD = """
import sys
from pcpc.drivers.machine import claim
held = claim.hold(sys.argv[1])
print(held is not None, flush=True)
sys.stdin.read()
"""
TAKE = """
import sys
from pcpc.drivers.machine import claim
sys.stdin.read(1)
held = [claim.hold(f"{sys.argv[1]}/{i}") for i in range(200)]
print(200 - held.count(None), flush=True)
sys.stdin.read()
"""


def own_name(text: str) -> str:
    return f"test/{os.getpid()}/{text}"


def start(script: str, *words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", script, *words],
        cwd=ROOT,
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )


@pytest.mark.parametrize("text", ["short", "long" * 60, "é" * 90], ids=["short", "long", "wide"])
def test_a_claim_has_one_holder_who_is_known_and_whose_death_frees_it(text: str) -> None:
    name = own_name(text)
    with start(HOLD, name) as other:
        assert other.stdout is not None and other.stdout.readline() == "True\n"
        assert claim.hold(name) is None
        assert claim.holder(name) == claim.Holder(other.pid, os.getuid())
        other.send_signal(signal.SIGKILL)
        other.wait()
        mine = claim.hold(name)
        assert mine is not None and claim.holder(name) == claim.Holder(os.getpid(), os.getuid())
        mine.close()
    assert claim.holder(name) is None


def test_of_two_processes_that_ask_at_once_exactly_one_gets_each_name() -> None:
    name = own_name("race")
    with start(TAKE, name) as one, start(TAKE, name) as two:
        for process in (one, two):
            assert process.stdin is not None
            process.stdin.write("!")
            process.stdin.flush()
        got = [int(process.stdout.readline()) for process in (one, two) if process.stdout]
        assert sum(got) == 200, f"{got} of 200 names"


def test_what_is_held_is_listed_by_its_beginning() -> None:
    names = [own_name("list/b"), own_name("list/a b"), own_name("other")]
    claims = [claim.hold(name) for name in names]
    found = claim.held_names(own_name("list/"))
    for one in claims:
        assert one is not None
        one.close()
    assert found == sorted(names[:2]) and claim.held_names(own_name("")) == [], f"{found}"


def test_turns_follow_each_other() -> None:
    busy, order = threading.Event(), []

    def first() -> None:
        with claim.turn():
            busy.set()
            order.append("first in")
            order.append("first out")

    thread = threading.Thread(target=first)
    thread.start()
    busy.wait()
    with claim.turn():
        order.append("second in")
    thread.join()
    assert order == ["first in", "first out", "second in"], f"{order}"


def test_a_turn_that_is_never_given_back_stops_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(claim, "_TURN_S", 0.05)
    kept = claim.hold("turn")
    assert kept is not None
    with kept, claim.turn():
        assert claim.hold("turn") is None
