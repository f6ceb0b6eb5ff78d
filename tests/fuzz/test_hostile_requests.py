"""Requests in mailboxes that nobody should write: refused, or harmless."""

import math

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pcpc.executive.loop.requests import SLOTS, Refusal
from pcpc.tools.dev.evidence import envelope

WORD = st.integers(-(2**63), 2**63 - 1) | st.integers(-2, 300)
LOOK = settings(
    max_examples=300, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)


@LOOK
@given(
    st.lists(st.tuples(WORD, st.floats()), max_size=SLOTS),
    WORD | st.none(),
    WORD,
    WORD,
    st.integers(0, 1),
)
def test_any_request_in_the_mailbox_is_refused_or_within_the_ranges(
    entries: list[tuple[int, float]], count: int | None, lock: int, request: int, node: int
) -> None:
    bench = envelope.bench()
    bench.restore()
    n = bench.loops[node]
    bench.advance(10)
    places, tuning = [*bench.places[node].values()], n.tuning
    for i, (place, value) in enumerate(entries):
        known = place % len(places) if place % 3 else place  # two of three are variables
        n.mail_index[i], n.mail_value[i] = known, value
    n.mail.count = len(entries) if count is None else count
    n.mail.lock, n.mail.request = lock if lock % 2 else 0, request
    before = n.v[: n.n_variables].copy()
    bench.advance(1)
    refused = request == 0 or n.answer.refusal != Refusal.ACCEPTED
    low, high = tuning.low[: n.n_variables], tuning.high[: n.n_variables]
    parameters = low == low
    now = n.v[: n.n_variables]
    changed = parameters & (now != before) & ~(np.isnan(now) & np.isnan(before))
    left = [place for name, place in bench.places[node].items() if name.endswith(".left")]
    changed[left] &= not refused  # which count down by themselves
    assert not (refused and changed.any()), np.flatnonzero(changed)
    assert ((now >= low) & (now <= high) & (abs(now) < math.inf))[changed].all()
    bench.advance(20)
    assert n.control.passes >= 20 or n.control.done, "the loop stands still"
