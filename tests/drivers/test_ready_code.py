"""What Python calls is found and run without numba, and is then what numba would have made."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import ROOT

from pcpc.drivers.compiled import kept_files, kinds
from pcpc.drivers.compiled.jit import JIT_OFF, VIEW, compiled, f8, i8, types
from pcpc.drivers.compiled.ready_code import ImportedFunction
from pcpc.drivers.compiled.structures import structure

pytestmark = pytest.mark.skipif(JIT_OFF, reason="numba is switched off")
LAW = """
import numpy as np
from pcpc.drivers.compiled.jit import compiled, f8, i8, types
from pcpc.drivers.compiled.records import Element
from pcpc.drivers.compiled.structures import structure

class Pair(Element):
    first: int
    second: int
    third: float

N = structure(Pair.dtype)

@compiled(f8(f8, i8))
def declared(x, n):
    return x + n

@compiled()
def total(values):
    found = 0.0
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            found += values[i, j]
    return found

@compiled(types.void(types.UniTuple(N, 2), f8))
def fill(pair, x):
    pair[0].first, pair[1].second, pair[1].third = 3, 4, x

@compiled()
def both(x):
    return x < 0.0, 2.0 * x, 7

@compiled()
def careful(x):
    if x < 0.0:
        raise ValueError("below zero")
    return x

@compiled()
def allocates(n):
    return np.ones(n)
"""
MAIN = """
import sys
import numpy as np
import law
from pcpc.drivers.compiled.compile_cache import watch

pair = np.zeros(2, law.Pair.dtype).view(np.recarray)
law.fill((pair[0], pair[1]), 0.5)
table = np.arange(6.0).reshape(2, 3)
said = [law.declared(1.5, 2), law.total(table), law.total(table.T), law.total(table[:, ::2])]
said += [int(pair[0].first), int(pair[1].second), float(pair[1].third), law.both(-1.0)]
for i in range(2):
    try:
        law.careful(-1.0 - i)
    except ValueError as error:
        trace = error.__traceback__
        while trace.tb_next:
            trace = trace.tb_next
        said += [*error.args, trace.tb_lineno]
