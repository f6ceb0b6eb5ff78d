"""Running nodes from outside: found, read without disturbing them, tuned, waited for.

    live = find("executive")                       of this user, on this machine
    live["controller.e_rad"]                       the newest value
    now = live.read()                              all values of one cycle: now["barrel.theta_rad"]
    live.tune({"controller.kv_Nms_rad": 120.0})    all or none; returns the first cycle with them
    live.wait_until(lambda now: abs(now["controller.e_rad"]) < 1e-3, within_s=5.0)

Reading copies a table that the node publishes (seqlock: the node never waits). Tuning writes into
its mailbox, see `executive.nodes.mailbox`. No numba in here: it is there in a quarter of a second.
"""

import math
import re
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import did_you_mean
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.loop.requests import SLOTS
from pcpc.executive.nodes.mailbox import (
    LEVELS,
    PATIENCE_S,
    POLL_S,
    STOP,
    LiveError,
    Mailbox,
    pause,
)
from pcpc.executive.nodes.rings import rows_of

_SLICE_S = 0.05  # how soon the end of a loop is noticed; that of its process is at once
_GLOB = re.compile(r"[*?\[]")


@dataclass(frozen=True)
class LiveVariable:
    """What a node says about one of its variables; only parameters have a range."""

    name: str
    unit: str
    kind: str
    writer: str
    help: str
    range: tuple[float, float] | None = None

    def shown(self, value: float) -> str:
        """Return a value with its unit."""
        return f"{value:.9g} {self.unit}".rstrip()


class CycleValues(Mapping[str, float]):
    """All variables of a node, as they were at the end of one cycle."""

    def __init__(self, cycle: int, places: Mapping[str, int], values: NDArray[np.float64]) -> None:
        self.cycle, self._places, self._values = cycle, places, values

    @property
    def array(self) -> NDArray[np.float64]:
        """All of them, (n,), in the order of the node's variables."""
        return self._values

    def __getitem__(self, name: str) -> float:
        return float(self._values[self._places[known_name(name, self._places)]])

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


