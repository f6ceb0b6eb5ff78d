"""`--minutes N`: no test begins later, and what was not run is told; what has to be run is first.

The others come in an order that is another one each day, so that all have their turn.
"""

import hashlib
import time
from collections import Counter
from datetime import UTC, datetime
from typing import Any

import pytest

FIRST = ("tests/contract/", "tests/executive/loop/", "tests/tools/dev/", "tests/golden/")
_KEY = "not_run"


def turn(path: str, day: str | None = None) -> tuple[int, str]:
    """Return the place of a file in the order of a day (UTC): FIRST, then drawn by the day."""
    day = day or datetime.now(UTC).date().isoformat()
    drawn = hashlib.sha256(f"{day} {path}".encode()).hexdigest()
    return next((i for i, first in enumerate(FIRST) if path.startswith(first)), len(FIRST)), drawn


def pytest_addoption(parser: pytest.Parser) -> None:
    """Take the option."""
    group = parser.getgroup("tests of pcpc")
    group.addoption("--minutes", metavar="N", type=float, help="begin no test later; say which")


def pytest_configure(config: pytest.Config) -> None:
    """Watch the time."""
    if config.option.minutes is not None:
        config.pluginmanager.register(_Deadline(config))


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put the files in the order of the day."""
    if config.option.minutes is not None:
        items.sort(key=lambda item: turn(item.nodeid.partition("::")[0]))


class _Deadline:
    """Lets no test begin behind its minutes."""

    def __init__(self, config: pytest.Config) -> None:
        self._config, self._minutes = config, float(config.option.minutes)
        self._end_s = time.monotonic() + 60.0 * self._minutes
        self._not_run = Counter[str]()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> bool | None:
        """Leave out a test whose time is over."""
        if time.monotonic() < self._end_s:
            return None
        self._not_run[item.nodeid.partition("::")[0]] += 1
        return True

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self) -> None:
        """Hand on what a worker has not run."""
        if hasattr(self._config, "workeroutput"):
            self._config.workeroutput[_KEY] = dict(self._not_run)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Take what a worker has not run."""
        self._not_run.update(getattr(node, "workeroutput", {}).get(_KEY, {}))

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Say what was not run."""
        if self._not_run:
            what = f"{self._not_run.total()} tests of {len(self._not_run)} files"
            why = f"{self._minutes:g} minutes were over"
            terminalreporter.write_line(f"NOT RUN: {what}, as {why}; another day has other ones:")
            for path, number in sorted(self._not_run.items()):
                terminalreporter.write_line(f"  {number:4} {path}")
