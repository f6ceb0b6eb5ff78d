"""The evidence as a page: docs/faults.md, and what stands in it as JSON beside it."""

import json
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import UserError
from pcpc.executive.loop.faults import Fault
from pcpc.tools.dev.evidence import kills
from pcpc.tools.terminal.outfile import new_file

PAGE, NUMBERS, WIDTH = "faults.md", "faults.json", 120
_HEAD = """\
# What happens with each fault

`python -m pcpc.tools.dev.evidence` injects every fault and writes this page. `faults.json` beside
it has the command that repeats a single row ([how to inject faults](howto/faults.md)).
[What protects the frames](bus-safety.md) explains the checks.
"""
_MATRIX = """
## Fault against detector

The barrel holds its target on a moving hull at 1 kHz with `pd_nn_fast`. Each row stands for
{runs:,} runs, each with its own moment of the fault and its own seed ({seed} to {last}).

- *noticed* counts the runs in which something noticed the fault within the limit. A number below
{runs:,} is followed by the lower bound of its share at 95 %. For all {runs:,} it is {least:.2f} %.
- *after* gives the cycles from the first one in which the fault acts: median, maximum and limit.
- *reaction* names the [numbered fault](bus-safety.md#the-named-faults), or HOLD.
- *error* is the hub's largest angle off its target, in the plant, in the {after} cycles that
follow. It is {clean:.2f} mrad without a fault.

In rows named *limited* receivers limit the values that they accept (`plausible`), and two senders
of a frame are a fault (`supervisor.intrusion`). Rows named *CRC-16* have CRC-16 and
counters of 8 bits, as in AUTOSAR's E2E profile 5.

"""
_QUIET = """
These faults are noticed in all runs in their first cycle, and the error stays within 5 % of that
without a fault (cycles on in brackets).

{names}
"""
_SAME = """
With CRC-16 these faults are noticed in as many runs, after as many cycles and with the same
reaction as with the CRC-8:

- {names}
"""
_NOT = """
## What nothing notices
"""
_LEFT = """
These are a forged frame with the right counter and CRC, frozen data with a running counter, a wrong
sensor, and an actuator that does less than commanded. Limits and the signs of a second sender find
most of the first three, as the rows named *limited* show. Two kinds of fault remain: a sensor with
a small error or slow drift, and the actuator. Only a second sensor or a model finds them. A law
may have these, but the bus check does not.
"""


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
    yield _filled_text(_HEAD)
    if matrix := evidence.get("matrix"):
        yield from _matrix(matrix)
    if residual := evidence.get("residual"):
        yield from _residual(residual)
    for name, part in (
        ("frames", _frames),
        ("envelope", _envelope),
        ("alarms", _alarms),
        ("mutants", _mutants),
        ("kills", _kills),
    ):
        if name in evidence:
            yield from part(evidence[name])


