"""Mutants: whether every change of the safety code is noticed.

Supervisor, limits, watchdog, overrun, other senders, reception, signs of a second sender, tunings,
bus errors, end-to-end check and the codec's saturation are compiled once more with all their
mutants in them (`evidence.mutation`), of which a number chooses one. Each is fed with the same
drawn inputs, many of them just on a limit, and its outputs are compared with what the documents say
(`evidence.expected`, `compared_*`). A mutant that nobody notices stands in ARGUED, with the reason
why it changes nothing. A module of the loop without a mutant stands in ELSEWHERE with the reason
why, and is named at the end: what is wrong in it nobody notices here.
"""

import faulthandler
import os
import pkgutil
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from pcpc.executive import loop
from pcpc.executive.loop.states import NEXT, State
from pcpc.tools.dev.evidence import (
    compared,
    compared_frames,
    compared_plausible,
    compared_reception,
    compared_senders,
    compared_tuning,
)
from pcpc.tools.dev.evidence.comparison import Episodes
from pcpc.tools.dev.evidence.mutation import Mutant, build

TARGETS: Mapping[str, Sequence[str]] = {
    "drivers.can.codec": ("_round", "_bits", "_add", "_encoded", "_pack_layout", "pack"),
    "drivers.can.e2e": ("crc8", "crc16", "right_crc", "crc_of", "put_crc", "protect", "begin_cycle",
                    "age", "_use", "check"),
    "executive.loop.states": ("next_state",),
    "executive.loop.limits": ("find_not_finite", "check_finite", "limit_commands", "settled",
                              "quick_stop", "begin_ramp"),
    "executive.loop.strangers": ("_note", "blame", "refused", "is_foreign", "note_foreign",
                                 "note_repeat"),
    "executive.loop.plausibility": ("is_limited", "take_plausible", "take_again", "judged",
                                    "note_implausible"),
    "executive.loop.losses": ("is_lost",),
    "executive.loop.intrusion": ("suspect", "differs", "watch_beat", "note_sign", "is_out",
                                 "keep_values", "take_back"),
    "executive.loop.doubts": ("has_doubts", "is_doubted", "take_values", "note_sender", "undo",
                              "note_used"),
    "executive.loop.on_wire": ("age_frames", "note_as_came", "_note", "count", "taken_on_purpose"),
    "executive.loop.meeting": ("sorted_out", "exchange_held", "held_row", "compare_greeting"),
    "executive.loop.bus_state": ("note_bus_error", "_count", "fault_while_off"),
    "executive.loop.reception": ("take_frame", "use_frame", "put_in_place", "disturbed", "accept",
                                 "decode", "refuse"),
    "executive.loop.tuning": ("tune", "answer", "judge_request"),
    "executive.loop.supervisor": ("judge_overrun", "over", "count_missing", "watch_estop",
                                  "hear_requests", "judge_reset", "enter", "watch_input",
                                  "supervise"),
}  # fmt: skip
DRIVERS = {
    "supervisor": compared.SUPERVISOR, "receiver": compared_frames.RECEIVER,
    "sender": compared_frames.SENDER, "codec": compared_frames.CODEC,
    "senders": compared_senders.SENDERS, "values": compared_plausible.RECEIVER,
    "reception": compared_reception.RECEPTION, "tunings": compared_tuning.TUNING,
}  # fmt: skip
RECEPTION = ("bus_state", "doubts", "losses", "on_wire", "intrusion", "meeting", "reception")
TABLES = {
    "NEXT": (*NEXT.shape, len(State)),
    **dict.fromkeys(("RUNS", "EXPECTS", "RAMPS", "SENDS"), (len(State), 1, 2)),
}


def _put_beside_e2e(copy: Any) -> None:
    """Have an index beyond a table find what is wrong there, not another's memory."""
    for name, past in (("_CRC_TABLE", 1 << 8), ("_CRC_16_TABLE", 1 << 16)):
        right = getattr(copy, name)
        table = np.resize((right + 77) % past, 1 << 16)
        table[:256] = right
        setattr(copy, name, table)


