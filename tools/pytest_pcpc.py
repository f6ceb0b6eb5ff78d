"""The pytest plugin: rigs in tests. It comes with pcpc; nothing is to be imported.

    def test_the_network_halves_the_error(simulate):
        pd, network = simulate("hull", "pd"), simulate("hull", "pd_nn_fast")
        assert network.metrics["error_rms_mrad"] < 0.5 * pd.metrics["error_rms_mrad"]

    @pytest.mark.paced
    def test_a_gain_acts(rig):
        with rig("hull", pacing="real") as live:
            live.set({"controller.kv_Nms_rad": 120.0})

    simulate    as `pcpc.simulate`; the log stays with the test
    rig         as `pcpc.running`: real processes, each on a bus of its own, so that `-n 8` works;
                `device=["./firmware", "{bus}"]` starts and ends a device in the executive's place
    bus         the name of a bus that nobody else has, for `--bus`

What pcpc refuses is a line in the report. If a test fails, its report names log, figure and what
was not met, and how to replay it. Metrics are properties of the test (`--junitxml`); with
pytest-html the figure stands in the page. A test fails if a run of it ended as a safety stop and it
did not ask for the verdict. A test marked `paced` that fails while the machine could not keep time
is repeated once, and says so, but not for want of a file, a bus or a name.
"""

import os
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from _pytest.runner import runtestprotocol

from pcpc.drivers.errors import Exit, UserError

if TYPE_CHECKING:
    import pcpc


@dataclass
class _Kept:
    """A run of a test; `asked`: whether the test knows what it came to."""

    rig: str
    folder: Path
    asked: Callable[[], bool] = lambda: True  # of one that did not begin


_RUNS = pytest.StashKey[list[_Kept]]()
_NOT_OF_TIME = pytest.StashKey[bool]()  # a test failed for a reason that no time mends
_OF_TIME = (AssertionError, pytest.fail.Exception, TimeoutError, subprocess.TimeoutExpired)
_OF_TIME_CODES = (Exit.NOT_MET, Exit.LOSS, Exit.SAFETY_STOP)
_STOPPED = Exit.SAFETY_STOP.meaning
_PROBE_S, _LATE_S = 0.3, 0.002
_WAKE_S = 0.001
_WAIT_S, _STOOD_S = 0.01, 0.02  # this much late, a thread that waits for nothing but the clock
_REASON = 200  # characters of a failure that is named with a repeated test
_REPEATED = "pcpc, paced"  # title of a report's section


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker."""
    config.addinivalue_line(
        "markers", "paced: keeps time; repeated once if it fails while the machine could not"
    )


@pytest.fixture
def simulate(request: pytest.FixtureRequest, tmp_path: Path) -> "Callable[..., pcpc.Run]":
    """Run a rig in virtual time, as `pcpc.simulate`; the log is kept with the test."""

    def run(rig: str | Path, controller: str | None = None, **options: Any) -> "pcpc.Run":
        import pcpc

        folder = options.pop("folder", None) or _folder(request, tmp_path, rig)
        kept = _Kept(str(rig), Path(folder))
        _kept_runs(request).append(kept)
        done = pcpc.simulate(rig, controller, folder=folder, quiet=True, **options)
        kept.asked = lambda: done.asked
        return done

    return run


@pytest.fixture
def rig(
    request: pytest.FixtureRequest, tmp_path: Path
) -> "Callable[..., AbstractContextManager[pcpc.Live]]":
    """Run a rig in real processes, as `pcpc.running`; the log is kept with the test."""

    @contextmanager
    def run(
        rig: str | Path, controller: str | None = None, **options: Any
    ) -> "Iterator[pcpc.Live]":
        import pcpc

        folder = options.pop("folder", None) or _folder(request, tmp_path, rig)
        kept = _Kept(str(rig), Path(folder))
        _kept_runs(request).append(kept)
        with pcpc.running(rig, controller, folder=folder, **options) as live:
            yield live
        kept.asked = lambda: live.asked

    return run


@pytest.fixture
def bus() -> Iterator[str]:
    """Keep a free bus for as long as the test lasts; its name, as --bus takes it."""
    from pcpc.drivers.can import choice  # time

    taken = choice.take_bus(choice.BusRequest("auto", None, "", ()))
    yield str(taken.bus)
    taken.release()


def _kept_runs(request: pytest.FixtureRequest) -> list[_Kept]:
    return request.node.stash.setdefault(_RUNS, [])


def _folder(request: pytest.FixtureRequest, tmp_path: Path, rig: str | Path) -> Path:
    """Return the folder of the test's next run."""
    return tmp_path / f"run-{len(_kept_runs(request)) + 1}-{Path(str(rig)).stem}"


# Reports


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
    """Add metrics, and of a failed test what there is to look at."""
    report = yield
    if call.excinfo is not None and report.failed:
        item.stash[_NOT_OF_TIME] = not _may_want_time(call.excinfo.value)
        if isinstance(call.excinfo.value, UserError):
            report.longrepr = call.excinfo.getrepr(style="value")  # a line, not how pcpc came to it
    if report.when != "call":
        return report
    runs = item.stash.get(_RUNS, None) or []
    for number, kept in enumerate(runs, 1):
        if (kept.folder / "log.mcap").is_file():
            _report(item, report, f"run {number}: {kept.rig}", kept)
    return report


def _may_want_time(error: BaseException) -> bool:
    """Return whether a test may have failed so because the machine did not keep time."""
    if isinstance(error, UserError) and not isinstance(error, AssertionError):
        return error.code in _OF_TIME_CODES
    return isinstance(error, _OF_TIME)


