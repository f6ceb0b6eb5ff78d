"""The vocabulary of an evaluation.py, which judges and draws a run.

    from pcpc.plants.evaluation import *    # the vocabulary, `__all__` below

    EVALUATION = Evaluation(
        signals={"error_rad": lambda run: run["executive:reference.q_d"] - run["plant:arm.q_rad"]},
        merits={"error_rms_rad": Rms("error_rad"), "error_max_rad": Peak("error_rad", RUN)},
        panels=(Panel("error [rad]", (Line("error_rad", "q_d - q", BLUE),)),),
        notes=(("error rms {error_rms_rad:.4f} rad",), ()),
    )

signals   functions of a `Run` that return a value a cycle, (n,), NaN where unknown. A value may
          depend on its own and the neighbouring cycles only, because a long run is evaluated in
          stretches. Signals may use each other: run["error_rad"]
merits    statistics over a window, of a signal, of a recorded variable `NODE:NAME` (`NAME` alone:
          the executive's, or that of the node that has it), or of a function like a signal;
          or functions of a `Judged` run. Figures that are NaN are left out
panels    axes with lines of such sources
notes     parts of the two lines under the title, with figures by name, or functions of the
          figures; a part with an unknown figure is left out
numbers   what the rig may give under `evaluation` besides `window_s` and further windows
          NAME_from_s, NAME_to_s (default: the end); found in run.numbers and run.windows

A variable that only some controllers have is NaN for the others, in a string and in run.get(...);
run[...] requires it. `pcpc check` tries the evaluation on made-up runs and refuses a string that
names a variable of no controller of the rig.
"""

import math
import re
import string
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pcpc.executive.errors import did_you_mean
from pcpc.executive.log import names
from pcpc.executive.log.reader import NODES, Log
from pcpc.plants import pages
from pcpc.plants import statistics as of
from pcpc.plants.judging import (
    EACH,
    LATE,
    RUN,
    WINDOW,
    DeclarationError,
    Judged,
    Merit,
    Place,
    Run,
    Signal,
    Source,
    Vector,
    declared_at,
)
from pcpc.plants.pages import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    Level,
    Line,
    Panel,
)

__all__ = [  # the vocabulary of an evaluation.py, which takes it whole: `import *`
    "BLACK", "BLUE", "EACH", "GREEN", "GREY", "LATE", "ORANGE", "PURPLE", "RUN", "SKY", "VERMILION",
    "WINDOW", "Correlation", "Count", "Deviation", "Evaluation", "Figures", "Highest", "Judged",
    "Last", "Level", "Line", "Lowest", "Mean", "Median", "Merit", "Panel", "Peak", "Rms", "Run",
    "Signal", "Source", "Total", "Vector", "diverged", "settling", "started",
]  # fmt: skip

Rms, Peak, Mean, Median = (partial(Merit, s) for s in (of.RMS, of.PEAK, of.MEAN, of.MEDIAN))
Lowest, Highest, Last = (partial(Merit, s) for s in (of.LOW, of.HIGH, of.LAST))
Total, Count, Deviation = (partial(Merit, s) for s in (of.SUM, of.COUNT, of.STD))
Correlation = partial(Merit, of.CORRELATION)  # of a source (n, 2)

Figures = Mapping[str, float]
Note = str | Callable[[Figures], str]
_WINDOW = re.compile("_(from|to)_s$")
NOTE_LINES = 2  # under the title
STARTED_S = 0.5  # the start would hide the rest in a panel


def diverged(metrics: Figures) -> str:
    """Return the note of a run that its controller ended."""
    return "diverged: control ended" if metrics.get("diverged") else ""


def started(source: Source) -> Signal:
    """Return a source (n,) that is NaN before 0.5 s."""
    return lambda run: np.where(run.t_s < STARTED_S, math.nan, run.values(source))


def settling(source: Source, bound: float, over: str = RUN, needs: str = "") -> Merit:
    """Return the time from the window's begin until |source| stays within `bound`; inf for never.

    Only cycles with a record of the plant count; a value that is not finite is outside.
    `source`: (n,).
    """

    def ends(run: Run) -> Vector:
        begin_s = max(run.windows[over][0], 0.0)
        seen_s = np.where(run.plant_told, run.t_s + run.period_s - begin_s, math.nan)
        return np.column_stack((seen_s, ~(np.abs(run.values(source)) <= bound)))

    return Merit(of.SETTLING, ends, over, needs=needs)


