"""`pcpc log recover`: a damaged log written anew, as far as it is readable.

The new file is a whole one that every MCAP tool opens; it says in its metadata `recovered` what is
missing. The damaged file is not changed.
"""

import sys
from dataclasses import astuple
from pathlib import Path

from msgspec import Struct

from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.executive.log.mcap_writer import RecordError
from pcpc.executive.log.recovery import Recovery, recover
from pcpc.tools.after.log import source
from pcpc.tools.after.log.commands import RecoverRequest
from pcpc.tools.after.opened import Opened
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.answer import Count, NodeName
from pcpc.tools.terminal.outfile import LogCommandError, new_file
from pcpc.tools.terminal.progress import Progress


class RecoveredNode(Struct):
    """A node."""

    cycles: Count
    seconds: float


class RecoveredLog(Struct):
    """What was recovered of a log."""

    log: str
    file: str
    "that was written"
    nodes: dict[NodeName, RecoveredNode]
    messages: dict[str, Count]
    "by topic"
    missing: list[str]
    "in words"
    unproved: list[str]
    "kept, though no checksum proves it"


def command(request: RecoverRequest) -> int:
    """Carry out `recover`; return the exit code. LogCommandError: nothing to recover."""
    progress = Progress(request.quiet)
    path = request.log
    out = request.output or path.with_name(f"{path.stem}-recovered.mcap")
    with new_file(out, force=False, cure="choose another name with -o") as unfinished:
        try:
            done = recover(path, unfinished, source.Watch(path, progress))
        except RecordError as error:
            what = str(error).replace(str(unfinished), str(out))
            raise LogCommandError(what, error.code) from None
        if not sum(done.messages.values()):
            reason = done.missing[0] if done.missing else "the log is whole, and empty"
            raise LogCommandError(f"{path}: nothing to recover: {reason}")
        nodes = _nodes(unfinished, done)
    progress.close()
    if request.json:
        print(screen.json_text(RecoveredLog(str(path), str(out), nodes, *astuple(done))))
        return Exit.OK
    for line in done.missing or ["nothing: the log is whole"]:
        print(f"missing: {line}", file=sys.stderr)
    for line in done.unproved:
        print(f"kept as it reads, no checksum proves it: {line}", file=sys.stderr)
    kept = [f"{name}: {one.cycles} cycles, {one.seconds:g} s" for name, one in nodes.items()]
    print(f"{out}: {'; '.join([*kept, f'{sum(done.messages.values())} messages'])}")
    return Exit.OK


def _nodes(out: Path, done: Recovery) -> dict[str, RecoveredNode]:
    """Return cycles and seconds of each node that was recovered."""
    try:
        log = Opened(out).head
    except logs.LogError:  # messages of a log that lost its head
        return {}
    nodes = {}
    for name in log.node:
        cycles = done.messages.get(logs.topic(name, "state"), 0)
        period_ns = int(log.metadata[name].get("period_ns", 0))
        nodes[name] = RecoveredNode(cycles, cycles * period_ns / 1e9)
    return nodes
