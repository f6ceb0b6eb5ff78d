"""The rigs over which the contracts go: all that are shipped, and one of each feature of a node.

A feature brings a rig into `tests/rigs/`, or a line into MADE if its files are made.
"""

import itertools
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from fd_rig import fd_rig
from handed_on import with_fmu
from motors import motors
from places import ROOT
from recorded import Given

from pcpc.executive.rig.reading import load_rig
from pcpc.executive.rig.schema import Config

CYCLES = 300  # of a shipped rig
QUICK = ("fd",)
SHIPPED = sorted(ROOT.glob("plants/*/rigs/*.yaml"))
FEATURES = [
    *sorted(ROOT.glob("tests/rigs/*.yaml")),
    *sorted(ROOT.glob("tests/rigs/*/rig.yaml")),
    ROOT / "tests/drivers/canopen/mastered.yaml",
    *sorted(ROOT.glob("tests/drivers/robots/*.yaml")),
    ROOT / "tests/executive/relay/rig.yaml",
]


def _fmu(folder: Path) -> Path:
    """Write the probe with an FMU as its plant."""
    rig, path = load_rig(ROOT / "plants/probe/rig.yaml"), folder / "rig.yaml"
    law = str(ROOT / "plants/probe/law.py")
    text, _ = with_fmu(rig, folder)
    path.write_text(text.replace("law.py", law).replace("duration_s: 10.0", "duration_s: 0.4"))
    return path


MADE: dict[str, Callable[[Path], Path]] = {
    "fd": lambda folder: fd_rig(folder),
    "fd_line": lambda folder: fd_rig(
        folder,
        "bus: {emulate: 800k, bitrate: 800000, data_bitrate: 5000000, bit_error_rate: 3.0e-4,"
        " error_burst: 3, queue: 8}",
    ),
    "three_plants": lambda folder: motors(folder, 3),
    "fmu": _fmu,
    "two_buses": lambda folder: motors(folder, 3, 1),
}


@cache
def _config(path: Path) -> Config:
    return load_rig(path, resolve=False).config


def shipped() -> Iterator[tuple[Path, str]]:
    """Return every rig once, and every controller of every plant at least once.

    A rig whose expectations leave a controller out may have tunings that it does not know.
    """
    for folder in sorted({rig.parents[1] for rig in SHIPPED}):
        rigs = [rig for rig in SHIPPED if rig.parents[1] == folder]
        controllers = list(_config(rigs[0]).controllers)
        number = max(len(rigs), len(controllers))
        turns = zip(range(number), itertools.cycle(rigs), itertools.cycle(controllers))
        for _, rig, turn in turns:
            config = _config(rig)
            known = turn in config.expect or not config.expect
            yield rig, turn if known else config.controller


def _short(path: Path, controller: str) -> Given:
    rate_hz = _config(path).rate_hz
    return Given(path, controller, (f"duration_s={CYCLES / rate_hz!r}", "record.keyframe=100ms"))


def _name(path: Path) -> str:
    return path.parent.name if path.name == "rig.yaml" else path.stem


def given(name: str, folder: Path) -> Given:
    """Return a rig, whose files are made in a folder if need be."""
    return (
        Given(MADE[name](folder), None, ("record.keyframe=100ms",))
        if name in MADE
        else _READY[name]
    )


_READY = {_name(path): Given(path, None, ("record.keyframe=100ms",)) for path in FEATURES} | {
    f"{path.stem}-{name}": _short(path, name) for path, name in dict.fromkeys(shipped())
}
RIGS = [*MADE, *_READY]


def pairs(ways: Iterable[str], slow: Collection[str], heavy: Collection[str]) -> Iterator[Any]:
    """Yield rig and way: all, but a heavy way with one shipped rig of each plant.

    Those of QUICK go its ways with every change, but the slow and the heavy ones.
    """
    seen = set()
    for rig in RIGS:
        made = rig in MADE or _READY[rig].controller is None
        folder = rig if made else _READY[rig].path.parents[1].name
        for way in ways:
            if way not in heavy or folder not in seen:
                always = rig in QUICK and way not in (*slow, *heavy)
                yield pytest.param(rig, way, marks=[pytest.mark.quick] if always else [])
        seen.add(folder)
