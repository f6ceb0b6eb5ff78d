"""Tunings between two cycles: the rig's own, and those of clients, which the loop judges itself.

A request is taken whole or refused whole: parameters only, finite, in their range, nobody has
locked the node. The answer stands in `answer`: request, cycle, reason, the entry that is the
reason. Anything may stand in the mailbox at any time; nothing of it is used unchecked.
"""

from pcpc.drivers.compiled import libc
from pcpc.drivers.compiled.jit import loop_function, loop_part
from pcpc.drivers.compiled.records import int64
from pcpc.executive.loop.clock import Time
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.injection import count_down
from pcpc.executive.loop.layout import Loop
from pcpc.executive.loop.requests import SLOTS, Lock, Refusal
from pcpc.executive.loop.rings import push_event
from pcpc.executive.loop.states import State
from pcpc.executive.loop.variables import RESET_ASKED, STATE, STOP_ASKED

INFINITE = float("inf")


@loop_part
def tune(n: Loop) -> None:
    """Apply the tunings whose time has come, and those in the mailbox, which are answered."""
    tuning = n.tuning
    if n.faults.n_places > 0 and n.clock.kind != Time.GIVEN:
        count_down(n, 1 + n.clock.behind - n.faults.stalled)
    while tuning.done < tuning.n and tuning.schedule[tuning.done].cycle <= n.k:
        j, value = tuning.schedule[tuning.done].place, tuning.value[tuning.done]
        n.v[j] = value
        push_event(n, Event.TUNING, j, value)
        tuning.done += 1
    request = libc.load_acquire(n.mail, "request")
    if request != n.answer.request:
        answer(n, request)


@loop_function
def answer(n: Loop, request: int) -> None:
    """Carry out a request as a whole or refuse it; it is copied first, for clients may go on.

    One that changes meanwhile is looked at in the next cycle.
    """
    count, lock = n.mail.count, n.mail.lock
    index, value = n.tuning.asked_index, n.tuning.asked_value
    for i in range(SLOTS):
        index[i] = n.mail_index[i]
        value[i] = n.mail_value[i]
    if libc.load_acquire(n.mail, "request") != request:
        return
    refusal, entry = judge_request(n, count, lock)
    if refusal == Refusal.ACCEPTED:
        for i in range(count):
            n.v[index[i]] = value[i]
            push_event(n, Event.TUNING, index[i], value[i])
    else:
        n.control.refused += 1
        push_event(n, Event.REFUSED, index[entry], value[entry])
    n.answer.cycle = n.k
    n.answer.refusal = refusal
    n.answer.entry = entry
    libc.store_release(n.answer, "request", request)


@loop_function
def judge_request(n: Loop, count: int, lock: int) -> tuple[int, int]:
    """Return why the copied request is refused, or ACCEPTED, and the entry that is the reason."""
    tuning, first = n.tuning, int64(0)
    if count < 0 or count > SLOTS:
        return Refusal.BAD_COUNT, first
    stops = count == 1 and tuning.asked_index[0] == STOP_ASKED  # which nobody can lock
    if lock != Lock.NONE and count > 0 and not stops:
        return Refusal.LOCKED, first
    for i in range(count):
        j, value = tuning.asked_index[i], tuning.asked_value[i]
        if j < 0 or j >= n.n_variables or tuning.low[j] != tuning.low[j]:
            return Refusal.NO_PARAMETER, int64(i)
        if not (abs(value) < INFINITE and tuning.low[j] <= value <= tuning.high[j]):
            return Refusal.OUT_OF_RANGE, int64(i)
        if j == RESET_ASKED and (
            n.v[STATE] != State.FAULT or n.guard.waits == 0 or n.guard.gain > 0.0
        ):
            return Refusal.NO_RESET, int64(i)
    return Refusal.ACCEPTED, first
