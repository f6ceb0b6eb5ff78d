"""Frames in C: the bits of the loop's own codec and its protection, for every kind of signal.

As generated for a rig of classic frames, and for one that has some of CAN FD too.
"""

import ctypes
import random
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from fd_rig import LONG_DBC, fd_rig
from places import ROOT

from pcpc.drivers.can import codec, dbc, e2e
from pcpc.drivers.can.dbc import SignalKind
from pcpc.tools.make.generate import frames as in_c
from pcpc.tools.make.generate.device import same_files
from pcpc.tools.make.generate.words import identifier

STRICT = "-std=c99 -O2 -Wall -Wextra -Wconversion -Wdouble-promotion -Werror -ffp-contract=off"
FACTORS = 1, -1, 1e-4, 0.25, -0.1, 2.3968449810713143e-05, 3, -7, 2.0, 1e7, 0.3
OFFSETS = 0, 0, 0, 1, -40, 0.5, -273.15, 100000
ODD = 0.0, -0.0, 0.5, 1.5, 2.5, -0.5, 1e18, -1e18, 1e308, float("inf"), -float("inf"), float("nan")


def made_up(number: int, draw: random.Random) -> Message | None:
    """Return a frame whose signals lie anywhere, of any kind; None if the loop refuses it."""
    taken: set[int] = set()
    signals = []
    for name in "abcdef":
        first, length = (
            draw.choice((0, draw.randrange(64))),
            draw.choice((1, 4, 12, 20, 32, 53, 64)),
        )
        is_float = length in (32, 64) and draw.random() < 0.5
        if first + length > 64:
            continue
        big = draw.random() < 0.5
        turned = [n // 8 * 8 + 7 - n % 8 for n in range(first, first + length)]
        bits = set(turned if big else range(first, first + length))
        if bits & taken:
            continue
        taken |= bits
        factor, offset = draw.choice(FACTORS), draw.choice(OFFSETS)
        conversion = BaseConversion.factory(factor, offset, is_float=is_float)
        order = "big_endian" if big else "little_endian"
        start = turned[0] if big else first
        signed = draw.random() < 0.5
        signals.append(Signal(name, start, length, order, signed, conversion=conversion))
    chosen = [one for one in signals if one.length <= 20 and not one.is_signed]
    if number % 3 == 0 and chosen:
        chosen[0].is_multiplexer, chosen[0].conversion = True, BaseConversion.factory(1, 0)
        for one in signals:
            if one is not chosen[0] and draw.random() < 0.7:
                one.multiplexer_ids = [draw.randrange(2)]
                one.multiplexer_signal = chosen[0].name
    message = Message(number, f"F{number:03X}", 8, signals, send_type="EveryCycle")
    try:
        dbc.frame(message)
    except dbc.DbcError:
        return None
    return message


def all_frames(folder: Path, fd: bool) -> list[dbc.Frame]:
    """Return the frames of the project's plants and a few hundred made up."""
    files = [*ROOT.glob("plants/*/*.dbc"), ROOT / "tools/dev/evidence/crc16.dbc"]
    if fd:
        (folder / "long.dbc").write_text(LONG_DBC)
        files = [folder / "long.dbc", fd_rig(folder).with_suffix(".dbc"), *files]
    found: dict[str, dbc.Frame] = {}
    for file in files:
        for message in dbc.load(file).messages:
            found.setdefault(message.name, dbc.frame(message))
    draw = random.Random(18)
    drawn = (made_up(number, draw) for number in range(0x100))
    return [*found.values(), *(dbc.frame(message) for message in drawn if message is not None)]


@pytest.fixture(scope="module", params=[False, True], ids=["classic", "fd"])
def built(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[list[dbc.Frame], Any]:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler; apt-get install gcc libc6-dev")
    folder, fd = tmp_path_factory.mktemp("frames"), request.param
    found = all_frames(folder, fd)
    for name, text in same_files(fd=fd).items():
        (folder / name).write_text(text)
    (folder / "frames.h").write_text(in_c.header(found, found))
    (folder / "frames.c").write_text(in_c.source(found, found))
    rows = "".join(f"    {in_c.info(frame, 1000.0, fd)},\n" for frame in found)
    (folder / "table.c").write_text(
        f'#include "codec.h"\nextern const frame_info infos[];\n'
        f"const frame_info infos[] = {{\n{rows}}};\n"
        "const frame_info *info(int32_t i);\n"
        "const frame_info *info(int32_t i) { return &infos[i]; }\n"
    )
    words = ["cc", *STRICT.split(), "-fPIC", "-shared", "-o", "frames.so"]
    subprocess.run([*words, "codec.c", "frames.c", "table.c"], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "frames.so"))
    library.info.restype = ctypes.c_void_p
    return found, library


def test_pack_and_unpack_give_the_bits_of_the_loop(built: tuple[list[dbc.Frame], Any]) -> None:
    found, library = built
    kinds, layouts, draw = set(), 0, random.Random(5)
    for frame in found:
        if not frame.signals:
            continue
        table = dbc.table([frame], 1000.0)
        layouts += frame.selector != ""
        kinds |= {signal.kind for signal in frame.signals}
        where = table.frames, table.signals
        name = identifier(frame.name)
        for _ in range(30):
            values = np.array([a_value(signal, draw) for signal in frame.signals])
            layout = draw.randrange(3)
            for i, signal in enumerate(frame.signals):
                if signal.name == frame.selector:
                    values[i] = signal.factor * layout + signal.offset
            expected, told = np.zeros(64, np.uint8), np.zeros(64, np.uint8)
            clamped = codec.pack(expected, 0, *where, values)
            ours = getattr(library, f"pack_{name}")(values.ctypes, told.ctypes)
            assert (told.tobytes(), ours) == (expected.tobytes(), clamped), (frame.name, values)
            data = np.frombuffer(draw.randbytes(64), np.uint8).copy()
            data[frame.dlc :] = 0
            if frame.selector:
                data[:] = expected  # in whose layout there is something
            unpacked = values.copy()
            codec.unpack(data, 0, *where, values)
            getattr(library, f"unpack_{name}")(data.ctypes, unpacked.ctypes)
            assert unpacked.tobytes() == values.tobytes(), (frame.name, data.tobytes().hex())
    assert layouts > 10
    assert kinds == {
        SignalKind.SCALED,
        SignalKind.WIDE,
        SignalKind.UNSIGNED_64,
        SignalKind.FLOAT_32,
        SignalKind.FLOAT_64,
    }


def a_value(signal: dbc.Signal, draw: random.Random) -> float:
    """Return a value in range, between two raw numbers, beyond, or odd."""
    kind = draw.randrange(8)
    low, high = signal.range
    if kind == 0:
        return draw.choice(ODD)
    if kind == 1:
        return struct.unpack("d", draw.randbytes(8))[0]
    if kind == 2:
        return signal.offset + signal.factor * (draw.randrange(2**20) + 0.5)
    return draw.uniform(max(low, -1e300), min(high, 1e300)) * draw.choice((1.0, 1.0, 1.01))


def test_protection_and_judgement_are_those_of_the_loop(
    built: tuple[list[dbc.Frame], Any],
) -> None:
    found, library = built
    judged, draw = set(), random.Random(7)
    for i, frame in enumerate(found):
        if not frame.protected:
            continue
        info = ctypes.c_void_p(library.info(i))
        table, state = dbc.table([frame], 1000.0), e2e.new_state(1)
        receiver, lost = struct.pack("=iI?3x", -1, 0, False), ctypes.c_uint32(0)
        buffer = ctypes.create_string_buffer(receiver, len(receiver))
        counter = 0
        for _ in range(200):
            counter += draw.choice((1, 1, 1, 1, 0, 2, 3, 4, 5, 9))
            told = np.zeros(64, np.uint8)
            told[: frame.dlc] = np.frombuffer(draw.randbytes(frame.dlc), np.uint8)
            expected = told.copy()
            e2e.protect(expected, 0, table.frames, counter)
            library.protect(told.ctypes, info, ctypes.c_uint32(counter))
            assert told.tobytes() == expected.tobytes(), frame.name
            length = frame.dlc if draw.random() < 0.95 else frame.dlc - 1
            if draw.random() < 0.1:
                told[draw.randrange(frame.dlc)] ^= 1 << draw.randrange(8)
            for _ in range(draw.randrange(1, 12)):
                e2e.begin_cycle(state, 1)
                last, still, fresh = struct.unpack("=iI?3x", buffer.raw[:12])
                struct.pack_into("=iI?3x", buffer, 0, last, still + 1, False)
            before = int(lost.value)
            outcome, missing = e2e.check(told, length, 0, table.frames, state)
            ours = library.judge(told.ctypes, length, info, buffer, ctypes.byref(lost))
            assert ours == outcome, (frame.name, counter)
            assert lost.value - before == missing, frame.name
            last, _, fresh = struct.unpack("=iI?3x", buffer.raw[:12])
            assert (last, fresh) == (state[0].last_counter, state[0].fresh == 1)
            judged.add((outcome, int(table.frames[0].protected)))
    assert len(judged) == 10, judged  # each of five outcomes with both CRCs
