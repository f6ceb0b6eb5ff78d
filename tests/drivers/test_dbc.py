"""Reading a DBC: clear errors, the tables of the loop, and the load of the bus."""

import time
from pathlib import Path

import cantools
import pytest

from pcpc.drivers.can import dbc
from pcpc.drivers.can.dbc import BusError, DbcError

HEAD = 'VERSION "1"\nBU_: A B\n'
CYCLIC = 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" 10;\n'

SG = ' SG_ {} "" B\n'


def written(folder: Path, body: str, attributes: str = CYCLIC) -> Path:
    path = folder / "plant.dbc"
    path.write_text(HEAD + body + attributes)
    return path


def refusal(path: Path, node: str = "A") -> str:
    with pytest.raises(BusError) as caught:
        dbc.frames(dbc.load(path), node, "tx")
    text = str(caught.value)
    assert "\n" not in text, f"more than one line: {text}"
    return text


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    text = refusal(tmp_path / "no.dbc")
    assert text == f"{tmp_path / 'no.dbc'}: no such file; give the path of the plant's DBC file"


def test_a_folder_is_no_dbc(tmp_path: Path) -> None:
    text = refusal(tmp_path)
    assert "directory" in text, text


def test_a_syntax_error_has_line_and_column(tmp_path: Path) -> None:
    text = refusal(written(tmp_path, 'BO_ 1 M: 8 A\n SG_ q 0|8@1+ (1,0) [0|0] "" B\n'))
    expected = (
        f'{tmp_path}/plant.dbc:4:8: not DBC syntax at >>!<<: SG_ q >>!<<0|8@1+ (1,0) [0|0] "" B'
    )
    assert text == expected, text


