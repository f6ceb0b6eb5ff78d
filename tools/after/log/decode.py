"""The signals of recorded frames, by id: with the loop's own tables, else with cantools.

A frame that the tables hold is judged and decoded by the functions of the loop: counter and CRC are
checked and are no signals; a frame that is not OK is not decoded. A signal that is not in a frame's
layout keeps its value, at first NaN.
If more than half of an id's frames fail, then their CRC is another one than the loop's: they are
decoded unchecked, and the report says so. A cycle time is not asked for. The rest goes through
cantools. A file that is not strictly right (overlapping signals, ...) is read as far as possible.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import can_id, codec, dbc, e2e
from pcpc.drivers.can.dbc_file import Database, Error, Message
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.compiled.jit import compiled
from pcpc.drivers.errors import BusError
from pcpc.tools.terminal.outfile import LogCommandError
from pcpc.tools.terminal.progress import Progress

_STEP = 20_000  # frames from one look at the progress to the next
_NOT_DECODABLE = (  # what cantools raises for a frame that its message does not fit
    Error, ValueError, TypeError, LookupError, AttributeError, ArithmeticError,
)  # fmt: skip


@dataclass(frozen=True)
class DecodedFrames:
    """The frames of one id.

    `signals`: name, unit, help. `place` (n,): of the decoded ones among all frames; `values`
    (n, signals). `state`: of all of this id, as in drivers.can.e2e. `lost`: by the counters.
    """

    message: Message
    signals: list[tuple[str, str, str]]
    place: NDArray[np.int64]
    values: NDArray[np.float64]
    state: NDArray[np.int64]
    lost: int
    checked: bool  # by the loop's own rules
    foreign_crc: bool


def load(path: Path) -> Database:
    """Read a DBC file, strictly if it is so; LogCommandError."""
    try:
        return dbc.load(path)
    except BusError as error:
        try:
            return dbc.parse(path, dbc.text(path), strict=False)
        except BusError:  # said above
            raise LogCommandError(str(error)) from None


@compiled()
def _walk(
    data: Any,
    length: Any,
    frames: Any,
    signals: Any,
    state: Any,
    values: Any,
    outcome: Any,
    check: Any,
) -> int:
    lost = 0
    for i in range(data.shape[0]):
        outcome[i] = FrameState.OK
        if check:
            outcome[i], before = e2e.check(data[i], length[i], 0, frames, state)
            lost += before
        if frames[0].selector != 0:
            values[i] = values[max(i - 1, 0)]
            if length[i] != frames[0].dlc or outcome[i] > FrameState.OK_SOME_LOST:
                continue
        codec.unpack(data[i], 0, frames, signals, values[i])
    return lost


def decode(
    message: Message, frames: NDArray[Any], place: NDArray[np.int64], progress: Progress
) -> DecodedFrames:
    """Decode the frames (logs.FRAME) of one id; `place` are their places among all frames.

    Both (n,).
    """
    if not message.cycle_time and message.send_type != "EveryCycle":
        message.cycle_time = 1  # the tables want one
    try:
        frame = dbc.frame(message)
    except BusError:
        return _by_cantools(message, frames, place, progress)
    if frame.dlc > frames["data"].shape[1]:
        return _by_cantools(message, frames, place, progress)
    table = dbc.table([frame], 1.0)
    values = np.full((len(frames), len(frame.signals)), np.nan)
    outcome = np.zeros(len(frames), np.int64)
    data, length = np.ascontiguousarray(frames["data"]), frames["dlc"].astype(np.int64)

    def walk(check: bool) -> int:
        rows = (table.frames, table.signals, e2e.new_state(1))
        return int(_walk(data, length, *rows, values, outcome, check))

    progress.show("decoding; the first time compiles, some seconds")
    lost = walk(True)
    right = length == frame.dlc
    foreign = frame.protected and 2 * int((outcome[right] == FrameState.ERROR).sum()) > int(
        right.sum()
    )
    if foreign:
        lost = walk(False)
        outcome[:] = np.where(right, FrameState.NOT_AVAILABLE, FrameState.ERROR)
    used = right if foreign else (outcome == FrameState.OK) | (outcome == FrameState.OK_SOME_LOST)
    signals = [(s.name, s.unit, s.help) for s in frame.signals]
    return DecodedFrames(
        message, signals, place[used], values[used], outcome, lost, not foreign, foreign
    )


def _by_cantools(
    message: Message, frames: NDArray[Any], place: NDArray[np.int64], progress: Progress
) -> DecodedFrames:
    """As `decode`; a signal that is not in this layout of the frame keeps its value, first NaN."""
    index = {signal.name: i for i, signal in enumerate(message.signals)}
    values = np.full((len(frames), len(index)), np.nan)
    state = np.full(len(frames), FrameState.NOT_AVAILABLE, np.int64)
    last = np.full(len(index), np.nan)
    for i, row in enumerate(frames):
        if i and i % _STEP == 0:
            progress.show(f"{message.name}: {i}/{len(frames)} frames decoded")
        try:
            found: Any = message.decode(row["data"][: row["dlc"]].tobytes(), decode_choices=False)
            for name, value in found.items():
                last[index[name]] = value
        except _NOT_DECODABLE:
            state[i] = FrameState.ERROR
        values[i] = last
    used = state != FrameState.ERROR
    signals = [(s.name, s.unit or "", s.comment or "") for s in message.signals]
    return DecodedFrames(message, signals, place[used], values[used], state, 0, False, False)


def by_id(
    database: Database, frames: NDArray[Any], progress: Progress
) -> tuple[list[DecodedFrames], dict[int, int]]:
    """Return the decoded ids, by id, and how many frames of each other id there are.

    `frames`: (n,) records.
    """
    messages = {can_id.word_of(m.frame_id, m.is_extended_frame): m for m in database.messages}
    ids, which, counts = np.unique(frames["id"], return_inverse=True, return_counts=True)
    order = np.argsort(which, kind="stable")
    found, unknown = [], {}
    for number, count, places in zip(
        ids.tolist(), counts.tolist(), np.split(order, np.cumsum(counts)[:-1]), strict=True
    ):
        if number in messages:
            found.append(decode(messages[number], frames[places], places, progress))
        else:
            unknown[number] = count
    return found, unknown
