"""A package of somebody else adds a command, a system, a dialect and a bus; a broken one is named.

The example acme/ becomes a wheel, is installed in a folder of its own and used by real processes.
"""

import json
import os
import re
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from free_bus import own_port
from places import ROOT
from processes import DEADLINE_S, until

from pcpc.drivers.errors import UserError
from pcpc.drivers.machine import outside
from pcpc.tools import cli
from pcpc.tools.make import new
from pcpc.tools.terminal import additions

ACME = Path(__file__).with_name("acme")
LISTED = ["command spin", "system acme", "drive acme-torque", "bus acme"]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder in which the wheel of the example is installed."""
    folder = tmp_path_factory.mktemp("outside")
    source = folder / "source"
    shutil.copytree(ACME, source, ignore=shutil.ignore_patterns("__pycache__"))
    new.write(source / "pcpc_acme/lag", template=new.BARE)
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    wheel = [*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", str(folder), str(source)]
    subprocess.run(wheel, check=True, capture_output=True)
    (made,) = folder.glob("*.whl")
    install = [*pip, "install", "--no-deps", "--target", str(folder / "site"), str(made)]
    subprocess.run(install, check=True, capture_output=True)
    return folder / "site"


def started(site: Path | None, *words: str, cwd: Path) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "pcpc.tools.cli", *words],
        cwd=cwd,
        env=os.environ
        | {"PYTHONPATH": os.pathsep.join(map(str, [ROOT, *([site] if site else [])]))},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def pcpc(site: Path | None, *words: str, cwd: Path, code: int = 0) -> str:
    """Run a command in a process of its own, beside what is installed there; return its words."""
    process = started(site, *words, cwd=cwd)
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == code, f"{words}: {process.returncode}\n{out}{err}"
    return out if code == 0 else err


def test_help_and_doctor_name_what_is_added_and_its_version(site: Path, tmp_path: Path) -> None:
    for words in (["--help"], ["help", "all"]):
        told = pcpc(site, *words, cwd=tmp_path).partition("of other packages:\n")[2]
        rows = [re.split(r"\s{2,}", line.strip()) for line in told.splitlines()[:4]]
        assert rows == [[name, "pcpc-acme 0.1.0"] for name in LISTED]
        assert "other packages" not in pcpc(None, *words, cwd=tmp_path)
    facts = json.loads(pcpc(site, "doctor", "--json", cwd=tmp_path))["rows"]
    added = {fact["name"]: (fact["state"], fact["found"]) for fact in facts}
    assert [added.get(name) for name in LISTED] == [("ok", "pcpc-acme 0.1.0")] * 4


def test_its_command_is_one_of_pcpc(site: Path, tmp_path: Path) -> None:
    assert pcpc(site, "spin", "3", "--backwards", cwd=tmp_path) == "-1080 deg\n"
    assert "the other way" in pcpc(site, "spin", "--help", cwd=tmp_path)
    said = pcpc(site, "spin", "3", "--backward", "--fast", cwd=tmp_path, code=2)
    assert said.startswith("pcpc spin: no option --fast") and said.count("\n") == 1
    assert "no such command" in pcpc(None, "spin", "3", cwd=tmp_path, code=2)


def test_its_system_runs_in_virtual_time_and_on_its_bus_with_equal_bits(
    site: Path, tmp_path: Path
) -> None:
    assert pcpc(site, "rigs", "acme", cwd=tmp_path).startswith("acme: 1000 Hz; controllers p\n")
    kept = "--judge", "--no-figure", "--quiet"
    pcpc(site, "simulate", "acme", "-o", "virtual", *kept, cwd=tmp_path)
    bus = f"acme:{own_port()}"
    pcpc(site, "run", "acme/lag", "--bus", bus, "--pacing", "lockstep", "-o", "bus", *kept,
         cwd=tmp_path)  # fmt: skip
    assert "equal to the bit" in pcpc(site, "compare", "virtual", "bus", cwd=tmp_path)
    for run in ("virtual", "bus"):
        assert pcpc(site, "replay", run, cwd=tmp_path).count("bit-identical") == 2
    assert "acme of pcpc-acme 0.1.0 cannot open it: ValueError" in pcpc(
        site, "run", "acme", "--bus", "acme:x", "--pacing", "lockstep", cwd=tmp_path, code=4
    )


def test_what_the_log_of_a_system_needs_travels_in_it(site: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "site"
    shutil.copytree(site, elsewhere)
    model = elsewhere / "pcpc_acme/lag/model.py"
    table = 'from pathlib import Path\n\nTEXT = Path(__file__).with_name("t.txt").read_text()\n'
    model.write_text(model.read_text().replace("\nfrom ", f"\n{table}from ", 1))
    model.with_name("t.txt").write_text("1.0")
    pcpc(elsewhere, "simulate", "acme", "-o", "run", "--no-figure", "--quiet", cwd=tmp_path)
    shutil.rmtree(elsewhere)
    said = pcpc(None, "replay", "run", cwd=tmp_path, code=2)
    assert "t.txt" in said and "came with pcpc-acme 0.1.0" in said, said
    told = pcpc(None, "replay", "run", "--trust", cwd=tmp_path)
    assert told.count("bit-identical") == 2, told


def test_a_master_reaches_its_drive_over_its_bus(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pcpc(site, "new", "motor", "--drive", "acme-torque", cwd=tmp_path)
    monkeypatch.syspath_prepend(str(site))
    (bus,) = outside.additions("buses")
    port = str(own_port())
    words = "run", "motor/drive.yaml", "--only", "plant", "--bus", f"acme:{port}", "-o", "run"
    process = started(site, *words, cwd=tmp_path)
    try:
        sender, receiver = outside.loaded(bus)(port, False)
        receiver.settimeout(0.2)

        def answer() -> float | None:
            assert process.poll() is None, process.communicate()
            sender.send(struct.pack("=IB3xf4x", 0x301, 4, 0.02))
            try:
                number, position = struct.unpack("=I4xf4x", receiver.recv(72))
            except TimeoutError:
                return None
            return position if number == 0x381 else None

        until(lambda: (answer() or 0.0) > 0.5, "the motor turns")
    finally:
        process.send_signal(2)
        process.communicate(timeout=DEADLINE_S)
        sender.close()
        receiver.close()
    assert "bit-identical" in pcpc(site, "replay", "run", cwd=tmp_path)
    said = pcpc(None, "replay", "run", cwd=tmp_path, code=2)
    assert "speaks acme-torque, which came with pcpc-acme 0.1.0; install that" in said, said
    said = pcpc(None, "check", "motor/drive.yaml", cwd=tmp_path, code=2)
    assert "unknown value acme-torque; known: cia402" in said, said


_PLAIN = """
import sys
read = []
sys.addaudithook(lambda event, about: event == "open" and read.append(str(about[0])))
from pcpc.tools.cli import main
try:
    main(sys.argv[1:])
