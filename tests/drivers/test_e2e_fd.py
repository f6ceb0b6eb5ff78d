"""The CRC-16 of profile 5 over a frame of CAN FD, in the loop and in generated C."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from pcpc.drivers.can import dbc, e2e
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.tools.make.generate import frames as in_c
from pcpc.tools.make.generate.device import same_files

DATA_ID = 0x1234
FORMATS = ",".join([f'"f{i}"' for i in range(14)] + ['"StandardCAN_FD"', '"ExtendedCAN_FD"'])
TEXT = f"""VERSION ""
BU_: A B
BO_ 291 LONG: 64 A
 SG_ crc : 0|16@1+ (1,0) [0|0] "" B
 SG_ counter : 16|8@1+ (1,0) [0|0] "" B
 SG_ rest : 448|64@1+ (1,0) [0|0] "" B
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "E2EDataId" INT 0 65535;
BA_DEF_ BO_ "VFrameFormat" ENUM {FORMATS};
BA_DEF_DEF_ "GenMsgCycleTime" 1;
BA_DEF_DEF_ "E2EDataId" 0;
BA_DEF_DEF_ "VFrameFormat" "StandardCAN_FD";
BA_ "E2EDataId" BO_ 291 {DATA_ID};
"""
FRAME = dbc.frame(dbc.parse(Path("long.dbc"), TEXT, strict=True).messages[0])
ROWS = dbc.table((FRAME,), 1000.0).frames


def crc_of(data: bytes) -> int:
    """Return what profile 5 says: of all behind the CRC, then the data id, low byte first."""
    crc = 0xFFFF
    for byte in (*data[2:], DATA_ID & 255, DATA_ID >> 8):
        for i in range(8):
            crc = crc << 1 ^ (0x1021 if crc >> 15 ^ byte >> 7 - i & 1 else 0) & 0xFFFF
            crc &= 0xFFFF
    return crc


def protected(counter: int) -> "np.ndarray[tuple[int], np.dtype[np.uint8]]":
    data = np.random.default_rng(counter).integers(0, 256, 64, np.uint8)
    data[:3] = 0
    e2e.protect(data, 0, ROWS, counter)
    return data


@pytest.mark.parametrize("counter", [0, 1, 200, 255])
def test_it_is_that_of_the_profile_over_all_bytes(counter: int) -> None:
    data = protected(counter)
    assert data[2] == counter and int(data[0]) | int(data[1]) << 8 == crc_of(data.tobytes())


def test_each_flipped_bit_and_a_shorter_frame_are_detected() -> None:
    state = e2e.new_state(1)
    assert e2e.check(protected(7), 64, 0, ROWS, state.copy())[0] == FrameState.OK
    for bit in range(512):
        data = protected(7)
        data[bit // 8] ^= 1 << bit % 8
        assert e2e.check(data, 64, 0, ROWS, state.copy())[0] == FrameState.ERROR, bit
    assert e2e.check(protected(7), 48, 0, ROWS, state.copy())[0] == FrameState.ERROR


def test_generated_c_protects_it_with_the_same_bytes(tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler; apt-get install gcc libc6-dev")
    for name, text in same_files(fd=True).items():
        (tmp_path / name).write_text(text)
    row = in_c.info(FRAME, 1000.0, True)
    (tmp_path / "row.c").write_text(
        f'#include "codec.h"\nstatic const frame_info ROW = {row};\n'
        "void ours(uint8_t *data, uint32_t counter);\n"
        "void ours(uint8_t *data, uint32_t counter)\n{\n    protect(data, &ROW, counter);\n}\n"
        "int wrong(const uint8_t *data, uint8_t n);\n"
        "int wrong(const uint8_t *data, uint8_t n)\n{\n"
        "    receiver_t state = {-1, 0u, false, false};\n"
        "    uint32_t lost = 0u;\n    return judge(data, n, &ROW, &state, &lost) == WRONG_CRC;\n}\n"
    )
    words = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-o"]
    sources = [str(tmp_path / name) for name in ("codec.c", "row.c")]
    subprocess.run([*words, str(tmp_path / "c.so"), *sources], check=True)
    library = ctypes.CDLL(str(tmp_path / "c.so"))
    for counter in (0, 7, 255):
        data = protected(counter)
        given = ctypes.create_string_buffer(bytes(3) + data[3:].tobytes(), 64)
        library.ours(given, counter)
        assert given.raw == data.tobytes()
        assert not library.wrong(given, 64) and library.wrong(given, 48)
        given[63] = bytes([given.raw[63] ^ 1])
        assert library.wrong(given, 64)
