"""JUnit XML, which continuous integration reads: suites of cases, each with what came of it."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pcpc.drivers.errors import printable

_KINDS = {"failures": "failure", "errors": "error", "skipped": "skipped"}


@dataclass(frozen=True)
class Case:
    """A testcase of class `of`; `kind`: failure, error, skipped, "" for passed; `why` in words."""

    of: str
    name: str
    kind: str
    verdict: str
    why: str


def junit_text(suites: Mapping[str, Sequence[Case]]) -> str:
    """Return the file of suites by name."""
    top = ET.Element("testsuites", name="pcpc")
    for name, cases in suites.items():
        _add(top, name, cases)
    for key in ("tests", "failures", "errors"):
        top.set(key, str(sum(int(one.get(key, "0")) for one in top)))
    ET.indent(top)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(top, encoding="unicode")


def _add(top: ET.Element, name: str, cases: Sequence[Case]) -> None:
    own = ET.SubElement(top, "testsuite", name=name, tests=str(len(cases)))
    for key, kind in _KINDS.items():
        own.set(key, str(sum(case.kind == kind for case in cases)))
    own.set("time", "0")
    for case in cases:
        about = {"classname": f"pcpc.{printable(case.of) or name}", "name": printable(case.name)}
        one = ET.SubElement(own, "testcase", about | {"time": "0"})
        if case.kind:
            message = printable(f"{case.verdict}: {case.why}")
            told = ET.SubElement(one, case.kind, {"type": case.verdict, "message": message})
            told.text = printable(case.why)
        elif case.why:
            ET.SubElement(one, "system-out").text = printable(case.why)
