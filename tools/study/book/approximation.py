"""`pcpc experiment approximation`: what the approximators of chapters 1 and 3 of the book can do.

    fit     sin(pi x1) cos(pi x2/2) + 0.3 x1 x2 on +-1 by least squares
    online  sin x sample by sample: backpropagation and Hebbian tuning
    jumps   functions with a jump: standard and augmented network, after the same training

Every table has the values of an independent implementation beside its own ("reference"). Writes
results.md and figures/; returns 1 if a limit of LIMITS is not met.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, as_completed
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.plants.study import markdown
from pcpc.tools.start.pool import workers
from pcpc.tools.study.book import _approximation_figures as figures
from pcpc.tools.study.book._approximation_training import (
    CASES,
    Array,
    Net,
    TrainedNet,
    online_fit,
    trained_net,
)
from pcpc.tools.study.book.approximators import jumps
from pcpc.tools.study.book.approximators.family import (
    Approximator,
    Cmac,
    Fuzzy,
    Grid,
    rbf_net,
    rvfl_net,
)
from pcpc.tools.terminal.progress import Progress

SIZES = (5, 7, 11)
FIT_TRAIN = np.linspace(-1.0, 1.0, 31)  # both grids were searched for, see FIT_TEXT
FIT_TEST = np.linspace(-0.97, 0.97, 40)
RVFL_SEEDS = range(20)
SEEDS = (0, 1, 2)

FIT_REFERENCE = {
    "RBF": ("0.081", "0.053", "0.038"),
    "CMAC, triangles": ("0.055", "0.024", "0.0074"),
    "CMAC, splines of order 4": ("0.048", "0.0058", "0.0002"),
    "fuzzy, Gaussian": ("0.064", "0.034", "0.018"),
    "RVFL": ("0.036", "0.0030", "< 0.00005"),
}
ONLINE_REFERENCE = {"backpropagation": ("0.698", "0.091", ""), "Hebbian": ("0.698", "0.354", "308")}
JUMP_REFERENCE = {  # train rms, test rms, test max; each standard, augmented
    "sin1d": (0.0594, 0.0080, 0.0627, 0.0081, 0.566, 0.040),
    "sin1d, nodes at 0": (np.nan, np.nan, np.nan, 0.0619, np.nan, 0.563),
    "lin1d": (0.0612, 0.0081, 0.0654, 0.0081, 0.585, 0.029),
    "lin2d": (0.0790, 0.0138, 0.1238, 0.0133, 0.739, 0.071),
    "quad2d": (0.0764, 0.0146, 0.1248, 0.0155, 0.746, 0.078),
    "varjump2d": (0.1127, 0.1005, 0.193, 0.147, 2.14, 1.45),
}
BASIS_SEEDS = (0, 1)  # found by comparing with the reference, which names none
BASIS_REFERENCE = {("sin1d", "tanh"): 0.0093, ("sin1d", "polynomial"): 0.0088,
                   ("lin2d", "tanh"): 0.0132, ("lin2d", "polynomial"): 0.0133}  # fmt: skip
LIMITS = {  # of the ratio of test rms, standard to augmented: a tenth of the error is the claim
    "sin1d": (5.0, np.inf),
    "lin1d": (5.0, np.inf),
    "lin2d": (5.0, np.inf),
    "quad2d": (5.0, np.inf),
    "sin1d, nodes at 0": (0.8, 1.2),  # in the wrong place they do nothing
    "varjump2d": (1.0, 2.0),  # two nodes make one height only
}


def target(x: Array) -> Array:
    """Return the function of the least-squares fit at x (points, 2)."""
    product = np.sin(np.pi * x[:, 0]) * np.cos(np.pi * x[:, 1] / 2.0)
    return np.asarray(product + 0.3 * x[:, 0] * x[:, 1])


def fit_rms(net: Approximator) -> float:
    """Fit W to `target` by least squares, return the rms error on the test grid."""
    train, test = _square(FIT_TRAIN), _square(FIT_TEST)
    phi = np.array([net.hidden(x)[0] for x in train])
    w, _ = net.weights()
    w[:, 0] = np.linalg.lstsq(phi, target(train), rcond=None)[0]
    y = np.array([net.eval(x)[0] for x in test])
    return float(np.sqrt(np.mean((y - target(test)) ** 2)))


def fit_nets(n: int) -> Iterator[tuple[str, Approximator]]:
    """Yield a net of n x n nodes of each kind; RVFL once a seed."""
    grid = Grid((-1.0, -1.0), (1.0, 1.0), (n, n))
    yield "RBF", rbf_net(grid, 1)
    yield "CMAC, triangles", Cmac(grid, 1)
    yield "CMAC, splines of order 4", Cmac(grid, 1, order=4)
    yield "fuzzy, Gaussian", Fuzzy(grid, 1)
    for seed in RVFL_SEEDS:
        yield "RVFL", rvfl_net(grid.low, grid.high, n * n, 1, seed)


def fit_errors(n: int) -> dict[str, list[float]]:
    """Return the rms errors of `fit_nets`, by kind."""
    errors: dict[str, list[float]] = {}
    for kind, net in fit_nets(n):
        errors.setdefault(kind, []).append(fit_rms(net))
    return errors


def nets() -> list[Net]:
    """Return the nets to train, the slow ones first."""
    found = []
    for seed in SEEDS:
        for name, case in reversed(CASES.items()):
            found += [Net(name, seed), Net(name, seed, jumps.SIGMOID, case.c)]
        for name in ("lin2d", "sin1d"):
            for kind in (jumps.TANH, jumps.POLYNOMIAL):
                found.append(Net(name, seed, kind, CASES[name].c))
        found.append(Net("sin1d", seed, jumps.SIGMOID, 0.0))
        found += [Net("sin1d", seed, trainer="lm"), Net("sin1d", seed, 1, -1.0, trainer="lm")]
    return found


def chosen_nets(
    done: Sequence[TrainedNet], row: str, jump: int | None, trainer: str = "batch"
) -> list[TrainedNet]:
    """Return the trained nets, one a seed, of a row of the table."""
    name, _, elsewhere = row.partition(", nodes at ")
    c = float(elsewhere or CASES[name].c) if jump is not None else 0.0
    wanted = [Net(name, seed, jump, c, trainer) for seed in SEEDS]
    return [result for net in wanted for result in done if result.net == net]


def medians(results: Sequence[TrainedNet]) -> tuple[float, float, float, float]:
    """Return the medians over the seeds of train rms, test rms, largest, rms away from the jump."""
    rows = [(r.train, r.test, r.largest, r.far) for r in results]
    train, test, largest, far = np.median(np.array(rows), axis=0)
    return float(train), float(test), float(largest), float(far)


def run(folder: Path, progress: Progress, jobs: int | None) -> int:
    """Run everything on `jobs` processes (all processors), write results.md and figures/."""
    todo = nets()
    done: list[TrainedNet] = []
    fits: dict[int, dict[str, list[float]]] = {}
    with workers(jobs) as pool:
        fitting = {pool.submit(fit_errors, n): n for n in reversed(SIZES)}
        training = [pool.submit(trained_net, net) for net in todo]
        every: list[Future[Any]] = [*fitting, *training]
        for count, future in enumerate(as_completed(every), 1):
            progress.show(f"approximation: {count}/{len(every)} nets and fits")
            if future in fitting:
                fits[fitting[future]] = future.result()
        done = [future.result() for future in training]
    progress.close()
    progress.say("tables and figures: approximation")
    jump_table, missed = jump_report(done)
    parts = ("# Approximators\n", fit_report(fits), online_report(), jump_table)
    (folder / "results.md").write_text("\n".join((*parts, basis_report(done), lm_report(done))))
    (folder / "figures").mkdir()
    figures.draw(folder / "figures", done, fits)
    for line in missed:
        progress.say(line)
    return 1 if missed else 0


FIT_TEXT = """## Least-squares fit on a grid

