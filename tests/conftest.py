"""Of all tests: what they import stays, and is not searched for garbage again and again.

`deep` tests take long for what they find: `make test` leaves them out, `make test-all` has them,
and so has pytest where it is given files. `deep(but=2)` is deep but for its first two cases. The
files that took longest the last time come first: in the end no processor waits for one of them.
The tests of a file that starts programs as a user does are `paced`: such programs keep time by the
machine's clock, and one that fails while the machine could not is repeated once, and named. Their
commands are copies, which spares a second of processor time each. Hypothesis judges no test by the
time that it took.
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
from copies import PROGRAMS, Copy, copies
from hypothesis import HealthCheck, settings

from pcpc.tools.start.children import Child

STARTS_PROGRAMS = {
    "processes", "hosting", "live_run", "playing", "copies", "paging", "two_processes", "free_bus",
    "live", "blocks", "pcpc.tools.start.children",
}  # fmt: skip

_SECONDS = "pcpc/seconds"
_started = Child.started

gc.disable()
settings.register_profile("any speed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any speed")


@pytest.fixture(scope="module", autouse=True)
def _commands_are_copies(request: pytest.FixtureRequest) -> Iterator[None]:
    """Let `pcpc.running` start copies, see `copies`, but in a file that says NEW_PROCESSES."""
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
    group.addoption("--deep", choices=("no", "only", "too"), help="tests that take long; default: "
                    "no, but too where files are named")  # fmt: skip
    group.addoption("--changed", metavar="REF", help="only what a change since REF can reach")


def pytest_configure(config: pytest.Config) -> None:
    named = config.args_source is pytest.Config.ArgsSource.ARGS
    config.option.deep = config.option.deep or ("too" if named else "no")
    config.pluginmanager.register(_Seconds(config))


class _Seconds:
    """How long each file takes, for the order of the next run."""

    def __init__(self, config: pytest.Config) -> None:
        self.config, self.found = config, Counter[str]()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.found[report.nodeid.partition("::")[0]] += report.duration

    def pytest_sessionfinish(self) -> None:
        if not hasattr(self.config, "workerinput") and self.config.cache is not None:
            self.config.cache.set(_SECONDS, self.config.cache.get(_SECONDS, {}) | self.found)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Choose, and put the longest files first; the others stay in their order."""
    for item in items:
        if isinstance(item, pytest.Function) and _starts_programs(item.module):
            item.add_marker(pytest.mark.paced)
    _choose(config, items)
    known = config.cache.get(_SECONDS, {}) if config.cache is not None else {}
    items.sort(key=lambda item: -known.get(item.nodeid.partition("::")[0], 0.0))


def _choose(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what is not asked for: deep tests, and what a change cannot reach."""
    cases: Counter[str] = Counter()
    chosen, left = [], []
    if config.option.changed:
        changed = reach.changed_files(config.option.changed)
        reached = cache(lambda path: reach.reached(path, changed))
    for item in items:
        mark, function = item.get_closest_marker("deep"), item.nodeid.partition("[")[0]
        cases[function] += 1
        deep = mark is not None and cases[function] > mark.kwargs.get("but", 0)
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
    gc.enable()