class Live:
    """A running node. What it reads is a cycle old at the most; LiveError where it has ended."""

    def __init__(self, block: sh.NodeMemory) -> None:
        description = block.description
        self.block, self.name, self.period_ns = block, block.name, int(description["period_ns"])
        self.variables = {
            name: LiveVariable(
                name, unit, kind, writer, help, _pair(description["ranges"].get(name))
            )
            for name, unit, kind, writer, help in description["variables"]
        }
        self._places = {name: place for place, name in enumerate(self.variables)}
        self._mailbox = Mailbox(block)

    # Reading

    @property
    def running(self) -> bool:
        """Whether its loop runs; one that waits for the other node does."""
        return self.block.alive() and not self.ended

    @property
    def ended(self) -> bool:
        """Whether its loop has ended, in good order; its process stays until it is let go."""
        return bool(self.block.control.done)

    @property
    def ready(self) -> bool:
        """Whether it is set up, and looks for the other node."""
        return bool(self.block.control.ready)

    @property
    def under_way(self) -> bool:
        """Whether it has done a cycle."""
        return bool(self.block.control.passes)

    @property
    def recorded(self) -> bool:
        """Whether a recorder has its memory."""
        return bool(self.block.control.recorded)

    @property
    def run(self) -> str:
        """Its run, RIG.BUS."""
        return self.name.rpartition(".")[0]

    @property
    def names(self) -> set[str]:
        """What it may be called: in full, by its role, RIG.ROLE; the executive RIG and RIG.BUS."""
        rig, role = str(self.block.description.get("rig")), self.name.rpartition(".")[2]
        return {self.name, role, f"{rig}.{role}", *([rig, self.run] if role == "executive" else [])}

    def is_of(self, rig: str) -> bool:
        """Return whether it is of this rig or this run; of "" each is."""
        return rig in ("", self.run, self.block.description.get("rig"))

    @property
    def pid(self) -> int:
        """Its process."""
        return int(self.block.control.pid)

    def __getitem__(self, name: str) -> float:
        return self.read()[name]

    def read(self) -> CycleValues:
        """Return all variables, of one and the same cycle.

        LiveError if the node stands still in the middle of writing them.
        """
        torn = np.empty(0)
        deadline_s = time.monotonic() + PATIENCE_S
        while (values := sh.snapshot(self.block, torn)) is torn:
            if not self.block.alive() or time.monotonic() > deadline_s:
                what = f"{self.name}: is stuck in the middle of a cycle"
                raise LiveError(what, Exit.ENVIRONMENT)
            pause(self.block, POLL_S)
        t_s = values[self._places["time.t_s"]] if "time.t_s" in self._places else 0.0
        return CycleValues(round(float(t_s) * 1e9 / self.period_ns), self._places, values)

    def select(self, words: Sequence[str]) -> list[str]:
        """Return the names that names or patterns (* ? []) choose, in their order, each once.

        LiveError: a name or pattern matches nothing.
        """
        chosen: dict[str, None] = {}
        for word in words:
            if _GLOB.search(word):
                matches = [name for name in self.variables if fnmatchcase(name, word)]
                if not matches:
                    raise LiveError(f"{word}: matches no variable; `pcpc get` shows all")
                chosen |= dict.fromkeys(matches)
            else:
                chosen[known_name(word, self.variables)] = None
        return list(chosen)

    def rows(
        self, ring: str, since: int, columns: Sequence[int] | None = None
    ) -> tuple[NDArray[np.int64], int]:
        """Return rows (n, columns) of a ring and the number of the first; see `nodes.rings`."""
        return rows_of(self.block, ring, since, columns)

    # Waiting

    def every(self, seconds: float) -> Iterator[CycleValues]:
        """Yield the values now and then again and again, no cycle twice, until the node ends."""
        next_s, seen = time.monotonic(), -1
        while self.running:
            now = self.read()
            if now.cycle != seen:
                yield now
            seen = now.cycle
            next_s = max(next_s + seconds, time.monotonic())
            while self.running and (rest_s := next_s - time.monotonic()) > 0:
                pause(self.block, min(rest_s, _SLICE_S))

    def wait_until(
        self, holds: Callable[[CycleValues], bool], within_s: float, what: str = "the condition"
    ) -> CycleValues:
        """Return the values for which `holds` is true first; LiveError if that takes too long.

        It looks once a period: what lasts for a single cycle may be missed, and without a clock
        (lockstep) also what lasts for more. NOT_MET: it was not within `within_s` seconds of this
        machine, or the node ended before.
        """
        deadline_s, seen = time.monotonic() + within_s, -1
        while True:
            is_over = not self.running or time.monotonic() >= deadline_s
            now = self.read()
            if now.cycle != seen and holds(now):
                return now
            if is_over:
                why = f"not within {within_s:g} s" if self.running else "the node ended first"
                raise LiveError(f"{self.name}: {what}: {why}", Exit.NOT_MET)
            seen = now.cycle
            pause(self.block, max(1e-9 * self.period_ns, POLL_S))

    # Tuning

    def tune(self, changes: Mapping[str, float]) -> int:
        """Set parameters, all between the same two cycles or none; return the first with them.

        LiveError: unknown, not a parameter, out of range, too many, locked, no answer. The node
        judges again by itself. A stop alone does not depend on what others do with the mailbox.
        """
        places = self.check(changes)
        if [*changes] == [STOP]:
            return self._mailbox.stop(places[0], changes[STOP])
        return self._mailbox.post(dict(zip(changes, places, strict=True)), [*changes.values()])

    def lock(self, level: str) -> None:
        """Forbid tunings (`tune`, `all`) or allow them (`none`); none is under way on return.

        LiveError: no such level.
        """
        if level not in LEVELS:
            raise LiveError(f"{level}: no such lock level{did_you_mean(level, LEVELS)}")
        self._mailbox.lock(level)

    def check(self, changes: Mapping[str, float]) -> list[int]:
        """Return the places of parameters whose values are in their range; LiveError."""
        if len(changes) > SLOTS:
            raise LiveError(f"{len(changes)} values; at most {SLOTS} apply at once")
        for name, value in changes.items():
            variable = self.variables[known_name(name, self.variables)]
            if variable.range is None:
                problem = f"{variable.kind}, written by {variable.writer} every cycle"
                raise LiveError(f"{name}: {problem}; only parameters can be set")
            low, high = variable.range
            if not (low <= value <= high and math.isfinite(value)):
                problem = f"{name}: {value:.12g} is outside {low:.12g}..{high:.12g} {variable.unit}"
                raise LiveError(problem.rstrip())
        return [self._places[name] for name in changes]


