"""What the counter and the CRC-8 let pass: exactly, by the code's weights, and measured.

A frame with the CRC over two bytes of its id and seven of data is a word of 64 bits of which 8
follow from the others; errors that are words of this linear code themselves are not seen. How many
there are of each number of bits follows from the 256 words of the dual code (MacWilliams):

    A_w = 2^-8 sum_j B_j K_w(j),  K_w(j) = sum_i (-1)^i C(j, i) C(n - j, w - i),  n = 64      (1)
    P(passes | w bits wrong) = A_w / C(n, w)                                                 (2)
    P(passes | each bit wrong with p) = sum_w A_w p^w (1 - p)^(n - w)                         (3)
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers import dbc, e2e
from pcpc.drivers.jit import LOOP_INTERPRETED, numba

BITS, CAN_ID = 64, 0x120
WEIGHTS = (1, 2, 3, 4, 5, 8, 16, 32)
RATES = (1e-2, 1e-3, 1e-4, 1e-6)


def syndromes() -> list[int]:
    """Return what each single wrong bit of data and CRC changes between the two CRCs."""
    zero = np.zeros(8, np.uint8)
    right, found = int(e2e.crc8(CAN_ID, zero, 7)), []
    for bit in range(BITS):
        data = zero.copy()
        data[bit >> 3] = 1 << (bit & 7)
        last = int(data[7])
        found.append(int(e2e.crc8(CAN_ID, data, 7)) ^ right ^ last)
    return found


def weights() -> list[int]:
    """Return A_0 to A_64 of (1)."""
    single = syndromes()
    dual = [0] * (BITS + 1)
    for mask in range(256):  # a word of the dual code: one parity of each syndrome
        dual[sum((one & mask).bit_count() & 1 for one in single)] += 1
    return [sum(dual[j] * _krawtchouk(w, j) for j in range(BITS + 1)) // 256
            for w in range(BITS + 1)]  # fmt: skip


def _krawtchouk(w: int, j: int) -> int:
    return sum((-1) ** i * math.comb(j, i) * math.comb(BITS - j, w - i) for i in range(w + 1))


def passes(p: float, known: list[int] | None = None) -> float:
    """Return (3)."""
    return sum(a * p**w * (1.0 - p) ** (BITS - w)
               for w, a in enumerate(known or weights()) if w)  # fmt: skip


def _count(frames: Any, wrong: int, runs: int, seed: int, into: Any) -> None:
    """Count frames with `wrong` inverted bits (0: drawn data) by what the check makes of them."""
    np.random.seed(seed)
    state = np.zeros((1, 10), np.int64)
    data, places = np.zeros(8, np.uint8), np.zeros(64, np.int64)
    for _ in range(runs):
        for i in range(8):
            data[i] = np.random.randint(0, 256)
        state[0, :] = 0
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


def measured(wrong: int, runs: int, seed: int) -> NDArray[np.int64]:
    """Return how often the receiver came to each of its states."""
    rows = np.zeros((1, 12), np.int64)
    names = {"CAN_ID": CAN_ID, "DLC": 8, "PROTECTED": 1, "CRC_BYTE": 7, "COUNTER_BYTE": 6,
             "COUNTER_SHIFT": 4, "COUNTER_MASK": 15, "EVERY_N": 1}  # fmt: skip
    for name, value in names.items():
        rows[0, getattr(dbc, name)] = value
    into = np.zeros(6, np.int64)
    _counted()(rows, wrong, runs, seed, into)
    return into


_kept: dict[str, Any] = {}


def _counted() -> Any:
    if "count" not in _kept:
        _kept["count"] = _count if LOOP_INTERPRETED else numba.njit(_count)
    return _kept["count"]


def residual(runs: int, seed: int) -> Mapping[str, Any]:
    """Return predicted and measured shares of errors that the CRC does not see."""
    known = weights()
    rows = []
    for w in WEIGHTS:
        states = measured(w, runs, seed + w)
        unseen, predicted = int(states.sum() - states[e2e.ERROR]), known[w] / math.comb(BITS, w)
        spread = math.sqrt(runs * predicted * (1.0 - predicted))
        rows.append({
            "bits": w, "unseen_patterns": known[w], "patterns": math.comb(BITS, w),
            "predicted": predicted, "measured": unseen / runs, "runs": runs,
            "kept": abs(unseen - runs * predicted) <= 5.0 * spread + (predicted > 0.0),
        })  # fmt: skip
    drawn = measured(0, runs, seed)
    used = int(drawn[e2e.OK] + drawn[e2e.OK_SOME_LOST])
    share = e2e.MAX_DELTA / 16 / 256
    spread = math.sqrt(runs * share * (1.0 - share))
    return {
        "weights": rows,
        "rates": [{"bit_error_rate": p, "predicted": passes(p, known)} for p in RATES],
        "drawn_frames": {
            "runs": runs, "used": used, "predicted": share, "measured": used / runs,
            "rejected": {e2e_name: int(drawn[i]) for i, e2e_name in
                         ((e2e.ERROR, "ERROR"), (e2e.REPEATED, "REPEATED"),
                          (e2e.WRONG_SEQUENCE, "WRONG_SEQUENCE"))},
            "kept": abs(used - runs * share) <= 5.0 * spread,
        },
    }  # fmt: skip
