"""Judging a run: the rig's evaluation, what the rig expects, and what could not be judged.

One rule for values set on the command line and for live tunings: the limits of the rig are judged
whatever was changed, and what was changed is named. Only where the change leaves nothing to judge
by (another window, a run that ends before the window does) are limits left out, and named with the
reason. An evaluation that fails costs its metrics and the verdict, never the rest of the summary.
"""

import errno
import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pcpc.executive.errors import FULL, RigError, did_you_mean
from pcpc.executive.log.long_logs import Columns
from pcpc.executive.log.reader import Log
from pcpc.executive.own_laws.law_errors import cause
from pcpc.executive.own_laws.modules import module_of, own_streams
from pcpc.executive.rig import schema
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.requirements import RequirementError, text_of
from pcpc.plants.evaluation import Evaluation
from pcpc.plants.judging import DeclarationError, Judged
from pcpc.tools.after.trust import words_of
from pcpc.tools.after.verdict.findings import Finding, FindingKind, lines
from pcpc.tools.after.verdict.imagined_logs import imagined_log, large, noise, nothing
from pcpc.tools.after.verdict.masters import counters
from pcpc.tools.after.verdict.requirements import (
    Bound,
    JudgedRequirement,
    SignalNames,
    bound_requirements,
    results,
)
from pcpc.tools.after.verdict.timing import TIMING_COLUMNS
from pcpc.tools.terminal import screen

_NONE = schema.Evaluation(file="", window_s=(-math.inf, math.inf))  # of a rig that names none
_TITLED, _LONGEST = 2, 36  # settings in the figure's title, and letters of one
Made = TypeVar("Made")


class EvaluationError(RigError):
    """The rig's evaluation file failed: where and why, in one line."""


@dataclass
class Judgement:
    """What became of what the rig expects, and all metrics."""

    metrics: dict[str, float] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    requirements: list[JudgedRequirement] = field(default_factory=list)


