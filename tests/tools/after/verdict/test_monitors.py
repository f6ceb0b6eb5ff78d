"""Requirements in time against their definitions, cycle by cycle, however the record is cut up."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pcpc.executive.rig.expressions import BARELY, Rows
from pcpc.executive.rig.requirements import timed_requirement
from pcpc.executive.rig.schema import Requirement
from pcpc.tools.after.verdict.monitors import NEVER, Monitor, extremes, monitor

PERIOD_S = 1e-3
Cycles = list[int]
Values = list[float]


@dataclass
class Record:
    """Recorded cycles with x and y; `goes_on` behind the last one."""

    cycle: Cycles
    x: Values
    y: Values
    goes_on: bool = False


@dataclass
class Found:
    """What is compared: first violation, smallest margin, obligations, those judged."""

    first: int | None
    margin: float
    events: int
    judged: int


def watched(record: Record, pieces: int | None = None, **entry: Any) -> Monitor:
    """Return the monitor of a requirement on x and y after the record, in pieces of so many."""
    words = {key.removesuffix("_"): value for key, value in entry.items()}
    one = monitor(
        timed_requirement(msgspec.convert(words, Requirement), lambda name: None), PERIOD_S
    )
    columns = {name: np.array(getattr(record, name), np.float64) for name in "xy"}
    rows = Rows(np.array(record.cycle), columns, PERIOD_S)
    for begin in range(0, len(rows), pieces or len(rows)):
        one.take(rows.part(slice(begin, begin + (pieces or len(rows)))))
    one.end(record.goes_on)
    return one


def found(one: Monitor) -> Found:
    margin = 0.0 if abs(one.margin) == -BARELY else one.margin
    first = None if one.first is None else one.first[0]
    return Found(first, margin, one.events, one.judged)


def below(values: Values) -> list[tuple[bool, float]]:
    """Return whether value < 1, and the margin, of each."""
    return [(v < 1.0, -math.inf if math.isnan(v) else 1.0 - v) for v in values]


# ------------------------------------------------------------------- the definitions, one by one


def rises(record: Record, after: int, before: float) -> list[int]:
    """Return the rows in which y < 1 becomes true."""
    held = [ok for ok, _ in below(record.y)]
    return [
        i
        for i, k in enumerate(record.cycle)
        if held[i] and not (i and held[i - 1]) and after <= k < before
    ]


def by_hold(record: Record, within: int, after: int, before: float, events: bool) -> Found:
    """(1): x < 1 from `within` after an event to the next; without events from the begin on."""
    rho, cycle = below(record.x), record.cycle
    begins = rises(record, after, before)
    if not events:
        begins = [i for i, k in enumerate(cycle) if after <= k][:1]
        begins = [i for i in begins if cycle[i] < before]
    first, margin, judged = None, math.inf, 0
    for n, i in enumerate(begins):
        past = begins[n + 1] if n + 1 < len(begins) else len(cycle)
        own = [j for j in range(i, past) if cycle[j] >= cycle[i] + within and cycle[j] < before]
        margin = min([margin, *(rho[j][1] for j in own)])
        bad = [cycle[j] for j in own if not rho[j][0]]
        first = bad[0] if bad and first is None else first
        judged += bool(own)
        last = n + 1 == len(begins)
        unfinished = record.goes_on if before == math.inf else cycle[-1] < before - 1
        if own and last and unfinished:
            judged -= 1
    return Found(first, margin, len(begins), judged + (first is not None) * 1000)


def by_respond(record: Record, within: int, lasts: int, after: int, before: float) -> Found:
    """(2): at most `within` after each event x < 1 for `lasts`."""
    rho, cycle, last = below(record.x), record.cycle, record.cycle[-1]
    first, margin, judged = None, math.inf, 0
    begins = rises(record, after, before)
    for i in begins:
        starts = [j for j, k in enumerate(cycle) if cycle[i] <= k <= cycle[i] + within]
        spans = [
            [j for j, k in enumerate(cycle) if cycle[s] <= k <= cycle[s] + lasts] for s in starts
        ]
        whole = [span for span in spans if cycle[span[0]] + lasts <= last]
        worst = [min(rho[j][1] for j in span) for span in spans]
        good = [span for span in whole if all(rho[j][0] for j in span)]
        hopeless = all(any(not rho[j][0] for j in span) for span in spans)
        if good:
            judged, own = judged + 1, max(min(rho[j][1] for j in span) for span in whole)
        elif hopeless and cycle[i] + within <= last:
            judged, own = judged + 1, max(worst)
            row = next(j for j in range(starts[-1], len(cycle)) if not rho[j][0])
            first = cycle[row] if first is None else min(first, cycle[row])
        else:
            continue
        margin = min(margin, own)
    return Found(first, margin, len(begins), judged)


def by_until(record: Record, within: float, after: int) -> Found:
    """(3): x < 1 until y < 1, which comes `within`."""
    keeps, ends, cycle = below(record.x), below(record.y), record.cycle
    begin = next((i for i, k in enumerate(cycle) if k >= after), None)
    if begin is None:
        return Found(None, math.inf, 0, 0)
    due = cycle[begin] + within
    margin, first, done = -math.inf, None, False
    own = [i for i in range(begin, len(cycle)) if cycle[i] <= due]
    for i in own:
        before = min((keeps[j][1] for j in range(begin, i)), default=math.inf)
        margin = max(margin, min(ends[i][1], before))
        if not done and first is None:
            done = ends[i][0]
            first = cycle[i] if not done and not keeps[i][0] else None
    if not done and first is None and cycle[-1] >= due:
        first = cycle[own[-1]]
    judged = done or first is not None
    return Found(first, margin if judged else math.inf, 1, int(judged))


# ----------------------------------------------------------------------------------- comparisons

VALUES = st.sampled_from([-1.0, 0.0, 0.5, 1.0, 1.5, 3.0, math.nan])


@st.composite
def records(draw: st.DrawFn) -> Record:
    """Draw a record with cycles missing, and values that often lie on the limit."""
    steps = draw(st.lists(st.sampled_from([1, 1, 1, 2, 5]), min_size=1, max_size=40))
    cycle = np.cumsum(steps).tolist()
    x, y = (draw(st.lists(VALUES, min_size=len(cycle), max_size=len(cycle))) for _ in "xy")
    return Record(cycle, x, y, draw(st.booleans()))


SPANS = st.integers(0, 12)
WINDOWS = st.tuples(st.integers(0, 20), st.one_of(st.none(), st.integers(1, 30)))
PIECES = st.integers(1, 41)


def ms(cycles: int) -> str:
    return f"{cycles}ms"


def window(after: int, length: int | None) -> tuple[dict[str, str], float]:
    """Return the keys of a window, and the first cycle behind it."""
    if length is None:
        return {"after": ms(after)}, math.inf
    return {"after": ms(after), "before": ms(after + length)}, after + length


def same(one: Monitor, wanted: Found) -> None:
    """Compare; of a violated hold the number of those judged is open to taste."""
    got = found(one)
    if wanted.judged >= 1000:
        wanted.judged = got.judged
    assert got == wanted or (math.isnan(got.margin) and math.isnan(wanted.margin)), one


@settings(max_examples=400, deadline=None)
@given(records(), WINDOWS, PIECES)
def test_always_and_never_are_each_others_opposite(
    record: Record, limits: tuple[int, int | None], pieces: int
) -> None:
    keys, before = window(*limits)
    wanted = by_hold(record, 0, limits[0], before, events=False)
    same(watched(record, pieces, always="x < 1", **keys), wanted)
    numbers = [v for v in record.x if not math.isnan(v)]
    if len(numbers) == len(record.x):
        wanted = by_hold(record, 0, limits[0], before, events=False)
        same(watched(record, pieces, never="x >= 1", **keys), wanted)


@settings(max_examples=400, deadline=None)
@given(records(), SPANS, WINDOWS, PIECES)
def test_settles_is_its_definition(
    record: Record, within: int, limits: tuple[int, int | None], pieces: int
) -> None:
    keys, _ = window(*limits)
    record.x = [abs(v) for v in record.x]
    entry = {"settles": "x", "into": "1", "when": "y < 1", "within": ms(within), **keys}
    inside = Record(record.cycle, [v if v != 1.0 else 0.999 for v in record.x], record.y)
    inside.goes_on = record.goes_on  # into is closed: at the limit it is inside
    one, wanted = watched(record, pieces, **entry), by_hold(inside, within, *_ends(limits), True)
    wanted.margin = 0.0 if wanted.margin == pytest.approx(0.001) else wanted.margin
    same(one, wanted)


def _ends(limits: tuple[int, int | None]) -> tuple[int, float]:
    return limits[0], window(*limits)[1]


@settings(max_examples=600, deadline=None)
@given(records(), SPANS, SPANS, WINDOWS, PIECES)
def test_a_response_is_its_definition(
    record: Record, within: int, lasts: int, limits: tuple[int, int | None], pieces: int
) -> None:
    entry = {"when": "y < 1", "then": "x < 1", "within": ms(within), "for": ms(lasts)}
    one = watched(record, pieces, **entry, **window(*limits)[0])
    same(one, by_respond(record, within, lasts, *_ends(limits)))


@settings(max_examples=400, deadline=None)
@given(records(), st.one_of(st.none(), SPANS), st.integers(0, 20), PIECES)
def test_until_is_its_definition(
    record: Record, within: int | None, after: int, pieces: int
) -> None:
    entry = {"always": "x < 1", "until": "y < 1", "after": ms(after)}
    entry |= {} if within is None else {"within": ms(within)}
    one = watched(record, pieces, **entry)
    same(one, by_until(record, math.inf if within is None else within, after))


@settings(max_examples=300, deadline=None)
@given(records(), SPANS, SPANS, PIECES)
def test_the_sign_of_a_margin_is_the_verdict_and_the_pieces_do_not_matter(
    record: Record, within: int, lasts: int, pieces: int
) -> None:
    entries: list[dict[str, Any]] = [
        {"always": "x < 1"}, {"settles": "x", "into": "1", "when": "y changes"},
        {"when": "y changes", "then": "x < y", "within": ms(within), "for": ms(lasts)},
        {"always": "x < 1", "until": "y > 1", "within": ms(within)},
        {"overshoot": "x", "over": "y", "at_most": "50 %"}, {"rate": "x", "at_most": "500"},
        {"settles": "x", "into": "1", "to": "y", "when": "4ms", "for": ms(lasts)},
    ]  # fmt: skip
    for entry in entries:
        one, whole = watched(record, pieces, **entry), watched(record, **entry)
        assert found(one) == found(whole) and one.rows == whole.rows, entry
        assert repr((one.least, one.first)) == repr((whole.least, whole.first)), entry
        if one.judged:
            assert (one.margin < 0.0) == (one.first is not None), (entry, one)


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=60), st.data())
def test_extremes_of_spans_are_those_of_slices(values: Values, data: st.DataObject) -> None:
    spans = st.integers(0, len(values) - 1).flatmap(
        lambda i: st.tuples(st.just(i), st.integers(i + 1, len(values)))
    )
    pairs = data.draw(st.lists(spans, max_size=20))
    first, past = (np.array([p[i] for p in pairs], np.intp) for i in (0, 1))
    picks: list[tuple[Any, Callable[[Values], float]]] = [(np.minimum, min), (np.maximum, max)]
    for pick, plain in picks:
        got = extremes(np.array(values), first, past, pick)
        assert got.tolist() == [plain(values[a:b]) for a, b in pairs]


# --------------------------------------------------------------------------------- closed forms


def test_a_decaying_oscillation_settles_when_its_envelope_says() -> None:
    t = np.arange(3000) * PERIOD_S
    x = (np.exp(-4.0 * t) * (t >= 0.5 * PERIOD_S)).tolist()
    record = Record(list(range(3000)), x, [0.0] * 3000)
    after_s = math.log(1.0 / 0.02) / 4.0  # exp(-4 t) = 0.02
    late, early = f"{after_s + 0.001:.4f}s", f"{after_s - 0.001:.4f}s"
    assert watched(record, settles="x", into="0.02", within=late).first is None
    broken = watched(record, settles="x", into="0.02", within=early)
    assert broken.first is not None and broken.first[0] == math.floor(1e3 * (after_s - 0.001))


def test_an_overshoot_is_measured_from_the_step_and_in_its_direction() -> None:
    y = [0.0] * 5 + [2.0] * 5 + [1.0] * 5
    x = [0.0, 9.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.3, 2.1, 2.0, 2.0, 1.5, 0.95, 1.0, 1.0]
    record = Record(list(range(15)), x, y)
    held = watched(record, overshoot="x", over="y", at_most="20 %")
    assert held.first is None and held.events == 2, held
    assert held.margin == pytest.approx(0.4 - 0.3), "20 % of a step of 2, less 2.3 - 2"
    broken = watched(record, overshoot="x", over="y", at_most="0.04")
    assert broken.first is not None and broken.first[0] == 7
    down = watched(record, overshoot="x", over="y", at_most="4 %", after="10ms")
    assert down.first is not None and (down.first[0], down.events) == (12, 1), down


def test_a_reference_that_begins_is_no_step() -> None:
    y = [math.nan] * 3 + [0.0] * 8 + [1.0] * 4
    one = watched(Record(list(range(15)), [0.0] * 15, y), overshoot="x", over="y", at_most="20 %")
    assert (one.events, one.first) == (1, None), one


def test_a_rate_is_that_between_recorded_cycles() -> None:
    record = Record([0, 1, 2, 6, 7], [0.0, 1.0, 2.0, 6.0, 4.0], [0.0] * 5)
    one = watched(record, rate="x", at_most="1000")
    assert one.first is not None and one.first[0] == 7
    assert one.margin == pytest.approx(-1000.0)


def test_what_is_not_over_at_the_end_is_open() -> None:
    record = Record(list(range(20)), [0.0] * 20, [5.0] * 10 + [0.0] * 10)
    entry = {"when": "y < 1", "then": "x < 1", "for": "15ms"}
    one = watched(record, **entry)
    assert (one.events, one.judged, one.open, one.first) == (1, 0, 1, None)
    never = watched(record, **(entry | {"when": "y > 7"}))
    assert (never.events, never.open, never.first) == (0, 0, None)
    record.goes_on = True
    assert watched(record, always="x < 1").open == 1, "the run went on"
    assert watched(record, always="x < 1", before="15ms").open == 0
    assert watched(record, always="x < 1", before="25ms").open == 1
    record.x[3] = 2.0
    violated = watched(record, always="x < 1")
    assert (violated.open, violated.judged) == (0, 1), "what is violated is judged"


@pytest.mark.parametrize(("s", "begin"), [(0.002, NEVER), (0.0065, 7)])
def test_a_time_that_has_come_before_the_window_begins_nothing(s: float, begin: int) -> None:
    words = {"when": f"time.t_s > {s}", "then": "x < 1", "after": "5ms"}
    timed = timed_requirement(msgspec.convert(words, Requirement), lambda name: None)
    assert monitor(timed, PERIOD_S).begin == begin
