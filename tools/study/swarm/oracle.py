"""What a run must come to, by the frames of its nodes and the world: no code of the loop.

    accepted    each frame's state by counter and CRC                           as `drivers.can.e2e`
    decoded     its signals, bit by bit; what was sent lies within half a step of what was meant
    silent      a node faults in the cycle that ends `fault_after_cycles` of them without its input
    verdict     safety stop > loss > expectation not met > ok

Where something else decides, such as a value that is not plausible, the oracle does not.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.durations import duration_ns
from pcpc.executive.log.reader import NodeLog
from pcpc.tools.after.verdict.judge import Judge
from pcpc.tools.study.swarm.bits import crc_of, number, value
from pcpc.tools.study.swarm.case import Case
from pcpc.tools.study.swarm.files import TUNABLE, World, frames_of, scale

_OK, _SOME_LOST, _REPEATED, _WRONG, _ERROR, _TAKEN, _FOREIGN, _INJECTED = 0, 1, 2, 3, 4, 6, 7, 16
_REASONS = {"repeated": _REPEATED, "wrong_sequence": _WRONG, "crc_errors": _ERROR}
_MOST_DELTA, _ON_THE_WAY, _FOREIGN_FRAMES = 4, 3, 3
_INIT, _READY, _RUN, _HOLD, _FAULT, _STOP = range(6)
_SILENT, _NEVER = 1, 1 << 62
_NO_NUMBER = "nan", "corruption", "payload", "addressing", "masquerade", "forgery", "insertion"
_LIKELY = {  # faults that a rig or its history has to have: words of its text, any of them
    2: _NO_NUMBER, 8: _NO_NUMBER, 9: _NO_NUMBER, 3: ("stall", "flood", "emulate", "FB_", "CMD_"),
    12: ("estop",), 5: ("overrun",), 7: ("faults", "emulate"), 14: ("plausible",),
    15: ("intrusion",), 16: ("emulate",), 6: ("send",),
}  # fmt: skip


def received(world: World, role: str) -> Iterator[tuple[str, int, World]]:
    """Yield the frames that a node hears: name, id, what the world says of it."""
    yield from (one[:3] for one in frames_of(world) if one[4] == role)


def frames(case: Case) -> Iterator[str]:
    """Yield frames that were taken for what they are not, or decoded to what they do not say."""
    if case.world["around"] is not None:
        return
    for role, node in case.log.node.items():
        for name, word, frame in received(case.world, role):
            rows = _frames_of(node, word, 1)
            states = accepted(rows[rows["e2e"] != _TAKEN], frame, word)
            told = rows["e2e"][rows["e2e"] != _TAKEN] % _INJECTED
            differ = np.flatnonzero(states != told)
            if len(differ):
                at = differ[0]
                yield f"{role}: {name} in cycle {rows['cycle'][at]}: {told[at]}, not {states[at]}"
            yield from _misread(case, role, name, rows, frame)
            yield from _astray(case, role, name, word)
        yield from _unlike_sent(case, role, node)
        yield from _acted(case, role, node)
    for role, account in case.summary.frames_to.items():
        if role not in case.log.node:  # heard by nobody
            continue
        spent = sum(count for key, count in account.items() if key not in ("sent", "away"))
        if account.get("unread", 0) < 0 or account["sent"] != spent:
            yield f"{role}: of {account['sent']} frames {account}"
        came = case.log.node[role].frames
        states = came["e2e"][came["direction"] == 1]
        for name, state in _REASONS.items():
            if account[name] != (states == state).sum():
                yield f"{role}: {account[name]} {name}, {(states == state).sum()} in the log"


def _frames_of(node: NodeLog, word: int, direction: int) -> NDArray[Any]:
    """Return the frames of an id that a node sent (0) or that came (1)."""
    return node.frames[(node.frames["id"] == word) & (node.frames["direction"] == direction)]


def _used(rows: NDArray[Any]) -> NDArray[Any]:
    """Return those that are right, also by a fault."""
    return rows[np.isin(rows["e2e"] % _INJECTED, (_OK, _SOME_LOST))]


def _acted(case: Case, role: str, node: NodeLog) -> Iterator[str]:
    """Yield what was done from outside, and was not told or taken as it must be."""
    came, least, most = int((node.frames["e2e"] == _FOREIGN).sum()), 0, 0
    noted = {(t["cycle"], t["name"], t["value"]) for t in node.tunings}
    for to, passes, act in case.acts:
        count, asked = act.get("send", 0), act.get("set", {})
        most += count * (to == role)
        if to != role or passes >= len(node.cycle):  # or as it ends, which is in no row
            continue
        if passes + _ON_THE_WAY < len(node.cycle):
            least += count
            if count >= _FOREIGN_FRAMES and not node.columns["supervisor.fault"][passes:].any():
                yield f"{role}: {count} frames of another sender are no fault"
        right = all(one in TUNABLE and abs(x) <= 100.0 for one, x in asked.items())
        k = int(node.cycle[passes])
        if any(((k, *one) in noted) is not right for one in asked.items()):
            yield f"{role}: {asked}, asked in cycle {k}: {'not ' * right}taken"
    if not least <= came <= most:
        yield f"{role}: {came} frames of another sender, not {most}"


def _astray(case: Case, role: str, name: str, word: int) -> Iterator[str]:
    """Yield frames that were sent on an ideal bus, did not come, and were not on the way."""
    config = case.rig.config
    stalls = any(one.kind == "stall" for one in config.faults.values())
    if config.bus.emulate is not None or stalls:
        return
    heard = case.log.node[role]
    sender = case.log.node[next(one[3] for one in frames_of(case.world) if one[0] == name)]
    came = int((_frames_of(heard, word, 1)["e2e"] < _INJECTED).sum())
    past = int(heard.cycle[-1]) if len(heard.cycle) else 0
    sent = int((_frames_of(sender, word, 0)["cycle"] < past).sum())
    if not -_ON_THE_WAY <= sent - came <= _ON_THE_WAY:
        yield f"{role}: {name} was sent {sent} times and came {came} times"


def accepted(rows: NDArray[Any], frame: World, word: int) -> NDArray[np.int64]:
    """Return the state of each frame in turn, of its length, CRC and counter."""
    right = rows["dlc"] == frame["length"]
    if not frame["crc"]:
        return np.where(right, _OK, _ERROR)
    right &= crc_of(rows, frame, word) == number(rows["data"], frame["signals"]["crc"])
    counters = number(rows["data"], frame["signals"]["counter"]).tolist()
    turn, last, found = 1 << frame["signals"]["counter"]["bits"], None, []
    for counter, is_right in zip(counters, right.tolist(), strict=True):
        if not is_right:
            found.append(_ERROR)
            continue
        delta = 1 if last is None else (counter - last) % turn
        last = counter if delta else last
        found.append(
            _REPEATED if delta == 0 else _OK if delta == 1
            else _SOME_LOST if delta <= _MOST_DELTA else _WRONG
        )  # fmt: skip
    return np.array(found, np.int64)


def _misread(case: Case, role: str, name: str, rows: NDArray[Any], frame: World) -> Iterator[str]:
    """Yield signals whose value is not that of the last frame that was used in the cycle."""
    keys = case.rig.config
    judged = {**keys.executive.plausible} if role == "executive" else {}
    if keys.supervisor.intrusion != "count":
        return
    node, used = case.log.node[role], _used(rows)
    last = np.append(np.diff(used["cycle"]) != 0, True)[: len(used)]
    used, at = _recorded(node, used[last])
    for signal, about in frame["signals"].items():
        column = node.columns.get(f"rx.{name}.{signal}")
        own = f"{name}.{signal}" not in judged
        if column is None or not own or signal in ("counter", "crc"):
            continue
        there = value(used["data"], about)
        wrong = (there != column[at]) & ~(np.isnan(there) & np.isnan(column[at]))
        gain, state = (node.columns[f"supervisor.{one}"][at] for one in ("gain", "state"))
        ramps = (gain < 1.0) | (state > _HOLD)
        wrong &= ~ramps & _is_there(used, frame, about)  # of what a plant hears to what is safe
        if wrong.any():
            k = int(np.argmax(wrong))
            where = f"{role}: {name}.{signal} in cycle {node.cycle[at[k]]}"
            yield f"{where}: {column[at[k]]}, not {there[k]}"


def _is_there(rows: NDArray[Any], frame: World, about: World) -> NDArray[np.bool_]:
    """Return in which frames a signal is, by the layout that each says it has."""
    which = frame["signals"].get("which")
    if about["layout"] in (None, -1) or which is None:
        return np.ones(len(rows), np.bool_)
    return np.asarray(number(rows["data"], which) == about["layout"])


def _recorded(node: NodeLog, rows: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Return the frames of cycles that the node recorded, and where these are in its columns."""
    at = np.searchsorted(node.cycle, rows["cycle"])
    there = np.isin(rows["cycle"], node.cycle)
    return rows[there], at[there]


