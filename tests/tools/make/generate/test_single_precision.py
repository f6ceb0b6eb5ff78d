"""Laws with floats: the elementary functions' errors, no double left, what a closed loop loses."""

import ctypes
import re
import shutil
import subprocess
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage
from pcpc.executive.rig import law_lookup
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main
from pcpc.tools.make.generate import builds, precision, single
from pcpc.tools.make.generate.cli import block_of
from pcpc.tools.make.generate.cost import step_cost
from pcpc.tools.make.generate.library import WARNINGS, Library, run, write
from pcpc.tools.make.generate.translator import elementary
from pcpc.tools.make.generate.translator.kinds import Untranslatable
from pcpc.tools.make.generate.translator.law import law_files
from pcpc.tools.start.rigs import find

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here: apt install gcc")

_ALL = """
#include "pcpc_mathf.h"
void all(int32_t count, const float *x, float (*y)[9])
{
    for (int32_t i = 0; i < count; i += 1) {
        y[i][0] = pcpc_expf(x[i]);
        y[i][1] = pcpc_expmsqf(x[i]);
        y[i][2] = pcpc_tanhf(x[i]);
        y[i][3] = pcpc_logisticf(x[i]);
        pcpc_sincosf(x[i], &y[i][4], &y[i][5]);
        y[i][6] = pcpc_sqrtf(x[i]);
        y[i][7] = pcpc_soft_sqrtf(x[i]);
        y[i][8] = pcpc_floorf(x[i]);
    }
}
"""
_STATED = {"exp": 0.98, "expmsq": 0.91, "tanh": 1.31, "logistic": 2.41, "sin": 0.84, "cos": 0.84,
           "sqrt": 0.5, "soft_sqrt": 0.5, "floor": 0.0}  # fmt: skip


def _ulps(mine: Any, exact: Any) -> Any:
    """Return |mine - exact| in units of the last place of a float; 0 where both are no number."""
    rounded = exact.astype(np.float32)
    unit = np.maximum(np.spacing(np.abs(rounded)).astype(np.float64), 2.0**-149)
    found = np.abs(mine.astype(np.float64) - exact) / unit
    odd = ~np.isfinite(rounded)
    return np.where(odd, np.where(np.array_equal(mine[odd], rounded[odd], True), 0.0, 9.0), found)


def test_each_function_is_as_near_as_its_header_says(tmp_path: Path) -> None:
    sources = write({**single.files(), "all.c": _ALL}, tmp_path)
    run(["gcc", *elementary.FLAGS, "-O2", "-shared", "-fPIC", "-o", tmp_path / "all.so", *sources])
    x = np.arange(0, 2**32, 30011, dtype=np.uint64).astype(np.uint32).view(np.float32)
    x = x[~np.isnan(x)]
    y = np.zeros((len(x), 9), np.float32)
    library = ctypes.CDLL(str(tmp_path / "all.so"))
    library.all(len(x), x.ctypes.data_as(ctypes.c_void_p), y.ctypes.data_as(ctypes.c_void_p))
    d = x.astype(np.float64)
    with np.errstate(all="ignore"):
        near = np.abs(d) <= 12867.0
        exact = [np.exp(d), np.exp(-d * d), np.tanh(d), 1.0 / (1.0 + np.exp(-d)),
                 np.where(near, np.sin(d), np.nan), np.where(near, np.cos(d), np.nan),
                 np.sqrt(d), np.sqrt(d), np.floor(d)]  # fmt: skip
        worst = {name: float(np.max(_ulps(y[:, i], exact[i]))) for i, name in enumerate(_STATED)}
    assert all(worst[name] <= limit for name, limit in _STATED.items()), worst
    assert worst["exp"] > 0.5, "the float next to the exact number everywhere: what was compared?"


def _laws(folder: Path) -> list[Path]:
    """Write all laws of the project with floats."""
    found = single.files()
    for law, module in law_lookup.shipped_laws().items():
        name = "references:sine" if law == "references" else law
        if law == "references" or hasattr(import_module(module), "BLOCK"):  # else a part of laws
            found |= single.single_precision(law_files(*block_of(name)))
    return write(found, folder)


def test_no_law_has_a_warning_or_a_double_left(tmp_path: Path) -> None:
    sources = _laws(tmp_path)
    assert len(sources) > 20, sources
    run(["gcc", *elementary.FLAGS, *WARNINGS, "-Wunsuffixed-float-constants", "-Wno-pedantic",
         "-fsyntax-only", *sources])  # fmt: skip
    code = re.sub(r"/\*.*?\*/", "", "\n".join(p.read_text() for p in sources), flags=re.DOTALL)
    assert not re.search(r"\bdouble\b", code)


