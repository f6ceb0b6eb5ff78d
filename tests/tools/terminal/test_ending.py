"""How commands end when nobody reads, nothing can be written, or somebody asks them to end."""

import errno
import io
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from copies import as_of_a_terminal
from logcommand import barrel_log
from processes import DEADLINE_S, PCPC, ROOT, pcpc

from pcpc.drivers.errors import BusError, Exit, UserError
from pcpc.tools.cli import main
from pcpc.tools.terminal import ending

PROBE = str(ROOT / "plants/probe/rig.yaml")
Screen = pytest.CaptureFixture[str]
IGNORING = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
signal.signal(signal.SIGHUP, signal.SIG_IGN)
os.execv(sys.argv[1], sys.argv[1:])
"""
ENDLESS = """
import sys, time
from pcpc.tools.terminal.ending import exit_code
def wait():
    print("waiting", flush=True)
    while True:  # no signal.pause: a signal just before it is heard by the next one
        time.sleep(0.1)
sys.exit(exit_code(wait, goes_on=True))
"""


def in_shell(words: str) -> tuple[list[int], str]:
    """Return the exit codes of a pipe of `bash` and what it left on stderr."""
    script = f'{words}; echo "${{PIPESTATUS[@]}}" >&3'
    read, write = os.pipe()
    done = subprocess.run(
        ["bash", "-c", f"exec 3>&{write}; {script}"],
        cwd=ROOT,
        pass_fds=[write],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(write)
    lines = done.stderr.splitlines(keepends=True)
    said = "".join(line for line in lines if not line.startswith("compiling "))
    with os.fdopen(read) as codes:
        return [int(code) for code in codes.read().split()], said


@pytest.mark.parametrize("words", [
    "doctor | true", "doctor --json | head -1", "check PROBE | true", "check PROBE >&- 2>&- <&-",
    "--help | true", "--help >&-", "--help 2>&-", "--help <&-",
    "rigs | head -1", "rigs --json | head -1", "completion bash | head -1", "vm --help | head -1",
    "log info LOG | head -1", "log info LOG --json | head -1",
    "log export LOG -o- --quiet | head -1", "log export LOG -o- --quiet --format ndjson | true",
    "compare --bits LOG LOG --json - --quiet | head -1",
    "replay LOG --json --quiet | head -1",
])  # fmt: skip
def test_a_command_whose_words_nobody_reads_ends_well(words: str) -> None:
    log = str(barrel_log("pd")) if "LOG" in words else ""
    codes, said = in_shell(f"{PCPC} {words.replace('PROBE', PROBE).replace('LOG', log)}")
    assert set(codes) == {0} and said == "", f"{words}: {codes}\n{said}"


@pytest.mark.parametrize("words", ["doctor", "--help"])
def test_output_that_cannot_be_written_is_a_loss(words: str) -> None:
    codes, said = in_shell(f"{PCPC} {words.replace('PROBE', PROBE)} >/dev/full")
    lost = "standard output: No space left on device; what was printed there is lost\n"
    assert (codes, said) == ([3], lost), said


@pytest.mark.parametrize("where", ["2>/dev/full", "2>&-", ">/dev/full 2>&1", ">&- 2>&-"])
def test_an_exit_code_does_not_depend_on_whether_its_words_arrive(where: str) -> None:
    codes, said = in_shell(f"{PCPC} check nosuch.yaml {where}")
    assert (codes, said) == ([2], ""), f"{where}: {said}"


def test_what_is_opened_next_does_not_take_the_place_of_a_closed_stderr() -> None:
    code = (
        "from pcpc.tools.terminal.ending import exit_code; import os;"
        "raise SystemExit(exit_code(lambda: min(os.open('/dev/null', 0), 3), goes_on=True))"
    )
    done = subprocess.run(["bash", "-c", f'"{sys.executable}" -c "{code}" <&- >&- 2>&-'], cwd=ROOT)
    assert done.returncode == 3, done.returncode


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_in_the_background_ends_when_asked(number: signal.Signals) -> None:
    """A shell without job control ignores SIGINT for it, nohup SIGHUP too."""
    words = [sys.executable, "-c", IGNORING, sys.executable, "-c", ENDLESS]
    with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as one:
        assert one.stdout is not None and one.stderr is not None
        assert one.stdout.readline() == b"waiting\n"
        one.send_signal(signal.SIGHUP)  # ignored from birth: it survives the terminal
        one.send_signal(number)
        assert one.wait(DEADLINE_S) == 130
        assert one.stderr.read() == b"interrupted\n"


EARLY = """
import os, signal, sys
class Finder:
    def find_spec(self, name, *_):
        if name == "{module}":
            os.kill(os.getpid(), signal.{name})
