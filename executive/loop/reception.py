"""One frame that came, from the bus to the table.

take_frame   whose is it: one of ours, a stranger's, or part of the meeting of the nodes
disturbed    what the rig does to it on purpose; the one seam between wire and acceptance
accept       counter and CRC
decode       signals to the table; or refuse, which counts why not
"""

from typing import Any

import numpy as np

from pcpc.drivers import codec, e2e
from pcpc.drivers.e2e_states import ON_PURPOSE
from pcpc.drivers.jit import loop_function
from pcpc.drivers.structures import data_of
from pcpc.executive.loop import losses, meeting
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.losses import is_lost
from pcpc.executive.loop.rings import push_frame
from pcpc.executive.loop.strangers import is_foreign, note_foreign, note_repeat, word_of


@loop_function
def take_frame(n: Any) -> Any:
    """Check and decode `wire.rx`; return its row in the frame table, -1 if it is not for us."""
    word = word_of(n.wire.rx)
    row = codec.frame_of(word, n.rx, n.n_rx)
    if is_foreign(n, row, word):
        note_foreign(n, word)
        return np.int64(-1)
    if row < 0:
        return row
    if n.virtual_time != 0 and n.passes == 0:
        what = meeting.sorted_out(n, row)
        if what == meeting.LEAVE:
            return np.int64(-1)
        if what == meeting.HELD_FIRST:
            meeting.exchange_held(n)
            use_frame(n, meeting.held_row(n))
            meeting.exchange_held(n)
    return use_frame(n, row)


@loop_function
def use_frame(n: Any, row: Any) -> Any:
    """Disturb, accept and decode `wire.rx`, a frame of `row`; return the row, -1 if it is lost."""
    after_loss = n.loss_state[row, losses.LOST]
    if disturbed(n, row):
        return np.int64(-1)
    new = n.rx_state[row, e2e.FRESH] == 0
    state = accept(n, row)
    if state == e2e.OK or state == e2e.OK_SOME_LOST:
        decode(n, row, new)
    else:
        refuse(n, row, state, after_loss)
    return row


@loop_function
def disturbed(n: Any, row: Any) -> Any:
    """Do to the frame what the rig wants of its bus; return True if nothing is left of it."""
    if not is_lost(n, row):
        return False
    n.control[sh.LOST_ON_PURPOSE] += 1
    n.started += n.rx_role[row, sh.STARTS]  # nobody waits for it
    push_frame(n, n.wire.rx, 1, ON_PURPOSE)
    return True


@loop_function
def accept(n: Any, row: Any) -> Any:
    """Check counter and CRC, record the frame; return its state."""
    frame = n.wire.rx
    state, lost = e2e.check(data_of(frame), np.int64(frame[4]), row, n.rx, n.rx_state)
    push_frame(n, frame, 1, state)
    n.control[sh.LOST] += lost
    return state


@loop_function
def decode(n: Any, row: Any, new: Any) -> None:
    """Write the frame's signals to the table; `new`: it is the first of its row in this cycle."""
    codec.unpack(data_of(n.wire.rx), row, n.rx, n.rx_signals, n.rx_scales, n.v)
    n.control[sh.RECEIVED] += 1
    if new:
        n.started += n.rx_role[row, sh.STARTS]
        n.fresh += n.rx_role[row, sh.AWAITED]
        if n.wire.n_second > 0 and n.rx_role[row, sh.STARTS] > n.rx_role[row, sh.AWAITED]:
            n.wire.muted = 1  # what follows this SYNC belongs to the next cycle


@loop_function
def refuse(n: Any, row: Any, state: Any, after_loss: Any) -> None:
    """Count a frame that is not used, by its state; after a loss on purpose it is no mistake."""
    if state == e2e.ERROR:
        n.control[sh.CRC_ERRORS] += 1
    elif state == e2e.REPEATED:
        n.started += n.rx_role[row, sh.STARTS] * after_loss  # of a whole turn of the counter
        n.control[sh.REPEATED] += 1 - after_loss
        if after_loss == 0 and n.rx_role[row, sh.STARTS] + n.rx_role[row, sh.AWAITED] > 0:
            note_repeat(n, word_of(n.wire.rx))
    elif state == e2e.WRONG_SEQUENCE:
        n.control[sh.WRONG_SEQUENCE] += 1 - after_loss
        if n.rx_role[row, sh.STARTS] > n.rx_role[row, sh.AWAITED]:
            n.wire.muted = 1
        n.started += n.rx_role[row, sh.STARTS]  # it came; the next one will be trusted
