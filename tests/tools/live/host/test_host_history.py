"""The newest cycles of a node, and the least and greatest of each bin of them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pcpc.tools.live.history import History, envelope

floats = st.floats(allow_nan=True, allow_infinity=True, width=64)


@given(st.lists(st.integers(0, 12), max_size=60), st.integers(2, 9))
def test_it_keeps_the_newest_rows(pieces: list[int], size: int) -> None:
    history, every = History(size, 2), np.zeros((0, 3))
    for count in pieces:
        cycle = len(every) + np.arange(count)
        new = np.column_stack((cycle, np.sin(cycle), -cycle))
        history.add(new[:, 0].astype(np.int64), 10 * cycle, new[:, 1:])
        every = np.concatenate((every, new))
        np.testing.assert_array_equal(history.cycle, every[-size:, 0])
        np.testing.assert_array_equal(history.stamp_ns, 10 * every[-size:, 0])
        np.testing.assert_array_equal(history.values, every[-size:, 1:])
        cycle, values = history.part([1], 3, 7)
        kept = every[-size:]
        kept = kept[(kept[:, 0] >= 3) & (kept[:, 0] <= 7)]
        np.testing.assert_array_equal(cycle, kept[:, 0])
        np.testing.assert_array_equal(values, kept[:, 2:])
    history.clear()
    assert len(history.cycle) == 0


@given(
    st.lists(st.tuples(st.integers(0, 60), floats), max_size=40, unique_by=lambda row: row[0]),
    st.integers(0, 12),
    st.integers(1, 12),
    st.integers(1, 7),
)
def test_an_envelope_is_that_of_every_bin_by_itself(
    rows: list[tuple[int, float]], first: int, bins: int, width: int
) -> None:
    rows.sort()
    cycle = np.array([k for k, _ in rows], np.int64)
    values = np.array([[value, -value] for _, value in rows]).reshape(len(rows), 2)
    low, high = envelope(cycle, values, first, bins, width)
    assert low.shape == high.shape == (2, bins)
    for b in range(bins):
        mine = values[(cycle // width) == first + b]
        for column in range(2):
            there = mine[:, column][~np.isnan(mine[:, column])]
            ends = (there.min(), there.max()) if len(there) else (np.nan, np.nan)
            np.testing.assert_array_equal((low[column, b], high[column, b]), ends)
