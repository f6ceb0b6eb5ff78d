"""One cache of compiled code for processes with other processor features, and with other functions.

Each has the numbers that it has alone, whoever else has filled the cache or is filling it.
"""

import os
import platform
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from places import ROOT

from pcpc.drivers.compiled.jit import JIT_OFF

pytestmark = [
    pytest.mark.skipif(JIT_OFF, reason="numba is switched off"),
    pytest.mark.skipif(platform.machine() != "x86_64", reason="the names are of its processors"),
]
PROCESSORS = (  # every machine of today runs them: names and features, "" for its own ones
    ("generic", ""), ("nehalem", ""), ("generic", "+sse2"), ("generic", "+sse2,+sse4.2"),
)  # fmt: skip
SHARED = """
from pcpc.drivers.compiled.jit import inline
@inline
def advance(f, x, u):
    for _ in range(4):
        x = x + 0.125 * f(x, u)
    return x
"""
STEPS = """
from pcpc.executive.laws.block import Nothing, Ports, inline, port, stage
from shared import advance
class Inputs(Ports):
    {0} = port("", "one name for each step: other types for `advance`")
class Outputs(Ports):
    y = port("", "y")
@inline
def slope(x, u: Inputs):
    return {1}
@stage
def step(t: float, dt: float, p: Nothing, x: Nothing, u: Inputs, y: Outputs) -> None:
    y.y = advance(slope, u.{0}, u)
"""
FACTORY = """
from pcpc.drivers.compiled.jit import compiled
def made(k):
    @compiled()
    def f(x):
        s = 0.0
        for i in range(50):
{}        return s + 1000.0 * k
    return f

two, three = made(2.0), made(3.0)
@compiled()
def with_two(x):
    return two(x) + two(x + 1.0) + two(x * 3.0)
@compiled()
def with_three(x):
    return three(x) + three(x + 1.0) + three(x * 3.0)
"""
LONG = "            s = s / (1.0 + s * k + x * x) + x / (k + i * i)\n"  # too long to be inlined
STEPPED = """
import importlib, sys
import numpy as np
said = []
for name in sys.argv[1:]:
    step = importlib.import_module(name).step
    u, y = np.array([1.5]), np.zeros(1)
    assert step.entry != 0, f"{name}: no address"
    step(0.0, 0.0, np.zeros(1), np.zeros(1), u, y)
    said.append(y[0].hex())
print(*said)
"""


def begun(folder: Path, main: str, *words: str, **more: str) -> "subprocess.Popen[str]":
    """Begin a process that imports from `folder` and has its cache there."""
    mine = {"PYTHONPATH": f"{ROOT}:{folder}", "XDG_CACHE_HOME": str(folder / "cache")}
    mine["PYTHONDONTWRITEBYTECODE"] = "1"
    return subprocess.Popen(
        [sys.executable, "-c", main, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env=os.environ | mine | more,
    )


def said(process: "subprocess.Popen[str]") -> str:
    """Return what a process says in the end; it ends well."""
    text, errors = process.communicate()
    assert process.returncode == 0, f"ended with {process.returncode}: {errors}"
    return text.strip()


def on(processor: tuple[str, str]) -> dict[str, str]:
    return dict(zip(("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"), processor, strict=True))


def write_steps(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    (folder / "shared.py").write_text(SHARED)
    for name, slope in (("falls", "-x"), ("turns", "2.0 * x - x * x")):
        (folder / f"{name}.py").write_text(STEPS.format(f"at_{name}", slope))


def right() -> str:
    found = []
    for slope in (lambda x: -x, lambda x: 2.0 * x - x * x):
        x = 1.5
        for _ in range(4):
            x = x + 0.125 * slope(x)
        found.append(x.hex())
    return " ".join(found)


def test_the_second_processor_has_a_step_for_the_loop_to_call(tmp_path: Path) -> None:
    """Reading what the first one kept of `advance` imported the other model in the midst of one.

    The step of that model had no address then, and the loop called it: SIGSEGV.
    """
    main = """
import importlib, sys
for name in ("deadzone_arm", "payload_arm"):
    assert importlib.import_module(f"pcpc.plants.{name}.model").step.entry != 0, name
    print("pcpc.plants.payload_arm" in sys.modules)
"""
    for processor in PROCESSORS[:2]:
        assert said(begun(tmp_path, main, **on(processor))).split() == ["False", "True"]


def test_processors_of_four_kinds_that_fill_one_cache_at_once_have_equal_bits(
    tmp_path: Path,
) -> None:
    write_steps(tmp_path)
    orders = (("falls", "turns"), ("turns", "falls"))
    for _ in range(2):  # cold, then warm
        processes = [
            begun(tmp_path, STEPPED, *orders[i % 2], **on(processor))
            for i, processor in enumerate(PROCESSORS)
        ]
        for i, process in enumerate(processes):
            assert said(process).split() == right().split()[:: 1 - 2 * (i % 2)]
    kept = Counter(file.name.partition("-")[0] for file in (tmp_path / "cache").rglob("*.nbc"))
    wanted = {f"{name}.{what}": 4 for name in ("falls", "turns") for what in ("step", "slope")}
    assert {name: kept[name] for name in wanted} == wanted, "one took what another one has kept"


def test_functions_of_one_name_that_two_processes_compiled_are_two(tmp_path: Path) -> None:
    (tmp_path / "factory.py").write_text(FACTORY.format(LONG * 16))
    main = "import sys, factory\n"
    main += "print(*(getattr(factory, name)(1.0).hex() for name in sys.argv[1:]))"
    names = ("with_two", "with_three")
    alone = [said(begun(tmp_path, main, name)) for name in names]
    assert said(begun(tmp_path, main, *names)).split() == alone
    assert said(begun(tmp_path, main, *names[::-1])).split() == alone[::-1]


def test_a_module_that_is_imported_while_another_function_is_compiled_is_compiled_for_python(
    tmp_path: Path,
) -> None:
    write_steps(tmp_path)
    main = """
from pcpc.drivers.compiled import inner
import pcpc.drivers.compiled.in_numba
with inner.deeper(root=False), inner.deeper(root=False):
    import falls
assert falls.step.entry != 0
"""
    said(begun(tmp_path, main))


def test_what_takes_functions_is_not_kept_for_others_which_could_not_use_it(
    tmp_path: Path,
) -> None:
    write_steps(tmp_path)
    said(begun(tmp_path, STEPPED, "falls"))
    kept = {file.name.partition("-")[0] for file in (tmp_path / "cache").rglob("*.nbc")}
    assert "falls.slope" in kept and "shared.advance" not in kept, kept


def test_a_child_does_not_name_its_functions_as_its_parent_does(tmp_path: Path) -> None:
    main = """
import os
import pcpc.drivers.compiled.in_numba
from numba.core.bytecode import FunctionIdentity
into, out_of = os.pipe()[::-1]
first = next(FunctionIdentity._unique_ids)
if os.fork() == 0:
    os.write(into, str(next(FunctionIdentity._unique_ids)).encode())
    os._exit(0)
os.wait()
assert abs(int(os.read(out_of, 99)) - first) > 1000, "it counts on"
"""
    said(begun(tmp_path, main))