sys.meta_path.insert(0, Finder())
sys.argv = ["pcpc", "simulate", "hull", "-o", "never"]
from pcpc.tools.cli import main
sys.exit(main())
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.parametrize(
    "module", ["pcpc.tools.cli.commands", "pcpc.tools.run.commands", "pcpc.tools.run.simulate"]
)
def test_a_command_that_is_still_loading_ends_at_once_with_a_word(
    module: str, name: str, tmp_path: Path
) -> None:
    words = [sys.executable, "-c", EARLY.format(module=module, name=name)]
    one = subprocess.run(
        words, cwd=tmp_path, capture_output=True, text=True, preexec_fn=as_of_a_terminal
    )
    assert (one.returncode, one.stdout) == (130, ""), one
    assert one.stderr.splitlines()[-1] == "interrupted" and "Traceback" not in one.stderr, one


def test_a_command_ends_with_its_terminal() -> None:
    words = [sys.executable, "-c", ENDLESS]
    with subprocess.Popen(
        words, cwd=ROOT, stdout=subprocess.PIPE, preexec_fn=as_of_a_terminal
    ) as one:
        assert one.stdout is not None and one.stdout.readline() == b"waiting\n"
        one.send_signal(signal.SIGHUP)
        try:
            assert one.wait(DEADLINE_S) == 130
        finally:
            one.kill()


