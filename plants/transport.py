"""A transport delay of whole samples: a shift register in a plant's state.

    y_k = u_k-d,  d = 0..DELAY_SIZE-1;  0 before the first

With d = 0 the plant integrates a period with the command that was computed from the sample at its
beginning, as book simulations do. With d = 1 a command acts from the next sample on, as with real
hardware. Further samples stand for gateways and slow drives.
"""

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.compiled.views import Array

DELAY_SIZE = 8


@inline
def delayed(u: float, samples: float, sent: Array) -> float:
    """Put `u` into the register `sent` (DELAY_SIZE,); return the value of `samples` calls ago."""
    for i in range(len(sent) - 1, 0, -1):
        sent[i] = sent[i - 1]
    sent[0] = u
    return sent[int(samples)]
