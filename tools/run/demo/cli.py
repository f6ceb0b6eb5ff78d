"""`pcpc demo`: a run of a shipped rig with its page, or a film of it in the terminal.

Both are what `pcpc run --host` and `pcpc simulate` do, in a folder that goes with them. Where the
loop has to be compiled first, which takes a minute, a log that came with the wheel is shown.
"""

import io
import os
import subprocess
import sys
import threading
import time
import webbrowser
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

from pcpc.drivers.compiled import compile_cache
from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.opened import Opened
from pcpc.tools.run.demo import recorded, terminal
from pcpc.tools.run.demo.commands import DemoRequest
from pcpc.tools.start import rigs
from pcpc.tools.start.children import Child, complain, on_request
from pcpc.tools.start.folder import LOG
from pcpc.tools.start.page import SAID
from pcpc.tools.terminal.arguments import RunFolder
from pcpc.tools.terminal.rooms import part_of

LASTS_S, _LOOK_S = 300.0, 0.05
SETTINGS = (  # a desk stalls; of the log 110 MB stay, what is judged
    f"duration_s={LASTS_S}", "supervisor.hold_cycles=100000",
    "supervisor.fault_after_cycles=100000", "record.keep=1s",
)  # fmt: skip
_END = "Ctrl-C ends it, or five minutes; nothing is kept"
NEXT = """\
next:
  pcpc run hull --host --write                  the same, recorded and judged
  pcpc simulate hull --controller pd_nn_fast    with a network, in virtual time
  pcpc new motor                                a rig of your own
  pcpc --help                                   all else"""


def command(request: DemoRequest) -> int:
    """Show it until Ctrl-C or for LASTS_S; UserError."""
    if request.terminal:
        request.refuse("contradicts --terminal", "port")
        terminal.check()
    load_rig(Path(request.rig), resolve=False)  # a wrong one opens no page
    try:
        room = TemporaryDirectory(prefix="pcpc-demo-", ignore_cleanup_errors=True)
    except OSError as error:
        raise UserError(f"no temporary folder: {error.strerror}", Exit.ENVIRONMENT) from None
    with room as folder:
        show = _film if request.terminal else _page
        code = show(request, Path(folder))
    if code == Exit.OK:
        print(NEXT)
    return code


def _page(request: DemoRequest, folder: Path) -> int:
    """Run the rig and open its page, which is there before the loop is; return the exit code."""
    hosts = part_of("live/host", "commands")
    host = part_of("live/host", "cli")
    host.check_packages()
    page = hosts.PageRequest(write=True, port=request.port, recordings=folder / "recordings")
    door = host.open_door(hosts.HostRequest(page=page, once=True))
    _tell(door.url)

    def serve(_: Sequence[str]) -> int:
        sources = part_of("live/host", "sources")
        log, note = _meanwhile(request.rig)
        before = sources.of_log(Opened(log).log) if log else sources.RunSource("", True)
        before.note = note
        name = str(rigs.data_of(request.rig)["rig"])
        host.serve(door, sources.FollowedRun(name, before=before), page)
        return 0

    child = Child.fork("page", serve, ())
    door.line.close()
    try:
        return _run(request, folder)
    except KeyboardInterrupt:  # while it is compiled
        return Exit.OK
    finally:
        if child.ended:
            complain([child])
        child.end(0.0, 2.0)


def _run(request: DemoRequest, folder: Path) -> int:
    """Run the rig for as long as the demo lasts; return the exit code."""
    from pcpc.tools.run import run  # time
    from pcpc.tools.run.commands import RunRequest

    said = io.StringIO()  # of a folder that goes
    with redirect_stdout(said):
        code = run.command(
            RunRequest(
                rig=request.rig,
                set=SETTINGS,
                kept=RunFolder(output=str(folder / "run"), quiet=True, no_figure=True),
            )
        )
    if code in (Exit.INTERRUPTED, Exit.NOT_MET):  # nobody judges a demo
        return Exit.OK
    print(said.getvalue(), end="", file=sys.stderr)
    return code


def _film(request: DemoRequest, folder: Path) -> int:
    """Simulate the rig and show how it moved; return the exit code."""
    over = threading.Event()
    on_request(lambda *_: over.set())
    log, note = _meanwhile(request.rig)
    words = ["simulate", request.rig, "-o", str(folder / "run"), "--no-figure", "--quiet"]
    child = Child.started("simulation", "pcpc.tools.cli", words)
    try:
        if log is not None:
            terminal.play(
                terminal.Film(log), f"{note}; {_END}", lambda s: over.wait(s) or child.ended
            )
        else:
            print(f"{note}; {_END}", file=sys.stderr, flush=True)
        while not (child.ended or over.wait(_LOOK_S)):
            pass
        if over.is_set():
            return Exit.OK
        if child.code not in (Exit.OK, Exit.NOT_MET):
            complain([child])
            return child.code
        name, end_s = Path(request.rig).stem, time.monotonic() + LASTS_S
        terminal.play(
            terminal.Film(folder / "run" / LOG),
            f"{name}, simulated; {_END}",
            lambda s: over.wait(s) or time.monotonic() > end_s,
        )
    finally:
        child.end(0.0, 0.5)
    return Exit.OK


def _meanwhile(rig: str) -> tuple[Path | None, str]:
    """Return the log that is shown before the run, if one came of this rig, and what it is."""
    if not compile_cache.is_empty():
        return None, "the run begins"
    log = recorded.log_of(Path(rig).stem)
    what = "recorded when pcpc was released, in virtual time; " if log else ""
    return log, f"{what}the loop is compiled now, once: your run begins in about a minute"


def _tell(url: str) -> None:
    """Say where the page is, and open it where there is a screen."""
    print(f"{SAID}{url}\n{_END}", file=sys.stderr, flush=True)
    cure = "open that address, or try `pcpc demo --terminal`"
    if not any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"))):
        print(f"no screen here: {cure}", file=sys.stderr, flush=True)
        return
    try:
        webbrowser.get()
    except webbrowser.Error:
        print(f"no browser here: {cure}", file=sys.stderr, flush=True)
        return
    silent = subprocess.DEVNULL  # one in the foreground, as $BROWSER may name, holds up nobody
    words = [sys.executable, "-P", "-m", "webbrowser", url]
    subprocess.Popen(words, stdin=silent, stdout=silent, stderr=silent, start_new_session=True)
