"""One odd entry refuses no DBC file: what is well-formed is in, everything else is listed."""

import random
from pathlib import Path

import cantools
import pytest

from pcpc.drivers.can import dbc, dbc_file
from pcpc.drivers.can.dbc import DbcError
from pcpc.drivers.machine.patience import StalledError

HEAD = """VERSION ""
NS_ :
    NS_DESC_
    CM_
BS_:
BU_: ECU DEV
BO_ 256 SPEED: 8 ECU
 SG_ v : 0|16@1+ (0.01,0) [0|655.35] "m/s" DEV
 SG_ page M : 16|4@1+ (1,0) [0|15] "" DEV
 SG_ a m0 : 24|8@1+ (1,0) [0|255] "" DEV
BO_ 257 OTHER: 8 DEV
 SG_ w : 0|16@1- (1,0) [0|0] "" ECU
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 10;
"""
HARMLESS = [  # nothing of a frame depends on it
    ('VAL_ 256 removed 0 "off" 1 "on" ;', "VAL_ 256 removed: frame SPEED has no such signal"),
    ('VAL_ 999 v 0 "off" ;', "VAL_ 999: there is no frame with this id"),
    ('VAL_ 256 v 0.5 "half" ;', "VAL_ 256 v: a key is no whole number"),
    ('VAL_ 256 v 0 "off" 1 ;', "not DBC syntax at >>!<<: VAL_ 256 v 0 \"off\" >>!<<1 ;"),
    ("SIG_VALTYPE_ 999 v : 1;", "SIG_VALTYPE_ 999: there is no frame"),
    ("SIG_VALTYPE_ 256 gone : 1;", "SIG_VALTYPE_ 256 gone: frame SPEED has no such signal"),
    ("SG_MUL_VAL_ 256 gone page 0-1;", "SG_MUL_VAL_ 256 gone: frame SPEED has no such"),
    ("BO_TX_BU_ 999 : ECU,DEV;", "BO_TX_BU_ 999: there is no frame"),
    ('CM_ SG_ 256 "no signal";', 'not DBC syntax at >>!<<: CM_ >>!<<SG_ 256 "no signal";'),
    ('CM_ 145 "no kind";', "not DBC syntax"),
    ('CM_ SG_ 256 v "a "quoted" word";', "not DBC syntax"),
    ('CM_ BO_ 999 "gone";', "CM_ 999: there is no frame with this id"),
    ('BA_DEF_ BO_ "Own" BOOL False True;', "not DBC syntax"),
    ('BA_ "GenMsgCycleTime" BO_ 999 5;', "BA_ 999: there is no frame"),
    ("this is no entry", "not DBC syntax at >>!<<: >>!<<this is no entry"),
    ("BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX\n"
     ' SG_ spare : 0|8@1+ (1,0) [0|3] "" Vector__XXX\nVAL_ 3221225472 spare 0 "off" ;',
     "VECTOR__INDEPENDENT_SIG_MSG: its signals are of no frame"),
    ("BO_ 2147483648000 FAR: 8 NOBODY", "frame FAR: id 0x1f400000000 is more than 29 bits"),
    ("BO_ 300 2x-5: 8 NOBODY", "not DBC syntax at >>!<<: BO_ 300 2x>>!<<-5: 8 NOBODY"),
    ("BO_ 300 LONG: 4000 NOBODY", "frame LONG: 4000 bytes; classic CAN has 8"),
    ("BO_ 300 LONG: 4000 NOBODY\n SG_ q : 0|8", "frame LONG: 4000 bytes"),
    ('BO_ 256 TWICE: 4 NOBODY\n SG_ q : 0|8@1+ (1,0) [0|0] "" Vector__XXX', ""),
    ('BA_DEF_ BO_ "SystemMessageLongSymbol" STRING;\n'
     'BA_ "SystemMessageLongSymbol" BO_ 256 "no name";', "'no name' is no name"),
]  # fmt: skip
CHANGING = [  # the frame, which no node may use then
    (' SG_ q : 0|8@2+ (1,0) [0|0] "" DEV', ">>!<<2+ (1,0)"),
    (' SG_ q : 0|8@1+ (x,0) [0|0] "" DEV', ">>!<<x,0)"),
    (' SG_ q m1 : 0|8@1+ (1,0) [0|0] "" DEV', "OTHER: q (m1): its multiplexer is not there"),
    (' SG_ q m : 0|8@1+ (1,0) [0|0] "" DEV', "q: m is no marker of a multiplexer"),
    (' SG_ q : 0|0@1+ (1,0) [0|0] "" DEV', "q: its length 0 is not greater than 0"),
    (' SG_ q : 0|99999@1+ (1,0) [0|0] "" DEV', "q: 0|99999 lies in no frame"),
    ("SIG_VALTYPE_ 257 w : 7;", "SIG_VALTYPE_ 257 w : >>!<<7;"),
    ("SIG_VALTYPE_ 257 w : 2;", "257 w: 2 is no type of 16 bits, read by its length"),
    ("SIG_VALTYPE_ 257 w : 3;", "257 w: 3 is no type of 16 bits, read as a whole number"),
    ("SG_MUL_VAL_ 257 w page 0-1;", "frame OTHER has no multiplexer page"),
    ("BO_TX_BU_ 257 ECU;", "not DBC syntax"),
    ('BA_ "GenMsgCycleTime" BO_ 257 "soon";', 'BA_ "GenMsgCycleTime" "soon": not one of its'),
    ('BA_ "GenMsgSendType" BO_ 257 1;', "not defined as ENUM or STRING"),
    ("BO_ 257 OTHER_TOO: 8 ECU", "OTHER and OTHER_TOO (id 0x101) have the same id"),
    ("BO_ 258 OTHER: 8 DEV", "frame OTHER: another one has this name; read as OTHER_102"),
    ("BO_ 4096 WIDE: 8 DEV", "frame WIDE: id 0x1000 is more than 11 bits, and bit 31 is not"),
    ("BO_ 259 LONG: 4000 DEV", "frame LONG: 4000 bytes"),
    ('BO_ 259 LONG: 4000 NOBODY\n SG_ q : 0|8@1+ (1,0) [0|0] "" DEV', "frame LONG: 4000 bytes"),
    ("BO_ 259 2x-5: 8 DEV", "not DBC syntax"),
]
FINE = [  # as other programs write it
    "BS_: 500 : 1,28", "BS_: 1 : 2, 2", "VAL_ 256 v -1 \"a\" 1 \"b\"", "CM_ \"no end\"",
    'BS_: 500 VAL_ 256 a 1 "b";',
    "// a comment", "/* BO_ 1\n SG_ */", 'SG_MUL_VAL_ 256 a page 0 - 0 ;',
    'VAL_ 256 v 0 "a \\" quote" ;', "SIG_GROUP_ 256 g 1 : v a;", 'EV_ e: 0 [0|1] "" 0 1 D D;',
    'BA_DEF_ SG_ "SPN" STRING ;\nBA_ "SPN" SG_ 256 v "none";', "BU_:",
    'BA_DEF_ SG_ "GenSigStartValue" STRING;\nBA_ "GenSigStartValue" SG_ 256 v "x";',
    'BA_DEF_ "DBName" INT 0 1;\nBA_ "DBName" 1;', "CAT_DEF_ 1 x y;", "FILTER 0 CAT_ 1;",
    'BA_ "GenMsgCycleTime" SG_ 256 v "of a signal";',
]  # fmt: skip


