"""Worst-case response times of the frames on a CAN bus, from queueing to the end of transmission.

    B_m      = max C_k, k below m                                    a frame that is on the wire (1)
    t_m      = E_m(t_m) + B_m + sum_{k in hp(m), m} ceil((t_m + J_k) / T_k) C_k      busy period (2)
    Q_m      = ceil((t_m + J_m) / T_m)                                     frames m in it        (3)
    w_m(q)   = E_m(w_m(q) + C_m) + B_m + q C_m
               + sum_{k in hp(m)} ceil((w_m(q) + J_k + tau) / T_k) C_k     q-th frame waits      (4)
    R_m      = max_q J_m + w_m(q) - q T_m + C_m,   q = 0 ... Q_m - 1                             (5)
    E_m(t)   = ceil(t / T_e) (31 tau + max_{k in hp(m), m} C_k)            no T_e: no errors     (6)

Of n frames alike that come together, C in (2) to (5) is that of all; their R is that of the last,
which waits for n - 1 of them. B and E have one.

C longest transmission, T period, J queueing jitter, tau bit time, hp(m) the frames above m; ns,
whole ones. T_e: the least time between two bus errors, each of which costs an error frame and the
transmission anew. The recurrences are solved from below. Phases may be any; each node offers the
most urgent of its frames first. Only the first instance (q = 0) was looked at before 2007; the
paper's three messages show why that is too few.
Source: Davis, Burns, Bril, Lukkien, Controller Area Network (CAN) schedulability analysis: refuted,
revisited and revised, Real-Time Systems 35 (2007), equations (3) to (5), (8) to (11), (14).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

_FULL = 0.9999  # of the time: above, a busy period may last more than 10,000 frames
_ERROR_BITS = 31  # of an error frame with all that belongs to it


@dataclass(frozen=True)
class Message:
    """A frame as the analysis sees it, or `count` frames alike that come together."""

    transmission_ns: int  # C
    period_ns: int  # T
    jitter_ns: int = 0  # J
    count: int = field(default=1, kw_only=True)  # n

    @property
    def burst_ns(self) -> int:
        """What all of them take."""
        return self.count * self.transmission_ns


def responses_ns(
    messages: Sequence[Message], bit_ns: int, error_every_ns: int = 0
) -> list[int | None]:
    """Return R of each of `messages`, which stand in order of priority; None without a bound."""
    return [_response_ns(messages, m, bit_ns, error_every_ns) for m in range(len(messages))]


def error_cost_ns(messages: Sequence[Message], bit_ns: int) -> int:
    """Return what an error costs at most: an error frame, and one of `messages` anew."""
    return _ERROR_BITS * bit_ns + max(k.transmission_ns for k in messages)


def _response_ns(
    messages: Sequence[Message], m: int, bit_ns: int, error_every_ns: int
) -> int | None:
    own, higher = messages[m], messages[:m]
    blocking = max((k.transmission_ns for k in messages[m + 1 :]), default=0)  # (1)
    error_ns = error_cost_ns(messages[: m + 1], bit_ns)
    load = math.fsum(k.burst_ns / k.period_ns for k in messages[: m + 1])
    if load + (error_ns / error_every_ns if error_every_ns else 0.0) > _FULL:
        return None

    def errors(t: int) -> int:
        return -(-t // error_every_ns) * error_ns if error_every_ns else 0  # (6)

    def sent_ns(frames: Sequence[Message], t: int) -> int:
        return sum(-(-(t + k.jitter_ns) // k.period_ns) * k.burst_ns for k in frames)

    busy = _fixed_point(
        own.transmission_ns, lambda t: errors(t) + blocking + sent_ns(messages[: m + 1], t)
    )  # (2)
    wait, worst = blocking, 0
    for q in range(-(-(busy + own.jitter_ns) // own.period_ns)):  # (3)
        before = blocking + (q + 1) * own.burst_ns - own.transmission_ns

        def longer(w: int, before: int = before) -> int:
            return errors(w + own.transmission_ns) + before + sent_ns(higher, w + bit_ns)  # (4)

        wait = _fixed_point(max(wait, before), longer)
        worst = max(worst, own.jitter_ns + wait - q * own.period_ns + own.transmission_ns)  # (5)
    return worst


def _fixed_point(value: int, following: Callable[[int], int]) -> int:
    """Return the least value that follows from itself, not below `value`."""
    while (after := following(value)) != value:
        value = after
    return value
