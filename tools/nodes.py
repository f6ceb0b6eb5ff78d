"""A running node from outside: found by its socket, read without disturbing it, tuned, locked.

    find      a node by role or name, among those of this user
    find_for  the node that has some variables
    read      a consistent copy of the whole table (seqlock: the node never waits)
    tune      values into the mailbox, all or none; returns the cycle from which they hold
    set_lock  none: tunings allowed; tune, all: refused

One host at a time: the mailbox's own file is the lock (flock), and the kernel frees it when a host
dies. No numba in here: a command starts in a quarter of a second.
"""

import fcntl
import math
import os
import re
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing

LEVELS = ("none", "tune", "all")  # by the value of the mailbox's word LOCK
_REFUSALS = {
    sh.BAD_COUNT: "the request was no request",
    sh.NO_PARAMETER: "it is no parameter",
    sh.OUT_OF_RANGE: "it is out of range",
    sh.LOCKED: "it is locked",
}
_PATIENCE_S = 2.0  # a node that runs takes tunings within a period
_POLL_S = 0.001
_GLOB = re.compile(r"[*?\[]")


class HostError(UserError):
    """A node, or what is asked of it, cannot be had."""


# Nodes


def find(node: str) -> sh.Shared:
    """Return the block of the running node `node`: a role or a block's full name.

    Raises HostError: none runs (exit code 4), or several match (2).
    """
    running = _running()
    found = [name for name in running if node == name or node == name.rpartition(".")[2]]
    if len(found) > 1:
        raise HostError(
            f"{node}: {len(found)} run here; choose one with --node {' or '.join(found)}"
        )
    if found:
        return running[found[0]]
    others = f"; running: {', '.join(running)}" if running else ""
    other_users = sharing.other_users()
    if other_users and not running:
        others = f"; user {' and '.join(other_users)} has nodes, which only that user reaches"
    raise HostError(
        f"{node}: no such node is running{others}; start one with `pcpc run RIG`", Exit.ENVIRONMENT
    )


def find_for(words: Sequence[str]) -> sh.Shared:
    """Return the running node that has the variables `words` (* ? []): the executive, if it does.

    Raises HostError as `find`, and if no node or no single one has them all.
    """
    running = _running()
    if not words or not running:
        return next(iter(running.values())) if len(running) == 1 else find("executive")
    names = {node: names_of(block) for node, block in running.items()}
    for word in words:
        if not any(_has(known, word) for known in names.values()):
            if _GLOB.search(word):
                raise HostError(f"{word}: matches no variable; `pcpc list` shows all")
            every = {name: 0 for known in names.values() for name in known}
            raise HostError(f"{word}: no such variable{did_you_mean(word, every)}")
    holders = [node for node, known in names.items() if all(_has(known, word) for word in words)]
    found = [node for node in holders if node.endswith(".executive")] or holders
    if len(found) > 1:
        choice = " or ".join(found)
        raise HostError(f"{words[0]}: {len(found)} nodes have it; choose one with --node {choice}")
    if not found:
        raise HostError(f"{' '.join(words)}: no node has all of them; ask for one node's at a time")
    return running[found[0]]


def _has(places: Mapping[str, int], word: str) -> bool:
    """Return whether a node has the variable, or one that matches."""
    return word in places or (
        bool(_GLOB.search(word)) and any(fnmatchcase(name, word) for name in places)
    )


def _running() -> dict[str, sh.Shared]:
    """Return this user's nodes whose loop runs, by name."""
    return {block.name: block for block in sharing.running() if is_running(block)}


def is_running(block: sh.Shared) -> bool:
    """Return True while the node's loop runs."""
    return block.alive() and not block["control"][sh.DONE]


# Values


def read(block: sh.Shared) -> NDArray[np.float64]:
    """Return a consistent copy of all variables, in the order of the description.

    Raises HostError when the node stands still in the middle of writing one.
    """
    torn = np.empty(0)
    deadline_s = time.monotonic() + _PATIENCE_S
    while time.monotonic() < deadline_s:
        values: NDArray[np.float64] = sh.snapshot(block, torn)
        if values is not torn:
            return values
        time.sleep(_POLL_S)
    raise HostError(f"{block.name}: stands still in the middle of a cycle", Exit.ENVIRONMENT)


def names_of(block: sh.Shared) -> dict[str, int]:
    """Return the place of every variable by name."""
    return {variable[0]: place for place, variable in enumerate(block.description["variables"])}


def select(places: Mapping[str, int], words: Sequence[str]) -> dict[str, int]:
    """Return the places that names or glob patterns choose, in the order of `words`, each once."""
    chosen: dict[str, int] = {}
    for word in words:
        if _GLOB.search(word):
            found = {name: at for name, at in places.items() if fnmatchcase(name, word)}
            if not found:
                raise HostError(f"{word}: matches no variable; `pcpc list` shows all")
            chosen |= found
        else:
            chosen[word] = exactly(places, word)
    return chosen


