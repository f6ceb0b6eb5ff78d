"""Bounds on response times of frames whose nodes keep their phases, or send them in order.

A bound for frame m of node N from the moment t_0 at which N queues it; nodes queue all their frames
of a cycle at once, J at most behind the cycle's time. R_k bounds another frame k, so what of it is
sent behind t_0 was due behind t_0 - R_k:

    n_k(w) = ceil((w + J + tau - p_k) / T_k),  or 0                                          (1)
    p_k    = the first time > -R_k, from t_0 on, at which k may be due: with phases kept one of
             phi_k + i T, T the cycle, phi_k from N's phase to that of k's node; else any    (2)
    w_m    = E(w_m + C_m) + B_m + A_m + sum_{k in I(m)} n_k(w_m) C_k                         (3)
             and C_m for each frame that comes together with m
    R_m    = J + w_m + C_m                                                                   (4)

    by priority   I(m) all above m; A_m = 0; B_m the longest below m
    in order      of N's frames those before m in a cycle, and those behind it with R_k > T, are
                  ahead, once each: A_m. The least urgent of N, l, may stand in front: I(m) all
                  above l of other nodes, B_m the longest below l of those
    B_m           only of frames that may be due when m is queued: p_k <= J

All R start at C + J and are solved together from below. That a frame is ahead of m only once needs
R_k <= T_k of all that matter; where that fails there is no bound. E is (6) of `bus.response`.
The idea is that of Davis, Kollmann, Pollex, Slomka, Schedulability analysis for Controller Area
Network (CAN) with FIFO queues, priority queues and gateways, Real-Time Systems 49 (2013), with the
wait of others as their jitter; the phases are ours. Priority queues with any phases have the exact
(5) of `tools.start.bus.response`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from pcpc.tools.start.bus.response import Message, error_cost_ns


@dataclass(frozen=True)
class QueuedFrame(Message):
    """A frame with its node, that node's phase (None: any) and its place among those of a cycle."""

    node: str = ""
    phase_ns: int | None = None
    place: int = 0


@dataclass(frozen=True)
class Wire:
    """What all frames share: bit time, cycle, time between errors (0: none), kind of queues."""

    bit_ns: int
    cycle_ns: int
    error_every_ns: int = 0
    in_order: bool = False


def bounds_ns(frames: Sequence[QueuedFrame], wire: Wire) -> list[int | None]:
    """Return a bound on R of each of `frames`, which stand in order of priority; None for none."""
    found = [float(k.transmission_ns + k.jitter_ns) for k in frames]
    while (after := [_bound(frames, found, m, wire) for m in range(len(frames))]) != found:
        found = after
    return [None if math.isinf(ns) else int(ns) for ns in found]


def _bound(frames: Sequence[QueuedFrame], found: Sequence[float], m: int, wire: Wire) -> float:
    """Return (4) for frame `m`, given the others' R so far; infinite beyond its period."""
    own, last, ahead = frames[m], m, 0.0
    others = [*enumerate(frames)]
    if wire.in_order:
        last = max(i for i, k in others if k.node == own.node)
        for i, k in others:
            if k.node == own.node and i != m and (k.place < own.place or found[i] > wire.cycle_ns):
                ahead += k.burst_ns if found[i] < math.inf else math.inf
        others = [(i, k) for i, k in others if k.node != own.node]
    first = [_first_ns(k, own, found[i], wire) for i, k in enumerate(frames)]
    on_wire = [k for i, k in others if i > last and first[i] <= own.jitter_ns]
    blocking = max((k.transmission_ns for k in on_wire), default=0)
    above = [(k, first[i]) for i, k in others if i < last and i != m]
    error_ns = error_cost_ns(frames[: last + 1], wire.bit_ns)
    wait, before = 0.0, -1.0
    while wait != before:
        if own.jitter_ns + wait + own.transmission_ns > own.period_ns or ahead == math.inf:
            return math.inf
        before, until = wait, wait + own.jitter_ns + wire.bit_ns
        wait = blocking + ahead + own.burst_ns - own.transmission_ns
        if wire.error_every_ns:
            wait += math.ceil((before + own.transmission_ns) / wire.error_every_ns) * error_ns
        for k, due in above:
            if due == -math.inf:
                return math.inf
            wait += max(0, math.ceil((until - due) / k.period_ns)) * k.burst_ns  # (1) (3)
    return own.jitter_ns + wait + own.transmission_ns


def _first_ns(k: QueuedFrame, own: QueuedFrame, response_ns: float, wire: Wire) -> float:
    """Return p_k of (2)."""
    if k.phase_ns is None or own.phase_ns is None or math.isinf(response_ns):
        return -response_ns
    phase_ns = (k.phase_ns - own.phase_ns) % wire.cycle_ns
    return phase_ns - wire.cycle_ns * (math.ceil((response_ns + phase_ns) / wire.cycle_ns) - 1)
