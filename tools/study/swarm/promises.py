"""What is promised of every run, each by its name: a function of a case that says what is broken.

What a promise is not about, it leaves.
"""

import contextlib
import copy
import os
import random
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from pcpc.drivers.compiled.lanes import WIDTH, LanesDiffer
from pcpc.drivers.errors import UserError
from pcpc.executive.batch.group import LaneGroup, NotInLanes
from pcpc.executive.log import long_logs
from pcpc.executive.log import reader as logs
from pcpc.executive.log.frontier import ALL
from pcpc.executive.log.provenance import facts
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.fmus import step_of
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.opened import Opened
from pcpc.tools.after.replay import replay
from pcpc.tools.after.verdict.outcome import Outcome
from pcpc.tools.after.verdict.virtual_end import to_end
from pcpc.tools.study.swarm import counts, oracle
from pcpc.tools.study.swarm.case import QUIET, Case
from pcpc.tools.study.swarm.files import ACTS, RIG, write
from pcpc.tools.terminal.rooms import is_installed, part_of

PART_CYCLES, PARTS = 100, 7  # at least; at most
SAMPLE, INTERPRETED, LOCKSTEP = 0.005, 60, 2000  # share of seeds; cycles, at most
_FRAME = ["cycle", "id", "dlc", "direction", "e2e", "data"]
_GAIN = "controller.first"
_NOT_SURE = "is unknown"  # in a line that does not say that something is missing
_BRANCH, _VERIFY = "after/branch", "after/verify"  # rooms that may have been taken out


def bits(case: Case) -> Iterator[str]:
    """Yield in what a second run has other bits; the log's digest is the same."""
    again = case.recorded(case.folder / "again.mcap")
    same = is_installed(_VERIFY) and case.turn(4) > 0
    if is_installed(_VERIFY):
        digest = part_of(_VERIFY, "digest").digest
        if digest(case.path) != digest(again):
            yield "its log has another digest"
            same = False
    if not same:
        yield from differing(case.log, Opened(again).log)


def differing(one: logs.Log, other: logs.Log) -> Iterator[str]:
    """Yield in what two records differ: variables, frames."""
    yield from columns(one, other)
    for role, mine in one.node.items():
        theirs = other.node[role]
        more, less = _unlike(mine, theirs), _unlike(theirs, mine)
        if more or less:
            yield f"{role}: {more} frames that the other has not, {less}"


def _unlike(one: logs.NodeLog, other: logs.NodeLog) -> int:
    """Return how many frames the other has not."""
    rows, theirs = (node.frames[_FRAME].tobytes() for node in (one, other))
    if theirs.startswith(rows):  # as a rule, and much sooner seen
        return 0
    kind = f"V{one.frames.itemsize}"
    return len({*np.frombuffer(rows, kind).tolist()} - {*np.frombuffer(theirs, kind).tolist()})


def columns(one: logs.Log, other: logs.Log, past: int | None = None) -> Iterator[str]:
    """Yield the variables that differ in the cycles before `past`."""
    for role, mine in one.node.items():
        theirs = other.node[role]
        ends = [
            len(node.cycle) if past is None else int(np.searchsorted(node.cycle, past))
            for node in (mine, theirs)
        ]
        end = min(ends)
        if ends[0] != ends[1]:
            yield f"{role}: {ends[0]} cycles, {ends[1]}"
        for name, values in mine.columns.items():
            if values[:end].tobytes() != theirs.columns[name][:end].tobytes():
                words = (x[:end].view(np.int64) for x in (values, theirs.columns[name]))
                yield f"{role}: {name} from cycle {mine.cycle[np.argmax(np.not_equal(*words))]}"


def replayed(case: Case) -> Iterator[str]:
    """Yield what a replay does not recompute bit for bit."""
    yield from _replay(case, (0, ALL))


def keyframe(case: Case) -> Iterator[str]:
    """Yield what a replay that begins at a drawn keyframe, if there is one, does not recompute."""
    if cycle := _behind_a_keyframe(case):
        yield from _replay(case, (cycle, ALL))


