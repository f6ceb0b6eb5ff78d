"""The rig's faults on purpose, planned for one node: variables, seams, moments; then installed."""

import math
import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pcpc.drivers.can import dbc
from pcpc.drivers.can.wire_layout import LENGTHS
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.executive.durations import duration_ns
from pcpc.executive.errors import did_you_mean
from pcpc.executive.loop import injected_frames, injected_values, losses
from pcpc.executive.loop.injection import FOR_EVER
from pcpc.executive.loop.injection_layout import FAULT_DEPTH, MAX_FAULTS
from pcpc.executive.loop.table import Table, Variable, Views
from pcpc.executive.rig import messages
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import PLANTS, Role
from pcpc.executive.rig.schema import Fault

STALL, FLOOD = "stall", "flood"
WITHOUT_VALUE = {"stuck", "dropout", "nan", "loss", "repetition", "sequence", "insertion",
                 "masquerade", "addressing", "payload", "forgery", STALL}  # fmt: skip
GIVEN = {"corruption": 1.0, "delay": 1.0}  # sizes where the rig gives none
ABOVE_0 = (0.0, math.inf)
RANGES = {  # of sizes, where not every number makes sense
    "corruption": (0.0, 64.0), "delay": (0.0, FAULT_DEPTH - 1.0), "length": (0.0, 8.0),
    "counter": (-255.0, 255.0), "checksum": (-255.0, 255.0), "noise": ABOVE_0,
    "flood": (1.0, 200.0), "quantise": ABOVE_0,
    "saturation": ABOVE_0, "rate": ABOVE_0, "dead_zone": ABOVE_0,
}  # fmt: skip
PROTECTED = {"counter", "checksum", "payload", "masquerade", "forgery"}  # what has both
ANY = (-math.inf, math.inf)
HOWS = {"counter": injected_frames.HOWS, "checksum": injected_frames.HOWS, "payload": ("freeze",)}


class Group(NumberedEnum):
    """Where a fault acts."""

    VALUES, FRAMES, FLOODS, OWN_STALL, PEER_STALL = range(5)


@dataclass(frozen=True)
class PlannedFault:
    """A fault as a node has it: the place of `fault.NAME.left`, and what it acts on there."""

    name: str
    fault: Fault
    place: int
    group: Group
    seam: int = 0
    target: int = 0
    other: int = -1

    @property
    def acts_later(self) -> bool:
        """Whether it acts from the cycle after the one in which it is set."""
        return self.group not in (Group.VALUES, Group.FLOODS)


def add_faults(
    rig: Rig, role: Role, pacing: str, table: Table, views: list[Views], rx: list[dbc.Frame]
) -> list[PlannedFault]:
    """Add the variables of the faults that act in a node, those of values first. RigError."""
    found = [
        (name, fault, *place)
        for name, fault in rig.config.faults.items()
        for place in _places(rig, role, pacing, name, fault, table, views, rx)
    ]
    found.sort(key=lambda row: row[2])
    if len(found) > MAX_FAULTS:
        raise rig.error("faults", f"{len(found)} faults; one node holds {MAX_FAULTS}")
    planned = []
    for name, fault, group, seam, target, other in found:
        unit = table.variables[target].unit if group == Group.VALUES else ""
        help = f"{fault.kind} of {fault.at or fault.frame or fault.node}"
        place = table.add(
            _variable(name, "left", "", f"{help}: cycles for which it is on", 0.0, FOR_EVER, True)
        )
        span = _range_of(rig, fault)
        table.add(_variable(name, "value", unit, f"{help}: how large it is", *span))
        table.add(_variable(name, "share", "", f"{help}: in how many of all chances", 1e-9, 1.0))
        table.add(_variable(name, "burst", "", f"{help}: in a row, on average", 1.0, 1e9))
        planned.append(PlannedFault(name, fault, place, group, seam, target, other))
    return planned


def _variable(
    name: str,
    what: str,
    unit: str,
    help: str,
    low: float = float("-inf"),
    high: float = float("inf"),
    recorded: bool = False,
) -> Variable:
    return Variable(
        f"fault.{name}.{what}", unit, "parameter", "rig", help, low, high, recorded=recorded
    )


