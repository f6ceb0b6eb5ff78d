"""How a command ends when its machine does not play along: in a line and a documented exit code.

    what happens                       what the command does                    exit code
    nobody reads its output            ends; goes on to its verdict, if any     0; the verdict's
    its output cannot be written       the same, and says so                    3; the verdict's
    its messages cannot be written     goes on in silence                       its own
    stdin, stdout or stderr closed     goes on with /dev/null in their place    its own
    a disk is full                     says which file                          3
    a name that no file can have       says it                                  2
    the machine refuses otherwise      says which file and why                  4
    Ctrl-C, SIGTERM or SIGHUP          ends in order, and says so               130
    what a user can mend               one line that says how                   the error's

A mistake in the program itself keeps its traceback.
"""

import errno
import io
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import FULL, code_of, near_file
from pcpc.tools.terminal import screen

_ASK_TO_END = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_INTERRUPTED = "interrupted"
_NO_THREAD = "can't start new thread"  # in Python's words
_asked = False  # to end, since the command began


class Output:
    """A standard stream; what cannot be written is dropped from then on, and `error` says why.

    `must_be_read`: the error is raised too, which ends the command. Whatever is written, a terminal
    obeys only the codes of this program itself, or any where `obeyed`: of what draws whole screens.
    """

    obeyed = False

    def __init__(self, stream: IO[str], must_be_read: bool = False) -> None:
        self._stream, self._must_be_read = stream, must_be_read
        self._open = False  # a line that changes in place, as of a progress, has no end yet
        self.error: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write `text`, or drop it."""
        self._open = not text.endswith("\n") if text else self._open
        return self._try(lambda: self._stream.write(self._fit(text)), len(text))

    def writelines(self, lines: Iterator[str]) -> None:
        """Write all `lines`, or drop them."""
        self._try(lambda: self._stream.writelines(map(self._fit, lines)), None)

    def say(self, line: str) -> None:
        """Write a line of its own."""
        self.write("\n" * self._open + line + "\n")

    def flush(self) -> None:
        """Hand on what was written so far."""
        self._try(self._stream.flush, None)

    def _fit(self, text: str) -> str:
        return text if self.obeyed else screen.without_foreign_codes(text)

    def _try(self, action: Callable[[], Any], otherwise: Any) -> Any:
        try:
            return action()
        except OSError as error:
            self.error = self.error or error
            with suppress(OSError, ValueError):  # no file behind it: a test's
                _to_nowhere(self._stream.fileno())
            if self._must_be_read:
                raise
            return otherwise


def exit_code(command: Callable[[], int], *, goes_on: bool, last: bool = False) -> int:
    """Run `command` and return its exit code, or that of the table above.

    `goes_on`: it has a verdict, which does not depend on whether somebody reads its words.
    `last`: nothing comes behind it but the end of this process, which a second Ctrl-C leaves alone.
    """
    _open_standard_files()
    out, err = Output(sys.stdout, must_be_read=not goes_on), Output(sys.stderr)
    before = sys.stdout, sys.stderr
    for stream in before:
        if isinstance(stream, io.TextIOWrapper):  # a name of a file may be no text at all
            with suppress(OSError):  # of where it stands in its file
                stream.reconfigure(errors="backslashreplace")
    sys.stdout, sys.stderr = out, err
    try:
        with _asked_to_end(last):
            code = _attempt(command, out, err)
            out.flush()
    except OSError:  # of the last flush: `out.error`
        code = Exit.OK
    finally:
        sys.stdout, sys.stderr = before
    if out.error is not None and out.error.errno != errno.EPIPE:
        Output(before[1]).write(
            f"standard output: {out.error.strerror}; what was printed there is lost\n"
        )
        return code or Exit.LOSS
    return code


def refusal(error: BaseException) -> UserError | None:
    """Return what to say and how to end where the machine refused something, else None."""
    if isinstance(error, OSError):
        return UserError(refusal_text(error), code_of(error))
    if isinstance(error, MemoryError):
        what = "out of memory; end other programs, or give this one more"
    elif isinstance(error, RuntimeError) and str(error) == _NO_THREAD:
        what = "no thread more; end other programs, or raise the limit with `ulimit -u`"
    else:
        return None
    return UserError(what, Exit.ENVIRONMENT)


def refusal_text(error: OSError) -> str:
    """Return what the machine refused, and for which file, in one line."""
    reason = error.strerror or str(error) or type(error).__name__
    files = [os.fsdecode(name) for name in (error.filename, error.filename2) if name is not None]
    cure = "; free space there, or choose another place" if error.errno in FULL else ""
    if error.errno == errno.EMFILE:
        cure = "; raise the limit with `ulimit -n`"
    if isinstance(error, FileNotFoundError) and not _folder_exists():
        return "the working folder is gone; change to another one"
    if isinstance(error, FileNotFoundError) and len(files) == 1:
        cure = near_file(Path(files[0]), Path.exists)
    return ": ".join([*files, reason]).replace("\n", " ") + cure


@contextmanager
def writing(place: Path) -> Iterator[None]:
    """Let what the machine refuses while something is written there name it."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(place)
        raise