@pytest.mark.parametrize(
    ("body", "part"),
    [
        ("8 A\nBO_ 1 N: 8 A\n", "M and N (id 0x1) have the same id; the first counts"),
        ("8 A\nBO_ 2 M: 8 A\n", "frame M: another one has this name; read as M_2"),
        ("1 A\n" + SG.format("a : 4|8@1+ (1,0) [0|0]"), "bits 4|8 do not lie in the 1 bytes"),
        ("1 A\n" + SG.format("a : 0|8@1+ (1,0) [0|0]") + SG.format("b : 0|4@1+ (1,0) [0|0]"),
         "are overlapping in message M"),
        ("64 A\n", "frame M: 64 bytes need CAN FD"),
        ("1000000000 A\n", "plant.dbc:3: frame M: 1000000000 bytes; classic CAN has 8"),
        ("+1000000000 A\n", "plant.dbc:3: frame M: +1000000000 bytes"),
        ("-1 A\n", "plant.dbc:3: frame M: -1 bytes"),
        ("8 A\n" + SG.format("a : 1000000000|8@1+ (1,0) [0|0]"), ":4: frame M: a: 1000000000|8"),
        ("8 A\n" + SG.format("a : 0|1000000000@1+ (1,0) [0|0]"), "a: 0|1000000000 lies in no"),
        ("8 A\n" + SG.format("a : -1|8@1+ (1,0) [0|0]"), "a: -1|8 lies in no frame"),
        ("8 A\n" + SG.format("a : 0|0@1+ (1,0) [0|0]"), "length 0 is not greater than 0"),
        ("8 A\n" + SG.format("m M : 0|8@1+ (1,0) [0|0]") + SG.format("a m0 : 8|8@1+ (1,0) [0|0]")
         + "SG_MUL_VAL_ 1 a m 0-5, 7-4000000000;\n", "a: 7-4000000000: more than 65536 values"),
        ("8 A\n" + SG.format("a : 0|8@1+ (1,0) [0|0]") + SG.format("a : 8|8@1+ (1,0) [0|0]"),
         "frame M: 2 signals a; give each"),
        ("1 A\n" + SG.format(f"a : 0|8@1+ (1{'0' * 400},0) [0|0]"), "M: a: factor inf"),
        ("1 A\n" + SG.format("a : 0|8@1+ (1,1e999) [0|0]"), "offset inf"),
        ("8 A\n" + SG.format("a : 0|8@1+ (1e308,0.5) [0|0]"), "gives infinite values"),
        ("1 A\n" + SG.format("a : 0|8@1+ (1,0) [5|-5]"), "no raw value lies in [5.0|-5.0]"),
        ("2 A\n" + SG.format("a : 0|16@1+ (1,0) [0|0]") + "SIG_VALTYPE_ 1 a : 1;\n",
         "float of 16 bits; use 32 or 64"),
        ("2 A\n" + SG.format("m M : 0|8@1- (1,0) [0|0]") + SG.format("a m0 : 8|8@1+ (1,0) [0|0]"),
         "frame M: m: a multiplexer must be unsigned"),
        ("2 A\n" + SG.format("m M : 0|1@1+ (1,0) [0|0]") + SG.format("a m2 : 8|8@1+ (1,0) [0|0]"),
         "frame M: a: layout 2 does not fit into the 1 bits of m"),
        ("8 A\n" + SG.format("m M : 0|8@1+ (1,0) [0|0]") + SG.format("a m0M : 8|8@1+ (1,0) [0|0]")
         + SG.format("b m1 : 16|8@1+ (1,0) [0|0]") + "SG_MUL_VAL_ 1 a m 0-0;\n"
         "SG_MUL_VAL_ 1 b a 1-1;\n", "frame M: a: a multiplexer within a layout; give each"),
        ("8 A\n" + SG.format("m M : 0|8@1+ (1,0) [0|0]") + SG.format("a m0 : 8|8@1+ (1,0) [0|0]")
         + "SG_MUL_VAL_ 1 a m 0-5;\n", "frame M: a: in more than one layout; give each"),
        ("8 A\n" + SG.format("m M : 0|8@1+ (1,0) [0|0]") + SG.format("n M : 8|8@1+ (1,0) [0|0]")
         + SG.format("a m0 : 16|8@1+ (1,0) [0|0]") + SG.format("b m0 : 24|8@1+ (1,0) [0|0]")
         + "SG_MUL_VAL_ 1 a m 0-0;\nSG_MUL_VAL_ 1 b n 0-0;\n", "more than one multiplexer"),
        ("3 A\n" + SG.format("counter m0 : 0|4@1+ (1,0) [0|0]")
         + SG.format("m M : 8|8@1+ (1,0) [0|0]") + SG.format("crc : 16|8@1+ (1,0) [0|0]"),
         "counter: only in one layout; let it be in all"),
        ("2 A\n" + SG.format("crc : 8|8@1+ (1,0) [0|0]"), "no counter or sequence"),
        ("2 A\n" + SG.format("crc : 0|8@1+ (1,0) [0|0]"), "crc must be the 8 bits of the last"),
        ("3 A\n" + SG.format("crc : 16|8@1+ (1,0) [0|0]")
         + SG.format("counter : 6|4@1+ (1,0) [0|0]"), "unsigned and lie within one byte"),
        ("4 A\n" + SG.format("crc : 0|16@1+ (1,0) [0|0]")
         + SG.format("counter : 24|8@1+ (1,0) [0|0]"), "as in AUTOSAR's E2E profile 5"),
        ("4 A\n" + SG.format("crc : 0|16@1+ (1,0) [0|0]")
         + SG.format("counter : 16|4@1+ (1,0) [0|0]"), "the one behind it is the counter's"),
        ("4 A\n" + SG.format("crc : 7|16@0+ (1,0) [0|0]")
         + SG.format("counter : 16|8@1+ (1,0) [0|0]"), "two whole bytes (Intel)"),
        ("4 A\n" + SG.format("crc : 4|16@1+ (1,0) [0|0]")
         + SG.format("counter : 20|8@1+ (1,0) [0|0]"), "unsigned and lie within one byte"),
        ("4 A\n" + SG.format("crc : 0|16@1+ (1,0) [0|0]")
         + SG.format("counter : 16|8@1+ (1,0) [0|0]")
         + 'BA_DEF_ BO_ "E2EDataId" INT 0 0;\nBA_DEF_DEF_ "E2EDataId" 0;\n'
         'BA_ "E2EDataId" BO_ 1 65536;\n', "frame M: E2EDataId 65536; expected 0 to 65535"),
        ("1 A\n" + SG.format("a : 0|8@1+ (0,0) [0|0]"), "M: a: factor 0.0"),
        ("1 A\n" + SG.format("a : 0|8@1+ (1,0) [300|400]"), "no raw value lies in [300.0|400.0]"),
        ("8 A\n" + SG.format("a : 0|64@1+ (3,0) [0|0]"), "scaled values exceed 64 bits"),
    ],
)  # fmt: skip
def test_a_frame_that_the_loop_cannot_handle_is_refused(
    tmp_path: Path, body: str, part: str
) -> None:
    text = refusal(written(tmp_path, "BO_ 1 M: " + body))
    assert part in text, text


