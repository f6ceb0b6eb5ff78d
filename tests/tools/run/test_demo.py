"""`pcpc demo` in real processes: what moves, how it ends, what it leaves, what stops it."""

import fcntl
import os
import pty
import re
import select
import signal
import socket
import struct
import subprocess
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hosting import Client, Host
from places import PATIENCE_S
from processes import PCPC, ROOT, pcpc

import pcpc as package
from pcpc.drivers.compiled import compile_cache
from pcpc.plants.scene import Scene, box, disc, line, text
from pcpc.tools.dev import demo_watch
from pcpc.tools.run.demo import recorded, terminal

DEMO = [PCPC, "demo", "--port", "0"]


@pytest.fixture
def home(tmp_path: Path) -> dict[str, str]:
    """Return an environment without a screen, with an empty home and the compiled code here."""
    base = compile_cache.user_cache()
    assert base is not None
    (tmp_path / "home").mkdir()
    own = {name: v for name, v in os.environ.items() if not name.endswith(("DISPLAY", "BROWSER"))}
    return own | {"HOME": str(tmp_path / "home"), "XDG_CACHE_HOME": str(base),
                  "TMPDIR": str(tmp_path)}  # fmt: skip


def test_a_rig_moves_on_a_page_until_ctrl_c_and_nothing_is_left(
    home: dict[str, str], tmp_path: Path
) -> None:
    seen = demo_watch.watch(DEMO, home, tmp_path)
    assert seen.code == 0 and seen.live and seen.out.startswith("next:"), seen
    assert "no screen here: open that address, or try `pcpc demo --terminal`" in seen.err
    assert "Ctrl-C ends it" in seen.err and "Traceback" not in seen.err
    assert [path.name for path in tmp_path.iterdir()] == ["home"]
    assert not [path for path in (tmp_path / "home").rglob("*") if path.is_file()], "no token"


def test_what_comes_next_can_be_typed(home: dict[str, str], tmp_path: Path) -> None:
    from pcpc.tools.cli.command_line import parsed_options
    from pcpc.tools.run.demo.cli import NEXT

    lines = [re.split(r" {2,}", one.strip())[0] for one in NEXT.splitlines()[1:]]
    assert len(lines) == 4
    for words in lines[:3]:
        parsed_options(words.split()[1:])


def test_a_browser_is_opened_with_the_address_and_holds_up_nobody(
    home: dict[str, str], tmp_path: Path
) -> None:
    script = tmp_path / "browser"
    script.write_text(f'#!/bin/sh\necho "$1" > {tmp_path}/asked\nsleep 600\n')
    script.chmod(0o755)
    seen = demo_watch.watch(DEMO, home | {"BROWSER": f"{script} %s"}, tmp_path)
    end_s = time.monotonic() + PATIENCE_S
    while not (tmp_path / "asked").exists():
        assert time.monotonic() < end_s
    subprocess.run(["pkill", "-f", str(script)], check=True)  # this test's own, by its place
    assert (tmp_path / "asked").read_text().strip() in seen.err and seen.code == 0
    assert "no browser" not in seen.err + seen.out


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--rig", "hul"], 2, "did you mean hull?"),
        (["--terminal"], 4, "--terminal: this is no terminal; leave it out for the page"),
        (["--terminal", "--port", "1"], 2, "--port: contradicts --terminal"),
        (["--port", "70000"], 2, "0 to 65535"),
    ],
)
def test_what_is_wrong_is_a_line(words: list[str], code: int, said: str, tmp_path: Path) -> None:
    done = pcpc("demo", *words, cwd=tmp_path)
    assert (done.code, done.err.count("\n"), done.out) == (code, 1, ""), str(done)
    assert said in done.err


def test_a_port_that_is_taken_is_a_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        done = pcpc("demo", "--port", str(taken.getsockname()[1]), cwd=tmp_path)
    assert done.code == 4 and done.err.count("\n") == 1 and "port" in done.err, str(done)


def test_a_home_that_cannot_be_written_is_no_obstacle(home: dict[str, str], tmp_path: Path) -> None:
    """As root may write everywhere, the home is a file, in which nobody can."""
    (tmp_path / "file").touch()
    seen = demo_watch.watch(DEMO, home | {"HOME": str(tmp_path / "file")}, tmp_path)
    assert seen.code == 0 and "Traceback" not in seen.err, seen.err