AT_EXIT = """
import atexit, os, signal, sys
atexit.register(lambda: os.kill(os.getpid(), signal.{name}))  # as a user who is not patient
sys.argv = ["pcpc", "rigs", "{what}"]
from pcpc.tools.cli import main
sys.exit(main())
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize(("what", "code"), [("motor*", 2), ("hull", 0)])
def test_a_second_ctrl_c_leaves_the_end_of_a_command_alone(name: str, what: str, code: int) -> None:
    script = AT_EXIT.format(name=name, what=what)
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == code, done
    assert "Exception" not in done.stderr and "Traceback" not in done.stderr, done.stderr


def raising(error: BaseException) -> Callable[[], int]:
    def command() -> int:
        raise error

    return command


@pytest.mark.parametrize(("error", "code", "line"), [
    (OSError(errno.ENOSPC, "No space left on device", "a/log.mcap"), 3,
     "a/log.mcap: No space left on device; free space there, or choose another place"),
    (OSError(errno.EROFS, "Read-only file system", "b"), 4, "b: Read-only file system"),
    (PermissionError(errno.EACCES, "Not yours", b"c\xff"), 4, r"c\udcff: Not yours"),
    (OSError(errno.ENAMETOOLONG, "File name too long", "n"), 2, "n: File name too long"),
    (OSError("odd"), 4, "odd"),
    (OSError(), 4, "OSError"),
    (MemoryError(), 4, "out of memory; end other programs, or give this one more"),
    (RuntimeError("can't start new thread"), 4,
     "no thread more; end other programs, or raise the limit with `ulimit -u`"),
    (KeyboardInterrupt(), 130, "interrupted"),
    (UserError("a.yaml:3:1: rate_hz: above 0, please"), 2, "a.yaml:3:1: rate_hz: above 0, please"),
    (BusError("vcan7: no such interface"), 4, "vcan7: no such interface"),
    (UserError("", Exit.LOSS), 3, ""),
])  # fmt: skip
def test_what_the_machine_refuses_is_a_line(
    error: BaseException, code: int, line: str, capsys: Screen
) -> None:
    assert ending.exit_code(raising(error), goes_on=True) == code
    out, err = capsys.readouterr()
    assert (out, err.splitlines()) == ("", [line] if line else []), err


@pytest.mark.parametrize("interrupted", [True, False])
def test_what_an_interruption_left_half_made_is_no_mistake(
    interrupted: bool, capsys: Screen
) -> None:
    def command() -> int:
        try:
            try:
                raise KeyboardInterrupt if interrupted else ValueError
            finally:
                raise RuntimeError("no compiled object yet")
        except RuntimeError as error:
            raise LookupError from error

    if not interrupted:
        with pytest.raises(LookupError):
            ending.exit_code(command, goes_on=True)
        return
    assert ending.exit_code(command, goes_on=True) == 130
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.parametrize("swallowed", [True, False])
def test_an_interruption_that_was_lost_explains_what_comes_later(
    swallowed: bool, capsys: Screen
) -> None:
    """Where C calls Python, as in a compiler, a KeyboardInterrupt ends nothing."""

    def command() -> int:
        if swallowed:
            with suppress(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGTERM)
        raise RuntimeError("no compiled object yet")

    if not swallowed:
        with pytest.raises(RuntimeError):
            ending.exit_code(command, goes_on=True)
        return
    assert ending.exit_code(command, goes_on=True) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_an_error_does_not_go_on_behind_a_progress(capsys: Screen) -> None:
    def command() -> int:
        sys.stderr.write("\r\x1b[Kcycle 5")
        raise UserError("it faulted")

    assert ending.exit_code(command, goes_on=True) == 2
    assert capsys.readouterr().err == "\r\x1b[Kcycle 5\nit faulted\n"


EVIL = "\x1b]0;evil\x07\x1b[2J\x9b31m\u202e\b\rgone\x1b[3A"
SPELT = r"\x1b]0;evil\x07\x1b[2J\x9b31m\u202e\x08\rgone\x1b[3A"


def test_a_terminal_obeys_nothing_that_others_have_written(capsys: Screen) -> None:
    def told() -> int:
        print(f"title: {EVIL}")
        sys.stdout.writelines([f"{EVIL}\n"])
        sys.stderr.write(f"\r\x1b[K{EVIL}\n")
        sys.stdout.write("\x1b[2A\r\x1b[Ka\n\r\x1b[Kb\x1b[31mred\x1b[0m\n")
        raise UserError(f"no such rig: {EVIL}")

    assert ending.exit_code(told, goes_on=False) == Exit.WRONG_INPUT
    shown = capsys.readouterr()
    own = "\x1b[2A\r\x1b[Ka\n\r\x1b[Kb\x1b[31mred\x1b[0m\n"
    assert shown.out == f"title: {SPELT}\n{SPELT}\n{own}"
    assert shown.err == f"\r\x1b[K{SPELT}\nno such rig: {SPELT}\n"


def test_the_title_of_a_rig_is_shown_and_not_obeyed(tmp_path: Path, capsys: Screen) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(f'base: {PROBE}\ntitle: "\\e]0;evil\\a\\e[2J\\r"\n')
    words = ["simulate", str(rig), "--set", "duration_s=0.05", "-o", str(tmp_path / "run")]
    main([*words, "--no-figure"])
    main(["log", "info", str(tmp_path / "run" / "log.mcap")])
    main(["report", str(tmp_path / "run"), "-o", str(tmp_path / "page.html")])
    shown = capsys.readouterr()
    assert not re.search(
        r"[\x00-\x08\x0b-\x1a\x1c-\x1f\x7f-\x9f]|\x1b(?!\[[0-9;]*m)", shown.out + shown.err
    )


def test_a_working_folder_that_is_gone_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Screen
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    os.rmdir(tmp_path / "gone")
    assert ending.exit_code(lambda: len(os.getcwd()), goes_on=True) == 4
    assert capsys.readouterr().err == "the working folder is gone; change to another one\n"


def test_a_disk_that_is_full_while_something_is_written_is_named(capsys: Screen) -> None:
    def written() -> int:
        with ending.writing(Path("results")), open("/dev/full", "w") as file:
            return file.write("a result\n")

    assert ending.exit_code(written, goes_on=True) == 3
    said = "results: No space left on device; free space there, or choose another place\n"
    assert capsys.readouterr().err == said


def test_a_mistake_of_the_program_keeps_its_traceback() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(ZeroDivisionError):
        ending.exit_code(lambda: 1 // 0, goes_on=True)
    assert signal.getsignal(signal.SIGTERM) == before


class Placeless(io.BytesIO):
    """A file that cannot tell where it stands, once it is `damaged`."""

    damaged = False

    def tell(self) -> int:
        """Raise what a disk may."""
        if self.damaged:
            raise OSError(errno.EIO, "Input/output error")
        return super().tell()


UNREADABLE = """
import sys
class Disk:
    def find_spec(name, *_):
        if name == "pcpc.tools.cli.command_line":
            raise OSError(5, "Input/output error", name)
sys.meta_path.insert(0, Disk)
from pcpc.tools.cli import main
sys.exit(main(["rigs"]))
"""


def test_a_program_that_a_disk_cannot_read_says_so() -> None:
    words = [sys.executable, "-c", UNREADABLE]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    said = "pcpc.tools.cli.command_line: Input/output error\n"
    assert (done.returncode, done.stdout, done.stderr) == (4, "", said)


def test_a_stream_that_cannot_tell_its_place_ends_no_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    file = Placeless()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(file))
    file.damaged = True
    assert ending.exit_code(lambda: 3, goes_on=True) == 3


def test_an_experiment_without_matplotlib_runs_nothing(tmp_path: Path) -> None:
    (tmp_path / "matplotlib.py").write_text("raise ImportError('no such thing')\n")
    done = pcpc(
        "experiment",
        "chapter4",
        "-o",
        str(tmp_path / "out"),
        environment={"PYTHONPATH": str(tmp_path)},
    )
    cure = f"{sys.executable} -m pip install 'matplotlib~=3.10'"
    said = f"chapter4: its figures need matplotlib: {cure} (no such thing)\n"
    assert (done.code, done.out, done.err) == (4, "", said), str(done)
    assert not (tmp_path / "out").exists()
