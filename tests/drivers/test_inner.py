"""Functions that only others call are no machine code of their own; yet all can be called."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from places import ROOT

from pcpc.drivers.compiled import inner
from pcpc.drivers.compiled.in_numba import f8, i8, types
from pcpc.drivers.compiled.jit import JIT_OFF
from pcpc.drivers.compiled.target import njit

pytestmark = pytest.mark.skipif(JIT_OFF, reason="numba is switched off")
LAW = """
from pcpc.drivers.compiled.inner import part
from pcpc.drivers.compiled.jit import compiled, loop_function
@compiled()
def helper(x):
    if x > 8.0:
        raise ValueError("too large", x)
    return 3.0 * x
@loop_function
def own(x):
    return x
@part
@compiled()
def piece(x):
    return helper(x) + 1.0
@compiled()
def root(x):
    return piece(x) + own(helper(2.0 * x))
@compiled()
def other(x):
    return helper(x) + 3.0 if x < 8.0 else helper(x - 2.0) + x
"""
MAIN = "import sys, law\nfrom pcpc.drivers.compiled.compile_cache import watch\n"


def said(folder: Path, main: str) -> str:
    """Return what a process says that has the law and a cache in `folder`."""
    (folder / "law.py").write_text(LAW)
    environment = {"PYTHONPATH": f"{ROOT}:{folder}", "XDG_CACHE_HOME": str(folder / "cache")}
    words = [sys.executable, "-c", MAIN + main]
    done = subprocess.run(
        words, capture_output=True, text=True, cwd=folder, env=os.environ | environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def kept(folder: Path) -> set[str]:
    return {file.name.split("-")[0] for file in (folder / "cache").rglob("*.nbc")}


def test_of_an_inner_function_callers_find_what_they_link_in(tmp_path: Path) -> None:
    assert said(tmp_path, "print(law.root(1.0))") == "10.0"
    assert kept(tmp_path) == {"law.root", "law.piece", "law.helper"}, "not what is the loop's own"
    assert said(tmp_path, "print(law.root(1.0), watch.done)") == "10.0 0"
    assert said(tmp_path, "print(law.helper(1.0), watch.done)") == "3.0 1", "Python cannot call it"
    assert said(tmp_path, "print(law.other(1.0), watch.done)") == "6.0 1", "the helper is not"
    assert said(tmp_path, "print(law.helper(1.0), law.other(9.0), watch.done)") == "3.0 30.0 0"


def test_an_inner_function_that_python_calls_later_is_compiled_then(tmp_path: Path) -> None:
    main = "print(law.root(1.0), law.helper(1.0), law.helper(2.0), law.root(2.0))"
    assert said(tmp_path, main) == "10.0 3.0 6.0 19.0"


@pytest.mark.parametrize("cold", [True, False])
def test_an_inner_function_raises_what_it_says(tmp_path: Path, cold: bool) -> None:
    if not cold:
        said(tmp_path, "law.root(1.0)")
    main = "\ntry:\n    law.root(5.0)\nexcept ValueError as e:\n    print(e.args)"
    assert said(tmp_path, main) == "('too large', 10.0)"


def test_an_address_of_an_inner_function_can_be_called() -> None:
    kind = types.FunctionType(f8(f8))

    @njit
    def third(x: float) -> float:
        return x / 3.0

    @njit
    def direct(x: float) -> float:
        return third(x)

    @njit(f8(kind, f8))
    def apply(function: object, x: float) -> float:
        return function(x)  # type: ignore[operator]

    @njit
    def of_third(x: float) -> float:
        return apply(third, x)

    assert (direct(6.0), of_third(9.0), apply(third, 12.0)) == (2.0, 3.0, 4.0)


def test_threads_that_compile_at_the_same_time_get_what_they_call() -> None:
    @njit
    def power(x: float, n: int) -> float:
        value = 1.0
        for _ in range(n):
            value *= x
        return value

    makers = [njit(lambda x, n=n: power(x, n)) for n in range(6)]
    found: dict[int, float] = {}

    def work(i: int) -> None:
        found[i] = makers[i](2.0)
        found[10 + i] = power(2.0, i)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {i + j: 2.0**i for i in range(6) for j in (0, 10)}


def test_what_is_compiled_for_another_is_optimised_once() -> None:
    """The library of an inner function is linked and no more: numba's engine never sees it."""

    @njit(f8(f8))
    def never_called(x: float) -> float:
        return x

    @njit
    def small(x: float) -> float:
        return x + 1.0

    @njit(f8(f8))
    def large(x: float) -> float:
        return small(x)

    (one,), (two,) = small.overloads.values(), large.overloads.values()
    assert one.library.inner and not two.library.inner
    assert not isinstance(two.entry_point, inner.InnerFunction)
    assert large(1.0) == 2.0 and never_called(1.0) == 1.0


