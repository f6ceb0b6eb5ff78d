"""Tunings between two cycles: the rig's own, and those of clients, which the loop judges itself.

A request is taken whole or refused whole: parameters only, finite, in their range, nobody has
locked the node. The answer stands in `answer`: request, cycle, reason, the entry that is the
reason. Anything may stand in the mailbox at any time; nothing of it is used unchecked.
"""

from typing import Any

import numpy as np

from pcpc.drivers import libc
from pcpc.drivers.jit import loop_function
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.rings import push_event

INFINITE = float("inf")


@loop_function
def tune(n: Any) -> None:
    """Apply the tunings whose time has come, and those in the mailbox, which are answered."""
    while n.scheduled < n.n_schedule and n.schedule[n.scheduled, 0] <= n.k:
        j, value = n.schedule[n.scheduled, 1], n.schedule_value[n.scheduled]
        n.v[j] = value
        push_event(n, sh.TUNING_EVENT, j, value)
        n.scheduled += 1
    request = libc.load_acquire(n.mail, sh.REQUEST)
    if request != n.answer[sh.ACK]:
        answer(n, request)


@loop_function
def answer(n: Any, request: Any) -> None:
    """Carry out a request as a whole or refuse it; it is copied first, for clients may go on.

    One that changes meanwhile is looked at in the next cycle.
    """
    count, lock = n.mail[sh.COUNT], n.mail[sh.LOCK]
    for i in range(sh.MAIL_SLOTS):
        n.asked_index[i] = n.mail_index[i]
        n.asked_value[i] = n.mail_value[i]
    if libc.load_acquire(n.mail, sh.REQUEST) != request:
        return
    refusal, entry = judge_request(n, count, lock)
    if refusal == sh.ACCEPTED:
        for i in range(count):
            n.v[n.asked_index[i]] = n.asked_value[i]
            push_event(n, sh.TUNING_EVENT, n.asked_index[i], n.asked_value[i])
    else:
        n.control[sh.REFUSED] += 1
        push_event(n, sh.REFUSED_EVENT, n.asked_index[entry], n.asked_value[entry])
    n.answer[sh.ACK_CYCLE] = n.k
    n.answer[sh.REFUSAL] = refusal
    n.answer[sh.REFUSED_ENTRY] = entry
    libc.store_release(n.answer, sh.ACK, request)


@loop_function
def judge_request(n: Any, count: Any, lock: Any) -> Any:
    """Return why the copied request is refused, or ACCEPTED, and the entry that is the reason."""
    first = np.int64(0)
    if count < 0 or count > sh.MAIL_SLOTS:
        return sh.BAD_COUNT, first
    if lock != 0 and count > 0:
        return sh.LOCKED, first
    for i in range(count):
        j, value = n.asked_index[i], n.asked_value[i]
        if j < 0 or j >= n.n_variables or n.tunable_low[j] != n.tunable_low[j]:
            return sh.NO_PARAMETER, np.int64(i)
        if not (abs(value) < INFINITE and n.tunable_low[j] <= value <= n.tunable_high[j]):
            return sh.OUT_OF_RANGE, np.int64(i)
    return sh.ACCEPTED, first
