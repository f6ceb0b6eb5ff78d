"""A step that no lanes can take is named with its line, and with what to write instead."""

from pathlib import Path

import pytest

from pcpc.executive.batch.lane_words import lanes_problem
from pcpc.executive.rig.modules import module_of

HEAD = """
from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage
class Inputs(Ports):
    a = port("", "a")
class Outputs(Ports):
    y = port("", "y")
@stage
def step(t: float, dt: float, p: Nothing, x: Nothing, u: Inputs, y: Outputs) -> None:
"""
WORDS = {
    "max(u.a, 1.0)": "write where(a > b, a, b)",
    "min(u.a, 1.0)": "write where(a < b, a, b)",
    "round(u.a)": "write floor(x + 0.5) of emath",
    "abs(u.a) + 2.0 * u.a": "",
}


@pytest.mark.parametrize("word", WORDS)
def test_what_keeps_a_step_out_of_lanes_is_told_with_its_line_and_a_cure(
    word: str, tmp_path: Path
) -> None:
    (tmp_path / "law.py").write_text(f"{HEAD}    y.y = {word}\nBLOCK = Block(step)\n")
    said = lanes_problem(module_of("", tmp_path / "law.py").BLOCK)
    assert WORDS[word] in said and bool(said) == bool(WORDS[word]), said
    assert not said or f"law.py:{HEAD.count(chr(10)) + 1}: " in said, said