def _matrix(matrix: Mapping[str, Any]) -> Iterator[str]:
    rows = matrix["rows"]
    yield _filled_text(
        _MATRIX.format(
            runs=rows[0]["runs"], seed=matrix["seed"], last=matrix["seed"] + rows[0]["runs"] - 1,
            after=matrix["after_cycles"], clean=matrix["clean_mrad"],
            least=100.0 * max(row["lower_bound"] for row in rows),
        )
    ) + "\n"  # fmt: skip
    first = {(row["fault"], row["cycles"]): _outcome(row) for row in rows}
    same = [row for row in rows if _outcome(row) == first.get(_with_crc_8(row))]
    others = [row for row in rows if row["limit_cycles"] is not None and row not in same]
    quiet = [row for row in others if _is_quiet(row, 1.05 * matrix["clean_mrad"])]
    yield _table(
        ("fault", "cycles on", "noticed", "after", "first noticed by", "reaction", "error [mrad]"),
        [_matrix_row(row) for row in others if row not in quiet],
    )
    if quiet:
        both = (("HOLD follows", "HOLD"), ("No reaction", "none"))
        listed = [
            (what, [_quiet_name(row) for row in quiet if answer in row["answers"]])
            for what, answer in both
        ]
        names = "\n".join(f"- {what}: {_joined_words(some)}" for what, some in listed if some)
        yield _filled_text(_QUIET.format(names=names))
    if same:
        told = [row["fault"].rpartition(", ")[0] for row in same]
        yield _filled_text(_SAME.format(names=_joined_words(told)))
    if missed := [row for row in rows if row["limit_cycles"] is None and row not in same]:
        yield _filled_text(_NOT) + "\n"
        yield _table(
            ("fault", "cycles on", "error [mrad]"),
            [(row["fault"], str(row["cycles"]), f"{row['worst_mrad']:.3g}") for row in missed],
        )
        yield _filled_text(_LEFT)


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
    yield "\n## Random and mutated frames\n\n"
    yield _filled_text(
        f"{sum(row['frames'] for row in rows):,} frames went through a socket into the loop's own "
        "parser and acceptance. They have two formats: the `struct can_frame` of SocketCAN and the "
        "msgpack datagram of python-can's udp_multicast. The receiver had heard the counter "
        "before. It accepts 4 of 16 counters, and 1 of 256 CRCs is right by chance. All frames "
        "that were used and 1 % of the rest are judged again by the rules in plain Python, with "
        f"{sum(row['misjudged'] for row in rows)} differences. If a wrong bit or byte may hit a "
        "time stamp or a name, the table predicts no number. The rig is classic: it uses no "
        "CAN FD frame, and its raw socket does not even receive one."
    )
    for name in dict.fromkeys(row["format"] for row in rows):
        some = [row for row in rows if row["format"] == name]
        yield f"\n{name}, {some[0]['frames']:,} frames of each kind:\n\n"
        plain = [row for row in some if not row["used"] and len(row["fates"]) == 1]
        yield _table(
            ("sent", "predicted", "used", "the others"),
            [(row["kind"],
              "" if row["predicted"] is None else f"{row['predicted'] * row['frames']:,.0f}",
              f"{row['used']:,}",
              ", ".join(f"{fate} {n:,}" for fate, n in row["fates"].items() if fate != "used"))
             for row in some if row not in plain],
        )  # fmt: skip
        if plain:
            refused = [f"{row['kind']} ({next(iter(row['fates']))})" for row in plain]
            yield "\n" + _filled_text(
                f"None used, with one outcome for all:\n\n- {', '.join(refused)}"
            )


def _envelope(found: Mapping[str, Any]) -> Iterator[str]:
    yield "\n## No command leaves its envelope\n\n"
    met = ", ".join(f"{state} {n:,}" for state, n in found["met"].items())
    yield _filled_text(
        f"{found['laws']:,} runs of a lag have a command of limited range and rate. Each has "
        "another law, and faults of frames, blocks and nodes, resets and stops at random cycles. "
        "A law gives 64 answers in turn, times a gain: numbers, NaN, infinities, 1e300, both "
        f"zeros, denormals and limits. {len(found['broken'])} of them sent a command that was "
        "beyond its range or rate, was not a number, was not safe in INIT or at the end, or rose "
        f"again in FAULT. Number of runs that reached each state: {met}."
    )


def _alarms(alarms: Mapping[str, Any]) -> Iterator[str]:
    yield "\n## False alarms\n\n"
    told = sum(sum(row["alarms"].values()) for row in alarms["rigs"])
    bound = alarms["upper_bound_per_h"]
    upper = "" if bound is None else f", so fewer than {bound:.3g} an hour at 95 %"
    yield _filled_text(
        f"{alarms['hours']:.1f} h in virtual time without a fault gave {told} alarms{upper}. They "
        f"are {alarms['runs']:,} runs of {alarms['run_s']:g} s with other noise or another mass. "
        "An alarm is a held or stale cycle, a lost frame, a fault, or a run that ends early."
    )
    yield "\n" + _table(
        ("rig", "controller", "drawn", "hours", "runs", "alarms"),
        [(row["rig"], row["controller"], row["drawn"], f"{row['hours']:.1f}", f"{row['runs']:,}",
          ", ".join(f"{n} {kind}" for kind, n in row["alarms"].items() if n) or "0")
         for row in alarms["rigs"]],
    )  # fmt: skip