def values_of(planned: PlannedFault) -> Iterator[tuple[int, float]]:
    """Yield places and first values of a fault's variables."""
    fault = planned.fault
    size = GIVEN.get(fault.kind, 0.0) if fault.value is None else fault.value
    yield from enumerate((0.0, size, fault.share, fault.burst), planned.place)


def moments_of(rig: Rig, role: Role, planned: PlannedFault) -> Iterator[tuple[int, int, float]]:
    """Yield cycle, place and value of the tunings by which a fault begins.

    What acts on frames, or instead of a cycle, is set in the cycle before; of a stall of the node
    above the plant misses the frames one cycle later.
    """
    fault, rate_hz = planned.fault, rig.config.rate_hz
    if fault.from_ is None and fault.every is None and fault.times is None:
        return
    end = round(rig.config.duration_s * rate_hz)
    first = _cycles(fault.from_, rate_hz) or 0
    cycles = FOR_EVER if fault.for_ is None else float(_cycles(fault.for_, rate_hz) or 0)
    if fault.times is not None:
        draw = random.Random(f"{rig.config.seed} {planned.name}")
        starts = sorted(draw.randrange(first, max(end, first + 1)) for _ in range(fault.times))
    elif fault.every is not None:
        starts = list(range(first, end, max(_cycles(fault.every, rate_hz) or 1, 1)))
    else:
        starts = [first]
    early = int(planned.acts_later)
    if planned.group == Group.PEER_STALL and role in PLANTS:
        early = 0
    for start in starts:
        yield max(start - early, 0), planned.place, cycles


def _cycles(duration: str | None, rate_hz: float) -> int | None:
    return None if duration is None else round(1e-9 * duration_ns(duration, zero=True) * rate_hz)


def install_faults(rig: Rig, role: Role, planned: list[PlannedFault], loop: Any) -> None:
    """Write a node's faults into its LOOP record."""
    faults = loop.faults
    rows = [one for one in planned if one.group in (Group.VALUES, Group.FRAMES, Group.FLOODS)]
    faults.n_values, faults.n_floods = (
        sum(one.group == group for one in rows) for group in (Group.VALUES, Group.FLOODS)
    )
    faults.n = len(rows) - faults.n_floods
    faults.n_places = len(planned)
    for i, one in enumerate(planned):
        faults.every_place[i] = one.place
        if one.group == Group.OWN_STALL:
            faults.own_stall[faults.n_own_stalls] = one.place
            faults.n_own_stalls += 1
        elif one.group == Group.PEER_STALL:
            faults.peer_stall[faults.n_peer_stalls] = one.place
            faults.n_peer_stalls += 1
    for f, one in enumerate(rows):
        kinds = (injected_values.KINDS, injected_frames.KINDS, (FLOOD,))[one.group]
        faults.kind[f] = kinds.index(one.fault.kind)
        faults.how[f] = injected_frames.HOWS.index(one.fault.how or "value")
        faults.place[f], faults.seam[f] = one.place, one.seam
        faults.target[f], faults.other[f] = one.target, one.other
        faults.seed[f] = losses.first(rig.config.seed, f"{one.name} {role}")
        faults.since[f], faults.goes_on[f] = -1, one.fault.goes_on
        if one.group == Group.FRAMES:
            faults.spoiled[one.target] = 1


def _places(
    rig: Rig,
    role: Role,
    pacing: str,
    name: str,
    fault: Fault,
    table: Table,
    views: list[Views],
    rx: list[dbc.Frame],
) -> Iterator[tuple[Group, int, int, int]]:
    """Yield group, seam, target, other of a fault in this node; nothing if it acts elsewhere."""
    key = f"faults.{name}"
    _check(rig, key, fault)
    if fault.at is not None:
        node, colon, variable = fault.at.rpartition(":")
        if (node if colon else "executive") == role:
            yield Group.VALUES, *_seam(rig, key, fault, table, views, variable), -1
    elif fault.frame is not None:
        names = [frame.name for frame in rx]
        if fault.frame in names and fault.node in (None, role):
            row = names.index(fault.frame)
            yield Group.FRAMES, 0, row, _other(rig, key, fault, rx, row)
    elif fault.kind == FLOOD:
        if fault.node == role:
            yield Group.FLOODS, 0, _unknown_id(rig), -1
    elif fault.node == role:
        yield Group.OWN_STALL, 0, 0, -1
    elif pacing == "lockstep":
        yield Group.PEER_STALL, 0, 0, -1