@dataclass(frozen=True)
class Judge:
    """A rig and its evaluation, an empty one if the rig names none."""

    rig: Rig
    evaluation: Evaluation = field(default_factory=Evaluation)

    @classmethod
    def of(cls, rig: Rig) -> "Judge":
        """Load the rig's evaluation, if it names one; RigError for what is wrong with it."""
        if rig.evaluation is None:
            return cls(rig)
        file = Path(rig.evaluation.file)
        judge = cls(rig, guarded(lambda: _loaded_evaluation(file)))
        for name, what in judge.unused().items():
            if rig.document.place(("evaluation", name)).option:
                raise rig.error(f"evaluation.{name}", what)
        return judge

    @property
    def given(self) -> schema.Evaluation:
        """What the rig says of its evaluation."""
        return self.rig.evaluation or _NONE

    def unused(self) -> dict[str, str]:
        """Return the rig's numbers that nothing in its evaluation asks for, and what to say."""
        what = f"nothing in {self.given.file} asks for it"
        return {name: what + cure for name, cure in self.evaluation.unknown(self.given.numbers)}

    def metrics(self, log: Log, window_s: tuple[float, float] | None = None) -> dict[str, float]:
        """Return the metrics of a run; {} if the rig names no evaluation. EvaluationError.

        `window_s`: another window than the rig's.
        """
        return guarded(lambda: self.evaluation.figures(self.judged(log, window_s)))

    def judged(self, log: Log, window_s: tuple[float, float] | None = None) -> Judged:
        """Return a run with what the rig says of its evaluation."""
        window_s, period_s = window_s or self.given.window_s, 1.0 / self.rig.config.rate_hz
        return self.evaluation.judged(log, window_s, self.given.numbers, period_s)

    def required(self) -> dict[int, schema.Requirement]:
        """Return the rig's requirements of the controller that runs, by their numbers."""
        config = self.rig.config
        return {
            number: entry
            for number, entry in enumerate(config.require)
            if entry.controllers is None or config.controller in entry.controllers
        }

    def requirements(self, log: Log, cut: bool | None = None) -> list[JudgedRequirement]:
        """Return what became of the rig's requirements; EvaluationError, RigError.

        `cut`: whether the run went on behind the log's end; None: as far as the log tells.
        """
        return self._results(self.judged(log), cut, self.check_requirements(log))

    def _results(self, judged: Judged, cut: bool | None, those: Bound) -> list[JudgedRequirement]:
        required = list(self.required().values())
        return guarded(lambda: results(required, judged, cut, those)) if required else []

    def check_requirements(self, log: Log) -> Bound:
        """Return the requirements as they can be judged in a log like this one.

        RigError for names and units that are wrong.
        """
        try:
            return bound_requirements(
                list(self.required().values()), SignalNames(log, self.evaluation.signals)
            )
        except RequirementError as error:
            keys = ("require", list(self.required())[error.number], *error.keys)
            raise self.rig.document.error(keys, error.what) from None

    def draw(
        self,
        log: Log,
        metrics: Mapping[str, float],
        path: Path | None,
        requirements: Sequence[JudgedRequirement] = (),
        changed: Sequence[str] = (),
        who: str = "",
    ) -> str:
        """Draw the rig's figure; return "" or the reason why there is none.

        Without a `path` it is laid out only, which finds what is wrong with it.
        `requirements` that were violated are marked, what was `changed` stands in the title, and
        `who` in the controller's place. EvaluationError; OSError if `path` cannot be written.
        """
        config, section = self.rig.config, self.given
        if not self.evaluation.panels:
            return "the rig names no evaluation file with panels"
        title = f"{config.rig}: {config.title}, {who or f'controller {config.controller}'}"
        marks = [(one.first_s or 0.0, one.name) for one in requirements if one.held is False]
        about = title + changes(changed), metrics, section.window_s, section.numbers, marks
        try:
            guarded(lambda: self.evaluation.draw(log, path, *about), path or Path(os.devnull))
        except ImportError as error:
            return str(error)
        return ""

    def needed_columns(
        self, log: Log, drawn: bool, names: Sequence[str] = ()
    ) -> dict[str, list[str]]:
        """Return the columns by node that metrics, and the figure if `drawn`, ask of such a log.

        `names`: of variables and signals that are asked for besides.
        """
        nodes = {}
        for name, node in log.node.items():
            nodes[name] = replace(
                node,
                cycle=node.cycle[:_PROBED],
                stamp_ns=node.stamp_ns[:_PROBED],
                columns=_first_rows(node.columns),
                timing=_first_rows(node.timing),
            )
        probe = replace(log, node=nodes)
        try:
            self.requirements(probe)
            self.metrics(probe, (-math.inf, math.inf))
            for name in names:
                self.judged(probe).run().get(name)
            if drawn:
                guarded(lambda: self.evaluation.touch(self.judged(probe).run()))
        except RigError:
            pass  # it will fail again, and be told, on the whole log
        wanted = {}
        for name, one in nodes.items():
            asked = [key for of in (one.columns, one.timing) for key in getattr(of, "asked", ())]
            wanted[name] = [*asked, *counters(one.columns), *TIMING_COLUMNS]
        return wanted

    def judge(
        self, log: Log, changed: list[str], early: str = "", those: Bound | None = None
    ) -> Judgement:
        """Judge a run in which values were `changed`; `early`: why it has not come to its end.

        `those`: what `check_requirements` returned for a log with the same variables.
        """
        judged = self.judged(log)
        judgement = Judgement(*self._judged_limits(judged, changed, early))
        if why := _outside(log):
            judgement.findings += self.left_requirements(why)
            return judgement
        try:
            those = self.check_requirements(log) if those is None else those
            judgement.requirements = self._results(judged, True if early else None, those)
            judgement.findings += [one.finding for one in judgement.requirements]
        except RigError as error:
            told = [one.why for one in judgement.findings if one.kind is FindingKind.EVALUATION]
            judgement.findings += lines(FindingKind.EVALUATION, {words_of(error)} - {*told})
        return judgement

    def _judged_limits(
        self, judged: Judged, changed: list[str], early: str
    ) -> tuple[dict[str, float], list[Finding]]:
        """Return all metrics, and what became of those that the rig limits."""
        try:
            metrics = guarded(lambda: self.evaluation.figures(judged))
        except EvaluationError as error:
            failed = lines(FindingKind.EVALUATION, [words_of(error)])
            return {}, [*failed, *self.left_limits("the evaluation failed", {})]
        reason = early or _outside(judged.log) or beyond(self.rig, changed)
        if reason:
            return metrics, self.left_limits(reason, metrics)
        return metrics, [self._judged_limit(name, metrics, judged) for name in self._limits]

    def left_limits(self, why: str, metrics: Mapping[str, float]) -> list[Finding]:
        """Return all limits, none of them judged."""
        return [self.limit(name, None, why, metrics.get(name)) for name in self._limits]

    def left_requirements(self, why: str) -> list[Finding]:
        """Return all requirements, none of them judged."""
        of = self.required().values()
        return [JudgedRequirement(text_of(one), None, why, id=one.id or "").finding for one in of]

    @property
    def _limits(self) -> Mapping[str, Any]:
        return self.rig.config.expected

    def _judged_limit(self, name: str, metrics: Mapping[str, float], judged: Judged) -> Finding:
        """Return whether a metric is within its limits, and left nothing out."""
        low, high = self._limits[name]
        value = metrics.get(name, math.nan)
        if not low <= value <= high:
            known = "" if name in metrics else did_you_mean(name, metrics)
            said = "is not known in this run" if math.isnan(value) else f"= {value:.4g}"
            problem = f"{said}, expected {low:g} to {high:g}{known}"
        elif odd := guarded(partial(self.evaluation.non_finite, judged, name)):
            problem = f"= {value:.4g} ignores that {odd}"
        else:
            return self.limit(name, True, "", value)
        return self.limit(name, False, problem, metrics.get(name))

    def limit(self, name: str, held: bool | None, why: str, value: float | None = None) -> Finding:
        """Return what became of a metric that the rig limits."""
        low, high = self._limits[name]
        margin = None if value is None else min(value - low, high - value)
        about = name, self.rig.config.limit_ids().get(name, ""), value, low, high
        return Finding(FindingKind.LIMIT, why, held, *about, margin=margin)