def parsed(text: str) -> dbc.Database:
    return dbc.parse(Path("odd.dbc"), text)


def usable(database: dbc.Database, node: str) -> list[str]:
    return sorted({one.name for way in ("rx", "tx") for one in dbc.frames(database, node, way)})


@pytest.mark.parametrize(("entry", "said"), HARMLESS)
def test_an_entry_without_effect_is_left_out_and_listed(entry: str, said: str) -> None:
    database = parsed(HEAD + entry + "\n")
    assert [message.name for message in database.messages] == ["SPEED", "OTHER"]
    assert len(database.odd) == 1 and said in str(database.odd[0]), database.odd
    line = HEAD.count("\n") + 1 + entry.split("\n")[0].startswith('BA_DEF_ BO_ "System')
    assert str(database.odd[0]).startswith(f"line {line}:"), database.odd
    with pytest.raises(DbcError, match=f"odd.dbc:{line}"):
        dbc.parse(Path("odd.dbc"), HEAD + entry + "\n", strict=True)
    if "TWICE" not in entry:
        assert usable(database, "DEV") == ["OTHER", "SPEED"]


@pytest.mark.parametrize(("entry", "said"), CHANGING)
def test_a_frame_whose_meaning_an_odd_entry_changes_is_refused_where_it_is_used(
    entry: str, said: str
) -> None:
    begin, end = HEAD.split("BA_DEF_ BO_", 1)
    database = parsed(f"{begin}{entry}\nBO_ 300 FREE: 8 ECU\nBA_DEF_ BO_{end}")
    assert any(said in str(one) for one in database.odd), database.odd
    line = begin.count("\n") + 1 - 2 * ("its multiplexer" in said)
    with pytest.raises(DbcError, match=rf"odd.dbc:{line}\b"):
        dbc.frames(database, "DEV", "tx")
    if "ECU" not in entry:
        assert "SPEED" in [one.name for one in dbc.frames(database, "ECU", "tx")]


