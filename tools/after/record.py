"""A recorded run from Python: what `pcpc.simulate` and `pcpc.open` return."""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.errors import UserError
from pcpc.drivers.machine.packages import pip_install
from pcpc.executive.errors import did_you_mean
from pcpc.executive.log import names
from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.requirements import RequirementError
from pcpc.executive.rig.schema import Requirement
from pcpc.plants.judging import Judged, paired_rows
from pcpc.tools.after.differences import Difference
from pcpc.tools.after.log import diff, plot, series
from pcpc.tools.after.log import frames as play_frames
from pcpc.tools.after.log.drawing import DPI, DrawnLog, page_of
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.trust import Trust
from pcpc.tools.after.verdict import summary as summaries
from pcpc.tools.after.verdict import summary_file
from pcpc.tools.after.verdict.findings import Finding
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.after.verdict.requirements import JudgedRequirement, results
from pcpc.tools.start.settings import settings
from pcpc.tools.terminal.progress import Progress
from pcpc.tools.terminal.rooms import part_of

if TYPE_CHECKING:
    import pandas

    from pcpc.tools.after.replayed import Verdict as Replayed
    from pcpc.tools.terminal.document import Part

Vector = NDArray[np.float64]
FRAME = np.dtype(
    [
        ("t_s", "<f8"), ("cycle", "<i8"), ("sender", "U9"), ("id", "<u4"), ("name", "U32"),
        ("dlc", "u1"), ("data", "u1", (8,)),
    ]
)  # fmt: skip
_NODE = ":"


class UnknownName(UserError, KeyError):
    """No variable of this name was recorded; the message proposes one."""

    __str__ = Exception.__str__  # KeyError would show its repr


class NotOk(UserError, AssertionError):
    """A run whose verdict is not ok, in the words of its summary."""


@dataclass(frozen=True)
class Figure:
    """A picture of a run; a notebook shows it."""

    png: bytes = field(repr=False)

    def _repr_png_(self) -> bytes:
        return self.png

    def save(self, path: str | Path) -> Path:
        """Write the picture as a PNG file."""
        Path(path).write_bytes(self.png)
        return Path(path)


