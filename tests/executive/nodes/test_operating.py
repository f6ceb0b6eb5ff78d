"""What an operator is refused, before anything is asked of the loop."""

import os
from collections.abc import Iterator

import pytest
import standing

from pcpc.drivers.errors import Exit
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.loop.states import State
from pcpc.executive.nodes import operating
from pcpc.executive.nodes.live import Live, LiveError

NAMES = ("supervisor.state", "supervisor.disarmed", "handover.in_charge", "handover.to",
         "handover.usable_pd", "handover.usable_pid")  # fmt: skip
ABOUT = {
    "variables": [[name, "", "", "", ""] for name in NAMES],
    "ranges": {name: [0.0, 1.0] for name in NAMES}, "state_columns": [], "timing_columns": [],
    "period_ns": 1_000_000, "rig": "stand", "node": "executive", "sources": {}, "frames": {},
    "metadata": {}, "attachments": {}, "files": [], "blocks": [], "state_names": [],
    "fault_names": ["", "no valid input"], "watch": "", "cycles": 0, "laws": ["pd", "pid"],
}  # fmt: skip


@pytest.fixture
def block() -> Iterator[sh.NodeMemory]:
    """Return what a node writes, whose name is in its description."""
    name = f"operated.{os.getpid()}.executive"
    yield standing.stand(name, ABOUT)
    standing.end_all()


def saying(block: sh.NodeMemory, **values: float) -> Live:
    """Return the node as its clients see it, with values by the ends of their names, else 0."""
    ends = [name.rpartition(".")[2] for name in NAMES]
    block["snapshot"][:] = [values.get(end, 0.0) for end in ends]
    return Live(sharing.attach(block.name))


@pytest.mark.parametrize(
    ("state", "disarmed", "says", "code"),
    [
        (State.FAULT, 1.0, "FAULT, no valid input; `pcpc operate reset` first", Exit.NOT_MET),
        (State.INIT, 1.0, "waits for the other node; try again later", Exit.NOT_MET),
        (State.RUN, 0.0, "the loop is already closed", Exit.WRONG_INPUT),
    ],
)
def test_who_cannot_be_armed_says_why(
    block: sh.NodeMemory, state: int, disarmed: float, says: str, code: Exit
) -> None:
    node = saying(block, state=state, disarmed=disarmed)
    block.control.fault = 1
    with pytest.raises(LiveError) as refused:
        operating.arm(node)
    assert (str(refused.value), refused.value.code) == (f"{node.name}: {says}", code)
    assert node.block.mail.request == 0, "something was asked all the same"


def test_who_is_disarmed_is_not_held_again(block: sh.NodeMemory) -> None:
    node = saying(block, state=State.READY, disarmed=1.0)
    with pytest.raises(LiveError, match="already open"):
        operating.hold(node)
    assert node.block.mail.request == 0


def test_a_law_that_says_no_number_is_not_asked_for(block: sh.NodeMemory) -> None:
    node = saying(block, state=State.RUN, usable_pd=1.0)
    with pytest.raises(LiveError) as refused:
        operating.hand_over(node, "pid")
    says = "pid cannot take over: one of its outputs is not finite; pd stays in charge"
    assert (str(refused.value), refused.value.code) == (f"{node.name}: {says}", Exit.NOT_MET)
    assert node.block.mail.request == 0


def test_a_hand_over_that_the_loop_refuses_takes_its_wish_back(block: sh.NodeMemory) -> None:
    node = saying(block, state=State.RUN, usable_pd=1.0, usable_pid=1.0)
    with standing.granting(block) as granted, pytest.raises(LiveError) as refused:
        operating.hand_over(node, "pid")  # whose outputs are no numbers from the next cycle on
    assert "pid cannot take over" in str(refused.value) and refused.value.code == Exit.NOT_MET
    assert [values for _, values in granted] == [{"handover.to": 1.0}, {"handover.to": 0.0}]


def test_a_wish_of_before_is_taken_back_to_be_asked_again(block: sh.NodeMemory) -> None:
    node = saying(block, state=State.RUN, usable_pd=1.0, usable_pid=1.0, to=1.0)
    with standing.granting(block) as granted, pytest.raises(LiveError):
        operating.hand_over(node, "pid")
    wishes = [values["handover.to"] for _, values in granted]
    assert wishes == [0.0, 1.0, 0.0], "only a change is a wish"
