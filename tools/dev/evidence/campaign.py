"""One run of a rig that is gone back to again and again: the same begin, other faults and draws.

Both nodes are in memory, so that a run is set back by writing its memory back: a thousand runs
with a fault take as long as their cycles, and each has the bits of a run of its own.
"""

import ctypes
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can.e2e_states import INJECTED, FrameState
from pcpc.executive.log.reader import FRAME
from pcpc.executive.loop import draws
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.events import Event
from pcpc.executive.loop.exchange import run_of
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.ring_layout import RECORD_HEAD, OfEvent, OfRecord
from pcpc.executive.loop.states import State
from pcpc.executive.nodes.virtual import VirtualRun
from pcpc.executive.rig.reading import Rig

WARM = 1000  # cycles before all that is compared
SPREAD = 100  # cycles over which the begin of a fault is drawn
AFTER = 60  # cycles that are looked at after it
NOTICED_BY = {  # what is told of a received value, and of a frame
    Event.IMPLAUSIBLE: "plausibility",
    Event.TWO_SENDERS: "two senders",
    Event.AHEAD: "counter ahead",
}
_RINGS = {*sh.RINGS, "histogram", "snapshot"}  # what is not written back


class FaultOutcome(NamedTuple):
    """What came of one run; cycles count from the first one in which the fault acted."""

    noticed: int | None
    by: str
    answer: str
    fault: str
    worst_rad: float


