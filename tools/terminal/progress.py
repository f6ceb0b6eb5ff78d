"""Progress on stderr: a line that changes in place on a terminal, else one every few seconds.

While nothing but the time changes, as in a long wait, lines become rarer.
"""

import re
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from pcpc.drivers.compiled import compile_cache
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.ring_layout import OfRecord

_IN_PLACE_S = 0.1
_LINES_S, _RAREST_S = 2.0, 120.0
_TIME = re.compile(r"\d+ s$")
_PATIENCE_S = 1.0
_COMPILING_S = 5.0


class Progress:
    """Shows `text` at a bearable rate; `quiet` shows nothing."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet
        self._terminal = sys.stderr.isatty()
        self._next_s = 0.0
        self._open = False
        self._last, self._every_s, self._again_s = "", _LINES_S, 0.0

    def due(self) -> bool:
        """Return True when a new text would be shown now."""
        return not self._quiet and time.monotonic() >= self._next_s

    def show(self, text: str) -> None:
        """Show `text` in place of the last one."""
        if not self.due():
            return
        now_s = time.monotonic()
        self._next_s = now_s + (_IN_PLACE_S if self._terminal else _LINES_S)
        if not self._terminal and self._waits(text, now_s):
            return
        if self._terminal:
            sys.stderr.write(f"\r\x1b[K{text}")
            self._open = True
        else:
            sys.stderr.write(f"{text}\n")
        sys.stderr.flush()

    def _waits(self, text: str, now_s: float) -> bool:
        """Return whether a text says nothing new but the time, and it is too soon for that."""
        same = (words := _TIME.sub("", text)) == self._last and words != text
        if same and now_s < self._again_s:
            return True
        self._last = words
        self._every_s = min(2.0 * self._every_s, _RAREST_S) if same else _LINES_S
        self._again_s = now_s + self._every_s
        return False

    @contextmanager
    def going_on(self, text: str) -> Iterator[None]:
        """Show `text`, and for how long, while something runs that cannot tell how far it is."""
        begin_s, over = time.monotonic(), threading.Event()

        def tell() -> None:
            while not over.wait(_PATIENCE_S):
                self.show(f"{text}, {time.monotonic() - begin_s:.0f} s")

        teller = threading.Thread(target=tell, name="progress", daemon=True)
        teller.start()
        try:
            yield
        finally:
            over.set()
            teller.join()

    def say(self, text: str) -> None:
        """Print a line that stays."""
        if not self._quiet:
            self.close()
            print(text, file=sys.stderr, flush=True)

    def close(self) -> None:
        """End the line that changes in place."""
        if self._open:
            print(file=sys.stderr, flush=True)
            self._open = False


class Compiling:
    """Says that code is compiled, by this process or by children, and how much of it is done."""

    def __init__(self) -> None:
        self._begin_s, self._since_s = time.monotonic(), time.time()
        self._had = not compile_cache.is_empty()

    def text(self) -> str:
        """Return what is said now; "" when nothing is compiled."""
        done = compile_cache.count(self._since_s)
        return self._words(done) if done or not self._had else ""

    def told(self, quiet: bool) -> None:
        """From here on say it when this process compiles, in lines that stay."""
        progress, next_s = Progress(quiet), self._begin_s + compile_cache.SHORT_S

        def say(done: int, holder: str = "") -> None:
            nonlocal next_s
            if holder:
                progress.say(f"waiting for process {holder}, which is compiling the same code")
            elif (done or not self._had) and time.monotonic() >= next_s:
                next_s = time.monotonic() + _COMPILING_S
                progress.say(self._words(done))

        compile_cache.watch.listener = say

    def _words(self, done: int) -> str:
        total = compile_cache.FUNCTIONS if not self._had else 0  # of the barrel; others have more
        of_all = f" of about {total}" if done <= total else ""
        spent = time.monotonic() - self._begin_s
        what = "function" if done == 1 and not of_all else "functions"
        return f"compiling for this machine, once: {done}{of_all} {what}, {spent:.0f} s"


def node_line(block: sh.NodeMemory, total: str) -> str:
    """Return state, cycle, rate and the rig's watched variable of a running node, in one line."""
    control = block.control
    state = block.description["state_names"][int(control.state)]
    done, late = int(control.cycle) + 1, int(control.late)
    rate = _rate_hz(block)
    return f"{state:5} cycle {done}{total}  {rate:.0f} Hz{_watched_text(block)}  late {late}"


def _watched_text(block: sh.NodeMemory) -> str:
    name = block.description["watch"]
    names = [v[0] for v in block.description["variables"]]
    if name not in names:
        return ""
    try:
        value = sh.snapshot(block)[names.index(name)]
    except sh.SharedError:  # it died in mid-write; the host will say so
        return ""
    return f"  {name} {value:+.6f}"


def _rate_hz(block: sh.NodeMemory) -> float:
    """Return the mean rate over the newest thousand records."""
    ends, rows = block.ends("record"), block["record"]
    put = int(ends.head)
    count = min(put - 1, 1000)
    if count < 1:
        return 0.0
    stamps = [int(rows[(put - 1 - back) % len(rows), OfRecord.STAMP_NS]) for back in (0, count)]
    return 1e9 * count / max(stamps[0] - stamps[1], 1)
