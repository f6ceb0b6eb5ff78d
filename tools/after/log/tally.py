"""What the messages of a log add up to, without keeping them: cycles, frames, events, bytes."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.can.e2e_states import are_of_wire, name_of
from pcpc.drivers.can.frame_bits import frame_bits
from pcpc.executive.log import checks as log_checks
from pcpc.executive.log import reader as logs
from pcpc.executive.log.inventory import TOPICS
from pcpc.executive.log.mcap_reader import Scan
from pcpc.tools.after.log.contents import DIRECTIONS, Cycles, Entry, FrameRow, TopicRow

_KEY = [("id", "<u4"), ("direction", "u1"), ("e2e", "u1"), ("dlc", "u1"), ("flags", "u1")]
_AT_ONCE = 100_000  # frames counted at once
_NAME = 80  # letters of a name that are shown


@dataclass
class Tally:
    """Sums by topic; `first_ns`, `last_ns` are wall times."""

    found: Scan
    first_ns: dict[str, int] = field(default_factory=dict)
    last_ns: dict[str, int] = field(default_factory=dict)
    messages: Counter[str] = field(default_factory=Counter)
    bytes: Counter[str] = field(default_factory=Counter)
    _steps: dict[str, list[int]] = field(default_factory=dict)  # first, last
    _left_out: Counter[str] = field(default_factory=Counter)
    _entries: dict[str, list[tuple[int, Any]]] = field(default_factory=dict)
    _frames: Counter[tuple[Any, ...]] = field(default_factory=Counter)  # topic, values of _KEY
    _keys: dict[str, list[NDArray[np.uint64]]] = field(default_factory=dict)
    _waiting: int = 0

    def add(self, channel: int, rows: NDArray[Any]) -> None:
        """Take messages (n,) of one channel."""
        topic = self.found.topic(channel)
        if not topic:
            return
        self.first_ns.setdefault(topic, int(rows["log_time"][0]))
        self.last_ns[topic] = int(rows["log_time"][-1])
        self.messages[topic] += len(rows)
        self.bytes[topic] += rows["data"].size
        kind = topic.rpartition("/")[2]
        if kind == "state":
            self._step(topic, rows["sequence"].astype(np.int64))
        elif kind == "frames" and rows["data"].shape[1] - logs.CDR_BYTES in logs.FRAME_SIZES:
            self._take_frames(topic, rows)
        elif kind in ("events", "tunings"):
            entries = self._entries.setdefault(topic, [])
            for at_ns, row in zip(rows["log_time"].tolist(), rows["data"], strict=True):
                entry = log_checks.entry(row.tobytes())
                if entry is None:
                    self._left_out[topic] += 1
                else:
                    entries.append((at_ns, entry))

    def _step(self, topic: str, sequence: NDArray[np.int64]) -> None:
        step = self._steps.setdefault(topic, [int(sequence[0]), int(sequence[0])])
        step[1] = int(log_checks.unwrapped_cycles(sequence, step[1])[-1])

    def _take_frames(self, topic: str, rows: NDArray[Any]) -> None:
        data, sane = logs.frames_in(rows)
        self._left_out[topic] += len(data) - int(sane.sum())
        keys = data[sane][[name for name, _ in _KEY]].astype(_KEY).view(np.uint64)
        self._keys.setdefault(topic, []).append(keys)
        self._waiting += len(rows)
        if self._waiting >= _AT_ONCE:
            self._settle()

    def _settle(self) -> None:
        """Count the frames whose keys wait."""
        for topic, pieces in self._keys.items():
            keys, counts = np.unique(np.concatenate(pieces), return_counts=True)
            for key, n in zip(keys.view(_KEY).tolist(), counts.tolist(), strict=True):
                self._frames[(topic, *key)] += n
        self._keys, self._waiting = {}, 0

    def cycles(self, topic: str) -> Cycles:
        """Return count, first and last of a node's cycles, and how many between are not there.

        `skipped`: the loop had no time for them, and says so; `lost`: the log has no row of them.
        """
        if topic not in self._steps:
            return {"cycles": 0, "first": None, "last": None, "skipped": 0, "lost": 0}
        first, last = self._steps[topic]
        count = self.messages[topic]
        gone = max(last - first + 1 - count, 0)  # cycles out of order are none that are gone
        skipped = min(self._skipped_cycles(topic.removesuffix("state") + "events"), gone)
        return {
            "cycles": count, "first": first, "last": last, "skipped": skipped,
            "lost": gone - skipped,
        }  # fmt: skip

    def _skipped_cycles(self, events: str) -> int:
        """Return how many cycles the events of a node call skipped."""
        told = (entry for _, entry in self._entries.get(events, []))
        counts = (one.get("argument", 0) for one in told if one.get("event") == "skip")
        return sum(count for count in counts if count > 0)

    def left_out(self) -> list[str]:
        """Return a line for each topic of which messages are not counted: they make no sense."""
        return senseless(self._left_out)

    def duration_s(self, topic: str) -> float:
        """Return the time from the first message of a topic to its last."""
        return (self.last_ns.get(topic, 0) - self.first_ns.get(topic, 0)) / 1e9

    def heard(self) -> str:
        """Return the node whose frames are told: the executive, in a log without it the plant."""
        with_frames = (n for n in logs.NODES if self.messages[logs.topic(n, "can/frames")])
        return next(with_frames, logs.NODES[0])

    def frames(
        self, names: Mapping[int, str], duration_s: float, node: str = "", data_bit: float = 1
    ) -> list[FrameRow]:
        """Return a node's frames by direction and id; without one those of the node `heard`.

        `bits`: on the wire, at most; what was injected was on none. One of CAN FD's data phase
        counts as `data_bit`.
        """
        self._settle()
        heard = logs.topic(node or self.heard(), "can/frames")
        total: Counter[tuple[int, int]] = Counter()
        bits: dict[tuple[int, int], float] = defaultdict(int)
        for (topic, number, direction, state, size, flags), n in self._frames.items():
            if topic == heard:
                total[direction, number] += n
                wired = n if are_of_wire(state) else 0
                nominal, data = frame_bits(size, number > can_id.ID, flags)
                bits[direction, number] += wired * (nominal + data_bit * data)
        return [
            {"name": names.get(number, ""), "id": can_id.text_of(number),
             "direction": DIRECTIONS[direction], "count": n, "bits": bits[direction, number],
             "rate_hz": round(n / duration_s, 1) if duration_s else None}
            for (direction, number), n in sorted(total.items())
        ]  # fmt: skip

    def e2e(self, nodes: Iterable[str]) -> Mapping[str, Mapping[str, int]]:
        """Return how many received frames were not OK, by node and state of the check."""
        self._settle()
        bad: dict[str, Counter[str]] = {name: Counter() for name in nodes}
        for (topic, _, direction, state, *_), n in self._frames.items():
            name = TOPICS.get(topic, ("",))[0]
            if direction == 1 and state and name in bad:
                bad[name][name_of(state)] += n
        return bad

    def entries(self, kind: str, zero_ns: int) -> list[Entry]:
        """Return the events or tunings of all nodes by time, `time_s` after `zero_ns`.

        What others may have added to them is left out.
        """
        timed_entries: list[tuple[int, Any]] = [
            (
                at_ns,
                {"time_s": (at_ns - zero_ns) / 1e9, "node": node}
                | {key: entry[key] for key in log_checks.PARTS if key in entry},
            )
            for node in logs.NODES
            for at_ns, entry in self._entries.get(logs.topic(node, kind), [])
        ]
        return [entry for _, entry in sorted(timed_entries, key=lambda pair: pair[0])]

    def topics(self) -> list[TopicRow]:
        """Return messages and bytes, as they were before compression, of all topics."""
        names = (channel.topic for channel in self.found.channels.values())
        return [{"topic": n, "messages": self.messages[n], "bytes": self.bytes[n]} for n in names]


def senseless(left_out: Mapping[str, int]) -> list[str]:
    """Return a line for each topic with so many messages that make no sense."""
    return [
        f"{shortened_name(topic)}: {n} messages make no sense" for topic, n in left_out.items() if n
    ]


def shortened_name(name: str) -> str:
    """Return a name from a file, as long as a line can hold."""
    return name if len(name) <= _NAME else f"{name[: _NAME - 3]}..."
