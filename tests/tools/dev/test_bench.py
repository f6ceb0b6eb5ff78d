"""The steps in C, generated and by hand: the same bits as in Python."""

import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.atb1000.ports import Outputs
from pcpc.tools.dev.bench import generated, steps
from pcpc.tools.dev.bench.steps import LAWS, PERIODS, Case, c_library, in_c, in_python
from pcpc.tools.machine.jitter.compiler import CompilerError
from pcpc.tools.terminal.progress import Progress

STEPS = (*LAWS, "barrel")
FEW = 200
LOGGED = dict.fromkeys(LAWS, ("executive", "controller.motor_torque_Nm", 0))
HUB_RATE = [port.name for port in Outputs.ports].index("hub_rate_rad_s")
LOGGED |= {"barrel": ("plant", "barrel.hub_rate_rad_s", HUB_RATE)}
LIBM_RELATIVE = 1e-9  # of each output's largest value; libm differs in last bits, the laws amplify


@pytest.fixture
def compiler(request: pytest.FixtureRequest) -> None:
    if shutil.which("cc") is None:
        request.applymarker(pytest.mark.xfail(reason="no C compiler", raises=CompilerError))


@cache
def recorded(name: str) -> Case:
    return steps.record(name if name in LAWS else "pd")[name]


def trace(case: Case, drive: steps.Drive) -> np.ndarray:
    """Return outputs and states after each of growing numbers of periods, the whole run last."""
    counts = [*range(1, FEW + 1), PERIODS]
    rows = []
    for count in counts:
        drive(1, count)
        rows.append(np.concatenate([case.outputs(), case.states()]))
    return np.array(rows)


def differing(ours: np.ndarray, theirs: np.ndarray) -> list[int]:
    """Return the columns of two traces whose bits differ."""
    return np.flatnonzero((ours.view(np.int64) != theirs.view(np.int64)).any(axis=0)).tolist()


@pytest.mark.parametrize("name", STEPS)
def test_c_with_the_same_functions_gives_the_bits_of_python(name: str, compiler: None) -> None:
    case = recorded(name)
    ours, c = (trace(case, drive) for drive in (in_python(case), in_c(case, c_library())))
    assert np.ptp(ours[:, 0]) > 0.0 and np.isfinite(ours).all()
    differ = differing(ours, c)
    assert not differ, f"outputs, then states {differ} differ from C"


@pytest.mark.parametrize("name", generated.WRITTEN_TWICE)
def test_a_law_by_hand_gives_the_bits_of_python_and_of_its_generated_c(
    name: str, compiler: None
) -> None:
    case, c = recorded(name), generated.c_library()
    drives = in_python(case), in_c(case, c), in_c(case, c, f"{name}_by_hand")
    kept = [
        port.recorded or port.name in ("w", "v")
        for port in case.block.states
        for _ in range(port.size)
    ]
    shown = np.array([True] * len(case.outputs()) + kept)  # C by hand has its scratch on the stack
    ours, own, hand = (trace(case, drive) for drive in drives)
    assert not differing(ours, own) and not differing(ours[:, shown], hand[:, shown])


@pytest.mark.parametrize("name", STEPS)
def test_c_with_libm_agrees_with_python_over_200_periods(name: str, compiler: None) -> None:
    case = recorded(name)
    drives = in_python(case), in_c(case, c_library(libm=True))
    ours, c = (trace(case, drive)[:FEW] for drive in drives)
    largest = np.abs(ours).max(axis=0)
    worst = np.max(np.abs(ours - c) / np.where(largest > 0.0, largest, 1.0))
    assert worst < LIBM_RELATIVE, f"{name}: {worst:.1e} of an output's or a state's largest value"


@pytest.mark.parametrize("name", STEPS)
def test_the_recorded_inputs_give_the_commands_of_the_run(name: str) -> None:
    case = recorded(name)
    node, variable, column = LOGGED[name]
    run = in_memory(load_rig(steps.RIG, name if name in LAWS else "pd", ["duration_s=0.3"]))
    logged = run.node[node].columns[variable][:FEW]
    ours = trace(case, in_python(case))[:FEW, column]
    wrong = np.flatnonzero(ours != logged)
    assert np.ptp(logged) > 0.0 and not len(wrong), f"other {variable} in cycles {wrong[:5]}"


def test_without_a_compiler_the_cure_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(CompilerError, match="no C compiler on PATH; `apt-get install gcc`"):
        steps.measure(Progress(quiet=True), rounds=1)
