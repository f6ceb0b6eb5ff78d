"""`pcpc replay LOG`: recompute a recorded run from its log alone, compare it bit by bit.

Frames, tunings and the rig come from the log; the laws are the project's. A law from outside is
taken from where it lay, if it is unchanged, or with --trust from the log: see `after.log.rig`. With
--controller or --set it recomputes what the node would have done with the recorded input (open
loop: the plant does not answer) and shows how far that is from the record.
"""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import BusError, Exit, UserError
from pcpc.executive.log import reader as logs
from pcpc.executive.log.frontier import ALL, Frontier
from pcpc.executive.log.keyframes import newest
from pcpc.executive.nodes.fmus import step_of
from pcpc.executive.nodes.planned_keyframes import restore, why_none
from pcpc.executive.nodes.replay import Replay
from pcpc.executive.nodes.rings import kept_cycles
from pcpc.executive.nodes.slices import HEAD, PASSES, STAMP, Assembler, K
from pcpc.executive.nodes.watched import StepError
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.commands import ReplayRequest
from pcpc.tools.after.keyframe_check import KeyframeCheck
from pcpc.tools.after.log.recorded import holds_several, log_of
from pcpc.tools.after.opened import Opened, opened
from pcpc.tools.after.replayed import ReplayedNodes, Verdict, compare_frames, plain, report
from pcpc.tools.after.span import ValuePrinter, cycles_of
from pcpc.tools.after.trust import Trust
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.progress import Progress
from pcpc.tools.terminal.rooms import is_installed, part_of

_DEVICE = "make/device"  # the room that replays a device's log
_PIECE_BYTES = 1 << 20  # of the log, where only some of it is looked at
_OF_MANY = ("brief", "table", "sign", "check", "signers", "identity", "junit", "jobs")
_OF_ONE = ("since", "until", "show", "controller", "set")
END = "end of the node"  # as a difference
MOST_SKIPPED = 10_000_000  # periods: a plant makes them up one by one


def command(request: ReplayRequest) -> int:
    """Replay its log; OK if bit-identical, LOSS if as far as an incomplete log goes.

    UserError: wrong input; StepError: a step hangs or raises.
    """
    one_cycle = request.are_given("cycle", "time")
    if not one_cycle and (len(request.logs) != 1 or _is_of_many(request)):
        request.refuse("of one log; several are compared as they are", *_OF_ONE)
        if request.node == "device":
            raise UserError("--node device: of one log; leave it out")
        return int(part_of("after/verify", "cli").command(request))
    if len(request.logs) != 1:
        raise UserError(f"--cycle and --time are of one log, got {len(request.logs)}")
    path = log_of(request.logs[0])
    if one_cycle:
        request.refuse("of many logs, not of one cycle", *_OF_MANY)
        return _step(path, request)
    if request.show and request.json:
        raise UserError("--show prints CSV; leave out --json")
    progress = Progress(request.quiet or bool(request.show and sys.stdout.isatty()))
    about = request.node, request.controller, request.set
    try:
        with opened(path, Trust.of(request.code)) as run:
            span = cycles_of(run.head, request.since, request.until)
            verdicts = replay(run, progress, *about, span, request.show)
    except BusError as error:  # the log's DBC, not a bus of this machine
        raise UserError(str(error)) from None
    except StepError as error:
        raise StepError(f"{path}: {error or 'a step does not return'}") from None
    progress.close()
    changed = bool(request.controller or request.set)
    codes = {verdict.code for verdict in verdicts}
    if request.show and codes == {Exit.OK}:
        return Exit.OK
    if request.json:
        told: ReplayedNodes = [plain(one) for one in verdicts]
        print(screen.json_text(told))
    else:
        lines = screen.fitted(line for verdict in verdicts for line in report(verdict, changed))
        print(*lines, sep="\n", file=sys.stderr if request.show else None)
    return next(code for code in (Exit.NOT_MET, Exit.LOSS, Exit.OK) if code in codes)


def _is_of_many(request: ReplayRequest) -> bool:
    """Return whether a row a log is asked for, or a folder holds logs of several runs."""
    return request.are_given(*_OF_MANY) or holds_several(request.logs[0])


def _step(path: Path, request: ReplayRequest) -> int:
    """Show a cycle, stage by stage."""
    fields = {"--from": "since", "--to": "until", "--set": "set", "--controller": "controller"}
    if beside := [option for option, name in fields.items() if request.are_given(name)]:
        raise UserError(f"--cycle and --time show one cycle as it was; leave out {beside[0]}")
    if request.node == "device":
        raise UserError("--node device: a device's cycles cannot be shown")
    return int(part_of("after/step", "cli").command(path, request))


