"""Many virtual runs side by side: cases in, metrics and traces out, on all processors."""

import argparse
import importlib
import multiprocessing
import os
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.progress import Progress

TRACE_POINTS = 1500  # of a figure's line: more than its pixels


@dataclass(frozen=True)
class Case:
    """One run: a rig file, a controller, settings as for `--set`, and where its result belongs."""

    group: str
    rig: str
    controller: str
    label: str
    settings: tuple[str, ...] = ()
    window_s: tuple[float, float] | None = None  # instead of the rig's
    traces: tuple[str, ...] = ()  # variables to keep, `executive:` or `plant:` before the name


@dataclass(frozen=True)
class Result:
    """What a case came to; `failed`: why there are no metrics; `diverged`: it ended early."""

    case: Case
    metrics: Mapping[str, float] = field(default_factory=dict)
    traces: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    diverged: bool = False
    failed: str = ""


def run_case(case: Case) -> Result:
    """Run one case in virtual time in this process."""
    from executive.errors import RigError
    from executive.rig import load_rig
    from executive.virtual import in_memory
    from tools.summary import evaluation_module

    try:
        rig = load_rig(case.rig, case.controller, case.settings)
        log = in_memory(rig)
    except RigError as error:
        return Result(case, failed=str(error))
    module = evaluation_module(rig)
    if module is None or rig.evaluation is None:
        return Result(case, failed=f"{case.rig}: names no evaluation file")
    window = case.window_s or rig.evaluation.window_s
    metrics = module.metrics(log, window, rig.evaluation.numbers, 1.0 / rig.config.rate_hz)
    done = len(log.node["executive"].cycle)
    expected = round(rig.config.duration_s * rig.config.rate_hz)
    return Result(case, metrics, _traces(log, case.traces), diverged=done < expected)


def _traces(log: Any, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Return the wanted columns over the executive's cycles, thinned, and `t`."""
    if not names:
        return {}
    n = len(log.node["executive"].cycle)
    step = max(1, n // TRACE_POINTS)
    found = {"t": log.node["executive"].columns["time.t_s"][::step].copy()}
    for name in names:
        node, _, column = name.partition(":")
        values = log.node[node].columns.get(column)
        if values is not None:
            found[name] = values[:n:step].copy()
    return found


def run_cases(cases: Sequence[Case], progress: Progress, jobs: int | None = None) -> list[Result]:
    """Run all cases on `jobs` processes (all processors); results in the order of the cases."""
    workers = min(jobs or os.cpu_count() or 1, len(cases))
    results: dict[int, Result] = {}
    begin = time.monotonic()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context) as pool:
        futures = {pool.submit(run_case, case): i for i, case in enumerate(cases)}
        for future in as_completed(futures):
            results[futures[future]] = future.result()
            done, spent = len(results), time.monotonic() - begin
            left = spent / done * (len(cases) - done)
            progress.show(f"run {done}/{len(cases)}, {spent:.0f} s, about {left:.0f} s left")
    progress.close()
    return [results[i] for i in range(len(cases))]


def write_csv(results: Sequence[Result], path: Path) -> None:
    """Write one line a result: group, rig, label, settings and all metrics."""
    names = sorted({name for result in results for name in result.metrics})
    lines = [",".join(("group", "rig", "controller", "label", "settings", "diverged", *names))]
    for result in results:
        case = result.case
        values = (f"{result.metrics[name]:.6g}" if name in result.metrics else "" for name in names)
        words = (
            case.group,
            Path(case.rig).stem,
            case.controller,
            case.label,
            " ".join(case.settings),
        )
        lines.append(",".join((*words, str(result.diverged), *values)))
    path.write_text("\n".join(lines) + "\n")


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def command(options: argparse.Namespace) -> int:
    """Run the experiment `options.name`; return 0, 1 if a run failed, 2 for wrong input."""
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    folder = Path(options.output or Path("runs") / f"{stamp}-{options.name}")
    if options.jobs is not None and options.jobs < 1:
        print(f"--jobs {options.jobs}: expected 1 or more", file=sys.stderr)
        return 2
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise FileExistsError(0, "is not empty")
    except OSError as error:
        print(f"{folder}: {error.strerror}; choose another folder with -o", file=sys.stderr)
        return 2
    experiment = importlib.import_module(f"tools.experiments.{options.name}")
    progress = Progress(options.quiet)
    try:
        code = int(experiment.run(folder, progress, options.jobs))
    except KeyboardInterrupt:
        progress.close()
        return 130
    print(folder / "results.md")
    return code
