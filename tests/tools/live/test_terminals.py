"""What a terminal of another machine knows a node by."""

import json
import os

import standing
from scoped import HEAD

from pcpc.executive.loop import sharing
from pcpc.executive.nodes.live import Live
from pcpc.tools.live.host import client_messages as messages
from pcpc.tools.live.host.terminals import Terminal


def test_a_later_run_of_a_name_is_another_node_and_the_one_before_still_answers() -> None:
    name = f"handled.{os.getpid()}.executive"
    there: dict[str, Live] = {}
    terminal = Terminal(lambda: there, write=False)
    try:
        for process in (1, 2):
            about = HEAD | {"cycles": process}
            standing.stand(name, about).control.pid = process
            there[name] = Live(sharing.attach(name))
            assert json.loads(terminal.answer(messages.Nodes(1)))["nodes"] == [f"{name}@{process}"]
    finally:
        standing.end_all()
    for process in (1, 2):
        told = json.loads(terminal.answer(messages.Describe(1, f"{name}@{process}")))
        assert told["about"]["cycles"] == process
