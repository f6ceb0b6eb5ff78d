"""The plant of a log as it moved, drawn in the terminal again and again, as fast as it was.

A letter of the terminal is a braille pattern, dots two wide and four high, bits in this order:

    1 8
    2 16
    4 32
    64 128
"""

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from shutil import get_terminal_size

from pcpc.drivers.errors import Exit, UserError
from pcpc.plants.drawing import load, settings_of_log
from pcpc.plants.judging import Judged
from pcpc.plants.scene import Point, Scene, Shape, polar
from pcpc.tools.after.opened import opened

PER_S = 20
_BITS = (1, 8), (2, 16), (4, 32), (64, 128)
_COLOURS = {  # of a role, in the terminal's own
    "ground": 37, "body": 37, "moving": 34, "reference": 39, "ghost": 36, "magnified": 31,
    "force": 33, "note": 39,
}  # fmt: skip
_CORNERS = 24  # of a disc


def check() -> None:
    """Raise UserError where nothing can be drawn."""
    if not sys.stdout.isatty():
        raise UserError(
            "--terminal: this is no terminal; leave it out for the page", Exit.ENVIRONMENT
        )
    try:
        "⣿".encode(sys.stdout.encoding or "ascii")
    except UnicodeEncodeError:
        what = f"this terminal takes {sys.stdout.encoding}; set LC_ALL=C.UTF-8"
        raise UserError(f"--terminal: {what}", Exit.ENVIRONMENT) from None


class Film:
    """The scenes of a log by time; LogError, DrawingError, UserError for a plant without any."""

    def __init__(self, path: Path) -> None:
        with opened(path) as opener:
            log = opener.log
            file, _ = opener.drawing()
            if file is None:
                raise UserError("this rig's plant has no drawing.py")
            self._drawing, self._settings = load(file), settings_of_log(log)
        leader = next(iter(log.node))
        run = Judged(log, 1e-9 * float(log.metadata[leader].get("period_ns", 1e9))).run(leader)
        self._columns, self._t_s = self._drawing.columns(run), run.t_s

    def at(self, since_s: float) -> Scene:
        """Return the scene so long after the first one; behind the last comes the first."""
        whole_s = float(self._t_s[-1] - self._t_s[0])
        t_s = float(self._t_s[0]) + (since_s % whole_s if whole_s > 0.0 else 0.0)
        row = min(int(self._t_s.searchsorted(t_s)), len(self._t_s) - 1)
        now = {name: column[row] for name, column in self._columns.items()}
        return self._drawing.scene(now, self._settings)


def lines(scene: Scene, columns: int, rows: int) -> list[str]:
    """Return a scene as so many lines of so many letters, with colours."""
    x0, y0, x1, y1 = scene.bounds
    each = min((2 * columns - 1) / (x1 - x0), (4 * rows - 1) / (y1 - y0))  # dots for a length of 1
    left, top = columns - 0.5 * each * (x1 - x0), 2 * rows - 0.5 * each * (y1 - y0)
    dots: dict[tuple[int, int], int] = {}
    letters: dict[tuple[int, int], str] = {}
    colours: dict[tuple[int, int], int] = {}

    def place(x: float, y: float) -> Point:
        return left + (x - x0) * each, top + (y1 - y) * each

    for shape in scene.shapes:
        colour = _COLOURS[shape.role]
        if shape.kind == "text":
            words, (x, y) = str(shape.size), place(*shape.xy[:2])
            shift = {"middle": len(words) // 2, "right": len(words)}.get(str(shape.style), 0)
            for i, letter in enumerate(words):
                at = int(y) // 4, int(x) // 2 - shift + i
                letters[at], colours[at] = letter, colour
            continue
        outline = [place(*point) for point in _outline(shape)]
        for x, y in _dots(outline, dashed=shape.kind == "line" and bool(shape.style)):
            at = y // 4, x // 2
            dots[at] = dots.get(at, 0) | _BITS[y % 4][x % 2]
            colours[at] = colour
    return [
        "".join(
            f"\x1b[{colours[at]}m{letters.get(at) or chr(0x2800 + dots[at])}"
            if (at := (row, column)) in colours
            else " "
            for column in range(columns)
        )
        + "\x1b[0m"
        for row in range(rows)
    ]


def _outline(shape: Shape) -> list[Point]:
    """Return the corners of what is drawn of a shape."""
    if shape.kind == "disc":
        x, y, radius = shape.xy
        turns = (2.0 * math.pi * i / _CORNERS for i in range(_CORNERS + 1))
        return [polar((x, y), radius, angle) for angle in turns]
    return [*shape.points, shape.points[0]] if shape.kind == "area" else shape.points


def _dots(corners: list[Point], dashed: bool) -> Iterator[tuple[int, int]]:
    """Yield the dots on a way through corners, each a dot or less from the one before."""
    for (x0, y0), (x1, y1) in pairwise(corners):
        count = min(int(max(abs(x1 - x0), abs(y1 - y0))) + 1, 10_000)
        for i in range(count + 1):
            if not dashed or i % 8 < 5:
                yield int(x0 + (x1 - x0) * i / count), int(y0 + (y1 - y0) * i / count)


def play(film: Film, words: str, until: Callable[[float], bool]) -> None:
    """Draw the film, with words below it, until `until(s)`, which waits for so long, is true."""
    begin_s = time.monotonic()
    with _screen():
        while True:
            since_s = time.monotonic() - begin_s
            size = get_terminal_size()
            drawn = lines(film.at(since_s), size.columns, max(1, size.lines - 1))
            picture = "\r\n".join([*drawn, words[: size.columns]])
            sys.stdout.write(f"\x1b[H{picture}\x1b[J")
            sys.stdout.flush()
            if until(max(0.0, 1.0 / PER_S - (time.monotonic() - begin_s - since_s))):
                return


@contextmanager
def _screen() -> Iterator[None]:
    """Take the whole screen, and give it back as it was."""
    sys.stdout.obeyed = True  # type: ignore[union-attr]
    sys.stdout.write("\x1b[?1049h\x1b[?25l\x1b[?7l")
    try:
        yield
    finally:
        sys.stdout.write("\x1b[?7h\x1b[?25h\x1b[?1049l")
        sys.stdout.flush()
