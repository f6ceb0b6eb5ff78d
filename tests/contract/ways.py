"""The ways to a run: each gives the bits of the recorded one, or refuses the rig with its reason.

A way takes a recorded run and an empty folder, and returns what differs. What it cannot do it says
by Refused; REFUSED holds which rigs those are. There is no third answer.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import replays
from free_bus import own_bus
from handed_on import as_a_device, as_an_fmu, in_a_page
from logcommand import run_here
from numpy.typing import NDArray
from recorded import Recorded, Refused, columns_differing, differences, record
from two_processes import Whole, differing, lockstep, virtual

from pcpc.drivers.compiled.lanes import WIDTH, LanesDiffer
from pcpc.drivers.errors import BusError
from pcpc.executive.batch.group import LaneGroup, NotInLanes
from pcpc.executive.errors import RigError
from pcpc.executive.log import long_logs
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.plan import check_pacing
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.buses import check_line
from pcpc.tools.make.generate.library import in_place
from pcpc.tools.make.generate.translator.kinds import Untranslatable

PART_CYCLES = 64  # of a log that is read in parts
INTERPRETED_CYCLES = 60


def _same(run: Recorded, path: Path) -> list[str]:
    return differences(run.log, logs.read(path))


def again(run: Recorded, folder: Path) -> list[str]:
    """Simulate once more."""
    return _same(run, record(run.given, folder / "log.mcap").path)


def interpreted(run: Recorded, folder: Path) -> list[str]:
    """Simulate in a process that compiles nothing; of a rig that is shipped only the beginning."""
    rig, controller, settings = run.given
    if controller:
        settings = (*settings, f"duration_s={INTERPRETED_CYCLES / run.rig.config.rate_hz!r}")
    path = folder / "log.mcap"
    given = [str(rig), controller, settings, str(path)]
    print(json.dumps(given), file=_interpreter().stdin, flush=True)
    assert (answer := _interpreter().stdout.readline().strip()) == str(path), answer
    if not controller:
        return _same(run, path)
    return columns_differing(run.log, logs.read(path), whole=False)


@cache
def _interpreter() -> Any:
    """Start the process; it ends with its input, so with this one."""
    words = [sys.executable, "-W", "ignore", str(Path(__file__).with_name("interpreter.py"))]
    env = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    pipe = subprocess.PIPE
    return subprocess.Popen(words, stdin=pipe, stdout=pipe, text=True, env=env)


def on_a_bus(run: Recorded, folder: Path) -> list[str]:
    """Run in lockstep over real sockets, every node but the executive in another process."""
    try:
        check_line(run.rig, "lockstep")
        check_pacing(run.rig, "lockstep")
    except (RigError, BusError) as why:
        raise Refused(str(why)) from None
    runs = virtual(run.rig), lockstep(run.rig, own_bus())
    return differing(*(_in_one_order(one, run.cycles) for one in runs))


def _in_one_order(whole: Whole, cycles: int) -> Whole:
    """Return a run whose frames, of several senders, are sorted, without how its nodes ended.

    A node whose executive sends no sign of its end takes that for silence.
    """
    frames = {role: rows[np.lexsort(rows.T)] for role, rows in whole.frames.items()}
    events = {role: rows[rows[:, 1] < cycles] for role, rows in whole.events.items()}
    return replace(whole, frames=frames, events=events)


def replayed(run: Recorded, folder: Path) -> list[str]:
    """Recompute each node from the log of it."""
    verdicts = {verdict.role: verdict for verdict in replays.replayed(run.path)}
    rows = {role: len(node.cycle) for role, node in run.log.node.items()}
    found = [f"{role}: {v}" for role, v in verdicts.items() if not v.identical]
    short = {role: v.cycles for role, v in verdicts.items()} != rows
    return found + ([f"{rows} cycles, {verdicts}"] if short else [])


def from_a_keyframe(run: Recorded, folder: Path) -> list[str]:
    """Recompute the last third, beginning with the keyframe before."""
    if none := [r for r, n in run.log.node.items() if not n.description["keyframe_passes"]]:
        raise Refused(f"no keyframe has the state of {none}")
    first = run.cycles * 2 // 3
    since = repr(first / run.rig.config.rate_hz)
    done = run_here("replay", run.path, "--from", since, "--json", "--quiet")
    if done.code == 2:
        raise Refused(done.err)
    found = []
    for one in json.loads(done.out):
        if not one["identical"] or one["missing"] or not 0 < one["cycles"] < run.cycles * 3 // 4:
            found.append(f"{one['node']}: {one}")
    return found


def branched(run: Recorded, folder: Path) -> list[str]:
    """Go on from a cycle of the log, without a change."""
    found = []
    for cycle in (1, run.cycles // 2, run.cycles - 2):
        out = folder / str(cycle)
        words = ("-o", out, "--no-figure", "--quiet", "--cycle", str(cycle))
        done = run_here("branch", run.path, *words)
        if done.code == 2:
            raise Refused(done.err)
        found += [f"from {cycle}: {what}" for what in _same(run, out / "log.mcap")]
    return found


def branched_on_a_bus(run: Recorded, folder: Path) -> list[str]:
    """Go on from a cycle of the log over real sockets, without a change."""
    words = ("-o", folder / "b", "--no-figure", "--quiet", "--cycle", str(run.cycles // 2))
    done = run_here("branch", run.path, *words, "--bus", own_bus())
    if done.code == 2:
        raise Refused(done.err)
    return columns_differing(run.log, logs.read(folder / "b/log.mcap"))


def in_lanes(run: Recorded, folder: Path) -> list[str]:
    """Simulate WIDTH equal runs, an element of a vector each."""
    names = {role: list(node.description["state_columns"]) for role, node in run.log.node.items()}
    try:
        group = LaneGroup(run.rig, names)
        group.begin()
        odd = group.run()
    except (NotInLanes, LanesDiffer) as why:
        raise Refused(str(why)) from None
    if odd.any():
        raise Refused("its runs leave the path of lanes")
    found = []
    for role, node in run.log.node.items():
        trace = group.seats[role].trace.reshape(-1, len(names[role]), WIDTH)
        for place, name in enumerate(names[role]):
            values = _of_one_nan(node.columns[name])
            for lane in (0, WIDTH - 1):
                if _of_one_nan(trace[: len(values), place, lane]).tobytes() != values.tobytes():
                    found.append(f"{role}: {name} in lane {lane}")
    return found


def _of_one_nan(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(np.isnan(values), np.nan, values)


def in_parts(run: Recorded, folder: Path) -> list[str]:
    """Read the log as one that is too long for the memory, in parts."""
    long = long_logs.read(run.path, _all_but_two, short=PART_CYCLES, part=PART_CYCLES)
    assert isinstance(long, long_logs.LongLog)
    found = []
    for role, node in run.log.node.items():
        pieces = [(p.node[role], a, b) for p, a, b in long.parts(role)]
        for name, values in node.columns.items():
            whole = np.concatenate([np.array(p.columns[name])[a:b] for p, a, b in pieces])
            if whole.tobytes() != values.tobytes():
                found.append(f"{role}: {name}")
    return found


def _all_but_two(log: logs.Log) -> long_logs.Wanted:
    """Return columns that are read in one pass; each of the others is a pass over the log."""
    return {role: list(node.columns)[2:] for role, node in log.node.items()}


def in_c(run: Recorded, folder: Path) -> list[str]:
    """Simulate with C that was generated in the place of all steps."""
    try:
        made = VirtualRun(run.rig, folder / "log.mcap", check=in_place(folder, ["-O0"]))
    except Untranslatable as why:
        raise Refused(str(why)) from None
    try:
        for _ in made.advance():
            pass
    finally:
        made.close()
    return _same(run, folder / "log.mcap")


Way = Callable[[Recorded, Path], list[str]]
WAYS: dict[str, Way] = {
    way.__name__: way
    for way in (
        again, interpreted, on_a_bus, replayed, from_a_keyframe, branched, branched_on_a_bus,
        in_lanes, in_parts, in_c, in_a_page, as_an_fmu, as_a_device,
    )
}  # fmt: skip
SLOW = ("interpreted", "in_c")
HEAVY = ("in_a_page", "as_an_fmu", "as_a_device")  # one rig of each plant is enough

DRIVES, LINES = ("mastered", "mit", "moteus", "odrive", "robstride"), ("line", "fd_line", "flood")
FAULTY = ("faults_of_*", "stall*", "flood*", "not_finite", "intrusion*", "ends_in_[fh]*", "reset",
          "watchdog", "plausibility")  # fmt: skip
FMU, NO_C = "its state is not in the log; an FMU goes on with", "an FMU has no C"
LACKS = "the log lacks the frames that wait on the emulated line"
IN_THE_DEVICE = "it acts in the executive, which is a device here"
OF_THE_LOOP = "is of the loop, which a device in C does not tune"
BITWISE = "int(u.statusword) & 111: write it with +, -, * or /"
REFUSED: dict[str, dict[str, str]] = {name: {} for name in WAYS} | {  # way, rigs: words of why
    "on_a_bus": dict.fromkeys(LINES, "in lockstep no clock runs"),
    "from_a_keyframe": {"fmu": "no keyframe has the state of ['plant']"},
    "branched": {"fmu": FMU, **dict.fromkeys(LINES, LACKS)},
    "branched_on_a_bus": {"fmu": FMU, **dict.fromkeys(LINES, LACKS)},
    "in_lanes": {
        "three_plants": "it has the nodes executive, plant, plant_2",
        "two_buses": "it has the nodes executive, plant, plant_2",
        "relay": "it has the nodes executive, local, plant",
        "telerobot*": "it has the nodes executive, local, plant",
        "ends_in_ready": "it is armed by hand",
        "multiplexed": "is multiplexed",
        "fmu": "it has an FMU",
        **dict.fromkeys(("line", "fd_line"), "its line is emulated"),
        **dict.fromkeys(DRIVES, "its plant is a drive"),
        **dict.fromkeys(FAULTY, "it has faults on purpose"),
    },
    "in_c": {"mastered": BITWISE, "fmu": NO_C},
    "in_a_page": {
        "fmu": NO_C,
        "losses": "losses on purpose have no C",
        "ends_in_ready": "a page has no operator who arms it",
        **dict.fromkeys(("line", "fd_line"), "an emulated line has no C"),
        **dict.fromkeys(DRIVES, "a page has no drive"),
        **dict.fromkeys(FAULTY, "no C; "),
    },
    "as_an_fmu": {
        "fmu": NO_C,
        **dict.fromkeys(DRIVES, "plant.drive.velocity: the plant has no variable motor."),
    },
    "as_a_device": {
        "mastered": BITWISE,
        "two_buses": "is on a second bus; a device in C is on one",
        "handover": "a device in C has one controller, and none on standby",
        "not_finite": OF_THE_LOOP,
        "reset": OF_THE_LOOP,
        "plausibility": "a device in C does not judge what it hears",
        "ends_in_ready": "a device in C has no operator who arms it",
        "stall*": "a device does not know of a stall",
        **dict.fromkeys(
            ("faults_of_*", "ends_in_[fh]*", "losses", "intrusion_held"), IN_THE_DEVICE
        ),
        **dict.fromkeys(LINES, "a device is on no emulated line"),
    },
}


def refusal(rig: str, way: str) -> str:
    """Return words of the reason for which a rig cannot go a way; "": it can."""
    found = [why for names, why in REFUSED[way].items() if fnmatch(rig, names)]
    assert len(found) < 2, f"{rig}, {way}: {found}"
    return found[0] if found else ""
