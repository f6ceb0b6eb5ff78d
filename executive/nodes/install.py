"""A plan written into the LOOP record of a node: schedule, frames, wiring, limits.

With FMUs it makes an instance of each; RigError says what one of them refuses.
"""

import math
from typing import Any

import numpy as np

from pcpc.drivers.can import dbc, e2e, wire
from pcpc.drivers.can.bus import RECEIVE_TIMEOUT_US
from pcpc.drivers.can.wire_layout import Medium
from pcpc.executive.loop import losses
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.clock import Time, Trigger
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.intrusion import REACTIONS, Reaction
from pcpc.executive.loop.ring_layout import RECORD_HEAD, frame_words
from pcpc.executive.loop.sending import LastWord
from pcpc.executive.loop.supervisor import Overrun
from pcpc.executive.loop.timing import reset
from pcpc.executive.loop.variables import DISARMED
from pcpc.executive.nodes import fmus, planned_keyframes
from pcpc.executive.nodes.plan import Plan, cycles_of
from pcpc.executive.nodes.planned_drive import install_drive
from pcpc.executive.nodes.planned_faults import install_faults
from pcpc.executive.nodes.planned_plausible import install_plausible
from pcpc.executive.rig.buses import OVER_LINE
from pcpc.executive.rig.messages import (
    is_awaited,
    is_emergency,
    is_heartbeat,
    parts_in_meeting,
    peers_of,
    starts_cycle,
)
from pcpc.executive.rig.roles import PLANTS
from pcpc.executive.rig.schema import FALLBACK

RECEIVE_TIMEOUT_S = 1e-6 * RECEIVE_TIMEOUT_US  # of a blocking receive
LISTEN_S = 0.2  # several cycles of a slow rig; a waiting node sends its heartbeat more often
PATIENCE_S = 5.0  # lockstep and sync: silence after which the other node is given up


def install_in_memory(made: Plan, loop: Any) -> None:
    """Write `made` into the zeroed LOOP record `loop` without bus, clock and recorder."""
    wire.prepare(loop.wire, Medium.MEMORY, -1, -1)
    install(made, loop)
    loop.clock.kind = Time.VIRTUAL if made.pacing in ("lockstep", OVER_LINE) else Time.GIVEN
    loop.rings.wait_recorder = 0


def install(made: Plan, loop: Any) -> None:
    """Write `made` into the zeroed LOOP record `loop`; of its wire only what goes out where."""
    config = made.rig.config
    _install_schedule(made, loop)
    _install_part(made, loop)
    reset(loop)
    guard, limits, tuning = loop.guard, loop.limits, loop.tuning
    period_s = loop.clock.period_ns * 1e-9
    guard.hold_cycles = config.supervisor.hold_cycles
    guard.fault_after = config.supervisor.fault_after_cycles
    guard.waits = config.supervisor.on_fault == "wait"
    guard.ramp_step = period_s / config.supervisor.ramp_s
    guard.quick_step = period_s / (config.supervisor.quick_stop_s or config.supervisor.ramp_s)
    loop.v[:] = 0.0
    guard.manual = made.role == "executive" and config.supervisor.arm == "manual"
    guard.gain, guard.disarmed = 1.0 - guard.manual, guard.manual
    loop.v[DISARMED] = guard.manual
    loop.v[list(made.values)] = list(made.values.values())
    ranges = [
        (v.low, v.high) if v.kind == "parameter" else (math.nan, math.nan)
        for v in made.table.variables
    ]
    tuning.low[: len(ranges)], tuning.high[: len(ranges)] = np.array(ranges).T
    _install_frames(made, loop)
    _install_wiring(made, loop)
    guard.estop_index = made.table.index.get(f"rx.{config.supervisor.estop}", -1)
    names = [frame.name for frame in made.rx_frames]
    stop = config.supervisor.stop_frame
    guard.stop_row = names.index(stop) if stop in names else -1
    install_faults(made.rig, made.role, made.faults, loop)
    _install_intrusion(made, loop)
    install_plausible(made.rig, made.role, made.table, made.rx_frames, loop)
    install_drive(made.rig, made.role, made.table, loop)
    guard.mode_index = -1
    if made.role != "executive":
        modes = [
            f"rx.{f.name}.mode"
            for f in made.rx_frames
            if f.name not in made.below and any(s.name == "mode" for s in f.signals)
        ]
        guard.mode_index = made.table.index[modes[0]] if modes else -1
    for i, (name, limit) in enumerate(made.limits.items()):
        rate = math.inf if limit.rate_per_s is None else limit.rate_per_s * period_s
        limits.place[i] = made.table.index[f"tx.{name}"]
        safe = limit.safe or 0.0
        limits.table[i] = (limit.low, limit.high, rate, safe, safe, safe)
    for i, (name, value) in enumerate(made.spec.safe.items()):
        guard.safe_index[i] = made.table.index[f"rx.{name}"]
        guard.safe[i] = (0.0, value)
    limits.n, guard.n_safe = len(made.limits), len(made.spec.safe)
    sent = [i for i, variable in enumerate(made.table.variables) if variable.kind == "sent"]
    loop.tx.first, loop.tx.past = (sent[0], sent[-1] + 1) if sent else (0, 0)
    for i, (cycle, place, value) in enumerate(made.schedule):
        tuning.schedule[i] = (cycle, place)
        tuning.value[i] = value
    for i, place in enumerate(made.noted):
        loop.blocks.noted_index[i] = place
    tuning.n, loop.blocks.n_noted = len(made.schedule), len(made.noted)
    fmus.install(made, loop)
    planned_keyframes.install(made, loop)


