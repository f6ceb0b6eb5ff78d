"""The rig's faults on purpose, planned for one node: variables, seams, moments; then installed."""

from collections.abc import Iterator
from dataclasses import replace

from pcpc.drivers.can import dbc
from pcpc.drivers.can.wire_layout import LENGTHS
from pcpc.executive.errors import did_you_mean
from pcpc.executive.log.description import NodeDescription
from pcpc.executive.loop import draws, injected_values
from pcpc.executive.loop.fault_kinds import (
    BY_THEMSELVES,
    HOWS,
    KINDS,
    FaultKind,
    WrongFrame,
    WrongNode,
    WrongValue,
)
from pcpc.executive.loop.injection import FOR_EVER
from pcpc.executive.loop.injection_layout import MAX_FAULTS
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.table import Variable
from pcpc.executive.nodes.acting_faults import ActingFault, Seam, cycles_in
from pcpc.executive.nodes.part import Part, Plan
from pcpc.executive.rig import messages
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.executive.rig.schema import Fault


class Faults(Part):
    """The rig's faults on purpose that act in a node."""

    def variables(self, made: Plan) -> None:
        """Add four variables a fault, those of values first, and when it begins; RigError."""
        rig, role, table = made.rig, made.role, made.table
        check_frames(rig, messages.received_frames(rig, messages.database_of(rig)))
        of_node = [
            one
            for name in rig.config.faults
            for one in _acting(made, name, rig.config.faults[name])
        ]
        of_node.sort(key=lambda one: one.group)
        if len(of_node) > MAX_FAULTS:
            raise rig.error("faults", f"{len(of_node)} faults; one node holds {MAX_FAULTS}")
        for acting in of_node:
            unit = table.variables[acting.target].unit if acting.group == Seam.VALUES else ""
            made.faults.append(replace(acting, place=_add_variables(made, acting, unit)))
        for acting in made.faults:
            for row in acting.moments(rig, role):
                made.tune_at(*row)

    def in_no_lane(self, rig: Rig) -> str:
        """Return that there are some."""
        return "it has faults on purpose" if rig.config.faults else ""

    def install(self, made: Plan, loop: Loop) -> None:
        """Write what each acts on, and where the generators begin."""
        faults, planned = loop.faults, made.faults
        rows = [one for one in planned if one.group in (Seam.VALUES, Seam.FRAMES, Seam.FLOODS)]
        faults.n_values, faults.n_floods = (
            sum(one.group == group for one in rows) for group in (Seam.VALUES, Seam.FLOODS)
        )
        faults.n = len(rows) - faults.n_floods
        faults.n_places = len(planned)
        for i, acting in enumerate(planned):
            faults.every_place[i] = acting.place
            if acting.group == Seam.OWN_STALL:
                faults.own_stall[faults.n_own_stalls] = acting.place
                faults.n_own_stalls += 1
            elif acting.group == Seam.PEER_STALL:
                faults.peer_stall[faults.n_peer_stalls] = acting.place
                faults.n_peer_stalls += 1
        for f, acting in enumerate(rows):
            if acting.group != Seam.FLOODS:
                faults.kind[f] = acting.kind
            faults.how[f] = HOWS.index(acting.fault.how or "value")
            faults.place[f], faults.seam[f] = acting.place, acting.seam
            faults.target[f], faults.other[f] = acting.target, acting.other
            faults.seed[f] = draws.first(made.rig.config.seed, f"{acting.name} {made.role}")
            faults.since[f], faults.goes_on[f] = -1, acting.fault.goes_on
            if acting.group == Seam.FRAMES:
                faults.spoiled[acting.target] = 1

    def described(self, made: Plan) -> NodeDescription:
        """Return what clients and summaries need to know of each."""
        return {
            "faults": {
                acting.name: {
                    "kind": acting.fault.kind,
                    "of": acting.fault.at or acting.fault.frame or acting.fault.node,
                    "next_cycle": acting.acts_later,
                }
                for acting in made.faults
            }
        }


