"""`--at`: every cycle comes over the line, and what does not is counted."""

import os
from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import standing
from hosting import Host, hosting
from live_run import Screen, there
from scoped import CAPTURED, HEAD, WORDS, stepping

from pcpc.executive.log import reader as logs
from pcpc.executive.loop import shared as sh
from pcpc.executive.nodes.tap import Tap
from pcpc.tools.live import scope
from pcpc.tools.live.remote.link import Link
from pcpc.tools.live.remote.live import RemoteNodes


@pytest.mark.parametrize("jump", [0, 300_000])
def test_what_was_overwritten_before_it_was_sent_is_a_loss(
    jump: int, capsys: Screen, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, file = f"scoped.at{os.getpid()}.executive", tmp_path / "burst.mcap"
    _, go_on = stepping(name, jump)
    monkeypatch.setattr(scope, "time", SimpleNamespace(sleep=go_on, monotonic=lambda: 0.0))
    try:
        with hosting(tmp_path / "host", "--node", name) as other:
            monkeypatch.setenv("PCPC_TOKEN", other.token)
            code, out, _ = there(capsys, other, *WORDS, "-o", str(file))
    finally:
        standing.end_all()
    assert code == (3 if jump else 0), out
    assert ("cycles lost" in out) == bool(jump), out
    if not jump:
        assert logs.read(file).node["executive"].cycle.tolist() == CAPTURED


def test_many_rows_come_in_several_answers_and_none_is_missing(
    capsys: Screen, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, count = f"many.at{os.getpid()}.executive", 100_000
    block = standing.stand(name, HEAD)
    rows = block["record"][:count]
    rows[:, 0] = rows[:, 1] = np.arange(count)
    rows[:, 3] = np.where(np.arange(count) == count - 1, 1.0, 0.0).view(np.int64)
    block.control.cycle, block.ends("record").head = count - 1, count
    file = tmp_path / "burst.mcap"
    words = ["scope", "a.x", "--trigger", "a.x > 0.5 rad", "--pre", "95s", "--post", "0s", "--past",
             "-o", str(file), "--quiet"]  # fmt: skip
    try:
        with hosting(tmp_path / "host", "--node", name) as other:
            monkeypatch.setenv("PCPC_TOKEN", other.token)
            code, out, err = there(capsys, other, *words)
    finally:
        standing.end_all()
    assert code == 0, out + err
    cycle = logs.read(file).node["executive"].cycle
    assert cycle.tolist() == [*range(count - 1 - 95_000, count)]


class Between(Link):
    """A line on whose other end the ring comes round behind the first rows that were sent."""

    def __init__(self, host: Host, block: sh.NodeMemory) -> None:
        super().__init__(Namespace(at=host.name, token_file=None, ca=None, plain=False))
        self._block, self.first = block, True

    def ask(self, what: str, **about: Any) -> Any:
        """Ask, and go on there."""
        found = super().ask(what, **about)
        if what == "rows" and self.first:
            self._block.ends("record").head += len(self._block["record"])
            self.first = False
        return found


def test_a_gap_between_two_answers_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = f"gap.at{os.getpid()}.executive"
    block = standing.stand(name, HEAD)
    size = len(block["record"])
    block["record"][:, 0] = np.arange(size)
    block.ends("record").head = size - 1
    try:
        with hosting(tmp_path / "host", "--node", name) as other:
            monkeypatch.setenv("PCPC_TOKEN", other.token)
            link = Between(other, block)
            node = RemoteNodes(link).find(name)
            tap = Tap(node, past=True)
            first = tap.rows().cycle
            begin = size - 1 - 3 * size // 4
            assert 1000 < len(first) < size // 4 and tap.missed["record"] == 0
            assert first.tolist() == [*range(begin, begin + len(first))]
            rest = tap.rows()
            end = int(block.ends("record").head)
            assert tap.missed["record"] + len(first) + len(rest) == end - begin
            assert len(rest) == size - 1
            link.close()
    finally:
        standing.end_all()
