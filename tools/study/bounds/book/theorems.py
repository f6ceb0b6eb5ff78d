"""`pcpc experiment theorems`: every shipped rig and law against its theorem, tuned and mistuned.

Each rig of the project whose controller has a theorem is run in virtual time as it is, and with the
tuning rates of its law at 0, at -1 and at 100 times what they are: results.md, results.csv, a
figure of what is not explained, and V, V', error and weights of one rig a plant.
"""

import csv
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from pcpc import plants
from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.lyapunov import UNEXPLAINED, Account
from pcpc.plants.pages import BLUE, GREEN, GREY, ORANGE, VERMILION
from pcpc.plants.study import markdown
from pcpc.plants.theorem import NoTheorem
from pcpc.tools.start.pool import each
from pcpc.tools.study.bounds import figure, text
from pcpc.tools.study.bounds.book._retuned import retuned_rig
from pcpc.tools.study.bounds.bounds import known_theorems, law_of, of_rig, theorem_of
from pcpc.tools.terminal.progress import Progress

PLANTS = Path(plants.__file__).resolve().parent
TUNINGS = {"as it is": 1.0, "dead": 0.0, "flipped": -1.0, "x100": 100.0}
COLOURS = dict(zip(TUNINGS, (BLUE, GREY, ORANGE, VERMILION), strict=True))
LEAST, MOST = 1e-3, 1e4  # percent that a figure shows
OFF = ("the network is on", "both networks are on", "the rules are on", "W, Wi, y, u are in use")
SHOWN = {  # a picture each: plant, rig, controller
    "friction_arm": ("friction-c", "nn_ramp"), "deadzone_arm": ("deadzone-sine", "nn"),
    "deadzone_map": ("fuzzy-d03", "fuzzy"), "map_chains": ("two-deadzones", "fuzzy"),
    "backlash_pendulum": ("backlash-pendulum", "nn"),
    "backlash_map": ("backlash-map", "nn"), "quarter_car": ("suspension-8", "fl"),
    "payload_arm": ("payload-on", "critic"), "telerobot": ("telerobot-u2", "rnn"),
    "atb1000": ("slew10", "pd_nn_fast"),
}  # fmt: skip


@dataclass(frozen=True)
class RunShares:
    """What one run came to; shares, not percent."""

    plant: str
    rig: str
    controller: str
    tuning: str
    theorem: str = ""
    unit: str = ""
    bound: float = math.nan
    largest: float = math.nan
    looseness: float = math.nan
    inequality_fails: float = math.nan
    unexplained: float = math.nan
    unnamed: float = math.nan
    violated: str = ""
    not_given: str = ""
    ended: str = ""  # why there is no account

    @property
    def off(self) -> bool:
        """Whether the controller has its network switched off: an ablation."""
        return any(name in self.violated.split("; ") for name in OFF)


def cases() -> list[tuple[str, str]]:
    """Return rig file and controller of everything shipped that has a theorem."""
    found = []
    for path in sorted(PLANTS.glob("*/rigs/*.yaml")):
        rig = load_rig(path)
        theorems = known_theorems(rig)
        for controller in rig.config.controllers:
            if law_of(rig, controller) in theorems:
                found.append((str(path), controller))
    return found


def rows_of(case: tuple[str, str]) -> list[RunShares]:
    """Return the rows of a rig and controller, none if the theorem is not one of this rig."""
    path, controller = Path(case[0]), case[1]
    found = []
    for tuning, factor in TUNINGS.items():
        about = path.parents[1].name, path.stem, controller, tuning
        rig = load_rig(path, controller)
        try:
            with np.errstate(all="ignore"):
                account = of_rig(retuned_rig(rig, theorem_of(rig), factor)).account
                found.append(row(about, account))
        except NoTheorem:
            return []
        except UserError as error:
            found.append(RunShares(*about, violated="the run ends early", ended=str(error)))
        if found[0].off:
            break
    return found


def row(about: tuple[str, str, str, str], account: Account) -> RunShares:
    """Return an account as a row."""
    proof = account.proof
    return RunShares(
        *about,
        theorem=proof.theorem,
        unit=proof.error_is,
        bound=account.own.error,
        largest=account.largest,
        looseness=text.loose(account),
        inequality_fails=float(account.failing.mean()),
        unexplained=account.unexplained,
        unnamed=account.unnamed,
        violated="; ".join(check.name for check in account.checks() if not check.holds),
        not_given="; ".join(one.what for one in proof.asked if not (one.needed or one.holds)),
    )