@pytest.mark.parametrize("number", [0x98FF00FF, 0x98FF00FF - 2**32])
def test_an_id_of_32_bits_with_a_sign_is_the_one_without(number: int) -> None:
    frame = f'BO_ {number} LATER: 8 ECU\n SG_ q : 0|8@1+ (1,0) [0|0] "" DEV\n'
    database = parsed(HEAD + frame + f'VAL_ {number} q 1 "on";\n')
    found = database.get_message_by_name("LATER")
    assert (found.frame_id, found.is_extended_frame) == (0x18FF00FF, True)
    assert database.odd == () and found.signals[0].choices == {1: "on"}
    broken = parsed(f"{HEAD}{frame}SIG_VALTYPE_ {number} q : 7;\n").odd
    assert [one.frame for one in broken] == [0x98FF00FF], broken
    with pytest.raises(DbcError, match="frame FAR: id 0x180000001 is more than 29 bits"):
        dbc.parse(Path("odd.dbc"), f"{HEAD}BO_ -2147483649 FAR: 8 DEV\n", strict=True)


@pytest.mark.parametrize("entry", FINE)
def test_what_other_programs_write_is_read(entry: str) -> None:
    database = parsed(HEAD + entry + "\nBO_ 300 LAST: 8 ECU\n")
    assert [one.name for one in database.messages] == ["SPEED", "OTHER", "LAST"]
    assert database.odd == () and set(usable(database, "DEV")) == {"OTHER", "SPEED"}


@pytest.mark.parametrize(
    ("signal", "expected"),
    [
        ('2_LEVEL : 0|8@1+ (.5,-.5) [0|0] "" ', ("2_LEVEL", 0.5, -0.5, [])),
        ('VERSION : 0|8@1+ (1.,0) [0|0] "" DEV,\n ECU', ("VERSION", 1.0, 0, ["DEV", "ECU"])),
        ('BO_ : 0|8@1+ (1,0) [0|0] "" DEV ECU', ("BO_", 1, 0, ["DEV", "ECU"])),
        ('x : 00|08@1+ (1e0,+3) [0|0] ""Vector__XXX', ("x", 1.0, 3, [])),
    ],
)
def test_names_and_numbers_as_they_are_in_the_world(signal: str, expected: object) -> None:
    database = parsed(f"BU_: ECU DEV\nBO_ 1 2ND_FRAME: 8 ECU\n SG_ {signal}\nBO_ 2 N: 8\n")
    (one,) = database.messages[0].signals
    assert (one.name, one.scale, one.offset, list(one.receivers)) == expected
    assert database.messages[0].name == "2ND_FRAME" and database.odd == ()