BESIDE = {
    "drivers.can.e2e": _put_beside_e2e,
    "executive.loop.reception": compared_reception.put_beside,
    "executive.loop.tuning": compared_tuning.put_beside,
}
FIRST_PLACE = "place 0 of the table is the time, never what is looked for"
ARGUED = {  # words of mutants that nobody can notice, and why
    r"size < _TWO_52 -> size <= _TWO_52": "2^52 is a whole number either way",
    r"x < 0.0 -> x <= 0.0": "it gives -0.0 for 0.0, which is sent as the same bits",
    r"code < _TWO_63 -> code <= _TWO_63": "2^63 converts to the same bits, the highest one",
    r"code . signal.code_(low|high) -> .*=": "the bits of a limit are those of its code",
    r"dlc > 8 -> .* >= 8": "in 8 bytes each signal lies in the same word either way",
    r"dlc > 8 -> .* > 9": "no frame has 9 bytes",
    r"compare_greeting: .*: 16 -> 17": "behind the data of a classic frame there is 0",
    r"int64\(_TOP_BIT\) -> .* \| int64": "the number below 2^63 has no highest bit",
    r"NEXT.* in row [01235], column [056]": "only FAULT has these events",
    r"NEXT.* in row 4, column [1237]": "FAULT never has these events",
    r"NEXT.* in row 0, column 7": "INIT never has this event",
    r"not_finite = int64\(0\): 0 -> 1": "only a short cut: then each value is looked at by itself",
    r"int64\(-1\): 1 -> 2": "any number below 0 says that there is none",
    r"place < 0 -> place <(= 0| 1)": FIRST_PLACE,
    r"(place|mode_index|estop_index) >= 0 -> .* (> 0|>= 1)$": FIRST_PLACE,
    r"limit_commands: .*SENDS.* in row [45]": "on a ramp the way to the safe value goes first",
    r"limit_commands: .*RAMPS.* in row [45]": "there the pace is above 0, which says it too",
    r"way \* guard.pace > .* -> .* >= ": "where both are equal, so are the two paces",
    r"n_places > 0 -> .* >= 0": "of no faults nothing is counted down",
    r"supervise: .*EXPECTS.* in row 2": "RUN had input a cycle before; a fault needs 2 without",
    r"is_lost: .* <= 0.0 -> .* < 0.0": "a share of 0 has a generator of 0, which turns nothing",
    r"is_lost: .*s / PRIME < .*s / PRIME <= ": "no drawn number is a share to the last bit",
    r"differs: .*: 8 -> 9": "data that differ in one byte alone differ in their CRC too",
    r"beat_every\[row\] > 0 -> .* >= 0": "of turns of 0 cycles nothing comes early",
    r"met\[row\] = 1: 1 -> 2": "any number but 0 says that it was heard",
    r"supervise: .*SENDS.* in row [45]": "these states ramp, so that the gain does not rise anyway",
}


ON_PURPOSE = "injects what a rig asks for; judges nothing that comes"
ELSEWHERE = {  # modules of the loop without mutants, and why
    **dict.fromkeys(("floods", "injected_frames", "injected_values", "injection", "stalls"),
                    ON_PURPOSE),
    "keyframes": "it only copies: what is restored is held against the whole, byte for byte",
    "clock": "what late cycles lead to is judged in supervisor, which has mutants",
    "cycle": "the order of its stages alone", "stepping": "calls the blocks",
    "drive": "a word for others; no command depends on it",
    "plant_drive": "carries between the loop and drivers.canopen, drivers.robots, whose tests name"
                   " each bit",
    "running": "the order of start and end alone",
    "exchange": "the order of virtual time alone", "over_line": "the order of virtual time alone",
    "rings": "carries to the recorder", "timing": "measures",
    "sending": "what it sends is limited, packed and protected by functions that have mutants",
}  # fmt: skip


def results() -> dict[str, Any]:
    """Return how many mutants there are, which nobody notices, and reasons of none."""
    every, left, broken = score()
    told = [mutant.change for mutant in left]
    idle = [words for words in ARGUED if not any(re.search(words, text) for text in told)]
    return {
        "mutants": len(every), "noticed": 0 if broken else len(every) - len(left),
        "argued": dict(Counter(reason(one) for one in left if reason(one))),
        "left": [str(one) for one in left if not reason(one)],
        "idle": [] if broken else idle, "broken": broken,
        "without": [one for one in modules_without_mutants() if one not in ELSEWHERE],
        "unchanged": unchanged_functions(),
        "elsewhere": {one: ELSEWHERE[one] for one in modules_without_mutants() if one in ELSEWHERE},
    }  # fmt: skip


def modules_without_mutants() -> list[str]:
    """Return the modules of the loop that have compiled functions, of which none is changed."""
    return [name for name in _compiled_functions() if f"executive.loop.{name}" not in TARGETS]


