"""docs/tool-confidence.md: what of pcpc could be wrong, who would notice, and what shows that.

Terms of ISO 26262-8:2018, clause 11. Every malfunction here could bring an error into an item, or
hide one: TI2. Then the level is that of the detection:

    TI1 -> TCL1,   TI2 and TD1 -> TCL1,   TI2 and TD2 -> TCL2,   TI2 and TD3 -> TCL3

Rows come from docs/faults.json and confidence.yaml. A test checks that each named test is there
and is run.
"""

import ast
import json
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

WIDTH = 120  # of a page
ROOT = Path(__file__).resolve().parents[2]
NUMBERS = ROOT / "docs/faults.json"
_NAMES = {"ways": ("tests/contract/ways.py", "WAYS"),
          "promises": ("tools/study/swarm/promises.py", "PROMISES")}  # fmt: skip
LIMITED = ", limited"  # behind the name of a fault
_EVIDENCE = "tools/dev/evidence/test_evidence.py::"
_TEMPLATE = """# Confidence in pcpc as a tool
<!-- written by `make reference`; change its source, not this page -->

{head}

| use | malfunction | detected by | TD | TCL | shown by |
|---|---|---|---|---|---|
{rows}

{tail}
"""
_HEAD = (
    "pcpc is **not qualified**: nobody has assessed it by ISO 26262-8, clause 11, or any other "
    "standard. This page helps you to classify your use of it. All rows have tool impact TI2: the "
    "malfunction could bring an error into your item, or hide one. Tool error detection TD (1 "
    "high, 2 medium, 3 low) is the authors' estimate, and holds if you do what *detected by* says. "
    "The confidence level TCL follows. Where a row does not fit your use, judge anew."
)
_TAIL = (
    "Tests stand below `tests/`; `make test-all` runs them. Numbers are those of [the faults]"
    "(faults.md). Nothing here detects a model that does not match your plant: compare it with "
    "measurements (`pcpc fit`)."
)


@dataclass(frozen=True)
class ConfidenceRow:
    """A malfunction; `shown`: tests below tests/, as pytest names them, without cases."""

    use: str
    malfunction: str
    detected: str
    td: int
    shown: Sequence[str]

    @property
    def tcl(self) -> int:
        """The tool confidence level of TI2."""
        return {1: 1, 2: 2, 3: 3}[self.td]


def rows() -> list[ConfidenceRow]:
    """Return all rows: those by hand, then those of the evidence."""
    with (Path(__file__).with_suffix(".yaml")).open(encoding="utf-8") as file:
        by_hand = yaml.safe_load(file)
    names = {key: len(_listed(*place)) for key, place in _NAMES.items()}
    told: list[dict[str, Any]] = [
        {key: text.format(**names) if isinstance(text, str) else text for key, text in one.items()}
        for one in by_hand
    ]
    evidence = json.loads(NUMBERS.read_text(encoding="utf-8"))
    return [*(ConfidenceRow(**one) for one in told), *_measured(evidence)]


def _measured(evidence: Mapping[str, Any]) -> Iterator[ConfidenceRow]:
    """Yield the rows that docs/faults.json has."""
    yield from _faults(evidence["matrix"]["rows"])
    mutants, kills = evidence["mutants"], evidence["kills"]
    argued = sum(mutants["argued"].values())
    yield ConfidenceRow(
        "run on a bus", "supervisor, limits, codec or reception decide wrongly",
        f"{mutants['noticed']:,} of {mutants['mutants']:,} mutants in tests, {argued} change "
        f"nothing, {len(mutants['left'])} are left", 2,
        ["tools/dev/test_mutants.py::test_the_compiled_code_is_as_expected_and_every_mutant_of_it_"
         "is_noticed"],
    )  # fmt: skip
    safe = sum(one["ok"] for one in kills)
    yield ConfidenceRow(
        "run on a bus", "a process of it dies",
        f"the others: commands safe in time, {safe} of {len(kills)} kills", 1,
        ["tools/dev/evidence/test_kills.py::test_whatever_is_killed_the_commands_are_safe_in_time_"
         "and_all_is_tidy"],
    )  # fmt: skip
    alarms = evidence["alarms"]
    yield ConfidenceRow(
        "run on a bus", "an alarm without a fault",
        f"replay: fewer than {alarms['upper_bound_per_h']:.2g} an hour (95 %)", 2,
        [f"{_EVIDENCE}test_a_clean_run_of_each_rig_has_no_alarm_and_each_is_another"],
    )  # fmt: skip


def _faults(faults: Sequence[Mapping[str, Any]]) -> Iterator[ConfidenceRow]:
    """Yield how many kinds of faults are noticed always, in some runs, and never."""
    kinds: dict[str, set[float]] = {}
    for one in faults:
        kinds.setdefault(one["fault"], set()).add(one["noticed"] / one["runs"])
    always = [name for name, shares in kinds.items() if shares == {1.0}]
    never = [name for name, shares in kinds.items() if shares == {0.0}]
    limited = [name for name in always if name.endswith(LIMITED)]
    some = [name for name in kinds if name not in (*always, *never)]
    runs = f"{faults[0]['runs']:,} runs each"
    shown = [f"{_EVIDENCE}test_a_few_runs_of_every_case_are_as_stated"]
    for names, td, how in (
        ([one for one in always if one not in limited], 1, f"counters, CRC, supervisor: {runs}"),
        (limited, 1, "the same, with limits (`plausible`) and `supervisor.intrusion`"),
        (some, 2, f"not in all runs: {'; '.join(sorted(some))}"),
        (never, 3, f"nothing: {'; '.join(sorted(never))}"),
    ):
        what = f"{len(names)} faults of bus and nodes"
        yield ConfidenceRow("exchange frames", what, how, td, shown)


def _listed(file: str, name: str) -> list[str]:
    """Return the names of functions in a table that is made of a tuple of them."""
    for node in ast.walk(ast.parse((ROOT / file).read_text(encoding="utf-8"))):
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == name:
            assert isinstance(node.value, ast.DictComp)
            source = node.value.generators[0].iter
            assert isinstance(source, ast.Tuple)
            return [ast.unparse(one) for one in source.elts]
    raise LookupError(f"{file}: no {name}")


def written() -> str:
    """Return the page."""
    lines = [
        f"| {row.use} | {row.malfunction} | {row.detected} | {row.td} | {row.tcl} | "
        f"{' '.join(f'`{one}`' for one in row.shown)} |"
        for row in rows()
    ]
    head, tail = (textwrap.fill(text, WIDTH, break_on_hyphens=False) for text in (_HEAD, _TAIL))
    return _TEMPLATE.format(head=head, rows="\n".join(lines), tail=tail)
