"""The line to a `pcpc host` of another machine: questions and answers, one after the other."""

import argparse
import json
import os
import ssl
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from pcpc.drivers.errors import Exit, UserError
from pcpc.drivers.machine import regular_files
from pcpc.drivers.machine.packages import pip_install
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.tools.live.remote import answers, guard
from pcpc.tools.terminal import screen

Answer = TypeVar("Answer")
_ANSWER_S, _OPEN_S, _CLOSE_S = 15.0, 10.0, 1.0
_MOST_BYTES = 64 << 20  # of one answer: what a node says about itself has its laws and tables
_ENVIRONMENT = "PCPC_TOKEN"
_ODD = (
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    OverflowError,
    AttributeError,
    RecursionError,
    struct.error,
)  # what reading an answer ends in that is none
_OTHER = "does not answer as `pcpc host` does"


class Link:
    """One connection, with the token. UserError where there is none to be had."""

    def __init__(self, options: argparse.Namespace) -> None:
        try:
            from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus
            from websockets.sync.client import connect
        except ImportError:
            what = f"--at needs websockets: {pip_install('websockets')}"
            raise UserError(what, Exit.ENVIRONMENT) from None
        host, port = _place(options.at)
        self.at = guard.place(host, port)
        token, context = token_of(options), _context(options, host)
        scheme = "ws" if context is None else "wss"
        self._number, self._closed = 0, ConnectionClosed
        try:
            self._line = connect(
                f"{scheme}://{self.at}/ws",
                ssl=context,
                proxy=None,
                compression=None,
                max_size=_MOST_BYTES,
                open_timeout=_OPEN_S,
                close_timeout=_CLOSE_S,
            ).__enter__()
        except ssl.SSLError as error:
            raise self.error(
                f"{_reason(error)}; --ca FILE takes a certificate of your own"
            ) from None
        except InvalidStatus as error:
            name = f"it is not called {host}; start it there with --name {host}"
            code = error.response.status_code
            raise self.error(name if code == 403 else f"no pcpc host: HTTP {code}") from None
        except (InvalidHandshake, EOFError):
            other = "does it use TLS (--ca FILE)?" if context is None else "does it use TLS?"
            raise self.error(f"{_OTHER}; {other}") from None
        except TimeoutError:
            raise self.error(f"no answer within {_OPEN_S:g} s") from None
        except OSError as error:
            what = f"{error.strerror or error}; is `pcpc host` running there?"
            raise self.error(what) from None
        self._send({"do": "hello", "token": token, "kind": "terminal"})

    def close(self) -> None:
        """End it."""
        self._line.close()

    def ask(self, what: str, **about: Any) -> Any:
        """Return the answer to a question: an object, or bytes. LiveError: refused, or none."""
        self._number += 1
        self._send({"do": what, "id": self._number, **about})
        found = self._answer()
        if isinstance(found, bytes):
            return found
        try:
            told = answers.clean(json.loads(found))
            if "refused" not in told:
                return told
            refusal = LiveError(" ".join(str(told["why"]).split()), Exit(told["code"]))
        except _ODD:
            raise self.not_understood() from None
        raise refusal

    def answer(self, read: Callable[[Any], Answer], what: str, **about: Any) -> Answer:
        """Return what `read` makes of an answer; LiveError where it can make nothing of it."""
        found = self.ask(what, **about)
        try:
            return read(found)
        except _ODD:
            raise self.not_understood() from None

    def not_understood(self) -> LiveError:
        """Return an error about an answer that is none."""
        return self.error(f"{_OTHER}; what answers there?")

    def _send(self, message: dict[str, Any]) -> None:
        try:
            self._line.send(json.dumps(message, allow_nan=False))
        except (self._closed, OSError) as error:
            raise self._loss_error(error) from None

    def _answer(self) -> str | bytes:
        try:
            return self._line.recv(timeout=_ANSWER_S)
        except TimeoutError:
            raise self.error(f"no answer for {_ANSWER_S:g} s") from None
        except (self._closed, OSError) as error:
            raise self._loss_error(error) from None

    def _loss_error(self, error: Exception) -> LiveError:
        said = screen.clean(getattr(getattr(error, "rcvd", None), "reason", ""))
        if getattr(getattr(error, "rcvd", None), "code", 0) == guard.WRONG_TOKEN:
            what = "wrong token; it is the part after the # of the address that `pcpc host` printed"
            return LiveError(f"{self.at}: {what}")
        return self.error(f"the connection was lost{f': {said}' if said else ''}")

    def error(self, what: str) -> LiveError:
        """Return an error about the other side."""
        return LiveError(f"{self.at}: {what}", Exit.ENVIRONMENT)


def token_of(options: argparse.Namespace) -> str:
    """Return the token, or that of an address: from a file that only its user reads, or PCPC_TOKEN.

    UserError. It is no option, as all users of a machine see the words of a command.
    """
    text = os.environ.get(_ENVIRONMENT, "")
    if options.token_file is not None:
        path = Path(options.token_file)
        try:
            if path.is_dir():
                raise UserError(f"--token-file {path}: is a folder; give the file")
            if path.stat().st_mode & 0o077:
                raise UserError(f"{path}: others can read it; chmod 600 {path}")
            text = regular_files.read_text(path)
        except (OSError, UnicodeError) as error:
            said = getattr(error, "strerror", None) or "no text"
            raise UserError(f"--token-file {path}: {said}") from None
    token = text.strip().rpartition("#")[2]
    if options.token_file is not None and not 0 < len(token) <= guard.MOST_TOKEN:
        what = "holds no token; it is the part after the # of the address that `pcpc host` printed"
        raise UserError(f"--token-file {options.token_file}: {what}")
    if not token or len(token) > guard.MOST_TOKEN:
        what = f"--at needs the token of that host: --token-file FILE, or {_ENVIRONMENT}"
        raise UserError(f"{what}; on that host it is in ~/.local/state/pcpc/host-token")
    return token


def _place(at: str) -> tuple[str, int]:
    """Return host and port of HOST[:PORT], also [::1]:8642."""
    try:
        parts = urlsplit(f"//{at}")
        if parts.hostname and parts.netloc == at and "@" not in at and parts.port != 0:
            return parts.hostname, parts.port or guard.PORT
    except ValueError:
        pass
    raise UserError(f"--at {at}: expected HOST or HOST:PORT, as `pcpc host` printed it")


def _context(options: argparse.Namespace, host: str) -> ssl.SSLContext | None:
    """Return how TLS is spoken, None without; UserError."""
    if options.plain and options.ca is not None:
        raise UserError("--plain and --ca exclude each other")
    if options.plain or (options.ca is None and guard.is_loopback(host)):
        return None
    try:
        found = ssl.create_default_context(cafile=options.ca)
    except (ssl.SSLError, OSError) as error:
        raise UserError(f"--ca {options.ca}: {_reason(error)}") from None
    # a ticket of TLS 1.3 wakes the thread that reads, which then stands in the middle of a record
    found.maximum_version = ssl.TLSVersion.TLSv1_2
    return found


def _reason(error: OSError) -> str:
    if isinstance(error, ssl.SSLCertVerificationError):
        return error.verify_message
    said = error.reason if isinstance(error, ssl.SSLError) else None
    return str(said or error.strerror or error).replace("_", " ").lower()
