"""An EDS or DCF is read: what is ours, what is kept, what does not exist, what is wrong."""

from pathlib import Path

import pytest
from drives import NODE, Bench

from pcpc.drivers.canopen import eds, eds_file, layout, objects
from pcpc.drivers.canopen.layout import MODES, ObjectType, Od
from pcpc.executive.errors import RigError
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main

HERE = Path(__file__).parent
EVERY = objects.objects(NODE, "bench")
VAR = "ParameterName=x\nObjectType=0x7\nDataType=0x{:04X}\nAccessType={}\nDefaultValue={}\n"
FILE = f"""[FileInfo]
; a comment
[DeviceComissioning]
NodeID=0x05
[1018sub1]
{VAR.format(7, "ro", "0x1234")}
[1003]
ObjectType=0x8
CompactSubObj=10
DataType=0x0007
AccessType=ro
[1017]
{VAR.format(6, "rw", "0")}
ParameterValue=250
[605B]
{VAR.format(3, "rw", "7")}
[6085]
{VAR.format(7, "rw", "010")}
LowLimit=1
HighLimit=0x1000
[60B0]
{VAR.format(4, "rw", "0xFFFFFFFE")}
[60B2]
{VAR.format(3, "rw", "0xFFFE")}
[6502]
{VAR.format(7, "ro", "0x0000003F")}
[1402sub1]
{VAR.format(7, "rw", "$NODEID+0x400")}
[1A01sub0]
{VAR.format(5, "rw", "2")}
[1A01sub2]
{VAR.format(7, "rw", "0x60B90010")}
[60B9]
{VAR.format(6, "ro", "0")}
[2001]
{VAR.format(4, "rw", "-7")}
PDOMapping=1
[2002]
ObjectType=0x8
CompactSubObj=3
DataType=0x0006
AccessType=const
DefaultValue=9
[2003]
{VAR.format(8, "rw", "1.5")}
[2004]
{VAR.format(15, "rw", "")}
"""


@pytest.fixture
def read(tmp_path: Path) -> eds_file.EdsContent:
    (tmp_path / "real.dcf").write_text(FILE)
    return eds_file.read(tmp_path / "real.dcf", EVERY, NODE)


def bench_of(every: list[objects.Object]) -> Bench:
    bench = Bench()
    bench.d.value[:] = 0
    objects.install(bench.d, NODE, every)
    bench.d.state.boots = 0
    return bench.cycles(1)


def test_what_the_drive_writes_it_reads_back(tmp_path: Path) -> None:
    (tmp_path / "own.eds").write_text(eds.text(EVERY))
    found = eds_file.read(tmp_path / "own.eds", EVERY, NODE)
    assert found.left_out == []
    bounds = [(one.key, one.start, one.bounds, one.text, one.access) for one in found.every]
    assert bounds == [(one.key, one.start, one.bounds, one.text, one.access) for one in EVERY]


def test_objects_of_ours_begin_with_its_values_within_its_bounds(read: eds_file.EdsContent) -> None:
    of = {one.key: one for one in read.every}
    assert (of["1017"].start, of["1018.1"].start) == (250, 0x1234)
    assert (of["6085"].start, of["6085"].bounds) == (8, (1, 0x1000))
    assert (of["60B2"].start, of["1402.1"].start) == (-2, 0x405)
    assert of["6502"].start == 0x3F & MODES
    assert of["605B"].start == EVERY[Od.SHUTDOWN_OPTION].start


def test_what_the_drive_does_not_have_is_told(read: eds_file.EdsContent) -> None:
    told = [*(f"1003.{i}" for i in range(5, 11)), "2004", "605B=7", "60B0", "60B9", "1A01"]
    assert sorted(read.left_out) == sorted(told)
    row = layout.FIRST_TPDO + layout.TPDO_ROWS + layout.COB_ID
    assert read.every[row].start >> 31 == 1, "a PDO that maps what is not there is not valid"


def test_a_manufacturers_objects_are_kept_without_an_effect(read: eds_file.EdsContent) -> None:
    bench = bench_of(read.every)
    assert bench.read(0x2001) == 0xFFFF_FFF9 and bench.write(0x2001, 0, 70_000, 4) == 0
    assert bench.read(0x2001) == 70_000
    assert [bench.read(0x2002, i) for i in range(5)] == [3, 9, 9, 9, -0x0609_0011]
    assert bench.write(0x2002, 1, 1, 2) == 0x0601_0002
    assert bench.read(0x60B9) == bench.read(0x2004) == -0x0602_0000
    bench.write(0x1600, 1, 0, 4)
    for index, subindex, value, size in (
        (0x1A02, 0, 0, 1),
        (0x1A02, 1, 0x2001_0020, 4),
        (0x1A02, 0, 1, 1),
    ):
        assert bench.write(index, subindex, value, size) == 0, "it can be mapped"


