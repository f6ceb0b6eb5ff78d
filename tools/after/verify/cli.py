"""`pcpc replay LOG...`: recompute many logs, and hold them against a table of digests."""

import os
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

from msgspec import Meta, Struct

from pcpc.drivers.errors import Exit, UserError, printable
from pcpc.tools.after.commands import ReplayRequest
from pcpc.tools.after.log.recorded import LATEST, log_of, logs_below
from pcpc.tools.after.trust import Trust
from pcpc.tools.after.verify import table as tables
from pcpc.tools.after.verify.commands import ManyLogs
from pcpc.tools.after.verify.one import CODES, IDENTICAL, VerifiedLog, verified_row
from pcpc.tools.start.pool import each
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.junit import Case, junit_text
from pcpc.tools.terminal.outfile import new_file
from pcpc.tools.terminal.progress import Progress

_BYTES_A_PROCESS = 1 << 26  # as fast in one process
_FAILURES = {"differs": "failure", IDENTICAL: ""}  # in JUnit; others are errors
_WORST = (Exit.NOT_MET, Exit.WRONG_INPUT, Exit.LOSS, Exit.OK)
_OF_TABLE = {"missing": Exit.LOSS}  # others: NOT_MET


class VerifiedLogs(Struct):
    """What became of many logs, and how they stand to a table."""

    logs: Annotated[list[VerifiedLog], Meta(min_length=1)]
    "in the order of their names"
    signature: str | None
    "who signed the table, or that it was not checked; null: no signature"
    table: list[tables.TableProblem]


def command(request: ReplayRequest) -> int:
    """Verify the logs, print a row for each, write and check what is asked for."""
    asked = request.beside.of(ManyLogs)
    _check_words(request, asked)
    known, note = _table(asked)
    words = request.logs or ([str(asked.check.parent)] if asked.check else [])
    found = [str(path) for word in words for path in _logs(word)]
    names = sorted({os.path.abspath(name): name for name in found[::-1]}.values())
    if asked.table:
        for name in names:
            tables.relative(name, asked.table)
    rows = _rows(names, request, asked.jobs)
    problems = tables.table_differences(rows, known, asked.check) if asked.check else []
    told = VerifiedLogs(rows, note or None, problems)
    screen.answer(request.json, told, _lines(rows, problems, note), 1)
    if asked.junit is not None:
        with new_file(asked.junit, force=True) as unfinished:
            unfinished.write_text(_junit(rows, problems), encoding="utf-8")
    if asked.table:
        tables.write(asked.table, tables.text_of(rows, asked.table), asked.sign)
    codes = {CODES[row.verdict] for row in rows}
    codes |= {_OF_TABLE.get(one.what, Exit.NOT_MET) for one in problems}
    return next(code for code in _WORST if code in codes)


def _check_words(request: ReplayRequest, asked: ManyLogs) -> None:
    """Raise UserError for options that do not go together, before any work is done."""
    if not (request.logs or asked.check):
        raise UserError("which logs? name logs, run folders or latest, or folders that hold some")
    for name, needed in (
        ("sign", "table"),
        ("signers", "check"),
        ("identity", "signers"),
        ("signers", "identity"),
    ):
        if getattr(asked, name) is not None and not getattr(asked, needed):
            raise UserError(f"--{name}: needs --{needed} too")
    if request.node != "all" and (asked.table or asked.check):
        raise UserError(f"--node {request.node}: a table is of whole logs; leave out --node")
    if asked.table and asked.check:
        raise UserError("--table and --check: choose one of them")
    if asked.table:
        for path in (asked.table, tables.signature_of(asked.table)):
            if os.path.lexists(path):
                raise UserError(f"{path}: exists; choose another name, or remove it")
        if asked.junit and os.path.realpath(asked.junit) == os.path.realpath(asked.table):
            raise UserError(f"--junit {asked.junit}: is the table; choose another file")
    if asked.sign is not None:
        if not Path(asked.sign).is_file():
            raise UserError(f"--sign {asked.sign}: no such key; `ssh-keygen -t ed25519` makes one")
        if shutil.which("ssh-keygen") is None:
            raise tables.without_ssh_keygen()


def _table(asked: ManyLogs) -> tuple[dict[str, tables.TableLine], str]:
    """Return the table to check, and a word on its signature; UserError."""
    if not asked.check:
        return {}, ""
    if not asked.check.is_file():
        raise UserError(f"--check {asked.check}: no such table; --table writes one")
    try:
        data = asked.check.read_bytes()
    except OSError as error:
        raise UserError(f"--check {asked.check}: {error.strerror}") from None
    note = ""
    if asked.signers is not None and asked.identity is not None:
        tables.check_signature(asked.check, data, asked.signers, asked.identity)
        note = f"signed by {asked.identity}"
    elif (beside := tables.signature_of(asked.check)).exists():
        note = f"{beside.name} is not checked; --signers FILE --identity WHO checks it"
    return tables.entries(asked.check, data), note