def _attempt(command: Callable[[], int], out: Output, err: Output) -> int:
    try:
        return command()
    except SystemExit as end:  # argparse has printed its message; rich ends so without a reader
        if out.error is not None:
            return Exit.OK
        return end.code if isinstance(end.code, int) else Exit.OK if end.code is None else 1
    except KeyboardInterrupt:
        err.say(_INTERRUPTED)
        return Exit.INTERRUPTED
    except UserError as error:
        if str(error):  # else it was said already
            err.say(str(error))
        return error.code
    except Exception as error:
        if error is out.error:
            return Exit.OK
        if (said := refusal(error)) is not None:
            err.say(str(said))
            return said.code
        if not _comes_of_an_interruption(error):
            raise
        err.say(_INTERRUPTED)
        return Exit.INTERRUPTED


def _comes_of_an_interruption(error: BaseException | None) -> bool:
    """Return whether an exception came after a KeyboardInterrupt, or while one was on its way.

    A compiler that was interrupted leaves things half made, and what goes on or tidies up finds
    them; where C calls Python, the KeyboardInterrupt itself is lost.
    """
    if _asked:
        return True
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def leave_at_once() -> None:
    """Let a signal that asks to end do so at once: nothing has begun that has to end in order."""
    _hear(_leave)


def end_in_order() -> None:
    """Make such a signal a KeyboardInterrupt, if `leave_at_once` held until now."""
    if any(signal.getsignal(number) is _leave for number in _ASK_TO_END):
        _hear(_interrupt)


def _interrupt(number: int, frame: Any) -> None:
    global _asked
    _asked = True
    signal.default_int_handler(number, frame)


def _leave(*_: Any) -> None:
    with suppress(OSError):
        os.write(2, f"{_INTERRUPTED}\n".encode())
    os._exit(Exit.INTERRUPTED)


def _hear(handler: Callable[[int, Any], Any]) -> None:
    """Handle the signals, also where SIGINT is ignored from birth.

    A shell ignores it for what runs in the background; SIGHUP stays ignored if it was: `nohup`.
    """
    for number in _ASK_TO_END:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, handler)


@contextmanager
def _asked_to_end(last: bool) -> Iterator[None]:
    """Make SIGINT, SIGTERM and SIGHUP a KeyboardInterrupt, unless `leave_at_once` holds.

    Behind the `last` command all are ignored: libraries tidy up then, and would print them.
    """
    global _asked
    _asked = False
    before = {number: signal.getsignal(number) for number in _ASK_TO_END}
    try:
        if before[signal.SIGTERM] is not _leave:
            _hear(_interrupt)
    except ValueError:  # only the main thread may; nobody sends a signal to another
        before = {}
    try:
        yield
    finally:
        for number, handler in before.items():
            if handler is not None:
                signal.signal(number, signal.SIG_IGN if last else handler)


def _folder_exists() -> bool:
    try:
        os.getcwd()
    except OSError:
        return False
    return True


def _open_standard_files() -> None:
    """Put /dev/null where one of the three is closed: the next file opened would get its number."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            _to_nowhere(number)
    for number, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:
            stream = open(number, "w", encoding="utf-8", closefd=False)  # noqa: SIM115  for good
            setattr(sys, name, stream)


def _to_nowhere(number: int) -> None:
    nowhere = os.open(os.devnull, os.O_RDWR)
    if nowhere != number:
        os.dup2(nowhere, number)
        os.close(nowhere)