def test_two_processes_do_not_compile_the_same_function(tmp_path: Path) -> None:
    """The second one waits and takes what the first one has kept."""
    main = "print(law.root(1.0), watch.done)"
    (tmp_path / "law.py").write_text(LAW)
    environment = os.environ | {
        "PYTHONPATH": f"{ROOT}:{tmp_path}",
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
    }
    words = [sys.executable, "-c", f"{MAIN}input(); {main}"]
    both = [
        subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
            env=environment,
        )
        for _ in range(2)
    ]
    for process in both:
        assert process.stdin
        process.stdin.write("\n")
        process.stdin.flush()
    lines = [process.communicate()[0].split() for process in both]
    assert [line[0] for line in lines] == ["10.0", "10.0"]
    roots = [int(line[1]) for line in lines]
    assert sorted(roots) == [0, 4], "root, piece, and two that they call"


def test_arrays_pass_through() -> None:
    @njit
    def total(values: np.ndarray) -> float:
        found = 0.0
        for value in values:
            found += value
        return found

    @njit(f8(types.float64[::1], i8))
    def mean(values: np.ndarray, n: int) -> float:
        return total(values) / n

    assert mean(np.arange(4.0), 4) == 1.5


USERS = """
import numba
import numpy as np
from numba.core import caching, codegen, cpu, dispatcher, registry, target_extension

CLASSES = (dispatcher.Dispatcher, dispatcher._FunctionCompiler, cpu.CPUContext,
           codegen.JITCPUCodegen, codegen.JITCodeLibrary, caching.Cache, registry.CPUDispatcher)

@numba.njit
def before(x):
    return 3.0 * x

@numba.njit
def with_helpers_of_numba(x):
    a = np.zeros(4)
    a[1:3] = (x, x)
    return a.sum()

first = before(with_helpers_of_numba(0.5))
was = first, [dict(vars(one)) for one in CLASSES], dispatcher.FunctionCache

import law
from pcpc.drivers.compiled.deferred import is_open
assert not is_open()
assert law.root(1.0) == 10.0
assert [dict(vars(one)) for one in CLASSES] == was[1], "a class of numba's is another"
assert dispatcher.FunctionCache is was[2] and numba.njit.__module__ == "numba.core.decorators"

@numba.njit(cache=True)
def after(x):
    return 3.0 * x

@numba.njit
def above(x):
    return law.root(x) + before(x)

from pcpc.drivers.compiled.jit import compiled
@compiled()
def ours(x):
    return above(x) + after(x) + law.helper(x)

helped = with_helpers_of_numba.py_func
assert compiled()(helped)(1.0) == with_helpers_of_numba(1.0) == 2.0
@numba.njit
def helped_again(x):
    a = np.zeros(3)
    a[0:2] = (x, x)
    return a.max()
assert helped_again(1.0) == 1.0 and compiled()(helped_again.py_func)(2.0) == 2.0

assert ours(1.0) == 19.0 and above(1.0) == 13.0 and after(1.0) == before(1.0) == 3.0
assert type(after) is type(before) is registry.CPUDispatcher
assert type(after._cache) is caching.FunctionCache
steps = [[line.split()[0] for line in one.inspect_asm(one.signatures[0]).splitlines()
          if line.startswith("\\t") and not line.startswith("\\t.")] for one in (before, after)]
assert steps[0] == steps[1] and "mulsd" in steps[0], steps
print(law.root(1.0))
"""


def test_what_others_compile_in_the_same_process_stays_with_numba(tmp_path: Path) -> None:
    """A user's `@njit` before and after ours: same classes, same cache, called both ways."""
    (tmp_path / "users.py").write_text(USERS)
    assert said(tmp_path, "import users") == "10.0"
