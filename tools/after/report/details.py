"""How a run was carried out: timing, bus, configuration, versions, how to replay it."""

import shlex
from collections.abc import Mapping

from pcpc.executive.log import reader as logs
from pcpc.executive.log.long_logs import WITHOUT_CLOCK
from pcpc.tools.after.log.rig import carried_by
from pcpc.tools.after.report import figures
from pcpc.tools.after.report.record import RESOLVED, ReportedRun
from pcpc.tools.after.report.sections import listed_section
from pcpc.tools.after.verdict.report import timing_text
from pcpc.tools.start.bus.report import rate_of
from pcpc.tools.start.bus.traffic import MOST_CLASSIC
from pcpc.tools.terminal.document import (
    Block,
    Bullets,
    Code,
    Part,
    Picture,
    Section,
    Strong,
    Table,
)
from pcpc.tools.terminal.html import png_of

MOST_LETTERS = 200_000  # of a rig file
REPLAY_S, REPLAY_CYCLE_S = 2.0, 20e-6  # to begin; a cycle of a node: measured, a processor of 2025
_COUNTS = {  # of the summary's frames: in words
    "lost": "lost", "lost_on_purpose": "lost on purpose",
    "stale": "cycles without a valid input", "crc_errors": "wrong CRC or length",
    "repeated": "repeated", "wrong_sequence": "jumps of the counter",
    "implausible": "values that were not plausible", "intrusions": "signs of a second sender",
    "foreign": "frames of this rig from another sender",
    "send_errors": "frames that the bus did not take", "bus_errors": "error frames",
    "bus_offs": "bus-off", "saturated_values": "values clamped to the range of a signal",
}  # fmt: skip


def timing(record: ReportedRun) -> list[Part]:
    """Return how late the executive woke and how long each stage took."""
    summary = record.summary
    if record.facts.get("pacing") in WITHOUT_CLOCK:
        return ["No clock ran: nothing could be late."]
    page = figures.lateness(record) if record.is_drawn else None
    drawn = page and Picture(png_of(page), "histogram of lateness and work")
    if summary is None or not summary.timing_us:
        return [drawn]
    points = list(next(iter(summary.timing_us.values())))
    rows = [
        (stage, *(f"{values.get(p, 0.0):.1f}" for p in points))
        for stage, values in summary.timing_us.items()
    ]
    words = (
        f"{summary.late_cycles:,} cycles late, {summary.skipped_cycles:,} skipped, "
        f"{summary.held_cycles:,} held, of {summary.cycles:,}. {timing_text(summary)}."
    )
    keys = {"cycle": "cycle", "wake_late_us": "late [us]", "work_us": "work [us]", "cause": "why"}
    latest = [[one.get(key, "") for key in keys] for one in summary.latest_cycles]
    return [
        drawn, words, Table(("stage [us]", *points), rows, range(1, len(points) + 1)),
        listed_section("The slowest cycles", [*keys.values()], latest, (0, 1, 2)),
    ]  # fmt: skip


# The bus


def bus(record: ReportedRun) -> list[Part]:
    """Return the frames of each bus with its load, and where they went."""
    nodes = ("executive", "plant") if "local" in record.log.node else (record.tally.heard(),)
    parts = [part for node in nodes if node in record.log.node for part in _frames(record, node)]
    if summary := record.summary:
        rows = [(words, f"{summary.frames.get(key, 0):,}") for key, words in _COUNTS.items()]
        wrong = Section(
            "What went wrong, of all nodes", [Table(("", ""), rows, (1,)), summary.most_cut]
        )
        return [*parts, _account(summary.frames_to), wrong]
    bad = (
        (node, state, f"{n:,}")
        for node, row in record.tally.e2e(record.log.node).items()
        for state, n in row.items()
    )
    head = ("node", "state", "count")
    return [*parts, listed_section("Received frames that were not valid", head, bad, (2,))]


