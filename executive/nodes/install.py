"""A plan written into the LOOP record of a node: schedule, frames, wiring, limits."""

import math
from typing import Any

from pcpc.drivers import dbc, e2e
from pcpc.executive.loop import losses
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.cycle import CLOCKED, ON_FRAMES
from pcpc.executive.loop.timing import reset
from pcpc.executive.nodes.plan import Plan, cycles_of
from pcpc.executive.rig.messages import awaited, heartbeat, parts_in_meeting, starts
from pcpc.executive.rig.schema import FALLBACK

RECEIVE_TIMEOUT_S = 0.1  # of a blocking receive; see drivers.bus
LISTEN_S = 0.2  # a waiting node sends its heartbeat every 0.1 s
PATIENCE_S = 5.0  # lockstep and sync: silence after which the other node is given up


def install(made: Plan, loop: Any) -> None:
    """Write `made` into the zeroed LOOP record `loop`; of its wire only what goes out where."""
    config = made.rig.config
    _install_schedule(made, loop)
    reset(loop)
    period_s = loop.period_ns * 1e-9
    loop.hold_cycles = config.supervisor.hold_cycles
    loop.fault_after = config.supervisor.fault_after_cycles
    loop.ramp_step = period_s / config.supervisor.ramp_s
    loop.gain = 1.0
    loop.v[:] = 0.0
    for place, value in made.values.items():
        loop.v[place] = value
    for place, variable in enumerate(made.table.variables):
        tunable = variable.kind == "parameter"
        loop.tunable_low[place] = variable.low if tunable else math.nan
        loop.tunable_high[place] = variable.high if tunable else math.nan
    _install_frames(made, loop)
    _install_wiring(made, loop)
    loop.mode_index = -1
    if made.role != "executive":
        modes = [
            f"rx.{f.name}.mode"
            for f in made.rx_frames
            if f.name not in made.below and any(s.name == "mode" for s in f.signals)
        ]
        loop.mode_index = made.table.index[modes[0]] if modes else -1
    for i, (name, limit) in enumerate(made.limits.items()):
        rate = math.inf if limit.rate_per_s is None else limit.rate_per_s * period_s
        loop.limit_index[i] = made.table.index[f"tx.{name}"]
        safe = limit.safe or 0.0
        loop.limits[i] = (limit.low, limit.high, rate, safe, safe, safe)
    for i, (name, value) in enumerate(made.spec.safe.items()):
        loop.safe_index[i] = made.table.index[f"rx.{name}"]
        loop.safe[i] = (0.0, 0.0, 0.0, 0.0, value)
    loop.n_limits, loop.n_safe = len(made.limits), len(made.spec.safe)
    sent = [i for i, variable in enumerate(made.table.variables) if variable.kind == "sent"]
    loop.sent_first, loop.sent_past = (sent[0], sent[-1] + 1) if sent else (0, 0)
    for i, (cycle, place, value) in enumerate(made.schedule):
        loop.schedule[i] = (cycle, place)
        loop.schedule_value[i] = value
    for i, place in enumerate(made.noted):
        loop.noted_index[i] = place
    loop.n_schedule, loop.n_noted = len(made.schedule), len(made.noted)


def _install_schedule(made: Plan, loop: Any) -> None:
    config = made.rig.config
    leads = made.role == "executive"
    loop.is_plant = made.role == "plant"
    clocked = made.pacing == "real" or (made.pacing == "sync" and leads)
    loop.trigger = CLOCKED if clocked else ON_FRAMES
    loop.period_ns = round(1e9 / config.rate_hz)
    loop.phase_ns = round(loop.period_ns * config.realtime.of(made.role).phase)
    loop.late_ns = round(loop.period_ns * config.realtime.late_fraction)
    loop.cycles = cycles_of(made.rig) if leads else 2**62
    loop.arm_pass = 0 if leads else 1
    loop.listen_ns = round(1e9 * LISTEN_S)
    loop.patience = round(PATIENCE_S / RECEIVE_TIMEOUT_S)
    loop.wait_recorder = loop.virtual_time = loop.wire.in_turn = made.pacing == "lockstep"
    _install_overrun(made, loop)
    loop.n_blocks, loop.n_variables = len(made.spec.blocks), len(made.table.variables)


def _install_overrun(made: Plan, loop: Any) -> None:
    """Only the executive has a policy: the emulator makes up what it owes."""
    config, names = made.rig.config, [block.name for block in made.spec.blocks]
    overrun = config.overrun
    loop.controller_block = loop.fallback_block = -1
    loop.overrun_policy = sh.SKIP
    if made.role != "executive":
        return
    loop.grace_passes = round(overrun.grace_s * config.rate_hz)
    if overrun.fault_after is not None:
        loop.overrun_policy, loop.overrun_after = sh.FAULT_AFTER, overrun.fault_after
    if overrun.fallback is not None:
        loop.overrun_policy, loop.overrun_after = sh.FALL_BACK, overrun.fallback_after
        loop.controller_block = names.index("controller")
        loop.fallback_block = names.index(FALLBACK)


def _install_frames(made: Plan, loop: Any) -> None:
    rate = made.rig.config.rate_hz
    for prefix, frames in (("rx", made.rx_frames), ("tx", made.tx_frames)):
        index = {
            v.name[3:]: i
            for i, v in enumerate(made.table.variables)
            if v.name.startswith(prefix + ".")
        }
        table = dbc.table(frames, rate, index)
        loop[prefix][: len(frames)] = table.frames
        loop[f"{prefix}_signals"][: len(table.signals)] = table.signals
        loop[f"{prefix}_scales"][: len(table.scales)] = table.scales
    loop.n_rx, loop.n_tx = len(made.rx_frames), len(made.tx_frames)
    loop.rx_state[: loop.n_rx] = e2e.new_state(loop.n_rx)
    part = parts_in_meeting(made.rx_frames, made.below, leads=made.role == "executive")
    for i, frame in enumerate(made.rx_frames):
        peer = made.role != "local" or frame.name in made.below
        loop.rx_role[i] = (starts(made.role, frame, made.below), awaited(frame), peer, part[i])
    loop.n_starters, loop.n_awaited, *_ = loop.rx_role[: loop.n_rx].sum(axis=0)
    lost = {name: (loss.share, loss.burst) for name, loss in made.rig.config.losses.items()}
    losses.install(loop, made.rx_frames, lost, made.rig.config.seed)
    second = [f.word for f in made.tx_frames if f.name in made.below]
    loop.wire.n_second = len(second)
    loop.wire.second[: len(second)] = second
    for i, frame in enumerate(made.tx_frames):
        loop.tx_role[i] = (frame.has_sequence, heartbeat(frame))


def _install_wiring(made: Plan, loop: Any) -> None:
    at = 0
    for i, copies in enumerate(made.copies):
        for pair in copies:
            loop.copies[at] = pair
            at += 1
        loop.copies_end[i] = at
    for i, views in enumerate(made.views):
        ranges = (views.parameters, views.states, views.inputs, views.outputs)
        loop.views[i] = [edge for r in ranges for edge in (r.start, r.stop)]
    for name, timing in (("state", False), ("timing", True)):
        places = made.columns(timing)
        loop[f"{name}_columns"][: len(places)] = places
        loop[f"n_{name}"] = len(places)
    columns = sh.RECORD_HEAD + loop.n_state + 1 + loop.n_timing
    loop.record_rows = sh.RECORD_RING_WORDS // columns
