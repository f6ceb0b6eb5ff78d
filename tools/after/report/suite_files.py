"""The files of `pcpc report --suite`: a page of HTML, and JUnit for continuous integration."""

import os
from pathlib import Path

from pcpc.drivers.errors import UserError, printable
from pcpc.tools.after.report import suite as suites
from pcpc.tools.after.report.commands import ReportRequest
from pcpc.tools.after.report.suite import OK, RequirementResult, Suite, link
from pcpc.tools.after.trust import Trust
from pcpc.tools.terminal.document import Code, Link, Part, Section, Strong, Table, Verdict, html
from pcpc.tools.terminal.html import page
from pcpc.tools.terminal.junit import Case, junit_text
from pcpc.tools.terminal.outfile import LogCommandError, write_text
from pcpc.tools.terminal.progress import Progress

_SUFFIXES = (".html", ".htm")


def command(request: ReportRequest) -> int:
    """Judge the runs, write the page and the JUnit file, tell what keeps them from being ok.

    UserError: wrong input.
    """
    output, junit = Path(request.output or "suite.html"), request.junit
    if output.suffix.lower() not in _SUFFIXES:
        raise LogCommandError(f"-o {output}: no page; expected FILE.html")
    if junit is not None and os.path.realpath(junit) == os.path.realpath(output):
        raise UserError(f"--junit {junit}: is the page of -o; choose another file")
    needed = [one.strip() for text in request.need for one in text.split(",")]
    if not all(needed):
        raise UserError("--need: an empty name; expected ids with a comma between")
    suite = suites.gather(request.suite, needed, Trust.of(request.code), Progress(request.quiet))
    write_text(output, as_html(suite, output))
    if junit is not None:
        write_text(junit, as_junit(suite) + "\n")
    for line in () if request.quiet else [*_failures(suite), *_remarks(suite)]:
        print(line)
    print(output)
    return suite.code


def _failures(suite: Suite) -> list[str]:
    """Return what keeps a suite from being ok, a line each."""
    lines = [f"{one}: not judged: no run tests it" for one in suite.absent]
    for cell in suite.cells:
        run, one = cell.worst
        if one.verdict != OK:
            lines.append(f"{cell.key}: {one.verdict}: {cell.of}: {one.why} ({run.path})")
    for run in suite.runs:
        if not run.ok:
            lines.append(f"{run.path}: {run.verdict}: {_reasons(run)}".removesuffix(": "))
    if not suite.cells:
        lines.append("nothing was judged")
    return [printable(line) for line in lines]


def _remarks(found: Suite) -> list[str]:
    """Return how runs that are ok were judged, where that is not as usual, a line each."""
    return [printable(f"{run.path}: {_reasons(run)}") for run in found.runs if run.ok and run.lines]


def _reasons(run: suites.OneRun) -> str:
    return "; ".join(run.lines)


def as_html(suite: Suite, output: Path) -> str:
    """Return the page."""
    rows: list[tuple[object, ...]] = []
    for cell in suite.cells:
        run, result = cell.worst
        word = result.verdict if result.verdict == OK else Strong(result.verdict)
        of = (
            Link(run.path.parent.name or run.path.name, link(run.path, output)),
            " ",
            Code(run.sha256[:16]),
        )
        rows.append(
            (cell.key, result.words, cell.of, word, result.margin, result.why, len(cell.runs), of)
        )
    rows += [
        (one, "", "", Strong("not judged"), "", "no run tests it", 0, "") for one in suite.absent
    ]
    head = ("requirement", "what it says", "rig, controller", "verdict", "margin", "why",
            "runs", "log, sha256")  # fmt: skip
    runs = [
        (Link(str(run.path), link(run.path, output)), run.of, run.facts.get("seed", ""),
         run.revision, run.verdict if run.ok else Strong(run.verdict), run.code,
         "; ".join([*run.problems, *run.notes]), Code(run.sha256))
        for run in suite.runs
    ]  # fmt: skip
    columns = ("log", "rig, controller", "seed", "versions", "verdict", "exit code", "", "sha256")
    word = "ok" if suite.ok else "not ok"
    parts: list[Part] = [
        Verdict(word, _failures(suite), suite.ok),
        Section("Requirements", [Table(head, rows, (6,))]),
        Section("Runs", [Table(columns, runs, (5,))]),
    ]
    title = html(Section("All runs of a suite", [_counts(suite)]), 1)
    return page(f"suite: {word}", [title, *map(html, parts)])


def _counts(suite: Suite) -> str:
    words = [cell.worst[1].verdict for cell in suite.cells]
    told = [f"{words.count(word)} {word}" for word in suites.WORDS if word in words]
    return f"{len(suite.runs)} runs; requirements by rig: {', '.join(told) or 'none'}"


# JUnit


def as_junit(suite: Suite) -> str:
    """Return a testcase for each requirement of each rig, and one for each run."""
    cases = []
    for cell in suite.cells:
        run, one = cell.worst
        kind = "" if one.verdict == OK else "failure"
        cases.append(Case(cell.of, one.title, kind, one.verdict, _words(one, run)))
    cases += [Case("", one, "failure", "not judged", "no run tests it") for one in suite.absent]
    runs = [
        Case(
            run.of,
            str(run.path),
            "" if run.ok else "error",
            "not ok" if run.verdict == OK and not run.ok else run.verdict,
            _reasons(run),
        )
        for run in suite.runs
    ]
    return junit_text({"requirements": cases, "runs": runs})


def _words(one: RequirementResult, run: suites.OneRun) -> str:
    margin = f"margin {one.margin}" if one.margin else ""
    told = [one.why, margin, f"log {run.path}", f"sha256 {run.sha256}"]
    return "; ".join(filter(None, told))
