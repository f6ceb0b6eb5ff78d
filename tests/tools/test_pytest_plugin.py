"""The plugin for pytest, in a pytest of its own: fixtures, reports of failures, repetition."""

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from copies import program
from processes import RIGS

from pcpc.drivers.compiled import compile_cache

pytestmark = pytest.mark.deep

pytest_plugins = ["pytester"]
CACHES = compile_cache.user_cache()  # pytester's home is an empty one
SIMULATED = """
def test_it_is_judged(simulate):
    run = simulate("slew10")
    assert run.metrics["muzzle_error_rms_mrad"] {relation} 0.0
"""
LIVE = """
import pytest
KEPT = {{"duration_s": 600}} | dict.fromkeys(
    ("supervisor.hold_cycles", "supervisor.fault_after_cycles"), 10**6
)

@pytest.mark.parametrize("gain", [{gains}])
def test_a_gain_acts(rig, gain):
    with rig("slew10", pacing="real", set=KEPT) as live:
        cycle = live.set({{"controller.kv_Nms_rad": gain}})
        live.wait_until(lambda now: now["time.t_s"] > 1e-3 * (cycle + 20), within_s=120)
    at = [e["value"] for e in live.run.events if e.get("name") == "controller.kv_Nms_rad"]
    assert at == [gain]
"""


@pytest.fixture(autouse=True)
def compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(CACHES))


def run(pytester: pytest.Pytester, *words: str) -> pytest.RunResult:
    """Run pytest in a copy, see `copies`."""
    return pytester.run(program("pytest"), "-p", "pytester", "--basetemp=kept", *words)


