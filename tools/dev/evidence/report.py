"""The evidence as a page: docs/faults.md, and what stands in it as JSON beside it."""

import json
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import UserError
from pcpc.executive.loop.faults import Fault
from pcpc.plants.study import markdown
from pcpc.tools.dev.evidence import kills
from pcpc.tools.terminal.outfile import new_file

PAGE, NUMBERS, WIDTH = "faults.md", "faults.json", 120
_TEMPLATE = Path(__file__).with_name("faults.md.in")


def read(folder: Path) -> dict[str, Any]:
    """Return the numbers that a folder holds, of other parts; UserError if they are none."""
    path = folder / NUMBERS
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: {error}; choose another folder with -o") from None
    return dict(found)


def write(folder: Path, evidence: Mapping[str, Any]) -> Path:
    """Write page and numbers; return the page's path."""
    folder.mkdir(parents=True, exist_ok=True)
    written = {PAGE: "".join(_parts(evidence)), NUMBERS: json.dumps(evidence, indent=1)}
    for name, text in written.items():
        with new_file(folder / name, force=True) as path:
            path.write_text(text, encoding="utf-8")
    return folder / PAGE


def _parts(evidence: Mapping[str, Any]) -> Iterator[str]:
    """Yield the sections of the page."""
    yield _section("head").removeprefix("\n")
    for name, part in (
        ("matrix", _matrix),
        ("residual", _residual),
        ("frames", _frames),
        ("envelope", _envelope),
        ("alarms", _alarms),
        ("mutants", _mutants),
        ("kills", _kills),
    ):
        if evidence.get(name):
            yield from part(evidence[name])


@cache
def _texts() -> dict[str, str]:
    """Return the texts of the template by name."""
    _, *parts = re.split(r"<!-- (\w+) -->\n", _TEMPLATE.read_text(encoding="utf-8"))
    return dict(zip(parts[::2], parts[1::2], strict=True))


def _section(name: str, /, **fields: Any) -> str:
    """Return a text of the template, its paragraphs as broad as those of other pages."""
    parts = []
    for part in _texts()[name].strip().split("\n\n"):
        text = part.format(**fields).strip()
        parts.append(text if text.startswith(("#", "|", "```")) else _paragraph(text))
    return "\n" + "\n\n".join(parts) + "\n"


def _matrix(matrix: Mapping[str, Any]) -> Iterator[str]:
    rows, runs = matrix["rows"], matrix["rows"][0]["runs"]
    first = {(row["fault"], row["cycles"]): _outcome(row) for row in rows}
    same = [row for row in rows if _outcome(row) == first.get(_with_crc_8(row))]
    others = [row for row in rows if row["limit_cycles"] is not None and row not in same]
    quiet = [row for row in others if _is_quiet(row, 1.05 * matrix["clean_mrad"])]
    yield _section(
        "matrix", **matrix, runs=runs, last=matrix["seed"] + runs - 1,
        least=100.0 * max(row["lower_bound"] for row in rows),
        table=markdown(
            ("fault", "cycles on", "noticed", "after", "first noticed by", "reaction",
             "error [mrad]"),
            [_matrix_row(row) for row in others if row not in quiet],
        ),
    )  # fmt: skip
    if quiet:
        both = (("HOLD follows", "HOLD"), ("No reaction", "none"))
        listed = [
            (what, [_quiet_name(row) for row in quiet if answer in row["answers"]])
            for what, answer in both
        ]
        names = "\n".join(f"- {what}: {_joined_words(some)}" for what, some in listed if some)
        yield _section("quiet", names=names)
    if same:
        crc_8 = [row["fault"].rpartition(", ")[0] for row in same]
        yield _section("same", names=_joined_words(crc_8))
    if missed := [row for row in rows if row["limit_cycles"] is None and row not in same]:
        table = markdown(
            ("fault", "cycles on", "error [mrad]"),
            [(row["fault"], str(row["cycles"]), f"{row['worst_mrad']:.3g}") for row in missed],
        )
        yield _section("missed", table=table)


def _with_crc_8(row: Mapping[str, Any]) -> tuple[str, int]:
    """Return name and cycles of the row with the CRC-8 beside one with the CRC-16."""
    name, comma, rig = row["fault"].rpartition(", ")
    return (name if comma and rig == "CRC-16" else "", row["cycles"])


def _is_quiet(row: Mapping[str, Any], bound_mrad: float) -> bool:
    """Return whether all runs noticed a fault at once and kept their error."""
    at_once = row["within_limit"] == row["runs"] and row["max_cycles"] == 0
    answer = [*row["answers"]] in (["HOLD"], ["none"])
    return at_once and answer and float(row["worst_mrad"]) <= bound_mrad


def _quiet_name(row: Mapping[str, Any]) -> str:
    return f"{row['fault'].replace(', ', ' with ')} ({row['cycles']})"