def _install_schedule(made: Plan, loop: Any) -> None:
    config, clock = made.rig.config, loop.clock
    leads = made.role == "executive"
    clocked = made.pacing in ("real", OVER_LINE) or (made.pacing == "sync" and leads)
    clock.trigger = Trigger.CLOCKED if clocked else Trigger.ON_FRAMES
    clock.period_ns = config.period_ns
    clock.phase_ns = round(clock.period_ns * config.realtime.of_node(made.role).phase)
    clock.late_ns = round(clock.period_ns * config.realtime.late_fraction)
    loop.guard.cycles = cycles_of(made.rig) if leads else 2**62
    clock.arm_pass = -1 if made.pacing == OVER_LINE else 0 if leads else 1
    loop.rx.listen_ns = round(1e9 * LISTEN_S)
    loop.rx.patience = round(PATIENCE_S / RECEIVE_TIMEOUT_S)
    lockstep = made.pacing == "lockstep"
    clock.kind = Time.LOCKSTEP if lockstep else Time.REAL
    loop.rings.wait_recorder = loop.meeting.ordered = lockstep
    loop.meeting.between = made.role == "local"
    loop.wire.in_turn = lockstep and loop.meeting.between
    _install_overrun(made, loop)
    loop.blocks.n, loop.n_variables = len(made.spec.blocks), len(made.table.variables)


def _install_part(made: Plan, loop: Any) -> None:
    """Say what the node does; the lowest one waits for nobody, and owes periods after a stall."""
    is_plant = made.role in PLANTS
    loop.meeting.on_second = is_plant and made.rig.config.plants[made.role].bus is not None
    loop.meeting.seeks_below = not is_plant
    loop.blocks.owe_periods = is_plant
    loop.guard.safe_start = made.role == "executive"
    loop.guard.odd_output = Fault.PLANT_NOT_FINITE if is_plant else Fault.OUTPUT_NOT_FINITE
    loop.tx.last_word = LastWord.HEARTBEAT if is_plant else LastWord.ALL_FRAMES


