"""Compiled code gives the bits of the interpreter: every stage of every block that is shipped.

Blocks are those of all rigs and controllers, with their settings, driven by inputs that are drawn;
generators of references, which few rigs use, get drawn settings. One process that compiles nothing
answers for a plant.
"""

import ast
import hashlib
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from interpreting import interpreted
from places import ROOT

from pcpc.executive.laws.block import Block
from pcpc.executive.own_laws.preparation import prepared_values
from pcpc.executive.rig.reading import load_rig

TEMPLATE = "tools/make/template"
PLANTS = {
    path.parent.name: path.parent / "rigs" for path in (ROOT / "plants").glob("*/rig.yaml")
} | {"template": ROOT / TEMPLATE, "probe": ROOT / "plants/probe", "generators": ROOT}
GENERATORS = "profiles", "references", "sequences"
VALUES = 0.0, 1.0, 2.0, 3.0, 0.25, 0.7, -0.4
PARTS = {f"telerobot_{name}" for name in ("cancel", "model", "network", "robust")}  # of _remote
CYCLES = (*range(8), 500, 2000, 10_000)
SCALES = 0.0, 0.1, 3.0


def settings_of_rigs(plant: str) -> Iterator[tuple[str, Block, dict[str, float], float]]:
    """Yield the blocks of a plant's rigs: of the first with all controllers, of others with one."""
    whole = {"template": "**/rig.yaml", "probe": "rig.yaml"}.get(plant, "*.yaml")
    for first, path in enumerate(sorted(PLANTS[plant].glob(whole))):
        config = load_rig(path, resolve=False).config
        for controller in config.controllers if first == 0 else [config.controller]:
            for node in load_rig(path, controller).nodes().values():
                for one in node.blocks:
                    yield one.name, one.block, one.settings, config.rate_hz


def drawn_settings() -> Iterator[tuple[str, Block, dict[str, float], float]]:
    """Yield the generators of references with values of all signs and kinds."""
    draw = np.random.default_rng(5)
    for module in GENERATORS:
        for name, block in vars(import_module(f"pcpc.executive.laws.{module}")).items():
            for _ in range(6 if isinstance(block, Block) else 0):
                ports = [(one, port) for port in block.settings for one in port.names()]
                given = {one: float(np.clip(draw.choice(VALUES), port.low, port.high))
                         for one, port in ports}  # fmt: skip
                yield f"{module}:{name}", block, given, 1000.0


def blocks(plant: str) -> dict[str, tuple[Block, dict[str, float], float]]:
    """Return each block once with each of its settings, by a name that tells them apart."""
    of = drawn_settings() if plant == "generators" else settings_of_rigs(plant)
    found: dict[Any, tuple[str, Block, dict[str, float], float]] = {}
    for name, block, settings, rate_hz in of:
        step = block.step.py_func
        found.setdefault((step.__module__, step.__qualname__, *settings.items()),
                         (name, block, settings, rate_hz))  # fmt: skip
    return {f"{n} {name}": rest for n, (name, *rest) in enumerate(found.values())}  # type: ignore[misc]


def digests(plant: str) -> dict[str, str]:
    """Return a digest of the states and outputs of each block, here as this process runs them."""
    return {name: digest(*one) for name, one in blocks(plant).items()}


def digest(block: Block, settings: dict[str, float], rate_hz: float) -> str:
    """Return a digest of a block that steps from its start with inputs of several sizes."""
    draw, found, dt = np.random.default_rng(7), hashlib.sha256(), np.float64(1.0 / rate_hz)
    given = prepared_values(block, settings, rate_hz, 1)
    p, begin = (np.array([value for _, value in one] or [0.0]) for one in given)
    for scale in SCALES:
        x, y = begin.copy(), np.zeros(max(block.size(block.outputs), 1))
        for k in CYCLES:
            u = scale * draw.normal(size=max(block.size(block.inputs), 1))
            with np.errstate(all="ignore"):
                block.step(np.float64(k * dt), dt, p, x, u, y)
            for values in (x, y):
                found.update(np.where(np.isnan(values), 0.125, values).tobytes())
            if not (np.isfinite(x).all() and np.isfinite(y).all()):
                break
    return found.hexdigest()


@pytest.mark.parametrize(
    "plant", [pytest.param(p, marks=[] if p == "probe" else pytest.mark.deep) for p in PLANTS]
)
def test_compiled_and_interpreted_steps_give_the_same_bits(plant: str) -> None:
    here, there = digests(plant), ast.literal_eval(interpreted(__name__, f"t.digests({plant!r})"))
    assert len({*here.values()}) > 1 and here == there


@pytest.mark.deep
def test_every_block_that_is_shipped_is_compared() -> None:
    compared = {
        (one.step.py_func.__module__, one.step.py_func.__qualname__)
        for plant in PLANTS
        for one, *_ in blocks(plant).values()
    }
    files = [*(ROOT / "plants").rglob("model.py"), *(ROOT / "plants").rglob("laws/*.py")]
    files += (ROOT / "executive/laws").glob("*.py")
    there = set()
    for file in files:
        name = ".".join(("pcpc", *file.relative_to(ROOT).with_suffix("").parts))
        found = [one for one in vars(import_module(name)).values() if isinstance(one, Block)]
        there |= {(one.step.py_func.__module__, one.step.py_func.__qualname__) for one in found}
    assert {module.rpartition(".")[2] for module, _ in there - compared} == PARTS
