"""Episodes that the mutants are fed with: a LOOP record set back, inputs, what has to come out."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled.structures import words_of
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop.ring_layout import FRAME_WORDS

FRAMES = 450  # of an episode in the ring, at most
Arrays = Sequence[NDArray[Any]]


class Episodes:
    """Episodes for a function of the driver: `feed(mutant, n, *inputs, *outputs)` fills outputs."""

    def __init__(self, feed: Callable[..., None]) -> None:
        self._feed = feed
        memory, fields = np.recarray(1, sh.LOOP), dict[str, Any](sh.LOOP.fields or {})
        self._bytes, self._loop = memory.view(np.uint8), memory[0]
        self._private = self._bytes[fields["k"][1] :]
        self._episodes: list[tuple[NDArray[np.uint8], Arrays, Arrays]] = []

    def new_loop(self) -> Any:
        """Return the record, empty, for the settings of an episode."""
        self._bytes[:] = 0
        self._loop.rings.frame_words, self._loop.rings.frame_rows = FRAME_WORDS, 1 << 16
        return self._loop

    def add(self, inputs: Arrays, expected: Arrays) -> None:
        """Add an episode that begins with the record as it is."""
        self._episodes.append((self._private.copy(), inputs, expected))

    def differ(self, number: int) -> bool:
        """Return whether an episode shows that this mutant is there; 0: the code as it is."""
        return any(self._differs(np.array([number]), *episode) for episode in self._episodes)

    def _differs(
        self, mutant: NDArray[Any], private: NDArray[np.uint8], inputs: Arrays, expected: Arrays
    ) -> bool:
        n = self._loop
        for record in (n.control, n.answer, n.event_ends, n.frame_ends):
            words_of(record)[:] = 0
        n.event[:] = n.frame[-2 * FRAME_WORDS :] = n.frame[: FRAMES * FRAME_WORDS] = 0
        self._private[:] = private
        outputs = [np.zeros_like(one) for one in expected]
        self._feed(mutant, n, *inputs, *outputs)
        pairs = zip(outputs, expected, strict=True)
        return not all(np.array_equal(*pair, equal_nan=True) for pair in pairs)