def changes(settings: Sequence[str]) -> str:
    """Return what was changed, for a title: the first ones, and how many more."""
    shown = [f"{text[:_LONGEST]}..." if len(text) > _LONGEST else text for text in settings]
    return "".join(f"; {setting}" for setting in screen.some(shown, _TITLED, "{} more"))


_PROBED = 1000  # rows
_FULL = (*FULL, errno.EROFS, errno.EIO)  # the disk's fault, not the file's


def _first_rows(columns: Mapping[str, Any]) -> Columns:
    return Columns(list(columns), lambda name: columns[name][:_PROBED])


def _outside(log: Log) -> str:
    """Return that the commands of a run were not those of the rig's controller; "" if they were."""
    stepped = (node.description.get("external") or () for node in log.node.values())
    if not any("controller" in names for names in stepped):
        return ""
    return "the commands came from outside, but the limits are for the rig's controllers"


def beyond(rig: Rig, changed: Sequence[str]) -> str:
    """Return why nothing is left to judge the rig's limits by; "" where something is."""
    names = [setting.partition("=")[0] for setting in changed]
    for name in names:
        if name.partition(".")[0] == "evaluation":
            return f"{name} was changed: the limits are for another window"
    if rig.evaluation is None:
        return ""
    duration_s, shorter = rig.config.duration_s, "duration_s" in names
    if shorter and "window_s" not in (rig.config.evaluation or {}):
        return "duration_s was changed, and the window is the whole run"
    numbers = rig.evaluation.numbers.items() if shorter else ()  # else left from a base, perhaps
    last = max([rig.evaluation.window_s[1], *(v for k, v in numbers if k.endswith("_to_s"))])
    if duration_s < last:
        ends = f"the run ends at {duration_s:g} s, before its window ends at {last:g} s"
        return f"{ends}; duration_s={last:.12g} is enough"
    return ""