def _behind_a_keyframe(case: Case) -> int:
    """Return a drawn cycle behind a keyframe: of one in a ramp, a hold or a fault if there is.

    0: no keyframe lies before the last cycle.
    """
    config, found = case.rig.config, set[int]()
    every = max(1, round(1e-9 * config.record.keyframe_ns * config.rate_hz))
    last = min(int(node.cycle[-1]) if len(node.cycle) else 0 for node in case.log.node.values())
    for node in case.log.node.values():
        state, gain, missing = (
            node.columns[f"supervisor.{name}"] for name in ("state", "gain", "missing_cycles")
        )
        moves = (state != State.RUN) | (gain != 1.0) | (missing != 0.0)
        there = (node.cycle < last) & (node.cycle % every == every - 1)
        found |= {*node.cycle[moves & there].tolist()}
    if found:
        return 1 + sorted(found)[case.at("keyframe", 0, len(found))]
    return case.at("keyframe", every, last) if every < last else 0


def _replay(case: Case, span: tuple[int, int]) -> Iterator[str]:
    for one in replay(case.opened, QUIET, span=span):
        case.cycles += one.cycles
        if not one.identical:
            why = one.first() or one.incomplete or one.missing
            yield f"{one.role}: {one.state}, {one.extent}: {why}"


def _has(case: Case, *acts: str) -> bool:
    """Return whether something of it is done to the run from outside."""
    return any(one in act for act in case.world.get("acts", ()) for one in acts)


def branched(case: Case) -> Iterator[str]:
    """Yield what differs in a run that goes on from a drawn cycle, without or with a change."""
    of_rig = [step_of(one) for node in case.rig.nodes().values() for one in node.blocks]
    unknown = case.rig.config.bus.emulate is not None or any(of_rig)  # states that no log holds
    if _has(case, "stop", "send") or unknown or case.length < 8 or not is_installed(_BRANCH):
        return
    cycle = _branch_cycle(case)
    if cycle == case.length:
        return
    if case.turn(2) or case.world["around"] is not None or len(case.rig.config.schedule) > 8:
        yield from differing(case.log, _branch(case, cycle, []))
        return
    value = 0.1 + 4.0 * case.world["at"]["branch"]
    branch = _branch(case, cycle, [("executive", _GAIN, value)])
    yield from (f"changed: {line}" for line in columns(case.log, branch, cycle))
    world = copy.deepcopy(case.world)
    tuning = {"at_s": cycle / case.rig.config.rate_hz, "set": {_GAIN: value}}
    rows = [tuning, *world["keys"].get("schedule", [])]  # a later one of the cycle wins
    world["keys"]["schedule"] = sorted(rows, key=lambda row: row["at_s"])
    other = Case(world, case.folder / "changed")
    write(world, other.folder, case.laws)
    yield from (f"changed: {line}" for line in columns(branch, other.log, case.length))
    case.cycles += other.cycles


def _branch_cycle(case: Case) -> int:
    """Return the drawn cycle, or the next whose last ones before no node has skipped, or `length`.

    The executive goes on freely from two cycles before on, the others from one.
    """
    cycle, lasts = case.at("branch", 1, case.length - 2), [*case.log.node.values()]
    while cycle < case.length and any(
        cycle - behind >= 0 and cycle - behind not in node.cycle
        for behind, node in zip((3, *(2 for _ in lasts[1:])), lasts, strict=True)
    ):
        cycle += 1
    return cycle


def _branch(case: Case, cycle: int, changes: list[tuple[str, str, float]]) -> logs.Log:
    path = case.folder / f"branch-{len(changes)}.mcap"
    with case.opened.rig(whole=True) as rig:
        about = facts() | {"pacing": "virtual", "bus": "memory", "seed": str(rig.config.seed)}
        about |= {"controller": rig.config.controller, "rate_hz": repr(rig.config.rate_hz)}
        branching = part_of(_BRANCH, "branching")
        run = branching.Branch(case.opened.head, rig, cycle, about, path, None)
        run.change([branching.Change(*change) for change in changes])
        for _ in run.before():
            pass
        to_end(run, Outcome("virtual", "memory"), QUIET)
    case.count(run)
    return Opened(path).log


def in_lanes(case: Case) -> Iterator[str]:
    """Yield what differs in WIDTH equal runs at once, where the rig can run in lanes."""
    if _has(case, *ACTS):
        return
    names: dict[Any, list[str]] = {
        role: list(node.description["state_columns"]) for role, node in case.log.node.items()
    }
    try:
        group = LaneGroup(case.rig, names)
        group.begin()
        if group.run().any():
            return
    except (NotInLanes, LanesDiffer):
        return
    case.cycles += WIDTH * sum(len(node.cycle) for node in case.log.node.values())
    for role in names:
        node = case.log.node[role]
        trace = group.seats[role].trace.reshape(-1, len(names[role]), WIDTH)
        for place, name in enumerate(names[role]):
            values = node.columns[name]
            for lane in (0, WIDTH - 1):
                if not np.array_equal(trace[: len(values), place, lane], values, equal_nan=True):
                    yield f"{role}: {name} in lane {lane}"


