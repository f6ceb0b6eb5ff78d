"""The job of the guest: a shell script that runs one command as the caller would have run it.

Any byte but NUL passes unharmed, in arguments and in the environment: everything is single-quoted,
and `env -i` sets the environment, so that a name that no shell accepts arrives as well.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

_BUSYBOX = b"/run/pcpc-vm/busybox"


@dataclass(frozen=True)
class Job:
    """What to run and as whom; bytes as the kernel has them."""

    command: Sequence[bytes]
    environment: Mapping[bytes, bytes]
    folder: bytes
    umask: int
    uid: int
    gid: int
    groups: Sequence[int]


def job_of_caller(command: Sequence[str]) -> Job:
    """Return the job that runs `command` in this process's folder, environment and user."""
    umask = os.umask(0o077)
    os.umask(umask)
    return Job(
        command=[os.fsencode(argument) for argument in command],
        environment=dict(os.environb),
        folder=os.getcwdb(),
        umask=umask,
        uid=os.getuid(),
        gid=os.getgid(),
        groups=os.getgroups(),
    )


def quote(text: bytes) -> bytes:
    """Return `text` as one word of a POSIX shell."""
    return b"'" + text.replace(b"'", b"'\\''") + b"'"


def script(job: Job, setpriv: str) -> bytes:
    """Return the shell script of `job`; `setpriv` is the path of util-linux's program of that name.

    The command becomes the leader of a session, for signals to its group; its id is in `pid`.
    """
    groups = f"--groups={','.join(map(str, job.groups))}" if job.groups else "--clear-groups"
    user = [f"--reuid={job.uid}", f"--regid={job.gid}", groups]
    words = [_BUSYBOX, b"setsid", _BUSYBOX, b"env", b"-i"]
    words += [name + b"=" + value for name, value in job.environment.items()]
    words += [os.fsencode(setpriv), *(word.encode() for word in user), b"--", *job.command]
    runtime = quote(b"/run/user/%d" % job.uid)
    lines = [
        b"echo $$ >/run/pcpc-vm/pid",
        b"%s mkdir -p %s && %s chown %d:%d %s && %s chmod 700 %s"
        % (_BUSYBOX, runtime, _BUSYBOX, job.uid, job.gid, runtime, _BUSYBOX, runtime),
        b"umask %04o" % job.umask,
        b"cd %s || exit 126" % quote(job.folder),
        b"exec " + b" ".join(quote(word) for word in words),
    ]
    return b"\n".join(lines) + b"\n"
