"""The recorder drains the rings of the nodes' shared blocks into one MCAP file.

A chunk (at most 1 MiB, zstd) is ended and handed to the kernel every 0.5 s, and what explains a log
(description, rig, DBC) is written first: `kill -9` costs less than a second. As a process:
`python -m pcpc.executive.log.recorder OUT.mcap EXECUTIVE_BLOCK [PLANT_BLOCK]`. Topics: see
`executive.log.reader`.
"""

import argparse
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.drivers.machine import heap
from pcpc.executive.errors import code_of
from pcpc.executive.log.channels import Channels, register_objects, write_description
from pcpc.executive.log.description import node_description
from pcpc.executive.log.long_logs import WITHOUT_CLOCK, Wanted
from pcpc.executive.log.mcap_writer import CHUNK_BYTES, BulkWriter, RecordError
from pcpc.executive.log.observers import OBSERVERS
from pcpc.executive.log.run_counts import RunCounts
from pcpc.executive.log.snapshot import Sink, SnapshotRing
from pcpc.executive.loop import sharing
from pcpc.executive.loop.ring_layout import RECORD_HEAD, OfEvent, OfRecord
from pcpc.executive.loop.shared import RINGS, NodeMemory, SharedError

FLUSH_NS = 500_000_000  # half of the second that a kill may cost
POLL_S = 0.02


class _Node:
    """One attached block: its channels and what was counted."""

    def __init__(self, block: NodeMemory, writer: BulkWriter) -> None:
        description = node_description(block.description)
        self.block, self.about, self.name = block, description, description["node"]
        self.channels = Channels(description, writer)
        self.observers = [observer(block) for observer in OBSERVERS]
        schemas = (observer.schema for observer in self.observers)
        self.channels.ids |= register_objects(writer, self.name, *filter(None, schemas))
        self.written = dict.fromkeys((*RINGS, *(one.word for one in self.observers)), 0)
        self.backlog = dict.fromkeys(RINGS, 0)
        self.taken = {ring: _rows_taken(block, ring) for ring in RINGS}
        self.counts = RunCounts(description)

    def is_over(self) -> bool:
        """Return whether the loop has ended, in good order or by death: it puts no more rows."""
        alive = self.block.alive()  # before the look at DONE: its last word counts
        return bool(self.block.control.done) or not alive

    def is_empty(self) -> bool:
        """Return whether all that was put is taken."""
        return all(self.block.ends(r).head == self.taken[r] for r in RINGS)

    def has_died(self) -> bool:
        """Return whether the loop ended without good order."""
        return bool(self.block.control.pid) and not self.block.control.done

    def drain(self, sink: Sink) -> bool:
        """Move the rows that are now in the rings on; return whether one was 1/8 full.

        The ring of the record keeps a row until `end_pass`.
        """
        for observer in self.observers:
            take = sink.add if observer.waits else sink.write
            for machine_ns, cycle, entry in observer.look():
                stamp_ns = self.channels.stamp(machine_ns, cycle)
                take([self.channels.entry(observer.topic, stamp_ns, cycle, entry)])
                self.written[observer.word] += 1
        full = False
        for ring in RINGS:
            rows, taken = self.block[ring], self.taken[ring]
            put = int(self.block.ends(ring).head)
            self.backlog[ring] = max(self.backlog[ring], put - taken)
            full = full or put - taken > len(rows) // 8
            most = CHUNK_BYTES // (8 * rows.shape[1] + 128)  # with the heads of two messages
            self.block[f"{ring}_taken"][0] = taken  # whatever others have written there
            while taken < put:
                start = taken % len(rows)
                count = min(put - taken, len(rows) - start, most)
                messages = self.channels.messages(ring, rows[start : start + count])
                self.counts.add(ring, rows[start : start + count])
                taken += count
                self.taken[ring] = taken
                self.block[f"{ring}_taken"][0] = taken - (ring == "record" and taken == put)
                (sink.write if ring == "event" else sink.add)(messages)
                self.written[ring] += count
                if ring == "event":
                    for row in rows[start : start + count]:
                        stamp = int(row[OfEvent.STAMP_NS]) + self.channels.wall_ns
                        sink.note_event(int(row[OfEvent.CODE]), stamp)
        return full

    def end_pass(self) -> None:
        """Give back the rows that were held: all nodes have been drained.

        Until then a node sees that the recorder lags, and has patience with one that waits for it.
        """
        self.block["record_taken"][0] = self.taken["record"]


