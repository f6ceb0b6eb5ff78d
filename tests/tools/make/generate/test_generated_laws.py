"""C from laws: it compiles without a warning, and gives the bits of Python."""

import ctypes
import hashlib
import importlib.util
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcpc.executive.laws.block import Block, Nothing, Ports, inline, port, stage
from pcpc.executive.laws.emath import clip, sin, where
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.own_laws.preparation import prepared_values
from pcpc.executive.rig.reading import load_rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.make.generate.library import Library, in_place, run, write
from pcpc.tools.make.generate.translator import elementary, points
from pcpc.tools.make.generate.translator.kinds import Untranslatable
from pcpc.tools.make.generate.translator.law import law_files, signature

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here: apt install gcc")

_SPEC = importlib.util.spec_from_file_location(
    "golden_runs", Path(__file__).parents[3] / "golden/golden.py"
)
assert _SPEC is not None and _SPEC.loader is not None
golden = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(golden)
RUNS = {name: (file, controller) for name, file, controller in golden.rigs()}
ROUGH = "atb1000/rough"  # a plant in parts that are off elsewhere
A_RUN_OF_EACH_PLANT = {name.partition("/")[0]: name for name in RUNS if name != ROUGH}
ODD = (float("nan"), float("inf"), -float("inf"), 0.0, -0.0, 5e-324, 1e308)


@pytest.mark.parametrize("name", [*A_RUN_OF_EACH_PLANT.values(), ROUGH])
def test_a_golden_run_with_every_step_in_c_has_the_blessed_bits(name: str, tmp_path: Path) -> None:
    rig = load_rig(*RUNS[name])
    virtual = VirtualRun(rig, None, check=in_place(tmp_path, ["-O0"]))
    for _ in virtual.advance():
        pass
    digest = hashlib.sha256()
    for node in virtual.memory.log().node.values():
        digest.update(np.stack(list(node.columns.values())).tobytes())
    plant, _, rig_name = name.partition("/")
    assert digest.hexdigest() == golden.blessed(plant)[rig_name]["sha256"]


def _in_c(block: Block, folder: Path) -> Any:
    kinds = [ctypes.c_void_p] * 2 + [ctypes.c_double] * 2 + [ctypes.c_void_p] * 4
    return ctypes.CFUNCTYPE(ctypes.c_int32, *kinds)(Library({"law": block}, folder).entry("law"))


def _vectors(block: Block, values: Any) -> list[np.ndarray[Any, Any]]:
    states = np.array([value for _, value in values[1]])
    sizes = (block.size(block.inputs), block.size(block.outputs))
    return [np.array([value for _, value in values[0]]), states, *map(np.zeros, sizes)]


def _inputs(seed: int, count: int) -> Iterator[np.ndarray[Any, Any]]:
    draw = np.random.default_rng(seed)
    for k in range(60):
        scale = 10.0 ** draw.integers(-8, 4)
        values = draw.normal(0.0, scale, count)
        if k >= 40 and count:
            values[draw.integers(count)] = ODD[k % len(ODD)]
        yield values


@pytest.mark.parametrize(
    ("name", "law", "role", "of"),
    [
        ("atb1000/hull", "pd_nn_fast", "executive", "controller"),
        ("atb1000/hull", "nn_backstepping", "executive", "controller"),
        ("atb1000/hull", "pd_feedforward", "executive", "controller"),
        ("atb1000/hull", "pd_observer", "executive", "controller"),
        ("atb1000/hull", "super_twisting", "executive", "controller"),
        ("atb1000/hull", "pd_adaptive", "executive", "controller"),
        ("atb1000/hull", "lqg", "executive", "controller"),
        ("deadzone_map/fuzzy-d01", "inverse", "executive", "controller"),
        ("telerobot/telerobot-u1", None, "local", "servo"),  # counts with what it receives
    ],
)
def test_random_and_odd_inputs_give_the_bits_of_python(
    name: str, law: str | None, role: Role, of: str, tmp_path: Path
) -> None:
    rig = load_rig(RUNS[name][0], law)
    spec = next(b for b in rig.nodes()[role].blocks if b.name == of)
    block = spec.block
    values = prepared_values(block, spec.settings, rig.config.rate_hz, rig.config.seed)
    in_c = _in_c(block, tmp_path)
    python, c = _vectors(block, values), _vectors(block, values)
    for k, given in enumerate(_inputs(7, block.size(block.inputs))):
        for vectors in (python, c):
            vectors[2][:] = given
        block.step(k * 1e-3, 1e-3, *python)
        in_c(None, None, k * 1e-3, 1e-3, *(vector.ctypes.data for vector in c))
        for mine, theirs, what in zip(python, c, "pxuy", strict=True):
            same = (mine == theirs) & (np.signbit(mine) == np.signbit(theirs))
            same |= np.isnan(mine) & np.isnan(theirs)
            assert same.all(), f"{of}, step {k}: {what}{np.flatnonzero(~same)}"


def test_the_stored_digest_is_that_of_the_elementary_functions() -> None:
    out, digest = np.zeros(points.VALUES), 14695981039346656037
    for i in range(points.POINTS):
        points.evaluate(float(i), out)
        for byte in out.astype("<f8").tobytes():
            digest = ((digest ^ byte) * 1099511628211) % 2**64
    assert digest == points.DIGEST, hex(digest)