def unchanged_functions() -> list[str]:
    """Return the compiled functions without a mutant in modules of the loop that have others."""
    known = {f"executive.loop.{name}": name for name in _compiled_functions()}
    return [
        f"{known[key]}.{one}"
        for key, names in TARGETS.items()
        if key in known
        for one in _compiled_functions()[known[key]]
        if one not in names
    ]


@cache
def _compiled_functions() -> dict[str, list[str]]:
    """Return the compiled functions of each module of the loop that has any."""
    found = {}
    for one in pkgutil.iter_modules(loop.__path__):
        name = f"{loop.__name__}.{one.name}"
        every = vars(import_module(name)).items()
        own = [
            key
            for key, each in every
            if getattr(each, "py_func", None) is not None and each.py_func.__module__ == name
        ]
        if own:
            found[one.name] = own
    return found


def reason(mutant: Mutant) -> str:
    """Return why nobody can notice a mutant; "" if there is no reason."""
    return next((why for words, why in ARGUED.items() if re.search(words, mutant.change)), "")


def score() -> tuple[list[Mutant], list[Mutant], list[str]]:
    """Return all mutants, those that nobody notices, and what is wrong without any.

    Beside code that is not as stated itself no mutant could be told.
    """
    mutants, compares = mutants_and_compares(True)
    broken = [
        f"{name}: {where}" for name, one in compares.items() if (where := _difference(one, 0))
    ]
    return mutants, [] if broken else _unnoticed(mutants), broken


def _unnoticed(mutants: list[Mutant]) -> list[Mutant]:
    """Return those that nobody notices, found in copies of this process; a crash is noticed.

    A wrong index of compiled code reaches any memory.
    """
    left, at = list[Mutant](), 0
    while at < len(mutants):
        reads, writes = os.pipe()
        pid = os.fork()
        if pid == 0:
            faulthandler.disable()
            code = 1
            try:
                for mutant in mutants[at:]:
                    os.write(writes, bytes([is_noticed(mutant)]))
                code = 0
            finally:
                os._exit(code)
        os.close(writes)
        with os.fdopen(reads, "rb") as pipe:
            told = pipe.read()
        left += [mutant for mutant, is_seen in zip(mutants[at:], told, strict=False) if not is_seen]
        at += len(told)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        if code > 0:
            raise RuntimeError(f"{mutants[at]}: its comparison failed")
        at += code < 0
    return left


def is_noticed(mutant: Mutant) -> bool:
    """Return whether any comparison sees a mutant."""
    groups = {
        "drivers.can.codec": ("codec",), "drivers.can.e2e": ("receiver", "sender"),
        "executive.loop.strangers": ("senders",), "judge_overrun": ("senders",),
        "executive.loop.plausibility": ("values", "reception"),
        "executive.loop.tuning": ("tunings",),
        **{f"executive.loop.{name}": ("reception",) for name in RECEPTION},
    }  # fmt: skip
    names = groups.get(mutant.function, groups.get(mutant.module, ("supervisor",)))
    return any(_difference(mutants_and_compares(True)[1][name], mutant.number) for name in names)


def _difference(compare: Episodes, number: int) -> str:
    """Return where a mutant is noticed; a copy that is not compiled minds its indices."""
    try:
        return compare.difference(number)
    except IndexError as error:
        return str(error)


@cache
def mutants_and_compares(compiled: bool = True) -> tuple[list[Mutant], dict[str, Episodes]]:
    """Return all mutants, and the comparisons by name."""
    drivers = {name: (one.step, one.driver) for name, one in DRIVERS.items()}
    mutants, feeds = build(TARGETS, TABLES, drivers, BESIDE, compiled)
    count = compared.EPISODES if compiled else compared.FEW
    draw = np.random.default_rng(compared.SEED)
    compares = {
        "supervisor": compared.supervisor(feeds["supervisor"], draw, count),
        "receiver": compared_frames.receiver(feeds["receiver"], draw),
        "sender": compared_frames.sender(feeds["sender"], draw),
        "codec": compared_frames.codec(feeds["codec"], draw),
        "senders": compared_senders.senders(feeds["senders"], draw, count),
        "values": compared_plausible.receiver(feeds["values"], draw, count),
        "reception": compared_reception.reception(feeds["reception"], draw, count),
        "tunings": compared_tuning.tuning(feeds["tunings"], draw, count),
    }
    return mutants, compares