def test_a_name_that_is_long_is_the_name_everywhere() -> None:
    database = parsed(
        HEAD
        + 'BA_DEF_ SG_ "SystemSignalLongSymbol" STRING;\nBA_DEF_ BU_ "SystemNodeLongSymbol" STRING;'
        '\nBA_ "SystemSignalLongSymbol" SG_ 256 page "the_page";\n'
        'BA_ "SystemNodeLongSymbol" BU_ DEV "DEVICE";\nCM_ SG_ 256 page "what";\n'
    )
    (frame,) = dbc.frames(database, "DEVICE", "rx")
    assert frame.selector == "the_page" and [s.layout for s in frame.signals] == [None, None, 0]
    assert frame.signals[1].help == "what" and database.nodes == ("ECU", "DEVICE")
    assert database.messages[1].senders == ["DEVICE"] and database.odd == ()


@pytest.mark.parametrize(
    ("kind", "given", "expected"),
    [
        ('ENUM "Cyclic","Event","EveryCycle"', "2", "EveryCycle"),
        ('ENUM "Cyclic","Event","EveryCycle"', '"EveryCycle"', "EveryCycle"),
        ('ENUM "Cyclic" "Event"', "1.0", "Event"),
        ("STRING", '"Event"', "Event"),
    ],
)
def test_an_attribute_is_a_number_or_a_text_of_its_definition(
    kind: str, given: str, expected: str
) -> None:
    text = f'{HEAD}BA_DEF_ BO_ "GenMsgSendType" {kind};\nBA_ "GenMsgSendType" BO_ 256 {given};\n'
    assert parsed(text).messages[0].send_type == expected
    default = f'BA_DEF_DEF_ "GenMsgSendType" {given};\n'
    assert parsed(text + default).messages[1].send_type == expected, "also where it is the default"


@pytest.mark.parametrize(
    ("kind", "default", "fd"),
    [("INT 0 15", "", False), ("INT 0 15", "14", True), ("HEX 0 15", "14", True)],
)
def test_a_format_is_a_number_or_a_text(kind: str, default: str, fd: bool) -> None:
    text = f'{HEAD}BA_DEF_ BO_ "VFrameFormat" {kind};\n'
    text += f'BA_DEF_DEF_ "VFrameFormat" {default};\n' if default else ""
    text += 'BA_ "VFrameFormat" BO_ 256 15;\n'
    database = parsed(text)
    assert [one.is_fd for one in database.messages] == [True, fd] and database.odd == ()
    (odd,) = parsed(text.replace("256 15", "256 16")).odd
    assert "VFrameFormat" in odd.what and odd.frame == 256


def signals_of(database: dbc.Database) -> set[tuple[object, ...]]:
    return {
        (message.name, message.frame_id, message.length, one.name, one.start, one.length,
         one.is_signed, one.scale, one.multiplexer_signal, tuple(one.multiplexer_ids or ()))
        for message in database.messages for one in message.signals
    }  # fmt: skip