def test_a_cortex_m4_calls_nothing_to_step_a_network_with_floats(tmp_path: Path) -> None:
    gcc = shutil.which("arm-none-eabi-gcc")
    if gcc is None:
        pytest.skip("no compiler for Arm here: make firmware-tools")
    assert main(["generate", "c", "hull", "--controller", "pd_nn_fast", "--single", "-o",
                 str(tmp_path)]) == 0  # fmt: skip
    run([gcc, *elementary.FLAGS, *WARNINGS, "-O2", "-mcpu=cortex-m4", "-mthumb", "-nostdlib",
         "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-fno-tree-loop-distribute-patterns", "-r", "-o",
         tmp_path / "all.o", *tmp_path.glob("*.c")])  # fmt: skip
    symbols = run(["arm-none-eabi-nm", tmp_path / "all.o"])
    assert " T hull_rig_step\n" in symbols
    assert set(re.findall(r" U (\w+)", symbols)) <= {"memcpy", "memset"}, symbols


@pytest.mark.parametrize(
    ("flags", "code"), [(("-O2",), 0), (("-O2", "-mfma", "-ffp-contract=fast"), 1)]
)
def test_a_build_with_other_bits_is_refused(
    flags: tuple[str, ...], code: int, tmp_path: Path
) -> None:
    if code and "fma" not in Path("/proc/cpuinfo").read_text().split():
        pytest.skip("this processor has no FMA")
    text = '#include "pcpc_mathf.h"\nint main(void) { return pcpc_selftestf(); }\n'
    sources = write({**single.files(), "main.c": text}, tmp_path)
    run(["gcc", *elementary.FLAGS, *flags, "-o", tmp_path / "main", *sources])
    assert subprocess.run([str(tmp_path / "main")]).returncode == code


def test_all_builds_agree_and_the_loop_in_float_is_near_that_in_double(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["fuzzy-d01", "--controller", "fuzzy", "--single", "--check", "--cycles", "20", "-q"]
    assert main(["generate", "c", *words]) == 0
    told = capsys.readouterr().out
    assert len(set(re.findall(r" ([0-9a-f]{16})  equal\n", told))) == 1, told
    row = next(line for line in told.splitlines() if line.startswith("fuzzy "))
    rms, _, double, in_single = map(float, row.split()[1:5])
    assert 0.0 < rms < 1e-4, told
    assert in_single == pytest.approx(double, rel=1e-3), told


class _Slow(Ports):
    near, far, gone = port("", "1"), port("", "1e9 times more"), port("", "no number")


def _creep(t: float, dt: float, p: Nothing, x: _Slow, u: Nothing, y: _Slow) -> None:
    """Three sums that grow by the same."""
    x.near += 1.0
    x.far += 1.0
    x.gone += 0.0
    y.near = x.near


def test_changes_that_a_float_cannot_take_are_counted(tmp_path: Path) -> None:
    block = Block(stage(_creep))
    library = Library({"law": block}, tmp_path, entry=precision.counting_adapter)
    kinds = [ctypes.c_void_p] * 2 + [ctypes.c_double] * 2 + [ctypes.c_void_p] * 4
    step = ctypes.CFUNCTYPE(ctypes.c_int32, *kinds)(library.entry("law"))
    none, x, y = np.zeros(1), np.array([0.0, 1e9, np.nan]), np.zeros(3)
    for k in range(10):
        step(None, None, float(k), 1.0, *(one.ctypes.data for one in (none, x, none, y)))
    assert library.counts("law_changed", 3) == [10, 10, 0]
    assert library.counts("law_lost", 3) == [0, 10, 0]
    assert x[1] == 1e9 + 10


def test_floats_cost_a_cortex_m4_what_a_cortex_m7_pays(capsys: pytest.CaptureFixture[str]) -> None:
    build = next(one for one in builds.builds() if one.name.startswith("Cortex-M4"))
    if not build.possible:
        pytest.skip(f"no Cortex-M4 here: {build.cure}")
    rig = load_rig(Path(find("probe")), None)
    instructions, _ = step_cost(rig, "Cortex-M4", 20, True)
    assert 10 <= instructions <= 60, instructions
    assert main(["generate", "c", "pid", "--cost", "--cycles", "5", "-q"]) == 0
    told = capsys.readouterr().out
    rows = {tuple(line.split()[1:3]): line.split()[3] for line in told.splitlines()[1:]}
    most = {key: int(text.replace(",", "")) for key, text in rows.items()}
    assert most["Cortex-M4", "float"] == pytest.approx(most["Cortex-M7", "float"], rel=0.1), told
    assert most["Cortex-M4", "double"] > 5 * most["Cortex-M4", "float"], told


def test_numbers_beyond_a_float_are_the_largest_or_refused() -> None:
    assert single.literal("1e300", "law.c") == "3.4028235e+38f"
    assert single.single_precision({"law.c": "x /* 0.5 double */ = 0.5 * pcpc_exp(y);"}) == {
        "law.c": "x /* 0.5 double */ = 0.5f * pcpc_expf(y);"
    }
    with pytest.raises(Untranslatable, match=r"law\.c: 1e-60 is 0 in single precision"):
        single.literal("1e-60", "law.c")


def test_a_device_with_floats_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["generate", "c", "probe", "--single", "--device"]) == 2
    assert "leave out --device or --single" in capsys.readouterr().err