def _loaded_evaluation(file: Path) -> Evaluation:
    """Return what an evaluation file declares."""
    if file.suffix != ".py":
        raise EvaluationError(f"{file}: no Python file; its name has to end in .py")
    with own_streams():
        declared = getattr(module_of("", file), "EVALUATION", None)
    if not isinstance(declared, Evaluation):
        kind = "no EVALUATION" if declared is None else f"EVALUATION is a {type(declared).__name__}"
        what = "expected EVALUATION = Evaluation(...) of pcpc.plants.evaluation"
        raise EvaluationError(f"{file}: {kind}; {what}")
    return declared


def guarded(action: Callable[[], Made], output: Path | None = None) -> Made:
    """Return what `action`, code of an evaluation file, returns; EvaluationError if it fails.

    What is wrong with the disk, or with writing `output`, stays an OSError.
    """
    try:
        return action()
    except EvaluationError:
        raise
    except ImportError as error:
        if output is not None and "pip install" in str(error):  # matplotlib's, of a figure
            raise
        raise EvaluationError(cause(error)) from None
    except OSError as error:
        if error.errno in _FULL or (output and str(error.filename) == str(output)):
            raise
        raise EvaluationError(cause(error)) from None
    except (Exception, SystemExit) as error:
        placed = isinstance(error, DeclarationError) and error.placed
        raise EvaluationError(str(error) if placed else cause(error)) from None


def _check_names(judge: Judge, log: Log) -> None:
    """Refuse variables that the records of no controller of the rig have; RigError."""
    absent = dict(judge.evaluation.absent(log))
    for name in judge.rig.config.controllers if absent else ():
        with suppress(RigError):  # its own check tells
            other = imagined_log(load_rig(judge.rig.path, name), judge.rig.config.pacing)
            absent = {k: v for k, v in absent.items() if k in dict(judge.evaluation.absent(other))}
    for what in absent.values():
        raise RigError(what)


def columns_to_keep(judge: Judge, pacing: str, drawn: bool) -> dict[str, list[str]]:
    """Return the columns by node that will be judged and drawn, of a log that keeps a part only.

    {} for a rig whose log keeps everything. RigError, BusError as `plan`, and for requirements
    that name what the rig will not record.
    """
    config = judge.rig.config
    if config.record.keep is None and not config.require:
        return {}
    log = imagined_log(judge.rig, pacing)
    judge.check_requirements(log)
    return {} if config.record.keep is None else judge.needed_columns(log, drawn)


def check(judge: Judge, changed: Sequence[str]) -> list[str]:
    """Try the evaluation out on imagined runs of the rig; return warnings.

    `changed`: settings from the command line. RigError, with the place, for what would fail at the
    end of a run: an evaluation that raises, a limit of a metric that it does not tell.
    """
    rig, evaluation = judge.rig, judge.rig.evaluation
    config = rig.config
    if config.require:
        judge.check_requirements(imagined_log(rig, config.pacing))
    if evaluation is None:
        if any(config.expect.values()):
            raise rig.error("expect", "the rig has no evaluation with metrics; add one")
        return []
    known_metrics: dict[str, None] = {}
    for fill in (nothing, noise, large):
        log = imagined_log(rig, config.pacing, fill)
        known_metrics |= dict.fromkeys(judge.metrics(log))
    judge.draw(log, judge.metrics(log), None)
    _check_names(judge, log)
    expected = config.expected
    known = judge.evaluation.names(evaluation.numbers)
    for name in expected:
        if name not in known:
            what = f"the evaluation has no such metric{did_you_mean(name, known)}"
            raise rig.error(f"expect.{config.controller}.{name}", what)
    unjudged = beyond(rig, changed)
    warnings = [f"the limits will not be judged: {unjudged}"] if unjudged and expected else []
    warnings += [str(rig.error(f"evaluation.{n}", what)) for n, what in judge.unused().items()]
    return warnings + [
        f"{evaluation.file}: {name} is not known after a trial run; it may depend on the run"
        for name in expected
        if name not in known_metrics
    ]