@dataclass(frozen=True)
class Evaluation:
    """What an evaluation.py declares; Mistake, with its place, for what cannot be."""

    signals: Mapping[str, Signal] = field(default_factory=dict)
    merits: Mapping[str, Merit | Callable[[Judged], float]] = field(default_factory=dict)
    panels: Sequence[Panel] = ()
    notes: tuple[Sequence[Note], Sequence[Note]] = ((), ())
    numbers: Sequence[str] = ()
    place: Place = field(default_factory=declared_at, init=False, compare=False)

    def __post_init__(self) -> None:
        for name, signal in self.signals.items():
            if not callable(signal):
                raise DeclarationError(f"signal {name} is no function of a run", self.place)
        for name, merit in self.merits.items():
            if not callable(merit) and not isinstance(merit, Merit):
                raise DeclarationError(
                    f"merit {name} is neither Rms(...) or the like nor a function", self.place
                )
        self._check_shapes()
        for source, place in self._sources():
            node, colon, _ = source.partition(":")
            variable = node in NODES if colon else "." in source
            if source not in self.signals and not variable:
                names = [*self.signals, *(f"{node}:" for node in NODES)]
                raise DeclarationError(f"no signal {source}{did_you_mean(source, names)}", place)
        each = [name for name, merit in self.merits.items() if _window_of(merit) == EACH]
        for part in (part for line in self.notes for part in line if isinstance(part, str)):
            for name in _fields(part, self.place):
                if name not in self.merits and not name.endswith(tuple(f"_{e}" for e in each)):
                    raise DeclarationError(
                        f"notes: no merit {name}{did_you_mean(name, self.merits)}", self.place
                    )

    def _check_shapes(self) -> None:
        """Refuse panels and notes that are not what their type says."""
        for one in _sequence("panels", self.panels, Panel, self.place):
            _sequence(f"panel {one.label!r}: lines", one.lines, Line, one.place)
            _sequence(f"panel {one.label!r}: levels", one.levels, Level, one.place)
        rows = self.notes if isinstance(self.notes, tuple | list) else ()
        if len(rows) != NOTE_LINES or any(isinstance(row, str) for row in rows):
            what = 'expected two rows, (("one {a:.3g}", "another"), ())'
            raise DeclarationError(f"notes: {what}; got {_short(self.notes)}", self.place)

    def _sources(self) -> Iterator[tuple[str, Place]]:
        """Yield the names that merits and lines are taken from, and where that is said."""
        lines = [line for panel in self.panels for line in panel.lines]
        for one in (*self.merits.values(), *lines):
            if not callable(one) and isinstance(one.source, str):
                yield one.source, one.place

    def judge(
        self,
        log: Log,
        window_s: tuple[float, float],
        numbers: Mapping[str, float],
        period_s: float,
    ) -> dict[str, float]:
        """Return the figures of a run; {} without a cycle in the window."""
        return self.figures(self.judged(log, window_s, numbers, period_s))

    def figures(self, judged: Judged) -> dict[str, float]:
        """Return the figures of a run; {} without a cycle in the window."""
        merits = self.taken(judged.numbers)
        figures: dict[str, float] = {}
        for leader in dict.fromkeys(m.leader for m in merits.values() if isinstance(m, Merit)):
            own = {n: m for n, m in merits.items() if isinstance(m, Merit) and m.leader == leader}
            figures |= judged.measured(own, leader)
        figures |= {n: m(judged) for n, m in merits.items() if not isinstance(m, Merit)}
        return {name: float(figures[name]) for name in merits if not math.isnan(figures[name])}

    def judged(
        self,
        log: Log,
        window_s: tuple[float, float],
        numbers: Mapping[str, float],
        period_s: float,
    ) -> Judged:
        """Return a run with its windows."""
        windows = {WINDOW: window_s, RUN: (-math.inf, math.inf), LATE: (window_s[1], math.inf)}
        for name in further(numbers):
            windows[name] = (numbers[f"{name}_from_s"], numbers.get(f"{name}_to_s", math.inf))
        return Judged(log, period_s, windows, numbers, self.signals)

    def taken(self, numbers: Mapping[str, float]) -> dict[str, Merit | Callable[[Judged], float]]:
        """Return the figures of merit that the rig's windows and numbers ask for."""
        known_names = {*further(numbers), *numbers, WINDOW, RUN, LATE, ""}
        taken_merits: dict[str, Merit | Callable[[Judged], float]] = {}
        for name, merit in self.merits.items():
            if not isinstance(merit, Merit):
                taken_merits[name] = merit
            elif merit.over == EACH:
                taken_merits[name] = replace(merit, over=WINDOW)
                parts = further(numbers)
                taken_merits |= {f"{part}_{name}": replace(merit, over=part) for part in parts}
            elif merit.over in known_names and merit.needs in known_names:
                taken_merits[name] = merit
        return taken_merits

    def non_finite(self, judged: Judged, name: str) -> str:
        """Return which recorded value of a figure is no finite number; "" for none."""
        merit = self.taken(judged.numbers).get(name)
        return judged.non_finite(merit) if isinstance(merit, Merit) else ""

    def names(self, numbers: Mapping[str, float]) -> list[str]:
        """Return the names of all figures that a run may have."""
        return list(self.taken(numbers))

    def unknown(self, numbers: Mapping[str, float]) -> Iterator[tuple[str, str]]:
        """Yield the numbers of a rig that nothing here asks for, each with a cure."""
        used = {_window_of(merit) for merit in self.merits.values()} - {"", WINDOW, RUN, LATE}
        used |= {m.needs for m in self.merits.values() if isinstance(m, Merit)} - {""}
        windows = [f"{name}_{end}_s" for name in sorted(used) for end in ("from", "to")]
        known = [
            *self.numbers,
            *windows,
            *(n for n in numbers if EACH in used and _WINDOW.search(n)),
        ]
        for name in numbers:
            begin = _WINDOW.sub("_from_s", name)
            if name not in known:
                yield name, did_you_mean(name, known)
            elif begin not in (name, *numbers) and name not in self.numbers:
                yield name, f" without {begin}"

    def draw(
        self,
        log: Log,
        path: Path | None,
        title: str,
        metrics: Figures,
        window_s: tuple[float, float],
        numbers: Mapping[str, float] | None = None,
        violations: Sequence[tuple[float, str]] = (),
    ) -> None:
        """Write one PNG, 1200 x 1500 pixels.

        ImportError without matplotlib, with the cure; Mistake for a line that cannot be drawn.
        """
        period_s = 1e-9 * float(log.metadata.get("executive", {}).get("period_ns", 1e9))
        judged = self.judged(log, window_s, numbers or {}, period_s)
        text = [[], [f"shaded {window_s[0]:g} to {window_s[1]:g} s"]]
        for line, parts in zip(text, self.notes, strict=True):
            line += [told for part in parts if (told := self._told(part, metrics))]
        words = "\n".join("   ·   ".join(line) for line in text)
        pages.draw_page(judged, path, title, words, self.panels, violations)

    def _told(self, part: Note, metrics: Figures) -> str:
        if callable(part):
            return part(metrics)
        names = list(_fields(part, self.place))
        if not all(name in metrics for name in names):
            return ""
        endless = [f"{name} is infinite" for name in names if math.isinf(metrics[name])]
        return ", ".join(endless) or part.format(**metrics)

    def touch(self, run: Run) -> None:
        """Ask a run for all that the panels draw."""
        for line in (line for panel in self.panels for line in panel.lines):
            run.values(line.source)

    def absent(self, log: Log) -> Iterator[tuple[str, str]]:
        """Yield the variables that a string names and no records have, each with what to say."""
        for source, place in self._sources():
            node, colon, _ = source.partition(":")
            told = node in log.node if colon else "plant" in log.node
            if told and source not in self.signals and names.find_variable(log, source) is None:
                yield (
                    source,
                    str(DeclarationError(names.unknown_name(log, source, self.signals), place)),
                )