def test_a_frame_without_a_cycle_time_is_refused(tmp_path: Path) -> None:
    text = refusal(written(tmp_path, "BO_ 1 M: 8 A\n", attributes=""))
    assert text == 'frame M: give a GenMsgCycleTime, or GenMsgSendType "EveryCycle"', text


def test_an_unknown_node_is_answered_with_the_known_ones(tmp_path: Path) -> None:
    text = refusal(written(tmp_path, "BO_ 1 M: 8 A\n"), node="EXEC")
    assert text == "node EXEC: not in the DBC file; it has A, B", text


def test_sent_and_received_frames_are_those_of_the_node_by_id(tmp_path: Path) -> None:
    body = (
        'BO_ 7 U: 1 A\n SG_ a: 0|8@1+ (1,0) [0|0] "" B\n'
        'BO_ 2 V: 1 A\n SG_ a: 0|8@1+ (1,0) [0|0] "" Vector__XXX\n'
    )
    database = dbc.load(written(tmp_path, body))
    got = {
        (node, way): [entry.name for entry in dbc.frames(database, node, way)]
        for node in "AB"
        for way in ("tx", "rx")
    }
    expected = {("A", "tx"): ["V", "U"], ("A", "rx"): [], ("B", "tx"): [], ("B", "rx"): ["U"]}
    assert got == expected, f"{got}"


def test_a_protected_frame_has_its_tail_in_the_frame_row_only(tmp_path: Path) -> None:
    body = (
        'BO_ 2147484000 M: 4 A\n SG_ a: 15|8@0- (0.5,1) [-10|10] "V" B\n'
        ' SG_ counter: 7|4@0+ (1,0) [0|0] "" B\n SG_ crc: 31|8@0+ (1,0) [0|0] "" B\n'
    )
    entries = dbc.frames(dbc.load(written(tmp_path, body)), "A", "tx")
    table = dbc.table(entries, 1000.0, {"M.a": 5})
    row = table.frames[0].tolist()
    assert row == (352, 1, 4, 0, 0, 1, 10, 1, 0, 0, 4, 15, 3, 352, 0), f"{row}"
    assert table.variables == ("M.a",), f"{table.variables}"
    assert table.signals[0].variable == 5, f"{table.signals}"
    scales = table.signals[0].tolist()[-4:]
    assert scales == (0.5, 1.0, -22.0, 18.0), f"{scales}"


