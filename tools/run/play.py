"""`pcpc play LOG --bus BUS`: recorded frames on a real bus, at absolute deadlines.

The frames of the log's nodes go out in the order of the bus, each at the time that its stamp gives;
a thread of its own runs the compiled loop, so that its timing is that of a node. At the end: how
many frames, and how far from their deadlines.

The player imports numba, so it is imported only once the bus is known.

With --as the player stands in for one node. It waits, as that node would, until the other one is
heard, and then plays the recording whatever the other one sends: open loop.
"""

import os
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import can_id, choice
from pcpc.drivers.errors import BusError, Exit
from pcpc.drivers.machine import realtime
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import frames as play_frames
from pcpc.tools.after.log.frames import LoggedFrames, PlayError
from pcpc.tools.after.opened import Opened
from pcpc.tools.run.commands import PlayRequest
from pcpc.tools.run.played import Played, TimingError, lines_of
from pcpc.tools.start.interface import named_bus
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.progress import Progress

if TYPE_CHECKING:
    from pcpc.executive.nodes.player import Player

_POLL_S = 0.1
PEER_S = 300.0  # that a player waits for the node opposite, as a rig's node does
_LONG_READ_BYTES = 20 << 20  # about a second


def command(request: PlayRequest) -> int:
    """Play a log."""
    progress = Progress(request.quiet)
    _check(request)
    path = Path(request.log)
    if path.is_file() and path.stat().st_size > _LONG_READ_BYTES:
        progress.show(f"reading {path}")
    log = Opened(path).log
    everything = play_frames.bus_frames(log)
    frames = chosen_frames(everything, request)
    progress.close()
    for line in log.missing:
        print(f"{path}: missing: {line}", file=sys.stderr)
    held = _take_bus(request, log)
    return PlaySession(request, held.bus, everything, frames, log.missing, progress).run()


def _check(request: PlayRequest) -> None:
    """Raise PlayError for a number that makes no sense, RigError for a bus that cannot be."""
    rate, loop, start_s, duration_s, priority = (
        request.rate, request.loop, request.start_s, request.duration_s, request.priority,
    )  # fmt: skip
    factor, times = "0 (as fast as possible) or a positive factor", "a number of times, or nothing"
    for name, value, good, expected in (
        ("-r", rate, 0.0 <= rate < 1e9, factor),
        ("--loop", loop, loop is None or loop >= 0, times),
        ("--start", start_s, 0.0 <= start_s < 1e9, "seconds, 0 or more"),
        (
            "--duration",
            duration_s,
            duration_s is None or 0.0 < duration_s < 1e9,
            "seconds, more than 0",
        ),
        ("-p", priority, 1 <= priority <= 99, "a priority of 1 to 99"),
    ):
        if not good:
            raise PlayError(f"{name} {value:g}: expected {expected}")
    if request.step and request.loop is not None:
        raise PlayError("--step with --loop: leave out one of them")
    if request.no_wait and request.role is None:
        raise PlayError("--no-wait: only with --as")
    named = buses.parse(request.bus)
    if named[0] != "auto" and not named_bus(named, f"--bus {request.bus}").compiled:
        os.environ["PCPC_LOOP"] = "interpreted"  # before numba is imported


def chosen_frames(frames: LoggedFrames, request: PlayRequest) -> LoggedFrames:
    """Return the frames that a request asks for; PlayError if none."""
    span_s = request.start_s, request.duration_s
    return play_frames.choose(frames, request.log, request.role, request.only, *span_s)


def _take_bus(request: PlayRequest, log: logs.Log) -> choice.Choice:
    """Return the bus, held; with --as and no bus named, that of the node opposite."""
    rig = next((facts["rig"] for facts in log.metadata.values() if "rig" in facts), "")
    roles = () if request.role is None or not rig else (request.role,)
    return choice.take_bus(choice.BusRequest(*buses.parse(request.bus), rig=rig, roles=roles))


