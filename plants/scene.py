"""Shapes of a plant at one instant, for matplotlib and for the canvas of a web page alike.

    line(points, role, width, dash)     area(points, role, fill, width)    closed
    disc(centre, radius, role, fill)    text(at, words, role, anchor)

All else is made of these four: box, link, spring, arrow, turn (an arc with a head), ground, slot,
gauge. Lengths are the plant's, m as a rule; widths are pixels; `fill` is the share of the role's
colour inside, 0 to 1; angles are rad, anticlockwise from x. A painter gives each role its colour:

    ground     what stands still         moving      what the plant moves
    body       what is carried           reference   where it should be
    ghost      what was, or is believed  magnified   a truth drawn larger than it is
    force      what acts                 note        words and scales

`Scene.json()`, numbers rounded to a pixel's fraction:

    {"bounds": [x0, y0, x1, y1], "note": "bending x 20", "shapes": [
        ["line", role, [x, y, ...], width, dashed],      ["area", role, [x, y, ...], width, fill],
        ["disc", role, [x, y, radius], width, fill],     ["text", role, [x, y], words, anchor]]}

`anchor` is left, middle or right. A shape with a place that is not finite is left out, and the
scene says "no data".
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pcpc.plants.pages import BLACK, BLUE, GREY, ORANGE, SKY, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Point = tuple[float, float]
Bounds = tuple[float, float, float, float]  # x0, y0, x1, y1

COLOURS = {
    "ground": "#909090", "body": "#505050", "moving": BLUE, "reference": BLACK, "ghost": SKY,
    "magnified": VERMILION, "force": ORANGE, "note": GREY,
}  # fmt: skip
_FAR = 50.0  # of the bounds; what is drawn beyond is cut
_FINE = 4  # decimals of the bounds' longer side
_ARC = 16  # lines of an arc


@dataclass(frozen=True)
class Shape:
    """One of the four: `xy` in turn x, y, ...; of a disc x, y, radius."""

    kind: str
    role: str
    xy: tuple[float, ...]
    size: float | str = 0.0  # width, or the words of a text
    style: float | bool | str = 0.0  # dash, fill or anchor

    def __post_init__(self) -> None:
        if self.role not in COLOURS:
            raise ValueError(f"no role {self.role}; expected one of {', '.join(COLOURS)}")

    @property
    def points(self) -> list[Point]:
        """The points of a line or an area, the place of others."""
        return list(zip(self.xy[::2], self.xy[1::2], strict=False))


Shapes = Shape | Iterable["Shapes"]


def line(points: Iterable[Point], role: str, width: float = 1.5, dash: bool = False) -> Shape:
    """Return a line through points."""
    return Shape("line", role, _flat(points), width, dash)


def area(points: Iterable[Point], role: str, fill: float = 0.2, width: float = 1.5) -> Shape:
    """Return a closed outline, filled."""
    return Shape("area", role, _flat(points), width, fill)


def disc(centre: Point, radius: float, role: str, fill: float = 0.2, width: float = 1.5) -> Shape:
    """Return a circle, filled."""
    return Shape("disc", role, (*centre, radius), width, fill)


def text(at: Point, words: str, role: str = "note", anchor: str = "middle") -> Shape:
    """Return words; `anchor`: which end of them lies at the point."""
    return Shape("text", role, at, words, anchor)


def _flat(points: Iterable[Point]) -> tuple[float, ...]:
    return tuple(value for point in points for value in point)


def _clamp(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)  # NaN stays NaN


def polar(centre: Point, radius: float, angle: float) -> Point:
    """Return the point at an angle around a centre."""
    return centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle)


def box(centre: Point, wide: float, high: float, role: str, fill: float = 0.2) -> Shape:
    """Return an upright rectangle."""
    (x, y), w, h = centre, 0.5 * wide, 0.5 * high
    return area(((x - w, y - h), (x + w, y - h), (x + w, y + h), (x - w, y + h)), role, fill)


def link(a: Point, b: Point, wide: float, role: str, fill: float = 0.2) -> Shape:
    """Return a rod from a to b with round ends."""
    angle = math.atan2(b[1] - a[1], b[0] - a[0])
    ends = [(b, angle - math.pi / 2), (a, angle + math.pi / 2)]
    return area(
        [polar(end, 0.5 * wide, start + math.pi * i / 6) for end, start in ends for i in range(7)],
        role,
        fill,
    )


def spring(a: Point, b: Point, wide: float, role: str, turns: int = 6) -> Shape:
    """Return a zigzag from a to b."""
    (x, y), dx, dy = a, b[0] - a[0], b[1] - a[1]
    length = math.hypot(dx, dy) or 1.0
    along = [0.0, 0.1, *(0.1 + 0.8 * (i + 0.5) / (2 * turns) for i in range(2 * turns)), 0.9, 1.0]
    side = [0.0, 0.0, *(wide * (0.5 - i % 2) for i in range(2 * turns)), 0.0, 0.0]
    return line(
        [
            (x + s * dx - w * dy / length, y + s * dy + w * dx / length)
            for s, w in zip(along, side, strict=True)
        ],
        role,
    )


def arrow(a: Point, b: Point, role: str = "force", head: float = 0.05) -> list[Shape]:
    """Return an arrow from a to b; nothing where it would be shorter than a quarter of its head."""
    length = math.hypot(b[0] - a[0], b[1] - a[1])
    if length < 0.25 * head:
        return []
    return [line((a, b), role, 2.0), _head(b, math.atan2(b[1] - a[1], b[0] - a[0]), head, role)]


def turn(
    centre: Point, radius: float, start: float, by: float, role: str = "force", head: float = 0.05
) -> list[Shape]:
    """Return an arc with a head, at most three quarters of a circle."""
    by = _clamp(by, -1.5 * math.pi, 1.5 * math.pi)
    if abs(by) * radius < 0.25 * head:
        return []
    arc = [polar(centre, radius, start + by * i / _ARC) for i in range(_ARC + 1)]
    ahead = start + by + math.copysign(0.5 * math.pi - 0.3 * head / radius, by)
    return [line(arc, role, 2.0), _head(arc[-1], ahead, head, role)]


def _head(tip: Point, angle: float, size: float, role: str) -> Shape:
    back = [polar(tip, size, angle + math.pi + side) for side in (-0.4, 0.4)]
    return area((tip, *back), role, 1.0, 1.0)


def ground(a: Point, b: Point, hatch: float = 0.04) -> list[Shape]:
    """Return a line that stands still, hatched on its right side from a to b."""
    (x, y), angle = a, math.atan2(b[1] - a[1], b[0] - a[0])
    length = math.hypot(b[0] - x, b[1] - y)
    count = max(2, round(length / hatch))
    marks: list[Point] = []
    for i in range(count):
        foot = polar(a, length * (i + 0.5) / count, angle)
        marks += [foot, polar(foot, hatch, angle - 0.75 * math.pi), foot]
    return [line((a, b), "ground", 2.0), line(marks, "ground", 0.8)]


def slot(
    centre: Point, wide: float, tooth: float, low: float, high: float, span: float
) -> list[Shape]:
    """Return a tooth in a slot: where play is. `span` of the values is `wide`.

    The slot goes from `low` to `high`; the tooth is solid where it touches, up to a thousandth.
    """
    (x, y), scale, h = centre, wide / span, 0.12 * wide
    left, right, tip = x + scale * low, x + scale * high, x + scale * tooth
    near = 1e-3 * (high - low)
    touches = tooth <= low + near or tooth >= high - near
    jaw = 0.16 * wide
    walls = [(left - jaw, y + h), (left, y + h), (left, y - h), (right, y - h), (right, y + h),
             (right + jaw, y + h), (right + jaw, y - 2 * h), (left - jaw, y - 2 * h)]  # fmt: skip
    return [
        area(walls, "moving"),
        area(
            [
                (tip, y - 0.8 * h),
                (tip - 0.04 * wide, y + 2.2 * h),
                (tip + 0.04 * wide, y + 2.2 * h),
            ],
            "force",
            1.0 if touches else 0.15,
        ),
    ]


def gauge(
    at: Point, high: float, span: float, marks: Sequence[tuple[float, str]], words: str
) -> list[Shape]:
    """Return an upright scale from -span to span with marks (value, role); beyond, at its end."""
    (x, y), w = at, 0.05 * high
    ticks = [(x - w * (0.5 if i % 2 else 1.0), y + 0.125 * high * i) for i in range(-4, 5)]
    scale = [p for tick in ticks for p in ((x, tick[1]), tick, (x, tick[1]))]
    shapes = [line(scale, "note", 0.8), text((x, y + 0.56 * high), words)]
    for value, role in marks:
        v = y + 0.5 * high * _clamp(value / span, -1.0, 1.0)
        shapes.append(
            area(((x, v), (x + 1.6 * w, v + 0.6 * w), (x + 1.6 * w, v - 0.6 * w)), role, 0.9, 1.0)
        )
    return shapes


@dataclass(frozen=True)
class Plane:
    """A square with axes from -span to span, for a curve and the point that moves on it."""

    centre: Point
    half: float  # of its side
    span_x: float
    span_y: float

    def at(self, x: float, y: float) -> Point:
        """Return where (x, y) lies; at the edge if beyond."""
        x, y = _clamp(x / self.span_x, -1.0, 1.0), _clamp(y / self.span_y, -1.0, 1.0)
        return self.centre[0] + self.half * x, self.centre[1] + self.half * y

    def curve(
        self, points: Iterable[Point], role: str = "body", width: float = 1.5, dash: bool = False
    ) -> Shape:
        """Return a line through places of the plane."""
        return line([self.at(*point) for point in points], role, width, dash)

    def frame(self, x: str, y: str) -> list[Shape]:
        """Return the axes with their names."""
        far = (self.span_x, self.span_y)
        right, top = self.at(far[0], 0.0), self.at(0.0, far[1])
        gap = 0.12 * self.half
        return [
            self.curve([(-far[0], 0.0), (far[0], 0.0)], "note", 0.8),
            self.curve([(0.0, -far[1]), (0.0, far[1])], "note", 0.8),
            text((right[0], right[1] - gap), x, anchor="right"),
            text((top[0], top[1] + gap), y),
        ]


@dataclass(init=False)
class Scene:
    """What is seen at one instant, in bounds that are the same at all of them."""

    bounds: Bounds
    given: list[Shape]
    note: str

    def __init__(self, bounds: Bounds, *shapes: Shapes, note: str = "") -> None:
        x0, y0, x1, y1 = (1.0 * edge for edge in bounds)
        if not (math.isfinite(x0 + y0 + x1 + y1) and x0 < x1 and y0 < y1):
            raise ValueError(f"bounds {bounds}: expected (x0, y0, x1, y1), finite, ascending")
        self.bounds, self.note = (x0, y0, x1, y1), note
        self.given = list(_each(shapes))

    def add(self, *shapes: Shape) -> None:
        """Add shapes on top."""
        self.given += shapes

    @property
    def shapes(self) -> list[Shape]:
        """The shapes whose places are known."""
        return [one for one in self.given if all(map(math.isfinite, one.xy))]

    @property
    def lacks(self) -> bool:
        """Whether a shape is left out."""
        return len(self.shapes) < len(self.given)

    @property
    def side(self) -> float:
        """The longer side of the bounds."""
        x0, y0, x1, y1 = self.bounds
        return max(x1 - x0, y1 - y0)

    def json(self) -> dict[str, Any]:
        """Return plain lists, see the module header."""
        decimals = _FINE - math.floor(math.log10(self.side))
        far = _FAR * self.side

        def rounded_value(value: float) -> float:
            return round(max(-far, min(far, float(value))), decimals)

        shapes = [
            [one.kind, one.role, [rounded_value(v) for v in one.xy], one.size, one.style]
            for one in self.shapes
        ]
        return {"bounds": list(self.bounds), "note": self.note, "shapes": shapes}

    def paint(self, axes: "Axes") -> None:
        """Draw with matplotlib, what `json` says and no more."""
        drawn = self.json()
        for order, (kind, role, xy, size, style) in enumerate(drawn["shapes"], 2):
            _PAINT[kind](axes, xy, size, style, COLOURS[role]).set_zorder(order)
        x0, y0, x1, y1 = self.bounds
        axes.set(xlim=(x0, x1), ylim=(y0, y1), aspect="equal")
        axes.set_axis_off()
        if self.note:
            axes.text(x1, y0, self.note, color=COLOURS["note"], fontsize=7, ha="right", va="bottom")


def _each(shapes: Shapes) -> Iterator[Shape]:
    if isinstance(shapes, Shape):
        yield shapes
    else:
        for one in shapes:
            yield from _each(one)


def _paint_line(axes: Any, xy: list[float], size: Any, style: Any, colour: str) -> Any:
    dash = (0, (4, 3)) if style else "-"
    (found,) = axes.plot(xy[::2], xy[1::2], color=colour, linewidth=0.75 * size, linestyle=dash)
    return found


def _paint_area(axes: Any, xy: list[float], size: Any, style: Any, colour: str) -> Any:
    (found,) = axes.fill(xy[::2], xy[1::2], facecolor=(colour, style), edgecolor=colour)
    found.set_linewidth(0.75 * size)
    return found


def _paint_disc(axes: Any, xy: list[float], size: Any, style: Any, colour: str) -> Any:
    from matplotlib.patches import Circle

    inside = (colour, style)
    return axes.add_patch(
        Circle((xy[0], xy[1]), xy[2], facecolor=inside, edgecolor=colour, linewidth=0.75 * size)
    )


def _paint_text(axes: Any, xy: list[float], size: Any, style: Any, colour: str) -> Any:
    side = "center" if style == "middle" else style
    return axes.text(*xy, size, color=colour, fontsize=7, ha=side, va="center", clip_on=True)


_PAINT = {"line": _paint_line, "area": _paint_area, "disc": _paint_disc, "text": _paint_text}
