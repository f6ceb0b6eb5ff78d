"""An EDS or DCF is read: what is ours, what is kept, what does not exist, what is wrong."""

from pathlib import Path

import canopen
import pytest
from drives import NODE, Bench

from pcpc.drivers.canopen import eds, eds_file, layout, objects
from pcpc.drivers.canopen.layout import Row
from pcpc.drivers.canopen.objects import Kind
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
    assert of["6502"].start == 0x3F & objects.MODES
    assert of["605B"].start == EVERY[Row.SHUTDOWN_OPTION].start


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
    theirs = canopen.import_od(str(tmp_path / "drive.eds"), NODE)
    assert theirs[0x2001].default == -7 and theirs[0x2002][2].default == 9
    assert theirs[0x1017].default == 250 and 0x60B9 not in theirs


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "has no object"),
        (b"\0\xff" * 4000, "line 1: no [section]; give an EDS"),
        (b"1017=3", "line 1: no [section]"),
        (b"[1017]\nnothing", "line 2: expected key=value"),
        (FILE.replace("NodeID=0x05", "NodeID=7").encode(), "NodeID 7, the rig's node is 5"),
        (FILE.replace("DataType=0x0006", "DataType=0x0007", 1).encode(),
         "[1017]: Heartbeat ms: DataType 0x0007, the drive has 0x0006"),
        (FILE.replace("=250", "=2x0").encode(), "[1017]: expected a number, got '2x0'"),
        (FILE.replace("DefaultValue=-7", "DefaultValue=0x1FFFFFFFF").encode(),
         "[2001]: 8589934591 does not fit into 32 bits"),
        ("".join(f"[{i:04X}]\n{VAR.format(7, 'rw', '1')}" for i in range(0x2000, 0x2500)).encode(),
         f"1457 objects; the drive holds {layout.MAX_OBJECTS}"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_named_with_its_section(content: bytes, said: str, tmp_path: Path) -> None:
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
    assert {kind.name for kind in Kind} - {kind.name for kind in objects.BITS} == {"TEXT"}
