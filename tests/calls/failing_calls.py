"""Run a command of pcpc with its calls of libc counted, and one of them failed.

A site is a call by its number: ("host", "write", 7) is the host's seventh write. `run` forks, so
what a command imports is there already, and counts from the command's beginning.
"""

import ctypes
import errno
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NamedTuple, NoReturn

import numpy as np

HERE = Path(__file__).parent
_FILES = "open64 openat64 memfd_create socket socketpair pipe2 accept4 dup dup2 dup3 epoll_create1"
_DISK = "ftruncate64 truncate64 fsync fdatasync rename mkdir unlink rmdir link lseek64 symlink"
_BUS = "bind listen connect setsockopt getsockopt getsockname shutdown ioctl fcntl64 flock"
_GROUPS = (  # functions, what a failing one returns, how they fail
    (_FILES, "RETURNS_MINUS_1", "EMFILE ENOMEM ENOSPC EIO EINTR"),
    ("opendir fdopendir fopen64", "RETURNS_NULL", "EMFILE ENOMEM EIO"),
    ("readdir64", "RETURNS_NULL", "EIO"),
    ("read pread64", "RETURNS_MINUS_1", "EIO ENOMEM EINTR SHORT"),  # a file never says EAGAIN
    ("recv recvfrom", "RETURNS_MINUS_1", "EIO ENOMEM EINTR EAGAIN SHORT"),
    ("recvmsg", "RETURNS_MINUS_1", "ENOMEM EINTR EAGAIN"),
    ("write pwrite64", "RETURNS_MINUS_1", "ENOSPC EIO EINTR SHORT"),
    ("send sendto", "RETURNS_MINUS_1", "ENOBUFS ENOMEM EIO EINTR EAGAIN SHORT"),
    ("sendmsg", "RETURNS_MINUS_1", "ENOBUFS ENOMEM EINTR EAGAIN"),
    ("poll ppoll select epoll_wait epoll_ctl", "RETURNS_MINUS_1", "EINTR ENOMEM"),
    (_DISK, "RETURNS_MINUS_1", "ENOSPC EIO"),
    ("posix_fallocate64", "RETURNS_ERRNO", "ENOSPC ENOMEM EINTR"),
    ("stat64 lstat64 fstat64 fstatat64 access readlink getcwd", "RETURNS_MINUS_1", "EIO ENOMEM"),
    ("close", "CLOSES", "EIO EINTR"),
    ("mmap64 mremap munmap mlockall", "RETURNS_MINUS_1", "ENOMEM EAGAIN"),
    (_BUS, "RETURNS_MINUS_1", "ENOBUFS ENOMEM EINTR"),
    ("waitpid getrandom", "RETURNS_MINUS_1", "EINTR"),
    ("pthread_create", "RETURNS_ERRNO", "EAGAIN"),
    ("execve chdir", "RETURNS_MINUS_1", "EIO ENOMEM"),
    ("getpeername signalfd", "RETURNS_MINUS_1", "ENOBUFS ENOMEM"),
    ("mprotect madvise", "RETURNS_MINUS_1", "ENOMEM EAGAIN"),
    ("sched_setscheduler sched_setaffinity setpriority", "RETURNS_MINUS_1", "EPERM"),
    ("fork vfork", "", "EAGAIN ENOMEM"),  # the last five are written out in failing_calls.c
    ("clock_nanosleep", "", "EINTR"),
    ("clock_monotonic", "", "FORWARD"),
    ("clock_real", "", "FORWARD BACK"),
)
WAYS = {name: how.split() for names, _, how in _GROUPS for name in names.split()}
_ODD = {"SHORT": -1, "FORWARD": -2, "BACK": -3}
_ROW = [("process", "S24"), ("call", "S24"), ("count", "i8")]
_HEAD = ["number", "what", "fired", "used"]
_TABLE = np.dtype([*_ROW[:2], *((word, "i8") for word in _HEAD), ("rows", np.dtype(_ROW), 1024)])
_PR_SET_CHILD_SUBREAPER = 36
_GONE_S = 5.0  # what a command has started is gone so long after it


class Site(NamedTuple):
    """A call: of which process, of which function, the how manieth."""

    process: str
    call: str
    number: int