def _unlike_sent(case: Case, role: str, node: NodeLog) -> Iterator[str]:
    """Yield signals of sent frames that are farther than half a step from what was meant."""
    for name, word, frame in (one[:3] for one in frames_of(case.world) if one[3] == role):
        rows, at = _recorded(node, _frames_of(node, word, 0))
        if (rows["dlc"] != frame["length"]).any():
            yield f"{role}: {name} was sent with another length"
        for signal, about in frame["signals"].items():
            column = node.columns.get(f"tx.{name}.{signal}")
            if column is None:
                continue
            sent, meant = value(rows["data"], about), column[at]
            none = np.isnan(meant)  # which is sent as 0
            if about["kind"] == "float":
                wrong = sent != np.where(none, 0.0, meant.astype(np.float32))
            else:
                factor, offset = scale(about)
                low = -(1 << about["bits"] - 1) if about["kind"] == "signed" else 0
                ends = np.array([low, low + (1 << about["bits"]) - 1]) * factor + offset
                wrong = np.abs(sent - np.clip(meant, ends[0], ends[1])) > 0.5001 * factor
            if not (np.isfinite(meant).all() or _may_be_none(case)):
                wrong |= ~np.isfinite(meant)
            wrong &= _is_there(rows, frame, about)
            if wrong.any():
                k = int(np.argmax(wrong))
                where = f"{role}: {name}.{signal} in cycle {rows['cycle'][k]}"
                yield f"{where}: {sent[k]}, not {meant[k]}"