@pytest.mark.parametrize("seed", range(8))
def test_of_a_file_with_many_odd_entries_the_others_are_in(seed: int) -> None:
    chance = random.Random(seed)
    blocks = []
    for number in range(8):
        lines = [f"BO_ {number + 1} F{number}: 8 ECU"]
        marks = ["M", "m0", "m1", "m2", ""] if chance.random() < 0.5 else [""] * 5
        for k, mark in enumerate(marks):
            sign, scale = chance.choice("+-"), chance.choice(["1", "0.5", "-2"])
            lines.append(f' SG_ s{k} {mark} : {8 * k}|8@1{sign} ({scale},0) [0|0] "" DEV')
        blocks.append("\n".join(lines))
    good = HEAD + "\n".join(blocks) + "\n"
    listed = [(entry, said) for entry, said in HARMLESS if "Symbol" not in entry]
    odd = chance.sample([entry for entry, said in listed if "TWICE" not in entry], 6)
    places = [*blocks, *odd]
    chance.shuffle(places)
    database = parsed(HEAD + "\n".join(places) + "\n")
    expected = signals_of(parsed(good))
    reference = cantools.database.load_string(good, "dbc", strict=False)
    assert len(expected) == sum(len(one.signals) for one in reference.messages)
    assert signals_of(database) == expected and len(database.odd) == len(odd), database.odd


def test_a_file_without_any_entry_is_refused() -> None:
    with pytest.raises(DbcError, match=r"odd.dbc:1:1: not DBC syntax at >>!<<: >>!<<hello"):
        parsed("hello\nworld\n")


@pytest.mark.parametrize(("length", "is_in"), [(0, True), (1785, True), (1786, False)])
def test_a_frame_has_no_byte_or_as_many_as_the_longest_message(length: int, is_in: bool) -> None:
    database = parsed(f"{HEAD}BO_ 300 EDGE: {length} NOBODY\n")
    assert [one.name for one in database.messages[2:]] == ["EDGE"] * is_in
    assert len(database.odd) == 1 - is_in


@pytest.mark.parametrize(("value", "count"), [(2, 0), (3, 1), (-1, 1)])
def test_a_value_is_one_of_the_choices(value: int, count: int) -> None:
    text = f'{HEAD}BA_DEF_ BO_ "GenMsgSendType" ENUM "a","b","c";\n'
    assert len(parsed(f'{text}BA_ "GenMsgSendType" BO_ 256 {value};\n').odd) == count


def test_ranges_are_those_of_the_signal_of_this_name_whose_marker_is_in_them() -> None:
    signals = ' SG_ {} : {}|8@1+ (1,0) [0|0] "" DEV\n'
    text = "BU_: ECU DEV\nBO_ 1 F: 8 ECU\n" + "".join(
        signals.format(name, 8 * i) for i, name in enumerate(("p M", "s m1", "s m2", "t m1"))
    )
    ranges = "SG_MUL_VAL_ 1 s p 0-1;\nSG_MUL_VAL_ 1 s p 2-3;\nSG_MUL_VAL_ 1 t p 5-6;\n"
    found = [(one.name, one.multiplexer_ids) for one in parsed(text + ranges).messages[0].signals]
    assert found == [("p", None), ("s", [0, 1]), ("s", [2, 3]), ("t", [5, 6])]


@pytest.mark.parametrize(
    ("signals", "more", "expected", "said"),
    [
        ("n M, m M, a m0", "1 m n 0-0", "n None, m n, a n", ""),
        ("p M, r M, q m1", "", "p None, r None", "q (m1): its multiplexer is not known; give it"),
        ("p m0M, r m0M", "1 p r 0-0;SG_MUL_VAL_ 1 r p 0-0", "", "its multiplexer is not there"),
        ("p M, q m0, q", "1 q p 0-0", "p None, q p, q None", "1 q: it is always there; mark it"),
        ("p M, q m0", "1 q p 0-65535", "p None, q p", ""),
        ("p M, q m7", "1 q p 7-7", "p None, q p", ""),
        ("p M, q m7", "1 q p 0-1,7-6", "p None, q p", "1 q: a range that ends before it begins"),
        ("p M, q m0, r m0", "1 q p 0-40000;SG_MUL_VAL_ 1 r p 0-40000", "p None, q p, r p",
         "1 r: 0-40000: more than 65536 values"),
    ],
)  # fmt: skip
def test_a_signal_has_the_multiplexer_that_the_file_tells(
    signals: str, more: str, expected: str, said: str
) -> None:
    lines = [f' SG_ {one} : {8 * i}|8@1+ (1,0) [0|0] "" DEV' for i, one in
             enumerate(signals.split(", "))]  # fmt: skip
    ranges = [f"SG_MUL_VAL_ {more};"] if more else []
    database = parsed("\n".join(["BU_: ECU DEV", "BO_ 1 F: 8 ECU", *lines, *ranges, ""]))
    found = [f"{one.name} {one.multiplexer_signal}" for one in database.messages[0].signals]
    assert ", ".join(found) == expected
    assert said in str(database.odd[:1]) and bool(database.odd) == bool(said), database.odd


