"""What the user sees on stderr while the machine gets ready."""

import sys


class Progress:
    """Lines `vm: ...`; on a terminal the seconds of the boot count up in place."""

    def __init__(self, verbose: bool) -> None:
        """`verbose` also shows the guest's console."""
        self._verbose = verbose
        self._what = ""
        self._shown_s = -1
        self._open_line = False

    def say(self, text: str) -> None:
        """Print one line."""
        end = "\n" if self._open_line else ""
        self._open_line = False
        print(f"{end}vm: {text}", file=sys.stderr, flush=True)

    def boots(self, what: str) -> None:
        """Announce a boot; `what` names kernel and accelerator."""
        self._what, self._shown_s = what, -1
        if not sys.stderr.isatty():
            self.say(f"booting {what} ...")

    def booting(self, now_s: float) -> None:
        """Show the seconds since the announcement, on a terminal."""
        if sys.stderr.isatty() and int(now_s) != self._shown_s:
            self._shown_s, self._open_line = int(now_s), True
            sys.stderr.write(f"\rvm: booting {self._what} ... {now_s:.0f} s")
            sys.stderr.flush()

    def done(self) -> None:
        """End the line of the boot."""
        if self._open_line:
            self._open_line = False
            print(file=sys.stderr, flush=True)

    def console(self, piece: bytes) -> None:
        """Show a piece of the guest's console, if asked to."""
        if self._verbose:
            sys.stderr.write(piece.decode(errors="replace").replace("\r", ""))
            sys.stderr.flush()