@pytest.mark.parametrize(
    ("rate_hz", "expected"), [(1000, 10), (500, 5), (1200, 12), (4000, 40), (50, 1), (1049, 10)]
)
def test_a_cyclic_frame_keeps_its_time_at_any_rate(
    tmp_path: Path, rate_hz: int, expected: int
) -> None:
    (entry,) = dbc.frames(dbc.load(written(tmp_path, "BO_ 1 M: 8 A\n")), "A", "tx")
    got = entry.every_n(rate_hz)
    assert got == expected, f"every {got} cycles at {rate_hz} Hz"


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-8-sig", "utf-16"])
def test_units_and_comments_are_read_in_the_encodings_of_the_world(
    tmp_path: Path, encoding: str
) -> None:
    body = 'BO_ 1 M: 1 A\n SG_ a : 0|8@1+ (1,0) [0|0] "\u00b0C" B\n'
    body += 'CM_ BO_ 1 "\u00fcber 5 \u00b5s\x07";\n'
    path = tmp_path / "plant.dbc"
    end = "\x1a" + "\0" * 9  # of DOS, and of a file that lost its power
    path.write_bytes((HEAD + body + CYCLIC + end).replace("\n", "\r\n").encode(encoding))
    (entry,) = dbc.frames(dbc.load(path), "A", "tx")
    got = entry.signals[0].unit, entry.help
    assert got == ("\u00b0C", "\u00fcber 5 \u00b5s\\x07"), got
    assert not set("\r\x1a\0") & set(dbc.text(path))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "it is empty"), (b" \r\n", "it is empty"), (b"\0\1\2", "not text"),
        (b'<?xml version="1.0"?><NetworkDefinition/>', "XML (KCD, ARXML?), not DBC"),
        (b"FormatVersion=6.0 // SYM", "SYM, not DBC; convert it"),
        (b"version https://git-lfs.github.com/spec/v1\noid", "a Git LFS pointer; fetch the file"),
        (b'BU_: A\nBO_ 1 M: 8 A\n' + 8 * b' SG_ "' + b"\n", "not DBC syntax"),
        (b"BU_: A\nBO_ 4294967295 M: 8 A\n", "more than 29 bits"),
        (b"\x1b[2JVERSION", "not DBC syntax at"),
    ],
)  # fmt: skip
def test_what_is_no_dbc_file_is_refused_in_a_printable_line(
    tmp_path: Path, content: bytes, said: str
) -> None:
    path = tmp_path / "plant.dbc"
    path.write_bytes(content)
    text = refusal(path)
    assert said in text and text.startswith(str(path)) and text.isprintable(), repr(text)


def test_a_line_that_never_ends_its_signal_costs_no_time(tmp_path: Path) -> None:
    """The look at the sizes goes through the text once, whatever is in it."""
    begin_s = time.process_time()
    for content in (
        "SG_ a " * 40_000,
        "SG_ " + "a" * 200_000,
        'BO_ "' * 40_000,
        "BO_ 1 M " * 40_000,
    ):
        path = tmp_path / "plant.dbc"
        path.write_text(content)
        refusal(path)
    spent_s = time.process_time() - begin_s
    assert spent_s < 30.0, f"{spent_s:.1f} s"


def test_a_range_without_end_is_the_raw_range(tmp_path: Path) -> None:
    body = "BO_ 1 M: 1 A\n" + SG.format("a : 0|8@1- (2,0) [-1e999|1e999]")
    (entry,) = dbc.frames(dbc.load(written(tmp_path, body)), "A", "tx")
    assert entry.signals[0].codes == (-128, 127), entry.signals[0]


@pytest.mark.parametrize("given", ["-5", "99999999999", "1e400"])
def test_a_cycle_time_that_is_none_is_refused(tmp_path: Path, given: str) -> None:
    attributes = CYCLIC.replace("INT 0 65535", "FLOAT 0 1").replace("10;", f"{given};")
    text = refusal(written(tmp_path, "BO_ 1 M: 8 A\n", attributes))
    assert "GenMsgCycleTime" in text and "expected 1 to" in text, text


def test_a_long_name_that_is_no_name_is_left_out_and_listed(tmp_path: Path) -> None:
    body = (
        'BO_ 1 M: 8 A\nBA_DEF_ BO_ "SystemMessageLongSymbol" STRING;\n'
        'BA_ "SystemMessageLongSymbol" BO_ 1 "a.b\x1b[2J";\n'
    )
    database = dbc.load(written(tmp_path, body))
    assert [entry.name for entry in dbc.frames(database, "A", "tx")] == ["M"]
    (odd,) = database.odd
    assert r"line 5: frame M: 'a.b\x1b[2J' is no name; use letters" in str(odd), odd


@pytest.mark.parametrize("bits", ["60|8@1", "0|65@1", "200|8@1", "58|8@0", "3|66@0"])
def test_a_signal_outside_of_its_frame_is_refused_where_cantools_let_it_pass(bits: str) -> None:
    text = f'VERSION ""\nBU_: A\nBO_ 5 F: 8 A\n SG_ s : {bits}+ (1,0) [0|0] "" A\n' + CYCLIC
    database = cantools.database.load_string(text, "dbc", strict=False)
    with pytest.raises(DbcError, match=r"frame F: s: bits .* do not lie in the 8 bytes"):
        dbc.frame(database.messages[0])  # type: ignore[union-attr]
