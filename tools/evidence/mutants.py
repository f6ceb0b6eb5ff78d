"""Mutants: whether every change of the safety code is noticed.

Supervisor, limits, watchdog, overrun, other senders, end-to-end check and the codec's saturation
are compiled once more with all their mutants in them (`evidence.mutation`), of which a number
chooses one. Each is fed with the same drawn inputs, many of them just on a limit, and its outputs
are compared with what the documents say (`evidence.expected`). A mutant that nobody notices stands
in ARGUED, with the reason why it changes nothing.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from pcpc.executive.loop import supervisor as sv
from pcpc.tools.evidence import compared, compared_plausible, compared_senders
from pcpc.tools.evidence.mutation import Mutant, build

TARGETS: Mapping[str, Sequence[str]] = {
    "drivers.codec": ("_round", "_bits", "pack"),
    "drivers.e2e": ("crc8", "crc16", "right_crc", "crc_of", "put_crc", "protect", "begin_cycle",
                    "_use", "check"),
    "executive.loop.supervisor": ("advance",),
    "executive.loop.limits": ("find_not_finite", "check_finite", "limit_commands", "settled",
                              "quick_stop", "begin_ramp"),
    "executive.loop.strangers": ("_note", "blame", "refused", "is_foreign", "note_foreign",
                                 "note_repeat"),
    "executive.loop.plausibility": ("take_plausible", "judged", "note_implausible"),
    "executive.loop.cycle": ("judge_overrun", "over", "count_missing", "watch_estop",
                             "hear_requests", "judge_reset", "enter", "watch_input", "supervise"),
}  # fmt: skip
TABLES = {
    "NEXT": (*sv.NEXT.shape, len(sv.STATE_NAMES)),
    "DOES": (*sv.DOES.shape, 2),
}
BESIDE = {  # an index beyond the table finds what is wrong there, not another's memory
    "drivers.e2e": "_CRC_TABLE = np.resize((_CRC_TABLE + 77) % 256, 1 << 16)\n"
    "_CRC_TABLE[:256] = _source._CRC_TABLE\n"
    "_CRC_16_TABLE = np.resize((_CRC_16_TABLE + 77) % 65536, 1 << 16)\n"
    "_CRC_16_TABLE[:256] = _source._CRC_16_TABLE"
}
FIRST_PLACE = "place 0 of the table is the time, never what is looked for"
ARGUED = {  # words of mutants that nobody can notice, and why
    r"size < _TWO_52 -> size <= _TWO_52": "2^52 is a whole number either way",
    r"x < 0.0 -> x <= 0.0": "it gives -0.0 for 0.0, which is sent as the same bits",
    r"code >= _TWO_63 -> code > _TWO_63": "2^63 converts to the same bits, the highest one",
    r"np.int64\(_TOP_BIT\) -> .* \| np.int64": "the number below 2^63 has no highest bit",
    r"NEXT.* in row [01235], column [056]": "only FAULT has these events",
    r"NEXT.* in row 4, column [1237]": "FAULT never has these events",
    r"NEXT.* in row 0, column 7": "INIT never has this event",
    r"odd = np.int64\(0\): 0 -> 1": "only a short cut: then each value is looked at by itself",
    r"np.int64\(-1\): 1 -> 2": "any number below 0 says that there is none",
    r"place < 0 -> place <(= 0| 1)": FIRST_PLACE,
    r"(place|mode_index|estop_index) >= 0 -> .* (> 0|>= 1)$": FIRST_PLACE,
    r"limit_commands: .*SENDS.* in row [45]": "on a ramp the way to the safe value goes first",
    r"limit_commands: .*RAMPS.* in row [45]": "there the pace is above 0, which says it too",
    r"way \* guard.pace > .* -> .* >= ": "where both are equal, so are the two paces",
    r"supervise: .*EXPECTS.* in row 2": "RUN had input a cycle before; a fault needs 2 without",
    r"supervise: .*SENDS.* in row [45]": "these states ramp, so that the gain does not rise anyway",
}


def found() -> dict[str, Any]:
    """Return how many mutants there are, which nobody notices, and reasons of none."""
    every, left = score()
    told = [mutant.change for mutant in left]
    return {
        "mutants": len(every), "noticed": len(every) - len(left),
        "argued": dict(Counter(reason(one) for one in left if reason(one))),
        "left": [str(one) for one in left if not reason(one)],
        "idle": [words for words in ARGUED if not any(re.search(words, text) for text in told)],
    }  # fmt: skip


def reason(mutant: Mutant) -> str:
    """Return why nobody can notice a mutant; "" if there is no reason."""
    return next((why for words, why in ARGUED.items() if re.search(words, mutant.change)), "")


def score() -> tuple[list[Mutant], list[Mutant]]:
    """Return all mutants, and those that nobody notices."""
    mutants, compares = prepared()
    for name, compare in compares.items():
        if compare(0):
            raise AssertionError(f"{name}: the code itself is not as expected")
    return mutants, [mutant for mutant in mutants if not noticed(mutant)]


def noticed(mutant: Mutant, compiled: bool = True) -> bool:
    """Return whether any comparison sees a mutant."""
    groups = {
        "drivers.codec": ("codec",), "drivers.e2e": ("receiver", "sender"),
        "executive.loop.strangers": ("senders",), "judge_overrun": ("senders",),
        "executive.loop.plausibility": ("values",),
    }  # fmt: skip
    names = groups.get(mutant.function, groups.get(mutant.module, ("supervisor",)))
    return any(prepared(compiled)[1][name](mutant.number) for name in names)


@cache
def prepared(compiled: bool = True) -> tuple[list[Mutant], dict[str, compared.Compare]]:
    """Return all mutants, and the comparisons by name."""
    mutants, driver = build(
        TARGETS, TABLES, compared.DRIVER + compared_senders.DRIVER + compared_plausible.DRIVER,
        BESIDE, compiled,
    )  # fmt: skip
    count = compared.EPISODES if compiled else compared.FEW
    draw = np.random.default_rng(compared.SEED)
    compares = {
        "supervisor": compared.supervisor(driver, draw, count),
        "receiver": compared.receiver(driver, draw),
        "sender": compared.sender(driver, draw),
        "codec": compared.codec(driver, draw),
        "senders": compared_senders.senders(driver, draw, count),
        "values": compared_plausible.receiver(driver, draw, count),
    }
    return mutants, compares
