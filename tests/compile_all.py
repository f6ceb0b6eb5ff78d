"""Compile what several tests share, once: no worker waits for another one that compiles it.

    python tests/compile_all.py loop    the loop in its uses; each has all of its code in it
    python tests/compile_all.py laws    laws, plants, lanes; and, where one was not there, what
                                        the import of test files compiles, and their bytecode

At once, in two processes: what the uses of the loop share is typed once in one. Workers that
collect would do the same at the same time, and wait for each other.
"""

import contextlib
import importlib
import os
import pkgutil
import sys
from pathlib import Path

import pytest

import pcpc.executive.laws
import pcpc.plants
from pcpc.drivers.compiled import compile_cache
from pcpc.drivers.compiled.stage import entry_of
from pcpc.drivers.compiled.structures import structure
from pcpc.drivers.robots.layout import Robot
from pcpc.executive.batch.group import LaneGroup
from pcpc.executive.loop import exchange, over_line, plant_drive, shared
from pcpc.executive.nodes import planned_robot
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.study.margin import measured
from pcpc.tools.terminal.progress import Compiling

HERE = Path(__file__).parent
HULL = HERE.parent / "plants" / "atb1000" / "rigs" / "hull.yaml"


def compile_loop() -> None:
    """Compile what does whole cycles of two or three nodes, what these call, and a drive alone."""
    importlib.import_module("pcpc.executive.loop.running")
    exchange.run_of(2)
    importlib.import_module("pcpc.executive.nodes.replay")
    sys.path += [str(HERE / "executive"), str(HERE / "drivers/canopen")]
    importlib.import_module("engine")
    importlib.import_module("drives").Bench().send(0x80)
    over_line.run_over_line(2)
    exchange.run_of(3)
    dialects = [one.dialect for one in planned_robot.KINDS.values()]
    for verb in ("hear", "work", "speak"):
        for whose in ("drive", "robot"):
            entry_of(getattr(plant_drive, f"{verb}_{whose}"), structure(shared.LOOP))
        for dialect in dialects:
            entry_of(getattr(dialect, verb), structure(Robot.dtype))


def compile_laws() -> None:
    """Compile what is imported somewhere, and what lanes need."""
    for package in (pcpc.executive.laws, pcpc.plants):
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if "study" not in found.name:
                importlib.import_module(found.name)
    lanes = LaneGroup(load_rig(HULL, settings=["duration_s=0.01"]), {})
    lanes.begin()
    lanes.run()
    measured._drive_of(2)
    for name in ("gateway", "player"):
        importlib.import_module(f"pcpc.executive.nodes.{name}")
    if compile_cache.watch.done:
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
            pytest.main(["--collect-only", "-qq", "-p", "no:cacheprovider"])


if __name__ == "__main__":
    Compiling().told(quiet=False)
    {"loop": compile_loop, "laws": compile_laws}[sys.argv[1]]()
