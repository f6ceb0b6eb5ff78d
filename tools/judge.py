"""Judging a run: the rig's evaluation file, what the rig expects, and what could not be judged.

One rule for values set on the command line and for live tunings: the limits of the rig are judged
whatever was changed, and what was changed is named. Only where the change leaves nothing to judge
by (another window, a run that ends before the window does) are limits left out, and named with the
reason. An evaluation that fails costs its metrics and the verdict, never the rest of the summary.
"""

import errno
import importlib.util
import inspect
import math
import sys
import tempfile
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from pcpc.executive.errors import FULL, RigError, did_you_mean
from pcpc.executive.log.long_logs import Columns
from pcpc.executive.log.reader import Log
from pcpc.executive.rig.reading import Rig
from pcpc.tools.imagine import imagined, large, noise, nothing

TIMING_COLUMNS = (  # of every node: what a summary and the last axes of a figure are made of
    *(f"timing.{stage}_us" for stage in ("wake_late", "receive", "step", "send", "publish")),
    *(f"health.{name}" for name in (
        "late_cycles", "skipped_cycles", "held_cycles", "stale_cycles", "frames_sent",
        "frames_received", "frames_lost", "crc_errors", "frames_repeated", "saturated_values",
        "frames_lost_on_purpose",
    )),
)  # fmt: skip
METRICS = ("log", "window_s", "numbers", "period_s")
FIGURE = ("log", "path", "title", "metrics", "window_s")
Result = TypeVar("Result")


class EvaluationError(Exception):
    """The rig's evaluation file failed: where and why, in one line."""


@dataclass
class Judgement:
    """What became of the rig's expectations; `not_judged`: name -> reason."""

    metrics: dict[str, float] = field(default_factory=dict)
    judged: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    not_judged: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Judge:
    """A rig and its evaluation file, loaded."""

    rig: Rig
    module: ModuleType | None

    @classmethod
    def of(cls, rig: Rig) -> "Judge":
        """Load the rig's evaluation file, if it names one; RigError if it can judge nothing."""
        if rig.evaluation is None:
            return cls(rig, None)
        try:
            module = evaluation_module(rig)
        except EvaluationError as error:
            raise RigError(str(error)) from None
        for name, wanted in (("metrics", METRICS), ("figure", FIGURE)):
            function = getattr(module, name, None)
            if function is None and name == "figure":
                continue
            fault = _fault(name, function, len(wanted))
            if fault:
                what = f"{rig.evaluation.file}: {fault}; expected {name}({', '.join(wanted)})"
                raise RigError(what)
        return cls(rig, module)

    def metrics(self, log: Log) -> dict[str, float]:
        """Return the metrics of a run; {} if the rig names no evaluation. EvaluationError."""
        evaluation = self.rig.evaluation
        if self.module is None or evaluation is None:
            return {}
        return self.metrics_within(log, evaluation.window_s)

    def metrics_within(self, log: Log, window_s: tuple[float, float]) -> dict[str, float]:
        """As `metrics`, over another window than the rig's."""
        module, evaluation = self.module, self.rig.evaluation
        assert module is not None and evaluation is not None, "the rig names an evaluation"
        period_s = 1.0 / self.rig.config.rate_hz

        def found() -> dict[str, float]:
            told = module.metrics(log, window_s, evaluation.numbers, period_s)
            return {str(name): float(value) for name, value in dict(told).items()}

        return _guarded(evaluation.file, log, found)

    def draw(self, log: Log, title: str, metrics: Mapping[str, float], path: Path) -> str:
        """Draw the rig's figure; return "" or the reason why there is none.

        Raises EvaluationError; OSError if `path` cannot be written.
        """
        evaluation, module = self.rig.evaluation, self.module
        if evaluation is None or not hasattr(module, "figure"):
            return "the rig names no evaluation file with a figure"
        assert module is not None, "it has a figure"
        refused: list[OSError] = []

        def figure() -> None:
            try:
                module.figure(log, path, title, metrics, evaluation.window_s)
            except OSError as error:
                if error.errno not in FULL and str(error.filename) != str(path):
                    raise
                refused.append(error)

        try:
            _guarded(evaluation.file, log, figure)
        except ImportError as error:
            return str(error)
        if refused:
            raise refused[0]
        return ""

    def asked(self, log: Log, drawn: bool) -> dict[str, list[str]]:
        """Return the columns by node that metrics, and the figure if `drawn`, ask of such a log."""
        nodes, probes = {}, {}
        for name, node in log.node.items():
            probes[name] = _first_rows(node.columns), _first_rows(node.timing)
            nodes[name] = replace(
                node, cycle=node.cycle[:_PROBED], stamp_ns=node.stamp_ns[:_PROBED],
                columns=probes[name][0], timing=probes[name][1],
            )  # fmt: skip
        probe = replace(log, node=nodes)
        found: dict[str, float] = {}
        try:
            if self.module is not None:
                found = self.metrics_within(probe, (-math.inf, math.inf))
                if drawn:
                    self.draw(probe, "", found, Path("/dev/null"))
        except EvaluationError:
            found = {}  # it will fail again, and be told, on the whole log
        return {
            name: [*columns.asked, *timing.asked, *TIMING_COLUMNS]
            for name, (columns, timing) in probes.items()
        }

    def judge(self, log: Log, changed: list[str], early: str = "") -> Judgement:
        """Judge a run in which values were `changed`; `early`: why it has not come to its end."""
        config, found = self.rig.config, Judgement()
        expected = config.expect.get(config.controller, {})
        try:
            found.metrics = self.metrics(log)
        except EvaluationError as error:
            found.failed.append(str(error))
            found.not_judged = dict.fromkeys(expected, "the evaluation failed")
            return found
        reason = early or _beyond(self.rig, changed)
        if reason:
            found.not_judged = dict.fromkeys(expected, reason)
            return found
        for name, (low, high) in expected.items():
            found.judged.append(name)
            value = found.metrics.get(name, math.nan)
            if not low <= value <= high:
                known = "" if name in found.metrics else did_you_mean(name, found.metrics)
                said = "is not told by this run" if math.isnan(value) else f"= {value:.4g}"
                found.failed.append(f"{name} {said}, expected {low:g} to {high:g}{known}")
        return found