def known_name(name: str, names: Collection[str]) -> str:
    """Return the name of a variable; LiveError with the likeliest one if it is not in `names`."""
    if name not in names:
        raise LiveError(f"{name}: no such variable{did_you_mean(name, names)}")
    return name


def _pair(bounds: Sequence[float] | None) -> tuple[float, float] | None:
    return None if bounds is None else (bounds[0], bounds[1])


# Finding


def running(rig: str = "") -> dict[str, Live]:
    """Return this user's nodes whose loop runs, by name: all, or those of a rig or run."""
    nodes = {}
    for block in sharing.running():
        with suppress(KeyError, TypeError, ValueError):  # what it says is not what a node says
            live = Live(block)
            if live.running and live.is_of(rig):
                nodes[live.name] = live
    return nodes


def find(node: str = "executive", rig: str = "", among: Mapping[str, Live] | None = None) -> Live:
    """Return the running node `node`; `rig`: only of this rig; `among`: not those of this machine.

    It is called as `Live.names` has it. LiveError: none runs (ENVIRONMENT), or several do.
    """
    nodes = running(rig) if among is None else among
    names = [name for name, live in nodes.items() if node in live.names]
    if len(names) > 1:
        choice = " or ".join(names)
        raise LiveError(
            f"{node}: {len(names)} nodes of this name run here; choose one with --node {choice}"
        )
    if names:
        return nodes[names[0]]
    others = f"; running: {', '.join(nodes)}" if nodes else ""
    if among is None and not nodes and (users := sharing.other_users()):
        others = f"; user {' and '.join(users)} has nodes, which only that user can reach"
    what = f"{node}: no such node is running{others}; start one with `pcpc run RIG`"
    raise LiveError(what, Exit.ENVIRONMENT)


def find_for(words: Sequence[str], among: Mapping[str, Live] | None = None) -> Live:
    """Return the node that has the variables `words` (* ? []): the executive, if it does.

    LiveError as `find`, and if no node or no single one has them all.
    """
    nodes = running() if among is None else among
    if not words or not nodes:
        return next(iter(nodes.values())) if len(nodes) == 1 else find("executive", "", among)
    for word in words:
        if not any(_has(live, word) for live in nodes.values()):
            if _GLOB.search(word):
                raise LiveError(f"{word}: matches no variable; `pcpc get` shows all")
            every = {name: 0 for live in nodes.values() for name in live.variables}
            raise LiveError(f"{word}: no such variable{did_you_mean(word, every)}")
    holders = [name for name, live in nodes.items() if all(_has(live, word) for word in words)]
    candidates = [name for name in holders if name.endswith(".executive")] or holders
    if len(candidates) > 1:
        choice = " or ".join(candidates)
        raise LiveError(
            f"{words[0]}: {len(candidates)} nodes have this variable; "
            f"choose one with --node {choice}"
        )
    if not candidates:
        raise LiveError(
            f"{' '.join(words)}: no node has all of them; name variables of one node at a time"
        )
    return nodes[candidates[0]]


def _has(live: Live, word: str) -> bool:
    """Return whether a node has the variable, or one that matches."""
    return word in live.variables or (
        bool(_GLOB.search(word)) and any(fnmatchcase(name, word) for name in live.variables)
    )