def _check(rig: Rig, key: str, fault: Fault) -> None:
    """Raise RigError for keys that do not go together."""
    of_values, of_frames = injected_values.KINDS, injected_frames.KINDS
    known = [*of_values, *(k for k in of_frames if k not in of_values), STALL, FLOOD]
    if fault.kind not in known:
        cure = did_you_mean(fault.kind, known) or f"; known: {', '.join(known)}"
        raise rig.error(f"{key}.kind", f"no kind {fault.kind}{cure}")
    if sum(place is not None for place in (fault.at, fault.frame)) > 1:
        raise rig.error(f"{key}.frame", "a fault has either at or frame")
    if fault.kind in (STALL, FLOOD):
        if fault.node is None or fault.at is not None or fault.frame is not None:
            what = f"a {fault.kind} has node: executive or plant, and neither at nor frame"
            raise rig.error(key, what)
        if fault.kind == STALL and len(rig.roles) > 2:
            raise rig.error(key, "a stall needs a rig of two nodes")
    elif fault.at is None and fault.frame is None:
        what = f"at: a variable ({', '.join(of_values)})"
        raise rig.error(key, f"what is disturbed? {what}; or frame: a frame's name")
    elif fault.at is not None and fault.kind not in of_values:
        raise rig.error(f"{key}.kind", f"{fault.kind} is a fault of a frame; write frame: NAME")
    elif fault.frame is not None and fault.kind not in of_frames:
        raise rig.error(f"{key}.kind", f"{fault.kind} is a fault of a value; write at: VARIABLE")
    if fault.how is not None and fault.how not in HOWS.get(fault.kind, ()):
        raise rig.error(f"{key}.how", f"{fault.kind} knows {_list(HOWS.get(fault.kind, ()))}")
    if fault.kind == "payload" and fault.how is None:
        raise rig.error(key, "payload needs how: freeze; for random data use kind: masquerade")
    if fault.goes_on and fault.kind != "counter":
        raise rig.error(f"{key}.goes_on", "only a fault of kind counter has goes_on")
    needless = fault.kind in WITHOUT_VALUE or fault.how in ("freeze", "random")
    if fault.value is None and not needless and fault.kind not in GIVEN:
        raise rig.error(key, f"{fault.kind} needs a value: how large it is")
    low, high = _range_of(rig, fault)
    if fault.value is not None and not low <= fault.value <= high:
        what = f"{fault.value:g} is outside {low:g}..{high:g}, which a {fault.kind} may have"
        raise rig.error(f"{key}.value", what)
    _check_moments(rig, key, fault)
    if fault.at is not None and fault.node is not None:
        raise rig.error(f"{key}.node", "for a value, at names the node: plant:NAME")
    if (fault.data_of is None) == (fault.kind == "addressing"):
        raise rig.error(key, "addressing, and nothing else, has data_of: another frame's name")


def _range_of(rig: Rig, fault: Fault) -> tuple[float, float]:
    """Return how large a fault may be."""
    frames = messages.frames_of_rig(rig, messages.database_of(rig))
    if fault.kind == "length" and any(one.fd and one.name == fault.frame for one in frames):
        return 0.0, float(LENGTHS[-1])
    return RANGES.get(fault.kind, ANY)


