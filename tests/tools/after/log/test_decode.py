"""Recorded frames are decoded as their DBC file says, on any levels of multiplexers, and by PGN."""

from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest

from pcpc.drivers.can import can_id, dbc, e2e
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import decode
from pcpc.tools.terminal.progress import Progress

SG = ' SG_ {} "{}" DEV\n'
NAN = np.nan


def described(frames: dict[str, list[str]], more: str = "") -> str:
    """Return a DBC file of frames with the beginnings of their signals."""
    text = "BU_: ECU DEV\n"
    for head, signals in frames.items():
        text += f"BO_ {head} ECU\n" + "".join(
            SG.format(one.removesuffix(" km") + " [0|0]", "km" if one.endswith(" km") else "")
            for one in signals
        )
    return text + more


def decoded(text: str, frames: list[tuple[int, str]]) -> decode.Decoded:
    rows = np.zeros(len(frames), logs.FD_FRAME)
    for row, (word, data) in zip(rows, frames, strict=True):
        raw = bytes.fromhex(data)
        row["id"], row["dlc"] = word, len(raw)
        row["data"][: len(raw)] = list(raw)
    return decode.by_id(dbc.parse(Path("x.dbc"), text), rows, Progress(True))


def columns(found: decode.Decoded) -> dict[str, list[float]]:
    """Return the values of each column by the names of frame and signal."""
    return {
        f"{one.name}.{name}": one.values[:, i].tolist()
        for one in found.frames
        for i, (name, *_) in enumerate(one.signals)
    }


LAYOUTS = ["page M : 0|8@1+ (1,0)", "always : 8|8@1+ (1,0)", "a m0 : 16|8@1+ (1,0)",
           "b m2 : 16|8@1+ (1,0)"]  # fmt: skip
PAGES = [(256, "00070A00"), (256, "09080A00"), (256, "02090B00"), (256, "010A0C00")]


@pytest.mark.parametrize("more", ["", "SG_MUL_VAL_ 256 a page 0-1;\nSG_MUL_VAL_ 256 b page 2-2;\n"])
def test_a_page_without_a_layout_has_the_signals_that_are_always_there(more: str) -> None:
    found = decoded(described({"256 F: 4": LAYOUTS}, more), PAGES)
    (one,) = found.frames
    assert columns(found) == {
        "F.page": [0, 9, 2, 1], "F.always": [7, 8, 9, 10],
        "F.a": [10, 10, 10, 12 if more else 10],
        "F.b": [pytest.approx(NAN, nan_ok=True)] * 2 + [11, 11],
    }  # fmt: skip
    assert one.place.tolist() == [0, 1, 2, 3] and not one.state.any()


def test_levels_of_multiplexers_are_followed_by_their_raw_values() -> None:
    text = described(
        {"1 F: 8": ["top M : 0|4@1- (2,1)", "mid m1M : 4|4@1+ (1,0)", "x m3 : 8|8@1+ (1,0)",
                    "y m15 : 16|8@1+ (1,0)"]},
        "SG_MUL_VAL_ 1 mid top 1-1;\nSG_MUL_VAL_ 1 x mid 3-4;\nSG_MUL_VAL_ 1 y top 15-15;\n",
    )  # fmt: skip
    data = ["3105000000000000", "4106000000000000", "3207000000000000", "3F08090000000000"]
    found = columns(decoded(text, [(1, one) for one in data]))
    assert found["F.x"] == [5, 6, 6, 6], "with 1 and 3 or 4"
    assert found["F.top"] == [3, 3, 5, -1] and found["F.y"][3] == 9
    assert found["F.mid"] == [3, 4, 4, 4]