class Bench:
    """A rig, warmed up, that is set back before each run."""

    def __init__(self, rig: Rig, warm: int = WARM) -> None:
        self.run = VirtualRun(rig, None)
        self.loops = tuple(block.loop for block in self.run.blocks)
        self._go = run_of(len(self.loops))
        if warm:
            self.advance(warm)
        self._parts = [part for loop in self.loops for part in _to_set_back(loop)]
        self._saved = [part.copy() for part in self._parts]
        self._columns = [
            {name: RECORD_HEAD + i for i, name in enumerate(block.description["state_columns"])}
            for block in self.run.blocks
        ]
        self.places = [
            {variable[0]: i for i, variable in enumerate(block.description["variables"])}
            for block in self.run.blocks
        ]
        self._later = [
            {name for name, about in block.description["faults"].items() if about["next_cycle"]}
            for block in self.run.blocks
        ]

    def clean_error(self, cycles: int) -> NDArray[np.float64]:
        """Return the pointing error without a fault, rad, from the end of the warming on."""
        self.restore()
        self.advance(cycles)
        return self.column(1, "barrel.theta_rad")

    def run_once(self, faults: Sequence[str], cycles: int, seed: int) -> FaultOutcome:
        """Run once: all `faults` act from the same drawn cycle on, for `cycles`."""
        self.restore()
        begin = int(np.random.default_rng(seed).integers(2, SPREAD))
        self.schedule(
            [(WARM + begin, f"fault.{name}.left", float(cycles)) for name in faults], seed
        )
        self.advance(begin + cycles + AFTER)
        return self._seen(WARM + begin)

    def schedule(self, events: Sequence[tuple[int, str, float]], seed: int) -> None:
        """Let variables be set in cycles of this run, in each node that has them; seed the draws.

        A fault acts from its cycle on; `executive:NAME` is set in the executive alone.
        """
        seeds: list[int] = []
        for i, (loop, places) in enumerate(zip(self.loops, self.places, strict=True)):
            rows = []
            for at, name, value in events:
                place = places.get(name.removeprefix("executive:") if i == 0 else name)
                if place is not None:
                    fault = name.split(".")[1]
                    early = fault in self._later[i] and not self._is_peer(i, fault)
                    rows.append((at - early, place, value))
            tuning, faults = loop["tuning"], loop["faults"]
            last, count = int(tuning["n"]), int(faults["n"])
            for row, (at, place, value) in enumerate(sorted(rows), last):
                tuning["schedule"][row] = at, place
                tuning["value"][row] = value
            tuning["n"] = last + len(rows)
            seeds.extend(draws.first(seed, str(f)) for f in range(len(seeds), count))
            faults["seed"][:count] = seeds[:count]

    def _is_peer(self, node: int, name: str) -> bool:
        """Return whether the plant only knows of a stall of the executive, one cycle later."""
        places = self.loops[node].faults
        stalls = set(places.peer_stall[: int(places.n_peer_stalls)].tolist())
        return node == 1 and self.places[node][f"fault.{name}.left"] in stalls

    def advance(self, cycles: int) -> None:
        """Do some cycles."""
        self._go(self.loops, self.run.steps, cycles)

    def restore(self) -> None:
        """Be where the warming ended."""
        for part, saved in zip(self._parts, self._saved, strict=True):
            part[:] = saved
        for block in self.run.blocks:
            for ring in sh.RINGS:
                block.ends(ring).head = block[f"{ring}_taken"][0] = 0

    def column(self, node: int, name: str) -> NDArray[np.float64]:
        """Return a variable in the cycles since the run was set back."""
        return self.rows(node).view(np.float64)[:, self._columns[node][name]]

    def rows(self, node: int) -> NDArray[np.int64]:
        """Return the records of a node since then."""
        block = self.run.blocks[node]
        return np.asarray(block["record"][: int(block.ends("record").head)])

    def _seen(self, begin: int) -> FaultOutcome:
        first: list[tuple[int, int, str]] = []  # cycle, rank, who
        answer, fault = "none", ""
        for node, block in enumerate(self.run.blocks):
            rows = self.rows(node)
            cycle = rows[:, OfRecord.CYCLE]
            state, missing, code = (
                self.column(node, f"supervisor.{name}")
                for name in ("state", "missing_cycles", "fault")
            )
            after = cycle >= begin
            for rank, who, found in (
                (1, "missing input", after & (missing > 0) & (state < State.FAULT)),
                (2, "fault", after & (code != Fault.NONE)),
            ):
                if found.any():
                    first.append((int(cycle[found][0]), rank, who))
            if (state[after] == State.FAULT).any():
                number = int(block.control.fault)
                answer, fault = "FAULT", block.description["fault_names"][number]
            elif (state[after] == State.HOLD).any() and answer == "none":
                answer = "HOLD"
            told = block["event"][: int(block.ends("event").head)]
            for event, who in NOTICED_BY.items():
                cycles = told[told[:, OfEvent.CODE] == event, OfEvent.CYCLE]
                if len(cycles):
                    first.append((int(cycles[0]), 3, who))
            refused = self._refused_cycles(block)
            if len(refused):
                first.append((int(refused[0]), 0, "counter or CRC"))
        own = self.rows(1)[:, OfRecord.CYCLE] >= begin
        error = self.column(1, "barrel.theta_rad")[own]
        worst = float(np.abs(error).max()) if len(error) else 0.0
        if not first:
            return FaultOutcome(None, "", answer, fault, worst)
        soonest, _, who = min(first)
        return FaultOutcome(max(soonest - begin, 0), who, answer, fault, worst)

    @staticmethod
    def _refused_cycles(block: Any) -> NDArray[np.int64]:
        """Return the cycles in which a frame that a fault put on the way was not plainly used."""
        put = int(block.ends("frame").head)
        frames = np.ascontiguousarray(block["frame"][:put, 1:]).view(FRAME)[:, 0]
        state = frames["e2e"].astype(np.int64) - INJECTED
        return np.asarray(frames["cycle"][state >= FrameState.OK_SOME_LOST], np.int64)


def _to_set_back(loop: Any) -> Iterator[NDArray[np.uint8]]:
    """Yield the bytes of a node's memory that lie between its rings, each stretch as a whole."""
    places: dict[str, Any] = dict(sh.LOOP.fields or {})
    address = loop["seq"].ctypes.data - places["seq"][1]
    raw = np.ctypeslib.as_array((ctypes.c_uint8 * sh.LOOP.itemsize).from_address(address))
    first = 0
    for kind, place, *_ in sorted((places[name] for name in _RINGS), key=lambda it: it[1]):
        yield raw[first:place]
        first = place + kind.itemsize
    yield raw[first:]