print(said, watch.done, "numba" in sys.modules)
"""
RIGHT = [3.5, 15.0, 15.0, 10.0, 3, 4, 0.5, (True, -2.0, 7), "below zero", 37, "below zero", 37]


def said(folder: Path, main: str, **more: str) -> str:
    """Return what a process says that has the law, and a cache in `folder`."""
    (folder / "law.py").write_text(LAW)
    mine = {"PYTHONPATH": f"{ROOT}:{folder}", "XDG_CACHE_HOME": str(folder / "cache")} | more
    done = subprocess.run(
        [sys.executable, "-c", main],
        capture_output=True,
        text=True,
        cwd=folder,
        env=os.environ | mine,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_what_is_kept_does_the_same_without_numba(tmp_path: Path) -> None:
    assert said(tmp_path, MAIN) == f"{RIGHT} 7 True"
    assert said(tmp_path, MAIN) == f"{RIGHT} 0 False"
    interpreted = said(tmp_path, MAIN, NUMBA_DISABLE_JIT="1")
    assert re.sub(r"np\.float64\(([0-9.]+)\)", r"\1", interpreted) == f"{RIGHT} 0 False"


def test_code_for_another_processor_is_other_code(tmp_path: Path) -> None:
    main = "import law; from pcpc.drivers.compiled.compile_cache import watch\n"
    main += "print(law.both(1.0), watch.done)"
    assert said(tmp_path, main) == "(False, 2.0, 7) 3", "and those with a signature"
    assert said(tmp_path, main, NUMBA_CPU_NAME="nehalem") == "(False, 2.0, 7) 3"
    assert said(tmp_path, main) == "(False, 2.0, 7) 0"


def test_what_needs_memory_of_its_own_is_called_through_numba_and_kept_there(
    tmp_path: Path,
) -> None:
    main = "import sys, law; from pcpc.drivers.compiled.compile_cache import watch\n"
    main += "before = watch.done; print(law.allocates(3), watch.done - before, "
    main += "'numba' in sys.modules)"
    assert said(tmp_path, main) == "[1. 1. 1.] 1 True"
    assert said(tmp_path, main) == "[1. 1. 1.] 0 True"


def test_code_with_the_address_of_a_table_is_of_its_process_alone(tmp_path: Path) -> None:
    (tmp_path / "large.py").write_text(
        "import numpy as np\nfrom pcpc.drivers.compiled.jit import compiled\n"
        "TABLE = np.arange(200_000.0)\n"  # numba copies what has a megabyte at most
        "@compiled()\ndef entry(i):\n    return TABLE[i]\n"
    )
    main = "import large; from pcpc.drivers.compiled.compile_cache import watch\n"
    main += "print(large.entry(199_999), watch.done)"
    for _ in range(2):
        assert said(tmp_path, main) == "199999.0 1"


def test_numba_takes_what_has_no_mark(tmp_path: Path) -> None:
    @compiled()
    def doubled(x: Any) -> Any:
        return x + x

    @compiled(f8(f8))
    def declared(x: float) -> float:
        return x + 1.0

    assert doubled(np.float32(1.5)) == 3.0 and doubled(True) == 2 and doubled(2) == 4
    assert declared(np.float32(1.5)) == 2.5 and declared(2) == 3.0
    with pytest.raises(TypeError):
        declared("1.0")
    with pytest.raises(TypeError):
        declared(1.0, 2.0)
    with pytest.raises(Exception, match=r"[Cc]annot determine"):
        doubled(object())


def test_a_mark_is_one_type_of_numba() -> None:
    from pcpc.drivers.compiled.in_numba import numba

    row = np.dtype([("a", "<i8"), ("b", "<f8", (2,))])
    inner = structure(row)
    table = np.zeros((2, 3))
    fixed = table.copy()
    fixed.flags.writeable = False
    record = np.zeros(2, row).view(np.recarray)[1]
    values: list[Any] = [
        1.0, np.float64(2.0), 1, np.int64(2), table, table.T, table[:, ::2], table[0], fixed,
        table.astype(np.float32), table.astype(np.uint8), np.zeros(2, row), record,
        (1.0, 2), (record, record), ((1, 2), (3, 4)),
    ]  # fmt: skip
    by_mark: dict[str, set[str]] = {}
    by_type: dict[str, set[str]] = {}
    for value in values:
        mark, kind = kinds.mark_of(value), str(numba.typeof(value))
        by_mark.setdefault(mark, set()).add(kind)
        by_type.setdefault(kind, set()).add(mark)
    assert all(len(found) == 1 for found in (*by_mark.values(), *by_type.values())), by_mark
    for kind, value in (
        (f8, 1.0),
        (i8, 1),
        (VIEW, table[0]),
        (f8[:, ::1], table),
        (f8[::1, :], table.T),
        (f8[:, :], table[:, ::2]),
        (inner, record),
        (types.UniTuple(inner, 2), (record, record)),
    ):
        assert kind.mark == kinds.mark_of(value)
        assert kind.in_numba() == numba.typeof(value), kind.mark


@pytest.mark.parametrize("value", [
    True, 1 << 63, "a", None, np.float32(1.0), np.zeros(2, ">f8"), np.zeros(2, "U3"), [1.0],
    np.zeros(1, [("never", "<f8"), ("named", "<f8")]).view(np.recarray)[0],
])  # fmt: skip
def test_other_values_have_no_mark(value: Any) -> None:
    with pytest.raises(kinds.UnmarkedValue):
        kinds.mark_of(value)


def test_what_cannot_be_kept_is_compiled_without_a_word(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept_files, "_told", [])
    outside = object()  # no constant: no file tells what it is
    ImportedFunction(lambda: outside).keep("", "step", "", b"code")
    assert capsys.readouterr().err == ""