@pytest.mark.parametrize(
    ("signals", "expected"),
    [
        (["page M : 0|8@1+ (1,0)", "s m0 : 8|8@1+ (1,0)", "s m1 : 16|8@1+ (2,0)"],
         {"F.page": [0, 1], "F.s": [17, 68]}),
        (["page M : 0|8@1+ (1,0)", "s m0 : 8|8@1+ (1,0)", "s m1 : 16|8@1+ (1,0) km"],
         {"F.page": [0, 1], "F.s_8": [17, 17], "F.s_16": [NAN, 34]}),
        (["page M : 0|8@1+ (1,0)", "s : 8|8@1+ (1,0)", "s m1 : 16|8@1+ (1,0)"],
         {"F.page": [0, 1], "F.s_8": [17, 17], "F.s_16": [NAN, 34]}),
        (["page M : 0|8@1+ (1,0)", "s m0 : 8|8@1+ (1,0)", "s m1 : 8|8@1+ (1,0) km"],
         {"F.page": [0, 1], "F.s_8_1": [17, 17], "F.s_8_2": [NAN, 17]}),
        (["s : 8|8@1+ (1,0)", "s : 16|8@1+ (1,0)"], {"F.s_8": [17, 17], "F.s_16": [34, 34]}),
    ],
)  # fmt: skip
def test_signals_of_one_name_share_a_column_only_where_they_never_meet(
    signals: list[str], expected: dict[str, list[float]]
) -> None:
    found = columns(decoded(described({"1 F: 4": signals}), [(1, "00112233"), (1, "01112233")]))
    np.testing.assert_equal(found, expected)


def test_of_equal_ids_the_first_frame_counts() -> None:
    text = described({"1 A: 2": ["a : 0|8@1+ (1,0)"], "1 B: 2": ["b : 0|8@1+ (1,0)"]})
    assert columns(decoded(text, [(1, "0500")])) == {"A.a": [5]}


def test_a_longer_frame_is_decoded_and_a_shorter_one_is_not() -> None:
    found = decoded(described({"1 F: 2": ["a : 0|8@1+ (1,0)"]}), [(1, "05"), (1, "0600"),
                                                                 (1, "070000")])  # fmt: skip
    assert columns(found) == {"F.a": [6, 7]} and found.frames[0].place.tolist() == [1, 2]
    assert (found.frames[0].state != 0).tolist() == [True, False, False]


def test_a_signal_that_no_frame_can_have_is_listed() -> None:
    signals = ["a : 0|8@1+ (1,0)", "far : 60|8@1+ (1,0)", "long : 0|72@1+ (1,0)",
               "half : 8|24@1- (1,0)", "wide : 1|8@1+ (1e400,0)",
               "high : 2|8@1+ (1,-1e400)"]  # fmt: skip
    found = decoded(described({"1 F: 8": signals}, "SIG_VALTYPE_ 1 half : 1;\n"), [(1, "05" * 8)])
    assert columns(found) == {"F.a": [5]}
    assert sorted(found.left_out) == [
        "F.far (60|8)", "F.half (8|24)", "F.high (2|8)", "F.long (0|72)", "F.wide (1|8)",
    ]  # fmt: skip


J1939 = 'BA_DEF_ "ProtocolType" STRING;\nBA_ "ProtocolType" "J1939";\n'
PG = 'BA_DEF_ BO_ "VFrameFormat" ENUM "S","E","r","J1939PG";\nBA_ "VFrameFormat" BO_ {} 3;\n'
EEC1, TSC1 = 0x0CF004FE, 0x0C0000FE


@pytest.mark.parametrize("more", [J1939, PG.format(EEC1 | can_id.EXTENDED)])
@pytest.mark.parametrize(
    ("recorded", "name"),
    [(0x0CF004FE, "EEC1"), (0x18F00403, "EEC1"), (0x00F004AA, "EEC1"), (0x0CF005FE, None),
     (0x0DF004FE, None), (0x0EF004FE, None), (0x04F003FE, None)],
)  # fmt: skip
def test_j1939_is_decoded_by_pgn(more: str, recorded: int, name: str | None) -> None:
    text = described({f"{EEC1 | can_id.EXTENDED} EEC1: 8": ["a : 0|8@1+ (1,0)"]}, more)
    found = decoded(text, [(recorded | can_id.EXTENDED, "05" * 8)])
    assert [one.name for one in found.frames] == ([name] if name else [])
    assert len(found.unknown) == (name is None)
    assert len(found.by_pgn) == (name is not None and recorded != EEC1)


def test_without_j1939_an_id_is_an_id() -> None:
    text = described({f"{EEC1 | can_id.EXTENDED} EEC1: 8": ["a : 0|8@1+ (1,0)"]})
    assert list(decoded(text, [(0x18F00403 | can_id.EXTENDED, "05" * 8)]).unknown) == [0x98F00403]


