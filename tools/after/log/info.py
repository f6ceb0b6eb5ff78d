"""`pcpc log info`: what a log holds, on one screen.

Reads the file once, message by message, so that a damaged, cut or empty log is described as far as
it goes. `start` is the first cycle on the wall clock; of a run without a clock, when it was made.
"""

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from msgspec import UNSET, to_builtins

from pcpc.drivers.errors import Exit
from pcpc.executive.log import reader as logs
from pcpc.executive.log.mcap_reader import Scan
from pcpc.executive.log.provenance import RIG_COMMIT, rig_commits
from pcpc.tools.after.log import source
from pcpc.tools.after.log.commands import InfoRequest
from pcpc.tools.after.log.contents import DIRECTIONS, Contents, Foreign, Machine
from pcpc.tools.after.log.foreign import survey
from pcpc.tools.after.log.tally import Tally
from pcpc.tools.terminal import document, screen
from pcpc.tools.terminal.progress import Progress

_FACTS = ("rig", "controller", "pacing", "bus", "seed", "rate_hz")
_TOPICS = 60  # on the screen; our logs have 15
_SHOWN = 12  # events and tunings on the screen; all of them with --json


def command(request: InfoRequest) -> int:
    """Carry out `info`; return the exit code."""
    path, progress = request.log, Progress(request.quiet)
    try:
        report = to_builtins(describe(path, progress))
    except logs.LogError as error:
        if foreign := survey(path):
            foreign.reason = str(error)
            _show_foreign(foreign, request.json)
            if foreign.damaged is UNSET:  # others have other records
                raise logs.LogError(f"{path}: an MCAP file, but not a log of pcpc") from None
        raise
    progress.close()
    if request.json:
        print(screen.json_text(report))
    else:
        show(report)
    return Exit.LOSS if report["missing"] else Exit.OK


def describe(path: Path, progress: Progress) -> Contents:
    """Return what `--json` prints; LogError if the file is no log of this project."""
    scanned = Scan()
    tally = Tally(scanned)
    for channel, piece in source.stream(path, scanned, progress):
        tally.add(channel, source.messages(piece))
    log = logs.assemble(path, scanned)
    facts = log.metadata[next(iter(log.node))]
    lead = logs.topic(next(iter(log.node)), "state")
    if lead not in tally.first_ns:  # frames only
        lead = logs.topic(next(iter(log.node)), "can/frames")
    zero_ns, duration_s = tally.first_ns.get(lead, 0), tally.duration_s(lead)
    events = tally.entries("events", zero_ns)
    return Contents(
        file=str(path),
        bytes=scanned.size,
        bytes_per_hour=round(scanned.size / duration_s * 3600) if duration_s else None,
        **{name: facts.get(name, "") for name in _FACTS},
        rig_git=rig_commits(log.metadata, log.node),
        start=start_of(facts, zero_ns),
        duration_s=duration_s,
        versions={k.removeprefix("version_"): v for k, v in facts.items()
                  if k.startswith("version_") or k in ("python", "git")},
        machine=Machine(**{key: facts.get(key, "") for key in Machine.__struct_fields__}),
        nodes={name: tally.cycles(logs.topic(name, "state")) for name in log.node},
        frames=tally.frames(logs.frame_names(log), duration_s),
        e2e=tally.e2e(log.node),
        faults=[e for e in events if e.get("event") == "fault"],
        events=events,
        tunings=tally.entries("tunings", zero_ns),
        topics=tally.topics(),
        attachments={name: len(text.encode()) for name, text in log.attachments.items()}
        | {name: len(data) for name, data in log.files.items()},
        recorder=log.metadata.get("run", {}),
        recovered=log.metadata.get("recovered", {}),
        missing=log.missing + tally.left_out(),
    )  # fmt: skip


