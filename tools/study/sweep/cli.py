"""`pcpc sweep`: thousands of runs of a rig in virtual time, a table, a report, a statement."""

import argparse
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcpc.drivers.errors import Exit, printable
from pcpc.executive.errors import RigError
from pcpc.tools.start.folder import folder_of
from pcpc.tools.start.rigs import find
from pcpc.tools.study.sweep import decision, rerun, shards, store
from pcpc.tools.study.sweep.campaign import SEARCHES
from pcpc.tools.study.sweep.report import report
from pcpc.tools.study.sweep.request import Request
from pcpc.tools.study.sweep.results import Results
from pcpc.tools.study.sweep.statements import HOLDS
from pcpc.tools.study.sweep.summary import COLUMNS, summary
from pcpc.tools.study.sweep.work import Work
from pcpc.tools.terminal.option_notes import refuse
from pcpc.tools.terminal.progress import Progress

if TYPE_CHECKING:
    import pyarrow

_REQUESTED = (
    "draws", "sampling", "seed", "until", "worst", "rare", "of", "limit", "shard", "threads",
    "scheduler",
)  # fmt: skip
_TAKES = {"merge": {"output", "quiet"}, "rerun": {"output", "quiet", "on_bus"}}


def command(options: argparse.Namespace) -> int:
    """Carry out `pcpc sweep`; return the exit code. RigError: wrong input."""
    _check_options(options)
    if options.words[0] == "merge":
        return _merge(options)
    if options.words[0] == "rerun":
        return rerun.command(options)
    if options.words[1:]:
        raise RigError(f"{' '.join(options.words[1:])}: one rig at a time")
    controllers = options.controllers
    request = Request(
        find(options.words[0]),
        () if controllers is None else controllers.split(","),
        options.vary,
        options.set,
        **{name: getattr(options, name) for name in _REQUESTED},
    )
    campaign = request.campaign()
    with folder_of(options.output, f"sweep-{campaign.rigs[0].config.rig}") as folder:
        return _run(request.work(campaign, folder), Progress(options.quiet))


def _run(work: Work, progress: Progress) -> int:
    folder = work.folder
    try:
        outcome = work.to_end(progress)
        work.check_runs()
    except KeyboardInterrupt:
        progress.close()
        cure = f"to go on, the same command with -o {folder}"
        print(f"{len(work.store)} rows are in {folder}; {cure}")
        return Exit.INTERRUPTED
    finally:
        work.store.close()
    progress.close()
    if work.shard.of > 1:
        cure = f"when all shards are done: pcpc sweep merge {folder}"
        print(f"{work.store.path}: {len(work.store)} rows; {cure}")
        return Exit.OK
    return _tell(*shards.merge([folder]), folder, outcome)


def _check_options(options: argparse.Namespace) -> None:
    """Raise UserError for an option that `merge`, `rerun` or a campaign does not take."""
    if (kind := options.words[0]) in _TAKES:
        wrong = [name for name in vars(options) if name not in _TAKES[kind]]
        refuse(options, f"pcpc sweep {kind} does not take it", *wrong)
    else:
        refuse(options, "is of `pcpc sweep rerun`", "on_bus")


def _merge(options: argparse.Namespace) -> int:
    folders = [Path(name) for name in options.words[1:]]
    if not folders:
        raise RigError("pcpc sweep merge: name the folders of the shards")
    named = str(folders[0]) if options.output is None else options.output
    with shards.merged(folders) as (db, spec), folder_of(named, "") as folder:
        table = shards.table(db, spec)
        if spec["sampling"] not in SEARCHES:
            if folder.resolve() not in [one.resolve() for one in folders]:
                shards.write(db, spec, folder)
            store.export(table, folder)
        return _tell(table, spec, folder, "")


def _tell(table: "pyarrow.Table", spec: Mapping[str, Any], folder: Path, outcome: str) -> int:
    """Tell what a table says, and write the report."""
    if spec["sampling"] in SEARCHES:  # its rows are no sample: no share of them says a thing
        print(printable(f"{spec['title']}: {table.num_rows:,} runs"))
        print(
            _filled_lines(outcome) or "pcpc sweep with its -o prints the result", folder, sep="\n"
        )
        return Exit.OK
    results, until = Results(table, spec), spec.get("until")
    found = decision.decisions(results, until) if until is not None else []
    left = [] if until is not None else list(results.never_judged())
    print(printable(summary(results, folder), "\n"))
    if results.refused.all():
        raise RigError(f"{folder}: all runs were refused: {table['why'][0]}")
    for one in found:
        print(_filled_lines(printable(one.text)))
    for line in left:
        print(_filled_lines(printable(f"not ok: {line}")))
    print(f"report   {report(results, folder)}")
    holds = all(one.outcome == HOLDS for one in found) and not left
    return Exit.OK if holds else Exit.NOT_MET


def _filled_lines(text: str) -> str:
    """Return lines in as many as fit the terminal."""
    return "\n".join(
        textwrap.fill(line, COLUMNS, subsequent_indent="    ") for line in text.splitlines()
    )