def _rows_taken(block: NodeMemory, ring: str) -> int:
    """Return how many rows of a ring are taken already; a word that cannot be true counts as none.

    From here on the recorder's own count holds: any client may write into that word.
    """
    put, rows = int(block.ends(ring).head), len(block[ring])
    taken = int(block[f"{ring}_taken"][0])
    return taken if 0 <= taken <= put <= taken + rows else max(put - rows, 0)


class Recorder:
    """Writes the blocks' rings to `path`; call `drain` every 20 to 50 ms, at the end `finish`.

    `late` names blocks that may appear later or never. `judged`: columns by node that go whole into
    tables beside a log that keeps a part of the run. `clock` (ns) only paces the flushes. Raises
    RecordError, once the file cannot be written any more.
    """

    def __init__(
        self,
        path: Path,
        blocks: Sequence[NodeMemory],
        late: Sequence[str] = (),
        judged: Wanted | None = None,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.path, self.clock, self.judged = path, clock, judged or {}
        self.late = list(late)
        self.nodes: list[_Node] = []
        self.drains = self.busy_ns = self.longest_ns = 0
        self._full = False
        self.flushed_ns = clock()
        self._files: dict[str, str] = {}
        self.started_ns = int(blocks[0].description["metadata"]["clock_monotonic_ns"])
        self.started_s = 1e-9 * int(blocks[0].description["metadata"]["clock_wall_ns"])
        self._writing(lambda: self._open(blocks))

    def _open(self, blocks: Sequence[NodeMemory]) -> None:
        self.writer = BulkWriter(self.path)
        self.writer.start(profile="ros2")
        self.sink = Sink(self.writer)
        for block in blocks:
            self._add(block)
        self._attach_late()
        about = node_description(blocks[0].description)
        if about.get("keep_ns"):
            self.sink = SnapshotRing(self.writer, about["keep_ns"], about["keep_on"])
        self.writer.flush()

    def _writing(self, action: Callable[[], None]) -> None:
        """Do `action`; an OSError becomes RecordError and closes the file as it is."""
        try:
            action()
        except OSError as error:
            if hasattr(self, "writer"):
                with suppress(OSError):
                    self.writer.file.close()
            raise RecordError(
                f"{self.path}: the log cannot be written: {error.strerror}; "
                "free space there or choose another folder",
                code_of(error),
            ) from None

    def _add(self, block: NodeMemory) -> None:
        """Take up a node; write what explains its messages first."""
        self._set_clock(block.description["metadata"])
        description = node_description(block.description)
        node = _Node(block, self.writer)
        if node.name in self.judged:
            node.counts.open_table(self.path, self.judged[node.name])
        write_description(self.writer, description, self._files)
        self.nodes.append(node)

    def _set_clock(self, facts: dict[str, str]) -> None:
        """Let the stamps of a node without a clock, k T, count from the start of the first node."""
        if facts.get("pacing") in WITHOUT_CLOCK:
            first = self.nodes[0].about["metadata"] if self.nodes else facts
            facts |= {"clock_monotonic_ns": "0", "clock_wall_ns": first["clock_wall_ns"]}

    def _attach_late(self) -> None:
        """Take up late nodes that are there, except one that an earlier run is leaving."""
        for name in list(self.late):
            with suppress(SharedError):
                block = sharing.attach(name, sharing.RECORDER)
                if not block.control.done or self._in_this_run(block):
                    self._add(block)
                    self.late.remove(name)

    def _in_this_run(self, block: NodeMemory) -> bool:
        """Return whether the node of `block`, which has ended, ran when the first had started."""
        put, rows = int(block.ends("record").head), block["record_values"]
        names = block.description["timing_columns"]
        if not put:
            return False
        last = (put - 1) % len(rows)
        if "timing.wall_s" not in names:
            return int(block["record"][last, OfRecord.STAMP_NS]) > self.started_ns
        at = RECORD_HEAD + len(block.description["state_columns"]) + 1
        wall_s = float(rows[last, at + names.index("timing.wall_s")])
        return wall_s > self.started_s  # stamps without a clock are k T

    def drain(self) -> bool:
        """Move what is in the rings to the file; end the chunk when it is 0.5 s old.

        Return whether a ring was 1/8 full: the nodes run without a clock, do not sleep.
        """
        began_ns = self.clock()
        self._writing(lambda: self._drain(began_ns))
        took_ns = self.clock() - began_ns
        self.drains, self.busy_ns = self.drains + 1, self.busy_ns + took_ns
        self.longest_ns = max(self.longest_ns, took_ns)
        return self._full

    def _drain(self, now_ns: int) -> None:
        self._attach_late()
        full = [node.drain(self.sink) for node in self.nodes]
        for node in self.nodes:
            node.end_pass()
        self._full = any(full)
        if now_ns - self.flushed_ns >= FLUSH_NS:
            self.writer.flush()
            self.flushed_ns = now_ns

    def is_over(self) -> bool:
        """Return whether all nodes have ended and all that they put is taken."""
        if not all(node.is_over() for node in self.nodes):
            return False
        self._writing(self._attach_late)  # of a node that came and went since
        return all(node.is_empty() for node in self.nodes)

    def dropped_rows(self) -> dict[str, int]:
        """Return the rows that found a ring full, by `node.ring`."""
        return {
            f"{node.name}.{ring}": int(node.block.ends(ring).dropped)
            for node in self.nodes
            for ring in RINGS
        }

    def finish(self) -> None:
        """Take the last rows, write counts, statistics and index, close the file."""
        if not self.writer.file.closed:
            self.drain()
            self._writing(self._finish)

    def _finish(self) -> None:
        if any(node.has_died() for node in self.nodes):
            self.sink.note_death()
        self.sink.close()
        for node in self.nodes:
            node.counts.close()
        counts: dict[str, int] = {f"dropped.{key}": n for key, n in self.dropped_rows().items()}
        for node in self.nodes:
            counts |= {f"written.{node.name}.{kind}": n for kind, n in node.written.items()}
            for ring in RINGS:
                counts[f"backlog_max.{node.name}.{ring}"] = node.backlog[ring]
        counts |= {
            "discarded": self.sink.discarded,
            "drains": self.drains,
            "busy_us": self.busy_ns // 1000,
        }
        counts["longest_drain_us"] = self.longest_ns // 1000
        self.writer.flush()
        self.writer.add_metadata("run", {key: str(n) for key, n in counts.items()})
        frames = {key: n for node in self.nodes for key, n in node.counts.frame_counts().items()}
        self.writer.add_metadata("frames", {key: str(n) for key, n in frames.items()})
        away = {key: n for node in self.nodes for key, n in node.counts.absences().items()}
        self.writer.add_metadata("away", {key: str(n) for key, n in away.items()})
        self.writer.finish()
        self.writer.file.close()


def main(argv: Sequence[str] | None = None) -> int:
    """Record until the nodes have ended or SIGTERM comes; return the exit code."""
    parser = argparse.ArgumentParser(
        "pcpc.executive.log.recorder", description="record running nodes into OUT"
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("executive")
    parser.add_argument("others", nargs="*", help="blocks that may appear later or never")
    parser.add_argument("--judged", type=json.loads, default={}, help="columns by node, as JSON")
    options = parser.parse_args(argv)
    stopped: list[int] = []
    for number in (signal.SIGTERM, signal.SIGHUP):  # handlers: numpy's threads escape a signal mask
        signal.signal(number, lambda which, _: stopped.append(which))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the nodes; it sees them end
    heap.give_back()
    try:
        block = sharing.attach(options.executive)
        recorder = Recorder(options.out, [block], options.others, options.judged)
        block.tell(sharing.RECORDER)  # only now: with the executive the others may go
        os.nice(10)  # not before: until the file is open nothing of a run is kept
    except (RecordError, SharedError) as error:
        print(error, file=sys.stderr)
        return error.code
    with suppress(BrokenPipeError):
        print("ready", flush=True)
    try:
        while not stopped and not recorder.is_over():
            if not recorder.drain():
                time.sleep(POLL_S)
        recorder.finish()
    except RecordError as error:
        print(error, file=sys.stderr)
        return Exit.LOSS
    lost = {ring: rows for ring, rows in recorder.dropped_rows().items() if rows}
    if lost:
        print(f"{options.out}: rows dropped, the ring was full: {lost}", file=sys.stderr)
    return Exit.LOSS if lost else Exit.OK


if __name__ == "__main__":
    sys.exit(main())
