"""Generated C of the barrel's laws against C written by hand, in turn: the same inputs and bits.

Both are compiled with -O2 -ffp-contract=off and called by the same native loop, that of steps.c.
"""

import ctypes

import numpy as np

from pcpc.drivers.compile_cache import made
from pcpc.tools.dev.bench import steps as by_hand
from pcpc.tools.dev.bench.c_library import library
from pcpc.tools.dev.bench.cli import Ratio
from pcpc.tools.make.generate.library import write
from pcpc.tools.make.generate.translator import elementary
from pcpc.tools.make.generate.translator.law import LETTERS, ROLES, signature, translated
from pcpc.tools.terminal.progress import Progress

FLAGS = ("-O2", "-ffp-contract=off")


def build(cases: list[by_hand.Case]) -> ctypes.CDLL:
    """Return the laws of these cases as generated, under the names of `steps.c`."""
    texts = elementary.files()
    for case in cases:
        assert case.block is not None
        name = f"made_{case.name}"
        texts |= translated(case.block, name)
        given = "".join(f", (void *){LETTERS[role]}" for role in signature(case.block))
        doubles = ", ".join(f"double *{LETTERS[role]}" for role in ROLES)
        texts[f"{case.name}.c"] = (
            f'#include "{name}.h"\n'
            f"void {case.name}(double t, double dt, {doubles});\n"
            f"void {case.name}(double t, double dt, {doubles})\n"
            f"{{ (void)x; {name}_step(t, dt{given}); }}\n"
        )
    folder = made("generated")
    sources = write(texts, folder)
    headers = {name: text for name, text in texts.items() if name.endswith(".h")}
    return library(sources, FLAGS, headers)


def drive_of(case: by_hand.Case, law: ctypes.CDLL, loop: ctypes.CDLL) -> by_hand.Drive:
    """Return a law of one library in the native loop of another."""
    step = ctypes.cast(getattr(law, case.function), ctypes.c_void_p)
    vectors = (case.n["v"], case.n["at"], case.x0, case.inputs)
    views = [ctypes.c_void_p(vector.ctypes.data) for vector in vectors]
    call, dt = loop.drive, ctypes.c_double(case.dt)
    call.restype = None
    return lambda repeats, periods: call(
        step, ctypes.c_longlong(repeats), ctypes.c_longlong(periods), dt, *views
    )


def measure(progress: Progress, rounds: int = by_hand.ROUNDS) -> list[Ratio]:
    """Measure the barrel's laws; CompilerError, RigError."""
    progress.show("recording the inputs: three virtual runs")
    cases = [by_hand.record(law)[law] for law in by_hand.LAWS]
    hand, own = by_hand.build(by_hand.SAME), build(cases)
    found = []
    for case in cases:
        drives = [drive_of(case, law, hand) for law in (own, hand)]
        repeats = [by_hand.repeats_of(once) for once in drives]
        times = np.empty((rounds, 2))
        for i in range(rounds):
            progress.show(f"{case.name}: round {i + 1} of {rounds}")
            for j, once in enumerate(drives):
                spent = by_hand.time_s(once, repeats[j])
                times[i, j] = 1e9 * spent / (repeats[j] * by_hand.PERIODS)
        against = "C by hand, the same functions"
        found.append(Ratio.of("generated", case.name, against, times[:, 0], times[:, 1], "ns"))
    return found
