"""Counter and CRC: reference vectors, detection of bit errors, exact counts under loss.

Of classic frames and of one of CAN FD, LONG.
"""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from fd_rig import LONG_DBC
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from places import ROOT

from pcpc.drivers.can import dbc, e2e
from pcpc.drivers.can.dbc import Protection
from pcpc.drivers.can.e2e_states import INJECTED, FrameState, name_of
from pcpc.drivers.compiled.rows import Receiver
from pcpc.tools.dev.evidence.expected import crc16

DBC = dbc.load(ROOT / "plants/atb1000/atb1000.dbc")
WIDE_DBC = """VERSION ""
BU_: A B
BO_ 291 WIDE: 8 A
 SG_ crc : 0|16@1+ (1,0) [0|0] "" B
 SG_ counter : 16|8@1+ (1,0) [0|0] "" B
 SG_ rest : 24|40@1+ (1,0) [0|0] "" B
BO_ 292 WIDE_BEHIND: 7 A
 SG_ crc : 32|16@1+ (1,0) [0|0] "" B
 SG_ counter : 48|8@1+ (1,0) [0|0] "" B
BO_ 2566848513 WIDE_ID: 8 A
 SG_ crc : 8|16@1+ (1,0) [0|0] "" B
 SG_ counter : 24|8@1+ (1,0) [0|0] "" B
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "E2EDataId" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 1;
BA_DEF_DEF_ "E2EDataId" 0;
BA_ "E2EDataId" BO_ 292 4660;
"""
WIDE = dbc.parse(Path("wide.dbc"), WIDE_DBC, strict=True)
LONG = dbc.parse(Path("long.dbc"), LONG_DBC, strict=True)
FRAMES = tuple(dbc.frame(one) for one in (*DBC.messages, *WIDE.messages, *LONG.messages))
TABLE = dbc.table(FRAMES, 1000.0)
ROWS = {entry.name: row for row, entry in enumerate(FRAMES)}
PROTECTED = [entry.name for entry in FRAMES if entry.protected]
WITH_CRC_16 = "WIDE", "WIDE_BEHIND", "WIDE_ID", "LONG"


def sent(name: str, counter: int, fill: int = 0) -> NDArray[np.uint8]:
    """Return a protected frame with `fill` in its other bytes."""
    dlc = FRAMES[ROWS[name]].dlc
    data = np.array([fill] * dlc + [0] * (64 - dlc), np.uint8)
    e2e.protect(data, ROWS[name], TABLE.frames, counter)
    return data


def check(state: NDArray[np.int64], name: str, data: NDArray[np.uint8]) -> tuple[int, int]:
    row = ROWS[name]
    outcome, lost = e2e.check(data, FRAMES[row].dlc, row, TABLE.frames, state)
    return int(outcome), int(lost)


def let_pass(state: np.ndarray, name: str, turns: int) -> None:
    """Let as many cycles pass as `turns` of a frame take."""
    for _ in range(turns * int(TABLE.frames[ROWS[name]].every_n)):
        e2e.begin_cycle(state, len(state))


def counts(state: NDArray[np.int64], name: str) -> dict[str, int]:
    values = state[ROWS[name]].tolist()
    return dict(zip(Receiver.dtype.names or (), values, strict=True))


@pytest.mark.parametrize(
    ("can_id", "data", "expected"),
    [
        (0x0A0, bytes(7), 0xB0),
        (0x120, bytes(7), 0x1F),
        (0x080, bytes(1), 0x31),
        (0x3231, b"3456789", 0x4B),
    ],
)
def test_crc_equals_the_published_vectors(can_id: int, data: bytes, expected: int) -> None:
    got = e2e.crc8(can_id, np.frombuffer(data, np.uint8), len(data))
    assert got == expected, f"{got:#04x}, not {expected:#04x}"


def test_crc_equals_division_of_polynomials_bit_by_bit() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        data = rng.integers(0, 256, 7, dtype=np.uint8)
        can_id = int(rng.integers(0, 2048))
        crc = 0xFF
        for byte in [can_id & 0xFF, can_id >> 8, *data.tolist()]:
            for bit in range(7, -1, -1):
                crc = (crc << 1 & 0xFF) ^ (0x1D if (crc >> 7 ^ byte >> bit) & 1 else 0)
        got = e2e.crc8(can_id, data, 7)
        assert got == crc ^ 0xFF, f"{got:#04x}, not {crc ^ 0xFF:#04x} for {data}"


