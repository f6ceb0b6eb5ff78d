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
from pcpc.tools.study.sweep import decision, rerun, shards, told
from pcpc.tools.study.sweep.campaign import SEARCHES, Campaign, Shard, asked
from pcpc.tools.study.sweep.commands import sweep
from pcpc.tools.study.sweep.report import report
from pcpc.tools.study.sweep.results import Results
from pcpc.tools.study.sweep.search import chosen, search
from pcpc.tools.study.sweep.statements import HOLDS
from pcpc.tools.study.sweep.work import Work
from pcpc.tools.terminal.outfile import new_file
from pcpc.tools.terminal.progress import Progress

if TYPE_CHECKING:
    import pyarrow

_TAKES = {"merge": {"output", "quiet"}, "rerun": {"output", "quiet", "on_bus"}}


def command(options: argparse.Namespace) -> int:
    """Carry out `pcpc sweep`; return the exit code."""
    _check_options(options)
    if options.words[0] == "merge":
        return _merge(options)
    if options.words[0] == "rerun":
        return rerun.command(options)
    if options.words[1:]:
        raise RigError(f"{' '.join(options.words[1:])}: one rig at a time")
    options.rig = find(options.words[0])
    campaign = _campaign(options)
    campaign.check()
    shard = Shard() if options.shard is None else Shard.parsed(options.shard)
    with folder_of(options.output, f"sweep-{campaign.of[0].config.rig}") as folder:
        return _carried_out(options, campaign, shard, folder)


def _carried_out(
    options: argparse.Namespace, campaign: Campaign, shard: Shard, folder: Path
) -> int:
    progress = Progress(options.quiet)
    looked_for = search(campaign, options.of, options.limit)
    about = options.until, options.threads, options.scheduler, looked_for
    work = Work(campaign, shard, folder, *about)
    try:
        ended = work.to_end(progress)
    except KeyboardInterrupt:
        progress.close()
        print(f"{len(work.store.rows)} rows are in {folder}; to go on, the same command with "
              f"-o {folder}")  # fmt: skip
        return Exit.INTERRUPTED
    finally:
        work.store.close()
    progress.close()
    if shard.of > 1:
        print(f"{work.store.table}: {len(work.store.rows)} rows; when all shards are done: "
              f"pcpc sweep merge {folder}")  # fmt: skip
        return Exit.OK
    return _tell(*shards.merged([folder]), folder, ended)


def _check_options(options: argparse.Namespace) -> None:
    """Raise RigError for an option that `merge`, `rerun` or a campaign does not take."""
    parser = argparse.ArgumentParser()
    sweep(parser.add_argument)
    unset = vars(parser.parse_args(["RIG"]))
    given = {name for name, value in unset.items() if getattr(options, name) != value} - {"words"}
    kind = options.words[0] if options.words[0] in _TAKES else ""
    wrong = given - _TAKES[kind] if kind else given & _TAKES["rerun"] - _TAKES["merge"]
    if wrong:
        name = f"--{min(wrong).replace('_', '-')}"
        what = f"pcpc sweep {kind} does not take it" if kind else "is of `pcpc sweep rerun`"
        raise RigError(f"{name}: {what}")


def _campaign(options: argparse.Namespace) -> Campaign:
    others = {name: getattr(options, name) for name in ("draws", "sampling", "until", "shard")}
    if kind := chosen({name: getattr(options, name) for name in SEARCHES}, others):
        options.sampling, options.draws = kind
    named = () if options.controllers is None else options.controllers.split(",")
    return asked(
        options.rig, named, options.vary, options.draws, options.sampling, options.seed,
        options.set, options.until is not None,
    )  # fmt: skip


def _merge(options: argparse.Namespace) -> int:
    folders = [Path(name) for name in options.words[1:]]
    if not folders:
        raise RigError("pcpc sweep merge: name the folders of the shards")
    table, spec = shards.merged(folders)
    named = str(folders[0]) if options.output is None else options.output
    with folder_of(named, "") as folder:
        return _tell(table, spec, folder, "")


def _tell(table: "pyarrow.Table", spec: Mapping[str, Any], folder: Path, ended: str) -> int:
    """Write the whole table, if it is not one shard's, and tell what it says."""
    import pyarrow.parquet

    if spec["sampling"] in SEARCHES:  # its rows are no sample: no share of them says a thing
        print(printable(f"{spec['title']}: {table.num_rows:,} runs"))
        print(_filled(ended) or "pcpc sweep with its -o tells what came out", folder, sep="\n")
        return Exit.OK
    if [path.name for path in shards.tables(folder)] != [f"{Shard()}.parquet"]:
        with new_file(folder / "sweep.parquet", force=True) as unfinished:
            pyarrow.parquet.write_table(table, unfinished)
    until, results = spec.get("until"), Results(table, spec)
    found = decision.decisions(results, until) if until is not None else []
    print(printable(told.summary(table, spec, folder), "\n"))
    if results.refused.all():
        raise RigError(f"{folder}: all runs were refused: {table['why'][0]}")
    for one in found:
        print(_filled(printable(one.text)))
    print(f"report   {report(table, spec, folder)}")
    return Exit.OK if all(one.outcome == HOLDS for one in found) else Exit.NOT_MET


def _filled(text: str) -> str:
    """Return lines in as many as fit the terminal."""
    return "\n".join(
        textwrap.fill(line, told.COLUMNS, subsequent_indent="    ") for line in text.splitlines()
    )