def in_parts(case: Case) -> Iterator[str]:
    """Yield, of a quarter, what differs in the log that is read in parts."""
    if case.turn(4) != 1:
        return
    part = max(PART_CYCLES, case.length // PARTS)
    long = case.opened.part(
        lambda head: {role: list(node.columns)[1:] for role, node in head.node.items()},
        short=part, part=part,
    )  # fmt: skip
    if not isinstance(long, long_logs.LongLog):
        return
    for role, node in case.log.node.items():
        pieces = [(p.node[role], a, b) for p, a, b in long.parts(role)]
        for name, values in node.columns.items():
            whole = np.concatenate([p.columns[name][a:b] for p, a, b in pieces])
            if whole.tobytes() != values.tobytes():
                yield f"{role}: {name} in parts"


def interpreted(case: Case) -> Iterator[str]:
    """Yield, of a sample, what differs in the first cycles where nothing is compiled."""
    if case.world["at"]["sample"] < SAMPLE and not _has(case, *ACTS):
        words = ["simulate", _shorter(case, INTERPRETED)]
        yield from _elsewhere(case, words, {"NUMBA_DISABLE_JIT": "1"}, INTERPRETED)


def lockstep(case: Case) -> Iterator[str]:
    """Yield, of a sample, what differs in processes of their own on a bus."""
    emulated = case.rig.config.bus.emulate is not None or _has(case, *ACTS)
    if 1.0 - case.world["at"]["sample"] < SAMPLE and not emulated:
        bus = f"udp_multicast:239.74.163.14:{20000 + os.getpid() % 20000}"
        words = ["run", "--pacing=lockstep", "--bus", bus, _shorter(case, LOCKSTEP)]
        yield from _elsewhere(case, words, {}, LOCKSTEP)


def _shorter(case: Case, most: int) -> str:
    """Return the setting of a run of at most so many cycles."""
    return f"--set=duration_s={min(most, case.world['cycles']) / case.rig.config.rate_hz!r}"


def _elsewhere(case: Case, words: list[str], more: dict[str, str], past: int) -> Iterator[str]:
    """Yield in what the run of another command differs, up to the end of the shorter one."""
    out = case.folder / words[0]
    line = [sys.executable, "-m", "pcpc.tools.cli", *words, str(case.folder / RIG), "-o", str(out),
            "--no-figure", "--quiet"]  # fmt: skip
    done = subprocess.run(line, env=os.environ | more, capture_output=True, text=True)
    if done.returncode in (2, 4):
        yield f"{words[0]}: exit code {done.returncode}: {done.stderr.strip()}"
        return
    log = Opened(out / "log.mcap").log
    case.cycles += sum(len(node.cycle) for node in log.node.values())
    least = min(int(node.cycle[-1]) for one in (log, case.log) for node in one.node.values())
    yield from (f"{words[0]}: {line}" for line in columns(case.log, log, min(past, least)))


def verdict(case: Case) -> Iterator[str]:
    """Yield where the verdict is not what the oracle says of the frames and the rig."""
    yield from oracle.verdict(case)
    yield from counts.judged(case)


def frames(case: Case) -> Iterator[str]:
    """Yield frames of which nobody knows what became of them, and wrong ones that were used."""
    yield from oracle.frames(case)
    yield from counts.paced(case)


def limits(case: Case) -> Iterator[str]:
    """Yield where a command left its bounds or its rate, or was not safe."""
    for role, node in case.log.node.items():
        yield from (f"{role}: {line}" for line in broken_limits(case.rig, role, node))


def broken_limits(rig: Rig, role: Any, node: logs.NodeLog) -> Iterator[str]:
    """Yield where a command of a node left its bounds or its rate, or was not safe."""
    state, wanted = node.columns["supervisor.state"], rig.config.supervisor
    limited = plan(rig, role, "virtual").limits
    ramp_s = max(
        wanted.ramp_s, wanted.quick_stop_s or 0.0,
        *(max(one.high - safe, safe - one.low) / one.rate_per_s for one in limited.values()
          for safe in [one.safe or 0.0] if one.rate_per_s),
    )  # fmt: skip
    rows = np.arange(len(state))  # passes: what is skipped moves no ramp
    since = rows - np.maximum.accumulate(np.where(state == State.FAULT, 0, rows))
    faulted = since > ramp_s * rig.config.rate_hz + 3
    for name, limit in limited.items():
        sent, safe = node.columns[f"tx.{name}"], limit.safe or 0.0
        if not ((sent >= limit.low) & (sent <= limit.high)).all():
            yield f"{name} was beyond its bounds"
        if limit.rate_per_s is not None:
            most = limit.rate_per_s / rig.config.rate_hz * (1.0 + 1e-9)
            if (np.abs(np.diff(sent)) > most * np.diff(node.cycle)).any():
                yield f"{name} was faster than its rate"
        if (sent[state == State.INIT] != safe).any():
            yield f"{name} was not safe in INIT"
        if (sent[faulted] != safe).any():
            yield f"{name} was not safe behind the ramp of a fault"
        ramps = (state[1:] == State.FAULT) & (state[:-1] == State.FAULT)
        if (np.diff(np.abs(sent - safe))[ramps] > 0.0).any():
            yield f"{name} rose in FAULT"


def damage(case: Case) -> Iterator[str]:
    """Yield a wrong value of a log that was cut or has flipped bits: told, or never wrong."""
    whole = case.path.read_bytes()
    cut = case.at("cut", 1, len(whole))
    at = case.at("flip", 8, len(whole) - 8)
    flipped = bytearray(whole)
    flipped[at] ^= 1 << random.Random(at).randrange(8)
    both, own = bytearray(whole[:cut]), at % cut
    both[own] ^= 1 << random.Random(own).randrange(8)
    true, turn = case.log, case.turn(3)
    ways = (
        (f"cut at {cut}", whole[:cut]), (f"bit of byte {own} flipped, too", both),
        (f"bit of byte {at} flipped", flipped),
    )  # fmt: skip
    for how, data in ways[2:] if turn == 2 else ways[: turn + 1]:
        path = case.folder / "damaged.mcap"
        path.write_bytes(data)
        with contextlib.suppress(logs.LogError):
            found = Opened(path).log
            for line in wrong_values(true, found):
                yield f"{how}: {line}"
            true = found if how.startswith("cut") else true  # of which the next lacks something


def wrong_values(true: logs.Log, found: logs.Log) -> Iterator[str]:
    """Yield values and frames of a damaged log that the true one does not have; loss is told."""
    lacks = []
    for role, node in true.node.items():
        if role not in found.node:
            lacks.append(role)
            continue
        other = found.node[role]
        at = np.searchsorted(node.cycle, other.cycle)
        if (at >= len(node.cycle)).any() or (node.cycle[at] != other.cycle).any():
            yield f"{role}: cycles that were not"
            continue
        for name, values in other.columns.items():
            if name not in node.columns or values.tobytes() != node.columns[name][at].tobytes():
                yield f"{role}: {name} is wrong"
        if _unlike(other, node):
            yield f"{role}: frames that were not"
        lost = len(other.cycle) < len(node.cycle) or _unlike(node, other) > 0
        is_cut = true.missing and [*other.cycle[-1:]] != [*node.cycle[-1:]]  # which was told
        lacks += [role] * (lost and not is_cut)
    told, before = ([one for one in log.missing if _NOT_SURE not in one] for log in (found, true))
    if lacks and told == before:
        yield f"parts of {lacks} are missing, and nothing tells it"


Promise = Callable[[Case], Iterator[str]]
PROMISES: dict[str, Promise] = {
    one.__name__: one
    for one in (
        bits, replayed, keyframe, branched, in_lanes, in_parts, verdict, frames, limits, damage,
        interpreted, lockstep,
    )
}  # fmt: skip


def broken(case: Case, names: Any = PROMISES) -> dict[str, list[str]]:
    """Return what is broken, by the name of its promise; RigError of a rig that is refused."""
    found = {}
    case.path  # noqa: B018
    for name in [one for one in names if one in PROMISES]:
        try:
            lines = list(PROMISES[name](case))
        except UserError as error:
            lines = [f"refused: {error}"]
        except Exception as error:
            lines = [f"{type(error).__name__}: {error}"]
        if lines:
            found[name] = lines
    return found
