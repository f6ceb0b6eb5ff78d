"""A transport delay of whole samples: a shift register in a plant's state.

    y_k = u_k-d,  d = 0..DELAY_SIZE-1;  0 before the first

With d = 0 the plant integrates a period at its end, with the command that was computed from the
sample at its beginning, as book simulations do; with d = 1 a command acts from the next sample on,
as with real hardware. Further samples stand for gateways and slow drives.
"""

from typing import Any

from pcpc.drivers.jit import inline

DELAY_SIZE = 8


@inline
def delayed(u: float, samples: float, x: Any, at: int) -> float:
    """Put `u` into the register x[at..at+7] and return what was put `samples` calls before."""
    for i in range(DELAY_SIZE - 1):
        x[at + DELAY_SIZE - 1 - i] = x[at + DELAY_SIZE - 2 - i]
    x[at] = u
    return x[at + int(samples)]
