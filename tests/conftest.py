"""Of all tests: what they import stays, and is not searched for garbage again and again.

The files that take longest come first, so that in the end no processor waits for one of them. The
tests of a file that starts programs as a user does are `paced`: such programs keep time by the
machine's clock, and one that fails while the machine could not is repeated once, and named. Their
commands are copies, which spares a second of processor time each. Hypothesis judges no test by the
time that it took.
"""

import gc
import os
import tempfile
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from copies import PROGRAMS, Copy, copies
from hypothesis import HealthCheck, settings

from pcpc.tools.start.children import Child

LONGEST = [  # in turn
    "test_pytest_plugin", "test_pages", "test_ci", "test_neural_controllers", "test_memory",
    "test_virtual", "test_stalls", "test_cluster", "test_logs_damage", "test_run", "test_replay",
    "test_compare_versions", "test_supervisor_model", "test_every_rig", "test_hostile_logs",
    "test_golden", "test_mutants", "test_hangs", "test_kills", "test_kept_code", "test_api",
    "test_bench_suites", "test_monitors", "test_jitter", "test_soak", "test_play", "test_trial",
    "test_campaign", "test_verdict", "test_check", "test_outside", "test_judge", "test_ending",
    "test_wrong_input", "test_wheel",
]  # fmt: skip

STARTS_PROGRAMS = {
    "processes", "hosting", "live_run", "playing", "copies", "paging", "two_processes", "free_bus",
    "live", "blocks", "pcpc.tools.start.children",
}  # fmt: skip

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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first; the others stay in their order."""
    order = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.stem, len(order)))
    for item in items:
        if isinstance(item, pytest.Function) and _starts_programs(item.module):
            item.add_marker(pytest.mark.paced)


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