def _frames(record: ReportedRun, node: str) -> list[Part]:
    """Return what a node sent and received, and which share of its bus that takes."""
    duration_s = record.tally.duration_s(logs.topic(node, "can/frames"))
    config = record.judge.rig.config if record.judge else None
    own_bus = config and (config.local.bus if config.local and node == "plant" else None)
    bus = own_bus or (config and config.bus)
    data_bit = bus.data_bit if bus else 1.0
    counted = record.tally.frames(logs.frame_names(record.log), duration_s, node, data_bit)
    if not counted:
        return []
    bits_per_s = (own_bus and own_bus.bits_per_s) or (config and config.bus.bits_per_s)
    room = duration_s * (bits_per_s or MOST_CLASSIC)
    rows = [
        (row["name"], row["id"], row["direction"], f"{row['count']:,}",
         "" if row["rate_hz"] is None else f"{row['rate_hz']:,.1f}",
         f"{row['bits'] / room:.2%}" if room else "")
        for row in counted
    ]  # fmt: skip
    head = ("frame", "id", f"by the {node}", "count", "per second", "of the bus")
    share = sum(row["bits"] for row in counted) / room if room else 0.0
    rate = rate_of(bits_per_s or MOST_CLASSIC) + (
        "" if bits_per_s else ", assumed: no bit rate is known"
    )
    load = ("Load: ", Strong(f"{share:.1%}"), f" of {rate}; each frame with the most stuff bits.")
    return [load, Table(head, rows, (3, 4, 5))]


def _account(frames_to: Mapping[str, Mapping[str, int]]) -> Section:
    """Return where the frames to each node went."""
    keys = dict.fromkeys(key for row in frames_to.values() for key in row)
    rows = [
        (node, *(f"{row[key]:,}" if key in row else "" for key in keys))
        for node, row in frames_to.items()
    ]
    head = ("to", *(key.replace("_", " ") for key in keys))
    return Section("Where the frames went", [Table(head, rows, range(1, len(head)))])


# What it was


def configuration(record: ReportedRun) -> list[Part]:
    """Return the rig as it was written, what was set besides, and all its values."""
    texts = {n: t for n, t in record.log.attachments.items() if n.endswith((".yaml", ".yml"))}
    if not texts:
        return ["The log holds no rig."]
    changed = record.summary.changed if record.summary else []
    parts: list[Part] = ["Changed:", Bullets(map(Code, changed))]
    if not changed:
        parts = ["Nothing was changed."]
        if not record.at_end:
            parts = ["The list of all values includes those set on the command line."]
    for name, content in texts.items():
        more = len(content) - MOST_LETTERS
        shown = content[:MOST_LETTERS] + (f"\n... and {more:,} letters" if more > 0 else "")
        whole = name.endswith(RESOLVED)
        title = "All values, as they were used" if whole else name
        parts.append(Section(title, [Block(shown)], folded=whole))
    return parts


def versions(record: ReportedRun) -> Table:
    """Return what made the run, and where."""
    others = "python", "git", "kernel", "machine", "processor", "cpus"
    rows = [
        (name.removeprefix("version_"), value)
        for name, value in record.facts.items()
        if name.startswith("version_") or name in others
    ]
    return Table(("", ""), rows)


def replay(record: ReportedRun) -> list[Part]:
    """Return how to compute the run again from its log, and what identifies the log."""
    log = record.log
    size = f", {record.tally.found.size:,} bytes"
    log_table = Table(
        ("", ""), [("file", (Code(record.path), size)), ("sha256", Code(record.sha256))]
    )
    if not any(name.endswith(RESOLVED) for name in log.attachments):
        return ["The log holds no rig, so it cannot be replayed.", log_table]
    try:
        foreign = bool(carried_by(log))
    except logs.LogError as error:
        return [str(error), log_table]
    cycles = sum(len(node.cycle) for node in log.node.values())
    takes_s = REPLAY_S + REPLAY_CYCLE_S * cycles
    takes = f"{takes_s:.0f} s" if takes_s < 120 else f"{takes_s / 60:.0f} min"
    where = (
        " Its laws come from outside the project: if their files have moved or changed, add ",
        Code("--law FILE"), ", or ", Code("--trust"), " if you trust who made the log.",
    )  # fmt: skip
    command = Code(f"pcpc replay {shlex.quote(str(record.path))}")
    does = f" computes every node again and compares each bit: about {takes}."
    return [(command, does, *(where if foreign else ())), log_table]
