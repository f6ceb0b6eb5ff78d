"""What an independent watch of a run makes of the frames on its bus; no bus, no clock.

    away     a frame did not come for `silent_cycles`; a slow one for 3 of its cycles, if longer
    wrong    of the last 10 frames of an id, `wrong_frames` had a wrong CRC, length or counter, or a
             value that is not finite, outside its limits, or faster than its rate

The watch begins with the executive's first state but INIT and ends with its STOP; a node that tells
it stopped may be silent. Without a clock (lockstep) only what a single frame shows is judged: CRC,
length, values.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import codec, dbc, e2e
from pcpc.drivers.can.e2e_states import FrameState, name_of
from pcpc.drivers.can.wire_layout import FRAME_BYTES
from pcpc.executive.loop.states import HEARTBEATS, State
from pcpc.executive.rig import messages
from pcpc.executive.rig.bus_keys import Watchdog
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.executive.rig.schema import Limit

_RECENT = 10  # frames, of which some are wrong
_SLOW = 3  # cycles of a slow frame, as in the verdict


class _Limits(NamedTuple):
    """Of a value: its bounds, the most that it may change a cycle, what rounding adds to that."""

    low: float
    high: float
    step: float
    slack: float


@dataclass
class _Frame:
    """A frame that has to come: who sends it, what it may hold, when it came last (in cycles)."""

    frame: dbc.Frame
    role: Role
    every_n: int
    limits: dict[int, _Limits]  # by place of the value
    last: float = 0.0
    values: dict[int, float] = field(default_factory=dict)
    wrong: deque[str] = field(default_factory=lambda: deque(maxlen=_RECENT))


class FrameJudge:
    """What is judged, without bus and clock: frames go in by `heard`, troubles come out."""

    def __init__(self, rig: Rig, clocked: bool) -> None:
        config = rig.config
        self.settings, self.clocked = config.watchdog or Watchdog(), clocked
        database = messages.database_of(rig)
        on_bus = messages.frames_by_bus(rig, database)[0]
        self.rows = [
            _Frame(frame, role, frame.every_n(config.rate_hz), {})
            for role, node in config.sections.items()
            for frame in dbc.frames(database, node.node, "tx")
            if frame.name in on_bus
        ]
        frames = [row.frame for row in self.rows]
        names = [f"{f.name}.{s.name}" for f in frames for s in f.signals]
        self.places = {name: place for place, name in enumerate(names)}
        self.table = dbc.table(frames, config.rate_hz, self.places)
        self.tables = self.table.frames, self.table.signals
        self.by_word = {frame.word: row for row, frame in enumerate(frames)}
        self.values, self.state = np.zeros(len(names)), e2e.new_state(len(frames))
        self._take_limits(rig)
        blank = np.zeros(FRAME_BYTES, np.uint8)  # compiled before the first frame comes
        length = codec.length_of(blank, 0, self.table.frames)
        e2e.check(blank[8:], int(length), 0, self.table.frames, self.state.copy())
        codec.unpack(blank[8:], 0, *self.tables, self.values)
        self.ends = {  # place of the value in which a node tells its end, and that value
            role: [
                (
                    self.places[name],
                    float(State.STOP) if source == "supervisor.state" else HEARTBEATS[State.STOP],
                )
                for source in ("supervisor.state", "supervisor.nmt")
                for name, given in rig.nodes()[role].transmit.items()
                if given == source and name in self.places
            ][:1]
            for role in config.sections
        }
        end_places = {place for ends in self.ends.values() for place, _ in ends}
        own = [[self.places[f"{f.name}.{s.name}"] for s in f.signals] for f in frames]
        self.read = {  # rows of frames whose values matter
            i for i, row in enumerate(self.rows) if row.limits or end_places.intersection(own[i])
        }
        self.stated: dict[Role, float] = {}  # in which state each node says it is
        self.armed, self.begun, self.cycle = False, 0.0, 0.0  # in cycles of the rig
        self.stop_frame = dbc.frame(database.get_message_by_name(messages.stop_frame_of(rig)))

    def _take_limits(self, rig: Rig) -> None:
        """Note what may be wrong with values: limits, rates a cycle, and floats that are none."""
        for row in self.rows:
            limits = rig.nodes()[row.role].limits
            for signal in row.frame.signals:
                name = f"{row.frame.name}.{signal.name}"
                if name not in limits and not signal.is_float:
                    continue
                limit = limits.get(name, Limit())
                rate = limit.rate_per_s
                step = math.inf if rate is None else rate / rig.config.rate_hz
                slack = 0.0 if signal.is_float else abs(signal.factor)
                bounds = limit.low - slack, limit.high + slack
                row.limits[self.places[name]] = _Limits(*bounds, step, slack)

    def judge(self, frames: NDArray[np.uint8]) -> None:
        """Judge frames (k, 72) that came up to now."""
        words = frames[:, :4].copy().view("<u4")[:, 0].tolist()
        for data, word in zip(frames, words, strict=True):
            row = self.by_word.get(word)
            if row is not None:
                self._judge(row, data)

    def _judge(self, row: int, data: NDArray[np.uint8]) -> None:
        watched = self.rows[row]
        frames = self.table.frames
        length = int(codec.length_of(data, row, frames))
        state, missing = e2e.check(data[8:], length, row, frames, self.state)
        watched.last, why = self.cycle, ""
        if state in (FrameState.OK, FrameState.OK_SOME_LOST) and row in self.read:
            codec.unpack(data[8:], row, *self.tables, self.values)
            why = self._value_trouble(watched, int(missing) + 1)
            self._note_state(watched.role)
        elif state not in (FrameState.OK, FrameState.OK_SOME_LOST) and (
            self.clocked or state == FrameState.ERROR
        ):
            watched.values.clear()
            why = f"is {name_of(state)}"
        watched.wrong.append(why)

    def _value_trouble(self, watched: _Frame, turns: int) -> str:
        """Return what is wrong with the values of a frame, the first of them."""
        trouble = ""
        for place, (low, high, step, slack) in watched.limits.items():
            value, before = float(self.values[place]), watched.values.get(place, math.nan)
            watched.values[place] = value
            if not low <= value <= high:
                trouble = trouble or f"holds {self._name(place)} = {value:g}, outside its limits"
            elif self.clocked and abs(value - before) > step * watched.every_n * turns + slack:
                trouble = (
                    trouble or f"holds {self._name(place)}, which changes faster than its rate"
                )
        return trouble

    def _name(self, place: int) -> str:
        return list(self.places)[place].partition(".")[2]

    def _note_state(self, role: Role) -> None:
        """Take a node at its word about its state; the executive's begins and ends the watch."""
        for place, _ in self.ends[role]:
            self.stated[role] = float(self.values[place])
        if role == "executive":
            runs = self.stated[role] not in (State.INIT, State.STOP)
            if runs and not self.armed:
                self.state[:] = e2e.new_state(len(self.rows))
                self.begun = self.cycle
                for watched in self.rows:
                    watched.last = self.cycle
                    watched.wrong.clear()
                    watched.values.clear()
            self.armed = runs

    def troubles(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong now: of which node, frame or all, and what it is in words."""
        if not self.armed:
            return
        for role, ends in self.ends.items():
            stopped = any(self.stated.get(role) == end for _, end in ends)
            away = [one for one in self.rows if one.role == role and self._is_away(one)]
            if away and not stopped:
                more = f" and {len(away) - 1} more" if len(away) > 1 else ""
                cycles = f"for {self.cycle - away[0].last:.0f} cycles"
                yield role, f"{role}: {away[0].frame.name}{more} did not come {cycles}"
        for watched in self.rows:
            wrong = [why for why in watched.wrong if why]
            if len(wrong) >= self.settings.wrong_frames:
                many = f"{len(wrong)} of the last {len(watched.wrong)} are wrong"
                yield (
                    watched.frame.name,
                    f"{watched.role}: {watched.frame.name} {wrong[-1]}; {many}",
                )

    def _is_away(self, watched: _Frame) -> bool:
        slow = _SLOW * watched.every_n if watched.every_n > 1 else 0
        allowed = max(self.settings.silent_cycles + watched.every_n - 1, slow)
        return self.clocked and self.cycle - watched.last > allowed and not watched.frame.on_event