def _mutants(found: Mapping[str, Any]) -> Iterator[str]:
    yield "\n## What the tests of the safety code are worth\n\n"
    argued = sum(found["argued"].values())
    yield _filled_text(
        "The code under test is changed in one place at a time: supervisor, limits, watchdog, late "
        "cycles, other senders, reception, signs of a second sender, tunings, bus errors, "
        "end-to-end check and the codec's saturation. Of "
        f"{found['mutants']:,} changes, {found['noticed']:,} were noticed, {argued} make no "
        f"difference, and {len(found['left'])} were neither. "
        "`python -m pcpc.tools.dev.evidence mutants` and `faults.json` give the reason of each "
        "change that makes no difference."
    )
    if found.get("elsewhere"):
        yield "\n" + _filled_text(
            f"{len(found['elsewhere'])} modules of the loop, and {len(found['unchanged'])} "
            "functions of the others, have no mutants. `faults.json` names them."
        )


def _kills(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield "\n## Processes killed, stopped and slowed down\n\n"
    safe, bound = kills.safe_of(rows)
    yield _filled_text(
        f"{len(rows)} paced runs of the barrel at 1 kHz are disturbed once each, at a random "
        f"cycle. {safe} stay safe (>= {100.0 * bound:.2f} % at 95 %). KILL is kill -9. STOP is a "
        "stop of 20 to 600 ms, and SLOW is many short ones. BORN is kill -9 within 50 ms of the "
        "recorder's start, which may leave no log. A line's figures hold for each of its signals. "
        "*cycles* is the longest time for which a node that had noticed still acted on a command "
        "neither fresh nor safe. *log* is the number of runs whose log opens, with the ms that it "
        "lacks. *left* is how often a process or a claim stayed behind, and *next* how often the "
        "next run on the same bus ended well. The figures belong to one machine."
    )
    yield "\n```text\n" + "\n".join(kills.table(rows)) + "\n```\n"


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
    yield "\n## What the CRC-8 and the CRC-16 let pass\n\n"
    yield _filled_text(
        "Shares are predicted from the weights of the code, and measured, over 64 bits of counter, "
        "data and CRC. Hamming distances are "
        f"{both[0]['distance']} and {both[1]['distance']}, so the CRC-8 detects all errors of up "
        f"to {both[0]['distance'] - 1} bits, and the CRC-16 all of up to {both[1]['distance'] - 1}."
    )
    yield "\n" + _table(
        ("wrong bits", "patterns", "CRC-8: undetected", "predicted", "measured",
         "CRC-16: undetected", "predicted", "measured"),
        [(str(row["bits"]), f"{row['patterns']:,}", *_unseen(row), *_unseen(wide))
         for row, wide in zip(*(one["weights"] for one in both), strict=True) if row["bits"] <= 8],
    )  # fmt: skip
    yield "\nShare of wrong frames that pass, among all frames, with independent bit errors:\n\n"
    yield _table(
        ("bit error rate", "CRC-8", "CRC-16"),
        [
            (f"{row['bit_error_rate']:g}", f"{row['predicted']:.3g}", f"{wide['predicted']:.3g}")
            for row, wide in zip(*(one["rates"] for one in both), strict=True)
        ],
    )
    yield "\n" + _filled_text(
        f"Of frames with random data the CRC-8 lets {_passes(both[0])}, 4 of 16 counters and 1 of "
        f"256 CRCs). The CRC-16 lets {_passes(both[1])}, 4 of 256 counters and 1 of 65,536 CRCs). "
        "CAN's own CRC-15 checks each frame before this."
    )


def _unseen(row: Mapping[str, Any]) -> Sequence[str]:
    return f"{row['unseen_patterns']:,}", f"{row['predicted']:.3g}", f"{row['measured']:.3g}"


def _passes(found: Mapping[str, Any]) -> str:
    drawn = found["drawn_frames"]
    share = f"{drawn['measured']:.3g}, predicted {drawn['predicted']:.3g}"
    return f"{drawn['used']:,} of {drawn['runs']:,} pass ({share}"


def _filled_text(text: str) -> str:
    """Return text with its paragraphs as broad as those of other pages."""
    parts = [
        part if part.startswith("#") else _paragraph(part) for part in text.strip().split("\n\n")
    ]
    return "\n" * text.startswith("\n") + "\n\n".join(parts) + "\n"


def _paragraph(text: str) -> str:
    items = text.split("\n- ")
    return "\n".join(
        textwrap.fill(
            one, WIDTH, break_on_hyphens=False, subsequent_indent="  " * one.startswith("- ")
        )
        for one in (items[0], *(f"- {item}" for item in items[1:]))
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    above, *below = (f"| {' | '.join(cells)} |\n" for cells in (head, *rows))
    return "".join((above, f"|{'---|' * len(head)}\n", *below))
