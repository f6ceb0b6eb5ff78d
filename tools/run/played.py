"""What `pcpc play` comes to: how many frames went out, and how far from their deadlines."""

from collections.abc import Iterator

from msgspec import Struct

from pcpc.tools.terminal.answer import Count


class TimingError(Struct):
    """How far frames were from their deadlines."""

    p50: float
    "us"
    p99: float
    "us"
    max: float
    "us"


class Played(Struct):
    """What was played."""

    log: str
    bus: str
    rate: float
    "times the recorded speed; 0: as fast as possible"
    frames: Count
    "sent"
    frames_planned: int | None
    "null: no end"
    duration_s: float
    "s, from the first frame to the last"
    total_error_percent: float | None
    "of the duration; null: no schedule"
    timing_error_us: TimingError | None
    "null: no schedule"
    within_200us_percent: float | None
    "of the frames; null: no schedule"
    send_errors: Count
    last_send_error: str | None
    "null: none"
    queue_full: Count
    "times"
    left_out: Count
    "remote and error frames"
    missing: list[str]
    "damage of the log, in words"
    realtime: bool
    "SCHED_FIFO was granted"
    interrupted: bool


def lines_of(result: Played) -> Iterator[str]:
    """Yield the result in lines to read."""
    planned = result.frames_planned
    sent, spent = result.frames, result.duration_s
    yield f"frames        {sent}" + (f" of {planned}" if planned else "")
    total = result.total_error_percent
    speed = f", {sent / spent:.0f} frames/s" if spent > 0.0 else ""
    error = f", total time error {total:+.5f} %" if total is not None else ""
    yield f"duration      {spent:.3f} s{speed}{error}"
    late = result.timing_error_us
    if late is not None:
        yield (
            f"timing error  p50 {late.p50:.1f} us, p99 {late.p99:.1f} us, max "
            f"{late.max:.1f} us; {result.within_200us_percent:.2f} % within 200 us"
        )
    reason = f", the last: {result.last_send_error}" if result.send_errors else ""
    yield f"send errors   {result.send_errors}{reason}"
    if result.queue_full:
        yield f"bus queue     full {result.queue_full} times, waited each time"