def test_while_the_loop_is_compiled_the_page_says_so_and_ctrl_c_ends_it(
    home: dict[str, str], tmp_path: Path
) -> None:
    cold = home | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONOPTIMIZE": "1"}
    process = subprocess.Popen(
        DEMO, env=cold, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    try:
        assert process.stderr and process.stdout
        url = process.stderr.readline().removeprefix("page: ").strip()
        port, _, token = url.rpartition(":")[2].partition("/#")
        with Client(Host(None, int(port), token)) as client:  # type: ignore[arg-type]
            assert not client.about["live"] or not client.about["nodes"]
            assert "the loop is compiled now, once" in client.about["note"]
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, out[:5]) == (0, "next:") and "Traceback" not in err, err
    finally:
        process.kill()
        process.communicate()


# In the terminal


class Screen:
    """A terminal with the demo in it."""

    def __init__(self, environment: dict[str, str], *words: str) -> None:
        self.master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
        sized = {"COLUMNS", "LINES"}  # of a terminal around this one
        environment = {key: one for key, one in environment.items() if key not in sized}
        self.process = subprocess.Popen(
            [PCPC, "demo", "--terminal", *words], stdin=slave, stdout=slave, stderr=slave,
            env=environment | {"LC_ALL": "C.UTF-8"}, start_new_session=True,
        )  # fmt: skip
        os.close(slave)
        self.text = ""

    def until(self, met: Callable[[], bool]) -> None:
        """Read until `met`, or the other side is closed."""
        end_s = time.monotonic() + PATIENCE_S
        while not met():
            assert time.monotonic() < end_s, self.text[-2000:]
            if select.select([self.master], [], [], 1.0)[0]:
                try:
                    self.text += os.read(self.master, 1 << 16).decode(errors="replace")
                except OSError:  # the other side is closed
                    return

    @property
    def pictures(self) -> list[str]:
        """What was drawn, one by one."""
        return self.text.split("\x1b[H")[1:-1]


@pytest.fixture
def screen(home: dict[str, str]) -> Iterator[Screen]:
    found = Screen(home)
    yield found
    found.process.kill()
    found.process.wait()
    os.close(found.master)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_rig_moves_in_the_terminal_which_is_given_back(
    screen: Screen, number: signal.Signals
) -> None:
    screen.until(lambda: len(screen.pictures) > 20)
    drawn = [re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", one) for one in screen.pictures]
    assert len(set(drawn)) > 10, "it stands"
    assert all("hull, simulated; Ctrl-C ends it" in one and one.count("\n") == 29 for one in drawn)
    assert any(0x2800 < ord(letter) < 0x2900 for letter in drawn[5])
    screen.process.send_signal(number)
    screen.until(lambda: False)
    assert screen.process.wait(PATIENCE_S) == 0
    end = screen.text.rpartition("\x1b[H")[2]
    assert "\x1b[?25h\x1b[?1049l" in end and "next:" in end


def test_a_log_is_shown_while_the_simulation_is_not_there(
    home: dict[str, str], tmp_path: Path
) -> None:
    package.simulate("hull", set={"duration_s": 0.5, "rate_hz": 200.0}, folder=tmp_path / "run")
    film = terminal.Film(tmp_path / "run/log.mcap")
    times_s = 0.001, 0.201, 0.201 + 0.495  # the last cycle is at 0.495 s
    first, later, again = (terminal.lines(film.at(t_s), 80, 24) for t_s in times_s)
    assert first != later and later == again, "behind the last picture comes the first"


def test_a_scene_fills_the_letters_that_it_is_given() -> None:
    shapes = [box((1.0, 0.5), 2.0, 1.0, "body"), disc((1.0, 0.5), 0.25, "moving"),
              line([(0.0, 0.0), (2.0, 1.0)], "force"), text((1.0, 0.5), "mid")]  # fmt: skip
    drawn = terminal.lines(Scene((0.0, 0.0, 2.0, 1.0), *shapes), 40, 10)
    plain = [re.sub(r"\x1b\[[0-9;]*m", "", one) for one in drawn]
    assert [len(one) for one in plain] == [40] * 10
    assert "mid" in plain[4] + plain[5]
    assert set(plain[0][1:30]) == {"⠉"}, "the upper edge"
    assert plain[9][0] not in " ⠀" and plain[0][39] not in " ⠀", "corners"


def test_a_log_comes_with_a_release_only() -> None:
    assert recorded.log_of("engage") is None
    ignored = (ROOT / ".gitignore").read_text().split()
    assert f"tools/run/demo/{recorded.FILE.name}" in ignored
