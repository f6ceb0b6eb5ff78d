"""Frames of a DBC file in C: a struct of signals for each, functions to pack and unpack, a table.

CMD_signals                    the frame's signals, physical values in double
pack_CMD(s, data)              to eight bytes, counter and CRC still 0; returns how many clamped
unpack_FB_A(data, s)           from eight bytes

A frame of more than eight bytes, which CAN FD has, is all its bytes; each of its signals has a word
of its own there.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from pcpc.drivers.can import dbc
from pcpc.drivers.can.dbc import SignalKind
from pcpc.executive.rig import messages
from pcpc.tools.make.generate.words import comment, identifier, number

Frames = Sequence[dbc.Frame]
_ADD_WORD = """\
/* Add the bits of a little-endian and of a big-endian word to eight bytes. */
static void add_words(uint8_t data[8], uint64_t little, uint64_t big)
{
    uint8_t word[8];
    put_words(word, little, big);
    for (uint32_t i = 0u; i < 8u; i++) {
        data[i] |= word[i];
    }
}"""
_RAW_OF = {SignalKind.FLOAT_32: "raw_of_float32", SignalKind.FLOAT_64: "raw_of_float64"}


def header(sent: Frames, heard: Frames) -> str:
    """Return frames.h, of the frames that a device sends and hears."""
    lines = ["/* Signals of the frames, from the DBC file; physical values in their units. */"]
    lines += ["#ifndef FRAMES_H", "#define FRAMES_H", "", '#include "codec.h"', ""]
    for frame in _full({one.name: one for one in (*sent, *heard)}.values()):
        lines += [*_struct(frame), ""]
    lines.append(
        "/* Pack: counter and CRC are left 0; how many signals were clamped is returned. */"
    )
    lines += [f"{_pack_head(frame)};" for frame in _full(sent)]
    lines += ["", *(f"{_unpack_head(frame)};" for frame in _full(heard))]
    return "\n".join([*lines, "", "#endif", ""])


def source(sent: Frames, heard: Frames) -> str:
    """Return frames.c."""
    lines = ['#include "frames.h"']
    if any(_is_long(frame) for frame in _full(sent)):
        lines += ["", *_ADD_WORD.splitlines()]
    for frame in _full(sent):
        lines += ["", *_pack(frame)]
    for frame in _full(heard):
        lines += ["", *_unpack(frame)]
    return "\n".join([*lines, ""])


def info(frame: dbc.Frame, rate_hz: float, with_kind: bool = False) -> str:
    """Return the initialiser of the frame's `frame_info`; `with_kind`: of a rig on CAN FD."""
    kind, crc_byte, data_id = frame.crc
    byte, shift, mask = frame.counter
    flags = (
        frame.has_sequence,
        messages.is_awaited(frame),
        messages.is_heartbeat(frame),
        messages.is_emergency(frame),
    )
    word = f"0x{frame.can_id:03X}u" + (" | FRAME_EXTENDED" if frame.extended else "")
    told = ", ".join("true" if flag else "false" for flag in flags)
    told += f", {frame.flags}u" * with_kind
    return (
        f"{{{word}, {frame.every_n(rate_hz)}u, 0x{data_id & 0xFFFF:04X}u, {frame.dlc}u, "
        f"{dbc.Protection(kind).name}, {byte}u, {shift}u, 0x{mask:02X}u, {crc_byte}u, {told}}}"
    )


def data_bytes(frames: Iterable[dbc.Frame]) -> int:
    """Return the room that the data of any of the frames take: 8, or more."""
    return max(8, *(frame.dlc for frame in frames))


def _is_long(frame: dbc.Frame) -> bool:
    return frame.dlc > 8


def _full(frames: Iterable[dbc.Frame]) -> Iterator[dbc.Frame]:
    return (frame for frame in frames if frame.signals)


def _struct(frame: dbc.Frame) -> Iterator[str]:
    yield f"/* {frame.name}{': ' + comment(frame.help) if frame.help else ''} */"
    yield "typedef struct {"
    for signal in frame.signals:
        about = "; ".join(filter(None, (signal.unit, comment(signal.help))))
        yield f"    double {identifier(signal.name)};" + (f" /* {about} */" if about else "")
    yield f"}} {identifier(frame.name)}_signals;"


def _pack_head(frame: dbc.Frame) -> str:
    name = identifier(frame.name)
    return f"uint32_t pack_{name}(const {name}_signals *s, uint8_t data[{data_bytes([frame])}])"


def _unpack_head(frame: dbc.Frame) -> str:
    name = identifier(frame.name)
    return f"void unpack_{name}(const uint8_t data[{data_bytes([frame])}], {name}_signals *s)"


def _hex(word: int) -> str:
    word &= 2**64 - 1
    return f"0x{word:X}u" if word < 2**32 else f"0x{word:X}ull"