def start_of(facts: Mapping[str, str], wall_ns: int) -> str:
    """Return when the run began, ISO 8601 in UTC; empty if the log does not tell."""
    if facts.get("pacing") == "virtual" or not wall_ns:
        wall_ns = int(facts.get("clock_wall_ns", 0))
    if not 0 < wall_ns < 1 << 62:
        return ""
    return datetime.fromtimestamp(wall_ns // 1000 / 1e6, UTC).isoformat(timespec="milliseconds")


def show(report: Mapping[str, Any]) -> None:
    """Print a report on stdout."""
    texts = {label: own for label, own in _texts(report).items() if own}
    broad = max(map(len, texts)) + 2
    document.show(document.terminal(document.LabelledTexts(texts, broad)), broad)


def _texts(report: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the texts of each label on the screen."""
    facts = (f"{name} {report[name]}" for name in _FACTS[1:] if report[name])
    bad = [f"{name} {state} {n}" for name, row in report["e2e"].items() for state, n in row.items()]
    topics = [
        f"{row['topic']:20} {row['messages']:>9} messages {_size(row['bytes']):>10}"
        for row in report["topics"]
    ]
    hour = report["bytes_per_hour"]
    per_hour = "" if hour is None else f", {_size(hour)} an hour"
    return {
        "rig": [", ".join((str(report["rig"]), *facts))],
        "rig's commit": [report[RIG_COMMIT]] if report[RIG_COMMIT] else [],
        "start": [f"{report['start'] or 'unknown'}, for {report['duration_s']:g} s"],
        **{name: [_node_text(node)] for name, node in report["nodes"].items()},
        "frames": [_frames_text(report["frames"], way) for way in DIRECTIONS],
        "e2e errors": [", ".join(bad) or "none"],
        **{
            kind: screen.some([*map(_line, report[kind])], _SHOWN) or ["none"]
            for kind in ("faults", "events", "tunings")
        },
        "topics": screen.some(topics, _TOPICS),
        "size": [f"{_size(report['bytes'])}{per_hour} (compressed)"],
        "attachments": [", ".join(report["attachments"]) or "none"],
        "versions": [", ".join(f"{name} {text}" for name, text in report["versions"].items())],
        "machine": [", ".join(text for text in report["machine"].values() if text)],
        "recorder": [_recorder_text(report["recorder"])] if report["recorder"] else [],
        "recovered": [f"{name}: {text}" for name, text in report["recovered"].items()],
        "missing": report["missing"] or ["nothing"],
    }


def _node_text(node: Mapping[str, int | None]) -> str:
    span = f" ({node['first']} to {node['last']})" if node["cycles"] else ""
    lost = f", {node['lost']} lost" if node["lost"] else ""
    return f"{node['cycles']} cycles{span}, {node['skipped']} skipped{lost}"


def _line(entry: Mapping[str, Any]) -> str:
    """Return an event or a tuning with its time."""
    at = f"{entry['time_s']:+.3f} s  {entry['node']}  cycle {entry.get('cycle')}"
    return f"{at}  {entry_text(entry)}"


def _frames_text(frames: list[dict[str, Any]], direction: str) -> str:
    texts = [
        f"{row['name'] or row['id']} {row['count']}"
        + (f" ({row['rate_hz']:g}/s)" if row["rate_hz"] is not None else "")
        for row in frames
        if row["direction"] == direction
    ]
    return f"{direction}: {', '.join(texts) or 'none'}"


def _recorder_text(counts: Mapping[str, str]) -> str:
    return ", ".join(
        f"{sum(int(n) for name, n in counts.items() if name.split('.')[0] == kind)} records {kind}"
        for kind in ("written", "dropped", "discarded")
    )


def entry_text(entry: Mapping[str, Any]) -> str:
    """Return an event or a tuning in words: what happened, to what, and the number that it has."""
    kind, name, value = (entry.get(key) for key in ("event", "name", "value"))
    if kind in (None, "change", "alarm"):
        return " ".join(str(word) for word in (kind, name, value) if word is not None)
    count = entry.get("argument")
    numbers = {
        "skip": f"{count} periods", "late": f"by {1e-3 * _number(count):.1f} us",
        "fallback": f"{count} periods behind",
    }  # fmt: skip
    return f"{kind} {name or numbers.get(str(kind), '' if count is None else count)}".rstrip()


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def _size(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} GB"


def _show_foreign(foreign: Foreign, as_json: bool) -> None:
    if as_json:
        print(screen.json_text(foreign))
        return
    if not foreign.library and not foreign.topics:
        return  # nothing tells whose it is
    print(f"{foreign.file}: an MCAP file written by {foreign.library or 'others'}")
    for topic, count in foreign.topics.items():
        print(f"{topic}  {count} messages")