def _report(item: pytest.Item, report: pytest.TestReport, title: str, kept: _Kept) -> None:
    import pcpc

    folder = kept.folder
    lines = [f"log      {folder / 'log.mcap'}"]
    try:
        run = pcpc.open(folder)
        told = {"verdict": run.verdict, **run.metrics, **_requirements(run)}
        properties = [(f"{title}: {name}", value) for name, value in told.items()]
        item.user_properties += properties  # of the reports to come, as JUnit takes them
        report.user_properties += properties
        if run.verdict == _STOPPED:
            item.stash[_NOT_OF_TIME] = False  # whatever failed behind it
            if report.passed and not kept.asked():
                report.outcome, report.longrepr = "failed", _unseen_stop(title, run)
        if report.failed:
            lines += _verdict_lines(run)
            run.figure(path=folder / "figure.png")
            lines.append(f"figure   {folder / 'figure.png'}")
            _show(item, report, title, folder / "figure.png")
    except Exception as error:  # the test's outcome is what counts
        lines.append(f"but      {type(error).__name__}: {error}")
    lines.append(f"replay   pcpc replay {folder}")
    if report.failed:
        report.sections.append((f"pcpc, {title}", "\n".join(lines)))


def _unseen_stop(title: str, run: "pcpc.Run") -> str:
    """Return why a test failed that did not ask what its run came to."""
    why = "; ".join(run.result.reasons())
    cure = "assert `run.verdict` (`live.run.verdict`) where this is what the test wants"
    return f"{title}: {run.verdict}: {why}; {cure}"


def _requirements(run: "pcpc.Run") -> dict[str, str]:
    """Return what became of each requirement and limit that has an id."""
    result, words = run.result, {True: "met", False: "violated", None: "not judged"}
    if not result.ids and not any(one.id for one in result.requirements):
        return {}
    found = sorted(run.findings, key=lambda one: one.kind == "limit")  # in the order of old
    return {one.id: words[one.held] for one in found if one.id}


def _verdict_lines(run: "pcpc.Run") -> list[str]:
    """Return verdict, and what was not met."""
    return [f"verdict  {run.verdict}", *(f"         {line}" for line in run.result.problems())]


def _show(item: pytest.Item, report: Any, title: str, figure: Path) -> None:
    """Put the figure into the page of pytest-html, if it is there."""
    if item.config.pluginmanager.hasplugin("html"):
        from base64 import b64encode

        from pytest_html import extras

        picture = extras.png(b64encode(figure.read_bytes()).decode(), name=title)
        report.extras = [*getattr(report, "extras", []), picture]


# Tests that keep time


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Repeat a failed test marked `paced` once, if the machine could not keep time."""
    if item.get_closest_marker("paced") is None:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    reports, why = _reports(item, nextitem)
    if why:
        first = f"{why}; {_first_failure(reports)}"
        item.stash[_RUNS] = []
        item.session._setupstate.teardown_exact(None)  # what the module shares begins anew too
        item._initrequest()  # type: ignore[attr-defined]  # as a test that has not run
        reports, _ = _reports(item, nextitem)
        for report in reports:
            report.sections.append((_REPEATED, f"repeated once: {first}"))
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def _reports(item: pytest.Item, nextitem: pytest.Item | None) -> tuple[list[Any], str]:
    """Run a test; return its reports and, if it failed, why the machine could not keep time."""
    item.stash[_NOT_OF_TIME] = False
    with _Watch() as watch:
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
    failed = any(report.failed for report in reports)
    mended = failed and not item.stash.get(_NOT_OF_TIME, False)
    return reports, (watch.why or _cannot_keep_time()) if mended else ""


class _Watch(threading.Thread):
    """Waits for nothing but the clock while a test runs, and knows how late it ever was."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.why, self._worst_s, self._over = "", 0.0, threading.Event()

    def __enter__(self) -> "_Watch":
        self.start()
        return self

    def run(self) -> None:
        begin_s = time.monotonic()
        while not self._over.wait(_WAIT_S):
            now_s = time.monotonic()
            self._worst_s, begin_s = max(self._worst_s, now_s - begin_s - _WAIT_S), now_s

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self.join()
        if self._worst_s > _STOOD_S:
            self.why = f"the machine stood still for {1e3 * self._worst_s:.0f} ms"


def _first_failure(reports: list[Any]) -> str:
    """Return where and why the test failed before it was repeated, in a line."""
    failed = next(report for report in reports if report.failed)
    crash = getattr(failed.longrepr, "reprcrash", None)
    if crash is None:
        return f"its {failed.when} failed"
    reason = (crash.message.splitlines() or [""])[0]
    return f"it had failed at {Path(crash.path).name}:{crash.lineno}: {reason[:_REASON]}"


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Name the tests that were repeated and why, so that none is repeated for ever unseen."""
    found = {
        f"{report.nodeid}: {text}"
        for reports in terminalreporter.stats.values()
        for report in reports
        for title, text in getattr(report, "sections", ())
        if title == _REPEATED
    }
    if found:
        terminalreporter.section("tests that keep time")
        for line in sorted(found):
            terminalreporter.line(line)


def _cannot_keep_time() -> str:
    """Return why this machine cannot keep time at present; "" if it can."""
    worst_s, end_s = 0.0, time.monotonic() + _PROBE_S
    while (begin_s := time.monotonic()) < end_s:
        time.sleep(_WAKE_S)
        worst_s = max(worst_s, time.monotonic() - begin_s - _WAKE_S)
    if worst_s > _LATE_S:
        return f"a sleep of 1 ms took {1e3 * (worst_s + _WAKE_S):.1f} ms"
    with suppress(OSError):
        load, processors = os.getloadavg()[0], len(os.sched_getaffinity(0))
        if load > processors:
            return f"{load:.1f} programs want {processors} processors"
    return ""
