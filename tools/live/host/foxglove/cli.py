"""`pcpc host --foxglove [PORT]` and `--foxglove-layout`."""

import json
import os
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlencode

from pcpc.drivers.errors import Exit, UserError
from pcpc.drivers.machine.packages import pip_install
from pcpc.tools.live.host import guard
from pcpc.tools.live.host.commands import HostRequest
from pcpc.tools.live.host.foxglove.commands import FoxgloveRequest
from pcpc.tools.live.host.foxglove.names import TOKEN
from pcpc.tools.live.host.sources import FollowedRun, RunSource

PORT = 8765  # which both programs propose
_TRIES = 20


def layout(request: HostRequest) -> int:
    """Print the layout of a rig's plant. UserError: no rig."""
    from pcpc.tools.live.host.foxglove import layouts  # numba

    if request.what is None:
        raise UserError("--foxglove-layout: name a rig; `pcpc rigs` lists them")
    made, left_out = layouts.of_rig(request.what)
    print(json.dumps(made, indent=1))
    for name in left_out:
        print(f"left out: {name}, which {request.what} does not record", file=sys.stderr)
    return Exit.OK


def command(
    request: HostRequest, shown: RunSource | FollowedRun, certificate: tuple[str, str] | None
) -> int:
    """Serve Foxglove and Lichtblick until Ctrl-C. UserError: wrong input."""
    if request.page.port is not None:
        raise UserError(f"--port is the page's; use --foxglove {request.page.port}")
    if isinstance(shown, RunSource):
        raise UserError(f"{request.what}: Foxglove and Lichtblick open the log.mcap itself")
    try:
        from pcpc.tools.live.host.foxglove.server import FoxgloveServer  # numba
    except ImportError as error:
        what = f"this needs {error.name}: {pip_install(error.name or 'foxglove')}"
        raise UserError(what, Exit.ENVIRONMENT) from None
    cert, key = certificate or (None, None)
    pair = (Path(cert).read_bytes(), Path(key).read_bytes()) if cert and key else None
    token = guard.token_of(os.environ, request.new_token)
    wanted = request.beside.of(FoxgloveRequest).foxglove
    ports = range(PORT, PORT + _TRIES) if wanted is None or wanted < 0 else (wanted,)
    for port in ports:
        try:
            server = FoxgloveServer(shown, token, request.page.write, request.address, port, pair)
            break
        except UserError as error:
            if "in use" not in str(error):
                raise
            refused = error
    else:
        raise UserError(f"{refused}; choose another --foxglove PORT", Exit.ENVIRONMENT)
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: ended.set())
    _give_way()
    _say(request, server.port, token)
    server.serve(ended)
    return Exit.OK


def _give_way() -> None:
    """Let the loop and its bus go first, before every thread of the server."""
    nice = os.nice(0) + 5
    for thread in os.listdir("/proc/self/task"):
        with suppress(ProcessLookupError):  # it has ended since
            os.setpriority(os.PRIO_PROCESS, int(thread), min(nice, 19))


def _say(request: HostRequest, port: int, token: str) -> None:
    name = request.name[0] if request.name else request.address
    url = f"{'wss' if request.tls_cert else 'ws'}://{guard.place(name, port)}"
    query = urlencode({"ds": "foxglove-websocket", "ds.url": url}, safe=":/[]")
    print(f"{url}\nhttps://app.foxglove.dev/?{query}", flush=True)
    local = guard.is_loopback(request.address)
    reach = "every page open in a browser here" if local else "all there"
    tune = "it is read-only; with --write, clients with the token can tune"
    if request.page.write:
        tune = f"to tune, set the parameter {TOKEN} to {token}"
    print(
        f"showing {request.node or request.what or 'any rig that runs'}; Ctrl-C ends it\n"
        f"reading needs no token: {reach} can read\n{tune}",
        file=sys.stderr,
        flush=True,
    )
