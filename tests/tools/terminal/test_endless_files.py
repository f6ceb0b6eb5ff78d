"""Files that never end: pipes, devices, imports. A command says which, in a line, and ends."""

import os
import resource
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from logcommand import barrel_log, run, run_here
from processes import RIGS

from pcpc.drivers.machine.regular_files import open_regular
from pcpc.executive.own_laws import modules
from pcpc.tools.live.host import guard

COMMANDS = {
    "info": ("log", "info"), "cat": ("log", "export", "-o-"),
    "export": ("log", "export", "-o", "x.csv"),
    "recover": ("log", "recover", "-o", "y.mcap"), "report": ("report", "-o", "r.html"),
    "replay": ("replay",), "bounds": ("bounds",), "require": ("report", "--requirements"),
    "diff": ("compare", "--bits", str(barrel_log("pd"))),
    "compare": ("compare", str(barrel_log("pd"))),
    "fit": ("fit", str(RIGS / "slew10.yaml")), "play": ("play", "--bus", "udp_multicast"),
    "animate": ("log", "plot", "--moving", "-o", "a.gif"),
}  # fmt: skip


@pytest.mark.parametrize(
    "kind", ["fifo", "/dev/zero", "/dev/null", "/proc/kmsg", "folder", "loop", "absent"]
)
@pytest.mark.parametrize("name", COMMANDS)
def test_a_log_that_is_no_file_is_refused_at_once(
    name: str, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("fifo")
    Path("folder").mkdir()
    Path("loop").symlink_to("loop")
    done = run_here(*COMMANDS[name], kind)
    assert done.code == 2, done
    *_, line = done.err.splitlines()
    assert kind in line and "Traceback" not in done.err, done
    assert sorted(os.listdir()) == ["fifo", "folder", "loop"], "nothing is left behind"


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("fifo", "regular"), ("socket", ""), ("/dev/zero", "regular"), (".", "directory"),
        ("nothing", ""), ("/proc/kmsg", ""), ("/proc/self/pagemap", "regular"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("suffix", [".log", ".mf4"])
def test_a_recording_that_is_no_file_is_refused_at_once(
    kind: str, said: str, suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo("fifo")
    Path("nothing").touch()
    with socket.socket(socket.AF_UNIX) as end:
        end.bind("socket")
    Path(f"a{suffix}").symlink_to(kind)
    done = run_here("log", "import", f"a{suffix}", "-o", "out.mcap")
    assert done.code == 2 and done.err.count("\n") == 1 and not Path("out.mcap").exists(), done
    assert done.err.startswith(f"a{suffix}: ") and said in done.err, done


@pytest.mark.parametrize("beside", ["summary.json", "figure.png"])
def test_a_report_does_not_wait_for_a_pipe_beside_the_log(beside: str, tmp_path: Path) -> None:
    (tmp_path / "log.mcap").write_bytes(barrel_log("pd").read_bytes())
    os.mkfifo(tmp_path / beside)
    done = run_here("report", tmp_path / "log.mcap", "--quiet")
    assert done.code == 0 and (tmp_path / "report.html").exists(), done


def test_a_token_that_is_a_pipe_is_made_anew(tmp_path: Path) -> None:
    (tmp_path / "pcpc").mkdir()
    os.mkfifo(tmp_path / "pcpc" / "host-token")
    token = guard.token_of({"XDG_STATE_HOME": str(tmp_path)})
    assert len(token) >= 32 and (tmp_path / "pcpc" / "host-token").read_text() == token


@pytest.mark.parametrize("name", ["fifo", "."])
def test_only_a_regular_file_is_opened(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(OSError, match=r"regular|directory"):
        open_regular(tmp_path / name)


def test_an_import_without_an_end_is_named_and_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(modules, "LONG_S", 0.05)
    monkeypatch.setattr(modules, "ENDLESS_S", 0.3)
    law = tmp_path / "endless.py"
    law.write_text("while True:\n    pass\n")
    with pytest.raises(ImportError, match=r"endless\.py: it does not come to an end"):
        modules.module_of("", law)
    assert "endless.py: still importing" in capsys.readouterr().err


def test_a_chain_of_bases_is_refused_with_the_place(tmp_path: Path) -> None:
    for i in range(1200):
        base = RIGS / "slew10.yaml" if i == 1199 else f"r{i + 1}.yaml"
        (tmp_path / f"r{i}.yaml").write_text(f"base: {base}\nrig: r{i}\n")
    refused = run_here("check", tmp_path / "r0.yaml")
    assert refused.code == 2 and refused.err.count("\n") == 1, refused
    assert "r100.yaml:1:1: base: " in refused.err and "more than 100 files" in refused.err, refused
    assert run_here("check", tmp_path / "r1150.yaml").code == 0


def test_a_limit_of_open_files_is_raised_or_told() -> None:
    def limited(soft: int, hard: int) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            [sys.executable, "-m", "pcpc.tools.cli", "rigs"],
            capture_output=True,
            text=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard)),
        )

    low, raised = limited(16, 16), limited(16, 256)
    assert low.returncode == 4 and low.stderr.count("\n") == 1 and "ulimit -n" in low.stderr, low
    assert raised.returncode == 0, raised


@pytest.mark.parametrize("option", ["--start", "--end"])
@pytest.mark.parametrize("value", ["1e300", "-1e300", "nan", "inf", "1e10", "1e200min", "x"])
def test_a_time_that_no_log_has_is_refused(option: str, value: str, tmp_path: Path) -> None:
    for name, *words in (
        ("export", "-o", tmp_path / "a.csv"),
        ("export", "-o-"),
        ("plot", "--moving", "-o", tmp_path / "a.gif"),
        ("plot", "controller.e_rad", "-o", tmp_path / "a.png"),
    ):
        done = run(name, barrel_log("pd"), *words, f"{option}={value}")
        assert done.code == 2 and f"{option}: {value}: not a time" in done.err, done
        assert done.err.count("\n") == 1 and not list(tmp_path.iterdir()), done


@pytest.mark.parametrize("window", [("--start", "0.3"), ("--start", "5"), ("--end", "0"),
                                    ("--start", "0.2", "--end", "0.1")])  # fmt: skip
def test_a_window_without_a_cycle_is_said(window: tuple[str, ...], tmp_path: Path) -> None:
    for words in (
        ("export", "-o", tmp_path / "a.csv"),
        ("export", "-o-", "--topics", "/state"),
        ("plot", "controller.e_rad", "-o", tmp_path / "a.png"),
    ):
        done = run(words[0], barrel_log("pd"), *words[1:], *window)
        assert done.code == 2 and "nothing was recorded there" in done.err, done
        assert not list(tmp_path.iterdir())