def test_a_destination_is_free_below_pdu_format_240_and_each_source_has_its_columns() -> None:
    text = described({f"{TSC1 | can_id.EXTENDED} TSC1: 8": ["a : 0|8@1+ (1,0)"]}, J1939)
    ids = [word | can_id.EXTENDED for word in (0x0C000003, 0x0C000B27, 0x0C010003)]
    found = decoded(text, [(ids[0], "05" * 8), (ids[1], "06" * 8), (ids[2], "07" * 8)])
    assert columns(found) == {"TSC1_C000003.a": [5], "TSC1_C000B27.a": [6]}
    assert list(found.unknown) == [ids[2]]


def test_of_several_frames_with_a_pgn_only_that_of_the_source_is_meant() -> None:
    frames = {f"{0x18FF1000 + i | can_id.EXTENDED} OWN{i}: 8": [f"a{i} : 0|8@1+ (1,0)"]
              for i in (1, 2)}  # fmt: skip
    text = described(frames, J1939)
    words = [can_id.EXTENDED | one for one in (0x0CFF1001, 0x0CFF1002, 0x0CFF1003)]
    found = decoded(text, [(one, "05" * 8) for one in words])
    assert set(columns(found)) == {"OWN1.a1", "OWN2.a2"} and list(found.unknown) == [words[2]]


@pytest.mark.parametrize("order", "01")
def test_any_place_length_and_scale_is_what_cantools_decodes(order: str) -> None:
    chance = np.random.default_rng(int(order))
    scales = ["(1,0)", "(0.1,-3)", "(-7,5)", "(12345678901,3)", "(3,0.5)", "(1e-3,1e6)"]
    for length in (1, 7, 8, 9, 16, 31, 32, 33, 53, 54, 63, 64):
        for sign in "+-":
            start = int(chance.integers(0, 512 - length))
            begin = start if order == "1" else start // 8 * 8 + 7 - start % 8
            scale = scales[int(chance.integers(len(scales)))]
            text = described({"1 F: 64": [f"s : {begin}|{length}@{order}{sign} {scale}"]})
            reference: Any = cantools.database.load_string(text, "dbc", strict=False)
            data = chance.integers(0, 256, (20, 64), np.uint8)
            found = decoded(text, [(1, one.tobytes().hex()) for one in data])
            expected = [float(reference.decode_message(1, one.tobytes())["s"]) for one in data]
            assert columns(found)["F.s"] == expected, text


@pytest.mark.parametrize(("bits", "kind"), [(32, 1), (64, 2)])
def test_floats_are_what_cantools_decodes(bits: int, kind: int) -> None:
    text = described({"1 F: 8": [f"s : 0|{bits}@1- (2,1)"]}, f"SIG_VALTYPE_ 1 s : {kind};\n")
    data = np.random.default_rng(bits).integers(0, 120, (20, 8), np.uint8)
    reference: Any = cantools.database.load_string(text, "dbc")
    expected = [float(reference.decode_message(1, one.tobytes())["s"]) for one in data]
    assert columns(decoded(text, [(1, one.tobytes().hex()) for one in data]))["F.s"] == expected


def test_counter_and_crc_are_checked_where_they_are_the_loops() -> None:
    signals = ["level : 0|8@1+ (1,0)", "counter : 8|4@1+ (1,0)", "crc : 16|8@1+ (1,0)"]
    text = described({"1 P: 3": signals})
    data = [bytes([10 + i, i]) for i in (0, 1, 3, 3, 4)]
    right = [one + bytes([int(e2e.crc8(1, np.frombuffer(one, np.uint8), 2))]) for one in data]
    (one,) = (found := decoded(text, [(1, frame.hex()) for frame in right])).frames
    assert columns(found) == {"P.level": [10, 11, 13, 14]}, "a repeated one is not used"
    assert (one.lost, one.checked, one.foreign_crc) == (1, True, False)
    (one,) = (found := decoded(text, [(1, f"{10 + i:02X}{i:02X}77") for i in range(3)])).frames
    assert columns(found) == {"P.level": [10, 11, 12]}
    assert (one.lost, one.checked, one.foreign_crc) == (0, False, True)