@dataclass
class PlaySession:
    """One playing of `frames`, chosen from `everything` in a log."""

    request: PlayRequest
    bus: buses.BusAddress
    everything: LoggedFrames
    frames: LoggedFrames
    missing: list[str]
    progress: Progress
    interrupted: bool = False
    report: realtime.Report = field(default_factory=lambda: realtime.Report(()))

    def run(self) -> int:
        """Play; print the result; return the exit code."""
        player = self._make()
        self._say_what()
        try:
            self._wait_for_peer(player)
            player.close_ears()
            if self.request.step:
                self._step(player)
            else:
                self._play(player)
        except KeyboardInterrupt:
            self.interrupted = True
        finally:
            self.progress.close()
        return self._conclude(player)

    def _make(self) -> "Player":
        """Return a player of the chosen frames with the bus open; BusError."""
        from pcpc.executive.nodes.player import Player  # numba

        rate, stamps = self.request.rate, self.frames.stamp_ns
        timed = rate > 0.0
        due = np.rint((stamps - stamps[0]) / rate) if timed else np.zeros(len(stamps))
        period = self.frames.period_ns
        lap = (self.frames.span_ns // period + 1) * period  # whole periods: cyclic frames stay so
        player = Player(
            self.frames.raw, due.astype(np.int64), round(lap / rate) if timed else 0, timed=timed
        )
        player.open(self.bus, [int(i) & can_id.ID for i in self._peer_words()])
        return player

    def _peer_words(self) -> list[int]:
        """Return the ids that the node opposite sends, which show that it lives."""
        role = self.request.role
        if role is None:
            return []
        peer = play_frames.PEER[role]
        return sorted({int(i) for i in self.everything.words[self.everything.sent_by(peer)]})

    def _say_what(self) -> None:
        request, frames = self.request, self.frames
        how = f" at rate {request.rate:g}" if request.rate != 1.0 else ""
        self.progress.say(
            f"{len(frames)} frames, {1e-9 * frames.span_ns:.3f} s recorded, on {self.bus}{how}"
        )
        if frames.left_out:
            self.progress.say(f"left out: {frames.left_out} remote and error frames")
        if not self.bus.compiled:
            self.progress.say(f"{self.bus.interface}: through python-can, interpreted and slow")
        if request.role is not None:
            peer = play_frames.PEER[request.role]
            self.progress.say(
                f"open loop: the recorded {request.role} does not react to what the {peer} sends"
            )

    def _wait_for_peer(self, player: "Player") -> None:
        """Wait for a frame of the node opposite, as the node that is played would."""
        words, role = np.array(self._peer_words(), np.int64), self.request.role
        if self.request.no_wait or role is None or not len(words):
            return
        peer, begin = play_frames.PEER[role], time.monotonic()
        try:
            while not player.hear(words):
                waited = time.monotonic() - begin
                self.progress.show(f"waiting for the {peer} on {self.bus}, {waited:.0f} s")
                if waited > PEER_S:
                    ids = ", ".join(f"0x{can_id.text_of(int(word))}" for word in words)
                    what = f"no frame of the {peer} ({ids}) for {waited:.0f} s"
                    raise BusError(f"{self.bus}: {what}; start it, or play with --no-wait")
        except OSError as error:
            raise BusError(f"{self.bus}: receiving failed: {error.strerror}") from None

    def _play(self, player: "Player") -> None:
        """Run the loop in a thread of its own, and show how far it is; raise what it raises."""
        if self.request.rate > 0.0:  # one that never sleeps must not lock up a processor
            self.report = realtime.prepare_process()
        errors: list[Exception] = []

        def play() -> None:
            try:
                self._thread(player)
            except Exception as error:
                errors.append(error)

        thread = threading.Thread(target=play, daemon=True)
        thread.start()
        try:
            while thread.is_alive():
                thread.join(_POLL_S)
                self.progress.show(self._line(player))
        except KeyboardInterrupt:
            self.interrupted = True
        finally:
            player.stop()
            thread.join()
        for error in errors:
            raise error

    def _thread(self, player: "Player") -> None:
        if self.request.rate > 0.0:
            self.report += realtime.prepare_thread(self.request.priority, None)
        laps = 1 if self.request.loop is None else self.request.loop
        period, first = self.frames.period_ns, int(self.frames.stamp_ns[0])
        # Nodes wake at whole periods of the clock: frames keep their place between them. In virtual
        # time all stamps are whole periods; half of one keeps clear of the nodes' own time.
        player.play(player.soon_ns(period, first % period or period // 2), laps)

    def _line(self, player: "Player") -> str:
        sent, errors = player.count("sent"), player.count("errors")
        total = self._total()
        done = f"{sent}" + (f"/{total}" if total else "")
        late = f", late p99 {player.error_us(0.99):.0f} us" if self.request.rate > 0.0 else ""
        return f"{done} frames{late}" + (f", {errors} send errors" if errors else "")

    def _total(self) -> int:
        """Return how many frames are to be sent, 0 for endless."""
        return len(self.frames) * (1 if self.request.loop is None else self.request.loop)

    def _step(self, player: "Player") -> None:
        """Send one frame, or the frames of one cycle, for each line of the standard input."""
        frames = self.frames
        by_cycle = self.request.step == "cycle"
        ends = play_frames.cycles(frames) if by_cycle else np.arange(len(frames) + 1)
        self.progress.say(f"Enter sends the next {self.request.step}, Ctrl-D ends")
        for first, end in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
            if not sys.stdin.readline():
                return
            player.play_part(first, end)
            at_s = 1e-9 * float(frames.stamp_ns[first] - self.everything.stamp_ns[0])
            what = " ".join(frames.label(i) for i in range(first, end))
            self.progress.say(f"{at_s:.6f} s, cycle {frames.cycle[first]}: {what}")

    def _conclude(self, player: "Player") -> int:
        result = self._result(player)
        if warning := self.report.warning():
            self.progress.say(f"player: {warning}")
        screen.answer(self.request.json, result, lines_of(result), 2)
        if self.interrupted:
            return Exit.INTERRUPTED
        return Exit.LOSS if result.send_errors or self.missing else Exit.OK

    def _result(self, player: "Player") -> Played:
        """Return what was played and how well; nothing about time where there is no schedule."""
        sent, errno = player.count("sent"), player.count("errno")
        spent_ns = player.count("last_sent") - player.count("first_sent")
        planned_ns = player.count("last_due") - player.count("first_due")
        timed = bool(player.n.timed) and sent > 0
        is_scheduled = timed and not self.request.step and planned_ns > 0
        late = (
            TimingError(player.error_us(0.5), player.error_us(0.99), 1e-3 * player.count("max_ns"))
            if timed
            else None
        )
        return Played(
            log=str(self.request.log),
            bus=str(self.bus),
            rate=self.request.rate,
            frames=sent,
            frames_planned=self._total() or None,
            duration_s=1e-9 * spent_ns,
            total_error_percent=100.0 * (spent_ns - planned_ns) / planned_ns
            if is_scheduled
            else None,
            timing_error_us=late,
            within_200us_percent=100.0 * player.count("within") / sent if timed else None,
            send_errors=player.count("errors"),
            last_send_error=os.strerror(errno) if player.count("errors") else None,
            queue_full=player.count("waited"),
            left_out=self.frames.left_out,
            missing=self.missing,
            realtime=self.report.is_realtime,
            interrupted=self.interrupted,
        )