except SystemExit:
    pass
print(sum("entry_points.txt" in name for name in read), "pcpc_acme" in sys.modules)
"""


@pytest.mark.parametrize(("words", "read", "loaded"), [
    ("--version", False, False), ("simulate --help", False, False), ("rigs probe", True, False),
    ("--help", True, False), ("spin 1", True, True),
])  # fmt: skip
def test_nothing_of_it_is_read_or_loaded_at_a_plain_start(
    site: Path, words: str, read: bool, loaded: bool
) -> None:
    done = subprocess.run(
        [sys.executable, "-P", "-c", _PLAIN, *words.split()],
        env=os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{site}"},
        text=True, capture_output=True, check=True,
    )  # fmt: skip
    count, was_loaded = done.stdout.splitlines()[-1].split()
    assert (int(count) > 0, was_loaded == "True") == (read, loaded), done.stdout


def test_a_shell_completes_it(site: Path, tmp_path: Path) -> None:
    for line, word in (("pcpc sp", "spin"), ("pcpc spin --b", "--backwards"),
                       ("pcpc new x --drive a", "acme-torque")):  # fmt: skip
        answer = tmp_path / "answer"
        environment = os.environ | {
            "_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)),
            "_ARGCOMPLETE_STDOUT_FILENAME": str(answer), "_ARGCOMPLETE_IFS": "\n",
            "PYTHONPATH": f"{ROOT}{os.pathsep}{site}",
        }  # fmt: skip
        command = [sys.executable, "-P", "-m", "pcpc.tools.cli"]
        subprocess.run(command, env=environment, check=True, timeout=DEADLINE_S)
        assert [one.strip() for one in answer.read_text().split("\n")] == [word]


COMMAND = """
from pcpc.tools.terminal.command import Command
from pcpc.tools.terminal.request import Request
from typing import Annotated
"""
BROKEN = {  # by the command's name: its target, its module, METADATA's words, what is said
    "absent": ("{}:C", "import absent\n", "", "No module named 'absent' (absent_.py:1)"),
    "raises": ("{}:C", "1 / 0\n", "", "cannot be loaded: ZeroDivisionError"),
    "ends": ("{}:C", "raise SystemExit(0)\n", "", "its import ends the process; it must not"),
    "syntax": ("{}:C", "def (\n", "", "cannot be loaded: SyntaxError"),
    "nothing": ("{}:C", "", "", "AttributeError: module 'nothing_' has no attribute 'C'"),
    "nowhere": ("no_module_:C", "", "", "No module named 'no_module_'"),
    "number": ("{}:C", "C = 3\n", "", "is of type int, not Command"),
    "unasked": ("{}:C", f"{COMMAND}C = Command('', '', '', dict)\n", "", "asks for is no Request"),
    "newer": ("{}:C", "C = 3\n", "Requires-Dist: pcpc>=9\n", "is made for pcpc>=9, this is "),
    "unread": ("{}:C", "", "Requires-Dist: pcpc ==\n", "cannot be loaded: InvalidRequirement"),
    "options": ("{}:C", f"{COMMAND}class R(Request):\n    a: Annotated[str, '-h', 'x'] = ''\n"
                "C = Command('c', 'h', 'e', R)\n", "", "its options cannot be read: ArgumentError"),
    "unmade": ("{}:C", f"{COMMAND}C = Command('c', 'h', 'e', module='unmade_')\n", "",
               "AttributeError: module 'unmade_' has no attribute 'command'"),
    "long": ("{}:C", "raise ValueError('a\\nb' * 9)\n", "", "ValueError: a ba ba"),
}  # fmt: skip


def package(folder: Path, name: str, target: str, module: str, about: str, kind: str) -> None:
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (folder / f"{name}_.py").write_text(module)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n{about}")
    (info / "entry_points.txt").write_text(f"[pcpc.{kind}]\n{target}\n")


@pytest.fixture
def beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return a folder whose packages this process finds, and forgets again."""
    (folder := tmp_path / "beside").mkdir()
    monkeypatch.syspath_prepend(str(folder))
    known = {*sys.modules}
    yield folder
    outside._all_additions.cache_clear()
    additions.command_named.cache_clear()
    for name in {*sys.modules} - known:
        if name.endswith("_"):
            del sys.modules[name]


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_one_is_named_in_a_line(
    name: str, beside: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target, module, about, said = BROKEN[name]
    package(beside, name, f"{name} = {target.format(f'{name}_')}", module, about, "rooms")
    assert cli.main([name]) == 4
    err = capsys.readouterr().err
    assert said in err and f"{name} of {name} 1.0: " in err, err
    assert err.count("\n") == 1 and "Traceback" not in err, err
    assert cli.main(["help", "all"]) == 0
    assert f"command {name}" in capsys.readouterr().out


def test_a_name_that_is_taken_is_named_and_ours_stays(
    beside: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for one in ("one", "two"):
        package(beside, one, "twice = x_:C\nsimulate = x_:C", "", "", "rooms")
    assert cli.main(["twice"]) == 4
    said = "twice of one 1.0: two 1.0 has this name, too; uninstall one of them\n"
    assert capsys.readouterr().err == said
    assert cli.main(["simulate", "--help"]) == 0
    assert "virtual time" in capsys.readouterr().out
    assert cli.main(["help", "all"]) == 0
    told = " ".join(capsys.readouterr().out.partition("of other packages:")[2].split())
    assert "command simulate one 1.0: pcpc has this name itself; its own is used" in told
    assert "command twice two 1.0: one 1.0 has this name, too" in told


def test_an_import_without_an_end_is_ended(
    beside: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(outside, "ENDLESS_S", 0.2)
    package(beside, "endless", "endless = endless_:C", "while True: pass\n", "", "rooms")
    assert cli.main(["endless"]) == 4
    assert "does not come to an end, it computed for 0.2 s" in capsys.readouterr().err


def test_what_an_import_prints_is_no_output(
    beside: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = f"{COMMAND}print('hello')\nC = Command('c', 'h', 'e', module='noisy_')\n"
    text += "def command(request): print('done'); return 0\n"
    package(beside, "noisy", "noisy = noisy_:C", text, "", "rooms")
    assert cli.main(["noisy"]) == 0
    assert capsys.readouterr() == ("done\n", "hello\n")


def test_a_damaged_list_of_entry_points_is_none(beside: Path) -> None:
    for name, text in (("a", b"\xff[pcpc.rooms]\n=\n[pcpc.rooms]\nno equals\n[pcpc.odd]\na = b\n"),
                       ("b", b"[other]\nx = y:z\n[pcpc.rooms\n= x\n")):  # fmt: skip
        package(beside, name, "", "", "", "rooms")
        (beside / f"{name}-1.0.dist-info/entry_points.txt").write_bytes(text)
    (beside / "c-1.0.dist-info").mkdir()
    os.mkfifo(beside / "c-1.0.dist-info/entry_points.txt")
    (beside / "odd.dist-info").mkdir()
    assert [str(one) for one in outside.additions("rooms")] == []


def test_a_wrong_rig_of_a_system_is_named_and_the_others_are_listed(
    beside: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, text in (("odd", "rig: odd\nrate_hz: [\n"), ("few", "rig: few\nrate_hz: 1.0\n")):
        package(beside, name, f"{name} = {name}_lag", "", "", "plants")
        (beside / f"{name}_lag").mkdir()
        (beside / f"{name}_lag/rig.yaml").write_text(text)
    assert cli.main(["rigs"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("atb1000: 1000 Hz; controllers") and "odd" not in out
    assert "odd_lag/rig.yaml:3:" in err and "few_lag/rig.yaml: 'duration_s' is missing" in err, err
    assert err.count("\n") == 2, err
    assert cli.main(["simulate", "odd"]) == 2


def test_a_package_whose_folder_has_another_form_is_judged_by_its_words(beside: Path) -> None:
    package(beside, "new-er", "newer = new_er_:C", "C = 3\n", "Requires-Dist: pcpc>=9\n", "rooms")
    (one,) = outside.additions("rooms")
    with pytest.raises(UserError, match="is made for pcpc>=9"):
        outside.check_version(one)


def test_a_rig_for_a_broken_dialect_is_not_begun(
    beside: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    package(beside, "odd", "odd = odd_:K", "K = 1\n", "", "drives")
    assert cli.main(["new", str(beside / "motor"), "--drive", "odd"]) == 4
    assert "odd of odd 1.0: odd_:K is of type int, not RobotKind" in capsys.readouterr().err
    assert not (beside / "motor").exists()


def test_the_doctor_names_all_that_is_wrong_and_what_ends_it(tmp_path: Path) -> None:
    for name, (target, module, about, _) in BROKEN.items():
        package(tmp_path, name, f"{name} = {target.format(f'{name}_')}", module, about, "rooms")
    for kind, text, module in (
        ("plants", "hollow = hollow_", ""), ("drives", "odd = odd_:K", "K = 1\n"),
        ("buses", "flat = flat_:B", "B = 1\n"), ("drives", "mit = mit_:K", ""),
    ):  # fmt: skip
        package(tmp_path, text.partition(" ")[0], text, module, "", kind)
    facts = json.loads(pcpc(tmp_path, "doctor", "--json", cwd=tmp_path))["rows"]
    found = {fact["name"]: fact["found"] for fact in facts if fact["state"] == "warn"}
    assert all(said in found[f"command {name}"] for name, (*_, said) in BROKEN.items()), found
    assert "no folder with a rig.yaml" in found["system hollow"]
    assert "odd_:K is of type int, not RobotKind" in found["drive odd"]
    assert "pcpc has this name itself" in found["drive mit"]
    assert "cannot be called" in found["bus flat"]
    package(tmp_path, "zero", "zero = zero_:C", "import os\nos._exit(0)\n", "", "rooms")
    facts = json.loads(pcpc(tmp_path, "doctor", "--json", cwd=tmp_path))["rows"]
    (zero,) = [fact["found"] for fact in facts if fact["name"] == "command zero"]
    assert zero == "its import ended the process", zero