def _may_be_none(case: Case) -> bool:
    """Return whether a fault made a NaN, or a frame brought one: a forged float is any number."""
    return any(one.kind == "nan" for one in case.rig.config.faults.values()) or any(
        not np.isfinite(value(_frames_of(node, word, 1)["data"], signal)).all()
        for role, node in case.log.node.items()
        for _, word, frame in received(case.world, role)
        for signal in frame["signals"].values()
        if signal["kind"] == "float"
    )


# Faults and the verdict


def verdict(case: Case) -> Iterator[str]:
    """Yield where a node faulted, or did not, or the run came to what it did not deserve."""
    top = case.log.node["executive"]
    for name, one in case.rig.config.executive.plausible.items():
        x = top.columns.get(f"rx.{name}")
        if x is not None and not (((x >= one.low) & (x <= one.high)) | (x == x[0])).all():
            yield f"{name} was taken, which is not plausible"
    pressed = top.columns.get(f"rx.{case.rig.config.supervisor.estop}", np.zeros(1)) != 0.0
    if (pressed & (top.columns["supervisor.state"] < _FAULT)).any():
        yield "the emergency stop was pressed, and the executive went on"
    for role, node in case.log.node.items():
        if case.world["around"] is None:
            yield from _silence(case, role, node)
        yield from _groundless(case, role, node)
    yield from _not_begun(case)
    yield from _requirements(case)
    wanted, why = deserved(case)
    if case.summary.verdict not in wanted:
        yield f"verdict {case.summary.verdict}, not {' or '.join(sorted(wanted))}: {why}"


