"""`pcpc play LOG --bus BUS`: recorded frames on a real bus, at absolute deadlines.

The frames of the log's nodes go out in the order of the bus, each at the time that its stamp gives;
a thread of its own runs the compiled loop, so that its timing is that of a node. At the end: how
many frames, and how far from their deadlines.

The player imports numba, so it is imported only once the bus is known.

With --as the player stands in for one node. It waits, as that node would, until the other one is
heard, and then plays the recording whatever the other one sends: open loop.
"""

import argparse
import json
import os
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pcpc.drivers.can import bus as buses
from pcpc.drivers.can import can_id, choice
from pcpc.drivers.errors import BusError, Exit
from pcpc.drivers.machine import realtime
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import frames as play_frames
from pcpc.tools.after.log.frames import Frames, PlayError
from pcpc.tools.start.interface import named_bus
from pcpc.tools.terminal.progress import Progress

if TYPE_CHECKING:
    from pcpc.executive.nodes.player import Player

PRIORITY = 70  # that of an emulator, below the executive's 80
_POLL_S = 0.1
PEER_S = 300.0  # that a player waits for the node opposite, as a rig's node does
_LONG_READ_BYTES = 20 << 20  # about a second


def command(options: argparse.Namespace) -> int:
    """Play a log."""
    progress = Progress(options.quiet)
    _check(options)
    path = Path(options.log)
    if path.is_file() and path.stat().st_size > _LONG_READ_BYTES:
        progress.show(f"reading {path}")
    log = logs.read(path)
    everything = play_frames.bus_frames(log)
    frames = play_frames.choose(everything, options, options.log)
    progress.close()
    for line in log.missing:
        print(f"{path}: missing: {line}", file=sys.stderr)
    held = _take_bus(options, log)
    return Session(options, held.bus, everything, frames, log.missing, progress).run()


def _check(options: argparse.Namespace) -> None:
    """Raise PlayError for a number that makes no sense, RigError for a bus that cannot be."""
    for name, wrong, expected in (
        ("-r", not 0.0 <= options.rate < 1e9, "0 (as fast as possible) or a positive factor"),
        ("--loop", options.loop is not None and options.loop < 0, "a number of times, or nothing"),
        ("--start", not 0.0 <= options.start < 1e9, "seconds, 0 or more"),
        (
            "--duration",
            options.duration is not None and not 0.0 < options.duration < 1e9,
            "seconds, more than 0",
        ),
        ("-p", not 1 <= options.priority <= 99, "a priority of 1 to 99"),
    ):
        if wrong:
            option = {"-r": "rate", "-p": "priority"}.get(name, name.strip("-"))
            raise PlayError(f"{name} {getattr(options, option):g}: expected {expected}")
    if options.step and options.loop is not None:
        raise PlayError("--step with --loop: leave out one of them")
    if options.no_wait and options.role is None:
        raise PlayError("--no-wait: only with --as")
    named = buses.parse(options.bus)
    if named[0] != "auto" and not named_bus(named, f"--bus {options.bus}").compiled:
        os.environ["PCPC_LOOP"] = "interpreted"  # before numba is imported


def _take_bus(options: argparse.Namespace, log: logs.Log) -> choice.Choice:
    """Return the bus, held; with --as and no bus named, that of the node opposite."""
    rig = next((facts["rig"] for facts in log.metadata.values() if "rig" in facts), "")
    roles = () if options.role is None or not rig else (options.role,)
    return choice.take_bus(choice.BusRequest(*buses.parse(options.bus), rig=rig, roles=roles))


