"""`pcpc sweep`: thousands of runs of a rig in virtual time, a table, a report, a statement."""

import argparse
import textwrap
from collections.abc import Sequence
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError
from pcpc.tools.console.progress import Progress
from pcpc.tools.log.outfile import new_file
from pcpc.tools.rigs import find
from pcpc.tools.starting.folder import folder_of
from pcpc.tools.sweep import rerun, store, told
from pcpc.tools.sweep.campaign import SEARCHES, Campaign, Shard, asked
from pcpc.tools.sweep.report import report
from pcpc.tools.sweep.search import chosen, search
from pcpc.tools.sweep.work import Work


def command(options: argparse.Namespace) -> int:
    """Carry out `pcpc sweep`; return the exit code."""
    store.check_packages()
    if options.words[0] == "merge":
        return _merge(options)
    if options.words[0] == "rerun":
        return rerun.command(options)
    if options.words[1:]:
        raise RigError(f"{' '.join(options.words[1:])}: one rig at a time")
    options.rig = find(options.words[0])
    campaign = _campaign(options)
    campaign.check()
    shard = Shard.parsed(options.shard) if options.shard else Shard()
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
    return _tell(folder, [folder], ended)


def _campaign(options: argparse.Namespace) -> Campaign:
    others = {name: getattr(options, name) for name in ("draws", "sampling", "until", "shard")}
    if kind := chosen({name: getattr(options, name) for name in SEARCHES}, others):
        options.sampling, options.draws = kind
    named = options.controllers.split(",") if options.controllers else ()
    return asked(
        options.rig, named, options.vary, options.draws, options.sampling, options.seed,
        options.set, options.until is not None,
    )  # fmt: skip


def _merge(options: argparse.Namespace) -> int:
    folders = [Path(name) for name in options.words[1:]]
    if not folders:
        raise RigError("pcpc sweep merge: name the folders of the shards")
    return _tell(Path(options.output or folders[0]), folders, "")


def _tell(folder: Path, folders: Sequence[Path], ended: str) -> int:
    """Write the whole table, tell what it says."""
    import pyarrow.parquet

    table, spec = store.merged(folders)
    if spec["sampling"] in SEARCHES:  # its rows are no sample: no share of them says a thing
        print(f"{spec['title']}: {table.num_rows:,} runs")
        print(_filled(ended) or "pcpc sweep with its -o tells what came out", folder, sep="\n")
        return Exit.OK
    if len(folders) > 1 or len(list(store.tables(folder))) != 1:
        folder.mkdir(parents=True, exist_ok=True)
        with new_file(folder / "sweep.parquet", force=True) as unfinished:
            pyarrow.parquet.write_table(table, unfinished)
    print(told.summary(table, spec, folder))
    print(_filled(ended), end="\n" if ended else "")
    print(f"report   {report(table, spec, folder)}")
    return Exit.OK


def _filled(text: str) -> str:
    """Return lines in as many as fit the terminal."""
    return "\n".join(
        textwrap.fill(line, told.COLUMNS, subsequent_indent="    ") for line in text.splitlines()
    )
