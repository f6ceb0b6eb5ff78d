"""What a law loses in single precision, measured in its closed loop in virtual time.

Two runs of a rig: one with the law as it is, one with all nodes but the plant in C with floats
(`single`). The plant, the frames and the limits of the loop compute with doubles in both. The first
run also counts, of each state of the law, the changes that a float could not have taken:

    lost    the change d != 0 of a state x in a step, of which float(x) + float(d) == float(x)

A state all of whose small changes are lost stands still where the double creeps on. How much a loop
answers to any small cause is told by further runs in double: with other seeds, and with parameters
and inputs of the law rounded to floats.
"""

import math
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from pcpc.executive.laws.block import Block
from pcpc.executive.log.reader import Log
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.nodes.watched import StepError
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.make.generate.library import Library, adapter, put
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.progress import Progress

SEEDS = 4  # further ones
TOLD = 0.05  # share of lost changes of a state that is worth a line


@dataclass(frozen=True)
class Difference:
    """What became of a run in single precision, against the same one in double.

    `rms`, `most`: of the difference of the command that the plant takes, as a share of the rms of
    that command; of several commands the worst. `nudged`: least and most of the metric in double
    after small causes. `early`: the run with floats ended by a fault, after `cycles`. `lost`: share
    of lost changes by state, the worst first.
    """

    command: str
    rms: float
    most: float
    metric: str
    in_double: float
    in_single: float
    nudged: tuple[float, float]
    cycles: int
    early: bool
    lost: dict[str, float] = field(default_factory=dict)


def difference(rig: Rig, others: Sequence[Rig] = ()) -> Difference:
    """Run a rig with doubles and with floats, and compare. Untranslatable, UserError.

    `others`: the same one with other seeds.
    """
    libraries: list[Library] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        watched = partial(put, folder=folder / "double", entry=counting_adapter)
        double, made = _run(rig, lambda one: libraries.append(watched(one)))
        lost = _lost_shares(libraries)
        single, _ = _run(rig, partial(put, folder=folder / "single", in_single=True))
        rounded, _ = _run(rig, partial(put, folder=folder / "rounded", entry=_rounding_adapter))
    command, rms, most = max(_commands(double, single, made), key=lambda row: row[1])
    judge = Judge.of(rig)
    first = judge.metrics(double)
    metric = next((n for n in first if "error_rms" in n), next(iter(first), ""))
    further = [single, double, rounded, *(_run(one)[0] for one in others)]
    values = [judge.metrics(log).get(metric, math.nan) for log in further]
    cycles = [len(log.node["plant"].cycle) for log in (double, single)]
    return Difference(
        command,
        rms,
        most,
        metric,
        values[1],
        values[0],
        (min(values[1:]), max(values[1:])),
        cycles[1],
        cycles[1] < cycles[0],
        lost,
    )


def precision_table(
    rig: Rig, names: Sequence[str], settings: Sequence[str], progress: Progress
) -> list[str]:
    """Return the table of some of a rig's controllers, and what of their states is lost."""
    rows = [("law", "rms", "most", "double", "float", "double, nudged")]
    lost: list[str] = []
    asked: dict[str, None] = {}
    for name in names:
        progress.show(f"{name} with floats")
        law = load_rig(rig.path, name, list(settings))
        seeds = [f"seed={law.config.seed + i}" for i in range(1, SEEDS + 1)]
        found = difference(law, [load_rig(rig.path, name, [*settings, seed]) for seed in seeds])
        asked[found.command.removeprefix("rx.")] = asked[found.metric] = None
        last = f"ends at {found.cycles}" if found.early else f"{found.in_single:.4g}"
        nudged = f"{found.nudged[0]:.4g} to {found.nudged[1]:.4g}"
        shares = f"{found.rms:.1e}", f"{found.most:.1e}"
        rows.append((name, *shares, f"{found.in_double:.4g}", last, nudged))
        lost += [
            f"{name}: a float loses {share:.0%} of the changes of {state}"
            for state, share in found.lost.items()
            if share >= TOLD
        ]
    progress.close()
    about = (
        f"{rig.config.rig} in float: the change of the command as a share of its rms; the metric"
    )
    return [
        *screen.wrapped_lines(f"{about} ({', '.join(asked)})"),
        *screen.table(rows, right=(1, 2, 3, 4)),
        *lost,
    ]