def _add_variables(made: Plan, planned: ActingFault, unit: str) -> int:
    """Add the variables of a fault; return the place of the first."""
    name, fault, kind = planned.name, planned.fault, planned.kind
    help = f"{fault.kind} of {fault.at or fault.frame or fault.node}"
    size = kind.row.given or 0.0 if fault.value is None else fault.value
    rows = (
        ("left", "", "cycles for which it is on", (0.0, FOR_EVER), 0.0),
        ("value", unit, "how large it is", _range_of(made.rig, fault, kind), size),
        ("share", "", "in how many of all chances", (1e-9, 1.0), fault.share),
        ("burst", "", "in a row, on average", (1.0, 1e9), fault.burst),
    )
    for what, its, means, span, value in rows:
        own, keep = f"fault.{name}.{what}", what == "left"
        told = f"{help}: {means}"
        made.add(Variable(own, its, "parameter", "rig", told, *span, recorded=keep), value)
    return made.table.index[f"fault.{name}.left"]


def _acting(made: Plan, name: str, fault: Fault) -> Iterator[ActingFault]:
    """Yield a fault as it acts in this node; nothing if it acts elsewhere."""
    rig, role, rx = made.rig, made.role, made.rx_frames
    key = f"faults.{name}"
    kind = _check(rig, key, fault)
    if fault.at is not None:
        node, colon, variable = fault.at.rpartition(":")
        if (node if colon else "executive") == role:
            yield ActingFault(name, fault, kind, Seam.VALUES, *_seam(made, key, variable))
    elif fault.frame is not None:
        names = [frame.name for frame in rx]
        if fault.frame in names and fault.node in (None, role):
            row = names.index(fault.frame)
            if kind.row.protected and not rx[row].protected:
                raise rig.error(f"{key}.frame", f"{fault.frame} has no counter and CRC")
            other = _other(rig, key, fault, names)
            yield ActingFault(name, fault, kind, Seam.FRAMES, 0, row, other)
    elif kind is WrongNode.FLOOD:
        if fault.node == role:
            yield ActingFault(name, fault, kind, Seam.FLOODS, 0, _unknown_id(rig))
    elif fault.node == role:
        yield ActingFault(name, fault, kind, Seam.OWN_STALL)
    elif made.pacing == "lockstep":
        yield ActingFault(name, fault, kind, Seam.PEER_STALL)


def _check(rig: Rig, key: str, fault: Fault) -> FaultKind:
    """Return the kind of a fault; RigError for keys that do not go together."""
    kind = _kind_of(rig, key, fault)
    row, hows = kind.row, kind.row.hows
    if fault.how is not None and fault.how not in hows:
        known = f"how: {', '.join(hows)}" if hows else "no how"
        raise rig.error(f"{key}.how", f"{kind.word} knows {known}")
    if hows and "value" not in hows and fault.how is None:
        problem = f"{kind.word} needs how: {', '.join(hows)}; for random data use kind: masquerade"
        raise rig.error(key, problem)
    if fault.goes_on and not row.counts_on:
        those = " or ".join(one.word for one in WrongFrame if one.row.counts_on)
        raise rig.error(f"{key}.goes_on", f"only a fault of kind {those} has goes_on")
    needless = not row.sized or fault.how in BY_THEMSELVES
    if fault.value is None and row.given is None and not needless:
        raise rig.error(key, f"{kind.word} needs a value: how large it is")
    low, high = _range_of(rig, fault, kind)
    if fault.value is not None and not low <= fault.value <= high:
        problem = f"{fault.value:g} is outside {low:g}..{high:g}, which a {kind.word} may have"
        raise rig.error(f"{key}.value", problem)
    _check_moments(rig, key, fault)
    if fault.at is not None and fault.node is not None:
        raise rig.error(f"{key}.node", "for a value, at names the node: plant:NAME")
    if (fault.data_of is not None) != row.copies:
        those = " or ".join(one.word for one in WrongFrame if one.row.copies)
        problem = f"{those}, and nothing else, has data_of: another frame's name"
        raise rig.error(key, problem)
    return kind


