"""All nodes of a rig, from a cycle of a log on in virtual time, their loop closed.

    before    each node is recomputed from its record and compared with it, bit for bit
    at N - 2  what the node below the executive sent last lies in its neighbours' inboxes, behind
              what the executive had left there; no clock runs from here on
    from N    changes act in cycle N of each node, later tunings of the log in theirs, and behind
              its end what the rig has then: tunings of the schedule, begins of faults

In cycle k of the exchange in `executive.loop.exchange` the nodes below the executive are one cycle
ahead, and a fault of frames is set in the cycle before. So the executive is recomputed to N - 3 and
they to N - 2, from N = 3 on; before that the run begins anew. Of a paced log that cycle is the one
whose frames the executive took in N - 2. Its nodes go on with deadlines, at which no time passes.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.can.e2e_states import are_of_wire
from pcpc.drivers.can.wire_layout import QUEUE_FRAMES
from pcpc.drivers.compiled.rows import HEAD_BYTES
from pcpc.drivers.errors import UserError
from pcpc.executive.laws.emath_selftest import selftest
from pcpc.executive.log import reader as logs
from pcpc.executive.log.long_logs import WITHOUT_CLOCK, Wanted, sidecar
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import Time
from pcpc.executive.nodes.slices import tuning_of
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.replay import NodeComparison, pacing_of, recomputed_pieces

_FRAMES_KEPT = 1 << 14  # of a node, before the piece of the log at hand: some hundred cycles


@dataclass(frozen=True)
class Change:
    """A parameter of a node that the branch sets."""

    role: str
    name: str
    value: float
    early: int = 0  # cycles


class Branch(VirtualRun):
    """A run as `VirtualRun`, of which `before` recomputes what was, and `advance` goes on."""

    def __init__(
        self,
        head: logs.Log,
        rig: Rig,
        cycle: int,
        metadata: dict[str, str],
        log: Path,
        judged: Wanted | None,
    ) -> None:
        """`metadata`: of the log that is written. UserError for a log that cannot be branched."""
        selftest()
        self.head, self.rig, self.cycle = head, rig, cycle
        self.notes: list[str] = []
        self.missing: list[str] = []  # damage of the log
        self._skipped: set[str] = set()
        self._newest: dict[str, int] = {}
        self._heard: list[NDArray[np.uint8]] = []  # by the executive, in its first own cycle
        self._sends: dict[str, set[int]] = {role: set() for role in rig.roles}  # ids
        absent = [role for role in rig.roles if role not in head.node]
        if absent:
            raise UserError(f"{head.path}: no record of the {absent[0]}; a branch needs all nodes")
        if head.metadata.get("run", {}).get("discarded", "0") != "0":
            problem = "record.keep: it holds a part of its run, which cannot be recomputed"
            raise UserError(f"{head.path}: {problem}")
        if rig.config.bus.emulate is not None:
            problem = "bus.emulate: the log lacks the frames that wait on the emulated line"
            raise UserError(f"{head.path}: {problem}; simulate its rig with the change instead")
        lasts = _last_cycles(head, rig.roles, cycle - 2)
        self._nodes = [
            NodeComparison(
                head, rig, role, last, metadata | _origin(head, role, lasts), self._drain
            )
            for role, last in lasts.items()
        ]
        for node in self._nodes:
            if node.external:
                problem = f"{node.external[0]} of the {node.role}: its state is not in the log"
                raise UserError(f"{head.path}: {problem}; an FMU goes on with --fmu FILE")
        self._later: dict[str, list[tuple[int, int, float]]] = {role: [] for role in rig.roles}
        replays = [node.replay for node in self._nodes]
        plans = [replay.plan for replay in replays]
        self._begin(rig, plans, [replay.block for replay in replays], log, judged)

    def _drain(self) -> None:
        assert self.recorder is not None, "a branch has a log"
        self.recorder.drain()

    def before(self) -> Iterator[int]:
        """Recompute the cycles before; yield how many are done. UserError where that differs."""
        for piece in recomputed_pieces(self.head.path, self._nodes, whole=True):
            for node in self._nodes:
                self._note_tunings(node, piece)
                self._note_skips(node, piece)
            self._note_heard(piece)
            self.missing += [line for line in piece.missing if line not in self.missing]
            if self._stopped:
                raise KeyboardInterrupt
            yield min(node.verdict.cycles for node in self._nodes)
        newest = self._newest.get(self._nodes[0].role, -1)
        if newest < self.cycle:
            comes = f"the log ends with cycle {newest}" if newest >= 0 else "the log holds none"
            raise UserError(f"{self.head.path}: cycle {self.cycle} is not there, {comes}")
        for node in self._nodes:
            node.require_end()
        self._hand_on()
        for node in self._nodes:
            self._let_go(node.replay.block.loop)
            later = self._later[node.role]
            newest = max([self._newest.get(node.role, -1), node.last, *(row[0] for row in later)])
            later += [row for row in node.replay.plan.schedule if row[0] > newest]
            _tune_later(node, later)

    def _hand_on(self) -> None:
        hand_on([block.loop for block in self.blocks], self._left_there())

    def _let_go(self, loop: Any) -> None:
        """Let a node go on as in a run."""
        loop.clock.kind = Time.VIRTUAL
        loop.meeting.ordered, loop.wire.in_turn = 1, loop.meeting.between

    def _note_heard(self, piece: logs.Log) -> None:
        """Keep what the executive of a log without a clock took in its first cycle of its own."""
        top = self._nodes[0]
        if top.role in piece.node and pacing_of(self.head, top.role) in WITHOUT_CLOCK:
            rows = piece.node[top.role].frames
            here = (rows["cycle"] == top.last + 1) & (rows["direction"] == 1)
            self._heard += [*logs.on_bus(rows[here & are_of_wire(rows["e2e"])])]
        for role, node in piece.node.items():
            sent = node.frames[node.frames["direction"] == 0]
            self._sends[role].update(np.unique(sent["id"]).tolist())

    def _left_there(self) -> dict[int, list[NDArray[np.uint8]]]:
        """Return what the executive took then of what the nodes below had sent before their last.

        By the place of the sender. A drive sends behind its sample, which ends a cycle.
        """
        taken_frames = {}
        for i in range(1, 1 + int(self.blocks[0].loop.meeting.peers)):
            end, sends = self.blocks[i].loop.wire, self._sends[self._nodes[i].role]
            last = [_text(frame) for frame in end.outbox[: end.outbox_put]]
            heard = [frame for frame in self._heard if _id(frame) in sends]
            texts = [_text(frame) for frame in heard]
            both = range(min(len(texts), len(last)), 0, -1)
            count = next((n for n in both if texts[-n:] == last[:n]), len(texts))
            taken_frames[i] = heard[: len(heard) - count]
        return taken_frames

    def _note_tunings(self, node: NodeComparison, piece: logs.Log) -> None:
        """Keep the tunings of the log that come later."""
        index = node.replay.plan.table.index
        for entry in piece.node[node.role].tunings if node.role in piece.node else ():
            cycle, name, value = tuning_of(entry)
            if name in index and cycle > node.last:
                node.replay.check_tuning(cycle, name, value)
                self._later[node.role].append((cycle, index[name], value))

    def _note_skips(self, node: NodeComparison, piece: logs.Log) -> None:
        """Note where a node of the log skipped periods behind the branch, which does not."""
        if node.role not in piece.node or not len(piece.node[node.role].cycle):
            return
        cycle = np.append(self._newest.get(node.role, -1), piece.node[node.role].cycle)
        self._newest[node.role] = int(cycle[-1])
        gaps = np.flatnonzero((np.diff(cycle) > 1) & (cycle[:-1] > node.last))
        if len(gaps) and node.role not in self._skipped:
            self._skipped.add(node.role)
            count = cycle[gaps[0] + 1] - cycle[gaps[0]] - 1
            what = f"the {node.role} of the log skipped {count} periods behind cycle"
            self.notes.append(f"{what} {cycle[gaps[0]]}; the branch skips none")

    def parameters(self) -> Mapping[str, Mapping[str, Any]]:
        """Return by node the parameters that can be set, as variables of its table."""
        return {
            node.role: {
                one.name: one for one in node.replay.plan.table.variables if one.kind == "parameter"
            }
            for node in self._nodes
        }

    def discard(self) -> None:
        """Leave no log behind, nor columns beside it."""
        if self.recorder is not None:
            path = self.recorder.path
            with suppress(OSError):
                self.recorder.writer.file.close()
            for name in self.recorder.judged:
                sidecar(path, name).unlink(missing_ok=True)
            path.write_bytes(b"")  # an empty one goes with its folder

    def change(self, changes: Sequence[Change]) -> None:
        """Set parameters in the cycle of the branch, before what the log tunes there.

        Call it before `before`. UserError: what the node would refuse.
        """
        for change in changes:
            node = next(node for node in self._nodes if node.role == change.role)
            place = node.replay.plan.table.index[change.name]
            shared = node is self._nodes[0] or node.last < 0  # the executive's cycles
            at = self.cycle if shared else node.last + 2
            self._later[change.role].append((max(at - change.early, 0), place, change.value))


def _id(frame: NDArray[np.uint8]) -> int:
    return int(frame[:4].view(np.uint32)[0])


def _text(frame: NDArray[np.uint8]) -> bytes:
    """Return id, length and data of a frame, whatever room it lies in."""
    return frame[:5].tobytes() + frame[HEAD_BYTES:].tobytes().rstrip(b"\0")


def hand_on(nodes: Sequence[Any], before: Mapping[int, Sequence[NDArray[np.uint8]]]) -> None:
    """Put what the nodes below the executive sent last into the inboxes of their neighbours.

    `before`: what of earlier cycles the executive had not taken, by sender. All else was taken in
    the same cycle, as each node works before the one above it, but for what a local node left.
    """
    for i in range(int(nodes[0].meeting.peers), 0, -1):  # the order of `exchange.work_below`
        end = nodes[i].wire
        downwards = set(end.second[: end.n_second].tolist())
        for frame in (*before.get(i, ()), *end.outbox[: end.outbox_put]):
            _deliver(frame, nodes[2 * (_id(frame) in downwards)].wire)
    for frame in left_by_local(nodes):
        _deliver(frame, nodes[1].wire)
    for node in nodes:
        node.wire.outbox_put = 0


def _deliver(frame: NDArray[np.uint8], into: Any) -> None:
    into.inbox[into.inbox_put % QUEUE_FRAMES, : len(frame)] = frame
    into.inbox_put += 1


def left_by_local(nodes: Sequence[Any]) -> list[NDArray[np.uint8]]:
    """Return what a local node has not taken of the plant's last cycle.

    It takes frames up to the last one that starts its cycle. A drive's come behind that of the
    plant, and where the plant has none, behind that of the executive.
    """
    if len(nodes) - int(nodes[0].meeting.peers) < 2:
        return []
    rx, end = nodes[1].rx, nodes[2].wire
    frames = [rx.frames[row] for row in range(rx.n) if rx.role[row].starts]
    starters = {can_id.word_of(int(one.can_id), bool(one.extended)) for one in frames}
    sent = [*end.outbox[: end.outbox_put]]
    starts = [k for k, frame in enumerate(sent, 1) if _id(frame) in starters]
    return sent[max(starts, default=0) :]


def _tune_later(node: NodeComparison, later: list[tuple[int, int, float]]) -> None:
    """Schedule the tunings that come later; UserError for too many."""
    loop = node.replay.block.loop
    if len(later) > sh.MAX_SCHEDULE:
        what = f"{len(later)} tunings of the {node.role} come later"
        raise UserError(f"{node.path}: {what}; one branch takes {sh.MAX_SCHEDULE}")
    later.sort(key=lambda row: row[0])
    for i, (cycle, place, value) in enumerate(later):
        loop.tuning.schedule[i] = (cycle, place)
        loop.tuning.value[i] = value
    loop.tuning.n, loop.tuning.done = len(later), 0


# Which cycles of the nodes belong together


def _last_cycles(head: logs.Log, roles: Sequence[str], cycle: int) -> dict[str, int]:
    """Return by node the last cycle before the executive's `cycle`; UserError if nothing tells it.

    -1 where there is none: the run begins anew.
    """
    if cycle < 1:
        return dict.fromkeys(roles, -1)
    paced = pacing_of(head, roles[0]) not in WITHOUT_CLOCK
    below = _meeting_cycles(head, roles, cycle) if paced else dict.fromkeys(roles[1:], cycle)
    return {roles[0]: cycle - 1} | below


def _origin(head: logs.Log, role: str, lasts: Mapping[str, int]) -> dict[str, str]:
    """Return what has to be known of a node to replay the branch, and to branch it again.

    `branch_ahead`: how many cycles more it counts than the executive whose frame it sends.
    """
    leader = next(iter(lasts))
    ahead = 0 if role == leader or lasts[role] < 0 else lasts[role] - lasts[leader] - 1
    return {"branch_pacing": pacing_of(head, role), "branch_ahead": str(ahead)}


def _meeting_cycles(head: logs.Log, roles: Sequence[str], cycle: int) -> dict[str, int]:
    """Return by node below the cycle whose frames the node above took, the executive's `cycle`."""
    frames = frames_until((piece for piece, _ in logs.pieces(head.path)), roles, cycle)
    cycle_by_role: dict[str, int] = {}
    chain = pairwise(roles) if "local" in roles else ((roles[0], role) for role in roles[1:])
    for above, role in chain:
        above_cycle = cycle_by_role.get(above, cycle)
        taken = frames[above][
            (frames[above]["direction"] == 1) & (frames[above]["cycle"] == above_cycle)
        ]
        sent = frames[role][frames[role]["direction"] == 0]
        ours, theirs = (head.metadata[one].get("branch_ahead") for one in (above, role))
        near = above_cycle + int(theirs) - int(ours) if ours and theirs else None
        cycles = [sender_cycle(one, sent, near) for one in taken]
        known = [one for one in cycles if one >= 0]
        if not known and (frames[above]["cycle"] >= above_cycle).any():  # else `before` tells it
            what = f"in cycle {above_cycle} the {above} took no frame of the {role}"
            raise UserError(f"{head.path}: {what}; choose another --cycle")
        cycle_by_role[role] = max(known, default=above_cycle)
    return cycle_by_role


def frames_until(
    pieces: Iterable[logs.Log], roles: Sequence[str], cycle: int
) -> dict[str, NDArray[Any]]:
    """Return by node the frames before and in the executive's `cycle`, and some behind."""
    frames: dict[str, NDArray[Any]] = {}
    for piece in pieces:
        for role in (role for role in roles if role in piece.node):
            new = piece.node[role].frames
            kept = frames.get(role, new[:0])[-_FRAMES_KEPT:]
            frames[role] = np.concatenate((kept, new))
        if (frames[roles[0]]["cycle"][-1:] > cycle + 2).any():
            break
    return frames


def sender_cycle(frame: Any, sent: NDArray[Any], near: int | None) -> int:
    """Return the cycle in which a received frame was sent, -1 for none.

    The last one before it by their stamps; in a branch, which has no clock, the one nearest `near`.
    `sent`: (n,) records.
    """
    same = sent[(sent["id"] == frame["id"]) & (sent["data"] == frame["data"]).all(axis=1)]
    if near is None:
        same = same[same["stamp_ns"] <= frame["stamp_ns"]][-1:]
    return int(same["cycle"][np.argmin(np.abs(same["cycle"] - (near or 0)))]) if len(same) else -1