def _silence(case: Case, role: str, node: NodeLog) -> Iterator[str]:
    """Yield a cycle whose state is not that of the input that came."""
    config = case.rig.config
    doubts = config.supervisor.intrusion == "hold" or (
        role == "executive" and config.executive.plausible
    )
    drives = role == "plant" and "drive" in case.world  # which waits for nobody
    if doubts or drives or not len(node.cycle) or config.supervisor.intrusion == "fault":
        return
    state, k = node.columns["supervisor.state"], node.cycle
    fault = node.columns["supervisor.fault"]
    fresh = np.ones(len(k), bool)
    for _, word, frame in received(case.world, role):
        fresh &= np.isin(k, _used(_frames_of(node, word, 1))["cycle"]) | ("ms" in frame)
    missing, most = int(not fresh[0]), config.supervisor.fault_after_cycles
    end = _end_asked(case, node) if role == "executive" else _NEVER
    for i in range(1, len(k)):
        missing = 0 if fresh[i] else missing + 1
        before, now = int(state[i - 1]), int(state[i])
        if (told := int(node.columns["supervisor.missing_cycles"][i])) != missing:
            yield f"{role}: cycle {k[i]}: {told} cycles without input, not {missing}"
            return
        allowed = {_STOP, _FAULT} if fault[i] else {_STOP, _READY}
        if before in (_READY, _RUN, _HOLD) and missing >= most and k[i] < end:
            allowed = {_FAULT, _STOP}
        elif before in (_RUN, _HOLD) and not fault[i]:
            allowed |= {_HOLD if missing else _RUN}
        else:
            continue
        if now not in allowed:
            yield f"{role}: cycle {k[i]}: state {now} behind {before}, {missing} without input"
            return


def _end_asked(case: Case, node: NodeLog) -> int:
    """Return the cycle from which on an executive only waits for safe commands: none is missed."""
    stops = [t["cycle"] + 1 for t in node.tunings if t["name"] == "supervisor.stop"]
    passes = [at for _, at, act in case.acts if "stop" in act and at < len(node.cycle)]
    return min([node.description["cycles"], *stops, *node.cycle[passes].tolist()])


def _not_begun(case: Case) -> Iterator[str]:
    """Yield what the rig does in a cycle, and no node has noted."""
    config, log = case.rig.config, case.log
    rows = [(one.at_s, name, 0) for one in config.schedule for name in one.set]
    rows += [
        (1e-9 * duration_ns(one.from_, zero=True), f"fault.{name}.left", 1)
        for name, one in config.faults.items()
        if one.from_ is not None and one.times is None  # whose moments are drawn
    ]
    least = min(int(node.cycle[-1]) if len(node.cycle) else 0 for node in log.node.values())
    noted = {(t["cycle"], t["name"]) for node in log.node.values() for t in node.tunings}
    for at_s, name, early in rows:
        cycle = round(at_s * config.rate_hz)  # one of frames, or of a node below, is set before
        known = {(cycle - back, name) for back in range(early + 1)}
        if cycle < least and not known & noted:
            yield f"{name} was not set in cycle {cycle}"