class Run:
    """A recorded run.

        run["controller.e_rad"]         of the executive, (n,) float64, a value a cycle
        run["plant:barrel.theta_rad"]   of another node, at the executive's cycles, NaN if missing;
                                        also barrel.theta_rad, as the executive has no such name
        run["error_rad"]                a signal of the rig's evaluation
        run.t_s                         (n,) float64, time of the cycles, k T, s

    UnknownName, with a proposal, for a name that was not recorded. Copy the arrays before you
    change them.
    """

    def __init__(
        self,
        path: Path,
        rig: Rig | None = None,
        outcome: Outcome | None = None,
        keep: Any = None,
        *,
        trust: bool = False,
    ) -> None:
        self.path = path
        self._rig_given, self._outcome, self._keep = rig, outcome, keep
        self._opened = Opened(path, Trust(trust))
        self.asked = False  # somebody wanted to know what it came to

    def __repr__(self) -> str:
        about = self.log.metadata[next(iter(self.log.node))]
        return f"<pcpc.Run {about.get('rig')} {about.get('controller')} {self.path}>"

    # What was recorded

    @cached_property
    def log(self) -> logs.Log:
        """The log: nodes with their columns, events, tunings, attachments."""
        return self._opened.log

    @cached_property
    def period_s(self) -> float:
        """The period of the loop, s."""
        node = next(iter(self.log.node.values()))
        return 1e-9 * float(node.description["period_ns"])

    @cached_property
    def t_s(self) -> Vector:
        """Time of the executive's cycles, (n,), s."""
        return np.asarray(self._records.t_s)

    @cached_property
    def names(self) -> list[str]:
        """The names of all variables, those of other nodes as `NODE:NAME`."""
        return [
            name if node == "executive" else f"{node}{_NODE}{name}"
            for node, one in self.log.node.items()
            for name in (*one.columns, *one.timing)
        ]

    @cached_property
    def _records(self) -> Any:
        return Judged(self.log, self.period_s).run(next(iter(self.log.node)))

    def __getitem__(self, name: str) -> Vector:
        if (found := names.find_variable(self.log, name)) is not None:
            node, variable = found
            timing = self.log.node[node].timing
            if variable in timing:
                return self._at_cycles(node, timing[variable])
            return np.asarray(self._records[f"{node}{_NODE}{variable}"])
        if (signal := self._signal(name)) is not None:
            return signal
        raise self._unknown(name)

    def _unknown(self, name: str) -> UnknownName:
        """Return why there is no such record."""
        cure = did_you_mean(name, self.names)
        return UnknownName(
            f"{name}: {names.why_unrecorded(self.log, name) or f'not recorded{cure}'}"
        )

    def _at_cycles(self, node: str, values: Vector) -> Vector:
        """Return what a node recorded at the executive's cycles."""
        leader = self._records.leader
        if node == leader:
            return np.asarray(values)
        rows = paired_rows(self.log, self.period_s, node, leader)
        return np.where(rows < 0, np.nan, values[rows])

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and names.find_variable(self.log, name) is not None

    def __iter__(self) -> Any:
        return iter(self.names)

    @cached_property
    def units(self) -> dict[str, str]:
        """The unit of each variable; "" for a number without one."""
        return {
            name if node == "executive" else f"{node}{_NODE}{name}": unit
            for node, one in self.log.node.items()
            for name, unit, *_ in one.description.get("variables", [])
        }

    @cached_property
    def frames(self) -> NDArray[Any]:
        """All frames in the order of the bus, each once.

        (n,) with the fields t_s, cycle, sender, id, name, dlc, data: `run.frames["id"]`.
        """
        try:
            played = play_frames.bus_frames(self.log)
        except play_frames.PlayError:
            return np.empty(0, FRAME)
        table = np.zeros(len(played), FRAME)
        begin_ns = played.stamp_ns[0] - round(1e9 * played.cycle[0] * self.period_s)
        table["t_s"] = 1e-9 * (played.stamp_ns - begin_ns)
        table["cycle"], table["id"] = played.cycle, played.words & 0x1FFFFFFF
        table["sender"] = np.array(played.senders)[played.sender]
        known = {number: played.names.get(number, "") for number in set(table["id"].tolist())}
        table["name"] = [known[number] for number in table["id"].tolist()]
        table["dlc"], table["data"] = played.raw[:, 4], played.raw[:, 8:16]
        return table

    @cached_property
    def events(self) -> list[dict[str, Any]]:
        """States, faults, tunings, skipped periods of all nodes, by cycle; each with its node."""
        events = [
            {"node": name, **event}
            for name, node in self.log.node.items()
            for event in (*node.events, *node.tunings)
        ]
        return sorted(events, key=lambda event: int(event.get("cycle", 0)))

    def _signal(self, name: str) -> Vector | None:
        """Return a signal of the rig's evaluation; None if it has no such one."""
        if name not in self._judged_run.signals:
            return None
        return np.asarray(self._judged_run.run()[name])

    @cached_property
    def _judged_run(self) -> Judged:
        """The run with what the rig says of its evaluation, if that can be had."""
        try:
            return self._judge.judged(self.log)
        except (logs.LogError, UserError):  # a foreign log's: it does not run unasked
            return Judged(self.log, self.period_s)

    # What it came to

    @cached_property
    def rig(self) -> Rig:
        """The rig of the run, with all settings."""
        if self._rig_given is not None:
            return self._rig_given
        return self._opened.judged()[0]

    @cached_property
    def _judge(self) -> Judge:
        return Judge.of(self.rig)

    @cached_property
    def _beside(self) -> tuple[summaries.Summary | None, str]:
        return (None, "") if self._outcome is not None else summary_file.beside(self.path)

    @property
    def doubt(self) -> str:
        """Why summary.json is not of this log."""
        return self._beside[1]

    @property
    def judged_at_its_end(self) -> bool:
        """Whether the verdict is the run's own."""
        return self._outcome is not None or self._beside[0] is not None

    @property
    def result(self) -> summaries.Summary:
        """The result; judged again without a summary of this log."""
        self.asked = True
        return self._result

    @cached_property
    def _result(self) -> summaries.Summary:
        if self._beside[0] is not None:
            return self._beside[0]
        outcome = self._outcome or summaries.outcome_of(self.log, self.doubt)
        return summaries.summarise(self.rig, self.log, outcome, self._judge)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The content of `summary.json`."""
        return summary_file.plain(self.result)

    @property
    def metrics(self) -> dict[str, float]:
        """The figures of merit of the rig's evaluation."""
        return dict(self._result.metrics)

    @cached_property
    def requirements(self) -> list[JudgedRequirement]:
        """The results of the rig's requirements: met or not, where first, with which margin."""
        return self._judge.requirements(self.log)

    @cached_property
    def findings(self) -> list[Finding]:
        """What became of each limit and each requirement, as a kind of record for both."""
        return summary_file.findings_of(self._result, self._judge, self.log)

    def require(self, **entry: Any) -> JudgedRequirement:
        """Return the result of a requirement that holds in this run; NotOk if it does not hold.

            run.require(always="abs(controller.e_rad) < 2 mrad", after="1s")
            run.require(when="reference.q_d_rad changes", within="200ms", then=..., for_="1s")

        The keys are those of a rig's `require`, with `for_` in place of `for`. NotOk (an
        AssertionError) shows where it was first violated, or why it could not be judged.
        """
        words = {key.removesuffix("_"): value for key, value in entry.items()}
        try:
            asked = msgspec.convert(words, Requirement)
            (result,) = results([asked], self._judged_run)
        except (msgspec.ValidationError, RequirementError) as error:
            raise UserError(f"require: {error}") from None
        if not result.held:
            raise NotOk(str(result))
        return result

    @property
    def verdict(self) -> str:
        """`ok`, `not judged`, `expectation not met`, `loss`, `safety stop` or `interrupted`."""
        return self.result.verdict

    def check(self) -> "Run":
        """Return the run if its verdict is ok; NotOk (an AssertionError) if it is not."""
        if self.verdict != "ok":
            why = "; ".join(self.result.problems()) or "see its summary"
            raise NotOk(f"{self.result.rig}: {self.verdict}: {why}")
        return self

    def figure(self, *variables: str, path: str | Path | None = None) -> Figure:
        """Return the figure of the rig's evaluation, or of the `variables` over time.

        `path`: also written there. ImportError without matplotlib, with the cure.
        """
        with tempfile.TemporaryDirectory(prefix="pcpc-") as folder:
            place = Path(folder) / "figure.png"
            if variables:
                self._plot(variables, place)
            else:
                about = self.metrics, place, self.requirements
                if reason := self._judge.draw(self.log, *about):
                    raise UserError(f"{self.path}: {reason}")
            figure = Figure(place.read_bytes())
        if path is not None:
            figure.save(path)
        return figure

    def parts(self) -> "list[Part]":
        """Return the parts of `pcpc report`: facts, verdict, chapters with tables and pictures.

        `pcpc.tools.terminal.document` makes HTML, Markdown or lines of a terminal of each.
        """
        known = self.result if self.judged_at_its_end else None
        gather = part_of("after/report", "record").gather
        record = gather(self._opened, Progress(quiet=True), known)
        return [*part_of("after/report", "cli").report_of(record).parts]

    def report(self, path: str | Path) -> Path:
        """Write the run as one page, or FILE.md, as `pcpc report -o`; return `path`."""
        known = self.result if self.judged_at_its_end else None
        page = part_of("after/report", "cli")
        page.write(self.path, Path(path), self._opened.trust, Progress(quiet=True), known)
        return Path(path)

    def _plot(self, variables: Sequence[str], place: Path) -> None:
        """Draw variables over time as `pcpc log plot` does."""
        for name in variables:
            if name not in self:
                raise self._unknown(name)
        known, begin_ns = series.all_series(self.log), series.start_ns(self.log)
        source = DrawnLog(self.path.stem, self.log, known, begin_ns)
        groups = plot.groups_of([source], [name.replace(_NODE, ".", 1) for name in variables])
        page_of([source], groups).savefig(place, dpi=DPI)

    def to_pandas(self) -> "pandas.DataFrame":
        """Return all variables as a table by time. ImportError without pandas."""
        try:
            import pandas
        except ImportError:
            raise ImportError(f"pandas is not installed; {pip_install('pandas')}") from None
        index = pandas.Index(self.t_s, name="t_s")
        return pandas.DataFrame({name: self[name] for name in self.names}, index=index)

    def replay(self, **changes: Any) -> "list[Replayed]":
        """Recompute every node from the log and compare bit by bit; a verdict for each.

        `all(node.identical for node in run.replay())`. `controller` and `set`, as in `simulate`,
        recompute what the node would have sent on the recorded input. TypeError: another option.
        """
        from pcpc.tools.after.replay import replay  # time

        options = changes.pop("controller", None), settings(changes.pop("set", {}))
        if changes:
            raise TypeError(f"replay: no option {next(iter(changes))}; known: controller, set")
        return replay(self._opened, Progress(quiet=True), "all", *options)

    def differences(self, other: "Run") -> list[Difference]:
        """Return where bits differ, as `compare --bits`."""
        return diff.compare(self.log, other.log).differences