@pytest.mark.parametrize(
    ("data_id", "place", "data", "expected"),
    [
        (0x3938, 0, "00 00 31 32 33 34 35 36 37", 0x29B1),  # "123456789": CRC-16/CCITT-FALSE
        (0x1234, 0, "00 00 00 00 00 00 00 00", 0xCA1C),  # AUTOSAR's examples of profile 5
        (0x1234, 8, "00 " * 16, 0x9128),
        (38848, 5, "f0 a4 f2 1e 0a 00 00 be", 0xC12B),  # three of the package autosar-e2e
        (39763, 1, "13 00 00 48 a1 ae 6b 96", 0x2F90),
        (33432, 0, "00 00 2f 1e", 0x1F8A),
    ],
)
def test_crc16_equals_the_published_vectors(
    data_id: int, place: int, data: str, expected: int
) -> None:
    filled = np.frombuffer(bytes.fromhex(data), np.uint8).copy()
    filled[place : place + 2] = 0xA5  # where it will stand is not in it
    got = e2e.crc16(data_id, filled, place, len(filled))
    assert got == expected, f"{got:#06x}, not {expected:#06x}"


def test_a_frame_of_16_bits_says_where_and_over_which_id() -> None:
    found = {entry.name: (entry.crc, entry.counter) for entry in FRAMES if entry.crc[0] == 2}
    assert found == {
        "WIDE": ((Protection.CRC_16, 0, 291), (2, 0, 255)),
        "WIDE_BEHIND": ((Protection.CRC_16, 4, 0x1234), (6, 0, 255)),
        "WIDE_ID": ((Protection.CRC_16, 1, 2566848513 & 0xFFFF), (3, 0, 255)),
        "LONG": ((Protection.CRC_16, 0, 0x1234), (2, 0, 255)),
    }
    assert tuple(found) == WITH_CRC_16


@pytest.mark.parametrize("name", WITH_CRC_16)
@pytest.mark.parametrize("counter", [0, 1, 200, 255])
def test_a_crc_of_16_is_that_of_the_profile_over_all_bytes(name: str, counter: int) -> None:
    entry = FRAMES[ROWS[name]]
    data = np.random.default_rng(counter).integers(0, 256, 64, np.uint8)
    e2e.protect(data, ROWS[name], TABLE.frames, counter)
    _, at, data_id = entry.crc
    rest = data[: entry.dlc].tobytes()
    wanted = crc16(rest[:at] + rest[at + 2 :] + data_id.to_bytes(2, "little"))
    assert rest[at : at + 2] == wanted.to_bytes(2, "little"), rest.hex(" ")


