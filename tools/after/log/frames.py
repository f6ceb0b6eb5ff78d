"""The frames of a log in the order of the bus, each once, and the choice of those to play.

All nodes of a run record what they send and what they receive, so most frames stand in a log
twice or more. A frame counts at the stamp of its sender; what only a receiver has (the sender's
record is lost, the sender was no node of the run) counts at the receiver's stamp.

    a received record is a copy of the first sent one with the same id, length and data that is not
    used yet and not later than SLACK_NS behind it

Equal stamps, as virtual time has them, keep the order in which the recording node (the executive,
or the only one) had the frames.
"""

from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id
from pcpc.drivers.can.wire_layout import Flag
from pcpc.drivers.errors import UserError
from pcpc.executive.errors import did_you_mean
from pcpc.executive.log import reader as logs
from pcpc.executive.rig.roles import PLANTS

PEER = {"executive": "plant", "plant": "executive"}
SLACK_NS = 1_000_000  # a sender stamps after sending, so the receiver may be earlier
Ints = NDArray[np.int64]  # (n,)
_COLUMNS = [("stamp_ns", "<i8"), ("cycle", "<i8"), ("place", "<i8"), ("sender", "u1")]


class PlayError(UserError):
    """There is nothing to play."""


@dataclass(frozen=True)
class LoggedFrames:
    """Frames in the order of the bus: `stamp_ns`, `cycle` (n,) int64, `sender` (n,), `raw`.

    `raw` (n, bytes) is as of `reader.on_bus`, `sender` an index into `senders`, `cycle` the
    recording node's, never falling. `names`: id -> name. `left_out`: remote and error frames of
    the log.
    """

    stamp_ns: Ints
    cycle: Ints
    sender: NDArray[np.uint8]
    raw: NDArray[np.uint8]
    senders: tuple[str, ...]
    names: Mapping[int, str]
    period_ns: int
    left_out: int

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def words(self) -> Ints:
        """Return the ids with SocketCAN's flags, (n,)."""
        return self.raw[:, :4].copy().view("<u4")[:, 0].astype(np.int64)

    @property
    def span_ns(self) -> int:
        """Return the time from the first frame to the last."""
        return int(self.stamp_ns[-1] - self.stamp_ns[0]) if len(self) else 0

    def sent_by(self, name: str) -> NDArray[np.bool_]:
        """Return which frames node `name` sent, (n,)."""
        return np.array(self.senders)[self.sender] == name

    def keep(self, chosen: NDArray[np.bool_]) -> "LoggedFrames":
        """Return the chosen frames only."""
        return replace(
            self,
            stamp_ns=self.stamp_ns[chosen],
            cycle=self.cycle[chosen],
            sender=self.sender[chosen],
            raw=self.raw[chosen],
        )

    def label(self, i: int) -> str:
        """Return the name of frame i, or its id as candump writes it."""
        word = int(self.words[i])
        return self.names.get(word & can_id.ID, can_id.text_of(word))


def bus_frames(log: logs.Log) -> LoggedFrames:
    """Return all data frames of a log, each once; PlayError if there is none."""
    nodes = [name for name in log.node if len(log.node[name].frames)]
    if not nodes:
        lost = f" ({'; '.join(log.missing)})" if log.missing else ""
        raise PlayError(f"{log.path}: holds no frames{lost}; play another log")
    senders = tuple(dict.fromkeys([*nodes, *map(_peer_of, nodes)]))
    rows = _rows(log, nodes[0], senders)
    for node in nodes[1:2] if "local" in nodes else nodes[1:]:  # those who share its bus
        rows = _merged_frames(rows, _rows(log, node, senders), senders.index(node))
    rows = rows[np.lexsort((rows["place"], rows["stamp_ns"]))]
    flags = rows["frame"][:, 3] & ((can_id.REMOTE | can_id.ERROR) >> 24)
    data = rows[flags == 0]
    if not len(data):
        raise PlayError(f"{log.path}: holds only remote and error frames; play another log")
    return LoggedFrames(
        data["stamp_ns"].copy(),
        np.maximum.accumulate(data["cycle"]),
        data["sender"].copy(),
        data["frame"].copy(),
        senders,
        logs.frame_names(log),
        _period_ns(log, data["stamp_ns"]),
        len(rows) - len(data),
    )


def _rows(log: logs.Log, node: str, senders: Sequence[str]) -> NDArray[np.void]:
    """Return a node's frames in file order."""
    frames = log.node[node].frames
    raw = logs.on_bus(frames)
    rows = np.zeros(len(frames), [*_COLUMNS, ("frame", "u1", raw.shape[1:])])
    rows["stamp_ns"], rows["cycle"] = frames["stamp_ns"], frames["cycle"]
    rows["place"] = np.arange(len(frames))
    peer = senders.index(_peer_of(node))
    rows["sender"] = np.where(frames["direction"] == 0, senders.index(node), peer)
    rows["frame"] = raw
    return rows


def _peer_of(node: str) -> str:
    """Return from whom a node has what it received, unless the sender's own record tells more."""
    return "executive" if node in PLANTS else PEER.get(node, "the bus")