@pytest.mark.parametrize(
    ("number", "can_id", "extended"),
    [(2047, 0x7FF, False), (2048, 0x800, True), (2684354559, 0x1FFFFFFF, True)],
)
def test_the_highest_ids_are_ids(number: int, can_id: int, extended: bool) -> None:
    database = parsed(f"{HEAD}BO_ {number} EDGE: 8 NOBODY\n")
    edge = database.messages[2]
    assert (edge.frame_id, edge.is_extended_frame) == (can_id, extended)
    assert len(database.odd) == (number == 2048), "above 11 bits without bit 31"


def test_what_refers_to_two_signals_of_a_name_is_about_both() -> None:
    signal = ' SG_ s {} : {}|32@1- (1,0) [0|0] "" DEV\n'
    text = "BU_: ECU DEV\nBO_ 1 F: 12 ECU\n" + ' SG_ p M : 0|8@1+ (1,0) [0|0] "" DEV\n'
    text += signal.format("m0", 8) + signal.format("m1", 40) + "SIG_VALTYPE_ 1 s : 1;\n"
    assert [one.is_float for one in parsed(text).messages[0].signals] == [False, True, True]


def test_a_name_that_was_made_to_differ_is_taken() -> None:
    database = parsed(f"{HEAD}BO_ 258 OTHER: 8 DEV\nBO_ 300 OTHER_102: 8 DEV\n")
    names = [one.name for one in database.messages]
    assert names == ["SPEED", "OTHER", "OTHER_102", "OTHER_102_12C"]


def test_a_comment_of_several_lines_keeps_the_numbers_of_lines() -> None:
    (odd,) = parsed(f"{HEAD}/* 1\n 2 */ // 3\nthis is no entry\n").odd
    assert odd.place == f"{HEAD.count(chr(10)) + 3}:1"


def test_attributes_that_are_of_no_use_are_left_out() -> None:
    text = (
        HEAD + 'BA_DEF_ BO_ "VFrameFormat" STRING;\nBA_DEF_ BO_ "GenMsgSendType" FLOAT 0 1;\n'
        'BA_DEF_DEF_ "Unknown" 1;\nBO_TX_BU_ 256 : DEV,ECU;\nBO_TX_BU_ 257 : ;\n'
        'BA_ "GenMsgSendType" BO_ 256 1;\nBA_ "ProtocolType" "J1939";\n'
    )
    database = parsed(text)
    assert "GenMsgSendType" in str(database.odd) and "not defined as ENUM or" in str(database.odd)
    first, second = database.messages
    assert database.j1939
    assert not first.is_fd and first.send_type != "EveryCycle"
    assert (first.senders, second.senders) == (["ECU", "DEV"], ["DEV"])


