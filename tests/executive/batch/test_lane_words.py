"""A step that no lanes can take is named with its line, and with what to write instead."""

from pathlib import Path

import pytest

from pcpc.executive.batch.lane_words import decisions, lanes_problem
from pcpc.executive.own_laws import instead
from pcpc.executive.own_laws.modules import module_of

HEAD = """
import math
import numpy as np
from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage
from pcpc.executive.laws.emath import clip, cos, exp, floor, sign, sin, sqrt, tanh, where
class Inputs(Ports):
    a = port("", "a")
    several = port("", "several", shape=3)
class Parameters(Ports):
    on = port("", "on")
class Outputs(Ports):
    y = port("", "y")
@stage
def step(t: float, dt: float, p: Parameters, x: Nothing, u: Inputs, y: Outputs) -> None:
"""
LINE = HEAD.count("\n") + 1
WORDS = {
    "max(u.a, 1.0)": "no max; write where(a > b, a, b)",
    "u.a % 0.3": "no mod; write x - d * floor(x / d) of emath",
    "math.log(u.a)": "no log; emath has nothing like it, in",
    "(u.a > 0.3) * 0.5": "no mul; write where(c, 1.0, 0.0)",
    "abs(u.a) + 2.0 * u.a": "",
    "where(not (u.a > 0.3) ^ (u.a < 0.6), 0.3, u.a)": "",
}
DECIDED = {
    "where(u.a > 0.2 and u.a < 0.5, 0.3, u.a)": [("`and`", "(a > b) & (c > d)")],
    "where(u.a > 0.2 or p.on > 0.5, 0.3, u.a)": [("`or`", "(a > b) | (c > d)")],
    "where(p.on > 0.2 and u.a < 0.5, 0.3, u.a)": [],
    "where(0.2 < u.a < 0.5, 0.3, u.a)": [("`a < b < c`", "(a < b) & (b < c)")],
    "where(0.2 < p.on < 0.5, 0.3, u.a)": [],
    "where(u.a < 0.5, 0.3, u.a)": [],
    "0.3 if u.a < 0.5 else u.a": [("`if`", "where(c, a, b)")],
    "u.a if t < 0.5 and p.on > 0.5 else 0.3": [],
    "u.a if len(u.several) > 2 else 0.3": [],
    "0.0\n    late = 2.0 * early\n    early: float = u.a\n    if late > 1.0:\n        y.y = 1.0": [
        ("`if`", "where(c, a, b)")
    ],
    "0.0\n    n = 0.0\n    n += u.a\n    while n > 1.0:\n        n -= 1.0": [
        ("`while`", "where(c, a, b)")
    ],
    "where(x.n > 0.2 and u.a < 0.5, 0.3, u.a)": [("`and`", "(a > b) & (c > d)")],
    "float(int(p.on))": [],
    "float(int(u.a) + int(p.on))": [("`int`", "floor(x) of emath")],
}


@pytest.mark.parametrize("word", WORDS)
def test_what_keeps_a_step_out_of_lanes_is_told_with_its_line_and_a_cure(
    word: str, tmp_path: Path
) -> None:
    (tmp_path / "law.py").write_text(f"{HEAD}    y.y = {word}\nBLOCK = Block(step)\n")
    said = lanes_problem(module_of("", tmp_path / "law.py").BLOCK)
    assert WORDS[word] in said and bool(said) == bool(WORDS[word]), said
    assert not said or f"law.py:{LINE}: in lanes there is " in said, said


@pytest.mark.parametrize("word", DECIDED)
def test_what_a_step_decides_by_states_or_inputs_is_told_with_its_line_and_a_cure(
    word: str,
) -> None:
    found = decisions(f"{HEAD}    y.y = {word}\ndef plain(t, dt, p, x):\n    return x and 1\n")
    assert len(found) == len(DECIDED[word]), found
    for (line, said), (name, cure) in zip(found, DECIDED[word], strict=True):
        assert line == LINE + word.count("\n") - word.count("\n        ") and name in said
        assert f"go one by one; write {cure}" in said, said


def test_what_is_written_instead_is_for_lanes(tmp_path: Path) -> None:
    """All cures that are an expression, in one step."""
    cures = {one.removesuffix(" of emath") for one in instead._INSTEAD.values()}
    cures = {one.partition(", as ")[2] or one for one in cures}  # "a comparison, as x != 0.0"
    texts = [one for one in sorted(cures) if set("()<=*") & set(one) and " for " not in one]
    texts = [one for one in texts if one != "x without float()" and "sqrt(x)" not in one[4:]]
    assert len(texts) >= 20, texts
    lines = ["a, b, d = u.a, 2.0 * u.a, 0.3", "low, high, x, c = -a, a, b, 0.5 * a"]
    texts = [one.replace("where(c,", "where(a > b,") for one in texts]
    lines += [f"made_{i} = {text}" for i, text in enumerate(texts)]
    step = "".join(f"    {line}\n" for line in [*lines, "y.y = a"])
    (tmp_path / "cures.py").write_text(f"{HEAD}{step}BLOCK = Block(step)\n")
    assert lanes_problem(module_of("", tmp_path / "cures.py").BLOCK) == ""


@pytest.mark.parametrize(
    ("reason", "cure"),
    [
        ("there is no where(bool, float64, float64)", "; write where(c, a, b) of emath"),
        ("there is no clip(float64, float64, float64)", "; write clip(x, low, high) of emath"),
        ("there is no sum(Cells((4,), float64))", "; write a loop over range(n)"),
        ("there is no mul(Cells((4,), float64), float64)", "; write a loop over range(n)"),
        ("invalid use of getiter with parameters (Cells((4,), float64))", "; write a loop over"),
        ("unknown attribute 'sum' of type Cells((4,), float64)", "; write a loop over range(n)"),
        ("unknown attribute 'fmod' of type Module(...", "; write x - d * floor(x / d) of emath"),
        ("untyped global name 'any': cannot determine", "; write (a > b) | (c > d)"),
        ("there is no float(bool)", "; write where(c, 1.0, 0.0)"),
        ("there is no mul(Mask(8), float64)", "; write where(c, 1.0, 0.0)"),
        ("there is no float(Lane(8))", "; write x without float()"),
        ("there is no min(Lane(8), float64)", "; write where(a < b, a, b)"),
        ("there is no round(Lane(8))", "; write floor(x + 0.5) of emath"),
        ("there is no ceil(Lane(8))", "; write -floor(-x) of emath"),
        ("there is no atan2(Lane(8), float64)", "; emath has nothing like it"),
        ("untyped global name 'plain' is plain Python", ""),
        ("there is no mul(float64, unicode_type)", ""),
    ],
)
def test_what_numba_cannot_take_has_its_cure(reason: str, cure: str) -> None:
    found = instead.cure(reason)
    assert found.startswith(cure) and bool(found) == bool(cure), found