def replay(
    run: Opened,
    progress: Progress,
    node: str = "all",
    controller: str | None = None,
    settings: Sequence[str] = (),
    span: tuple[int, int] = (0, ALL),
    words: Sequence[str] = (),
) -> list[Verdict]:
    """Recompute the nodes asked for, in one pass over the log; LogError, RigError, BusError.

    `span`: first and last cycle. `words`: variables that are printed there, see `ValuePrinter`.
    """
    first, last = span
    values = ValuePrinter(words, first) if words else None
    changed = bool(controller or settings)
    how: dict[str, Any] = {"last": last, "seek": 0 if changed else first, "changed": changed}
    how |= {"each": values.look} if values else {}
    with run.rig(controller, settings) as rig:
        nodes = comparisons(run.head, rig, node, **how)
    if values:
        values.begin([one for one in nodes if isinstance(one, NodeComparison)])
    whole = (first, last) == (0, ALL)
    since_ns = 0 if whole else min(one.since_ns for one in nodes)
    for _ in recomputed_pieces(run.path, nodes, last == ALL, since_ns):
        done = min(one.verdict.cycles for one in nodes)
        progress.show(f"cycle {done}, {min(one.verdict.speed for one in nodes):.0f} x real time")
    for one in () if whole else nodes:
        one.require_cycle(first)
    return [one.verdict for one in nodes]


def comparisons(head: logs.Log, rig: Rig, node: str, **how: Any) -> list[Any]:
    """Return what recomputes a node, or all of a log, its device too; LogError.

    `how`: of `NodeComparison`. A device is recomputed as a whole.
    """
    nodes: list[Any] = [
        NodeComparison(head, rig, role, **how)
        for role in logs.NODES
        if role in head.node and node in (role, "all")
    ]
    whole = not how.get("seek") and how.get("last", ALL) == ALL
    if node in ("device", "all") and whole and is_installed(_DEVICE):
        device = part_of(_DEVICE, "replay")
        nodes += [device.DeviceComparison(head, rig)] if device.is_of_device(head) else []
    if not nodes and node == "device" and not whole:
        raise UserError("--node device: its frames are compared as a whole; leave out --from, --to")
    if not nodes:
        raise logs.LogError(f"{head.path}: no record of node {node}")
    return nodes


def recomputed_pieces(
    path: Path, nodes: Sequence[Any], whole: bool = False, since_ns: int = 0
) -> Iterator[logs.Log]:
    """Recompute the nodes; yield the log's pieces, until all have come to their last cycles.

    `whole`: to the log's end. `since_ns`: the log time before which no piece is needed. LogError.
    """
    frontier = Frontier()
    only = (since_ns, logs.LATEST) if since_ns else None
    size = _PIECE_BYTES if only else logs.PIECE_BYTES
    for piece, last in logs.pieces(path, size, frontier.see, only):
        for node in nodes:
            node.take(piece, frontier.whole[node.role], last)
        yield piece
        if not whole and all(node.is_there for node in nodes):
            return


