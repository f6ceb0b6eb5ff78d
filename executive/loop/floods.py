"""A flood on purpose: a node that sends frames which nobody knows, ahead of its own.

`value` frames a cycle of the lowest id that the DBC file has not, so that they win every
arbitration. A bus that knows its bits (a real one, or `bus.emulate`) has less room for others; one
that does not only carries them to receivers, which leave them. They are not in the log.
"""

from pcpc.drivers.can.wire import put_frame
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.records import int64
from pcpc.drivers.compiled.rows import FLAGS, LENGTH
from pcpc.drivers.compiled.structures import data_of
from pcpc.executive.loop.injection import acts, is_on, size
from pcpc.executive.loop.layout import Loop


@loop_function
def flood(n: Loop) -> None:
    """Send what the floods that are on send in a cycle."""
    faults, frame = n.faults, n.wire.tx
    for f in range(faults.n, faults.n + faults.n_floods):
        if is_on(n, f) and acts(n, f):
            data = data_of(frame)
            for i in range(4):
                frame[i] = (faults.target[f] >> (8 * i)) & 255
            frame[LENGTH], frame[FLAGS] = 8, 0
            for i in range(8):
                data[i] = 0
            for _ in range(int64(size(n, f))):
                put_frame(n.wire)