def run(folder: Path, progress: Progress, jobs: int | None) -> int:
    """Run everything; write results.md, results.csv and figures."""
    rows = [one for group in each(rows_of, cases(), progress, jobs) for one in group]
    with (folder / "results.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, list(asdict(rows[0])))
        table.writeheader()
        table.writerows(asdict(one) for one in rows)
    (folder / "results.md").write_text(report(rows))
    figures = folder / "figures"
    figures.mkdir()
    draw(rows, figures / "theorems.png")
    for plant, (rig, controller) in SHOWN.items():
        progress.show(f"theorems: drawing {plant}")
        account = of_rig(load_rig(PLANTS / plant / "rigs" / f"{rig}.yaml", controller)).account
        figure.draw(account, f"{rig}, {controller}", figures / f"{plant}.png")
    progress.close()
    return Exit.OK


def _percent(value: float) -> str:
    if not math.isfinite(value):
        return "all"
    return f"{100.0 * value:.2g}" if value < 10.0 else ">1000"


def _cell(words: str) -> str:
    return words.replace("|", "\\|")


def rows_by_run(rows: Sequence[RunShares]) -> dict[tuple[str, str, str], dict[str, RunShares]]:
    """Return the rows by plant, rig and controller, then by tuning, without ablations."""
    found: dict[tuple[str, str, str], dict[str, RunShares]] = {}
    for one in rows:
        if not one.off:
            found.setdefault((one.plant, one.rig, one.controller), {})[one.tuning] = one
    return {key: group for key, group in found.items() if "as it is" in group}


def report(rows: Sequence[RunShares]) -> str:
    """Return results.md."""
    runs, lines, wrong = rows_by_run(rows), [], []
    for (_, rig, controller), group in runs.items():
        own = group["as it is"]
        others = [_percent(group[name].unexplained) for name in list(TUNINGS)[1:]]
        lines.append((
            rig, controller, own.theorem, _cell(own.unit), f"{own.bound:.3g}", f"{own.largest:.3g}",
            f"{own.looseness:.3g}", _percent(own.inequality_fails), _percent(own.unexplained),
            _percent(own.unnamed), *others, "1" if own.violated else "0",
            _cell(own.not_given) or "all given",
        ))  # fmt: skip
        wrong += [
            f"- {rig}, {controller}: {name} violates nothing"
            for name in list(TUNINGS)[1:]
            if not group[name].violated
        ]
    off = sorted({f"{one.rig} {one.controller}" for one in rows if one.off})
    violated = [
        f"- {rig}, {controller}: {group['as it is'].violated}"
        for (_, rig, controller), group in runs.items()
        if group["as it is"].violated
    ]
    head = ("rig", "controller", "theorem", "error", "bound", "largest", "looseness",
            "inequality fails %", "not explained %", "without named causes %",
            "dead %", "flipped %", "x100 %", "exit", "not given")  # fmt: skip
    return "\n".join((
        "# Theorems on runs\n",
        f"{len(runs)} rigs and laws, each tuned as it is, dead, flipped, 100 times as fast; "
        f"{100.0 * UNEXPLAINED:.0f} % of what is dissipated may stay unexplained.\n",
        markdown(head, lines),
        "Violated as shipped:\n", *(violated or ["- nothing"]), "",
        "Mistuned, and nothing violated:\n", *(wrong or ["- none"]), "",
        f"With the network switched off, which violates: {', '.join(off) or 'none'}.\n",
    ))  # fmt: skip


def draw(rows: Sequence[RunShares], path: Path) -> None:
    """Draw what is not explained, a line a plant and controller with a dot a rig and tuning."""
    from matplotlib.figure import Figure

    groups: dict[tuple[str, str], list[dict[str, RunShares]]] = {}
    for (plant, _, controller), group in rows_by_run(rows).items():
        groups.setdefault((plant, controller), []).append(group)
    page = Figure(figsize=(9.0, 1.4 + 0.3 * len(groups)), layout="constrained")
    axis = page.subplots()
    for number, (name, colour) in enumerate(COLOURS.items()):
        points = [
            (100.0 * group[name].unexplained, at + 0.18 * (number - 1.5))
            for at, found in enumerate(groups.values())
            for group in found
        ]
        seen, places = zip(*points, strict=True)
        shown = np.clip(np.nan_to_num(seen, nan=MOST, posinf=MOST), LEAST, MOST)
        axis.scatter(shown, places, color=colour, s=22, alpha=0.75, linewidth=0, label=name)
    axis.axvline(100.0 * UNEXPLAINED, color=GREEN, linewidth=1.4, label="allowed")
    axis.set_xscale("log")
    axis.set_xlim(0.7 * LEAST, 1.6 * MOST)
    axis.set_yticks(range(len(groups)), [f"{plant}, {law}" for plant, law in groups], fontsize=8)
    axis.set_ylim(len(groups) - 0.4, -0.6)
    axis.grid(color="#E2E2E2", linewidth=0.5)
    axis.spines[["top", "right"]].set_visible(False)
    axis.set_xlabel(
        "V' of the run against V' of the proof: % of what is dissipated that is not explained\n"
        f"(at most {LEAST:g} on the left edge, at least {MOST:g} or no number on the right one)"
    )
    page.legend(frameon=False, loc="outside upper center", fontsize=9, ncols=5)
    page.savefig(path, dpi=110)
