"""How a run was carried out, as HTML: timing, bus, configuration, versions, how to replay it."""

import shlex
from collections.abc import Mapping

from pcpc.executive.log import reader as logs
from pcpc.executive.log.long_logs import WITHOUT_CLOCK
from pcpc.tools.after.html import table, text
from pcpc.tools.after.log.rig import carried_by
from pcpc.tools.after.report import figures
from pcpc.tools.after.report.record import RESOLVED, Record
from pcpc.tools.after.report.sections import drawn_as, listed
from pcpc.tools.start.bus.report import rate_of
from pcpc.tools.start.bus.traffic import MOST_CLASSIC

MOST_LETTERS = 200_000  # of a rig file
REPLAY_S, REPLAY_CYCLE_S = 2.0, 20e-6  # to begin; a cycle of a node: measured, a processor of 2025
_COUNTS = {  # of the summary's frames: in words
    "lost": "lost", "lost_on_purpose": "lost on purpose",
    "stale": "cycles without a valid input", "crc_errors": "wrong CRC or length",
    "repeated": "repeated", "wrong_sequence": "jumps of the counter",
    "implausible": "values that were not plausible", "intrusions": "signs of a second sender",
    "foreign": "frames of this rig's from another sender",
    "send_errors": "frames that the bus did not take", "bus_errors": "error frames",
    "bus_offs": "bus-off", "saturated_values": "values cut to what a signal holds",
}  # fmt: skip


def timing(record: Record) -> str:
    """Return how late the executive woke and how long each stage took."""
    told = record.told
    if record.facts.get("pacing") in WITHOUT_CLOCK:
        return "<p>No clock ran: nothing could be late.</p>"
    drawn = drawn_as("histogram of lateness and work", figures.lateness(record))
    if told is None or not told.timing_us:
        return drawn
    points = list(next(iter(told.timing_us.values())))
    rows = [(text(stage), *(f"{values.get(p, 0.0):.1f}" for p in points))
            for stage, values in told.timing_us.items()]  # fmt: skip
    stages = table(("stage [us]", *map(text, points)), rows, range(1, len(points) + 1))
    words = (
        f"<p>{told.late_cycles:,} cycles late, {told.skipped_cycles:,} skipped, "
        f"{told.held_cycles:,} held, of {told.cycles:,}. {text(told.timing_level)}: lateness and "
        f"work at p99.9 are {told.timing_share:.1%} of a period.</p>"
    )
    keys = ("cycle", "wake_late_us", "work_us", "cause")
    latest = [[text(one.get(key, "")) for key in keys] for one in told.latest_cycles]
    head = ("cycle", "late [us]", "work [us]", "why")
    return drawn + words + stages + listed("The latest cycles", head, latest, (0, 1, 2))


# The bus


def bus(record: Record) -> str:
    """Return the frames of each bus with its load, and where they went."""
    nodes = ("executive", "plant") if "local" in record.log.node else (record.tally.heard(),)
    seen = [_frames(record, node) for node in nodes if node in record.log.node]
    if told := record.told:
        rows = [(words, f"{told.frames.get(key, 0):,}") for key, words in _COUNTS.items()]
        most = f"<p>{text(told.most_cut)}</p>" if told.most_cut else ""
        wrong = f"<h3>What went wrong, of all nodes</h3>{table(('', ''), rows, (1,))}{most}"
        return "".join([*seen, _account(told.frames_to), wrong])
    bad = [(text(node), text(state), f"{n:,}")
           for node, row in record.tally.e2e(record.log.node).items()
           for state, n in row.items()]  # fmt: skip
    head = ("node", "state", "count")
    return "".join([*seen, listed("Received frames that were not valid", head, bad, (2,))])


