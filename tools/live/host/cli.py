"""`pcpc host [RIG|RUN|LOG]`: a page in the browser that shows a run or a log."""

import asyncio
import errno
import os
import re
import secrets
import signal
import socket
import ssl
import sys
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.nodes import live
from pcpc.tools.after.log import source
from pcpc.tools.after.log.recorded import LATEST, known_logs, log_of
from pcpc.tools.after.trust import ASKED, Trust
from pcpc.tools.live.host import guard
from pcpc.tools.live.host.commands import HostRequest, PageRequest
from pcpc.tools.live.host.sources import FollowedRun, RunSource, of_log
from pcpc.tools.start import rigs
from pcpc.tools.terminal.extras import need
from pcpc.tools.terminal.progress import Progress
from pcpc.tools.terminal.rooms import part_of

PACKAGES = "starlette", "uvicorn", "websockets"
_TRIES = 20
_HOST = re.compile(r"[\w.:-]+")


@dataclass
class Door:
    """Where a page is served: a socket that listens, its address, the names and the token."""

    line: socket.socket
    url: str
    names: frozenset[str]
    token: str
    certificate: tuple[str, str] | None


def command(request: HostRequest) -> int:
    """Serve the page until Ctrl-C; or what else is asked for."""
    if request.beside.value("foxglove_layout"):
        return int(part_of("live/host/foxglove", "cli").layout(request))
    if request.beside.value("foxglove") is not None:
        foxglove = part_of("live/host/foxglove", "cli")
        certificate = certificate_of(request)
        return int(foxglove.command(request, _source(request.what, request.node), certificate))
    check_packages()
    door = open_door(request)
    shown = _source(request.what, request.node)
    with suppress(KeyboardInterrupt):  # while the server is loaded; then it hears it by itself
        for part in ("uvicorn", "pcpc.tools.live.host.server"):
            import_module(part)  # who reads the address is answered at once, also under load
        print(door.url, flush=True)
        print(_summary(request, shown), file=sys.stderr, flush=True)
        serve(door, shown, request.page, Trust.of(request.code))
    return Exit.OK


def check_packages() -> None:
    """Raise UserError where a package is missing; loads none."""
    need("the page needs", *PACKAGES)


def open_door(request: HostRequest) -> Door:
    """Listen as `pcpc host` is told to; UserError."""
    certificate = certificate_of(request)
    for name in request.name:
        if not _HOST.fullmatch(name):
            raise UserError(f"--name {name!r}: not a machine's name; expected rig.example.org")
    folder = request.page.recordings
    if folder and folder.exists() and not folder.is_dir():
        raise UserError(f"--recordings {folder}: is not a folder")
    line = _listener(request.address, request.page.port)
    port = line.getsockname()[1]
    once = secrets.token_urlsafe(24) if request.once else ""
    token = once or guard.token_of(os.environ, request.new_token)
    local = guard.is_loopback(request.address)
    names = guard.names_of(
        {request.address, *(guard.LOOPBACK if local else ()), *request.name}, port
    )
    scheme = "https" if certificate else "http"
    name = request.name[0] if request.name else request.address
    url = f"{scheme}://{guard.place(name, port)}/#{token}"
    return Door(line, url, names, token, certificate)


def serve(
    door: Door, shown: RunSource | FollowedRun, page: PageRequest, trust: Trust = ASKED
) -> None:
    """Serve the page until this process is asked to end, or an error ends it, which is raised."""
    import uvicorn

    from pcpc.tools.live.host.server import PageServer, config  # numba

    os.nice(5)  # the loop and its bus go first
    server = PageServer(shown, door.token, page, trust)
    app = server.app(door.names, door.certificate is not None)
    web = uvicorn.Server(config(app, door.certificate))
    web.install_signal_handlers = lambda: None  # type: ignore

    def end() -> None:
        web.should_exit = True

    async def run() -> None:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            asyncio.get_running_loop().add_signal_handler(number, end)
        await web.serve(sockets=[door.line])

    server.at_failure = end
    asyncio.run(run())
    if server.failure is not None:
        raise server.failure


def _summary(request: HostRequest, shown: RunSource | FollowedRun) -> str:
    if isinstance(shown, RunSource):
        return f"{shown.rig}, a finished log; Ctrl-C ends it"
    can = (
        "can tune and stop the run" if request.page.write else "is read-only (--write lets it tune)"
    )
    what = f"the page {can}"
    return f"showing {request.node or request.what or 'any rig that runs'}; {what}; Ctrl-C ends it"


def _source(shown: str | None, node: str) -> RunSource | FollowedRun:
    """Return what is to be shown: a log or run folder, a rig by name, or whatever runs."""
    if shown is None:
        return FollowedRun(node=node)
    path = Path(shown)
    is_run = path.is_dir() and not (path / "rig.yaml").is_file()
    if path.suffix == ".mcap" or shown == LATEST or is_run:
        return of_log(source.read(log_of(shown), Progress()))
    going_on = bool(shown and live.running(shown))
    return FollowedRun(
        shown if going_on else str(rigs.data_of(rigs.find(shown, known_logs(shown)))["rig"]), node
    )


def certificate_of(request: HostRequest) -> tuple[str, str] | None:
    """Return certificate and key, None without; UserError, also for an address that needs them."""
    if bool(request.tls_cert) != bool(request.tls_key):
        raise UserError("--tls-cert and --tls-key belong together")
    if not (request.tls_cert and request.tls_key):
        if not guard.is_loopback(request.address) and not request.plain:
            raise UserError(
                f"--address {request.address}: anyone on that network can read the token and all "
                "data; give --tls-cert and --tls-key, or --plain if that network is yours alone"
            )
        return None
    try:
        ssl.create_default_context().load_cert_chain(request.tls_cert, request.tls_key)
    except OSError:
        what = "are not a certificate and its key, both as PEM"
        raise UserError(f"{request.tls_cert}, {request.tls_key}: {what}") from None
    return request.tls_cert, request.tls_key


def _listener(address: str, port: int | None) -> socket.socket:
    """Return a socket at the port, or without one at the first free from guard.PORT on."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    wanted = range(guard.PORT, guard.PORT + _TRIES) if port is None else [port]
    for number in wanted:
        line = socket.socket(family, socket.SOCK_STREAM)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            line.bind((address, number))
            line.listen(128)
            return line
        except OSError as error:
            line.close()
            why = error.strerror
            cure = "port" if error.errno in (errno.EADDRINUSE, errno.EACCES) else "address"
    raise UserError(f"{address}:{wanted[0]}: {why}; choose another --{cure}", Exit.ENVIRONMENT)
