"""What `pcpc jitter` prints and draws: cyclictest's line, stages, histogram, ratios, a picture."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from pcpc.plants import pages
from pcpc.tools.machine.jitter import nines
from pcpc.tools.machine.jitter.figures import (
    COMPARED,
    PCPC,
    PERCENTILES,
    JitterResult,
    Vector,
    percentiles,
    ratios,
)
from pcpc.tools.machine.jitter.probe import STAGES, ProbedNode
from pcpc.tools.terminal import screen

_BAR = 47  # the lines have 80 columns
_STEPS = np.outer(10.0 ** np.arange(7), (1.0, 2.0, 5.0)).ravel()  # us, edges of the short histogram
_LEAST_US = 0.1  # that the picture tells from 0
_BINS_A_DECADE = 20
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#000000")


def text_of(result: JitterResult, histogram_us: int | None) -> str:
    """Return the whole report."""
    nodes = {name: node for name in ("executive", "plant") if (node := result.node(name))}
    lines = [*_head(result)]
    lines += [thread_line(i, n, result) for i, n in enumerate(nodes.values())]
    for name, node in nodes.items():
        lines += ["", *_stages(name, node)]
    if paths := result.sorted_paths:
        lines += ["", *nines.lines(paths, result.setup.interval_ns, result.rounds)]
    late = {name: node.stages_us["wake_late"] for name, node in nodes.items()}
    if histogram_us is not None and late:
        lines += ["", *full_histogram(late, histogram_us)]
    elif late:
        lines += ["", *short_histogram(late["executive"])]
    if len(result.loops) > 1:
        lines += ["", *_comparison(result)]
    if found := result.verdicts:
        lines += ["", f"limits of {result.limits_of}"]
        lines += nines.limit_lines(found, result.setup.interval_ns, result.rounds)
    return "\n".join(lines)


def _head(result: JitterResult) -> Iterator[str]:
    setup = result.setup
    bus = result.probes[0].bus if result.probes else setup.bus
    yield (
        f"# pcpc jitter: {setup.interval_ns // 1000} us, {len(result.probes)} of {result.rounds} "
        f"rounds of {setup.periods} periods"
    )
    refused = [name for name, granted in result.fifo.items() if not granted]
    if refused:
        yield f"# without SCHED_FIFO: {', '.join(refused)}; `pcpc doctor` shows what to do"
    yield f"# T: 0 executive, T: 1 plant; us; {bus}"


def thread_line(number: int, node: ProbedNode, result: JitterResult) -> str:
    """Return cyclictest's line of a thread; Act is the last cycle's, P 0 without SCHED_FIFO."""
    late = node.late_ns // 1000
    priority = node.priority if result.fifo[PCPC] else 0
    return (
        f"T:{number:2d} ({node.pid:5d}) P:{priority:2d} I:{result.setup.interval_ns // 1000} "
        f"C:{len(late):7d} Min:{late.min():7d} Act:{late[-1]:5d} Avg:{int(late.mean()):5d} "
        f"Max:{late.max():8d}"
    )


def _stages(name: str, node: ProbedNode) -> Iterator[str]:
    yield f"{f'{name} us':13}" + "".join(f"{point:>10}" for point in PERCENTILES)
    for stage in STAGES:
        if len(node.stages_us[stage]):
            points = percentiles(node.stages_us[stage]).values()
            yield f"  {stage:11}" + "".join(f"{value:10.2f}" for value in points)
    yield f"  missed periods {node.missed}, late cycles {node.late}"


def full_histogram(late_us: Mapping[str, Vector], upto_us: int) -> Iterator[str]:
    """Yield cyclictest's histogram: a line for each us below `upto_us`, a column for each node.

    Each node: (n,).
    """
    whole = [np.floor(values).astype(np.int64) for values in late_us.values()]
    counts = [np.bincount(us[us < upto_us], minlength=upto_us) for us in whole]
    yield "# Histogram"
    for us in range(upto_us):
        yield f"{us:06d} " + "\t".join(f"{column[us]:06d}" for column in counts)
    for title, values in (
        ("Total:", [column.sum() for column in counts]),
        ("Min Latencies:", [us.min() for us in whole]),
        ("Avg Latencies:", [int(us.mean()) for us in whole]),
        ("Max Latencies:", [us.max() for us in whole]),
        ("Histogram Overflows:", [np.count_nonzero(us >= upto_us) for us in whole]),
    ):
        digits = 9 if title == "Total:" else 5
        yield f"# {title} " + " ".join(f"{value:0{digits}d}" for value in values)


def short_histogram(late_us: Vector) -> Iterator[str]:
    """Yield a line a bin, three to a decade, with a bar as long as the count's logarithm.

    `late_us`: (n,).
    """
    edges = np.concatenate([[0.0], _STEPS, [np.inf]])
    counts, _ = np.histogram(late_us, edges)
    used = np.flatnonzero(counts)
    longest = np.log1p(counts.max())
    yield "wake-up of the executive, us: cycles, bar logarithmic"
    for i in range(used[0], used[-1] + 1):
        bar = "#" * round(_BAR * np.log1p(counts[i]) / longest)
        yield f"  {edges[i]:8g} .. {edges[i + 1]:8g} {counts[i]:9d} {bar}".rstrip()


def _comparison(result: JitterResult) -> Iterator[str]:
    """Yield the figures of each loop, and ours over them."""
    ours, rows = result.late_us(PCPC), [("wake-up", "", "us", "pcpc/it")]
    for name in result.loops:
        rounds = result.late_us(name)
        if not sum(map(len, rounds)):
            continue
        figures = percentiles(np.concatenate(rounds))
        found = {} if name == PCPC else ratios(ours, rounds)
        for figure in COMPARED:
            of = found.get(figure)
            spread = f"{of.median:.2f} ({of.min:.2f}..{of.max:.2f})" if of else ""
            rows.append((name, figure, f"{figures[figure]:.1f}", spread))
    yield from screen.table(rows, right=(2,))
    yield "all rounds together; ratios: median over the rounds (least..largest)"


def draw(result: JitterResult, path: Path) -> None:
    """Draw the lateness of all loops as histograms, both axes logarithmic; OSError."""
    page, axis = pages.sheet((9.0, 4.5), 110)
    late = {name: np.concatenate(result.late_us(name)) for name in result.loops}
    late = {name: np.maximum(values, _LEAST_US) for name, values in late.items() if len(values)}
    low = 0.99 * min(values.min() for values in late.values())
    decades = np.log10(1.01 * max(values.max() for values in late.values()) / low)
    edges = low * np.logspace(0.0, decades, int(decades * _BINS_A_DECADE) + 2)
    for (name, values), colour in zip(late.items(), _COLOURS, strict=False):
        label = f"{name}: p50 {np.percentile(values, 50.0):.1f}, max {values.max():.0f} us"
        axis.hist(values, edges.tolist(), histtype="step", log=True, color=colour, label=label)
    axis.set_xscale("log")
    axis.set_xlabel("wake-up behind its deadline [us]")
    axis.set_ylabel("cycles")
    pages.bare(axis)
    axis.legend(frameon=False, fontsize=8)
    setup = result.setup
    axis.set_title(
        f"{setup.interval_ns // 1000} us, priority {setup.priority}, {len(result.probes)} rounds "
        f"of {setup.round_s:g} s",
        loc="left",
        fontsize=10,
    )
    page.savefig(path)
