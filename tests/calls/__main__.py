"""Fail calls of pcpc's commands, each once: `python -m tests.calls [COMMAND]...`, from the root.

Each site is tried with each way to fail. Of a function that a process calls more than `--most`
times so many are tried, by `--seed`; `--most 0` tries all. A case is a line of JSON. Exit code 1: a
command ended as none may. `--table FILE` writes what became of all in Markdown.
"""

import argparse
import json
import random
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from tests.calls import failing_calls as calls

Case = tuple[calls.Site, str]
_HEAD = """\
# What became of each call that failed

Written by `python -m tests.calls --table`: exit codes by how the call failed, with `x` for how many
sites. "never": the process did not come to that call. Memory for a new thread is left out: Python
waits for ever (python/cpython issue 140746).
"""


def cases_of(counts: Mapping[tuple[str, str], int], most: int, dice: random.Random) -> list[Case]:
    """Return sites and how they fail: of what is called more than `most` times so many.

    A thread without memory to begin is waited for for ever: python/cpython issue 140746.
    """
    found = []
    for (process, call), count in sorted(counts.items()):
        if call == "mmap64" and process.endswith(" thread"):
            continue
        every = range(1, count + 1)
        numbers = every if not most or count <= most else sorted(dice.sample(every, most))
        found += [(calls.Site(process, call, n), how) for n in numbers for how in calls.WAYS[call]]
    return found


def try_command(name: str, base: Path, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Try the cases of a command; print each in a line of JSON, and return them."""
    from tests.calls.called_commands import Judge

    judge, dice, rows = Judge.of(name, base), random.Random(options.seed), []
    cases = [
        (site, how)
        for site, how in cases_of(judge.counts, options.most, dice)
        if options.process in (None, site.process)
        and options.call in (None, site.call)
        and options.how in (None, how)
    ]
    if options.cases is not None:
        cases = sorted(dice.sample(cases, min(options.cases, len(cases))))
    folder = base.parent / "case"
    for site, how in cases:
        ended = judge.run(folder, site, how)
        lines = (ended.err.strip() or ended.out.strip()).splitlines()
        row = {"command": name, **site._asdict(), "how": how, "fired": ended.fired}
        row |= {"code": ended.code, "said": lines[-1:], "s": round(ended.seconds, 2)}
        rows.append(row | {"wrong": judge.wrong(ended, folder)})
        print(json.dumps(rows[-1]), flush=True)
        shutil.rmtree(folder)
    return rows


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return the page of what became of all cases."""
    reached = sum(row["fired"] for row in rows)
    lines = [_HEAD, f"{len(rows)} cases, {reached} of them reached.\n"]
    for name, of_command in groupby(rows, lambda row: row["command"]):
        lines += [f"## {name}\n", "| process | function | exit codes |", "|---|---|---|"]
        keyed = sorted(of_command, key=lambda row: (row["process"], row["call"], row["how"]))
        for (process, call), of_call in groupby(keyed, lambda row: (row["process"], row["call"])):
            cells = []
            for how, same in groupby(of_call, lambda row: row["how"]):
                codes = [str(row["code"]) if row["fired"] else "never" for row in same]
                told = [f"{code} x{codes.count(code)}" for code in sorted(set(codes))]
                cells.append(f"{how} {', '.join(told)}")
            lines.append(f"| {process} | {call} | {'; '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def main() -> int:
    """Try; return the exit code."""
    parser = argparse.ArgumentParser("tests.calls")
    parser.add_argument("commands", nargs="*", metavar="COMMAND")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--most", type=int, default=12)
    parser.add_argument("--cases", type=int, help="so many of each command, by --seed")
    parser.add_argument("--process", help="only of this one, as 'plant thread'")
    parser.add_argument("--call", help="only of this function")
    parser.add_argument("--how", help="only this failure")
    parser.add_argument("--table", type=Path, help="what became of them, in Markdown")
    options = parser.parse_args()
    calls.begin()
    from tests.calls.called_commands import COMMANDS, prepare  # which would be slow twice

    with tempfile.TemporaryDirectory() as folder:
        base, rows = Path(folder, "base"), []
        prepare(base)
        for name in options.commands or COMMANDS:
            rows += try_command(name, base, options)
    if options.table:
        options.table.write_text(table(rows))
    findings = sum(bool(row["wrong"]) for row in rows)
    print(f"{len(rows)} cases, {findings} findings", file=sys.stderr)
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