def test_metrics_of_a_run_are_properties_of_its_test(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(SIMULATED.format(relation=">"))
    run(pytester, "--junitxml=junit.xml").assert_outcomes(passed=1)
    found = ElementTree.parse(pytester.path / "junit.xml").iter("property")
    properties = {one.get("name"): one.get("value") for one in found}
    assert properties["run 1: slew10: verdict"] == "ok"
    value = properties["run 1: slew10: muzzle_error_rms_mrad"]
    assert value is not None and 3.1 < float(value) < 3.8


def test_a_failed_test_names_log_figure_and_replay(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(SIMULATED.format(relation="<"))
    result = run(pytester)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*pcpc, run 1: slew10*", "log *", "verdict *ok", "replay *"])
    text = result.stdout.str()
    for word in ("log", "figure"):
        found = re.search(rf"^{word} +(\S+)$", text, re.MULTILINE)
        assert found and Path(found[1]).is_file(), text


def test_what_a_rig_lacks_is_a_line_and_can_be_expected(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        "import pcpc, pytest\n"
        "def test_refused(simulate):\n    simulate('slew10', set={'barrel.gapp': 1})\n"
        "def test_not_ok(simulate):\n"
        "    simulate('slew10', set={'expect.pd.muzzle_error_rms_mrad': [0.0, 1e-9]}).check()\n"
        "def test_expected(simulate):\n"
        "    with pytest.raises(pcpc.Error):\n        simulate('slew11')\n"
    )
    result = run(pytester)
    result.assert_outcomes(failed=2, passed=1)
    text = result.stdout.str().partition("= FAILURES =")[2].partition("= short test")[0]
    lines = [line for line in text.splitlines() if "did you mean gap_rad" in line]
    assert len(lines) == 1 and "Traceback" not in text and "def run(" not in text, text
    assert "muzzle_error_rms_mrad = " in text and "raise NotOk" not in text, text


@pytest.mark.parametrize(("why", "outcome"), [("a sleep took long", "passed"), ("", "failed")])
def test_a_paced_test_is_repeated_once_if_the_machine_cannot_keep_time(
    pytester: pytest.Pytester, why: str, outcome: str
) -> None:
    pytester.makeconftest(
        f"from pcpc.tools import pytest_pcpc as p\np._cannot_keep_time = lambda: {why!r}\n"
        "p._STOOD_S = 1e9"  # this machine, too, may stand still
    )
    pytester.makepyfile(
        "import pytest, pathlib\nmade = []\n"
        "@pytest.fixture(scope='module')\ndef shared():\n    made.append(1)\n    return len(made)\n"
        "@pytest.mark.paced\ndef test_it(shared):\n    assert shared == 2\n"
        "def test_next(shared):\n    assert shared == len(made)\n"
    )
    result = run(pytester, "-n", "1", "-p", "no:cacheprovider")
    result.assert_outcomes(**{"passed": 1} | ({"passed": 2} if why else {outcome: 1}))
    named = [line for line in result.stdout.lines if "::test_it: repeated once: a sleep" in line]
    assert len(named) == bool(why), result.stdout.str()
    assert all("; it had failed at test_" in line and ": assert 1 == 2" in line for line in named)


OF_ANY_KIND = """
import pathlib, pytest, subprocess, pcpc
from pcpc.drivers.errors import BusError, Exit, UserError
MISSED = {"expect.pd.muzzle_error_rms_mrad": [0.0, 1e-9]}
"""
NOT_OF_TIME = (
    "pathlib.Path('no such').read_text()", "raise BusError('vcan7: no such interface')",
    "simulate('no-such-rig')", "simulate('slew10', set={'barrel.gapp': 1})",
    "import no_such_module", "no_such_name", "{}['key']", "raise OSError(19, 'No such device')",
)  # fmt: skip
OF_TIME = (
    "assert False", "pytest.fail('late')", "raise TimeoutError",
    "raise subprocess.TimeoutExpired('pcpc', 1.0)", "simulate('slew10', set=MISSED).check()",
    "raise UserError('it stopped', Exit.SAFETY_STOP)", "raise UserError('lost', Exit.LOSS)",
)  # fmt: skip


def test_only_what_may_come_of_want_of_time_is_repeated(pytester: pytest.Pytester) -> None:
    pytester.makeconftest(
        "from pcpc.tools import pytest_pcpc as p\np._cannot_keep_time = lambda: 'it was busy'"
    )
    bodies = {f"test_never_{i}": body for i, body in enumerate(NOT_OF_TIME)}
    bodies |= {f"test_again_{i}": body for i, body in enumerate(OF_TIME)}
    tests = [
        f"@pytest.mark.paced\ndef {name}(simulate):\n    {body}\n" for name, body in bodies.items()
    ]
    pytester.makepyfile("".join([OF_ANY_KIND, *tests]))
    result = run(pytester, "-p", "no:cacheprovider")
    result.assert_outcomes(failed=len(bodies))
    named = re.findall(r"::(\w+): repeated once: ", result.stdout.str())
    assert set(named) == {name for name in bodies if "again" in name}, result.stdout.str()


STOPPED = """
def test_unseen(simulate):
    simulate("own.yaml")
def test_metrics_alone(simulate):
    assert simulate("own.yaml").metrics is not None
def test_unseen_on_a_bus(rig):
    with rig("own.yaml", pacing="lockstep") as live:
        live.wait(240)
def test_known(simulate):
    assert simulate("own.yaml").verdict == "safety stop"
def test_known_by_its_summary(simulate):
    assert simulate("own.yaml").summary["faults"]
def test_known_on_a_bus(rig):
    with rig("own.yaml", pacing="lockstep") as live:
        live.wait(240)
    assert live.run.verdict == "safety stop"
def test_ok(simulate):
    assert simulate("slew10", set={"duration_s": 0.2}).metrics is not None
"""


def test_a_run_that_ended_as_a_safety_stop_is_not_passed_over(pytester: pytest.Pytester) -> None:
    fault = "faults: {gone: {kind: loss, frame: FB_A, from: 100ms}}\n"
    (pytester.path / "own.yaml").write_text(f"base: {RIGS / 'slew10.yaml'}\n{fault}")
    pytester.makepyfile(STOPPED)
    result = run(pytester)
    result.assert_outcomes(failed=3, passed=4)
    text = result.stdout.str()
    assert text.count("run 1: own.yaml: safety stop: ") >= 3, text
    assert set(re.findall(r"^FAILED \S+::test_(\w+)", text, re.MULTILINE)) == {
        "unseen", "metrics_alone", "unseen_on_a_bus",
    }, text  # fmt: skip


def test_a_machine_that_stood_still_during_a_test_is_named_though_it_does_not_after(
    pytester: pytest.Pytester,
) -> None:
    pytester.makeconftest(
        "from pcpc.tools import pytest_pcpc as p\np._cannot_keep_time = lambda: ''\np._WAIT_S = 0.5"
    )
    pytester.makepyfile(
        "import os, pytest, signal, subprocess, sys, time\n"
        "STOP = 'import os,signal,sys,time;p=int(sys.argv[1]);os.kill(p,signal.SIGSTOP);'\\\n"
        "       'time.sleep(0.7);os.kill(p,signal.SIGCONT)'\n"
        "@pytest.mark.paced\n@pytest.mark.parametrize('still', [True, False])\n"
        "def test_it(still):\n"
        "    if still:\n"
        "        subprocess.run([sys.executable, '-c', STOP, str(os.getpid())])\n"
        "    assert False\n"
    )
    result = run(pytester, "-p", "no:cacheprovider")
    result.assert_outcomes(failed=2)
    named = [line for line in result.stdout.lines if ": repeated once: the machine stood" in line]
    assert len(named) == 1 and "test_it[True]" in named[0], result.stdout.str()


def test_rigs_run_side_by_side_each_on_a_bus_of_its_own(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(LIVE.format(gains="81.0, 82.0, 83.0, 84.0"))
    run(pytester, "-n", "4", "-p", "no:cacheprovider").assert_outcomes(passed=4)


def test_a_bus_is_held_for_one_test_at_a_time(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        "from pcpc.drivers.can import choice\n"
        "def test_it(bus):\n"
        "    other = choice.take_bus(choice.BusRequest('auto', None, '', ()))\n"
        "    assert ':' in bus and str(other.bus) != bus\n"
        "    other.release()\n"
    )
    run(pytester).assert_outcomes(passed=1)


def test_what_became_of_an_id_is_a_property_of_its_test(pytester: pytest.Pytester) -> None:
    rig = pytester.path / "own.yaml"
    rig.write_text(
        f"base: {RIGS / 'slew10.yaml'}\nrequire:\n"
        "  - {id: R-1, never: abs(controller.e_rad) > 1000}\n"
        "  - {id: R-2, always: time.t_s < 1}\n"
        "  - {id: R-3, when: time.t_s > 1000, then: time.t_s > 0}\n"
        "  - {name: R-5 hub_error_max_mrad at rest, always: time.t_s < 1}\n"
        "expect: {pd: {muzzle_error_rms_mrad: {low: 0, high: 1.0e-9, id: R-4}, "
        "hub_error_max_mrad: {low: 0, id: R-5}}}\n"
    )
    pytester.makepyfile(f"def test_it(simulate):\n    simulate({str(rig)!r})\n")
    run(pytester, "--junitxml=junit.xml").assert_outcomes(passed=1)
    found = ElementTree.parse(pytester.path / "junit.xml").iter("property")
    told = {str(one.get("name")).rpartition(": ")[2]: one.get("value") for one in found}
    known = {name: word for name, word in told.items() if name.startswith("R-")}
    assert known == {
        "R-1": "met", "R-2": "violated", "R-3": "not judged", "R-4": "violated", "R-5": "met",
    }  # fmt: skip
