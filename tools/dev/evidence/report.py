"""The evidence as a page: docs/faults.md, and what stands in it as JSON beside it."""

import json
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pcpc.drivers.errors import UserError
from pcpc.tools.dev.evidence import kills
from pcpc.tools.terminal.outfile import new_file

PAGE, NUMBERS, WIDTH = "faults.md", "faults.json", 120
_HEAD = """\
# What happens with each fault

`pcpc evidence` wrote this page: every fault was injected, and here stands what noticed it
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
without a limit are faults that nothing in this rig can notice: their rate is stated as it is. Rows
named *limited* are in the same rig with limits of what its receivers take, and a fault where two
senders of a frame are recognised (`plausible` and `supervisor.intrusion`); those named *CRC-16* in
the same rig with CRC-16 and counters of 8 bits, as of AUTOSAR's E2E profile 5.

"""
_NOT = """
What is not noticed is not safe. Without limits of what is received that is a forged frame with the
right counter and CRC, data that stand still behind a counter that goes on, a sensor that lies, an
actuator that does less than it is told. Limits and the signs of a second sender find most of the
first three, as the rows named *limited* say. What they leave, a sensor that lies by little or
slowly and the actuator, needs a second sensor or a model, which a law may have and the bus check
has not. The column on the right says what they cost here.
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
    for name, part in (
        ("frames", _frames),
        ("envelope", _envelope),
        ("alarms", _alarms),
        ("mutants", _mutants),
        ("kills", _kills),
    ):
        if name in evidence:
            yield from part(evidence[name])


def _frames(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield "\n## Random and mutated frames\n\n"
    yield _filled(
        f"{sum(row['frames'] for row in rows):,} frames went through a socket into the loop's own "
        "parser and acceptance, as the `struct can_frame` of SocketCAN and as the msgpack datagram "
        "of python-can's udp_multicast. The receiver had heard the counter before; it takes 4 of "
        "16, and 1 of 256 CRCs is right by chance. Wire or counts tell of each what became of it; "
        "all that were used and 1 % of the rest are judged again by the rules in plain Python: "
        f"{sum(row['misjudged'] for row in rows)} were judged otherwise. Where a wrong bit or byte "
        "may fall on a time stamp or a name, no share is predicted. A rig speaks classic CAN: CAN "
        "FD is refused, and a raw socket does not even get it."
    )
    yield "\n" + _table(
        ("format", "sent", "frames", "predicted", "used", "the others"),
        [(row["format"], row["kind"], f"{row['frames']:,}",
          "" if row["predicted"] is None else f"{row['predicted'] * row['frames']:,.0f}",
          f"{row['used']:,}",
          ", ".join(f"{fate} {n:,}" for fate, n in row["fates"].items() if fate != "used"))
         for row in rows],
    )  # fmt: skip


def _envelope(found: Mapping[str, Any]) -> Iterator[str]:
    yield "\n## No command leaves its envelope\n\n"
    met = ", ".join(f"{state} {n:,}" for state, n in found["met"].items())
    yield _filled(
        f"{found['laws']:,} runs of a lag with a command of limited range and rate, each with "
        "another law, faults of frames, blocks and nodes, resets and stops at drawn cycles. A law "
        "is 64 answers in turn and a gain: numbers, NaN, infinities, 1e300, both zeros, denormals, "
        f"limits in turn. {len(found['broken'])} of them sent a command beyond its range or rate, "
        "that was no number, not safe in INIT or at the end, or rose again in FAULT. Met in so "
        f"many runs: {met}."
    )


def _alarms(alarms: Mapping[str, Any]) -> Iterator[str]:
    yield "\n## False alarms\n\n"
    told = sum(sum(row["alarms"].values()) for row in alarms["rigs"])
    bound = alarms["upper_bound_per_h"]
    upper = "" if bound is None else f", so fewer than {bound:.3g} an hour at 95 %"
    yield _filled(
        f"{alarms['hours']:.1f} h without a fault, in virtual time: {told} alarms{upper}. "
        f"{alarms['runs']:,} runs of {alarms['run_s']:g} s, each with other noise or another mass. "
        "An alarm is a held or stale cycle, a lost frame, a fault, or a run that ends early."
    )
    kinds = [*alarms["rigs"][0]["alarms"]]
    words = {kind: kind.partition(".")[2].replace("_", " ") for kind in kinds if "." in kind}
    yield "\n" + _table(
        ("rig", "controller", "drawn", "hours", "runs", *(words.get(kind, kind) for kind in kinds)),
        [(row["rig"], row["controller"], row["drawn"], f"{row['hours']:.1f}", f"{row['runs']:,}",
          *(str(row["alarms"][kind]) for kind in kinds)) for row in alarms["rigs"]],
    )  # fmt: skip


def _mutants(found: Mapping[str, Any]) -> Iterator[str]:
    yield "\n## What the tests of the safety code are worth\n\n"
    argued = sum(found["argued"].values())
    yield _filled(
        "Supervisor, limits, watchdog, the judgements of late cycles and of other senders, "
        "reception, signs of a second sender, tunings, bus errors, end-to-end check and the "
        "codec's saturation were changed in "
        f"{found['mutants']:,} places, one at a time. {found['noticed']:,} changes were noticed, "
        f"{argued} make no difference, {len(found['left'])} were neither. Why a change makes none:"
    )
    yield "\n" + _table(("changes", "why"), [(str(n), why) for why, n in found["argued"].items()])
    if found.get("elsewhere"):
        yield "\n" + _filled("Not changed, so that nothing is said of them:") + "\n"
        yield _table(("module of the loop", "why"), [*found["elsewhere"].items()])
        yield "\n" + _filled(f"Nor are these of the others: {', '.join(found['unchanged'])}.")


def _kills(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield "\n## Processes killed, stopped and slowed down\n\n"
    yield _filled(
        f"{len(rows)} "
        "paced runs of the barrel at 1 kHz, each disturbed once at a drawn cycle. KILL is "
        "kill -9, STOP a stop of 20 to 600 ms, SLOW many short ones, BORN kill -9 within 50 ms of "
        "the recorder's start, which may leave no log. *cycles* is the longest "
        "time in which a node that had noticed acted on a command neither fresh nor safe; "
        "*log* in how many runs the log opens, with the ms that it lacks; *left* how often a "
        "process or a claim stayed; *next ok* how often the next run on the same bus ended "
        "well. These figures are of one machine and time: others give others."
    )
    yield "\n```text\n" + "\n".join(kills.table(rows)) + "\n```\n"


def _matrix_row(row: Mapping[str, Any]) -> Sequence[str]:
    by = ", ".join(row["by"]) or "nothing"
    answers = ", ".join(sorted(row["answers"], key="FAULT".__eq__)) + "".join(
        f": {text}" for text in row["faults"]
    )
    limit = "none" if row["limit_cycles"] is None else str(row["limit_cycles"])
    within = f"{row['within_limit'] if row['limit_cycles'] is not None else row['noticed']:,}"
    least = "" if row["limit_cycles"] is None else f"{100.0 * row['lower_bound']:.2f} %"
    cycles = ["" if row[key] is None else str(row[key]) for key in ("p50_cycles", "max_cycles")]
    return (row["fault"], str(row["cycles"]), limit, within, least, *cycles, by, answers,
            f"{row['worst_mrad']:.3g}")  # fmt: skip


def _residual(residual: Mapping[str, Any]) -> Iterator[str]:
    yield "\n## What the CRC-8 lets pass\n\n"
    yield from _unseen(residual, "4 of 16 counters, 1 of 256 CRCs", 8)
    yield "\n## What the CRC-16 lets pass\n\n"
    yield from _unseen(residual["crc_16"], "4 of 256 counters, 1 of 65,536 CRCs", 16)


def _unseen(found: Mapping[str, Any], prediction: str, bits: int) -> Iterator[str]:
    yield _filled(
        "By its weights, and as often as that was measured, over 64 bits of counter, data and "
        f"CRC, of which {bits} are the CRC. Its Hamming distance there is {found['distance']}: "
        f"all errors of up to {found['distance'] - 1} bits are seen."
    )
    yield "\n" + _table(
        ("wrong bits", "patterns not seen", "of", "predicted", "measured"),
        [
            (str(row["bits"]), f"{row['unseen_patterns']:,}", f"{row['patterns']:,}",
             f"{row['predicted']:.3g}", f"{row['measured']:.3g}")
            for row in found["weights"] if row["bits"] <= 8
        ],
    )  # fmt: skip
    yield "\nWith each bit wrong by itself, of all frames this share is wrong and passes:\n\n"
    yield _table(
        ("bit error rate", "share"),
        [(f"{row['bit_error_rate']:g}", f"{row['predicted']:.3g}") for row in found["rates"]],
    )
    drawn = found["drawn_frames"]
    yield "\n" + _filled(
        f"Of {drawn['runs']:,} frames with drawn data {drawn['used']:,} were used "
        f"({drawn['measured']:.3g}; {drawn['predicted']:.3g} predicted: {prediction}). CAN's own "
        "CRC-15 stands before all this.\n"
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