def further(numbers: Mapping[str, float]) -> list[str]:
    """Return the names of the further windows of a rig."""
    return [key.removesuffix("_from_s") for key in numbers if key.endswith("_from_s")]


def _sequence(label: str, value: Any, kind: type, place: Place) -> Any:
    """Return `value` if it is a sequence of `kind`; Mistake with the cure."""
    name = kind.__name__
    if isinstance(value, kind):
        raise DeclarationError(
            f"{label}: a comma is missing behind the only {name}: ({name}(...),)", place
        )
    if not isinstance(value, tuple | list) or not all(isinstance(one, kind) for one in value):
        raise DeclarationError(f"{label}: expected ({name}(...), ...), got {_short(value)}", place)
    return value


def _short(given: object) -> str:
    return textwrap.shorten(repr(given), 60, placeholder=" ...")


def _window_of(merit: object) -> str:
    return merit.over if isinstance(merit, Merit) else ""


def _fields(text: str, place: Place) -> list[str]:
    """Return the names of the figures in a note."""
    try:
        names = [name for _, name, _, _ in string.Formatter().parse(text) if name]
        text.format(**dict.fromkeys(names, 1.0))
    except (ValueError, LookupError, AttributeError) as error:
        raise DeclarationError(f"notes: {text!r}: {error}", place) from None
    return names
