"""Progress on stderr: a line that changes in place on a terminal, else one every few seconds."""

import sys
import time

_IN_PLACE_S = 0.1
_LINES_S = 2.0


class Progress:
    """Shows `text` at a bearable rate; `quiet` shows nothing."""

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet
        self._terminal = sys.stderr.isatty()
        self._next_s = 0.0
        self._open = False

    def due(self) -> bool:
        """Return True when a new text would be shown now."""
        return not self._quiet and time.monotonic() >= self._next_s

    def show(self, text: str) -> None:
        """Show `text` in place of the last one."""
        if not self.due():
            return
        self._next_s = time.monotonic() + (_IN_PLACE_S if self._terminal else _LINES_S)
        if self._terminal:
            sys.stderr.write(f"\r\x1b[K{text}")
            self._open = True
        else:
            sys.stderr.write(f"{text}\n")
        sys.stderr.flush()

    def say(self, text: str) -> None:
        """Print a line that stays."""
        if not self._quiet:
            self.close()
            print(text, file=sys.stderr, flush=True)

    def close(self) -> None:
        """End the line that changes in place."""
        if self._open:
            print(file=sys.stderr, flush=True)
            self._open = False