@pytest.mark.parametrize(
    ("name", "n_flips"), [*((one, 1) for one in PROTECTED), *((one, 2) for one in PROTECTED[:-1])]
)
def test_every_flip_of_one_or_two_bits_is_an_error(name: str, n_flips: int) -> None:
    dlc = FRAMES[ROWS[name]].dlc
    good = sent(name, 9, fill=0x5A)
    missed = []
    for flips in combinations(range(8 * dlc), n_flips):
        data = good.copy()
        for bit in flips:
            data[bit // 8] ^= 1 << bit % 8
        if check(e2e.new_state(len(FRAMES)), name, data) != (FrameState.ERROR, 0):
            missed.append(flips)
    assert not missed, f"{len(missed)} undetected, first {missed[0]}"


@pytest.mark.parametrize("name", WITH_CRC_16)
def test_every_flip_of_up_to_three_bits_is_an_error_with_a_crc_of_16(name: str) -> None:
    good, row = sent(name, 9, fill=0x5A), ROWS[name]

    def difference(bit: int) -> int:
        data = good.copy()
        data[bit // 8] ^= 1 << bit % 8
        right, there = (of(data, row, TABLE.frames) for of in (e2e.right_crc, e2e.crc_of))
        return int(right ^ there)

    assert e2e.right_crc(good, row, TABLE.frames) == e2e.crc_of(good, row, TABLE.frames)
    ones = [difference(bit) for bit in range(8 * FRAMES[row].dlc)]
    twos = {a ^ b for a, b in combinations(ones, 2)}
    assert 0 not in twos and 0 not in ones and not twos & {*ones}, "a CRC is linear"


def test_a_frame_under_the_id_of_another_is_an_error() -> None:
    state = e2e.new_state(len(FRAMES))
    for name, other in (("FB_B", "FB_A"), ("WIDE", "WIDE_ID"), ("LONG", "WIDE")):
        got = check(state, name, sent(other, 0))
        assert got == (FrameState.ERROR, 0), f"{name}: {got}"


@pytest.mark.parametrize(
    ("name", "length"), [("CMD", 0), ("CMD", 1), ("CMD", 7), ("LONG", 8), ("LONG", 48)]
)
def test_a_frame_of_wrong_length_is_an_error(name: str, length: int) -> None:
    state, row = e2e.new_state(len(FRAMES)), ROWS[name]
    outcome, _ = e2e.check(sent(name, 3), length, row, TABLE.frames, state)
    assert outcome == FrameState.ERROR, f"{FrameState.names()[outcome]} with {length} bytes"


@pytest.mark.parametrize("name", PROTECTED)
def test_protection_changes_only_counter_and_crc(name: str) -> None:
    entry = FRAMES[ROWS[name]]
    byte, shift, mask = entry.counter
    data = sent(name, 0x1234, fill=0xFF)
    got = data[byte] >> shift & mask
    assert got == 0x1234 & mask, f"counter {got:#x}"
    data[byte] |= mask << shift
    size, place, _ = entry.crc
    data[place : place + size] = 0xFF
    rest = bytes(data[: entry.dlc])
    assert rest == b"\xff" * entry.dlc, f"{rest.hex(' ')}"


@pytest.mark.parametrize("name", PROTECTED)
def test_a_crc_that_stands_in_a_frame_can_be_read_and_exchanged(name: str) -> None:
    data, row = sent(name, 9, fill=0x5A), ROWS[name]
    right = e2e.right_crc(data, row, TABLE.frames)
    assert e2e.crc_of(data, row, TABLE.frames) == right
    wrong, changed = data.copy(), right ^ (0xFFFF if name in WITH_CRC_16 else 0xFF)
    e2e.put_crc(wrong, row, TABLE.frames, changed)
    assert e2e.crc_of(wrong, row, TABLE.frames) == changed
    places = np.flatnonzero(wrong != data).tolist()
    size, first, _ = FRAMES[row].crc
    assert places == [*range(first, first + size)], f"{places}"


def test_an_unprotected_frame_is_left_alone_and_always_ok() -> None:
    state = e2e.new_state(len(FRAMES))
    data = sent("HB_PLANT", 7, fill=5)
    got = [check(state, "HB_PLANT", data) for _ in range(3)]
    assert data[0] == 5, f"first byte {data[0]}"
    assert got == [(FrameState.OK, 0)] * 3, f"{got}"


@pytest.mark.parametrize(
    ("counters", "turns", "expected"),
    [
        ([7], 1, [("OK", 0)]),
        ([15, 0, 1], 1, [("OK", 0)] * 3),
        ([3, 3, 4], 1, [("OK", 0), ("REPEATED", 0), ("OK", 0)]),
        ([3, 5, 6], 1, [("OK", 0), ("OK_SOME_LOST", 1), ("OK", 0)]),
        ([14, 2], 1, [("OK", 0), ("OK_SOME_LOST", 3)]),
        ([14, 3, 4], 5, [("OK", 0), ("WRONG_SEQUENCE", 4), ("OK", 0)]),
        ([5, 4, 5], 15, [("OK", 0), ("WRONG_SEQUENCE", 14), ("OK", 0)]),
        ([14, 3, 4], 3, [("OK", 0), ("WRONG_SEQUENCE", 2), ("OK", 0)]),
        ([5, 4, 5], 1, [("OK", 0), ("WRONG_SEQUENCE", 0), ("OK", 0)]),
        ([5, 4, 5], 0, [("OK", 0), ("WRONG_SEQUENCE", 0), ("OK", 0)]),
    ],
)
def test_states_follow_the_step_of_the_counter_and_losses_the_time(
    counters: list[int], turns: int, expected: list[tuple[str, int]]
) -> None:
    state, outcomes = e2e.new_state(len(FRAMES)), []
    for counter in counters:
        let_pass(state, "CMD", turns)
        outcomes.append(check(state, "CMD", sent("CMD", counter)))
    got = [(FrameState.names()[outcome], lost) for outcome, lost in outcomes]
    assert got == expected, f"{got}"


@pytest.mark.parametrize("name", ["SYNC", *WITH_CRC_16])
def test_a_counter_of_a_byte_counts_to_256(name: str) -> None:
    state = e2e.new_state(len(FRAMES))
    outcomes = {check(state, name, sent(name, n)) for n in range(1000)}
    assert outcomes == {(FrameState.OK, 0)}, f"{outcomes}"
    let_pass(state, name, 16)
    got = check(state, name, sent(name, 999 + 16))
    assert got == (FrameState.WRONG_SEQUENCE, 15), f"{got}"


@given(st.lists(st.integers(0, 15), min_size=1, max_size=300), st.integers(0, 3))
@settings(max_examples=50, deadline=None)
def test_counters_that_jump_at_will_lose_no_more_than_time_allows(
    counters: list[int], turns: int
) -> None:
    state = e2e.new_state(len(FRAMES))
    for counter in counters:
        let_pass(state, "CMD", turns)
        check(state, "CMD", sent("CMD", counter))
    got = counts(state, "CMD")
    most = (e2e.MAX_DELTA - 1) * got["received"] + turns * len(counters)
    assert got["lost"] <= most, f"{got['lost']} lost, {got}"


def test_a_corrupt_frame_leaves_the_counter_as_it_was() -> None:
    state = e2e.new_state(len(FRAMES))
    check(state, "CMD", sent("CMD", 4))
    bad = sent("CMD", 5)
    bad[0] ^= 1
    got = [check(state, "CMD", data) for data in (bad, sent("CMD", 5))]
    assert got == [(FrameState.ERROR, 0), (FrameState.OK, 0)], f"{got}"


def test_nothing_heard_is_not_available_and_ages() -> None:
    state = e2e.new_state(len(FRAMES))
    for _ in range(3):
        e2e.begin_cycle(state, len(state))
    got = counts(state, "FB_A")
    assert (got["state"], got["age_cycles"], got["fresh"]) == (FrameState.NOT_AVAILABLE, 3, 0), (
        f"{got}"
    )


def test_only_a_used_frame_is_fresh_and_resets_the_age() -> None:
    state = e2e.new_state(len(FRAMES))
    history = []
    for counter in (1, 1, 2, 12, 13):
        e2e.begin_cycle(state, len(state))
        check(state, "FB_A", sent("FB_A", counter))
        got = counts(state, "FB_A")
        history.append((got["fresh"], got["age_cycles"]))
    assert history == [(1, 0), (0, 1), (1, 0), (0, 1), (1, 0)], f"{history}"


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 16), st.integers(0, 2), st.booleans()), max_size=60),
    st.sampled_from(["CMD", "FB_A", "SYNC", "REF", "WIDE", "WIDE_ID", "LONG"]),
)
def test_counts_are_exact_under_loss_repetition_and_corruption(
    pattern: list[tuple[int, int, bool]], name: str
) -> None:
    """Each entry: step of the counter (below one turn), extra copies, one corrupt copy before."""
    state, counter = e2e.new_state(len(FRAMES)), 0
    expected = dict.fromkeys(("received", "lost", "repeated", "wrong_sequence", "errors"), 0)
    turn = FRAMES[ROWS[name]].counter[2] + 1
    for step, copies, corrupt in [(1, 0, False), *pattern]:
        step = min(step, turn - 1)
        counter += step
        data = sent(name, counter)
        if corrupt:
            bad = data.copy()
            bad[0] ^= 0x10
            check(state, name, bad)
            expected["errors"] += 1
        let_pass(state, name, step)
        for _ in range(1 + copies):
            check(state, name, data)
        expected["repeated"] += copies
        expected["lost"] += step - 1
        expected["received" if step <= e2e.MAX_DELTA else "wrong_sequence"] += 1
    got = counts(state, name)
    assert {key: got[key] for key in expected} == expected, f"{got} not {expected}"
    total = sum(expected.values()) - expected["errors"] - expected["repeated"]
    assert total == counter, f"{total} accounted of {counter} sent"


def test_a_state_in_a_log_has_a_name() -> None:
    said = [name_of(state) for state in (FrameState.OK, INJECTED + FrameState.ERROR, 99 - INJECTED)]
    assert said == ["OK", "INJECTED_ERROR", f"INJECTED_{99 - 2 * INJECTED}"]
    assert name_of(FrameState.BUS_ERROR + 1) == "9"