def _check_moments(rig: Rig, key: str, fault: Fault) -> None:
    """Raise RigError for a fault that would never begin, or never end where it has to."""
    begins = (fault.from_, fault.every, fault.times)
    if fault.for_ is not None and all(one is None for one in begins):
        raise rig.error(f"{key}.for", "when does it begin? give from, every or times as well")
    if fault.every is not None and fault.times is not None:
        raise rig.error(f"{key}.times", "give either every or times")
    if fault.every is not None and fault.for_ is None:
        raise rig.error(f"{key}.every", "how long does it last each time? give for as well")
    config = rig.config
    late = (_cycles(fault.from_, config.rate_hz) or 0) >= round(config.duration_s * config.rate_hz)
    shortened, own = (
        rig.where(path).startswith("--set ") for path in ("duration_s", f"{key}.from")
    )
    if late and (own or not shortened):
        end = f"the end of the run at {config.duration_s:g} s"
        raise rig.error(f"{key}.from", f"{fault.from_} is after {end}")


def fault_descriptions(planned: list[PlannedFault]) -> dict[str, dict[str, Any]]:
    """Return what clients and summaries need to know of each fault of a node."""
    return {
        one.name: {
            "kind": one.fault.kind, "of": one.fault.at or one.fault.frame or one.fault.node,
            "next_cycle": one.acts_later,
        }
        for one in planned
    }  # fmt: skip


def _list(names: tuple[str, ...]) -> str:
    return f"how: {', '.join(names)}" if names else "no how"


def _seam(
    rig: Rig, key: str, fault: Fault, table: Table, views: list[Views], name: str
) -> tuple[int, int]:
    """Return where in a cycle a variable is disturbed, and its place."""
    if name not in table.index:
        raise rig.error(f"{key}.at", f"no variable {name}{did_you_mean(name, table.index)}")
    place = table.index[name]
    for b, view in enumerate(views):
        if place in view.inputs:
            return b, place
        if place in view.outputs:
            return injected_values.OUTPUTS + b, place
    kind = table.variables[place].kind
    if kind == "sent":
        return injected_values.SENT, place
    if kind != "parameter" or name.startswith(("timing.", "fault.")):
        cure = "; disturb the input that it is wired to" if kind == "received" else ""
        raise rig.error(
            f"{key}.at",
            f"{name} is neither an input, output or parameter of a block nor sent{cure}",
        )
    return injected_values.PARAMETERS, place


def _other(rig: Rig, key: str, fault: Fault, rx: list[dbc.Frame], row: int) -> int:
    """Return the row of the frame whose data come instead, -1 for none; check counter and CRC."""
    protected = rx[row].protected
    if fault.kind in PROTECTED and not protected:
        raise rig.error(f"{key}.frame", f"{fault.frame} has no counter and CRC")
    if fault.data_of is None:
        return -1
    names = [frame.name for frame in rx]
    if fault.data_of not in names:
        what = f"{fault.data_of} does not reach the same node{did_you_mean(fault.data_of, names)}"
        raise rig.error(f"{key}.data_of", what)
    return names.index(fault.data_of)


def _unknown_id(rig: Rig) -> int:
    """Return the lowest id of 11 bits that the rig's DBC file has not."""
    known = {message.frame_id for message in dbc.load(rig.dbc).messages}
    return next(i for i in range(1, 2048) if i not in known)


def check_frames(rig: Rig, known: dict[Role, list[str]]) -> None:
    """Raise RigError for a fault that acts nowhere: a frame or a node that the rig has not."""
    for name, fault in rig.config.faults.items():
        key = f"faults.{name}"
        if fault.frame is not None:
            every = sorted({frame for names in known.values() for frame in names})
            if fault.frame not in every:
                what = f"no frame {fault.frame}{did_you_mean(fault.frame, every)}"
                raise rig.error(f"{key}.frame", what)
            if fault.node is not None and fault.frame not in known.get(fault.node, []):
                raise rig.error(f"{key}.node", f"{fault.node} does not receive {fault.frame}")
        if fault.at is not None and ":" in fault.at:
            node = fault.at.rpartition(":")[0]
            if node not in rig.roles:
                what = f"no node {node}{did_you_mean(node, rig.roles)}"
                raise rig.error(f"{key}.at", what)
        if fault.node is not None and fault.node not in rig.roles:
            raise rig.error(f"{key}.node", f"the rig has no node {fault.node}")