def test_a_reset_brings_back_the_files_values(read: eds_file.EdsContent) -> None:
    bench = bench_of(read.every)
    assert bench.write(0x1017, 0, 9, 2) == bench.write(0x2001, 0, 9, 4) == 0
    bench.send(0, bytes([129, NODE]))
    assert (bench.read(0x1017), bench.read(0x2001)) == (250, 0xFFFF_FFF9)


def test_its_own_eds_then_has_the_manufacturers_objects(
    read: eds_file.EdsContent, tmp_path: Path
) -> None:
    (tmp_path / "drive.eds").write_text(eds.text(read.every))
    import canopen  # python-can reads MF4 with pandas: 0.4 s, for each worker at the top

    theirs = canopen.import_od(str(tmp_path / "drive.eds"), NODE)
    assert theirs[0x2001].default == -7 and theirs[0x2002][2].default == 9
    assert theirs[0x1017].default == 250 and 0x60B9 not in theirs


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "has no object"),
        (b"\0\xff" * 4000, "has no object, line 1 (no [section] before it); give an EDS"),
        (b"1017=3", "has no object, line 1 (no [section] before it)"),
        (FILE.replace("NodeID=0x05", "NodeID=7").encode(), "NodeID 7, the rig's node is 5"),
        (b"[DeviceCommissioning]\nNodeID=1\n[2000]\nDataType=6", "NodeID 1, the rig's node is 5"),
    ],
)  # fmt: skip
def test_what_is_no_such_file_is_refused(content: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "real.eds").write_bytes(content)
    drive = {"plant.drive.eds": str(tmp_path / "real.eds")}
    with pytest.raises(RigError) as error:
        plan(
            load_rig(HERE / "mastered.yaml", settings=[f"{k}={v}" for k, v in drive.items()]),
            "plant",
            "real",
        )
    text = str(error.value)
    assert said in text and "real.eds" in text and text.count("\n") == 0


