"""`pcpc sweep`: thousands of runs of a rig in virtual time, a table, a report, a statement."""

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pcpc.drivers.errors import Exit, printable
from pcpc.executive.errors import RigError
from pcpc.tools.start.folder import folder_of
from pcpc.tools.study.sweep import decision, shards, store
from pcpc.tools.study.sweep.campaign import SEARCHES
from pcpc.tools.study.sweep.commands import MergeRequest, SweepRequest
from pcpc.tools.study.sweep.report import report
from pcpc.tools.study.sweep.request import campaign_of, work_of
from pcpc.tools.study.sweep.results import Results
from pcpc.tools.study.sweep.statements import HOLDS
from pcpc.tools.study.sweep.summary import COLUMNS, summary
from pcpc.tools.study.sweep.work import Work
from pcpc.tools.terminal.progress import Progress

if TYPE_CHECKING:
    import pyarrow


def command(request: SweepRequest) -> int:
    """Carry out `pcpc sweep`; return the exit code. RigError: wrong input."""
    campaign = campaign_of(request)
    with folder_of(request.output, f"sweep-{campaign.rigs[0].config.rig}") as folder:
        return _run(work_of(request, campaign, folder), Progress(request.quiet))


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


def merge(request: MergeRequest) -> int:
    """Carry out `pcpc sweep merge`; return the exit code. RigError: wrong input."""
    folders = [Path(name) for name in request.folders]
    named = str(folders[0]) if request.output is None else request.output
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