@dataclass(frozen=True)
class Ended:
    """How a command ended; `code` None: it did not in time. `left`: processes it left behind."""

    code: int | None
    out: str
    err: str
    seconds: float
    left: tuple[str, ...]
    fired: bool
    counts: dict[tuple[str, str], int]


def begin() -> None:
    """Start this program anew with failing_calls.c in front of libc, unless it runs so already."""
    libc = ctypes.CDLL(None)
    if hasattr(libc, "calls_begin"):
        libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        return
    made = [f"CALL({one}, {kind})" for names, kind, _ in _GROUPS if kind for one in names.split()]
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "failing_calls.h").write_text("\n".join([*made, ""]))
        words = f"gcc -O1 -Wall -Werror -fno-builtin -shared -fPIC -I{folder} -o {folder}/calls.so"
        subprocess.run([*shlex.split(words), str(HERE / "failing_calls.c"), "-ldl"], check=True)
        environment = os.environ | {"LD_PRELOAD": f"{folder}/calls.so", "OPENBLAS_NUM_THREADS": "1"}
        sys.exit(subprocess.call([sys.executable, *sys.orig_argv[1:]], env=environment))


def run(
    words: Sequence[str], folder: Path, site: Site | None, how: str, within_s: float = 60.0
) -> Ended:
    """Run `pcpc WORDS` in the new `folder`; its call at `site` fails so, as `how` says."""
    (folder / "tmp").mkdir(parents=True)
    file = folder.with_name(folder.name + ".calls")
    table = np.memmap(file, _TABLE, "w+", shape=(1,))
    if site is not None:
        table["process"], table["call"], table["number"] = (site[0].encode(), site[1], site[2])
        table["what"] = _ODD.get(how) or getattr(errno, how)
    began_s = time.monotonic()
    pid = os.fork()
    if pid == 0:
        _be_command(words, folder, file)
    code = _waited(pid, began_s + within_s)
    seconds = time.monotonic() - began_s
    left = _left(_GONE_S if code is not None else 0.0)
    said = [folder.with_name(folder.name + end) for end in (".out", ".err")]
    texts = [one.read_text(errors="replace") for one in said]
    counts = {(row["process"].decode(), row["call"].decode()): int(row["count"])
              for row in table["rows"][0, : int(table["used"][0])]}  # fmt: skip
    fired = bool(table["fired"][0])
    for one in (file, *said):
        one.unlink()
    return Ended(code, texts[0], texts[1], seconds, left, fired, counts)


def _be_command(words: Sequence[str], folder: Path, table: Path) -> NoReturn:
    code = 1
    try:
        os.setsid()
        os.chdir(folder)
        files = [os.open(os.devnull, os.O_RDONLY)]
        kinds = os.O_WRONLY | os.O_CREAT | os.O_APPEND
        files += [os.open(f"{folder}{end}", kinds) for end in (".out", ".err")]
        for number, file in enumerate(files):
            os.dup2(file, number)
        os.closerange(3, 256)
        sys.stdout, sys.stderr = map(_opened, (1, 2))
        os.environ |= {"TMPDIR": str(folder / "tmp"), "PCPC_CALLS": str(table)}
        from pcpc.tools.cli import main

        ctypes.CDLL(None).calls_begin(os.fsencode(table), b"host")
        code = main(list(words))
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):
                stream.flush()
        os._exit(code)


def _opened(number: int) -> IO[str]:
    return open(number, "w", buffering=1, closefd=False)


def _waited(pid: int, until_s: float) -> int | None:
    """Wait for a process; return its code, None where it had to be killed."""
    while True:
        found, status = os.waitpid(pid, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > until_s:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            return None
        time.sleep(0.005)


def _left(within_s: float) -> tuple[str, ...]:
    """Return, and end, what is still there of a command; its processes are now children of this."""
    until_s = time.monotonic() + within_s
    names: set[str] = set()
    while True:
        with suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
        if not children:
            return tuple(sorted(names))
        if time.monotonic() > until_s:
            for pid in children:
                with suppress(OSError):
                    names.add(Path(f"/proc/{pid}/comm").read_text().strip())
                    os.kill(int(pid), signal.SIGKILL)
        time.sleep(0.005)
