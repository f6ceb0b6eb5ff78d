"""Faults in rig files and requests in mailboxes that nobody should write: refused, or harmless."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pcpc.drivers.errors import BusError
from pcpc.executive.errors import RigError
from pcpc.executive.loop.fault_kinds import KINDS, WrongFrame, WrongNode, WrongValue
from pcpc.executive.loop.requests import SLOTS, Refusal
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.dev.evidence import envelope

PROBE = Path(__file__).resolve().parents[2] / "plants" / "probe" / "rig.yaml"
PLACES = ("controller.command", "plant:tx.FB.position", "plant:lag.position", "controller.gain",
          "plant:lag.tau_s", "tx.CMD.command", "rx.FB.position", "time.t_s", "x.y")  # fmt: skip
FRAMES = ("FB", "CMD", "SYNC", "HB_PLANT", "fb")
TIMES = ("0s", "5ms", "20ms", "1ms", "999999999min", "-1ms", "")
KEYS = ("kind", "at", "frame", "node", "data_of", "how", "goes_on", "value", "share", "burst",
        "from", "for", "every", "times", "x")  # fmt: skip
NUMBERS = st.floats() | st.integers(-(2**63), 2**64) | st.sampled_from([0, 1, -0.0, 5e-324, 1e300])
ANY = (
    st.none()
    | st.booleans()
    | NUMBERS
    | st.text(max_size=5)
    | st.just([])
    | st.just({})
    | st.sampled_from((*KINDS, *PLACES, *FRAMES, *TIMES))
)


@st.composite
def entries(draw: st.DrawFn) -> dict[str, Any]:
    """Draw a fault that makes sense; in half of them one or two keys do not."""
    kind = draw(st.sampled_from((*WrongValue, *WrongFrame, *WrongNode)))
    entry: dict[str, Any] = {"kind": kind.word}
    if isinstance(kind, WrongValue):
        entry["at"] = draw(st.sampled_from(PLACES[:5]))
    elif isinstance(kind, WrongFrame):
        entry["frame"] = draw(st.sampled_from(FRAMES[:3]))
    else:
        entry["node"] = draw(st.sampled_from(["executive", "plant"]))
    if kind.row.copies:
        entry["data_of"] = draw(st.sampled_from(FRAMES[:3]))
    if kind.row.hows:
        entry["how"] = draw(st.sampled_from(kind.row.hows))
    if kind.row.sized:
        entry["value"] = draw(st.floats(0.1, 7.0) | st.integers(1, 8) | NUMBERS)
    entry |= {"from": draw(st.sampled_from(TIMES[:3])), "for": draw(st.sampled_from(TIMES[:4]))}
    for key in draw(st.just([]) | st.lists(st.sampled_from(KEYS), min_size=1, max_size=2)):
        if draw(st.booleans()):
            entry[key] = draw(ANY)
        else:
            entry.pop(key, None)
    return entry


WORD = st.integers(-(2**63), 2**63 - 1) | st.integers(-2, 300)
LOOK = settings(
    max_examples=300, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)


@LOOK
@given(st.dictionaries(st.sampled_from(["a", "b", "c-1"]), entries(), min_size=1, max_size=2))
def test_any_entry_of_faults_is_run_or_refused_in_a_line(faults: dict[str, Any]) -> None:
    text = yamlfile.dump({"base": str(PROBE), "rig": "fuzz", "faults": faults})
    try:
        rig = load_rig(PROBE.with_name("fuzz.yaml"), None, ["duration_s=0.03"], text=text)
        log = in_memory(rig)
    except (RigError, BusError) as error:
        assert "\n" not in str(error) and len(str(error)) < 400, str(error)
        return
    sent = log.node["executive"].columns["tx.CMD.command"]
    assert len(sent) > 0 and np.isfinite(sent).all(), sent


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
