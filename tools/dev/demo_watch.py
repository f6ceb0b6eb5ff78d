"""Start `pcpc demo` and take the time until the plant is drawn, and until it has moved.

    python -m pcpc.tools.dev.demo_watch uvx --from dist/pcpc-*.whl pcpc demo

The watch starts with the process. A client that knows the page's address and no more takes what any
browser is sent: the first scene, and the first that differs from it.
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from pcpc.tools.start.page import SAID

PATIENCE_S = 300.0


@dataclass(frozen=True)
class Watched:
    """What a demo did: times since its start in s, what the page said at first, what it printed."""

    address_s: float
    picture_s: float
    moved_s: float
    ended_s: float  # since it was asked to end
    note: str
    live: bool  # the first picture is of the run itself
    out: str
    err: str
    code: int

    def __str__(self) -> str:
        kind = "the run" if self.live else f"a log ({self.note})"
        return (
            f"address after {self.address_s:.2f} s, first picture after {self.picture_s:.2f} s, "
            f"it moves after {self.moved_s:.2f} s, ends in {self.ended_s:.2f} s; it shows {kind}"
        )


def watch(
    words: Sequence[str], environment: Mapping[str, str] = os.environ, cwd: Path | None = None
) -> Watched:
    """Start it, look, end it as Ctrl-C does; RuntimeError if nothing moves."""
    begin_s = time.monotonic()
    process = subprocess.Popen(
        words, env=environment, cwd=cwd, start_new_session=True,
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stderr is not None
    said = b""  # by its raw file: what a buffered one has read ahead nobody else gets
    try:
        while not re.search(rf"^{SAID}.*\n".encode(), said, re.MULTILINE):
            if not (more := os.read(process.stderr.fileno(), 1 << 12)):
                raise RuntimeError(f"{' '.join(words)}: no page\n{said.decode()}")
            said += more
        address_s = time.monotonic() - begin_s
        scenes = _scenes(said.decode().rpartition(SAID)[2].split()[0])
        about = next(scenes)
        picture_s = time.monotonic() - begin_s
        next(scenes)
        moved_s = time.monotonic() - begin_s
        scenes.close()
        os.killpg(process.pid, signal.SIGINT)
        out, rest = process.communicate(timeout=PATIENCE_S)
        ended_s = time.monotonic() - begin_s - moved_s
        shown = str(about["note"]), bool(about["live"])
        return Watched(
            address_s,
            picture_s,
            moved_s,
            ended_s,
            *shown,
            out.decode(),
            (said + rest).decode(),
            process.returncode,
        )
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


def _scenes(url: str) -> Generator[dict[str, Any], None, None]:
    """Yield what is told of the run, at its first scene and at the first other one."""
    from websockets.sync.client import connect

    parts = urlsplit(url)
    place = f"ws://{parts.netloc}/ws"
    with connect(place, proxy=None, max_size=None, ping_interval=None) as socket:
        socket.send(json.dumps({"do": "hello", "token": parts.fragment, "run": ""}))
        about: dict[str, Any] = {}
        first, t_s = None, 0.0
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            found = socket.recv(timeout=PATIENCE_S)
            told = json.loads(found) if isinstance(found, str) else {}
            about = told.get("about", about)
            if "scene" not in told:
                continue
            if first is None:
                first = told["scene"]["shapes"]
                yield about
            elif told["scene"]["shapes"] != first:
                yield about
                return
            if not about["live"]:  # a page plays a log by asking for its instants
                t_s += 0.2
                socket.send(json.dumps({"do": "at", "t_s": t_s}))
    raise RuntimeError(f"{url}: nothing moves")


if __name__ == "__main__":
    print(watch(sys.argv[1:]))