def _requirements(case: Case) -> Iterator[str]:
    """Yield what is said of `always` and is not so; None, not judged, where the run ends early."""
    top = case.log.node["executive"]
    if case.world["around"] is not None or not len(top.cycle):
        return
    whole = top.cycle[-1] + 1 >= top.description["cycles"]
    ran = whole and not any(  # the last one is in no row where a node gives its wait up
        node.columns["supervisor.fault"].any() or "fault" in [one["event"] for one in node.events]
        for node in case.log.node.values()
    )
    both = (case.summary.requirements, ran), (Judge.of(case.rig).requirements(case.log), whole)
    for judged, is_whole in both:
        for asked, told in zip(case.rig.config.require, judged, strict=True):
            at_most = float((asked.always or "").rpartition("<")[2])
            most = float(np.abs(top.columns["rx.FB_1.position"]).max())
            held = most < at_most
            if told.held is not (held if is_whole or not held else None):
                yield f"{asked.always}: held {told.held}; {held} in {len(top.cycle)} cycles"
            elif told.margin is not None and abs(told.margin - at_most + most) > 1e-9 * at_most:
                yield f"{asked.always}: margin {told.margin}, not {at_most - most}"


def _groundless(case: Case, role: str, node: NodeLog) -> Iterator[str]:
    """Yield a fault for which nothing in the rig is a reason."""
    text = str((case.rig.effective(), case.acts))
    for fault in {int(one) for one in node.columns["supervisor.fault"]} - {0, _SILENT}:
        if not any(word in text for word in _LIKELY.get(fault, ())):
            yield f"{role}: fault {fault} without a reason in the rig"


def deserved(case: Case) -> tuple[set[str], str]:
    """Return the verdicts that the run may have, and why."""
    log, config = case.log, case.rig.config
    if any(block.columns["supervisor.fault"].any() for block in log.node.values()):
        waits = config.supervisor.on_fault == "wait"
        told = {"safety stop"} if not waits else {"safety stop", *_MILDER}
        return told, "a node faulted"
    lost = _lost(case)
    if lost:
        return {"loss", "safety stop"}, lost
    late = config.bus.emulate is not None or config.losses or config.faults
    sure = {"loss", "safety stop"} if late else set()  # by frames that came late, at the end
    mistakes = [
        name
        for node in log.node.values()
        for name, count in node.columns.items()
        if name.startswith("drive.master.") and count.any()
    ]
    if mistakes:
        return sure | {"expectation not met"}, f"of the drive's master: {', '.join(mistakes)}"
    if config.expect:
        return sure | {*_MILDER}, "its metrics are not judged here"
    top = log.node["executive"]
    if case.outcome.short:
        return sure | {"expectation not met", "not judged", "ok"}, "it ended early"
    for one in config.require:
        if case.world["around"] is not None:
            return sure | {*_MILDER}, "its requirements are not judged here"
        at_most = float((one.always or "").rpartition("<")[2])
        if not (np.abs(top.columns["rx.FB_1.position"]) < at_most).all():
            return sure | {"expectation not met"}, f"{one.always} is violated"
    if config.require and top.cycle.max(initial=-1) + 1 < top.description["cycles"]:
        return sure | {"not judged"}, "a stall has skipped the last cycle"
    return sure | {"ok"}, "nothing speaks against it"


_MILDER = "loss", "expectation not met", "not judged", "ok"


def _lost(case: Case) -> str:
    """Return what was lost or wrong on the wire, by no fault on purpose; "" for nothing."""
    errors = case.rig.config.errors
    implausible = sum(one.get("implausible", 0) for one in case.outcome.health.values())
    if implausible > errors.implausible:
        return f"{implausible} values were not plausible"
    if any((node.frames["e2e"] == _FOREIGN).any() for node in case.log.node.values()):
        return "another sender"
    counts = dict.fromkeys((_SOME_LOST, _REPEATED, _WRONG, _ERROR), 0)
    for role, node in case.log.node.items():
        for _, word, frame in received(case.world, role):
            rows = _frames_of(node, word, 1)
            states = accepted(rows[rows["e2e"] < _INJECTED], frame, word)
            for state in counts:
                counts[state] += int((states == state).sum())
    allowed = {_REPEATED: errors.repeated, _WRONG: errors.wrong_sequence, _ERROR: errors.crc}
    told = [f"{n} of state {state}" for state, n in counts.items() if n > allowed.get(state, 0)]
    return ", ".join(told)