MAIN = '#include "pcpc_math.h"\nint main(void) { return pcpc_selftest(); }\n'


@pytest.mark.parametrize(
    ("flags", "code"),
    [
        (("-O0", "-ffp-contract=off"), 0),
        (("-O3", "-ffp-contract=off", "-mfma"), 0),
        (("-O2", "-ffp-contract=fast", "-mfma"), 1),
    ],
)
def test_a_build_that_joins_products_and_sums_is_refused(
    flags: tuple[str, ...], code: int, tmp_path: Path
) -> None:
    if "-mfma" in flags and "fma" not in Path("/proc/cpuinfo").read_text().split():
        pytest.skip("this processor has no FMA")
    sources = write({**elementary.files(), "main.c": MAIN}, tmp_path)
    run(["gcc", "-std=c99", *flags, "-o", tmp_path / "main", *sources])
    assert subprocess.run([str(tmp_path / "main")]).returncode == code


def test_fast_math_does_not_compile(tmp_path: Path) -> None:
    sources = write(elementary.files(), tmp_path)
    done = subprocess.run(
        ["gcc", "-std=c99", "-ffast-math", "-c", *sources],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode and "-ffast-math changes bits" in done.stderr


SQRT = """
#include "pcpc_math.h"
int main(void) {
    uint64_t seed = 1U;
    for (int i = 0; i < 300000; i += 1) {
        pcpc_bits v;
        seed = seed * 6364136223846793005U + 1442695040888963407U;
        v.bits = (i % 3 == 0) ? seed >> (i % 64) : seed;
        const double a = pcpc_soft_sqrt(v.number), b = pcpc_sqrt(v.number);
        if (!((a == b) || ((a != a) && (b != b)))) return 1;
    }
    return 0;
}
"""


def test_the_root_without_an_instruction_is_the_processors_to_the_last_bit(tmp_path: Path) -> None:
    sources = write({**elementary.files(), "main.c": SQRT}, tmp_path)
    run(["gcc", *elementary.FLAGS, "-O2", "-o", tmp_path / "main", *sources])
    run([tmp_path / "main"])


class _Row(Ports):
    a = port("", "a")
    b = port("", "b")
    row = port("", "several", shape=4)


def _block(step: Any) -> Block:
    return Block(stage(step))


@inline
def _next(x: Any) -> float:
    x.a = x.a * 0.5 + 1.0
    return float(x.a)


def _either(t: float, dt: float, p: Nothing, x: _Row, u: _Row, y: _Row) -> None:
    """Not for C: the call is made in one case only."""
    y.b = _next(x) if u.a > 0.0 else -x.a


def _order(t: float, dt: float, p: Nothing, x: _Row, u: _Row, y: _Row) -> None:
    """From left to right, also calls that change states."""
    y.a = x.a + 10.0 * _next(x) - 100.0 * _next(x) * x.a
    x.a, x.b = x.b, x.a
    x.row[0], x.row[1], x.row[2] = x.row[1], x.row[2], x.row[0]
    total = 0.0
    for i in range(3, -1, -1):
        if i % 2 == 0 and u.row[i] > 0.0:
            continue
        last = u.row[i] * i
        total += where(last > 0.0, clip(last, 0.5, 2.0), sin(last)) / (i + 1)
    y.row[0] = total
    y.row[2] = u.a - -u.b - (u.b - (u.a - u.b)) / (u.a * (u.b / 3.0))
    n = 2 * len(x.row)
    while n > 3 and u.b > 0.0:
        n -= 3
    y.row[3] = n


def test_order_of_evaluation_is_that_of_python(tmp_path: Path) -> None:
    block = _block(_order)
    in_c = _in_c(block, tmp_path)
    draw = np.random.default_rng(3)
    python = [np.zeros(0), *(draw.normal(size=6) for _ in range(3))]
    c = [one.copy() for one in python]
    for k in range(50):
        python[2][:] = c[2][:] = draw.normal(size=6)
        block.step(float(k), 1.0, *python)
        in_c(None, None, float(k), 1.0, *(vector.ctypes.data for vector in c))
        for mine, theirs in zip(python, c, strict=True):
            assert mine.tobytes() == theirs.tobytes(), (k, mine, theirs)
    assert signature(block) == ("states", "inputs", "outputs")


def _power(t: float, dt: float, p: Nothing, x: Nothing, u: _Row, y: _Row) -> None:
    """Not for C."""
    y.a = u.a**2


def _least(t: float, dt: float, p: Nothing, x: Nothing, u: _Row, y: _Row) -> None:
    """Not for C."""
    y.a = min(u.a, u.b)


@pytest.mark.parametrize(
    ("step", "cure"),
    [(_either, "a line of its own"), (_power, "x * x"), (_least, "where(a < b, a, b)")],
)
def test_what_has_no_c_is_told_with_line_and_cure(step: Any, cure: str) -> None:
    with pytest.raises(Untranslatable) as raised:
        law_files(_block(step), "law")
    said = str(raised.value)
    assert cure in said and "\n" not in said, said
    assert said.startswith("tests/tools/make/generate/test_generated_laws.py:"), said
