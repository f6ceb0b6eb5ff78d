"""Faults of values, at the seams where values are carried: sensors, actuators, blocks, parameters.

    at an input of a block     after it was carried there          (an actuator: the plant's input)
    at a signal that is sent   before the limits and the codec     (a sensor: the plant's signal)
    at an output of a block    after its step
    at a parameter             before the steps; when the fault is over, it is what it was

With x the true value, a the fault's `value`, T the period, n the cycles since it began:

    value       a                                                               (1)
    bias        x + a                                                           (2)
    gain        a x                                                             (3)
    drift       x + a n T,  a in the unit per s                                 (4)
    stuck       x of the cycle in which it began                                (5)
    dropout     x of the last cycle in which it did not act                     (6)
    noise       x + a (u_1 + ... + u_12 - 6), u uniform: nearly normal, deviation a  (7)
    random      a (2 u - 1)                                                     (8)
    quantise    a floor(x/a + 1/2)                                              (9)
    delay       x of a cycles ago                                               (10)
    saturation  min(max(x, -a), a)                                              (11)
    rate        moves by at most a T a cycle                                    (12)
    dead_zone   0 where |x| <= a, else x - a sign(x)                            (13)
    nan         no number                                                         (14)
"""

from math import floor

import numpy as np

from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import int64
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.fault_kinds import WrongValue as Wrong
from pcpc.executive.loop.injection import acts, is_on, size, uniform
from pcpc.executive.loop.injection_layout import FAULT_DEPTH
from pcpc.executive.loop.layout import Loop

# Where a fault acts: SENT, the inputs of block b at b, its outputs at OUTPUTS + b
PARAMETERS, SENT, OUTPUTS = -1, sh.MAX_BLOCKS, sh.MAX_BLOCKS + 1


@loop_function
def spoil(n: Loop, seam: int) -> None:
    """Put wrong values in the place of true ones at a seam."""
    faults = n.faults
    for f in range(faults.n_values):
        if faults.seam[f] != seam:
            continue
        j, on = faults.target[f], is_on(n, f)
        x = n.v[j]
        if seam == PARAMETERS:
            if on and faults.since[f] < 0:
                faults.true[f] = x
            elif not on and faults.since[f] >= 0:
                n.v[j] = faults.true[f]
            x = faults.true[f]
        if on:
            if faults.since[f] < 0:
                begin(n, f, x)
            n.v[j] = wrong(n, f, x)
        else:
            faults.since[f] = -1


@loop_function
def begin(n: Loop, f: int, x: float) -> None:
    """Note the value and the cycle with which a fault begins."""
    n.faults.since[f] = n.k
    n.faults.kept[f] = x
    for i in range(FAULT_DEPTH):
        n.faults.earlier[f, i] = x


@loop_function
def wrong(n: Loop, f: int, x: float) -> float:
    """Return what fault `f` makes of `x` in this cycle; it keeps what it needs for the next one."""
    faults = n.faults
    kind, a, cycles = faults.kind[f], size(n, f), n.k - faults.since[f]
    faults.earlier[f, cycles % FAULT_DEPTH] = x
    if not acts(n, f):
        if kind != Wrong.STUCK:
            faults.kept[f] = x
        return x
    value = injected_value(n, f, x, a, cycles)
    if kind == Wrong.RATE:
        faults.kept[f] = value
    return value


@loop_function
def injected_value(n: Loop, f: int, x: float, a: float, cycles: int) -> float:
    """Return (1) to (14)."""
    faults, period_s = n.faults, n.clock.period_ns * 1e-9
    kind, kept_value = faults.kind[f], faults.kept[f]
    if kind == Wrong.VALUE:
        return a
    if kind == Wrong.BIAS:
        return x + a
    if kind == Wrong.GAIN:
        return a * x
    if kind == Wrong.DRIFT:
        return x + a * (cycles * period_s)
    if kind in (Wrong.STUCK, Wrong.DROPOUT):
        return kept_value
    if kind == Wrong.NOISE:
        total = -6.0
        for _ in range(12):
            total += uniform(n, f)
        return x + a * total
    if kind == Wrong.RANDOM:
        return a * (2.0 * uniform(n, f) - 1.0)
    if kind == Wrong.QUANTISE:
        return a * floor(x / a + 0.5) if abs(x / a) < 2.0**52 else x
    if kind == Wrong.DELAY:
        back = int64(min(max(a, 0.0), FAULT_DEPTH - 1.0))
        return faults.earlier[f, (cycles - back) % FAULT_DEPTH]
    if kind == Wrong.SATURATION:
        return min(max(x, -a), a)
    if kind == Wrong.RATE:
        return min(max(x, kept_value - a * period_s), kept_value + a * period_s)
    if kind == Wrong.NAN:
        return np.nan
    return 0.0 if abs(x) <= a else x - a * np.sign(x)