def exactly(places: Mapping[str, int], name: str) -> int:
    """Return the place of a variable; HostError with the likeliest name if there is none."""
    if name not in places:
        raise HostError(f"{name}: no such variable{did_you_mean(name, places)}")
    return places[name]


# Tuning


def tune(block: sh.Shared, changes: Mapping[str, float]) -> int:
    """Set parameters, all between the same two cycles or none; return the first cycle with them.

    Raises HostError: unknown, not a parameter, out of range, too many, locked, no answer. The node
    judges again by itself.
    """
    indices, values = _checked(block, changes)
    with _one_host(block):
        word = int(block["mail"][sh.LOCK])
        level = LEVELS[word] if 0 <= word < len(LEVELS) else "all"
        if level != "none":
            raise HostError(f"{block.name}: locked ({level}); `pcpc lock none` allows tunings")
        if block["control"][sh.PASSES] == 0:
            what = "no cycle yet, it waits for the other node"
            raise HostError(f"{block.name}: {what}", Exit.ENVIRONMENT)
        _acknowledged(block, int(block["mail"][sh.REQUEST]))  # of a host that died waiting
        block["mail_index"][: len(indices)] = indices
        block["mail_value"][: len(values)] = values
        block["mail"][sh.COUNT] = len(indices)
        _release()
        request = int(block["mail"][sh.REQUEST]) + 1
        block["mail"][sh.REQUEST] = request
        cycle = _acknowledged(block, request)
        refusal, entry = int(block["answer"][sh.REFUSAL]), int(block["answer"][sh.REFUSED_ENTRY])
        if refusal != sh.ACCEPTED:
            name, why = list(changes)[entry], _REFUSALS.get(refusal, f"reason {refusal}")
            raise HostError(f"{name}: refused by the node: {why}; nothing was set")
        return cycle


def set_lock(block: sh.Shared, level: str) -> None:
    """Forbid tunings (`tune`, `all`) or allow them (`none`); no tuning is under way on return."""
    if level not in LEVELS:
        raise HostError(f"{level}: no such lock level{did_you_mean(level, LEVELS)}")
    with _one_host(block):
        block["mail"][sh.LOCK] = LEVELS.index(level)


def _checked(block: sh.Shared, changes: Mapping[str, float]) -> tuple[list[int], list[float]]:
    places, ranges = names_of(block), block.description["ranges"]
    if len(changes) > sh.MAIL_SLOTS:
        raise HostError(f"{len(changes)} values; at most {sh.MAIL_SLOTS} apply at once")
    for name, value in changes.items():
        _, unit, kind, writer, _ = block.description["variables"][exactly(places, name)]
        if kind != "parameter":
            raise HostError(
                f"{name}: {kind}, written by {writer} every cycle; only parameters can be set"
            )
        low, high = ranges[name]
        if not (low <= value <= high and math.isfinite(value)):
            raise HostError(
                f"{name}: {value:.12g} is outside {low:.12g}..{high:.12g} {unit}".rstrip()
            )
    return [places[name] for name in changes], list(changes.values())


@contextmanager
def _one_host(block: sh.Shared) -> Iterator[None]:
    """Keep other hosts out of the mailbox; HostError if one stays in it or the node ended."""
    if not block.alive() or block.client is None:
        raise HostError(f"{block.name}: ended", Exit.ENVIRONMENT)
    descriptor = os.open(f"/proc/self/fd/{block.client.mailbox}", os.O_RDONLY)  # a lock of its own
    deadline_s = time.monotonic() + 2 * _PATIENCE_S  # the other one waits as long for its answer
    try:
        while True:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > deadline_s:
                    raise HostError(
                        f"{block.name}: another host holds the mailbox; end it", Exit.ENVIRONMENT
                    ) from None
                time.sleep(_POLL_S)
        yield
    finally:
        os.close(descriptor)


def _release() -> None:
    """Make the slots visible before the request that is stored next, also on ARM.

    Releasing a lock orders what is before it, taking it again what follows.
    """
    barrier = threading.Lock()
    for _ in range(2):
        barrier.acquire()
        barrier.release()


def _acknowledged(block: sh.Shared, request: int) -> int:
    """Wait for the node's acknowledgement; return its cycle, or withdraw and raise HostError."""
    deadline_s = time.monotonic() + _PATIENCE_S
    while int(block["answer"][sh.ACK]) != request:
        if not is_running(block) or time.monotonic() > deadline_s:
            block["mail"][sh.COUNT] = 0  # the loop looks at it once: all or none also here
            why = "took no tunings for 2 s" if is_running(block) else "ended"
            raise HostError(f"{block.name}: {why}; nothing was set", Exit.ENVIRONMENT)
        time.sleep(_POLL_S)
    return int(block["answer"][sh.ACK_CYCLE])
