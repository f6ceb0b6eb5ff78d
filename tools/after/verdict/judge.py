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
from pcpc.executive.rig import schema
from pcpc.executive.rig.law_errors import cause
from pcpc.executive.rig.modules import module_of, own_streams
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.requirements import RequirementError, text_of
from pcpc.plants.evaluation import Evaluation
from pcpc.plants.judging import Judged, Mistake
from pcpc.tools.after.verdict.imagined_logs import imagined_log, large, noise, nothing
from pcpc.tools.after.verdict.masters import counters
from pcpc.tools.after.verdict.requirements import Bound, Names, Result, bound_requirements, results
from pcpc.tools.terminal import screen

TIMING_COLUMNS = (  # of every node: what a summary and the last axes of a figure are made of
    *(f"timing.{stage}_us" for stage in ("wake_late", "receive", "step", "send", "publish")),
    *(f"health.{name}" for name in (
        "late_cycles", "skipped_cycles", "held_cycles", "stale_cycles", "frames_sent",
        "frames_received", "frames_lost", "crc_errors", "frames_repeated", "saturated_values",
        "frames_lost_on_purpose",
    )),
)  # fmt: skip
_NONE = schema.Evaluation(file="", window_s=(-math.inf, math.inf))  # of a rig that names none
_TITLED, _LONGEST = 2, 36  # settings in the figure's title, and letters of one
Made = TypeVar("Made")


class EvaluationError(RigError):
    """The rig's evaluation file failed: where and why, in one line."""


@dataclass
class Judgement:
    """What became of the rig's expectations; `not_judged`: name -> reason."""

    metrics: dict[str, float] = field(default_factory=dict)
    judged: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    not_judged: dict[str, str] = field(default_factory=dict)
    requirements: list[Result] = field(default_factory=list)

    def require(self, results: list[Result]) -> None:
        """Enter what became of requirements."""
        self.requirements = results
        for one in results:
            if one.held is None:
                self.not_judged[one.name] = one.reason
            else:
                self.judged.append(one.name)
        self.failed += [str(one) for one in results if one.held is False]


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

    def named(self, limit: str) -> str:
        """Return the name of a limit behind its id, if it has one."""
        ids = self.rig.config.limit_ids()
        return f"{ids[limit]} {limit}" if limit in ids else limit

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

    def requirements(self, log: Log, cut: bool | None = None) -> list[Result]:
        """Return what became of the rig's requirements; EvaluationError, RigError.

        `cut`: whether the run went on behind the log's end; None: as far as the log tells.
        """
        return self._results(self.judged(log), cut, self.check_requirements(log))

    def _results(self, judged: Judged, cut: bool | None, those: Bound) -> list[Result]:
        required = list(self.required().values())
        return guarded(lambda: results(required, judged, cut, those)) if required else []

    def check_requirements(self, log: Log) -> Bound:
        """Return the requirements as they can be judged in a log like this one.

        RigError for names and units that are wrong.
        """
        try:
            return bound_requirements(
                list(self.required().values()), Names(log, self.evaluation.signals)
            )
        except RequirementError as error:
            keys = ("require", list(self.required())[error.number], *error.keys)
            raise self.rig.document.error(keys, error.what) from None

    def draw(
        self,
        log: Log,
        metrics: Mapping[str, float],
        path: Path | None,
        requirements: Sequence[Result] = (),
        changed: Sequence[str] = (),
        who: str = "",
    ) -> str:
        """Draw the rig's figure; return "" or the reason why there is none.

        Without a `path` it is laid out only, which finds what is wrong with it.
        `requirements` that were violated are marked, what was `changed` stands in the title, and
        `who` in the controller's place. EvaluationError; OSError if `path` cannot be written.
        """
        config, given = self.rig.config, self.given
        if not self.evaluation.panels:
            return "the rig names no evaluation file with panels"
        title = f"{config.rig}: {config.title}, {who or f'controller {config.controller}'}"
        marks = [(one.first_s or 0.0, one.name) for one in requirements if one.held is False]
        about = title + changes(changed), metrics, given.window_s, given.numbers, marks
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
        found = {}
        for name, one in nodes.items():
            asked = [key for of in (one.columns, one.timing) for key in getattr(of, "asked", ())]
            found[name] = [*asked, *counters(one.columns), *TIMING_COLUMNS]
        return found

    def judge(
        self, log: Log, changed: list[str], early: str = "", those: Bound | None = None
    ) -> Judgement:
        """Judge a run in which values were `changed`; `early`: why it has not come to its end.

        `those`: what `check_requirements` returned for a log with the same variables.
        """
        found, judged = Judgement(), self.judged(log)
        self._judge_limits(found, judged, changed, early)
        if why := _outside(log):
            found.not_judged |= {text_of(one): why for one in self.required().values()}
            return found
        try:
            those = self.check_requirements(log) if those is None else those
            found.require(self._results(judged, True if early else None, those))
        except RigError as error:
            found.failed += [str(error)] * (str(error) not in found.failed)
        return found

    def _judge_limits(
        self, found: Judgement, judged: Judged, changed: list[str], early: str
    ) -> None:
        """Judge the metrics that the rig limits."""
        expected = self.rig.config.expected
        try:
            found.metrics = guarded(lambda: self.evaluation.figures(judged))
        except EvaluationError as error:
            found.failed.append(str(error))
            found.not_judged = dict.fromkeys(expected, "the evaluation failed")
            return
        reason = early or _outside(judged.log) or beyond(self.rig, changed)
        if reason:
            found.not_judged = dict.fromkeys(expected, reason)
            return
        for name, (low, high) in expected.items():
            found.judged.append(name)
            value = found.metrics.get(name, math.nan)
            if not low <= value <= high:
                known = "" if name in found.metrics else did_you_mean(name, found.metrics)
                said = "is not known in this run" if math.isnan(value) else f"= {value:.4g}"
                what = f"{said}, expected {low:g} to {high:g}{known}"
            elif odd := guarded(partial(self.evaluation.non_finite, judged, name)):
                what = f"= {value:.4g} ignores that {odd}"
            else:
                continue
            found.failed.append(f"{self.named(name)} {what}")


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


