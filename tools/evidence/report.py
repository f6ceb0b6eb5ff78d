"""The evidence as a page: docs/faults.md, and what stands in it as JSON beside it."""

import json
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pcpc.tools.evidence import kills

PAGE, NUMBERS, WIDTH = "faults.md", "faults.json", 120
_HEAD = """\
# What happens with each fault

`pcpc evidence report` wrote this page: every fault was injected, and here stands what noticed it
and what followed. Each row can be seen by itself with the command in `faults.json` ([how to inject
faults](howto/faults.md)); what the checks are stands in [what protects the frames](bus-safety.md).
"""
_MATRIX = """
## Fault against detector

The barrel holds its target on a moving hull at 1 kHz, `pd_nn_fast`; {runs:,} runs a row, each with
the fault at another moment and with other draws (seeds {seed} to {last}). Cycles count from the
first one in which the fault acts; *within* says in how many runs something noticed it within the
limit, *at least* is the lower bound of that share at 95 %. The error is the hub's largest angle off
its target, in the plant, in the {after} cycles after; it is {clean:.2f} mrad without a fault. Rows
without a limit are faults that nothing in this rig can notice: their rate is stated as it is.

"""
_NOT = """
What is not noticed is not safe: a forged frame with the right counter and CRC, data that stand
still behind a counter that goes on, a sensor that lies plausibly, an actuator that does less than
it is told. Against the first there is only a bus that nobody else reaches; the others need a second
sensor or a model, which a law may have and the bus check has not. The column on the right says what
they cost here.
"""


def write(folder: Path, evidence: Mapping[str, Any]) -> Path:
    """Write page and numbers; return the page's path."""
    folder.mkdir(parents=True, exist_ok=True)
    page = folder / PAGE
    page.write_text("".join(_parts(evidence)), encoding="utf-8")
    (folder / NUMBERS).write_text(json.dumps(evidence, indent=1), encoding="utf-8")
    return page


def _parts(evidence: Mapping[str, Any]) -> Iterator[str]:
    yield _filled(_HEAD)
    if matrix := evidence.get("matrix"):
        rows = matrix["rows"]
        text = _MATRIX.format(
            runs=rows[0]["runs"], seed=matrix["seed"], last=matrix["seed"] + rows[0]["runs"] - 1,
            after=matrix["after_cycles"], clean=matrix["clean_mrad"],
        )  # fmt: skip
        yield _filled(text) + "\n"
        yield _table(
            ("fault", "cycles on", "limit", "within", "at least", "p50", "max", "first noticed by",
             "what followed", "error [mrad]"),
            [_matrix_row(row) for row in rows],
        )  # fmt: skip
        yield _filled(_NOT)
    if residual := evidence.get("residual"):
        yield from _residual(residual)
    for name, part in (("alarms", _alarms), ("mutants", _mutants), ("kills", _kills)):
        if name in evidence:
            yield from part(evidence[name])


def _alarms(alarms: Mapping[str, Any]) -> Iterator[str]:
    yield "\n## False alarms\n\n"
    told = sum(alarms["alarms"].values())
    bound = alarms["upper_bound_per_h"]
    upper = "" if bound is None else f", so fewer than {bound:.3g} an hour at 95 %"
    yield _filled(
        f"{alarms['hours']:.1f} h without a fault ({alarms['runs']:,} runs of 12 s, each with "
        f"other noise, in virtual time): {told} alarms{upper}. An alarm is a held or stale cycle, "
        "a lost frame, a fault, or a run that ends early."
    )


def _mutants(found: Mapping[str, Any]) -> Iterator[str]:
    yield "\n## What the tests of the safety code are worth\n\n"
    argued = sum(found["argued"].values())
    yield _filled(
        "Supervisor, limits, watchdog, end-to-end check and the codec's saturation were changed in "
        f"{found['mutants']:,} places, one at a time. {found['noticed']:,} changes were noticed, "
        f"{argued} make no difference, {len(found['left'])} were neither. Why a change makes none:"
    )
    yield "\n" + _table(("changes", "why"), [(str(n), why) for why, n in found["argued"].items()])


def _kills(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield "\n## Processes killed, stopped and slowed down\n\n"
    yield _filled(
        f"{len(rows)} "
        "paced runs of the barrel at 1 kHz, each disturbed once at a drawn cycle. KILL is "
        "kill -9, STOP a stop of 20 to 600 ms, SLOW many short ones. *cycles* is the longest "
        "time in which a node that had noticed acted on a command neither fresh nor safe; "
        "*log* in how many runs the log opens, with the ms that it lacks; *left* how often a "
        "process or a claim stayed; *next ok* how often the next run on the same bus ended "
        "well. These figures are of one machine and time: others give others."
    )
    yield "\n```text\n" + "\n".join(kills.table(rows)) + "\n```\n"


def _matrix_row(row: Mapping[str, Any]) -> Sequence[str]:
    by = ", ".join(row["by"]) or "nothing"
    answers = ", ".join(name for name in row["answers"]) + "".join(
        f": {text}" for text in row["faults"]
    )
    limit = "none" if row["limit_cycles"] is None else str(row["limit_cycles"])
    within = f"{row['within_limit'] if row['limit_cycles'] is not None else row['noticed']:,}"
    least = "" if row["limit_cycles"] is None else f"{100.0 * row['lower_bound']:.2f} %"
    cycles = ["" if row[key] is None else str(row[key]) for key in ("p50_cycles", "max_cycles")]
    return (row["fault"], str(row["cycles"]), limit, within, least, *cycles, by, answers,
            f"{row['worst_mrad']:.3g}")  # fmt: skip


def _residual(residual: Mapping[str, Any]) -> Iterator[str]:
    yield (
        "\n## What the CRC-8 lets pass\n\nBy its weights, and as often as that was measured, over "
        "64 bits of data and CRC:\n\n"
    )
    yield _table(
        ("wrong bits", "patterns not seen", "of", "predicted", "measured"),
        [
            (str(row["bits"]), f"{row['unseen_patterns']:,}", f"{row['patterns']:,}",
             f"{row['predicted']:.3g}", f"{row['measured']:.3g}")
            for row in residual["weights"] if row["bits"] <= 8
        ],
    )  # fmt: skip
    yield "\nWith each bit wrong by itself, of all frames this share is wrong and passes:\n\n"
    yield _table(
        ("bit error rate", "share"),
        [(f"{row['bit_error_rate']:g}", f"{row['predicted']:.3g}") for row in residual["rates"]],
    )
    drawn = residual["drawn_frames"]
    yield "\n" + _filled(
        f"Of {drawn['runs']:,} frames with drawn data {drawn['used']:,} were used "
        f"({drawn['measured']:.3g}; {drawn['predicted']:.3g} predicted: 4 of 16 counters, 1 of 256 "
        "CRCs). CAN's own CRC-15 stands before all this.\n"
    )


def _filled(text: str) -> str:
    """Return text with its paragraphs as broad as those of other pages."""
    parts = [
        part if part.startswith("#") else textwrap.fill(part, WIDTH, break_on_hyphens=False)
        for part in text.strip().split("\n\n")
    ]
    return "\n" * text.startswith("\n") + "\n\n".join(parts) + "\n"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)