@dataclass
class Session:
    """One playing of `frames`, chosen from `everything` in a log."""

    options: argparse.Namespace
    bus: buses.Bus
    everything: Frames
    frames: Frames
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
            if self.options.step:
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

        rate, stamps = self.options.rate, self.frames.stamp_ns
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
        role = self.options.role
        if role is None:
            return []
        peer = play_frames.PEER[role]
        return sorted({int(i) for i in self.everything.words[self.everything.sent_by(peer)]})

    def _say_what(self) -> None:
        options, frames = self.options, self.frames
        how = f" at rate {options.rate:g}" if options.rate != 1.0 else ""
        self.progress.say(
            f"{len(frames)} frames, {1e-9 * frames.span_ns:.3f} s recorded, on {self.bus}{how}"
        )
        if frames.left_out:
            self.progress.say(f"left out: {frames.left_out} remote and error frames")
        if not self.bus.compiled:
            self.progress.say(f"{self.bus.interface}: through python-can, interpreted and slow")
        if options.role is not None:
            peer = play_frames.PEER[options.role]
            self.progress.say(
                f"open loop: the recorded {options.role} does not react to what the {peer} sends"
            )

    def _wait_for_peer(self, player: "Player") -> None:
        """Wait for a frame of the node opposite, as the node that is played would."""
        words = np.array(self._peer_words(), np.int64)
        if self.options.no_wait or not len(words):
            return
        peer, begin = play_frames.PEER[self.options.role], time.monotonic()
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
        """Run the loop in a thread of its own, and show how far it is."""
        if self.options.rate > 0.0:  # one that never sleeps must not lock up a processor
            self.report = realtime.prepare_process()
        thread = threading.Thread(target=self._thread, args=(player,), daemon=True)
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

    def _thread(self, player: "Player") -> None:
        if self.options.rate > 0.0:
            self.report += realtime.prepare_thread(self.options.priority, None)
        laps = 1 if self.options.loop is None else self.options.loop
        period, first = self.frames.period_ns, int(self.frames.stamp_ns[0])
        # Nodes wake at whole periods of the clock: frames keep their place between them. In virtual
        # time all stamps are whole periods; half of one keeps clear of the nodes' own time.
        player.play(player.soon_ns(period, first % period or period // 2), laps)

    def _line(self, player: "Player") -> str:
        sent, errors = player.count("sent"), player.count("errors")
        total = self._total()
        done = f"{sent}" + (f"/{total}" if total else "")
        late = f", late p99 {player.error_us(0.99):.0f} us" if self.options.rate > 0.0 else ""
        return f"{done} frames{late}" + (f", {errors} send errors" if errors else "")

    def _total(self) -> int:
        """Return how many frames are to be sent, 0 for endless."""
        return len(self.frames) * (1 if self.options.loop is None else self.options.loop)

    def _step(self, player: "Player") -> None:
        """Send one frame, or the frames of one cycle, for each line of the standard input."""
        frames = self.frames
        by_cycle = self.options.step == "cycle"
        ends = play_frames.cycles(frames) if by_cycle else np.arange(len(frames) + 1)
        self.progress.say(f"Enter sends the next {self.options.step}, Ctrl-D ends")
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
        print(json.dumps(result, indent=2) if self.options.json else text_of(result))
        if self.interrupted:
            return Exit.INTERRUPTED
        return Exit.LOSS if result["send_errors"] or self.missing else Exit.OK

    def _result(self, player: "Player") -> dict[str, Any]:
        """Return what was played and how well; nothing about time where there is no schedule."""
        sent, errno = player.count("sent"), player.count("errno")
        spent_ns = player.count("last_sent") - player.count("first_sent")
        planned_ns = player.count("last_due") - player.count("first_due")
        timed = bool(player.n.timed) and sent > 0
        whole = timed and not self.options.step and planned_ns > 0
        return {
            "log": str(self.options.log),
            "bus": str(self.bus),
            "rate": self.options.rate,
            "frames": sent,
            "frames_planned": self._total() or None,
            "duration_s": 1e-9 * spent_ns,
            "total_error_percent": 100.0 * (spent_ns - planned_ns) / planned_ns if whole else None,
            "timing_error_us": {
                "p50": player.error_us(0.5),
                "p99": player.error_us(0.99),
                "max": 1e-3 * player.count("max_ns"),
            } if timed else None,
            "within_200us_percent": 100.0 * player.count("within") / sent if timed else None,
            "send_errors": player.count("errors"),
            "last_send_error": os.strerror(errno) if player.count("errors") else None,
            "queue_full": player.count("waited"),
            "left_out": self.frames.left_out,
            "missing": self.missing,
            "realtime": self.report.is_realtime,
            "interrupted": self.interrupted,
        }  # fmt: skip


def text_of(result: dict[str, Any]) -> str:
    """Return the result in lines to read."""
    planned = result["frames_planned"]
    sent, spent = result["frames"], result["duration_s"]
    lines = [f"frames        {sent}" + (f" of {planned}" if planned else "")]
    total = result["total_error_percent"]
    speed = f", {sent / spent:.0f} frames/s" if spent > 0.0 else ""
    error = f", total time error {total:+.5f} %" if total is not None else ""
    lines.append(f"duration      {spent:.3f} s{speed}{error}")
    late = result["timing_error_us"]
    if late is not None:
        lines.append(
            f"timing error  p50 {late['p50']:.1f} us, p99 {late['p99']:.1f} us, max "
            f"{late['max']:.1f} us; {result['within_200us_percent']:.2f} % within 200 us"
        )
    reason = f", the last: {result['last_send_error']}" if result["send_errors"] else ""
    lines.append(f"send errors   {result['send_errors']}{reason}")
    if result["queue_full"]:
        lines.append(f"bus queue     full {result['queue_full']} times, waited each time")
    return "\n".join(lines)