sin(pi x1) cos(pi x2/2) + 0.3 x1 x2 on [-1, 1]^2; W by least squares on 31 x 31 points, rms error
on 40 x 40 points over +-0.97. The reference does not name its grids: these were found by a search
over some hundred thousand pairs. No pair gives all twelve values; about twenty give eleven, and of
those this one misses by least: RBF 7 x 7 is 0.05248, which rounds to 0.052, not to 0.053. So the
last digits agree by selection, the first by computation. RVFL with n^2 nodes: median of 20 seeds
(smallest, largest); the reference is one unknown draw.
"""
ONLINE_TEXT = """## On-line fit

sin x on [-pi, pi], 10 nodes, V ~ U(-2, 2), seed 1, W = 0, 20,000 uniform samples; rms on 41 points.
eta = 0.05 for backpropagation, 0.005 for Hebbian tuning. The Hebbian first layer never sees the
error: |V| grows as long as the tuning goes on; a leak or a limit bounds it and teaches it nothing.
The order of the draws (V, then samples; one of eight tried) and the 41 points are those that gave
the reference.
"""
JUMP_TEXT = """## Functions with a jump

Standard network and the same network with the jump nodes k = 0, 1 of the sigmoid basis, both after
10,000 epochs from the same first weights; medians of seeds 0, 1, 2. Own value, in brackets the
reference. "ratio" is standard to augmented on the test grid, "far" the same ratio more than two
cells of the training grid away from the jump. The order of the random draws, which the reference
does not name, is the one of four tried that gave its 1-D values; the 2-D values then agreed.
"""


def fit_report(fits: dict[int, dict[str, list[float]]]) -> str:
    """Return the table of the least-squares fits."""
    rows = []
    for kind, reference in FIT_REFERENCE.items():
        row = [kind]
        for n, other in zip(SIZES, reference, strict=True):
            values = fits[n][kind]
            text = f"{np.median(values):.2g}" if kind == "RVFL" else f"{values[0]:.4f}"
            spread = f", {min(values):.2g} to {max(values):.2g}" if len(values) > 1 else ""
            row.append(f"{text}{spread} [{other}]")
        rows.append(row)
    head = ("rms error [reference]", *(f"{n} x {n}" for n in SIZES))
    return f"{FIT_TEXT}\n{markdown(head, rows)}"


def online_report() -> str:
    """Return the table of the on-line fits."""
    fits = {
        "backpropagation": online_fit(0.05, False),
        "Hebbian": online_fit(0.005, True),
        "Hebbian, leak 0.1": online_fit(0.005, True, leak=0.1),
        "Hebbian, norm limit 20": online_fit(0.005, True, limit=20.0),
    }
    rows = []
    for kind, values in fits.items():
        others = ONLINE_REFERENCE.get(kind, ("", "", ""))
        texts = (f"{values[0]:.3f}", f"{values[1]:.3f}", f"{values[2]:.0f}")
        cells = (
            f"{text} [{other}]" if other else text
            for text, other in zip(texts, others, strict=True)
        )
        rows.append((kind, *cells))
    return (
        f"{ONLINE_TEXT}\n{markdown(('tuning', 'rms before', 'rms after', 'norm of V after'), rows)}"
    )


def jump_report(done: Sequence[TrainedNet]) -> tuple[str, list[str]]:
    """Return the table of the jump functions, and a line for each limit missed."""
    rows, missed = [], []
    for row, reference in JUMP_REFERENCE.items():
        standard = medians(chosen_nets(done, row, None))
        augmented = medians(chosen_nets(done, row, jumps.SIGMOID))
        cells = [row]
        for i, form in enumerate((".4f", ".4f", ".3f")):
            for value, other in ((standard, reference[2 * i]), (augmented, reference[2 * i + 1])):
                cells.append(f"{value[i]:{form}}" + ("" if np.isnan(other) else f" [{other:.4g}]"))
        ratio, far = standard[1] / augmented[1], standard[3] / augmented[3]
        low, high = LIMITS[row]
        if not low <= ratio <= high:
            missed.append(f"{row}: ratio of test rms {ratio:.2f}, expected {low} to {high}")
        rows.append((*cells, f"{ratio:.1f}", f"{far:.1f}"))
    head = ("case", "train rms, standard", "augmented", "test rms, standard", "augmented",
            "test max, standard", "augmented", "ratio", "far")  # fmt: skip
    functions = "".join(f"- {name}: {case.title}\n" for name, case in CASES.items())
    return f"{JUMP_TEXT}\n{functions}\n{markdown(head, rows)}", missed


def basis_report(done: Sequence[TrainedNet]) -> str:
    """Return the table of other jump bases."""
    rows = []
    for (name, basis), reference in BASIS_REFERENCE.items():
        results = chosen_nets(done, name, jumps.NAMES.index(basis))
        two = [result for result in results if result.net.seed in BASIS_SEEDS]
        own, fitting = medians(results)[1], medians(two)[1]
        rows.append((name, basis, f"{own:.4f} [{reference:.4f}]", f"{fitting:.4f}"))
    head = ("case", "basis", "test rms, seeds 0, 1, 2", "seeds 0, 1")
    text = (
        "Other bases for the jump nodes. The reference gives no seeds for this table; medians of\n"
        "seeds 0 and 1 equal it, those of all three do not for sin1d, where a seed is worth a\n"
        "factor of two.\n"
    )
    return f"{text}\n{markdown(head, rows)}"


def lm_report(done: Sequence[TrainedNet]) -> str:
    """Return the table of the other trainer."""
    rows = []
    for label, jump in (("standard", None), ("augmented", jumps.SIGMOID)):
        train, test, largest, _ = medians(chosen_nets(done, "sin1d", jump, "lm"))
        rows.append((label, f"{train:.1e}", f"{test:.1e}", f"{largest:.2g}"))
    text = (
        "The trainer matters as much as the net. 100 Levenberg-Marquardt steps on sin1d let the\n"
        "standard net hide a steep sigmoid between two training points: its training error\n"
        "vanishes and its test error does not. Judge on an offset grid.\n"
    )
    return f"{text}\n{markdown(('sin1d', 'train rms', 'test rms', 'test max'), rows)}"


def _square(line: Array) -> Array:
    """Return the points (n^2, 2) of a square grid."""
    axes = np.meshgrid(line, line, indexing="ij")
    return np.stack([axis.ravel() for axis in axes], axis=1)
