"""A rig whose law tunes its network at other rates: dead, with the sign turned, too fast.

The rates that a theorem names are multiplied where the law's block is prepared, beyond the ranges
that a rig may give them.
"""

import copy
from collections.abc import Mapping

import numpy as np

from pcpc.executive.laws.block import Block, Prepared
from pcpc.executive.rig.reading import Rig
from pcpc.plants.theorem import Theorem


def retuned_rig(rig: Rig, theorem: Theorem, factor: float) -> Rig:
    """Return the rig itself, all tuning rates of its law times `factor`."""
    for node in rig.nodes().values():
        for spec in node.blocks:
            if spec.name == theorem.block:
                object.__setattr__(spec, "block", _scaled_block(spec.block, theorem, factor))
    return rig


def _scaled_block(block: Block, theorem: Theorem, factor: float) -> Block:
    own, made = block.prepare, copy.copy(block)

    def prepare(settings: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
        found = own(settings, rate_hz, seed) if own else Prepared(dict(settings))
        scaled = {n: float(factor * np.asarray(found.parameters[n])) for n in theorem.rates}
        return Prepared({**found.parameters, **scaled}, found.states)

    object.__setattr__(made, "prepare", prepare)
    return made