def _frames(record: Record, node: str) -> str:
    """Return what a node sent and received, and which share of its bus that takes."""
    duration_s = record.tally.duration_s(logs.topic(node, "can/frames"))
    found = record.tally.frames(logs.frame_names(record.log), duration_s, node)
    if not found:
        return ""
    config = record.judge.rig.config if record.judge else None
    own = config and (config.local.bus if config.local and node == "plant" else None)
    given = (own and own.bits_per_s) or (config and config.bus.bits_per_s)
    room = duration_s * (given or MOST_CLASSIC)
    rows = [
        (text(row["name"]), row["id"], row["direction"], f"{row['count']:,}",
         "" if row["rate_hz"] is None else f"{row['rate_hz']:,.1f}",
         f"{row['bits'] / room:.2%}" if room else "")
        for row in found
    ]  # fmt: skip
    head = ("frame", "id", f"by the {node}", "count", "per second", "of the bus")
    share = sum(row["bits"] for row in found) / room if room else 0.0
    rate = rate_of(given or MOST_CLASSIC) + ("" if given else ", assumed: no bit rate is known")
    load = f"<p>Load: <b>{share:.1%}</b> of {rate}; each frame with the most stuff bits.</p>"
    return load + table(head, rows, (3, 4, 5))


def _account(frames_to: Mapping[str, Mapping[str, int]]) -> str:
    """Return where the frames to each node went."""
    keys = dict.fromkeys(key for row in frames_to.values() for key in row)
    rows = [
        (text(node), *(f"{row[key]:,}" if key in row else "" for key in keys))
        for node, row in frames_to.items()
    ]
    head = ("to", *(text(key.replace("_", " ")) for key in keys))
    return f"<h3>Where the frames went</h3>{table(head, rows, range(1, len(head)))}" if rows else ""


# What it was


def configuration(record: Record) -> str:
    """Return the rig as it was written, what was set besides, and all its values."""
    texts = {n: t for n, t in record.log.attachments.items() if n.endswith((".yaml", ".yml"))}
    if not texts:
        return "<p>The log holds no rig.</p>"
    changed = record.told.changed if record.told else []
    said = "".join(f"<li><code>{text(one)}</code></li>" for one in changed)
    parts = [f"<p>Changed:</p><ul>{said}</ul>" if said else "<p>Nothing was changed.</p>"]
    if changed == [] and not record.at_end:
        parts = ["<p>What was set on the command line is among all values.</p>"]
    for name, content in texts.items():
        more = len(content) - MOST_LETTERS
        shown = content[:MOST_LETTERS] + (f"\n... and {more:,} letters" if more > 0 else "")
        if name.endswith(RESOLVED):
            name, tag = "All values, as they were used", "details"
            parts.append(f"<{tag}><summary>{name}</summary><pre>{text(shown)}</pre></{tag}>")
        else:
            parts.append(f"<h3>{text(name)}</h3><pre>{text(shown)}</pre>")
    return "".join(parts)


def versions(record: Record) -> str:
    """Return what made the run, and where."""
    facts = record.facts
    rows = [
        (text(name.removeprefix("version_")), text(value))
        for name, value in facts.items()
        if name.startswith("version_") or name in ("python", "git", "kernel", "machine",
                                                   "processor", "cpus")
    ]  # fmt: skip
    return table(("", ""), rows) if rows else ""


def replay(record: Record) -> str:
    """Return how to compute the run again from its log, and what identifies the log."""
    log = record.log
    about = table(("", ""), [
        ("file", f"<code>{text(record.path)}</code>, {record.tally.found.size:,} bytes"),
        ("sha256", f"<code>{record.sha256}</code>"),
    ])  # fmt: skip
    if not any(name.endswith(RESOLVED) for name in log.attachments):
        return f"<p>The log holds no rig, so it cannot be replayed.</p>{about}"
    try:
        foreign = bool(carried_by(log))
    except logs.LogError as error:
        return f"<p>{text(error)}</p>{about}"
    cycles = sum(len(node.cycle) for node in log.node.values())
    takes_s = REPLAY_S + REPLAY_CYCLE_S * cycles
    takes = f"{takes_s:.0f} s" if takes_s < 120 else f"{takes_s / 60:.0f} min"
    where = (
        "Its laws come from outside the project: where their files are not in their places, "
        "add <code>--law FILE</code>, or <code>--trust</code> if you trust who made the log."
    )
    command = f"pcpc replay {shlex.quote(str(record.path))}"
    return (
        f"<p><code>{text(command)}</code> computes every node again and compares each bit: about "
        f"{takes}. {where if foreign else ''}</p>{about}"
    )