def content_of(folder: Path, text: str | bytes) -> eds_file.EdsContent:
    (folder / "odd.eds").write_bytes(text.encode("latin-1") if isinstance(text, str) else text)
    return eds_file.read(folder / "odd.eds", EVERY, NODE)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("[2040]\nDataType=6\nDefaultValue=08", "2040 (expected a number, got '08')"),
        ("[2040]\nDataType=7\nDefaultValue=0.0", "2040 (expected a number, got '0.0')"),
        ("[2040]\nDataType=7\nDefaultValue=1_0", "2040 (expected a number, got '1_0')"),
        ("[2040]\nDataType=7\nDefaultValue=ten", "2040 (expected a number, got 'ten')"),
        ("[2040]\nDataType=7\nDefaultValue=0x1FFFFFFFF", "2040 (8589934591 does not fit into 32"),
        ("[2040]\nDataType=8\nDefaultValue=1,5", "2040 (expected a number, got '1,5')"),
        ("[2040]\nDataType=8\nDefaultValue=1e99", "2040 (1e99 does not fit into a REAL32)"),
        ("[2040]\nDataType=8\nDefaultValue=nan", "2040 (expected a number, got 'nan')"),
        ("[2040]\nObjectType=2\nAccessType=wo", "2040 (no DataType)"),
        ("[0x2040]\nDataType=6", "[0X2040] (no index of an object"),
        ("[2040sub100]\nDataType=6", "[2040SUB100] (no index of an object"),
        ("[2040]\nDataType=x", "2040 (expected a number, got 'x')"),
        ("[2040]\nDataType=6\nAccessType=any", "2040 (AccessType any)"),
        ("[2040]\nDataType=6\nPDOMapping=yes", "2040 (expected a number, got 'yes')"),
        ("[2040]\nObjectType=VAR\nDataType=6", "2040 (expected a number, got 'VAR')"),
        ("[2040]\nDataType=0x0011", "2040"),
        ("[2040sub1]\nDataType=6\nDefaultValue=-1", "2040.1 (-1 does not fit into 16 bits)"),
        ("[2040]\nDataType=6\nDefaultValue=9\nLowLimit=1\nHighLimit=5", "2040 (limits without 9"),
        ("[606D]\nDataType=7\nDefaultValue=100",
         "606D (Velocity window: DataType 0x0007, the drive has 0x0006)"),
        ("[1017]\nDataType=6\nDefaultValue=2x0", "1017 (expected a number, got '2x0')"),
        ("[1017]\nDataType=0x0008\nDefaultValue=0.5", "1017 (Heartbeat ms: DataType 0x0008, the"),
        ("[6065]\nDataType=8\nDefaultValue=0.5", "6065 (Following window: DataType 0x0008"),
        ("[1000]\nDataType=7\nDefaultValue=0x00040192", "1000=0x00040192"),
        ("[605A]\nDataType=3\nDefaultValue=3", "605A=3"),
        ("[6098]\nDataType=2\nDefaultValue=36", "6098=36"),
        ("[1008]\nDataType=9\nDefaultValue=" + 33 * "x", "1008 (not 32 characters of ASCII)"),
        ("[DeviceComissioning]\nNodeID=five", "NodeID (expected a number, got 'five')"),
        ("[DeviceComissioning]\nNodeID=0xff", "[DeviceComissioning] NodeID 0xff"),
        ("[2040Value]\n1=5", "[2040VALUE] (no compact [2040])"),
        ("[2040]\nDataType=6\nCompactSubObj=2\n[2040Value]\n3=5", "[2040Value] 3"),
        ("[2040]\nDataType=6\nCompactSubObj=2\n[2040Value]\n2=x", "2040.2 (expected a number"),
        ("[2040]\nDataType=6\nCompactSubObj=many", "2040 (expected a number, got 'many')"),
        ("[2040]\nDataType=6\nDataType=7", "line 7 (DataType again)"),
        ("[3000]\nDataType=6", "line 5 ([3000] again)"),
        ("[2040]\nDataType=6\nnothing", "line 7 (no key=value)"),
        ("[3000sub0]\nDataType=6\nDefaultValue=1", "3000 (again)"),
        ("[1017]\nDataType=6\n[1017sub0]\nDataType=6\nDefaultValue=9", "1017 (again)"),
    ],
)  # fmt: skip
def test_one_odd_entry_is_left_out_and_listed(entry: str, said: str, tmp_path: Path) -> None:
    good = "[3000]\nDataType=6\nDefaultValue=42\n; end\n"
    found = content_of(tmp_path, good + entry + "\n[3001]\nDataType=7\nDefaultValue=43\n")
    assert len(found.left_out) == 1 and said in found.left_out[0], found.left_out
    of = {one.key: one.start for one in found.every}
    assert (of["3000"], of["3001"]) == (42, 43)
    ours = {one.key: one for one in EVERY}
    assert all(one.start == ours[one.key].start for one in found.every if one.key in ours)


