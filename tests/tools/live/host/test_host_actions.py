"""What the page asks of several nodes, and what its server does when it cannot follow a run."""

import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
import standing
from hosting import LONG
from processes import own_bus, until

import pcpc
from pcpc.drivers.errors import UserError
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.live import Live
from pcpc.tools.live.host import client_messages as messages
from pcpc.tools.live.host.actions import Actions
from pcpc.tools.live.host.commands import BesideRun, PageOfRun, PageRequest
from pcpc.tools.live.host.display import Display
from pcpc.tools.live.host.run_page import Page
from pcpc.tools.live.host.sources import FollowedRun, RunSource
from pcpc.tools.terminal.request import Offers

ROLES = ("executive", "local", "plant")  # as the page has them
STATE, RESET = "supervisor.state", "supervisor.reset"


@pytest.fixture
def blocks() -> Iterator[dict[str, sh.NodeMemory]]:
    """Return what three nodes of a rig write, by role."""
    made = {}
    for role in ROLES:
        about = {
            "variables": [[name, "", "", "", ""] for name in (STATE, RESET)],
            "ranges": {RESET: [0.0, 1.0]}, "state_columns": [], "timing_columns": [],
            "period_ns": 1_000_000, "rig": "stand", "node": role, "sources": {}, "frames": {},
            "metadata": {}, "attachments": {}, "files": [], "blocks": [],
        }  # fmt: skip
        made[role] = standing.stand(f"reset.{os.getpid()}.{role}", about)
    yield made
    standing.end_all()


def actions(blocks: dict[str, sh.NodeMemory]) -> Actions:
    nodes = {role: SimpleNamespace(live=Live(sharing.attach(b.name))) for role, b in blocks.items()}
    source = RunSource("stand", True, nodes)
    return Actions(lambda: source, write=True)


@pytest.mark.parametrize("faulted", [ROLES, ("executive", "plant"), ("local",)])
def test_nodes_in_fault_are_reset_from_the_lowest_up(
    blocks: dict[str, sh.NodeMemory], faulted: tuple[str, ...]
) -> None:
    for role in faulted:
        blocks[role]["snapshot"][0] = State.FAULT
    with standing.granting(*blocks.values()) as granted:
        actions(blocks).do(messages.Act(1, "reset"))
    order = [role for role in ("plant", "local", "executive") if role in faulted]
    assert granted == [(blocks[role].name, {RESET: 1.0}) for role in order]


def test_without_a_fault_nothing_is_reset(blocks: dict[str, sh.NodeMemory]) -> None:
    with pytest.raises(UserError, match="no node is in FAULT"):
        actions(blocks).do(messages.Act(1, "reset"))
    assert not any(block.mail.request for block in blocks.values())


def test_what_is_told_is_made_anew_once_more_was_recorded() -> None:
    with pcpc.running("slew10", pacing="real", set=LONG, bus=own_bus()) as live:
        node = live._nodes["plant"]
        stage = Display(FollowedRun(node=node.name), PageRequest(), [])
        until(lambda: stage.find() or stage.source.nodes, "the run is found")
        told = []
        for _ in range(3):
            stage.poll()
            told.append(stage.status()[0]["nodes"]["plant"]["cycle"])
            assert stage.status()[0]["nodes"]["plant"]["cycle"] == told[-1]  # for all clients
            node.wait_until(lambda now: now.cycle > told[-1], 60.0)
        stage.close()
    assert told == sorted(set(told)), told


def test_a_server_that_cannot_follow_ends_with_the_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    beside = Offers(BesideRun(host=True, page=PageOfRun(port=0)))

    def fails(stage: Display) -> None:
        raise ValueError("the ring is torn")

    monkeypatch.setattr(Display, "poll", fails)
    with Page(beside, {"executive": "nobody.executive"}) as page:
        page.start()
        said = until(page.ended, "the page ends")
    assert said.startswith("the page has ended: ValueError: the ring is torn; the run goes on")