def _pack(frame: dbc.Frame) -> Iterator[str]:
    table = dbc.table([frame], 1.0)
    yield _pack_head(frame)
    yield "{"
    for i, signal in enumerate(frame.signals):
        row = table.signals[i]
        scale = map(float, (row.factor, row.offset, row.code_low, row.code_high))
        bits = _hex(int(row.bits_low)), _hex(int(row.bits_high))
        fields = ", ".join([*map(number, scale), *bits])
        yield f"    static const scale_t {identifier(signal.name)}_scale = {{{fields}}};"
    if not _is_long(frame):
        yield "    uint64_t little = 0u;"
        yield "    uint64_t big = 0u;"
    yield "    uint32_t clamped = 0u;"
    if frame.selector:
        chosen = int(table.frames[0].selector) - 1
        name, mask = identifier(frame.selector), int(table.signals[chosen].mask)
        yield "    uint32_t counted_below = 0u;"
        raw = f"raw_of(s->{name}, &{name}_scale, &counted_below)"
        yield f"    const uint64_t layout = {raw} & {_hex(mask)};"
    if _is_long(frame):
        yield f"    for (uint32_t i = 0u; i < {frame.dlc}u; i++) {{"
        yield from ("        data[i] = 0u;", "    }")
    for i, signal in enumerate(frame.signals):
        row, name = table.signals[i], identifier(signal.name)
        raw = f"{_RAW_OF.get(signal.kind, 'raw_of')}(s->{name}, &{name}_scale, &clamped)"
        word = "big" if signal.big_endian else "little"
        shift, mask = int(row.shift), int(row.mask)
        placed = f"({raw} & {_hex(mask)}) << {shift}"
        statement = f"{word} |= {placed};"
        if _is_long(frame):
            both = f"0u, {placed}" if signal.big_endian else f"{placed}, 0u"
            statement = f"add_words(&data[{int(row.byte)}], {both});"
        yield from _where_it_is(signal, statement)
    if not _is_long(frame):
        yield "    put_words(data, little, big);"
    yield "    return clamped;"
    yield "}"


def _unpack(frame: dbc.Frame) -> Iterator[str]:
    table = dbc.table([frame], 1.0)
    yield _unpack_head(frame)
    yield "{"
    for word, big in (("little", False), ("big", True)):
        if not _is_long(frame) and any(signal.big_endian is big for signal in frame.signals):
            yield f"    const uint64_t {word} = get_{word}(data);"
    if frame.selector:
        raw = _raw(frame, table.signals[int(table.frames[0].selector) - 1])
        yield f"    const uint64_t layout = {raw};"
    for i, signal in enumerate(frame.signals):
        row = table.signals[i]
        raw = _raw(frame, row)
        factors = int(row.int_factor), int(row.int_offset)
        value = _value(signal, raw, factors)
        yield from _where_it_is(signal, f"s->{identifier(signal.name)} = {value};")
    yield "}"


def _raw(frame: dbc.Frame, row: Any) -> str:
    """Return the expression of a signal's raw word; `row`: of `dbc.table`."""
    word = "big" if row.big_endian else "little"
    if _is_long(frame):
        word = f"get_{word}(&data[{int(row.byte)}])"
    return f"({word} >> {int(row.shift)}) & {_hex(int(row.mask))}"


def _where_it_is(signal: dbc.Signal, statement: str) -> Iterator[str]:
    """Yield a statement, for the layout of a multiplexed frame that has the signal."""
    if signal.layout is None:
        yield f"    {statement}"
    else:
        yield from (f"    if (layout == {signal.layout}u) {{", f"        {statement}", "    }")


def _value(signal: dbc.Signal, raw: str, whole: tuple[int, int]) -> str:
    """Return the expression of a signal's value; without a scale of 1 and an offset of 0."""
    if signal.kind in (SignalKind.FLOAT_32, SignalKind.FLOAT_64):
        code = f"float{signal.nbits}_of({raw})"
        if signal.factor != 1.0 or signal.offset != 0.0:  # else -0.0 stays
            code = f"({code} * {number(signal.factor)}) + {number(signal.offset)}"
        return code
    if signal.kind == SignalKind.UNSIGNED_64:
        code = f"(double)({raw})"
    else:
        extends = signal.signed and signal.nbits < 64
        code = f"signed_of({raw}, {signal.nbits}u)" if extends else f"(int64_t)({raw})"
        if signal.kind == SignalKind.WIDE:
            return f"(double)(({code} * {whole[0]}ll) + {whole[1]}ll)"
        code = f"(double){code}"
    if signal.factor < 0.0 and signal.offset == 0.0:  # so that raw 0 is no -0.0
        return f"plus_zero({code} * {number(signal.factor)})"
    if signal.factor != 1.0:
        code = f"{code} * {number(signal.factor)}"
    return f"({code}) + {number(signal.offset)}" if signal.offset != 0.0 else code