@pytest.mark.parametrize(
    ("text", "index", "subindex", "expected"),
    [
        ("[2000]\nDataType=8\nDefaultValue=0.5", 0x2000, 0, 0x3F000000),
        ("[2000]\nDataType=8\nDefaultValue=0x3F000000", 0x2000, 0, 0x3F000000),
        ("[2000]\nDataType=8\nDefaultValue=-.25e1", 0x2000, 0, 0xC0200000),
        ("[2000]\nDataType=8\nDefaultValue=0x7F800000", 0x2000, 0, 0x7F800000),
        ("[2000]\nDataType=8\nDefaultValue=1", 0x2000, 0, 0x3F800000),
        ("[2000]\nDataType=8\nDefaultValue=", 0x2000, 0, 0),
        ("[2000]\nDataType=1\nDefaultValue=1", 0x2000, 0, 1),
        ("[2000]\nDataType=6\nAccessType=wo\nDefaultValue=1", 0x2000, 0, -0x0601_0001),
        ("  [2000]\n  ObjectType=7\n\tDataType=0x0006\n DefaultValue=42", 0x2000, 0, 42),
        ("[2000]\nDataType=0X0006\nDefaultValue=$NodeID+0x10", 0x2000, 0, 0x15),
        ("[2000]\nDataType=6\nDefaultValue=0x10 + $NODEID ; a comment", 0x2000, 0, 0x15),
        ("[2000]\nObjectType=7 # VAR\nDataType=6 # U16\nAccessType=rw # r", 0x2000, 0, 0),
        ("[2000]\nDataType=6\nDefaultValue=$NODEID", 0x2000, 0, 5),
        ("[2000]\nDataType=3\nDefaultValue=0xFFFE\nLowLimit=0x8000\nHighLimit=0x7FFF", 0x2000, 0,
         0xFFFE),
        ("[2000]\nDataType=3\nDefaultValue=0x8000", 0x2000, 0, 0x8000),
        ("[2000]\nDataType=6\nDefaultValue=1\nParameterValue=2", 0x2000, 0, 2),
        ("[2020]\nObjectType=8\nDataType=6\nDefaultValue=7\nCompactSubObj=2\n"
         "[2020sub2]\nDataType=6\nDefaultValue=9", 0x2020, 2, 9),
        *(("[2020]\nObjectType=8\nDataType=6\nDefaultValue=7\nCompactSubObj=3\n"
           "[2020Value]\nNrOfEntries=2\n1=100\n3=300", 0x2020, i, value)
          for i, value in enumerate((3, 100, 7, 300))),
    ],
)  # fmt: skip
def test_a_master_reads_what_the_file_says(
    text: str, index: int, subindex: int, expected: int, tmp_path: Path
) -> None:
    found = content_of(tmp_path, text)
    bench = bench_of(found.every)
    assert (bench.read(index, subindex), found.left_out) == (expected, [])
    (tmp_path / "own.eds").write_text(eds.text(found.every))
    again = eds_file.read(tmp_path / "own.eds", EVERY, NODE)
    ends = [[(one.key, one.kind, one.start, one.access, one.bounds) for one in every]
            for every in (found.every, again.every)]  # fmt: skip
    assert ends[0] == ends[1] and again.left_out == [], "the EDS that it writes says the same"