class NodeComparison:
    """One node recomputed and compared piece by piece, until the end or a gap in the log.

    Or until cycle `last`, its log written with `metadata`; `each` is called after every slice.
    """

    def __init__(
        self,
        head: logs.Log,
        rig: Rig,
        role: Any,
        last: int = ALL,
        metadata: dict[str, str] | None = None,
        each: Callable[[], None] = lambda: None,
        seek: int = 0,
        changed: bool = False,
    ) -> None:
        """`seek`: begin behind the newest keyframe before this cycle, if there is one.

        `changed`: the rig is not the log's as it was; its keyframes are not compared.
        """
        about = head.node[role].description
        if not {"state_columns", "timing_columns", "period_ns"} <= about.keys():
            raise logs.LogError(f"{head.path}: the description of the {role} is damaged")
        self.role, self.last, self._each = role, last, each
        self.is_there = False  # at its last cycle
        self.recorded = Assembler([*about["state_columns"], *about["timing_columns"]])
        self._last_received = np.empty(0, np.int64)  # its cycle, once there is one
        pacing = pacing_of(head, role)
        external = [str(name) for name in about.get("external", [])]
        steps = {one.name: step_of(one) for one in rig.nodes()[role].blocks}
        fmus = {name: step.model for name, step in steps.items() if step and not step.file}
        external += fmus
        self.external, self._is_written = external, metadata is not None
        theirs = self.recorded.names
        self.replay = Replay(rig, role, pacing, theirs, external, metadata=metadata)
        ours, self.recorded.most = self.replay.names, kept_cycles(self.replay.block)
        absent = [name for name in self.replay.needed if name not in theirs]
        if absent or len(set(theirs)) != len(theirs):
            what = f"has no {absent[0]}" if absent else "names a variable twice"
            raise logs.LogError(f"{head.path}: the description of the {role} {what}")
        self.both = [name for name in theirs if name in ours]
        self._theirs = [HEAD + theirs.index(name) for name in self.both]
        self._ours = [ours.index(name) for name in self.both]
        self.path = head.path
        described = self.replay.block.description["variables"]
        self.verdict = Verdict(
            role, 1e9 / about["period_ns"], variables=len(self.both), described=described
        )
        self.verdict.planned = int(about.get("cycles", 0))
        self.verdict.dropped = _dropped_count(head, role)
        self.verdict.from_record = [
            f"{name}: as recorded, the FMU {model.name} (sha256 {model.sha256[:16]}) was not run; "
            "--fmu FILE runs it"
            for name, model in fmus.items()
        ]
        self.keyframes = KeyframeCheck(self.replay, self.verdict, {} if changed else about)
        self.recorded.every = self.keyframes.every
        self.notes: list[str] = []  # on keyframes
        self.since_ns = self._passes = 0  # log time and passes of the cycle behind which it begins
        if seek:
            self._seek(head, seek)
        self._begin_s = time.monotonic()

    def _seek(self, head: logs.Log, cycle: int) -> None:
        """Begin behind the newest keyframe before `cycle`, if there is one."""
        name = self.replay.block.description["keyframe_layout"]
        why = partial(why_none, self.replay.plan)
        frame = newest(head, self.role, cycle, name, why, self.notes)
        if frame is not None:
            self.replay.begin_at(partial(restore, frame=frame))
            self.recorded.behind, self._passes = frame.cycle, frame.passes + 1
            self.since_ns = frame.stamp_ns

    def take(self, piece: logs.Log, whole: int, last: bool) -> None:
        """Recompute what `piece` of the log completes, up to cycle `whole`; LogError."""
        try:
            self._take(piece, whole, last)
        except logs.LogError as error:
            raise logs.LogError(f"{self.path}: {self.role}: {error}") from None
        if last and self.last == ALL:
            _told_as_missing(self.verdict, self.recorded.left)
        if last and not self.verdict.incomplete:
            self.keyframes.end(self.last)

    def require_cycle(self, first: int) -> None:
        """Raise UserError if it did not come to cycle `first`, for want of it in the log."""
        k = int(self.replay.block.loop.k)
        if k <= first and not (self.verdict.differences or self.verdict.incomplete):
            what = f"there is no cycle {first}, the log comes to cycle {k - 1}"
            raise UserError(f"{self.path}: {self.role}: {what}; choose an earlier --from")

    def require_end(self) -> None:
        """Raise UserError if it did not come to its last cycle with the bits of the log."""
        verdict, k, first = self.verdict, int(self.replay.block.loop.k), self.verdict.first()
        if first is not None:
            recorded, recomputed = first.texts
            what = f"{first.name} in cycle {first.cycle} is recorded as {recorded}, "
            what += f"recomputed it is {recomputed}: laws or versions have changed"
            raise UserError(f"{self.path}: {self.role}: {what}; see `pcpc replay`")
        if verdict.incomplete or verdict.dropped:
            what = verdict.incomplete or f"{verdict.dropped} frames or events are missing"
            raise UserError(f"{self.path}: {self.role}: {what}")
        if k != self.last + 1:
            what = f"cycle {self.last} is not there; it was skipped, or the log ends before"
            raise UserError(f"{self.path}: {self.role}: {what}; choose another --cycle")

    def _disorder(self, frames: NDArray[Any]) -> str:
        """Return why received frames cannot be recomputed by their cycles; "" if they can."""
        cycles = np.append(self._last_received, frames["cycle"][frames["direction"] == 1])
        self._last_received = cycles[-1:]
        wrong = np.flatnonzero(cycles[1:] < cycles[:-1])
        first = f"a frame of cycle {cycles[wrong[0]]}" if len(wrong) else ""
        return first and f"{first} stands before earlier ones"

    def _take(self, piece: logs.Log, whole: int, last: bool) -> None:
        verdict = self.verdict
        verdict.missing += piece.missing
        if self.is_there:
            return
        if self.role in piece.node and not verdict.incomplete:
            verdict.incomplete = self._disorder(piece.node[self.role].frames)
            try:
                self.recorded.add(piece.node[self.role])
            except logs.LogError as error:
                verdict.incomplete = str(error)
                return
            self.keyframes.add(piece.node[self.role], self.recorded.behind)
        for part in self.recorded.take(min(whole, self.last), last or whole >= self.last):
            passes = self._passes + verdict.cycles
            verdict.incomplete = verdict.incomplete or _gap(part.rows, passes)
            if verdict.incomplete:
                return
            if self._is_written:  # the log has no clock
                part.rows[:, STAMP] = part.rows[:, K] * self.replay.block.description["period_ns"]
                if not verdict.cycles:
                    self.replay.repeat_meeting(part.frames)
                    self._each()
            computed = self.replay.advance(part, self.recorded.names)
            done = len(computed.values)
            old, new = part.rows[:done, self._theirs], computed.values[:, self._ours]
            _compare(verdict, self.both, part.rows[:done, K], old, new)
            compare_frames(verdict, self.replay.sent(part.frames), computed.sent)
            self.keyframes.look()
            verdict.cycles += done
            if self._is_written and done:
                self.replay.repeat_clocks(part, self.recorded.names, done)
            self._each()
            if done < len(part.rows):
                cycle = part.rows[done, K]
                verdict.incomplete = f"recomputed, the node stops before cycle {cycle}"
                at_s = cycle / verdict.rate_hz
                verdict.differences.note(END, int(cycle), float(at_s), "a cycle", "none")
        self.is_there = whole >= self.last
        verdict.spent_s = time.monotonic() - self._begin_s


