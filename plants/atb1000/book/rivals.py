"""Who wins where: the laws of the barrel, tuned alike, on 13 scenarios and on random plants.

    scenarios   SCENARIOS of study.py on the nominal barrel, SEEDS of noise that no tuning saw
    plants      PLANTS draws as in study.py, from another seed; three scenarios; each plant and its
                noise the same for all laws

Ratios are paired: of two laws on one plant and noise. Their geometric mean has the 95 % interval of
a BCa bootstrap over the plants. REFERENCE is the law without a network with the best score of the
tuning, so chosen on the nominal barrel alone. `pcpc experiment rivals` runs it.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcpc.plants.atb1000.book.study import NOMINAL, SCENARIOS, random_plant
from pcpc.plants.atb1000.book.tuning import RMS, STEP
from pcpc.plants.book.figures import legend_below, save
from pcpc.plants.book.tables import Words, case_maker, controller_of, grouped, rig_name
from pcpc.plants.pages import sheet
from pcpc.plants.study import Case, CaseResult, markdown, of_group

WITHOUT = ("pd", "pd_star", "pid", "pd_tuned", "pid_tuned", "pd_fast_tuned", "pd_feedforward",
           "pd_observer", "super_twisting", "pd_adaptive", "lqg")  # fmt: skip
NETWORKS = ("pd_nn_fast", "pd_nn_tuned", "pd_nn_fast_tuned", "nn_backstepping")
LAWS = (*WITHOUT, *NETWORKS)
ON_PLANTS = ("pd", "pd_tuned", "pid_tuned", "pd_feedforward", "pd_observer", "super_twisting",
             "pd_adaptive", "lqg", "pd_nn_fast", "pd_nn_tuned", "pd_nn_fast_tuned",
             "nn_backstepping")  # fmt: skip
REFERENCE, NETWORK = "pd_feedforward", "pd_nn_fast"
SEEDS = tuple(range(101, 107))
PLANTS, PLANT_SEED, NOISE_SEED = 200, 1902, 7000
CORE = ("slew10", "sin0.5", "hull")
SHORTER = {"hull": (("duration_s=8.0",), (4.0, 8.0))}  # and its window
_case = case_maker(__file__)
THIRDS = (("friction below 0.8", 0.0, 0.8), ("0.8 to 1.25", 0.8, 1.25), ("above", 1.25, 9.0))
DRAWN = {"pd_feedforward": "#e69f00", "pd_adaptive": "#009e73", "lqg": "#0072b2",
         "pd_nn_fast": "#d55e00", "pd_nn_fast_tuned": "#cc79a7"}  # fmt: skip
Array = NDArray[np.float64]
Figures = Mapping[Words, Array]


def cases(plants: int = PLANTS) -> Iterator[Case]:
    """Yield all runs."""
    for scenario in SCENARIOS:
        for law in LAWS:
            for seed in SEEDS:
                yield _case("nominal", scenario, law, str(seed), f"seed={seed}")
    rng = np.random.default_rng(PLANT_SEED)
    for i in range(plants):
        plant_settings = (f"seed={NOISE_SEED + i}", *random_plant(rng))
        for law in ON_PLANTS:
            for scenario in CORE:
                first, window_s = SHORTER.get(scenario, ((), None))
                yield _case(
                    "plants", scenario, law, str(i), *first, *plant_settings, window_s=window_s
                )


def figures(results: Sequence[CaseResult], group: str, metric: str) -> Figures:
    """Return a metric of a group of results, (labels,), by (scenario, law)."""
    return {
        names: np.array([np.inf if run.failed else run.metric(metric) for run in runs])
        for names, runs in grouped(of_group(results, group), rig_name, controller_of).items()
    }


def mean(values: Array) -> float:
    """Return the geometric mean of values (n,)."""
    return float(np.exp(np.mean(np.log(values))))


def interval(ratio: Array) -> tuple[float, float, float]:
    """Return the geometric mean of ratios (n,) and its 95 % interval; infinite ones: nan."""
    from scipy.stats import bootstrap

    logs = np.log(ratio)
    if not np.isfinite(logs).all() or np.ptp(logs) == 0.0:
        return float(np.exp(logs.mean())), float("nan"), float("nan")
    found = bootstrap((logs,), np.mean, n_resamples=4000, rng=np.random.default_rng(1))
    low, high = found.confidence_interval
    return float(np.exp(logs.mean())), float(np.exp(low)), float(np.exp(high))


def mean_ratio(ratio: Array) -> str:
    """Return the mean of ratios (n,) with its interval."""
    return "{:.3g} ({:.3g} to {:.3g})".format(*interval(ratio))


def report(results: Sequence[CaseResult], margins: Mapping[str, float]) -> str:
    """Return all tables."""
    rms, step = figures(results, "nominal", RMS), figures(results, "nominal", STEP)
    parts = [
        f"Nominal barrel, muzzle error rms in mrad, geometric mean of noise seeds {SEEDS[0]} to "
        f"{SEEDS[-1]};\nlargest step of the command, rms in N m, over the scenarios without fire, "
        "step and bang; disk margin.\n",
        _nominal(rms, step, margins),
        _best(rms),
    ]
    on_plants = figures(results, "plants", RMS)
    count = len(on_plants[CORE[0], "pd"])
    parts += [
        f"{count} random plants: median and largest rms in mrad; geometric means of the ratio to\n"
        f"{REFERENCE} and to {NETWORK} on the same plant with 95 % intervals, and on how many "
        "plants\nthe law is the better one.\n",
        _on_plants(on_plants, count),
        f"The same plants by their friction relative to nominal: ratio to {NETWORK}.\n",
        _by_friction(on_plants, frictions(results)),
    ]  # fmt: skip
    return "\n".join(parts)


def _nominal(rms: Figures, step: Figures, margins: Mapping[str, float]) -> str:
    best = {s: min(LAWS, key=lambda law: mean(rms[s, law])) for s in SCENARIOS}
    rows = []
    for law in LAWS:
        cells = [f"{mean(rms[s, law]):.3g}" for s in SCENARIOS]
        cells = [f"**{c}**" if best[s] == law else c for s, c in zip(SCENARIOS, cells, strict=True)]
        quiet = [s for s in SCENARIOS if not s.startswith(("fire", "step", "bang"))]
        moved = max(float(step[s, law].max()) for s in quiet)
        rows.append([law, *cells, f"{moved:.2g}", f"{margins[law]:.2f}"])
    return markdown(("", *SCENARIOS, "step", "margin"), rows)


def _best(rms: Figures) -> str:
    rows = []
    for s in SCENARIOS:
        classic, net = (
            min(laws, key=lambda law: mean(rms[s, law])) for laws in (WITHOUT, NETWORKS)
        )
        ratio = rms[s, net] / rms[s, classic]
        rows.append([s, f"{classic} {mean(rms[s, classic]):.3g}", f"{net} {mean(rms[s, net]):.3g}",
                     mean_ratio(ratio), mean_ratio(rms[s, NETWORK] / rms[s, classic])])  # fmt: skip
    head = ("scenario", "best without a network", "best with one", "ratio", f"ratio of {NETWORK}")
    return markdown(head, rows)


def _on_plants(rms: Figures, count: int) -> str:
    rows = []
    for s in CORE:
        for law in ON_PLANTS:
            law_rms = rms[s, law]
            row = [s, law, f"{np.median(law_rms):.3g}, {law_rms.max():.3g}"]
            for other in (REFERENCE, NETWORK):
                wins = int((law_rms < rms[s, other]).sum())
                row += (
                    ["", ""] if law == other else [mean_ratio(law_rms / rms[s, other]), str(wins)]
                )
            rows.append(row)
    head = ("", "law", "rms", f"to {REFERENCE}", f"better of {count}", f"to {NETWORK}", "better")
    return markdown(head, rows)


def frictions(results: Sequence[CaseResult]) -> Array:
    """Return the friction of each random plant relative to nominal, (plants,)."""
    ratios = {
        r.case.label: float(text.partition("=")[2]) / NOMINAL["coulomb_Nm"]
        for r in results
        if r.case.group == "plants"
        for text in r.case.settings
        if text.startswith("barrel.coulomb_Nm=")
    }
    return np.array(list(ratios.values()))


def _by_friction(rms: Figures, friction: Array) -> str:
    rows = []
    for s in CORE:
        for law in ON_PLANTS:
            if law == NETWORK:
                continue
            ratio = rms[s, law] / rms[s, NETWORK]
            cells = []
            for _, low, high in THIRDS:
                some = ratio[(friction >= low) & (friction < high)]
                cells.append(mean_ratio(some) if len(some) > 2 else "")
            rows.append([s, law, *cells])
    return markdown(("", "law", *(name for name, _, _ in THIRDS)), rows)


def draw(results: Sequence[CaseResult], path: Path) -> None:
    """Draw the error on each random plant over its friction, and the medians of six bins."""
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    rms, friction = figures(results, "plants", RMS), frictions(results)
    figure, axes = sheet((12.0, 4.8), 110, 1, len(CORE))
    edges = np.geomspace(0.5, 2.0, 7)
    for ax, scenario in zip(axes, CORE, strict=True):
        for law, colour in DRAWN.items():
            law_rms = rms[scenario, law]
            ax.plot(friction, law_rms, ".", color=colour, markersize=3, alpha=0.35)
            bins = [(friction >= a) & (friction < b) for a, b in pairwise(edges)]
            middle = np.sqrt(edges[1:] * edges[:-1])
            medians = [np.median(law_rms[one]) if one.any() else np.nan for one in bins]
            ax.plot(middle, medians, "o-", color=colour, linewidth=1.6, markersize=4, label=law)
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xticks((0.5, 0.7, 1.0, 1.4, 2.0))
        ax.set_yticks((0.2, 0.5, 1.0, 2.0, 4.0))
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_formatter(ScalarFormatter())
            axis.set_minor_formatter(NullFormatter())
        ax.set_ylim(0.15, 4.5)
        ax.set_xlabel("friction relative to nominal")
        ax.set_title(scenario, fontsize=10)
        ax.grid(alpha=0.3, which="both")
    axes[0].set_ylabel("muzzle error rms [mrad]")
    what = "dot: a plant; line: median of the plants in a sixth of the axis"
    legend_below(figure, axes[0], 5)
    save(figure, path, f"{len(DRAWN)} of {len(ON_PLANTS)} laws; {what}", 10)
