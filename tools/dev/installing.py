"""`make` installs with this: pip or uv, and in one line what it is about. Needs only Python.

    python -P tools/dev/installing.py COMMAND...

The command's own words are shown only if it fails. On a terminal the line changes in place;
elsewhere, as in CI, there is one at the beginning, one at the end and one every half a minute. The
exit code is the command's.
"""

import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Sequence

_LOOK_S = 0.5
_LINES_S = 30.0  # where it is no terminal
_PACKAGE = re.compile(r"^(?:Collecting|Requirement already satisfied:) ([A-Za-z0-9._-]+)")
_LOADING = re.compile(r"^\s*(?:Downloading|Using cached) (\S+?)(?:-[0-9].*)? \((.+)\)")
_RESOLVED = re.compile(r"^Resolved ([0-9]+) packages")  # uv


class Course:
    """What pip or uv has said so far: packages found, and what it does now."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.packages: set[str] = set()
        self.resolved = 0
        self.doing = "looking for packages"

    def take(self, line: str) -> None:
        """Take a line."""
        self.said.append(line)
        if found := _PACKAGE.match(line):
            self.packages.add(found[1].lower())
        if found := _RESOLVED.match(line):
            self.resolved = int(found[1])
        if found := _LOADING.match(line):
            self.doing = f"loading {found[1]} ({found[2]})"
        if line.startswith("Prepared "):
            self.doing = "unpacking them, the last step"
        if line.startswith("Installing collected packages: "):
            self.doing = f"unpacking {line.count(',') + 1} packages, the last step"

    def follow(self, lines: Iterable[str]) -> None:
        """Take all that is said, to its end."""
        for line in lines:
            self.take(line)

    def words(self, spent_s: float) -> str:
        """Return how far it is, in a line."""
        count = self.resolved or len(self.packages)
        found = f"{count} packages, " if count else ""
        return f"installing: {found}{self.doing}, {spent_s:.0f} s"


def main(command: Sequence[str]) -> int:
    """Run pip or uv and show its course; return its exit code."""
    course, begin_s = Course(), time.monotonic()
    if not sys.stderr.isatty():
        print("installing: about 50 packages, a minute or two", file=sys.stderr, flush=True)
    pip = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    )
    assert pip.stdout is not None, "a pipe was asked for"
    reader = threading.Thread(target=course.follow, args=(pip.stdout,))
    reader.start()
    told_s = begin_s
    try:
        while reader.is_alive():
            words = course.words(time.monotonic() - begin_s)
            if sys.stderr.isatty():
                print(f"\r\x1b[K{words[:79]}", end="", file=sys.stderr, flush=True)
            elif time.monotonic() >= told_s + _LINES_S:
                told_s = time.monotonic()
                print(words, file=sys.stderr, flush=True)
            reader.join(_LOOK_S)
        code = pip.wait()
    except KeyboardInterrupt:
        pip.wait()
        code = 130
    end = "\r\x1b[K" if sys.stderr.isatty() else ""
    if code:
        print(end + "".join(course.said[-20:]), end="", file=sys.stderr)
        return code
    print(f"{end}installed in {time.monotonic() - begin_s:.0f} s", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