@pytest.mark.parametrize("coding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_names_are_read_in_the_encodings_of_the_world(coding: str, tmp_path: Path) -> None:
    text = "[2000]\r\nParameterName=Pr\u00fcfwert\r\nDataType=6\r\nDefaultValue=3\r\n"
    found = content_of(tmp_path, text.encode(coding))
    assert [(one.name, one.start) for one in found.every if one.index == 0x2000] == [
        ("Pr\u00fcfwert", 3)
    ]


@pytest.mark.parametrize(
    ("access", "mapping", "readable", "writable", "sent", "taken"),
    [
        ("rw", "0x1", True, True, True, True), ("rwr", "01", True, True, True, False),
        ("rww", "1", True, True, False, True), ("ro", "1", True, False, True, False),
        ("const", "1", True, False, True, False), ("wo", "1", False, True, False, True),
        ("RW", "0x0", True, True, False, False), ("", "", True, True, False, False),
    ],
)  # fmt: skip
def test_rights_and_mapping_are_those_of_the_file(
    access: str, mapping: str, readable: bool, writable: bool, sent: bool, taken: bool,
    tmp_path: Path,
) -> None:  # fmt: skip
    text = f"[2000]\nDataType=6\nDefaultValue=7\nAccessType={access}\nPDOMapping={mapping}\n"
    bench = bench_of(content_of(tmp_path, text).every)
    assert bench.read(0x2000) == (7 if readable else -0x0601_0001)
    assert bench.write(0x2000, 0, 8, 2) == (0 if writable else 0x0601_0002)
    for index, may in ((0x1A02, sent), (0x1602, taken)):
        assert bench.write(index, 0, 0, 1) == 0
        assert bench.write(index, 1, 0x2000_0010, 4) == (0 if may else 0x0604_0041), hex(index)


@pytest.mark.parametrize(
    ("low", "high", "bounds"),
    [("5", "0x9", (5, 9)), ("-5", "0x1FFFF", (0, 0xFFFF)), ("0", "0", (0, 0xFFFF)),
     ("5", "", (0, 0xFFFF)), ("", "9", (0, 0xFFFF)), ("9", "5", (0, 0xFFFF))],
)  # fmt: skip
def test_a_manufacturers_object_has_the_files_limits(
    low: str, high: str, bounds: tuple[int, int], tmp_path: Path
) -> None:
    text = f"[2000]\nDataType=6\nDefaultValue=7\nLowLimit={low}\nHighLimit={high}\n"
    found = content_of(tmp_path, text)
    assert found.left_out == [] and found.every[-1].bounds == bounds
    bench = bench_of(found.every)
    answers = [bench.write(0x2000, 0, value, 2) for value in (4, 5, 9, 10)]
    assert answers == ([0x0609_0032, 0, 0, 0x0609_0031] if bounds == (5, 9) else [0, 0, 0, 0])


@pytest.mark.parametrize(
    ("pdo", "mapped", "valid"),
    [
        (0x1402, [0x2000_0020, 0x2001_0020], True), (0x1802, [0x2002_0020], True),
        (0x1402, [0x2000_0020, 0x2001_0020, 0x2003_0008], False), (0x1402, [0x2000_0010], False),
        (0x1402, [0x2002_0020], False), (0x1802, [0x2000_0020], False),
        (0x1802, [0x2FFF_0020], False),
    ],
)  # fmt: skip
def test_a_pdo_is_valid_if_the_drive_can_send_or_take_all_of_it(
    pdo: int, mapped: list[int], valid: bool, tmp_path: Path
) -> None:
    own = "[{:04X}]\nDataType={}\nAccessType={}\nPDOMapping=1\n"
    kinds = ((0x2000, 7, "rww"), (0x2001, 7, "rww"), (0x2002, 7, "rwr"), (0x2003, 5, "rww"))
    text = "".join(own.format(*one) for one in kinds)
    text += f"[{pdo:04X}sub1]\nDataType=7\nDefaultValue=0x405\n"
    for i, value in enumerate([len(mapped), *mapped]):
        kind = 7 if i else 5
        text += f"[{pdo + 0x200:04X}sub{i}]\nDataType={kind}\nDefaultValue={value}\n"
    found = content_of(tmp_path, text)
    of = {one.key: one.start for one in found.every}
    assert found.left_out == [f"{pdo + 0x200:04X}"] * (not valid)
    assert of[f"{pdo:04X}.1"] == 0x405 | objects.NOT_VALID * (not valid)
    assert of[f"{pdo + 0x200:04X}"] == len(mapped) * valid


def test_a_name_of_the_drive_has_all_its_letters(tmp_path: Path) -> None:
    found = content_of(tmp_path, f"[1008]\nDataType=9\nDefaultValue={32 * 'x'}\n")
    assert found.left_out == [] and found.every[Od.DEVICE_NAME].text == 32 * "x"


def test_more_objects_than_the_drive_holds_are_listed(tmp_path: Path) -> None:
    text = "".join(f"[{i:04X}]\nDataType=7\nDefaultValue=1\n" for i in range(0x2000, 0x2500))
    found = content_of(tmp_path, text)
    assert len(found.every) == layout.MAX_OBJECTS
    assert len(found.left_out) == len(EVERY) + 0x500 - layout.MAX_OBJECTS
    assert found.left_out[-1] == "24FF (more than 1024 objects)"


def test_no_file_is_wrong_input(tmp_path: Path) -> None:
    with pytest.raises(RigError, match="no such file: absent"):
        plan(
            load_rig(HERE / "mastered.yaml", settings=["plant.drive.eds=absent.eds"]),
            "plant",
            "real",
        )


def test_a_log_carries_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "real.eds"
    file.write_text(FILE)
    rig = load_rig(HERE / "mastered.yaml", settings=[f"plant.drive.eds={file}"])
    simulate(rig, tmp_path / "log.mcap")
    file.unlink()
    assert main(["replay", str(tmp_path / "log.mcap")]) == 0
    assert capsys.readouterr().out.count("bit-identical") == 2


def test_kinds_that_are_no_whole_numbers_are_named() -> None:
    assert {kind.name for kind in ObjectType} - {kind.name for kind in objects.BITS} == {"TEXT"}


def test_a_head_without_a_type_hides_no_object(tmp_path: Path) -> None:
    found = content_of(tmp_path, "[2040]\nSubNumber=1\n[2040sub0]\nDataType=5\nDefaultValue=1")
    assert found.left_out == ["2040 (no DataType)"]
    assert {one.key: one.start for one in found.every}["2040"] == 1


@pytest.mark.parametrize(("count", "listed"), [(254, []), (256, ["2020.255 to 256"])])
def test_an_array_has_at_most_254_values(count: int, listed: list[str], tmp_path: Path) -> None:
    text = f"[2020]\nObjectType=8\nDataType=5\nCompactSubObj={count}\n"
    found = content_of(tmp_path, text)
    own = [one.subindex for one in found.every if one.index == 0x2020]
    assert found.left_out == listed and own == [*range(255)]
