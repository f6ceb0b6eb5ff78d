"""`pcpc evidence report`: inject every fault, count what noticed it, write it down."""

import argparse
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import did_you_mean
from pcpc.tools.console.progress import Progress
from pcpc.tools.evidence import alarms, campaign, kills, matrix, mutants, report, residual
from pcpc.tools.evidence.parts import PARTS


def command(options: argparse.Namespace) -> int:
    """Carry out the parts asked for; NOT_MET if one is not kept."""
    progress = Progress(options.quiet)
    for name in options.parts:
        if name not in PARTS:
            raise UserError(f"{name}: no such part{did_you_mean(name, PARTS)}")
    parts: Mapping[str, Callable[[], Any]] = {
        "matrix": lambda: _matrix(options, progress),
        "residual": lambda: residual.residual(options.frames, options.seed),
        "alarms": lambda: alarms.alarms(options.hours, options.seed, progress, options.jobs),
        "mutants": _mutants,
        "kills": lambda: kills.run(options.kills, options.seed, options.jobs or 2, progress),
    }
    evidence = {name: parts[name]() for name in options.parts or PARTS}
    page = report.write(Path(options.output), evidence)
    missed = list(_missed(evidence))
    print("\n".join([*missed, f"{len(missed)} not as stated" if missed else "all as stated"]))
    print(f"{page} and {report.NUMBERS}")
    return Exit.NOT_MET if missed else Exit.OK


def _matrix(options: argparse.Namespace, progress: Progress) -> dict[str, Any]:
    rows = matrix.matrix(options.runs, options.seed, progress, options.jobs)
    clean = 1e3 * float(abs(matrix.bench().clean(campaign.SPREAD + campaign.AFTER)).max())
    return {"seed": options.seed, "after_cycles": campaign.AFTER, "clean_mrad": clean, "rows": rows}


def _mutants() -> dict[str, Any]:
    every, left = mutants.score()
    return {
        "mutants": len(every), "noticed": len(every) - len(left),
        "argued": dict(Counter(mutants.reason(one) for one in left if mutants.reason(one))),
        "left": [str(one) for one in left if not mutants.reason(one)],
    }  # fmt: skip


def _missed(evidence: Mapping[str, Any]) -> list[str]:
    """Return a line for each row that is not as stated."""
    lines = [
        f"{row['fault']}: {row['within_limit']} of {row['runs']} within {row['limit_cycles']} "
        f"cycles, {row['wanted']} wanted; {row['answers']}"
        for row in evidence.get("matrix", {}).get("rows", ()) if not row["kept"]
    ]  # fmt: skip
    found = evidence.get("residual", {})
    lines += [f"{row['bits']} wrong bits: {row['measured']:.3g}, {row['predicted']:.3g} predicted"
              for row in found.get("weights", ()) if not row["kept"]]  # fmt: skip
    if found and not found["drawn_frames"]["kept"]:
        lines.append(f"drawn frames: {found['drawn_frames']['used']} used")
    if "alarms" in evidence and not evidence["alarms"]["kept"]:
        lines.append(f"false alarms: {evidence['alarms']['alarms']}")
    lines += [f"nobody notices {one}" for one in evidence.get("mutants", {}).get("left", ())]
    lines += [f"{row['process']} {row['signal']} in cycle {row['cycle']}: {row['wrong']}"
              for row in evidence.get("kills", ()) if not row["ok"]]  # fmt: skip
    return lines