_PROBED = 1000  # rows
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO)  # the disk's fault, not the file's


def _first_rows(columns: Mapping[str, Any]) -> Columns:
    return Columns(list(columns), lambda name: columns[name][:_PROBED])


def _fault(name: str, function: Any, wanted: int) -> str:
    """Return what is wrong with a function of an evaluation file, "" for nothing."""
    if not callable(function):
        return f"no function {name}"
    try:
        inspect.signature(function).bind(*range(wanted))
    except TypeError as error:
        return f"{name}: {error}"
    return ""


def _beyond(rig: Rig, changed: list[str]) -> str:
    """Return why the changes leave nothing to judge the rig's limits by; "" if they do not."""
    names = [setting.partition("=")[0] for setting in changed]
    for name in names:
        if name.partition(".")[0] == "evaluation":
            return f"{name} was changed: the limits are about another window"
    if "duration_s" not in names or rig.evaluation is None:
        return ""
    if "window_s" not in (rig.config.evaluation or {}):
        return "duration_s was changed, and the window is the whole run"
    numbers = rig.evaluation.numbers.items()
    last = max([rig.evaluation.window_s[1], *(v for k, v in numbers if k.endswith("_to_s"))])
    if rig.config.duration_s < last:
        return f"the run is to end at {rig.config.duration_s:g} s, the window at {last:g} s"
    return ""


def evaluation_module(rig: Rig) -> ModuleType | None:
    """Import the rig's evaluation file, if it names one; EvaluationError."""
    if rig.evaluation is None:
        return None
    name, file = "pcpc_evaluation", rig.evaluation.file
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise EvaluationError(f"{file}: no Python file; its name has to end in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    loader = spec.loader
    _guarded(file, None, lambda: loader.exec_module(module))
    return module


def _guarded(file: str, log: Log | None, action: Callable[[], Result]) -> Result:
    """Return what `action`, code of an evaluation file, returns; EvaluationError if it fails."""
    try:
        return action()
    except ImportError as error:
        if log is not None and "pip install" in str(error):  # matplotlib's, of a figure
            raise
        raise EvaluationError(f"{_place(file, error)}: {error}") from None
    except OSError as error:
        if error.errno in _FULL:
            raise
        raise EvaluationError(f"{_place(file, error)}: {_words(error, log)}") from None
    except (Exception, SystemExit) as error:
        raise EvaluationError(f"{_place(file, error)}: {_words(error, log)}") from None


def _place(file: str, error: BaseException) -> str:
    """Return `file:line` of the user's code where an error came from."""
    if isinstance(error, SyntaxError):
        return f"{error.filename}:{error.lineno}"
    lines = [
        frame.lineno
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename).resolve() == Path(file).resolve()
    ]
    return f"{file}:{lines[-1]}" if lines else file


def _words(error: BaseException, log: Log | None) -> str:
    """Return an error's kind and text in one line, with a proposal for a variable not there."""
    if isinstance(error, SyntaxError):
        return f"{error.msg}"
    text = " ".join(str(error).split())
    if type(error) is KeyError and log is not None and error.args:
        known = [name for node in log.node.values() for name in (*node.columns, *node.timing)]
        return f"no variable {text}{did_you_mean(str(error.args[0]), known)}"
    if isinstance(error, KeyError):  # its own words
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def foreseen(judge: Judge, pacing: str, drawn: bool) -> dict[str, list[str]]:
    """Return the columns by node that will be judged and drawn, of a log that keeps a part only.

    {} for a rig whose log keeps everything. RigError, BusError as `plan`.
    """
    if judge.rig.config.record.keep is None:
        return {}
    return judge.asked(imagined(judge.rig, pacing), drawn)


def check(judge: Judge, changed: list[str]) -> list[str]:
    """Try the evaluation out on imagined runs of the rig; return warnings.

    `changed`: settings from the command line.

    RigError, with the place, for what would fail at the end of a run: an evaluation that raises, a
    limit of a metric that it does not tell.
    """
    rig, evaluation = judge.rig, judge.rig.evaluation
    config = rig.config
    if evaluation is None:
        if any(config.expect.values()):
            raise rig.error("expect", "the rig has no evaluation that tells metrics; add one")
        return []
    unjudged = _beyond(rig, changed)
    told: dict[str, None] = {}
    try:
        for fill in (nothing, noise, large):
            log = imagined(rig, config.pacing, fill)
            told |= dict.fromkeys(judge.metrics(log))
        with tempfile.TemporaryDirectory() as folder:
            judge.draw(log, config.title, judge.metrics(log), Path(folder) / "figure.png")
    except EvaluationError as error:
        raise RigError(str(error)) from None
    expected = config.expect.get(config.controller, {})
    source = Path(evaluation.file).read_text("utf-8", "replace")
    for name in expected:
        if name not in told and name not in source:  # there it may depend on the run
            what = f"the evaluation tells no such metric{did_you_mean(name, told)}"
            raise rig.error(f"expect.{config.controller}.{name}", what)
    warnings = [f"the limits will not be judged: {unjudged}"] if unjudged and expected else []
    return warnings + [
        f"{evaluation.file}: {name} is not told by a trial run; it may depend on what happens"
        for name in expected
        if name not in told
    ]
