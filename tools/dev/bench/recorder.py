"""The recorder: how much it writes in a second, and what it costs the loop.

    throughput   `Recorder.drain` on the rings of a run of slew10 (records, frames, events of both
                 nodes) against mcap's own Writer.add_message with the same messages, chunks and
                 compression; MB of messages per second of processor time, higher is better
    lateness     p99 of the executive's wake-up lateness in `pcpc run` at 1 kHz on a bus of its own,
    work         and of its time from wake-up to the end of sending, with the recorder against the
                 same run without; pairs of runs in turn, RUN_S each, the first SETTLE_S left out

The runs are those of `tools.run.run.Host`; the one without only leaves the recorder out. Its rings
are never emptied and hold the whole run.
"""

import signal
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from pcpc.executive.log.mcap_writer import CHUNK_BYTES
from pcpc.executive.log.recorder import Recorder
from pcpc.executive.loop import shared as sh
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.dev.bench.cycle import RIG
from pcpc.tools.dev.bench.ratio import Ratio, interleave
from pcpc.tools.machine.jitter.compiler import BenchError
from pcpc.tools.run.commands import RunRequest
from pcpc.tools.run.run import Host
from pcpc.tools.terminal.arguments import RunFolder
from pcpc.tools.terminal.progress import Progress

SUITE = "recorder"
BUS = "udp_multicast:239.74.163.63:43163"  # of its own
ROWS = 3000  # cycles of a drain, more than the recorder lets pile up in a run
RUN_S = 2.0
SETTLE_S = 0.2
PATIENT = ("supervisor.hold_cycles=100000", "supervisor.fault_after_cycles=100000")  # late is told
STAGES = ("timing.receive_us", "timing.step_us", "timing.send_us")


class UnrecordedHost(Host):
    """A run without recorder; its blocks stay mapped after the end."""

    def _start_recorder(self) -> None:
        return


def measure(progress: Progress, rounds: int = 15) -> list[Ratio]:
    """Return "throughput", "lateness p99" and "work p99"; one pair of runs to six rounds."""
    found = [throughput(progress, rounds)]
    pairs = max(1, rounds // 6)
    latest: dict[type[Host], list[tuple[float, float]]] = {Host: [], UnrecordedHost: []}
    for i in range(pairs):
        for kind, results in latest.items():
            progress.show(f"recorder: pair of runs {i + 1} of {pairs}")
            results.append(one_run(kind))
    own, base = np.array(latest[Host]), np.array(latest[UnrecordedHost])
    for column, what in enumerate(("lateness p99", "work p99")):
        against = "the run without recorder"
        found.append(Ratio.from_rounds(SUITE, what, against, own[:, column], base[:, column], "us"))
    return found


def one_run(kind: type[Host], seconds: float = RUN_S) -> tuple[float, float]:
    """Return p99 of wake-up lateness and of work of one run, us; BenchError if it failed."""
    settings = [f"duration_s={seconds}", *PATIENT]
    request = RunRequest(
        rig=RIG,
        bus=BUS,
        pacing="real",
        set=settings,
        kept=RunFolder(quiet=True, no_figure=True),
        begin_ns=time.monotonic_ns(),
    )
    rig = load_rig(RIG, settings=settings, resolve=False)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with tempfile.TemporaryDirectory() as folder:
        host = kind(request, rig, ("plant", "executive"), Path(folder))
        try:
            code = host.run()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
    if host.outcome.interrupted:
        raise KeyboardInterrupt
    if code >= 0 or "executive" not in host.blocks:
        raise BenchError(f"the run on {BUS} failed; look at `pcpc run {RIG} --bus {BUS}`")
    times = timing(host.blocks["executive"])[:, round(SETTLE_S * rig.config.rate_hz) :]
    if not times.size:
        raise BenchError(f"the run on {BUS} ended after {SETTLE_S:g} s or sooner")
    return float(np.percentile(times[0], 99)), float(np.percentile(times[1], 99))


def timing(block: sh.NodeMemory) -> NDArray[np.float64]:
    """Return lateness and work of each cycle that its record ring holds, (2, cycles), us."""
    put, rows = int(block.ends("record").head), block["record_values"]
    newest = rows[np.arange(max(0, put - len(rows)), put) % len(rows)]
    names = block.description["timing_columns"]
    columns = newest[:, newest.shape[1] - len(names) :].T
    late = columns[names.index("timing.wake_late_us")]
    return np.stack([late, sum(columns[names.index(name)] for name in STAGES)])


def throughput(progress: Progress, rounds: int) -> Ratio:
    """Return MB/s of Recorder.drain against those of mcap's own writer."""
    run = VirtualRun(load_rig(RIG, settings=[f"duration_s={ROWS / 1000.0}"]), None)
    for _ in run.advance():
        pass
    with tempfile.TemporaryDirectory() as folder:
        ours = Recorder(Path(folder) / "ours.mcap", run.blocks)
        channels, messages = _messages(ours, run)
        size = 1e-6 * sum(len(data) for _, data in messages)
        theirs = Writer(str(Path(folder) / "theirs.mcap"), CHUNK_BYTES, CompressionType.ZSTD)
        theirs.start()
        ids = [theirs.register_channel(str(c), "cdr", 0) for c in range(channels)]

        def drain() -> float:
            for node in ours.nodes:
                node.taken = dict.fromkeys(sh.RINGS, 0)
            return size / _seconds(ours.drain)

        def add() -> None:
            for channel, data in messages:
                theirs.add_message(ids[channel], 0, data, 0)

        own, base = interleave(
            progress, "recorder throughput", rounds, (drain, lambda: size / _seconds(add))
        )
        theirs.finish()
        ours.finish()
    return Ratio.from_rounds(SUITE, "throughput", "mcap.Writer.add_message", own, base, "MB/s")


def _messages(recorder: Recorder, run: VirtualRun) -> tuple[int, list[tuple[int, bytes]]]:
    """Return the number of channels, and channel and payload of every record and frame."""
    messages, channel = [], 0
    for node in recorder.nodes:
        block = node.block
        put = {ring: int(block.ends(ring).head) for ring in ("record", "frame")}
        for row in block["record"][: put["record"]]:
            data = row.tobytes()
            messages.append((channel, data[20 : node.channels.state_end]))
            messages.append((channel + 1, data[node.channels.state_end + 4 :]))
        for row in block["frame"][: put["frame"]]:
            messages.append((channel + 2, row.tobytes()[4:]))
        channel += 3
    return channel, messages


def _seconds(action: Any) -> float:
    start = time.thread_time()
    action()
    return time.thread_time() - start
