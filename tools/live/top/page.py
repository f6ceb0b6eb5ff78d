"""The lines of the screen: what a `Meter` has, in as many columns and rows as there are."""

from collections.abc import Sequence

from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.canopen.layout import Power
from pcpc.executive.nodes.operating import in_charge, laws
from pcpc.tools.live.top.meter import Meter, NodeMeter

_DRIVE = {  # CiA 402
    Power.NOT_READY.word: "not ready", Power.SWITCH_ON_DISABLED.word: "disabled",
    Power.READY_TO_SWITCH_ON.word: "ready", Power.SWITCHED_ON.word: "switched on",
    Power.OPERATION_ENABLED.word: "enabled", Power.QUICK_STOP_ACTIVE.word: "quick stop",
    Power.FAULT_REACTION_ACTIVE.word: "fault reaction", Power.FAULT.word: "fault",
}  # fmt: skip
_OF_THE_DRIVE = 0x6F
_LEAST = 3  # rows of frames and of parameters, however low the screen is
_STATES = {
    "used": (FrameState.OK, FrameState.OK_SOME_LOST),
    "gaps": (FrameState.OK_SOME_LOST, FrameState.WRONG_SEQUENCE),
    "repeated": (FrameState.REPEATED,),
    "crc": (FrameState.ERROR,),
}


def lines(meter: Meter, columns: int, rows: int) -> list[str]:
    """Return at most `rows` lines of at most `columns` characters."""
    top = [*_head(meter), "", *_nodes(meter), *_trouble(meter), "", _load(meter), ""]
    errors = [*_errors(meter), ""]
    frames, parameters = _frames(meter), _parameters(meter.leader)
    if len(top) + len(errors) + len(frames) + 1 + len(parameters) > rows:  # no room for blanks
        top, errors = [line for line in top if line], [line for line in errors if line]
    room = max(rows - len(top) - len(errors), 2 * (_LEAST + 1))
    own = min(len(frames), max(room - min(len(parameters), room - room // 3), _LEAST + 1))
    shown = [*top, *_shortened_list(frames, own), *errors, *_shortened_list(parameters, room - own)]
    return [line[:columns].rstrip() for line in shown[:rows]]


def _shortened_list(texts: Sequence[str], count: int) -> list[str]:
    if len(texts) <= count:
        return list(texts)
    return [*texts[: count - 1], f"... {len(texts) - count + 1} more"]


def _head(meter: Meter) -> list[str]:
    live = meter.leader.live
    description, cycle = live.block.description, meter.leader.now.cycle
    facts, period_s = description["metadata"], 1e-9 * live.period_ns
    end = (
        f" of {description['cycles'] * period_s:g} s" if meter.leader.role == "executive" else " s"
    )
    law, standby = facts.get("controller", ""), ""
    if now := in_charge(live, meter.leader.now):
        law = f"{now} in charge"
        standby = f"  on standby: {', '.join(one for one in laws(live) if one != now)}"
    head = f"{description['rig']}  {law}  {facts.get('pacing', '')}"
    return [f"{head}  {cycle * period_s:.2f}{end}, cycle {cycle}", facts.get("bus", "") + standby]


def _nodes(meter: Meter) -> list[str]:
    table_lines = [
        f"{'node':10}{'state':6}{'drive':15}{'rate Hz':>8}{'late us p50':>13}{'p99':>8}{'worst':>8}"
        f"{'skip':>6}{'held':>6}"
    ]
    for node in meter.nodes:
        control, description = node.live.block.control, node.live.block.description
        state = description["state_names"][int(control.state)]
        word = int(node.now["supervisor.status_word"]) & _OF_THE_DRIVE
        clocked = description["metadata"].get("pacing") != "lockstep"
        times = [node.now[f"timing.wake_late_{what}_us"] for what in ("p50", "p99", "max")]
        shown = [f"{time:.1f}" if clocked else "-" for time in times]
        table_lines.append(
            f"{node.role:10}{state:6}{_DRIVE.get(word, f'0x{word:02X}'):15}{node.rate_hz:8.1f}"
            f"{shown[0]:>13}{shown[1]:>8}{shown[2]:>8}{control.skipped:6}{control.held:6}"
        )
    return table_lines


def _trouble(meter: Meter) -> list[str]:
    """Return faults, then the last alarms; a line that there are none."""
    found = [f"fault: {one.role}: {why}" for one in meter.nodes if (why := one.fault())]
    return [*found, *meter.alarm_lines] or ["no faults, no alarms"]


def _load(meter: Meter) -> str:
    bits = meter.bits_per_s()
    share = f", {100 * bits / meter.bitrate:.0f} % of the bus" if meter.bitrate else ""
    lost = sum(int(one.live.block.control.lost) for one in meter.nodes)
    return f"load {1e-3 * bits:.0f} kbit/s at most{share}; frames lost since the start: {lost}"


def _frames(meter: Meter) -> list[str]:
    head = "".join(f"{name:>9}" for name in _STATES)
    table_lines = [f"{'frame':22}{'to':10}{'a second':>9}{head}"]
    for row in meter.frames():
        counts = (sum(row.counts.get(state, 0) for state in states) for states in _STATES.values())
        told = "".join(f"{count:9}" for count in counts)
        table_lines.append(f"{row.name[:21]:22}{row.node:10}{row.rate_hz:9.1f}{told}")
    return table_lines


def _errors(meter: Meter) -> list[str]:
    table_lines = [f"{'error':40}{'now':>13}{'lately':>13}{'worst':>13}"]
    for node in meter.nodes:
        for name in node.errors[:2]:
            numbers = (node.now[name], node.interval_worst[name], node.worst[name])
            told = "".join(f"{number:13.4g}" for number in numbers)
            named = f"{name} [{node.live.variables[name].unit}]"
            table_lines.append(f"{named[:39]:40}{told}")
    return table_lines if len(table_lines) > 1 else []


def _parameters(node: NodeMeter) -> list[str]:
    """Return the leading node's parameters, those that were tuned first, with a mark."""
    initial = node.live.block.description.get("initial", {})
    law = "controller."  # what is tuned most
    names = sorted(initial, key=lambda n: (node.now[n] == initial[n], not n.startswith(law)))
    table_lines = [f"{'parameter':42}{'value':>13}{'rig':>13}"]
    for name in names:
        tuned = "*" if node.now[name] != initial[name] else " "
        named = f"{name} [{node.live.variables[name].unit}]"
        table_lines.append(f"{tuned}{named[:40]:41}{node.now[name]:13.6g}{initial[name]:13.6g}")
    return table_lines