def beyond(rig: Rig, changed: list[str]) -> str:
    """Return why the changes leave nothing to judge the rig's limits by; "" if they do not."""
    names = [setting.partition("=")[0] for setting in changed]
    for name in names:
        if name.partition(".")[0] == "evaluation":
            return f"{name} was changed: the limits are for another window"
    if "duration_s" not in names or rig.evaluation is None:
        return ""
    if "window_s" not in (rig.config.evaluation or {}):
        return "duration_s was changed, and the window is the whole run"
    numbers = rig.evaluation.numbers.items()
    last = max([rig.evaluation.window_s[1], *(v for k, v in numbers if k.endswith("_to_s"))])
    if rig.config.duration_s < last:
        return f"the run ends at {rig.config.duration_s:g} s, before its window ends at {last:g} s"
    return ""


def _loaded_evaluation(file: Path) -> Evaluation:
    """Return what an evaluation file declares."""
    if file.suffix != ".py":
        raise EvaluationError(f"{file}: no Python file; its name has to end in .py")
    with own_streams():
        found = getattr(module_of("", file), "EVALUATION", None)
    if not isinstance(found, Evaluation):
        kind = "no EVALUATION" if found is None else f"EVALUATION is a {type(found).__name__}"
        what = "expected EVALUATION = Evaluation(...) of pcpc.plants.evaluation"
        raise EvaluationError(f"{file}: {kind}; {what}")
    return found


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
        placed = isinstance(error, Mistake) and error.placed
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


def check(judge: Judge, changed: list[str]) -> list[str]:
    """Try the evaluation out on imagined runs of the rig; return warnings.

    `changed`: settings from the command line.

    RigError, with the place, for what would fail at the end of a run: an evaluation that raises, a
    limit of a metric that it does not tell.
    """
    rig, evaluation = judge.rig, judge.rig.evaluation
    config = rig.config
    if config.require:
        judge.check_requirements(imagined_log(rig, config.pacing))
    if evaluation is None:
        if any(config.expect.values()):
            raise rig.error("expect", "the rig has no evaluation with metrics; add one")
        return []
    told: dict[str, None] = {}
    for fill in (nothing, noise, large):
        log = imagined_log(rig, config.pacing, fill)
        told |= dict.fromkeys(judge.metrics(log))
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
        if name not in told
    ]
