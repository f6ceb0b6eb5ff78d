"""DBC files as they are in the world, given to the commands: read, or refused with exit code 2."""

import shutil
from pathlib import Path

import pytest
from processes import ROOT, own_bus, pcpc

from pcpc.executive.log import reader as logs
from pcpc.tools.cli import main

FOREIGN = """
BO_ 2566834709 DM1: 100 OTHER
 SG_ lamps : 0|16@1+ (1,0) [0|65535] "" Vector__XXX

BO_ 291 GEAR: 8 OTHER
 SG_ page M : 0|8@1+ (1,0) [0|0] "" Vector__XXX
 SG_ oil m0 : 8|16@1- (0.1,-40) [-40|215] "\u00b0C" Vector__XXX
 SG_ water m1 : 8|16@1- (0.1,-40) [-40|215] "\u00b0C" Vector__XXX

BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX
 SG_ spare : 0|8@1+ (0,0) [0|0] "" Vector__XXX

CM_ BO_ 291 "Getriebe\u00f6l, 5 \u00b5s";
"""
Screen = pytest.CaptureFixture[str]


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """Return a probe of its own whose DBC is of cp1252 and knows frames of others."""
    folder = tmp_path / "probe"
    shutil.copytree(ROOT / "plants" / "probe", folder)
    dbc = (folder / "probe.dbc").read_text().replace("BU_: EXEC", "BU_: OTHER EXEC")
    dbc = dbc.replace('\nCM_ "Probe', FOREIGN + '\nCM_ "Probe')
    (folder / "probe.dbc").write_bytes(dbc.encode("cp1252"))
    return folder / "rig.yaml"


def test_a_file_of_vectors_encoding_with_foreign_frames_runs_and_replays(
    rig: Path, tmp_path: Path, capsys: Screen
) -> None:
    checked, said = main(["check", str(rig)]), capsys.readouterr()  # it may tell that it compiles
    assert checked == 0, said
    words = ["--set", "duration_s=0.2", "--no-figure", "--quiet", "-o", str(tmp_path / "run")]
    code = main(["simulate", str(rig), *words])
    said = capsys.readouterr()
    assert (code, said.err) == (0, ""), said
    text = logs.read(tmp_path / "run" / "log.mcap").attachments["probe.dbc"]
    assert "\u00b0C" in text and "Getriebe\u00f6l" in text
    assert main(["replay", str(tmp_path / "run" / "log.mcap"), "--quiet"]) == 0, capsys.readouterr()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("CMD: 8 EXEC", "CMD: 1000000000 EXEC", "frame CMD: 1000000000 bytes"),
        ("CMD: 8 EXEC", "CMD: 64 EXEC", "frame CMD: 64 bytes"),
        ("command : 0|32@1- (1e-06,0)", "command : 0|32@1- (0,0)", "frame CMD: command: factor 0"),
        ("command : 0|32@1-", "command : 40|32@1-", "frame CMD: command: bits 40|32 do not lie"),
        ('[-2147.483648|2147.483647] "" PLANT', '[9|-9] "" PLANT', "frame CMD: command: no raw"),
        ('mode : 44|4@1+ (1,0) [0|15] "" PLANT\n SG_ counter :',
         'mode M : 44|4@1+ (1,0) [0|15] "" PLANT\n SG_ counter m0 :',
         "frame CMD: counter: only in one layout"),
        ("BU_: OTHER EXEC PLANT", "", "node EXEC: not in the DBC file; it has none"),
        ("BO_ 291 GEAR", "BO_ 288 GEAR", "have the same id"),
        ("VERSION", "FormatVersion=6.0 //", "SYM, not DBC"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_wrong_input_in_one_line(
    old: str, new: str, said: str, rig: Path, capsys: Screen
) -> None:
    path = rig.with_name("probe.dbc")
    content = path.read_bytes().decode("cp1252")
    assert old in content
    path.write_bytes(content.replace(old, new, 1).encode("cp1252"))
    words = {"check": [], "simulate": ["--quiet", "-o", str(rig.parent / "out")]}
    for command in words:
        assert main([command, str(rig), *words[command]]) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and str(path) in err and said in err, err


def test_a_run_with_a_wrong_file_ends_as_wrong_input(rig: Path) -> None:
    path = rig.with_name("probe.dbc")
    path.write_bytes(path.read_bytes().replace(b"CMD: 8", b"CMD: 1000000000"))
    done = pcpc("run", str(rig), "--bus", own_bus(), "--quiet", "-o", str(rig.parent / "out"))
    assert done.code == 2 and "frame CMD: 1000000000 bytes" in done.err, done
    assert "Traceback" not in done.err and done.err.count(str(path)) <= 2, done
