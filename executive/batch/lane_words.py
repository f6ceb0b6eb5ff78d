"""What keeps a step out of lanes, and what to write instead: told before a study is slow by it."""

import re

from pcpc.drivers.compiled.jit import LOOP_INTERPRETED
from pcpc.drivers.compiled.stage import Stage
from pcpc.executive.laws.block import Block
from pcpc.executive.rig.law_errors import cause

_INSTEAD = {  # of a word in what numba says: what of executive.laws.emath does the same
    "max": "where(a > b, a, b)",
    "min": "where(a < b, a, b)",
    "clip": "clip(x, low, high) of emath",
    "floor": "floor(x) of emath",
    "round": "floor(x + 0.5) of emath",
    "sign": "sign(x) of emath",
    "sqrt": "sqrt(x) of emath",
    "sin": "sin(x) of emath",
    "cos": "cos(x) of emath",
    "exp": "exp(x) of emath",
    "pow": "a product, or sqrt(x) of emath",
}


def lanes_problem(block: Block) -> str:
    """Return why runs of a block are done one by one, with place and cure; "" if they are not."""
    if LOOP_INTERPRETED or not isinstance(block.step, Stage):
        return ""
    try:
        _ = block.step.entry_of_lanes
    except Exception as error:  # numba has many
        what = cause(error)
        reason = what.partition(", in `")[0]
        words = re.findall(r"\w+", reason)
        cure = next((instead for word, instead in _INSTEAD.items() if word in words), "")
        return f"{what}: a sweep runs it one by one{f'; write {cure}' if cure else ''}"
    return ""