def _rows(names: Sequence[str], request: ReplayRequest, jobs: int | None) -> list[VerifiedLog]:
    """Verify the logs, on several processors where there are several; in the order of `names`."""
    judge = partial(verified_row, node=request.node, trust=Trust.of(request.code))
    jobs, progress = jobs or _processes(names), Progress(request.quiet)
    if min(jobs, len(names)) > 1:
        return each(judge, names, progress, jobs)
    rows = []
    for number, name in enumerate(names, 1):
        progress.show(f"log {number}/{len(names)}: {name}")
        rows.append(judge(name))
    progress.close()
    return rows


def _processes(names: Sequence[str]) -> int:
    """Return how many processes pay: each takes as long to start as some MB of logs."""
    size = sum(os.path.getsize(name) for name in names if os.path.isfile(name))
    return min(len(os.sched_getaffinity(0)), max(1, size // _BYTES_A_PROCESS))


# Which logs


def _logs(word: str) -> list[Path]:
    """Return the logs that a word names, all below a folder; UserError where there is none."""
    if not word.strip() or word == LATEST or not Path(word).is_dir():
        return [log_of(word)]
    if not (found := list(logs_below(Path(word)))):
        raise UserError(f"{word}: no log below this folder; logs are called *.mcap")
    return found


# What is told


def _lines(
    rows: Sequence[VerifiedLog], problems: Sequence[tables.TableProblem], note: str
) -> Iterator[str]:
    """Yield what is printed."""
    heads = [
        (row.verdict, f"{row.cycles} cycles", (row.digest or "-")[:16], printable(row.log))
        for row in rows
    ]
    size = [max(map(len, column)) for column in zip(*heads, strict=True)]
    for row, (verdict, cycles, digest, log) in zip(rows, heads, strict=True):
        yield from screen.wrapped_lines(
            log, f"{verdict:{size[0]}}  {cycles:>{size[1]}}  {digest:{size[2]}}  "
        )
        if row.checked:
            yield f"  {_checked(row)}"
        yield from (f"  {printable(line)}" for line in _reasons(row))
    yield from (f"{one.what:10}  {printable(one.line)}" for one in problems)
    counts = Counter(row.verdict for row in rows)
    told = ", ".join(f"{counts[word]} {word}" for word in CODES if counts[word])
    left = sorted({role for row in rows for role in row.left_out})
    without = f", without the {' and the '.join(left)}" if left else ""
    yield f"{len(rows)} {'log' if len(rows) == 1 else 'logs'} recomputed{without}: {told}"
    if problems:
        yield "not as in the table"
    if note:
        yield printable(note)


def _checked(row: VerifiedLog) -> str:
    """Return what was recomputed of a log, and which of its nodes were left out."""
    left = f"; not asked for: {', '.join(row.left_out)}" if row.left_out else ""
    return f"recomputed: {row.checked}{left}"


def _reasons(row: VerifiedLog) -> list[str]:
    """Return why a log is not identical: a line each."""
    if row.verdict == IDENTICAL:
        return []
    found = []
    if row.first:
        one = row.first
        ulp = "" if one.ulp is None else f", {one.ulp} ULP"
        found.append(
            f"{one.node}: first {one.name} in cycle {one.cycle}{ulp}: "
            f"recorded {one.recorded}, recomputed {one.recomputed}"
        )
    found += row.why
    if row.changed:
        found.append(f"changed since: {'; '.join(row.changed)}")
    elif row.versions:
        dirty = ", but files differ from it" * row.versions.get("git", "").endswith("-dirty")
        found.append(f"versions and commit: as when the log was made{dirty}")
    return found


def _junit(rows: Sequence[VerifiedLog], problems: Sequence[tables.TableProblem]) -> str:
    """Return JUnit: a testcase for each log, and for each line that is not as in the table."""
    cases = [
        Case(
            "",
            row.log,
            _FAILURES.get(row.verdict, "error"),
            row.verdict,
            "; ".join([_checked(row), *_reasons(row), f"digest {row.digest}"]),
        )
        for row in rows
    ]
    table = [Case("", one.line, "failure", one.what, one.line) for one in problems]
    return junit_text({"logs": cases} | ({"table": table} if table else {})) + "\n"