def pacing_of(head: logs.Log, role: str) -> str:
    """Return what starts the cycles of a node; of a branch, what did so in its log."""
    about = head.metadata[role]
    return about.get("branch_pacing", about.get("pacing", "lockstep"))


def _dropped_count(head: logs.Log, role: str) -> int:
    """Return how many frames and events of a node found no room in the recorder's memory."""
    run = head.metadata.get("run", {})
    return sum(int(run.get(f"dropped.{role}.{ring}", 0)) for ring in ("frame", "event"))


def _told_as_missing(verdict: Verdict, left: NDArray[np.int64]) -> None:
    """Say at the end what could not be compared for want of input."""
    if verdict.dropped and (first := verdict.first()) is not None:
        verdict.differences.clear()
        verdict.incomplete = (
            f"{verdict.dropped} frames or events are missing, the recorder had no room for them; "
            f"from cycle {first.cycle} on nothing can be compared"
        )
    if verdict.incomplete:
        return
    if len(left):
        until = f"compared until {int(left[0]) - 1}" if verdict.cycles else "nothing is compared"
        verdict.incomplete = (
            f"frames or tunings of cycle {left[0]} and later ones are missing in the log; {until}"
        )
    elif not verdict.cycles:
        verdict.incomplete = "the log holds no cycle: its recorder ended before the first"


def _gap(rows: NDArray[np.int64], before: int) -> str:
    """Return why `rows` cannot be recomputed after `before` passes; "" if they can."""
    wrong = np.flatnonzero(rows[:, PASSES] != before + np.arange(len(rows)))
    if not len(wrong):
        steps = np.diff(rows[:, K])
        if (steps > 0).all() and (steps < MOST_SKIPPED).all() and 0 <= rows[0, K] < 2**62:
            return ""
        return f"the cycle numbers behind {rows[0, K]} are those of no run"
    first = int(rows[wrong[0], K])
    if before == 0 and wrong[0] == 0:
        return (
            f"the log begins with cycle {first}, not with the start of the run: "
            "what the node had learned by then is not in it"
        )
    return f"cycles before {first} are missing in the log; nothing after them can be recomputed"


def _compare(
    verdict: Verdict,
    names: Sequence[str],
    cycle: NDArray[np.int64],
    recorded: NDArray[np.int64],
    computed: NDArray[np.int64],
) -> None:
    """Note every variable whose bits differ; both are (cycles, variables)."""
    if np.array_equal(recorded, computed):
        return
    time_s = cycle / verdict.rate_hz
    for j in map(int, np.flatnonzero((recorded != computed).any(axis=0))):
        both = (x[:, j].copy().view(np.float64) for x in (recorded, computed))
        verdict.differences.add(names[j], cycle, time_s, *both)
