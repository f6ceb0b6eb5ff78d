"""The compiled codec against cantools: same bits both ways, for any layout and for atb1000.dbc."""

import hashlib
import math
import struct
import sys
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from interpreting import interpreted
from places import ROOT

from pcpc.drivers.can import can_id, codec, dbc
from pcpc.drivers.can.dbc import SignalKind
from pcpc.drivers.can.wire_layout import LENGTHS

ATB1000 = dbc.load(ROOT / "plants/atb1000/atb1000.dbc")
MESSAGES = sorted(ATB1000.messages, key=lambda message: message.frame_id)
FRAMES = tuple(dbc.frame(message) for message in MESSAGES)
TABLE = dbc.table(FRAMES, 1000.0)
FACTORS: list[float] = [1, -1, 1e-4, 0.25, -0.1, 2.3968449810713143e-05, 3, 10, -7, 2.0, 1e7, 0.3]
OFFSETS: list[float] = [0, 0, 0, 1, -40, 0.5, -273.15, 100000, 2.0**40]


@st.composite
def signals(draw: st.DrawFn, n_bits: int, name: str, narrow: bool) -> tuple[Signal, set[int]]:
    """Return a signal anywhere in a frame of `n_bits`, and the bits it takes."""
    first = draw(st.one_of(st.just(0), st.integers(0, n_bits - 1)))
    room = min(n_bits - first, 32 if narrow else 64)
    is_float = room >= 32 and not narrow and draw(st.integers(0, 3)) == 0
    if is_float:
        length = draw(st.sampled_from([32, 64] if room >= 64 else [32]))
    else:
        length = draw(st.one_of(st.integers(1, min(room, 20)), st.integers(1, room), st.just(room)))
    big_endian = draw(st.booleans())
    turned = [n // 8 * 8 + 7 - n % 8 for n in range(first, first + length)]
    conversion = BaseConversion.factory(
        draw(st.sampled_from(FACTORS)),
        draw(st.sampled_from(OFFSETS[:-1] if narrow else OFFSETS)),
        is_float=is_float,
    )
    signal = Signal(
        name,
        turned[0] if big_endian else first,
        length,
        "big_endian" if big_endian else "little_endian",
        draw(st.booleans()),
        conversion=conversion,
    )
    return signal, set(turned if big_endian else range(first, first + length))


@st.composite
def messages(draw: st.DrawFn, narrow: bool = False) -> Message:
    """Return signals that do not overlap; `narrow`: integers of 32 bits at most."""
    dlc = draw(st.one_of(st.just(8), st.integers(1, 8), st.sampled_from(LENGTHS[9:])))
    taken: set[int] = set()
    chosen: list[Signal] = []
    for i in range(draw(st.integers(1, 6 if dlc <= 8 else 24))):
        signal, bits = draw(signals(8 * dlc, f"s{i}", narrow))
        if not bits & taken:
            taken |= bits
            chosen.append(signal)
    about: Any = {"senders": ["A"], "cycle_time": 10, "strict": True, "is_fd": dlc > 8}
    return Message(0x123, "M", dlc, chosen, **about)


@st.composite
def multiplexed(draw: st.DrawFn) -> Message:
    """Return a frame with a multiplexer, signals of its layouts, and perhaps one of all of them."""
    dlc = draw(st.sampled_from([8, *LENGTHS[9:]]))
    length, first = draw(st.integers(1, 6)), 8 * draw(st.integers(0, dlc - 1))
    chosen = [Signal("m", first, length, is_multiplexer=True)]
    common = {*range(first, first + length)}
    layouts = draw(st.lists(st.integers(0, 2**length - 1), min_size=1, max_size=3, unique=True))
    taken = {layout: set(common) for layout in layouts}
    for i in range(draw(st.integers(1, 9))):
        signal, bits = draw(signals(8 * dlc, f"s{i}", False))
        layout = draw(st.sampled_from([*layouts, None]))
        wanted = layouts if layout is None else [layout]
        if any(bits & taken[one] for one in wanted):
            continue
        for one in wanted:
            taken[one] |= bits
        if layout is not None:
            signal.multiplexer_ids, signal.multiplexer_signal = [layout], "m"
        chosen.append(signal)
    assume(any(signal.multiplexer_ids for signal in chosen))
    about: Any = {"senders": ["A"], "cycle_time": 10, "strict": True, "is_fd": dlc > 8}
    return Message(0x123, "M", dlc, chosen, **about)


def in_layout(message: Message, layout: int) -> list[Signal]:
    """Return the signals that come with this value of the multiplexer."""
    return [one for one in message.signals if one.multiplexer_ids in (None, [layout])]


def tables(message: Message) -> dbc.CodecTable:
    """Return the tables of one message; one that dbc refuses for its width is discarded."""
    try:
        return dbc.table([dbc.frame(message)], 1000.0)
    except dbc.BusError:
        assume(False)
        raise


def unpack(data: bytes, frame: int, table: dbc.CodecTable) -> dict[str, float]:
    values = np.full(len(table.variables), np.nan)
    array = np.frombuffer(data.ljust(8, b"\xa5"), np.uint8).copy()
    codec.unpack(array, frame, table.frames, table.signals, values)
    first, end = table.frames[frame].first, table.frames[frame].end
    names = [name.split(".")[1] for name in table.variables[first:end]]
    return dict(zip(names, values[first:end].tolist(), strict=True))


def pack(values: dict[str, float], frame: int, table: dbc.CodecTable) -> tuple[bytes, int]:
    first, end = table.frames[frame].first, table.frames[frame].end
    dlc = int(table.frames[frame].dlc)
    array, data = np.zeros(len(table.variables)), np.full(max(dlc, 8), 0xA5, np.uint8)
    for i in range(first, end):
        array[i] = values[table.variables[i].split(".")[1]]
    saturated = codec.pack(data, frame, table.frames, table.signals, array)
    assert not data[dlc:].any(), f"bytes behind dlc {dlc}: {data.tobytes().hex(' ')}"
    return data[:dlc].tobytes(), int(saturated)


def float_bits(value: float) -> bytes:
    """Return the bits of a float64, one pattern for all NaN."""
    return b"nan" if math.isnan(value) else struct.pack(">d", value)


def assert_same_values(got: dict[str, float], expected: dict[str, Any], data: bytes) -> None:
    for name, value in got.items():
        want = float(expected[name])
        assert float_bits(value) == float_bits(want), (
            f"{name}: {value!r}, cantools {want!r} from {data.hex(' ')}"
        )


def reference(
    message: Message, values: dict[str, float], signals: list[Signal] | None = None
) -> tuple[bytes, int]:
    """Return what cantools makes of these values, and how many it must first pull into range."""
    raws: dict[str, Any] = {}
    saturated = 0
    for signal in message.signals if signals is None else signals:
        value = values[signal.name]
        if math.isnan(value):
            raws[signal.name], saturated = 0, saturated + 1
            continue
        if signal.is_float:
            high: Any = struct.unpack("<f", b"\xff\xff\x7f\x7f")[0]
            high = high if signal.length == 32 else sys.float_info.max
            low = -high
        else:
            low = -(1 << (signal.length - 1)) if signal.is_signed else 0
            high = low + (1 << signal.length) - 1
        if math.isinf(value):
            raw = value * signal.scale
        else:
            raw = signal.conversion.numeric_scaled_to_raw(value)
        raws[signal.name] = min(max(raw, low), high)
        saturated += raws[signal.name] != raw
    return message.encode(raws, scaling=False, strict=False), saturated


@settings(max_examples=150, deadline=None)
@given(messages(), st.binary(min_size=64, max_size=64))
def test_any_frame_decodes_as_by_cantools(message: Message, payload: bytes) -> None:
    data = payload[: message.length]
    expected = message.decode(data, decode_choices=False)
    assert isinstance(expected, dict)
    assert_same_values(unpack(data, 0, tables(message)), expected, data)


@settings(max_examples=150, deadline=None)
@given(messages(), st.data())
def test_any_value_encodes_as_by_cantools_and_saturation_is_counted(
    message: Message, data: st.DataObject
) -> None:
    table = tables(message)
    values: dict[str, float] = {}
    for signal in message.signals:
        size = 2.0 ** (0 if signal.is_float else signal.length)
        code = data.draw(st.one_of(st.floats(-1.5 * size, 1.5 * size), st.floats()))
        values[signal.name] = code * float(signal.scale) + float(signal.offset)
    with np.errstate(over="ignore", invalid="ignore"):
        assert pack(values, 0, table) == reference(message, values), f"{values} {message.signals}"


@settings(max_examples=150, deadline=None)
@given(multiplexed(), st.data())
def test_only_the_signals_of_a_layout_are_read_and_written_as_by_cantools(
    message: Message, data: st.DataObject
) -> None:
    table = tables(message)
    by_name = {signal.name: signal for signal in message.signals}
    layouts = {s.multiplexer_ids[0] for s in message.signals if s.multiplexer_ids}
    layout = data.draw(st.sampled_from(sorted(layouts)))
    payload = bytearray(data.draw(st.binary(min_size=message.length, max_size=message.length)))
    at = by_name["m"].start // 8
    payload[at] = payload[at] & ~((1 << by_name["m"].length) - 1) | layout
    expected = message.decode(bytes(payload), decode_choices=False)
    assert isinstance(expected, dict)
    found = unpack(bytes(payload), 0, table)
    assert_same_values({name: found[name] for name in expected}, expected, bytes(payload))
    kept = found.keys() - expected.keys()
    assert all(math.isnan(found[name]) for name in kept)
    assert len(kept) == len(message.signals) - len(in_layout(message, layout))
    values = dict.fromkeys(by_name, math.nan) | {
        name: data.draw(st.floats(-4.0, 4.0)) * float(by_name[name].scale) for name in expected
    }
    values["m"] = float(layout)
    assert pack(values, 0, table) == reference(message, values, in_layout(message, layout))


def test_of_an_unknown_layout_only_the_signals_of_all_layouts_are_read_and_written() -> None:
    signals = [
        Signal("m", 0, 8, is_multiplexer=True),
        Signal("always", 8, 8),
        Signal("a", 16, 8, multiplexer_ids=[3], multiplexer_signal="m"),
        Signal("b", 16, 8, multiplexer_ids=[255], multiplexer_signal="m"),
    ]
    table = tables(Message(0x123, "M", 4, signals, cycle_time=10, strict=True))
    assert str(unpack(b"\x04\x07\x09\x00", 0, table)) == str(
        {"m": 4.0, "always": 7.0, "a": math.nan, "b": math.nan}
    )
    given = {"m": 4.0, "always": 7.0, "a": 9.0, "b": 9.0}
    assert pack(given, 0, table) == (b"\x04\x07\x00\x00", 0)
    assert pack(given | {"m": 999.0}, 0, table) == (b"\xff\x07\x09\x00", 1)
    assert pack(given | {"m": math.nan}, 0, table) == (b"\x00\x07\x00\x00", 1)


@pytest.mark.parametrize("order", ["little_endian", "big_endian"])
def test_a_signal_of_any_start_and_length_agrees_with_cantools_both_ways(order: Any) -> None:
    rng = np.random.default_rng(5)
    n_wide = 0
    for first, end in combinations(range(65), 2):
        signed, factor = bool(rng.integers(2)), FACTORS[rng.integers(len(FACTORS))]
        offset = OFFSETS[rng.integers(len(OFFSETS))]
        if end - first > 32:
            factor, offset = [(1, 0), (0.3, -40), (3, 7)][
                rng.integers(2 if end - first > 60 else 3)
            ]
        signal = Signal(
            "s",
            first if order == "little_endian" else first // 8 * 8 + 7 - first % 8,
            end - first,
            order,
            signed,
            conversion=BaseConversion.factory(factor, offset),
        )
        message = Message(0x123, "M", 8, [signal], cycle_time=10, strict=True)
        table, data = tables(message), rng.bytes(8)
        expected = message.decode(data)
        assert isinstance(expected, dict)
        value = unpack(data, 0, table)
        assert_same_values(value, expected, data)
        got = pack(value, 0, table)
        assert got == reference(message, value), f"{value} {signal} {got[0].hex(' ')}"
        n_wide += int(table.signals[0].kind != SignalKind.SCALED)
    assert n_wide > 20, f"only {n_wide} signals needed integer arithmetic"


@settings(max_examples=150, deadline=None)
@given(messages(narrow=True), st.binary(min_size=64, max_size=64))
def test_every_decoded_frame_of_32_bit_integers_encodes_to_itself(
    message: Message, payload: bytes
) -> None:
    table = tables(message)
    raws = message.decode(payload[: message.length], decode_choices=False, scaling=False)
    assert isinstance(raws, dict)
    data = message.encode(raws, scaling=False)
    got = pack(unpack(data, 0, table), 0, table)
    assert got == (data, 0), f"{got[0].hex(' ')} from {data.hex(' ')}"


def single(signal: Signal) -> dbc.CodecTable:
    """Return the tables of a frame of 8 bytes with one signal."""
    return dbc.table([dbc.frame(Message(1, "M", 8, [signal], cycle_time=1, strict=True))], 1000.0)


@pytest.mark.parametrize(
    ("signed", "ends"), [(True, (-(2**63), 2**63 - 1)), (False, (0, 2**64 - 1))]
)
def test_64_bits_saturate_at_their_last_code(signed: bool, ends: tuple[int, int]) -> None:
    table = single(Signal("s", 0, 64, is_signed=signed))
    got = [pack({"s": value}, 0, table) for value in (-1e30, 1e30)]
    expected = [(end.to_bytes(8, "little", signed=signed), 1) for end in ends]
    assert got == expected, f"{got}"


@pytest.mark.parametrize("length", [32, 64])
def test_floats_keep_minus_zero_and_saturate_when_infinite(length: int) -> None:
    code = "<f" if length == 32 else "<d"
    table = single(Signal("s", 0, length, conversion=BaseConversion.factory(is_float=True)))
    data, saturated = pack({"s": -0.0}, 0, table)
    value = unpack(data, 0, table)["s"]
    assert (math.copysign(1, value), value, saturated) == (-1, 0, 0), f"{value}, {saturated}"
    data, saturated = pack({"s": -math.inf}, 0, table)
    largest = float(np.finfo(np.float32 if length == 32 else np.float64).max)
    got = struct.unpack(code, data[: length // 8])[0], saturated
    assert got == (-largest, 1), f"{got}"


@settings(max_examples=150, deadline=None)
@given(st.integers(0, len(FRAMES) - 1), st.binary(min_size=8, max_size=8))
def test_atb1000_decodes_as_by_cantools(row: int, payload: bytes) -> None:
    data = payload[: FRAMES[row].dlc]
    expected = MESSAGES[row].decode(data, decode_choices=False)
    assert isinstance(expected, dict)
    assert_same_values(unpack(data, row, TABLE), expected, data)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, len(FRAMES) - 1), st.data())
def test_atb1000_encodes_as_by_strict_cantools(row: int, data: st.DataObject) -> None:
    values = {s.name: data.draw(st.floats(s.low, s.high)) for s in FRAMES[row].signals}
    tail = {s.name: 0.0 for s in MESSAGES[row].signals if s.name not in values}
    expected = MESSAGES[row].encode(values | tail, strict=True)
    assert pack(values, row, TABLE) == (expected, 0), f"{FRAMES[row].name} {values}"


@pytest.mark.parametrize("row", range(len(FRAMES)), ids=[entry.name for entry in FRAMES])
def test_atb1000_saturates_at_both_ends_without_wrapping(row: int) -> None:
    for signal in FRAMES[row].signals:
        lsb = abs(signal.factor)
        for value, end in (
            (signal.high + lsb, signal.high),
            (signal.low - lsb, signal.low),
            (math.inf, signal.high),
            (-math.inf, signal.low),
        ):
            if signal.is_float and math.isfinite(value):
                continue
            values = {s.name: 0.0 for s in FRAMES[row].signals} | {signal.name: value}
            data, saturated = pack(values, row, TABLE)
            got = unpack(data, row, TABLE)[signal.name]
            assert saturated == 1, f"{signal.name} = {value}: {saturated} saturated"
            assert abs(got - end) <= 1e-6 * lsb, f"{signal.name} = {value}: sent {got}, not {end}"


def test_declared_limits_inside_of_the_raw_range_saturate_too() -> None:
    conversion = BaseConversion.factory(-0.5, 10)
    signal = Signal("s", 0, 8, conversion=conversion, is_signed=True, minimum=0, maximum=20)
    table = single(signal)
    got = [pack({"s": value}, 0, table) for value in (-0.5, 0.0, 20.0, 20.5)]
    expected = [(20, 1), (20, 0), (0x100 - 20, 0), (0x100 - 20, 1)]
    assert [(data[0], saturated) for data, saturated in got] == expected, f"{got}"


def test_nan_is_sent_as_raw_zero_and_counted() -> None:
    values = {s.name: math.nan for s in FRAMES[1].signals}
    got = pack(values, 1, TABLE)
    assert got == (bytes(8), len(values)), f"{got}"


@pytest.mark.parametrize("bits", [32, 64])
@pytest.mark.parametrize("is_float", [True, False])
@pytest.mark.parametrize("layout", [None, 0])
def test_nan_in_a_float_or_a_wide_signal_is_raw_zero_too(
    bits: int, is_float: bool, layout: int | None
) -> None:
    conversion = BaseConversion.factory(is_float=is_float)
    signal = Signal("s", 0, bits, conversion=conversion, is_signed=True)
    chosen = [signal]
    if layout is not None:
        chosen.append(Signal("m", 64, 8, is_multiplexer=True))
        signal.multiplexer_ids, signal.multiplexer_signal = [layout], "m"
    message = Message(1, "M", 12, chosen, cycle_time=1, strict=True, is_fd=True)
    table = dbc.table([dbc.frame(message)], 1000.0)
    assert pack({"s": math.nan, "m": 0.0}, 0, table) == (bytes(12), 1)


def test_a_frame_is_found_by_id_and_format() -> None:
    found = [codec.frame_of(entry.word, TABLE.frames, len(FRAMES)) for entry in FRAMES]
    assert found == list(range(len(FRAMES))), f"{found}"
    others = (0x7FF, 0x80 | can_id.EXTENDED)
    missing = [codec.frame_of(word, TABLE.frames, len(FRAMES)) for word in others]
    assert missing == [-1, -1], f"{missing}"


def digest_of_frames(n: int) -> str:
    """Return a hash over decoded values and packed frames of `n` pseudo-random payloads."""
    rng = np.random.default_rng(9)
    digest = hashlib.sha256()
    mixed = [
        Signal("a", 7, 12, "big_endian", True, conversion=BaseConversion.factory(0.1, -5)),
        Signal("b", 16, 48, "little_endian", False, conversion=BaseConversion.factory(3, 2**60)),
    ]
    wide = [Signal("u", 0, 64, "little_endian", False)]
    double = [Signal("f", 7, 64, "big_endian", conversion=BaseConversion.factory(is_float=True))]
    extra = [
        dbc.frame(Message(i, f"X{i}", 8, signals, cycle_time=1, strict=True))
        for i, signals in enumerate((mixed, wide, double))
    ]
    table = dbc.table((*FRAMES, *extra), 1000.0)
    for i in range(n):
        row = i % len(table.frames)
        values = unpack(rng.bytes(8), row, table)
        digest.update(b"".join(float_bits(value) for value in values.values()))
        spread = {name: value * (1.0 + rng.uniform(-1, 1)) for name, value in values.items()}
        data, saturated = pack(spread, row, table)
        digest.update(data + bytes([saturated]))
    return digest.hexdigest()


def test_compiled_and_interpreted_codec_give_the_same_bits() -> None:
    assert interpreted(__name__, "t.digest_of_frames(510)") == digest_of_frames(510)
