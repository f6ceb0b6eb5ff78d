"""`pcpc verify LOG...`: recompute many logs, and hold them against a table of digests."""

import argparse
import json
import os
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError, printable
from pcpc.tools.after.log.recorded import LATEST, log_of, logs_below
from pcpc.tools.after.verify import table as tables
from pcpc.tools.after.verify.one import CODES, IDENTICAL, Row, verified_row
from pcpc.tools.start.pool import each
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.junit import Case, junit_text
from pcpc.tools.terminal.outfile import new_file
from pcpc.tools.terminal.progress import Progress

_BYTES_A_PROCESS = 1 << 26  # as fast in one process
_FAILURES = {"differs": "failure", IDENTICAL: ""}  # in JUnit; others are errors
_WORST = (Exit.NOT_MET, Exit.WRONG_INPUT, Exit.LOSS, Exit.OK)
_OF_TABLE = {"missing": Exit.LOSS}  # others: NOT_MET


def command(options: argparse.Namespace) -> int:
    """Verify the logs, print a row for each, write and check what is asked for."""
    _check_words(options)
    known, note = _table(options)
    words = options.logs or [str(options.check.parent)]
    found = [str(path) for word in words for path in _logs(word)]
    names = sorted({os.path.abspath(name): name for name in found[::-1]}.values())
    if options.table:
        for name in names:
            tables.relative(name, options.table)
    rows = _rows(names, options)
    problems = tables.table_differences(rows, known, options.check) if options.check else []
    for line in () if options.json else _lines(rows, problems, note):
        print(line)
    if options.json:
        print(json.dumps({
            "logs": [vars(row) for row in rows], "signature": note or None,
            "table": [{"what": what, "line": line} for what, line in problems],
        }, indent=1))  # fmt: skip
    if options.junit is not None:
        with new_file(options.junit, force=True) as unfinished:
            unfinished.write_text(_junit(rows, problems), encoding="utf-8")
    if options.table:
        tables.write(options.table, tables.text_of(rows, options.table), options.sign)
    codes = {CODES[row.verdict] for row in rows}
    codes |= {_OF_TABLE.get(what, Exit.NOT_MET) for what, _ in problems}
    return next(code for code in _WORST if code in codes)


def _check_words(options: argparse.Namespace) -> None:
    """Raise UserError for options that do not go together, before any work is done."""
    if not (options.logs or options.check):
        raise UserError("verify: which logs? name logs, or folders that hold some")
    for name, needed in (
        ("sign", "table"),
        ("signers", "check"),
        ("identity", "signers"),
        ("signers", "identity"),
    ):
        if getattr(options, name) is not None and not getattr(options, needed):
            raise UserError(f"--{name}: needs --{needed} too")
    if options.node != "all" and (options.table or options.check):
        raise UserError(f"--node {options.node}: a table is of whole logs; leave out --node")
    if options.table and options.check:
        raise UserError("--table and --check: choose one of them")
    if options.table:
        for path in (options.table, tables.signature_of(options.table)):
            if os.path.lexists(path):
                raise UserError(f"{path}: exists; choose another name, or remove it")
        if options.junit and os.path.realpath(options.junit) == os.path.realpath(options.table):
            raise UserError(f"--junit {options.junit}: is the table; choose another file")
    if options.sign is not None:
        if not Path(options.sign).is_file():
            raise UserError(
                f"--sign {options.sign}: no such key; `ssh-keygen -t ed25519` makes one"
            )
        if shutil.which("ssh-keygen") is None:
            raise tables.without_ssh_keygen()


def _table(options: argparse.Namespace) -> tuple[dict[str, tables.Entry], str]:
    """Return the table to check, and a word on its signature; UserError."""
    if not options.check:
        return {}, ""
    if not options.check.is_file():
        raise UserError(f"--check {options.check}: no such table; --table writes one")
    try:
        data = options.check.read_bytes()
    except OSError as error:
        raise UserError(f"--check {options.check}: {error.strerror}") from None
    note = ""
    if options.signers is not None:
        tables.check_signature(options.check, data, options.signers, options.identity)
        note = f"signed by {options.identity}"
    elif (beside := tables.signature_of(options.check)).exists():
        note = f"{beside.name} is not checked; --signers FILE --identity WHO checks it"
    return tables.entries(options.check, data), note


def _rows(names: Sequence[str], options: argparse.Namespace) -> list[Row]:
    """Verify the logs, on several processors where there are several; in the order of `names`."""
    about = {key: getattr(options, key) for key in ("node", "trust", "law", "rig", "fmu")}
    judge = partial(verified_row, options=argparse.Namespace(**about))
    jobs, progress = options.jobs or _processes(names), Progress(options.quiet)
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


def _lines(rows: Sequence[Row], problems: Sequence[tuple[str, str]], note: str) -> Iterator[str]:
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
            yield from screen.wrapped_lines(_checked(row), "  ", "    ")
        for line in _reasons(row):
            yield from screen.wrapped_lines(printable(line), "  ", "    ")
    for what, line in problems:
        yield from screen.wrapped_lines(printable(line), f"{what:10}  ")
    counts = Counter(row.verdict for row in rows)
    told = ", ".join(f"{counts[word]} {word}" for word in CODES if counts[word])
    left = sorted({role for row in rows for role in row.left_out})
    without = f", without the {' and the '.join(left)}" if left else ""
    yield f"{len(rows)} {'log' if len(rows) == 1 else 'logs'} recomputed{without}: {told}"
    if problems:
        yield "not as in the table"
    if note:
        yield from screen.wrapped_lines(printable(note))


def _checked(row: Row) -> str:
    """Return what was recomputed of a log, and which of its nodes were left out."""
    left = f"; not asked for: {', '.join(row.left_out)}" if row.left_out else ""
    return f"recomputed: {row.checked}{left}"


def _reasons(row: Row) -> list[str]:
    """Return why a log is not identical: a line each."""
    if row.verdict == IDENTICAL:
        return []
    found = []
    if row.first:
        one = row.first
        ulp = "" if one["ulp"] is None else f", {one['ulp']} ULP"
        found.append(
            f"{one['node']}: first {one['name']} in cycle {one['cycle']}{ulp}: "
            f"recorded {one['recorded']}, recomputed {one['recomputed']}"
        )
    found += row.why
    if row.changed:
        found.append(f"changed since: {'; '.join(row.changed)}")
    elif row.versions:
        dirty = ", but files differ from it" * row.versions.get("git", "").endswith("-dirty")
        found.append(f"versions and commit: as when the log was made{dirty}")
    return found


def _junit(rows: Sequence[Row], problems: Sequence[tuple[str, str]]) -> str:
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
    table = [Case("", line, "failure", what, line) for what, line in problems]
    return junit_text({"logs": cases} | ({"table": table} if table else {})) + "\n"