def test_of_two_multiplexers_of_one_name_each_has_its_signals() -> None:
    text = "BU_: ECU DEV\nBO_ 1 F: 8 ECU\n" + "".join(
        f' SG_ {name} : {8 * i}|8@1+ (1,0) [0|0] "" DEV\n'
        for i, name in enumerate(("p M", "q m0M", "q m1M", "s m5"))
    )
    ranges = "SG_MUL_VAL_ 1 q p 0-0;\nSG_MUL_VAL_ 1 q p 1-1;\n"
    database = parsed(text + ranges)
    found = [(one.name, one.multiplexer_signal) for one in database.messages[0].signals]
    assert found == [("p", None), ("q_8", "p"), ("q_16", "p"), ("s", "p")]
    assert "frame F: q: another signal has this name; read as q_16" in str(database.odd)


def test_a_signal_without_a_frame_is_listed() -> None:
    (odd,) = parsed('BU_: ECU DEV\n SG_ lost : 0|8@1+ (1,0) [0|0] "" DEV\nBO_ 1 F: 8 ECU\n').odd
    assert "SG_ lost: a signal of no frame; put it behind its BO_" in str(odd)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (StalledError(), "cantools does not come to an end with it; simplify it"),
        (KeyError("x\n"), "cantools: KeyError 'x.n'; correct the DBC file"),
    ],
)
def test_what_cantools_cannot_do_is_told(
    error: Exception, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(content: str) -> None:
        raise error

    monkeypatch.setattr(dbc_file, "cantools_database", fail)
    with pytest.raises(DbcError, match=f"^odd.dbc: {said}$"):
        parsed(HEAD)


def test_a_signal_has_its_line_whatever_the_texts_before_it_hold(tmp_path: Path) -> None:
    path = tmp_path / "a.dbc"
    path.write_text('CM_ "BO_ 257 OTHER: 8 DEV\n SG_ w : \n";\n' + HEAD)
    for frame, signal, line in (("SPEED", "v", 11), ("OTHER", "w", 15), ("SPEED", "w", 0)):
        assert dbc.place(path, frame, signal) == str(path) + (f":{line}" if line else "")
    assert dbc.load(path).get_message_by_name("OTHER").frame_id == 257


def test_a_frame_of_can_fd_has_a_length_that_can_fd_has() -> None:
    fd = 'BA_DEF_ BO_ "VFrameFormat" INT 0 15;\nBA_ "VFrameFormat" BO_ 300 14;\n'
    database = parsed(f"{HEAD}BO_ 300 LONG: 10 ECU\n{fd}")
    with pytest.raises(DbcError, match="frame LONG: 10 bytes; CAN FD has 12; say so, the rest is"):
        dbc.frames(database, "ECU", "tx")


def test_the_load_is_that_of_all_frames_or_of_those_named() -> None:
    fd = 'BA_DEF_ BO_ "VFrameFormat" INT 0 15;\nBA_ "VFrameFormat" BO_ 257 14;\n'
    classic, mixed = parsed(HEAD), parsed(HEAD + fd)
    one = 135 * 100 / 1e6  # bits of 8 bytes, 100 times a second
    assert dbc.bus_load(classic, 1000.0, 1e6) == pytest.approx(2 * one)
    assert dbc.bus_load(mixed, 1000.0, 1e6, ["SPEED"]) == pytest.approx(one)
    with pytest.raises(DbcError, match="frame OTHER: CAN FD with a bit rate switch; give the rig"):
        dbc.bus_load(mixed, 1000.0, 1e6)
    nominal, data = dbc.frame(mixed.messages[1]).bits()
    assert (nominal, data) == dbc.frame(classic.messages[1]).bits(all_fd=True)
    load = dbc.bus_load(mixed, 1000.0, 1e6, ["OTHER"], 5e6)
    assert load == pytest.approx((nominal + data / 5) * 100 / 1e6)


def test_a_signal_holds_what_its_codes_are() -> None:
    v, *_ = dbc.frame(parsed(HEAD).messages[0]).signals
    assert v.range == (0.0, 655.35) and dbc.frame(parsed(HEAD).messages[1]).signals[0].range == (
        -32768.0, 32767.0
    )  # fmt: skip
