"""Of all tests: what they import stays, and is not searched for garbage again and again.

A test that takes more than SHARE of the time of all is deep but for its first cases, see
seconds.csv beside this file; so is what is marked `deep`, and what is marked `quick` is not.
`make test` leaves the deep ones out, `make test-all` has them, and so has pytest where it is given
files. A file of which no test can run is not imported: one compiles two loops. The files that took
longest the last time come first: in the end no processor waits for one of them.
The tests of a file that starts programs as a user does are `paced`: such programs keep time by the
machine's clock, and one that fails while the machine could not is repeated once, and named: it
waits for a time where an event, a count or virtual time would do. Their commands are copies, which
spares a second of processor time each. Hypothesis judges no test by the time that it took.
"""

import gc
import os
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import reach
from copies import PROGRAMS, Copy, copies, defer_grammars, say_no_compiling
from hypothesis import HealthCheck, settings

from pcpc.tools.start.children import Child

pytest_plugins = ("deadline",)
STARTS_PROGRAMS = {
    "processes", "hosting", "live_run", "playing", "copies", "paging", "two_processes", "free_bus",
    "live", "blocks", "pcpc.tools.start.children",
}  # fmt: skip

SHARE = 1 / 20000  # of the time of all tests, for one test with all its cases
_SECONDS, _COSTS = "pcpc/seconds", Path(__file__).with_name("seconds.csv")
_PROCESSORS = os.sched_getaffinity(0)
_started = Child.started

gc.disable()
defer_grammars()
say_no_compiling()
settings.register_profile("any speed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any speed")


@pytest.fixture(scope="module", autouse=True)
def _commands_are_copies(request: pytest.FixtureRequest) -> Iterator[None]:
    """Let `pcpc.running` start copies, see `copies`, but in a file that says NEW_PROCESSES.

    A command that watched in this process has kept off a loop's processor: that is over.
    """
    os.sched_setaffinity(0, _PROCESSORS)
    with pytest.MonkeyPatch.context() as patch:
        if not getattr(request.module, "NEW_PROCESSES", False):
            patch.setattr(Child, "started", _copied)
        yield


def _copied(name: str, module: str, arguments: Sequence[str], **more: bool) -> Child:
    """Do what `Child.started` does; what is a command of pcpc is a copy."""
    if module != "pcpc.tools.cli":
        return _started(name, module, arguments, **more)
    stderr, nothing = tempfile.TemporaryFile(), os.open(os.devnull, os.O_RDWR)  # noqa: SIM115
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    words, files = [PROGRAMS["pcpc"], *arguments], [nothing, nothing, stderr.fileno()]
    process: Any = Copy(copies().address, words, Path.cwd(), environment, files)
    os.close(nothing)
    return Child(name, process, stderr)


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("tests of pcpc")
    group.addoption(
        "--deep",
        choices=("no", "only", "too"),
        help="tests that take long; default: no, but too where files are named",
    )
    group.addoption(
        "--write-seconds",
        action="store_true",
        help="after a run of all tests: write tests/seconds.csv, which says what is deep",
    )
    group.addoption("--changed", metavar="REF", help="only what a change since REF can reach")


def pytest_configure(config: pytest.Config) -> None:
    named = config.args_source is pytest.Config.ArgsSource.ARGS
    config.option.deep = config.option.deep or ("too" if named else "no")
    config.pluginmanager.register(_Seconds(config))


class _Seconds:
    """How long each test takes: for the order of the next run, and for what is deep."""

    def __init__(self, config: pytest.Config) -> None:
        self.config, self.spent, self.cases = config, Counter[str](), Counter[str]()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        function = report.nodeid.partition("[")[0]
        self.spent[function] += report.duration
        self.cases[function] += report.when == "call"

    def pytest_sessionfinish(self) -> None:
        cache = getattr(self.config, "cache", None)  # None in a worker, missing without its plugin
        if hasattr(self.config, "workerinput") or cache is None:
            return
        files = Counter[str]()
        for function, seconds in self.spent.items():
            files[function.partition("::")[0]] += seconds
        cache.set(_SECONDS, cache.get(_SECONDS, {}) | files)
        if self.config.option.write_seconds:
            rows = [f"all,{sum(self.spent.values()):.0f},{sum(self.cases.values())}"]
            for function, seconds in self.spent.most_common():
                file = self.config.rootpath / function.partition("::")[0]
                marked = "deep" in reach.marks_of_all(file.read_text(encoding="utf-8"))
                if seconds > SHARE * sum(self.spent.values()) and not marked:
                    name = function.rpartition("/")[2]
                    rows.append(f"{name},{seconds:.2f},{max(self.cases[function], 1)}")
            _COSTS.write_text("\n".join(["test,seconds,cases", *rows, ""]))


@cache
def _costs() -> dict[str, tuple[float, int]]:
    rows = [line.rsplit(",", 2) for line in _COSTS.read_text().splitlines()[1:]]
    return {name: (float(seconds), int(cases)) for name, seconds, cases in rows}


def _is_deep(item: pytest.Item, case: int) -> bool:
    """Return whether a test, the case-th of its function, is one of those that take long."""
    if item.get_closest_marker("quick"):
        return False
    if item.get_closest_marker("deep"):
        return True
    name = f"{item.path.name}::{item.nodeid.partition('::')[2].partition('[')[0]}"
    seconds, cases = _costs().get(name, (0.0, 1))
    return case * seconds / cases > SHARE * _costs()["all"][0]


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out, before it is imported, what no test is wanted of."""
    return reach.is_left_out(collection_path, config.option.deep, config.option.markexpr) or None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Choose, and put the longest files first; the others stay in their order."""
    for item in items:
        if isinstance(item, pytest.Function) and _starts_programs(item.module):
            item.add_marker(pytest.mark.paced)
    _choose(config, items)
    cached = getattr(config, "cache", None)
    known = cached.get(_SECONDS, {}) if cached is not None else {}
    items.sort(key=lambda item: -known.get(item.nodeid.partition("::")[0], 0.0))


def _choose(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is not asked for: deep tests, and what a change cannot reach."""
    cases: Counter[str] = Counter()
    chosen, left = [], []
    if config.option.changed:
        changed = reach.changed_files(config.option.changed)
        reached = cache(lambda path: reach.reached(path, changed))
    for item in items:
        function = item.nodeid.partition("[")[0]
        cases[function] += 1
        deep = _is_deep(item, cases[function])
        wanted = config.option.deep == "too" or deep == (config.option.deep == "only")
        wanted = wanted and (not config.option.changed or reached(item.path))
        (chosen if wanted else left).append(item)
    if left:
        config.hook.pytest_deselected(items=left)
        items[:] = chosen


@cache
def _starts_programs(module: ModuleType) -> bool:
    """Return whether a file uses one of the helpers that start programs."""
    used = list(vars(module).values())
    return any(
        getattr(name, "__name__" if isinstance(name, ModuleType) else "__module__", "")
        in STARTS_PROGRAMS
        for name in used
    )


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.set_threshold(10_000)  # of 700: what is kept, as trees of all sources are, is searched less
    gc.enable()