def _run(rig: Rig, put_in: Callable[[Plan], object] = id) -> tuple[Log, list[Plan]]:
    """Run a rig with other steps for all of its nodes but the plant."""

    def check(made: Plan) -> None:
        if made.role != "plant":
            put_in(made)

    virtual = VirtualRun(rig, None, check=check)
    try:
        for _ in virtual.advance():
            pass
    except StepError:
        virtual.memory.drain()  # a law that fails; the run ends early
    return virtual.memory.log(), virtual.plans


def _commands(double: Log, single: Log, made: list[Plan]) -> Iterator[tuple[str, float, float]]:
    """Yield name, rms and most of the difference of each value that the plant's blocks take."""
    plant = made[-1]
    names = {
        plant.table.variables[source].name
        for copies in plant.copies[:-1]
        for source, _ in copies
        if plant.table.variables[source].kind == "received"
    }
    for name in sorted(names):
        a, b = (log.node["plant"].columns[name] for log in (double, single))
        count = min(len(a), len(b))
        error, size = b[:count] - a[:count], float(np.sqrt(np.mean(a**2))) or 1.0
        yield name, float(np.sqrt(np.mean(error**2))) / size, float(np.max(np.abs(error))) / size


def _lost_shares(libraries: Sequence[Library]) -> dict[str, float]:
    """Return the share of lost changes of each port of states that changed; worst first."""
    found: dict[str, float] = {}
    for library in libraries:
        for name, block in library.blocks.items():
            size, at = block.size(block.states), 0
            if not size:
                continue
            changed = library.counts(f"{name}_changed", size)
            lost = library.counts(f"{name}_lost", size)
            for port in block.states:
                here = slice(at, at + port.size)
                at += port.size
                if total := sum(changed[here]):
                    found[f"{name.partition('_')[2]}.{port.name}"] = sum(lost[here]) / total
    return dict(sorted(found.items(), key=lambda row: -row[1]))


_COUNTS = """
uint64_t NAME_changed[SIZE], NAME_lost[SIZE];
static double NAME_before[SIZE];
static void NAME_count(const double *x)
{
    for (uint32_t i = 0U; i < SIZEU; i += 1U) {
        const double change = x[i] - NAME_before[i];
        const volatile float sum = (float)NAME_before[i] + (float)change;
        if ((NAME_before[i] == NAME_before[i]) && (change != 0.0)) {
            NAME_changed[i] += 1U;
            NAME_lost[i] += (sum == (float)NAME_before[i]) ? 1U : 0U;
        }
    }
}
"""


def counting_adapter(block: Block, name: str) -> str:
    """Return the C of `NAME_entry` that counts changes of states."""
    size, text = block.size(block.states), adapter(block, name)
    if not size:
        return text
    first, _, rest = text.partition("\n")
    head, mark, call = rest.partition(f"    {name}_step(")
    call, _, end = call.partition("\n")
    counts = _COUNTS.replace("NAME", name).replace("SIZE", str(size))
    keep = _loop_text(size, f"{name}_before[i] = x[i];")
    return f"{first}\n{counts}{head}{keep}{mark}{call}\n    {name}_count(x);\n{end}"


def _rounding_adapter(block: Block, name: str) -> str:
    """Return the C of `NAME_entry` that rounds parameters and inputs to floats."""
    head, mark, rest = adapter(block, name).partition(f"    {name}_step(")
    both = (("p", block.size(block.parameters)), ("u", block.size(block.inputs)))
    rounded = [_loop_text(n, f"{its}[i] = (double)(float){its}[i];") for its, n in both if n]
    return f"{head}{''.join(rounded)}{mark}{rest}"


def _loop_text(size: int, statement: str) -> str:
    return f"    for (uint32_t i = 0U; i < {size}U; i += 1U) {{\n        {statement}\n    }}\n"
