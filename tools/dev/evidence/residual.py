"""What the counter and the CRC let pass: exactly, by the code's weights, and measured.

A frame of 8 bytes is a word of 64 bits of which the r bits of the CRC follow from the others and
the id; errors that are words of this linear code themselves are not seen. How many there are of
each number of bits follows from the 2^r words of the dual code (MacWilliams):

    A_w = 2^-r sum_j B_j K_w(j),  K_w(j) = sum_i (-1)^i C(j, i) C(n - j, w - i),  n = 64      (1)
    P(passes | w bits wrong) = A_w / C(n, w)                                                 (2)
    P(passes | each bit wrong with p) = sum_w A_w p^w (1 - p)^(n - w)                         (3)
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.can import e2e
from pcpc.drivers.can.dbc import Protection
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.drivers.compiled.jit import LOOP_INTERPRETED, njit
from pcpc.drivers.compiled.rows import FrameRow

BITS, CAN_ID = 64, 0x120
WEIGHTS = (1, 2, 3, 4, 5, 6, 8, 16, 32)
RATES = (1e-2, 1e-3, 1e-4, 1e-6)


@dataclass(frozen=True)
class CheckCode:
    """A protection: its CRC's bits, where in 8 bytes CRC and counter are, the counter's mask.

    Frames of drawn data that it lets pass are rare; `times` as many are drawn.
    """

    crc_bits: int
    crc: tuple[int, int]  # which, byte
    counter: tuple[int, int, int]  # byte, shift, mask
    times: int = 1

    @property
    def rows(self) -> NDArray[Any]:
        """The table of the one frame."""
        rows = np.zeros(1, FrameRow.dtype)
        row = rows[0]
        row.can_id = row.data_id = CAN_ID
        row.dlc, row.every_n = BITS // 8, 1
        row.protected, row.crc_byte = self.crc
        row.counter_byte, row.counter_shift, row.counter_mask = self.counter
        return rows

    @property
    def share(self) -> float:
        """How many of the frames with drawn data are used."""
        return e2e.MAX_DELTA / (self.counter[2] + 1) / 2**self.crc_bits


CRC_8 = CheckCode(8, (Protection.CRC_8, 7), (6, 4, 15))
CRC_16 = CheckCode(16, (Protection.CRC_16, 0), (2, 0, 255), times=50)
CODES = CRC_8, CRC_16
Task = tuple[int, int, int, int]  # code, wrong bits, frames, seed


def syndromes(code: CheckCode = CRC_8) -> list[int]:
    """Return what each single wrong bit of data and CRC changes between the two CRCs."""
    zero, rows = np.zeros(8, np.uint8), code.rows
    right, found = int(e2e.right_crc(zero, 0, rows)), []
    for bit in range(BITS):
        data = zero.copy()
        data[bit >> 3] = 1 << (bit & 7)
        found.append(int(e2e.right_crc(data, 0, rows)) ^ right ^ int(e2e.crc_of(data, 0, rows)))
    return found


def weights(code: CheckCode = CRC_8) -> list[int]:
    """Return A_0 to A_64 of (1)."""
    masks = np.arange(1 << code.crc_bits)  # a word of the dual code: one parity of each syndrome
    words = sum(np.bitwise_count(masks & one) & 1 for one in syndromes(code))
    dual = np.bincount(words, minlength=BITS + 1).tolist()
    return [sum(dual[j] * _krawtchouk(w, j) for j in range(BITS + 1)) >> code.crc_bits
            for w in range(BITS + 1)]  # fmt: skip


def _krawtchouk(w: int, j: int) -> int:
    return sum((-1) ** i * math.comb(j, i) * math.comb(BITS - j, w - i) for i in range(w + 1))


def passes(p: float, known: list[int]) -> float:
    """Return (3)."""
    return sum(a * p**w * (1.0 - p) ** (BITS - w) for w, a in enumerate(known) if w)


def _count(frames: Any, state: Any, wrong: int, runs: int, seed: int, into: Any) -> None:
    """Count frames with `wrong` inverted bits (0: drawn data) by what the check makes of them."""
    np.random.seed(seed)
    data, places = np.zeros(8, np.uint8), np.zeros(64, np.int64)
    for _ in range(runs):
        for i in range(8):
            data[i] = np.random.randint(0, 256)
        state[0].last_counter = 0
        state[0].still_cycles = 0
        if wrong > 0:
            e2e.protect(data, 0, frames, 1)
            for i in range(64):
                places[i] = i
            for i in range(wrong):
                j = np.random.randint(i, 64)
                places[i], places[j] = places[j], places[i]
                data[places[i] >> 3] ^= np.uint8(1 << (places[i] & 7))
        result, _ = e2e.check(data, 8, 0, frames, state)
        into[result] += 1


def state_counts(wrong: int, runs: int, seed: int, code: CheckCode = CRC_8) -> NDArray[np.int64]:
    """Return how often the receiver came to each of its states."""
    into = np.zeros(6, np.int64)
    _compiled_count()(code.rows, e2e.new_state(1), wrong, runs, seed, into)
    return into


_kept: dict[str, Any] = {}


def _compiled_count() -> Any:
    if "count" not in _kept:
        _kept["count"] = _count if LOOP_INTERPRETED else njit(_count)
    return _kept["count"]


def residual(runs: int, seed: int, by: Callable[..., Iterable[Any]] = map) -> Mapping[str, Any]:
    """Return what the CRC-8 does not see, and by itself what the CRC-16 does not.

    `by` calls `task` with each of a list, like `map`; the results are the same whoever does it.
    """
    tasks = [one for number in range(len(CODES)) for one in _tasks(number, runs, seed)]
    found: dict[tuple[int, int], NDArray[np.int64]] = {}
    for (number, wrong, _, _), states in zip(tasks, by(task, tasks), strict=True):
        found[number, wrong] = found.get((number, wrong), 0) + states
    unseen = [
        _unseen(code, runs, {w: found[number, w] for w in (0, *WEIGHTS)})
        for number, code in enumerate(CODES)
    ]
    return {**unseen[0], "crc_16": unseen[1]}


def _tasks(number: int, runs: int, seed: int) -> Iterator[Task]:
    """Yield the shares of a code, the frames of drawn data in pieces of `runs`."""
    for first in range(CODES[number].times):
        yield number, 0, runs, seed + 1000 * first
    for wrong in WEIGHTS:
        yield number, wrong, runs, seed + wrong


def task(one: Task) -> NDArray[np.int64]:
    """Return how often a receiver came to each of its states."""
    number, wrong, runs, seed = one
    return state_counts(wrong, runs, seed, CODES[number])


def _unseen(code: CheckCode, runs: int, found: Mapping[int, NDArray[np.int64]]) -> dict[str, Any]:
    """Return predicted and measured shares of errors that a CRC does not see.

    `found`: states by the number of wrong bits, 0 for frames of drawn data.
    """
    known = weights(code)
    rows = []
    for w in WEIGHTS:
        states = found[w]
        unseen, predicted = (
            int(states.sum() - states[FrameState.ERROR]),
            known[w] / math.comb(BITS, w),
        )
        spread = math.sqrt(runs * predicted * (1.0 - predicted))
        rows.append({
            "bits": w, "unseen_patterns": known[w], "patterns": math.comb(BITS, w),
            "predicted": predicted, "measured": unseen / runs, "runs": runs,
            "kept": abs(unseen - runs * predicted) <= 5.0 * spread + (predicted > 0.0),
        })  # fmt: skip
    runs *= code.times
    drawn, share = found[0], code.share
    used = int(drawn[FrameState.OK] + drawn[FrameState.OK_SOME_LOST])
    spread = math.sqrt(runs * share * (1.0 - share))
    return {
        "distance": next(w for w in range(1, BITS + 1) if known[w]),
        "weights": rows,
        "rates": [{"bit_error_rate": p, "predicted": passes(p, known)} for p in RATES],
        "drawn_frames": {
            "runs": runs, "used": used, "predicted": share, "measured": used / runs,
            "rejected": {e2e_name: int(drawn[i]) for i, e2e_name in
                         ((FrameState.ERROR, "ERROR"), (FrameState.REPEATED, "REPEATED"),
                          (FrameState.WRONG_SEQUENCE, "WRONG_SEQUENCE"))},
            "kept": abs(used - runs * share) <= 5.0 * spread,
        },
    }  # fmt: skip