def _install_overrun(made: Plan, loop: Any) -> None:
    """Only the executive has a policy: the emulator makes up what it owes."""
    config, names = made.rig.config, [block.name for block in made.spec.blocks]
    overrun, guard, blocks = config.overrun, loop.guard, loop.blocks
    blocks.controller = blocks.fallback = -1
    guard.overrun_policy = Overrun.SKIP
    if made.role != "executive":
        return
    guard.grace_passes = round(overrun.grace_s * config.rate_hz)
    if overrun.fault_after is not None:
        guard.overrun_policy, guard.overrun_after = Overrun.FAULT_AFTER, overrun.fault_after
    if overrun.fallback is not None:
        guard.overrun_policy, guard.overrun_after = Overrun.FALL_BACK, overrun.fallback_after
        blocks.controller = names.index("controller")
        blocks.fallback = names.index(FALLBACK)


def _install_frames(made: Plan, loop: Any) -> None:
    rx, tx, rate = loop.rx, loop.tx, made.rig.config.rate_hz
    for prefix, frames in (("rx", made.rx_frames), ("tx", made.tx_frames)):
        index = {
            v.name[3:]: i
            for i, v in enumerate(made.table.variables)
            if v.name.startswith(prefix + ".")
        }
        table = dbc.table(frames, rate, index)
        into = loop[prefix]
        into.frames[: len(frames)] = table.frames
        into.signals[: len(table.signals)] = table.signals
    rx.n, tx.n = len(made.rx_frames), len(made.tx_frames)
    rx.state[: rx.n] = loop.faults.on_wire[: rx.n] = e2e.new_state(rx.n)
    peers = peers_of(made.role, made.rx_frames, made.below, made.senders)
    part = parts_in_meeting(made.role, made.rx_frames, peers)
    loop.meeting.peers = max(made.senders.values(), default=1)
    for i, frame in enumerate(made.rx_frames):
        starts = starts_cycle(made.role, frame, made.below)
        rx.role[i] = (starts, is_awaited(frame), peers[i], part[i])
    rx.starters, rx.awaited = rx.role["starts"].sum(), rx.role["awaited"].sum()
    lost = {name: (loss.share, loss.burst) for name, loss in made.rig.config.losses.items()}
    losses.install(loop, made.rx_frames, lost, made.rig.config.seed)
    second = [f.word for f in made.tx_frames if f.name in made.below]
    loop.wire.n_second, loop.wire.fd = len(second), made.fd
    loop.wire.second[: len(second)] = second
    for i, frame in enumerate(made.tx_frames):
        tx.kind[i] = (frame.has_sequence, is_heartbeat(frame), is_emergency(frame), 0)


def _install_intrusion(made: Plan, loop: Any) -> None:
    """Say what follows a second sender of a frame, and how often heartbeats come."""
    watch, config = loop.intrusion, made.rig.config
    watch.reaction = REACTIONS.index(config.supervisor.intrusion)
    limited = {name.partition(".")[0] for name in config.sections[made.role].plausible}
    watch.early_at[:] = -(2**62)
    for row, frame in enumerate(made.rx_frames):
        if is_heartbeat(frame) and frame.cycle_ms:
            watch.beat_every[row] = frame.every_n(config.rate_hz)
        doubted = watch.reaction != Reaction.COUNT or frame.name in limited
        watch.care[row] = doubted or watch.beat_every[row] > 0


def _install_wiring(made: Plan, loop: Any) -> None:
    at, blocks, rings = 0, loop.blocks, loop.rings
    for i, copies in enumerate(made.copies):
        for pair in copies:
            blocks.copies[at] = pair
            at += 1
        blocks.copies_end[i] = at
    for i, views in enumerate(made.views):
        ranges = (views.parameters, views.states, views.inputs, views.outputs)
        blocks.views[i] = tuple(edge for r in ranges for edge in (r.start, r.stop))
        if views.judged is not None:
            blocks.views[i].y_end = views.outputs.start + views.judged
    for name, timing in (("state", False), ("timing", True)):
        places = made.columns(timing)
        rings[f"{name}_columns"][: len(places)] = places
        rings[f"n_{name}"] = len(places)
    columns = RECORD_HEAD + rings.n_state + 1 + rings.n_timing
    rings.record_rows = sh.RECORD_RING_WORDS // columns
    rings.frame_words = frame_words({"data_bytes": made.data_bytes})
    rings.frame_rows = sh.FRAME_RING_WORDS // rings.frame_words
