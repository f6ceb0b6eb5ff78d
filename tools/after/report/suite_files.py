"""The files of `pcpc report --suite`: a page of HTML, and JUnit for continuous integration."""

import argparse
import xml.etree.ElementTree as ET
from pathlib import Path

from pcpc.drivers.errors import UserError, printable
from pcpc.tools.after.report import suite as suites
from pcpc.tools.after.report.suite import OK, Suite, Tested, link
from pcpc.tools.terminal.document import Code, Link, Part, Section, Strong, Table, Verdict, html
from pcpc.tools.terminal.html import page
from pcpc.tools.terminal.outfile import LogCommandError, check_file, new_file
from pcpc.tools.terminal.progress import Progress

_SUFFIXES = (".html", ".htm")


def command(options: argparse.Namespace, progress: Progress) -> int:
    """Judge the runs, write the page and the JUnit file, tell what keeps them from being ok."""
    output, junit = Path(options.output or "suite.html"), options.junit
    if output.suffix.lower() not in _SUFFIXES:
        raise LogCommandError(f"-o {output}: no page; expected FILE.html")
    check_file("-o", output)
    check_file("--junit", junit)
    if junit is not None and junit.resolve() == output.resolve():
        raise UserError(f"--junit {junit}: is the page of -o; choose another file")
    needed = [one.strip() for text in options.need for one in text.split(",")]
    if not all(needed):
        raise UserError("--need: an empty name; expected ids with a comma between")
    found = suites.gather(options.suite, needed, options, progress)
    with new_file(output, force=True) as unfinished:
        unfinished.write_text(as_html(found, output), encoding="utf-8")
    if junit is not None:
        with new_file(junit, force=True) as unfinished:
            unfinished.write_text(as_junit(found) + "\n", encoding="utf-8")
    for line in () if options.quiet else _against(found):
        print(line)
    print(output)
    return found.code


def _against(found: Suite) -> list[str]:
    """Return what keeps a suite from being ok, a line each."""
    lines = [f"{one}: not judged: no run tests it" for one in found.absent]
    for cell in found.cells:
        run, one = cell.worst
        if one.verdict != OK:
            lines.append(f"{cell.key}: {one.verdict}: {cell.of}: {one.why} ({run.path})")
    for run in found.runs:
        if not run.ok:
            lines.append(f"{run.path}: {run.verdict}: {_reasons(run)}".removesuffix(": "))
    if not found.cells:
        lines.append("nothing was judged")
    return [printable(line) for line in lines]


def _reasons(run: suites.OneRun) -> str:
    return "; ".join(run.problems)


def as_html(found: Suite, output: Path) -> str:
    """Return the page."""
    rows: list[tuple[object, ...]] = []
    for cell in found.cells:
        run, one = cell.worst
        word = one.verdict if one.verdict == OK else Strong(one.verdict)
        of = (Link(run.path.parent.name or run.path.name, link(run.path, output)), " ",
              Code(run.sha256[:16]))  # fmt: skip
        rows.append((cell.key, one.words, cell.of, word, one.margin, one.why, len(cell.runs), of))
    rows += [(one, "", "", Strong("not judged"), "", "no run tests it", 0, "")
             for one in found.absent]  # fmt: skip
    head = ("requirement", "what it says", "rig, controller", "verdict", "margin", "why",
            "runs", "log, sha256")  # fmt: skip
    runs = [
        (Link(str(run.path), link(run.path, output)), run.of, run.facts.get("seed", ""),
         run.revision, run.verdict if run.ok else Strong(run.verdict), run.code,
         "; ".join([*run.problems, *run.notes]), Code(run.sha256))
        for run in found.runs
    ]  # fmt: skip
    about = ("log", "rig, controller", "seed", "versions", "verdict", "exit code", "", "sha256")
    word = "ok" if found.ok else "not ok"
    parts: list[Part] = [
        Section("All runs of a suite", [_counts(found)]),
        Verdict(word, _against(found), found.ok),
        Section("Requirements", [Table(head, rows, (6,))]),
        Section("Runs", [Table(about, runs, (5,))]),
    ]
    bodies = [html(part, 1 if number == 0 else 2) for number, part in enumerate(parts)]
    return page(f"suite: {word}", bodies)


def _counts(found: Suite) -> str:
    words = [cell.worst[1].verdict for cell in found.cells]
    told = [f"{words.count(word)} {word}" for word in suites.WORDS if word in words]
    return f"{len(found.runs)} runs; requirements by rig: {', '.join(told) or 'none'}"


# JUnit


def as_junit(found: Suite) -> str:
    """Return a testcase for each requirement of each rig, and one for each run."""
    top = ET.Element("testsuites", name="pcpc")
    cases: list[tuple[str, str, str, str]] = []  # class, name, failure's type, words
    for cell in found.cells:
        run, one = cell.worst
        known = one.words.startswith(cell.key)
        name = one.words if known else f"{cell.key} {one.words}".strip()
        cases.append((cell.of, name, one.verdict, _words(one, run)))
    cases += [("", one, "not judged", "no run tests it") for one in found.absent]
    _suite(top, "requirements", cases, "failure")
    runs = [
        (run.of, str(run.path), OK if run.ok else run.verdict, _reasons(run))
        if run.ok or run.verdict != OK
        else (run.of, str(run.path), "not ok", _reasons(run))
        for run in found.runs
    ]
    _suite(top, "runs", runs, "error")
    for key in ("tests", "failures", "errors"):
        top.set(key, str(sum(int(one.get(key, "0")) for one in top)))
    ET.indent(top)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(top, encoding="unicode")


def _words(one: Tested, run: suites.OneRun) -> str:
    margin = f"margin {one.margin}" if one.margin else ""
    told = [one.why, margin, f"log {run.path}", f"sha256 {run.sha256}"]
    return "; ".join(filter(None, told))


def _suite(top: ET.Element, name: str, cases: list[tuple[str, str, str, str]], kind: str) -> None:
    failed = sum(word != OK for _, _, word, _ in cases)
    own = ET.SubElement(top, "testsuite", name=name, tests=str(len(cases)))
    own.set("failures", str(failed * (kind == "failure")))
    own.set("errors", str(failed * (kind == "error")))
    own.set("skipped", "0")
    own.set("time", "0")
    for of, case, word, why in cases:
        about = {"classname": f"pcpc.{printable(of) or name}", "name": printable(case), "time": "0"}
        one = ET.SubElement(own, "testcase", about)
        if word != OK:
            told = ET.SubElement(one, kind, {"type": word, "message": printable(f"{word}: {why}")})
            told.text = printable(why)
        elif why:
            ET.SubElement(one, "system-out").text = printable(why)
