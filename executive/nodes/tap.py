"""Every cycle, frame and event of a running node, beside its recorder.

    tap = Tap(live)
    rows = tap.rows()          the cycles since the last look: rows.cycle, rows["controller.e_rad"]
    tap.frames(), tap.events() the same of what went over the bus, of what happened

The rings have one reader that counts for the loop, the recorder. A tap reads the same rows with a
place of its own, which the node does not know: it costs the loop nothing and never holds it. A row
is there until the ring has come round; what was overwritten before it was read is counted in
`missed`. Where no recorder takes rows, the rings fill up and nothing new comes (`stuck`).
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.executive.log.description import node_description
from pcpc.executive.log.event_entries import entry_of
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.ring_layout import RECORD_HEAD, OfEvent, OfRecord, frame_words
from pcpc.executive.nodes.live import Live, known_name
from pcpc.executive.nodes.rings import put


@dataclass(frozen=True)
class Rows:
    """Recorded variables of successive cycles.

    cycle     (n,) int64
    stamp_ns  (n,) int64, when each woke, on the clock of the node
    values    (n, columns) float64, of the columns `places`
    """

    cycle: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    values: NDArray[np.float64]
    places: dict[str, int]

    def __len__(self) -> int:
        return len(self.cycle)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Return a variable's values; LiveError if no row has it."""
        return self.values[:, self.places[known_name(name, self.places)]]


class Tap:
    """A place in the rings of a node; begins with what is put from now on.

    `past`: with what the rings hold, but for the oldest quarter, which may go at any moment.
    `names`: of the recorded variables only these, which a node on another machine sends sooner.
    """

    def __init__(
        self, live: Live, past: bool = False, names: Collection[str] | None = None
    ) -> None:
        self.live = live
        columns = columns_of(live.block.description)
        self.names = tuple(name for name in columns if names is None or name in names)
        self._columns = [OfRecord.CYCLE, OfRecord.STAMP_NS, *(columns[name] for name in self.names)]
        self._places = {name: place for place, name in enumerate(self.names)}
        self._next = {ring: put(live.block, ring) for ring in sh.RINGS}
        if past:
            held = {ring: 3 * self._size(ring) // 4 for ring in sh.RINGS}
            self._next = {ring: max(end - held[ring], 0) for ring, end in self._next.items()}
        self.missed = dict.fromkeys(sh.RINGS, 0)

    @property
    def stuck(self) -> bool:
        """Whether a ring is full, as nobody records the node: nothing new comes."""
        return any(int(self.live.block.ends(ring).dropped) > 0 for ring in sh.RINGS)

    def rows(self) -> Rows:
        """Return the cycles since the last look."""
        taken = self.raw("record", self._columns)
        return Rows(taken[:, 0], taken[:, 1], taken[:, 2:].view(np.float64), self._places)

    def frames(self) -> NDArray[np.int64]:
        """Return the frames since the last look, (n, columns); see `executive.loop.shared`."""
        return self.raw("frame")

    def events(self) -> Iterator[tuple[int, str, dict[str, Any]]]:
        """Yield cycle, topic and entry of what happened since the last look."""
        for row in self.raw("event"):
            yield (
                int(row[OfEvent.CYCLE]),
                *entry_of(row, node_description(self.live.block.description)),
            )

    def _size(self, ring: str) -> int:
        """Return how many rows a ring holds."""
        about = self.live.block.description
        own = sh.RECORD_RING_WORDS // int(about["record_columns"])
        frames = sh.FRAME_RING_WORDS // frame_words(about)
        return {"record": own, "frame": frames, "event": sh.EVENT_RING_ROWS}[ring]

    def raw(self, ring: str, columns: Sequence[int] | None = None) -> NDArray[np.int64]:
        """Return the rows of a ring since the last look as the node wrote them, or some columns.

        They are copies of rows that were whole when they were copied. Shape (n, columns).
        """
        rows, first = self.live.rows(ring, self._next[ring], columns)
        self.missed[ring] += first - self._next[ring]
        self._next[ring] = first + len(rows)
        return rows


def columns_of(about: Mapping[str, Any]) -> dict[str, int]:
    """Return the places of a node's recorded variables in a row of its ring, by name."""
    states, timings = about["state_columns"], about["timing_columns"]
    behind = RECORD_HEAD + len(states) + 1
    places = [*range(RECORD_HEAD, behind - 1), *range(behind, behind + len(timings))]
    return dict(zip((*states, *timings), places, strict=True))
