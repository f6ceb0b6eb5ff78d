"""How old a device's commands are, which their counters tell modulo 2^bits only.

    law   c[k]   what the rig's law answers to the plant's frames of cycle k, see `replay`
    sent  d[k]   what the device sent in answer to them, without counter and CRC
    age   0      d[k] = c[k] in all cycles, and c changes
          n      most values of c come first n cycles later in d
          None   else: nothing tells it

The order of samples and answers is certain without a clock only. With one, or with another law than
the rig's, nothing in the log tells the age; then a warning says so.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can.dbc import Frame, Protection
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.errors import UserError
from pcpc.executive.log import reader as logs
from pcpc.executive.rig import messages
from pcpc.executive.rig.reading import Rig
from pcpc.tools.make.device.behaviour import Behaviour
from pcpc.tools.make.device.below import NodesBelow
from pcpc.tools.make.device.replay import DeviceComparison

FEWEST = 20  # commands that tell an age
_USED = FrameState.OK, FrameState.OK_SOME_LOST
_CRC_BYTES = {Protection.CRC_8: 1, Protection.CRC_16: 2}
Ints = NDArray[np.int64]


def note_ages(found: Behaviour, rig: Rig, log: logs.Log, pacing: str) -> None:
    """Note the age of what a device sent in each cycle, or why it is not known."""
    frames = [frame for _, frame in NodesBelow(rig).heard if messages.is_awaited(frame)]
    frames = [frame for frame in frames if found.frames.get(frame.name, {}).get("received")]
    why = "a run in lockstep compares them with the rig's law"
    ages: dict[str, int | None] = {}
    if pacing == "lockstep":
        why = "they do not change, or are not those of the rig's law"
        try:
            ages = dict(_ages(frames, *_answers(rig, log)))
        except UserError as error:
            why = f"the rig's law cannot be run again: {error}"
    for frame in frames:
        age, name = ages.get(frame.name), f"device: {frame.name}"
        if age is not None:
            found.ages[frame.name] = age
        if age:
            old = f"{age:,} cycles" if age > 1 else "1 cycle"
            found.problems.append(f"{name}: its commands are {old} old")
        elif age is None:
            span = f"modulo {frame.counter[2] + 1} cycles only" if frame.protected else "not at all"
            found.warned.append(f"{name}: the age of its commands is known {span}: {why}")


def _answers(rig: Rig, log: logs.Log) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the frames of a device, and those of the rig's law, both (n,) by its own cycles."""
    pairs = list[tuple[NDArray[Any], ...]]()
    comparison = DeviceComparison(log, rig, lambda *both: pairs.append(both))
    node = log.node[comparison.role]
    pairs.append((node.frames[:0],) * 2)
    comparison.take(log, int(node.cycle.max(initial=0)), True)
    sent, computed = (np.concatenate(some) for some in zip(*pairs, strict=True))
    return sent, computed


def _ages(
    frames: list[Frame], sent: NDArray[Any], computed: NDArray[Any]
) -> Iterator[tuple[str, int | None]]:
    """Yield names and ages of frames; None of one that is not known."""
    sent = sent[np.isin(sent["e2e"], _USED)]
    for frame in frames:
        rows = [some[some["id"] == frame.word] for some in (sent, computed)]
        payload = np.concatenate([_payload(frame, some["data"]) for some in rows])
        keys = np.unique(payload, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
        d, c = np.split(keys, [len(rows[0])])
        yield frame.name, age_of(rows[1]["cycle"], c, rows[0]["cycle"], d)


def _payload(frame: Frame, data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return data (n, bytes) without counter and CRC."""
    found = data.copy()
    if frame.protected:
        byte, shift, mask = frame.counter
        found[:, byte] &= 0xFF ^ (mask << shift)
        kind, first, _ = frame.crc
        found[:, first : first + _CRC_BYTES[Protection(kind)]] = 0
    return found


def age_of(law_cycle: Ints, law: Ints, sent_cycle: Ints, sent: Ints) -> int | None:
    """Return how many cycles later than a law a device sends the same; None if it does not.

    `law` (n,) and `sent` (m,) are numbers of what was sent in these cycles. The last that was sent
    is not compared: it may be the device's end.
    """
    _, ours, theirs = np.intersect1d(law_cycle, sent_cycle[:-1], return_indices=True)
    if len(np.unique(law[ours])) > 1 and np.array_equal(law[ours], sent[theirs]):
        return 0
    _, first, second = np.intersect1d(law, sent, return_indices=True)
    lags = sent_cycle[second] - law_cycle[first]
    lags = lags[lags > 0]
    if not len(lags):
        return None
    lag = int(np.bincount(lags).argmax())
    begins = law_cycle[np.unique(law, return_index=True)[1]]
    answered = np.count_nonzero(begins <= sent_cycle[-1] - lag)
    votes = np.count_nonzero(lags == lag)
    return lag if votes >= max(FEWEST, answered / 2) else None