def _joined_words(names: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _outcome(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return what the runs of a row came to, but for the error."""
    keys = "limit_cycles", "noticed", "within_limit", "p50_cycles", "max_cycles"
    return *(row[key] for key in keys), set(row["by"]), set(row["answers"]), set(row["faults"])


def _frames(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    count, misjudged = (sum(row[key] for row in rows) for key in ("frames", "misjudged"))
    yield _section("frames", count=count, misjudged=misjudged)
    for name in dict.fromkeys(row["format"] for row in rows):
        some = [row for row in rows if row["format"] == name]
        plain = [row for row in some if not row["used"] and len(row["fates"]) == 1]
        table = markdown(
            ("sent", "predicted", "used", "the others"),
            [(row["kind"],
              "" if row["predicted"] is None else f"{row['predicted'] * row['frames']:,.0f}",
              f"{row['used']:,}",
              ", ".join(f"{fate} {n:,}" for fate, n in row["fates"].items() if fate != "used"))
             for row in some if row not in plain],
        )  # fmt: skip
        yield _section("format", name=name, count=some[0]["frames"], table=table)
        if plain:
            refused = [f"{row['kind']} ({next(iter(row['fates']))})" for row in plain]
            yield _section("refused", names=", ".join(refused))


def _envelope(found: Mapping[str, Any]) -> Iterator[str]:
    met = ", ".join(f"{state} {n:,}" for state, n in found["met"].items())
    yield _section("envelope", laws=found["laws"], broken=len(found["broken"]), met=met)


def _alarms(alarms: Mapping[str, Any]) -> Iterator[str]:
    count = sum(sum(row["alarms"].values()) for row in alarms["rigs"])
    bound = alarms["upper_bound_per_h"]
    upper = "" if bound is None else f", so fewer than {bound:.3g} an hour at 95 %"
    table = markdown(
        ("rig", "controller", "drawn", "hours", "runs", "alarms"),
        [(row["rig"], row["controller"], row["drawn"], f"{row['hours']:.1f}", f"{row['runs']:,}",
          ", ".join(f"{n} {kind}" for kind, n in row["alarms"].items() if n) or "0")
         for row in alarms["rigs"]],
    )  # fmt: skip
    yield _section("alarms", **{**alarms, "alarms": count}, upper=upper, table=table)


def _mutants(found: Mapping[str, Any]) -> Iterator[str]:
    argued, left = sum(found["argued"].values()), len(found["left"])
    yield _section("mutants", **{**found, "argued": argued, "left": left})
    if found.get("elsewhere"):
        modules, functions = len(found["elsewhere"]), len(found["unchanged"])
        yield _section("elsewhere", modules=modules, functions=functions)


def _kills(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    safe, bound = kills.safe_of(rows)
    table = "\n".join(kills.table(rows))
    yield _section("kills", runs=len(rows), safe=safe, bound=100.0 * bound, table=table)


def _matrix_row(row: Mapping[str, Any]) -> Sequence[str]:
    within = f"{row['within_limit']:,}"
    if row["within_limit"] < row["runs"]:
        within += f" (>= {100.0 * row['lower_bound']:.2f} %)"
    after = f"{row['p50_cycles']}/{row['max_cycles']}/{row['limit_cycles']}"
    answers = [one for one in row["answers"] if one != "FAULT"]
    numbered = [
        f"FAULT {next(one for one in Fault if one.says == text):d}" for text in row["faults"]
    ]
    return (row["fault"], str(row["cycles"]), within, after, ", ".join(row["by"]),
            ", ".join((*sorted(answers), *numbered)), f"{row['worst_mrad']:.3g}")  # fmt: skip


def _residual(residual: Mapping[str, Any]) -> Iterator[str]:
    both = residual, residual["crc_16"]
    crc_8, crc_16 = (one["distance"] for one in both)
    weights = markdown(
        ("wrong bits", "patterns", "CRC-8: undetected", "predicted", "measured",
         "CRC-16: undetected", "predicted", "measured"),
        [(str(row["bits"]), f"{row['patterns']:,}", *_unseen(row), *_unseen(wide))
         for row, wide in zip(*(one["weights"] for one in both), strict=True) if row["bits"] <= 8],
    )  # fmt: skip
    rates = markdown(
        ("bit error rate", "CRC-8", "CRC-16"),
        [
            (f"{row['bit_error_rate']:g}", f"{row['predicted']:.3g}", f"{wide['predicted']:.3g}")
            for row, wide in zip(*(one["rates"] for one in both), strict=True)
        ],
    )
    passes_8, passes_16 = map(_passes, both)
    yield _section(
        "residual", crc_8=crc_8, crc_16=crc_16, sure_8=crc_8 - 1, sure_16=crc_16 - 1,
        weights=weights, rates=rates, passes_8=passes_8, passes_16=passes_16,
    )  # fmt: skip


def _unseen(row: Mapping[str, Any]) -> Sequence[str]:
    return f"{row['unseen_patterns']:,}", f"{row['predicted']:.3g}", f"{row['measured']:.3g}"


def _passes(found: Mapping[str, Any]) -> str:
    drawn = found["drawn_frames"]
    share = f"{drawn['measured']:.3g}, predicted {drawn['predicted']:.3g}"
    return f"{drawn['used']:,} of {drawn['runs']:,} pass ({share}"


def _paragraph(text: str) -> str:
    items = text.split("\n- ")
    return "\n".join(
        textwrap.fill(
            one, WIDTH, break_on_hyphens=False, subsequent_indent="  " * one.startswith("- ")
        )
        for one in (items[0], *(f"- {item}" for item in items[1:]))
    )
