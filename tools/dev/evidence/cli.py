"""`python -m pcpc.tools.dev.evidence`: inject every fault, count what noticed it, write it down."""

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import Exit
from pcpc.tools.dev.evidence import (
    alarms,
    campaign,
    envelope,
    frames,
    kills,
    matrix,
    mutants,
    report,
    residual,
)
from pcpc.tools.dev.evidence.options import PARTS, EvidenceRequest
from pcpc.tools.start.folder import folder_of
from pcpc.tools.start.pool import each
from pcpc.tools.terminal.progress import Progress


def command(request: EvidenceRequest) -> int:
    """Carry out the parts asked for, beside those in the folder; NOT_MET if one is not kept."""
    progress = Progress(request.quiet)
    parts: Mapping[str, Callable[[], Any]] = {
        "matrix": lambda: _matrix(request, progress),
        "residual": lambda: residual.residual(
            request.frames, request.seed, lambda f, tasks: each(f, tasks, progress, request.jobs)
        ),
        "frames": lambda: each(
            frames.task, frames.tasks(request.frames, request.seed), progress, request.jobs
        ),
        "envelope": lambda: envelope.envelope(request.laws, request.seed, progress, request.jobs),
        "alarms": lambda: alarms.alarms(request.hours, request.seed, progress, request.jobs),
        "mutants": mutants.results,
        "kills": lambda: kills.run(
            request.kills, request.seed, request.jobs or kills.JOBS, progress
        ),
    }
    evidence = report.read(Path(request.output))
    with folder_of(request.output, "evidence") as folder:
        return _carried_out(folder, parts, evidence, request.parts or list(PARTS), progress)


def _carried_out(
    folder: Path,
    parts: Mapping[str, Callable[[], Any]],
    evidence: dict[str, Any],
    wanted: Sequence[str],
    progress: Progress,
) -> int:
    for number, name in enumerate(wanted, 1):
        progress.say(f"{name}, part {number} of {len(wanted)}")
        evidence[name] = parts[name]()
    evidence = {name: evidence[name] for name in PARTS if name in evidence}
    page = report.write(folder, evidence)
    wrong = list(failures(evidence))
    print("\n".join([*wrong, conclusion(wrong, evidence)]))
    print(f"{page} and {report.NUMBERS}")
    return Exit.NOT_MET if wrong else Exit.OK


def conclusion(wrong: Sequence[str], evidence: Mapping[str, Any]) -> str:
    """Return the last word, which names the modules whose lack of mutants has a reason."""
    if wrong:
        return f"{len(wrong)} not as stated"
    elsewhere = evidence.get("mutants", {}).get("elsewhere", ())
    if not elsewhere:
        return "all as stated"
    return textwrap.fill(f"all as stated; no mutants of {', '.join(elsewhere)}", 80)


def _matrix(request: EvidenceRequest, progress: Progress) -> dict[str, Any]:
    rows = matrix.matrix(request.runs, request.seed, progress, request.jobs)
    clean = 1e3 * float(abs(matrix.bench().clean_error(campaign.SPREAD + campaign.AFTER)).max())
    return {"seed": request.seed, "after_cycles": campaign.AFTER, "clean_mrad": clean, "rows": rows}


def failures(evidence: Mapping[str, Any]) -> list[str]:
    """Return a line for each row that is not as stated."""
    lines = [
        f"{row['fault']}: {row['within_limit']} of {row['runs']} within {row['limit_cycles']} "
        f"cycles, {row['wanted']} wanted; {row['answers']}"
        for row in evidence.get("matrix", {}).get("rows", ())
        if not row["kept"]
    ]
    if found := evidence.get("residual"):
        lines += [f"CRC-8: {line}" for line in _unpredicted_passes(found)]
        lines += [f"CRC-16: {line}" for line in _unpredicted_passes(found["crc_16"])]
    lines += [
        f"{row['format']}, {row['kind']}: {row['fates']}, {row['misjudged']} misjudged"
        for row in evidence.get("frames", ())
        if not row["kept"]
    ]
    if not (held := evidence.get("envelope", {"kept": True}))["kept"]:
        lines.append(f"beyond the envelope: {held['broken']}; met {held['met']}")
    if "alarms" in evidence and not evidence["alarms"]["kept"]:
        lines += [
            f"false alarms of {row['rig']}: {row['alarms']}"
            for row in evidence["alarms"]["rigs"]
            if any(row["alarms"].values())
        ]
    lines += [
        f"{one}: the code itself is not as expected, its mutants tell nothing"
        for one in evidence.get("mutants", {}).get("broken", ())
    ]
    lines += [
        f"executive/loop/{one}.py: no mutants, and no reason why"
        for one in evidence.get("mutants", {}).get("without", ())
    ]
    lines += [f"nobody notices {one}" for one in evidence.get("mutants", {}).get("left", ())]
    lines += [
        f"a reason of no mutant: {one}" for one in evidence.get("mutants", {}).get("idle", ())
    ]
    lines += [
        f"{row['process']} {row['signal']} in cycle {row['cycle']}: {row['wrong']}"
        for row in evidence.get("kills", ())
        if not row["ok"]
    ]
    return lines


def _unpredicted_passes(found: Mapping[str, Any]) -> Iterator[str]:
    """Yield what a CRC lets pass otherwise than predicted."""
    for row in found["weights"]:
        if not row["kept"]:
            predicted = f"{row['predicted']:.3g} predicted"
            yield f"{row['bits']} wrong bits: {row['measured']:.3g}, {predicted}"
    if not found["drawn_frames"]["kept"]:
        yield f"drawn frames: {found['drawn_frames']['used']} used"