def _merged_frames(own: NDArray[np.void], other: NDArray[np.void], number: int) -> NDArray[np.void]:
    """Return the frames of two records, each once; `own` (sender 0) gives place and cycle.

    `number`: of the sender of `other`.
    """
    sent = other["sender"] == number
    own_sent, other_sent = own[own["sender"] == 0], other[sent]
    received, other_received = own[own["sender"] != 0], other[~sent]
    source = copies(other_sent, received)
    known = source >= 0
    received["stamp_ns"][known] = other_sent["stamp_ns"][source[known]]
    received["sender"][known] = number
    unheard = np.ones(len(other_sent), bool)
    unheard[source[known]] = False
    unrecorded = copies(own_sent, other_received) < 0
    extra = np.concatenate([other_sent[unheard], other_received[unrecorded]])
    extra["place"] += len(own)
    return np.concatenate([own_sent, received, extra])


def copies(sent: NDArray[np.void], received: NDArray[np.void]) -> Ints:
    """Return for each received row the sent row that it is a copy of, -1 for none. All (n,)."""
    waiting: dict[bytes, deque[int]] = defaultdict(deque)
    for i, key in enumerate(_keys(sent)):
        waiting[key].append(i)
    stamps = sent["stamp_ns"].tolist()
    sources = np.full(len(received), -1, np.int64)
    latest = (received["stamp_ns"] + SLACK_NS).tolist()
    for k, (key, until) in enumerate(zip(_keys(received), latest, strict=True)):
        queue = waiting.get(key)
        if queue and stamps[queue[0]] <= until:
            sources[k] = queue.popleft()
    return sources


def _keys(rows: NDArray[np.void]) -> list[bytes]:
    text, size = rows["frame"].tobytes(), rows["frame"].shape[1]
    return [text[i : i + size] for i in range(0, len(text), size)]


def _period_ns(log: logs.Log, stamp_ns: Ints) -> int:
    """Return the period of the log's rig; without one the mean distance of its frames."""
    for facts in log.metadata.values():
        text = facts.get("period_ns", "")
        if text.isdigit() and int(text) > 0:
            return int(text)
    return max(int(stamp_ns[-1] - stamp_ns[0]) // max(len(stamp_ns) - 1, 1), 1)


def choose(
    frames: LoggedFrames,
    log: str,
    role: str | None = None,
    only: Sequence[str] = (),
    start_s: float = 0.0,
    duration_s: float | None = None,
) -> LoggedFrames:
    """Return the frames that --as, --only, --start and --duration ask for; PlayError if none."""
    begin_ns, recorded_s = int(frames.stamp_ns[0]), 1e-9 * frames.span_ns
    if role is not None:
        frames = frames.keep(frames.sent_by(role))
        if not len(frames):
            raise PlayError(f"{log}: holds no frames of the {role}; leave out --as")
    if only:
        frames = frames.keep(_named_frames(frames, only, log))
    since_ns = frames.stamp_ns - begin_ns
    start_ns = round(1e9 * start_s)
    chosen = since_ns >= start_ns
    if duration_s is not None:
        chosen &= since_ns < start_ns + round(1e9 * duration_s)
    if not chosen.any():
        raise PlayError(
            f"{log}: no such frame from {start_s:g} s on; the recording lasts "
            f"{recorded_s:.3f} s: change --start or --duration"
        )
    return frames.keep(chosen)


def _named_frames(frames: LoggedFrames, wanted: Sequence[str], log: str) -> NDArray[np.bool_]:
    """Return which frames have one of the names or hexadecimal ids; PlayError for an unknown."""
    words = frames.words
    ids = {name: number for number, name in frames.names.items()}
    chosen = np.zeros(len(frames), bool)
    for text in wanted:
        if text in ids:
            these = words & can_id.ID == ids[text]
        else:
            these = words == _id_word(text, frames, log)
        if not these.any():
            firsts = np.unique(words, return_index=True)[1].tolist()
            there = ", ".join(sorted(set(map(frames.label, firsts))))
            raise PlayError(f"{log}: --only {text}: no such frame to play; there are {there}")
        chosen |= these
    return chosen


def _id_word(text: str, frames: LoggedFrames, log: str) -> int:
    """Return a hexadecimal id with its flag; as with candump eight digits mean an extended one."""
    try:
        number = int(text, 16)
    except ValueError:
        hint = did_you_mean(text, frames.names.values())
        raise PlayError(
            f"{log}: --only {text}: neither a frame nor a hexadecimal id{hint}"
        ) from None
    digits = text.lower().removeprefix("0x")
    return can_id.word_of(number, len(digits) == 8 or number > 0x7FF)


def cycles(frames: LoggedFrames) -> Ints:
    """Return where each cycle begins, and the end, (cycles + 1,)."""
    begins = np.flatnonzero(np.diff(frames.cycle)) + 1
    return np.concatenate([[0], begins, [len(frames)]])


def payload(frame: Any) -> str:
    """Return the data of a recorded frame."""
    return bytes(frame["data"][: int(frame["dlc"])]).hex().upper()


def frame_text(frame: Any) -> str:
    """Return a recorded frame as candump writes it."""
    flags = int(frame["flags"])
    mark = f"##{flags & (Flag.BRS | Flag.ESI):X}" if flags & Flag.FD else "#"
    return f"{can_id.text_of(int(frame['id']))}{mark}{payload(frame)}"
