"""Laws made of expressions that are drawn: valid by construction, their commands within +-FULL.

A law has two gains, a state that it filters its input with, and one of SHAPES expressions; so all
seeds share the compiled code of SHAPES laws.
"""

import random

SHAPES, FULL = 12, 40.0
_LEAVES = "e", "x.kept", "p.first", "p.second", "u.position", "u.target", "0.5", "t"
_FORMS = (
    "({} + {})", "({} - {})", "({} * {})", "({} / (1.0 + abs({})))",
    "clip({}, -1.0, 3.0 - sin({}))",
    "where({} > {}, 1.0, -1.0)", "(sin({}) + {})", "(tanh({}) * {})", "({} - floor({}))",
    "clip({}, -2.0, abs({}))",
)  # fmt: skip
_LAW = '''"""A law that pcpc swarm has drawn; shape {shape}."""

from pcpc.executive.laws.block import Block, Ports, port, stage
from pcpc.executive.laws.emath import clip, floor, sin, tanh, where

ALL = clip, floor, sin, tanh, where


class Gains(Ports):
    first = port("", "gain", None, -100.0, 100.0)
    second = port("", "gain", None, -100.0, 100.0)


class States(Ports):
    kept = port("", "filtered input")


class Inputs(Ports):
    position = port("", "measured")
    target = port("", "wanted")


class Outputs(Ports):
    command = port("", "to the plant", low=-2000.0, high=2000.0)


@stage
def step(t: float, dt: float, p: Gains, x: States, u: Inputs, y: Outputs) -> None:
    e = u.target - u.position
    x.kept += 0.125 * (clip(u.position, -1e6, 1e6) - x.kept)
    wanted = {expression}
    y.command = clip(p.first * e + clip(wanted, -1.0, 1.0), -{full}, {full})


BLOCK = Block(step)
'''


def law_text(shape: int) -> str:
    """Return the file of a law."""
    return _LAW.format(shape=shape, full=FULL, expression=_drawn(random.Random(shape), 3))


def _drawn(draw: random.Random, depth: int) -> str:
    if depth == 0 or draw.random() < 0.1:
        return draw.choice(_LEAVES)
    return draw.choice(_FORMS).format(_drawn(draw, depth - 1), _drawn(draw, depth - 1))
