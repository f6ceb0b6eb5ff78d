"""What `pcpc bus --plot` draws: the fullest cycle of each bus, every frame at its longest.

In the first cycle all frames are due, slow ones too, each node's at its phase; nodes whose phases
may be any begin together. A bar is light while the frame waits and dark on the wire; a circle marks
its worst-case response, a cross when it is needed.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pcpc.executive.rig.reading import Rig
from pcpc.plants.pages import BLUE, GREEN, GREY, ORANGE, SKY, VERMILION, bare, sheet
from pcpc.tools.start.bus import traffic
from pcpc.tools.start.bus.phase_bounds import QueuedFrame, Wire
from pcpc.tools.start.bus.report import BusReport, rate_of
from pcpc.tools.terminal.outfile import new_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = (BLUE, VERMILION, GREEN, ORANGE, SKY, GREY)  # of senders
_CYCLES, _ROW_IN = 2, 0.24


def arbitration(frames: Sequence[QueuedFrame], wire: Wire) -> list[tuple[int, int, int, int]]:
    """Return (place in `frames`, due, begun, ended) of the frames of the first cycles, by time."""
    coming = sorted(
        (cycle * wire.cycle_ns + (k.phase_ns or 0), k.place, m)
        for m, k in enumerate(frames)
        for cycle in range(_CYCLES)
        for _ in range(k.count)
        if cycle % max(1, round(k.period_ns / wire.cycle_ns)) == 0
    )
    waiting: list[tuple[int, int, int]] = []
    found, now = [], 0
    while coming or waiting:
        now = now if waiting else max(now, coming[0][0])
        waiting += [one for one in coming if one[0] <= now]
        coming = coming[sum(one[0] <= now for one in coming) :]
        heads: dict[str, tuple[int, int, int]] = {}
        for one in waiting if wire.in_order else sorted(waiting, key=lambda one: one[2]):
            heads.setdefault(frames[one[2]].node, one)
        due, place, m = min(heads.values(), key=lambda one: one[2])
        waiting.remove((due, place, m))
        found.append((m, due, now, now := now + frames[m].transmission_ns))
    return found


def draw(rig: Rig, buses: Sequence[BusReport], path: Path) -> None:
    """Draw all buses below each other; OSError."""
    heights = [1.2 + _ROW_IN * len(bus.rows) for bus in buses]
    page, column = sheet((9.0, sum(heights)), 110, len(buses), squeeze=False, height_ratios=heights)
    for axis, bus in zip(column[:, 0], buses, strict=True):
        _draw_bus(axis, bus)
        rate = f"{rig.config.rate_hz:g} Hz, {rate_of(bus.setup.bitrate)}"
        axis.set_title(f"{rig.config.rig}, {bus.name}: {rate}", loc="left", fontsize=10)
    with new_file(path, force=True) as unfinished:
        page.savefig(unfinished)


def _draw_bus(axis: "Axes", bus: BusReport) -> None:
    frames, wire = traffic.queue_of(bus.frames, bus.setup)
    senders = list(dict.fromkeys(k.node for k in frames))
    colours = {name: _COLOURS[i % len(_COLOURS)] for i, name in enumerate(senders)}
    sent = arbitration(frames, wire)
    last_us = max(ended for *_, ended in sent) / 1e3
    waits = {(m, due): begun for m, due, begun, _ in sent}  # of those that come together the last
    for (m, due), begun in waits.items():
        colour = colours[frames[m].node]
        axis.barh(m, (begun - due) / 1e3, left=due / 1e3, height=0.5, color=colour, alpha=0.25)
    for m, _, begun, ended in sent:
        colour = colours[frames[m].node]
        axis.barh(m, (ended - begun) / 1e3, left=begun / 1e3, height=0.7, color=colour)
    for m, (k, row) in enumerate(zip(frames, bus.rows, strict=True)):
        for ns, mark in ((row.response_ns, "o"), (row.deadline_ns, "x")):
            if ns is not None and (at_us := ((k.phase_ns or 0) + ns) / 1e3) <= 1.05 * last_us:
                axis.plot(at_us, m, mark, color="black", markersize=4, markerfacecolor="none")
    for name, colour in colours.items():
        axis.barh(0, 0, color=colour, label=name)
    axis.set_yticks(range(len(frames)), [one.frame.name for one in bus.frames], fontsize=8)
    axis.invert_yaxis()
    axis.set_xlim(0.0, 1.05 * last_us)
    axis.set_xlabel("us; light: waiting, dark: on the wire, o worst case, x needed", fontsize=8)
    bare(axis, axis="x")
    axis.set_axisbelow(True)
    axis.legend(
        frameon=False, fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(colours)
    )