def _kind_of(rig: Rig, key: str, fault: Fault) -> FaultKind:
    """Return the kind that a fault names, of what it disturbs; RigError."""
    if fault.kind not in KINDS:
        cure = did_you_mean(fault.kind, KINDS) or f"; known: {', '.join(KINDS)}"
        raise rig.error(f"{key}.kind", f"no kind {fault.kind}{cure}")
    if fault.at is not None and fault.frame is not None:
        raise rig.error(f"{key}.frame", "a fault has either at or frame")
    kind = WrongNode.of(fault.kind)
    if kind is not None:
        if fault.node is None or fault.at is not None or fault.frame is not None:
            problem = f"a {kind.word} has node: executive or plant, and neither at nor frame"
            raise rig.error(key, problem)
        if kind is WrongNode.STALL and len(rig.roles) > 2:
            raise rig.error(key, "a stall needs a rig of two nodes")
        return kind
    if fault.at is None and fault.frame is None:
        problem = f"at: a variable ({', '.join(WrongValue.words())})"
        raise rig.error(key, f"what is disturbed? {problem}; or frame: a frame's name")
    if fault.at is not None:
        kind, cure = WrongValue.of(fault.kind), "a fault of a frame; write frame: NAME"
    else:
        kind, cure = WrongFrame.of(fault.kind), "a fault of a value; write at: VARIABLE"
    if kind is None:
        raise rig.error(f"{key}.kind", f"{fault.kind} is {cure}")
    return kind


def _range_of(rig: Rig, fault: Fault, kind: FaultKind) -> tuple[float, float]:
    """Return how large a fault may be."""
    if kind is WrongFrame.LENGTH:
        frames = messages.frames_of_rig(rig, messages.database_of(rig))
        if any(frame.fd and frame.name == fault.frame for frame in frames):
            return 0.0, float(LENGTHS[-1])
    return kind.row.low, kind.row.high


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
    past = round(config.duration_s * config.rate_hz)
    if (cycles_in(fault.from_, config.rate_hz) or 0) < past:
        return
    shortened, from_is_set = (
        rig.where(path).startswith("--set ") for path in ("duration_s", f"{key}.from")
    )
    if from_is_set or not shortened:
        end = f"the end of the run at {config.duration_s:g} s"
        raise rig.error(f"{key}.from", f"{fault.from_} is after {end}")


def _seam(made: Plan, key: str, name: str) -> tuple[int, int]:
    """Return where in a cycle a variable is disturbed, and its place."""
    rig, table = made.rig, made.table
    rig.known(f"{key}.at", name, table.index, "variable")
    place = table.index[name]
    for b, view in enumerate(made.views):
        if place in view.inputs:
            return b, place
        if place in view.outputs:
            return injected_values.OUTPUTS + b, place
    kind = table.variables[place].kind
    if kind == "sent":
        return injected_values.SENT, place
    if kind != "parameter" or name.startswith("timing."):
        cure = "; disturb the input that it is wired to" if kind == "received" else ""
        raise rig.error(
            f"{key}.at",
            f"{name} is neither an input, output or parameter of a block nor sent{cure}",
        )
    return injected_values.PARAMETERS, place


def _other(rig: Rig, key: str, fault: Fault, names: list[str]) -> int:
    """Return the row of the frame whose data come instead, -1 for none."""
    if fault.data_of is None:
        return -1
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
            rig.known(f"{key}.frame", fault.frame, every, "frame")
            if fault.node is not None and fault.frame not in known.get(fault.node, []):
                raise rig.error(f"{key}.node", f"{fault.node} does not receive {fault.frame}")
        if fault.at is not None and ":" in fault.at:
            rig.known(f"{key}.at", fault.at.rpartition(":")[0], rig.roles, "node")
        if fault.node is not None and fault.node not in rig.roles:
            raise rig.error(f"{key}.node", f"the rig has no node {fault.node}")
