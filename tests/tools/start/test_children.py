"""What a process of a run says when its machine refuses it something."""

import errno
import os
from collections.abc import Sequence

import pytest

from pcpc.tools.start.children import Child

FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "log.mcap")
FULL_LINE = "log.mcap: No space left on device; free space there, or choose another place"


@pytest.mark.parametrize(("error", "line"), [
    (FULL, FULL_LINE),
    (MemoryError(), "out of memory; end other programs, or give this one more"),
])  # fmt: skip
def test_a_refusal_is_a_line_of_the_process_that_met_it(error: Exception, line: str) -> None:
    def main(words: Sequence[str]) -> int:
        raise error

    child = Child.fork("recorder", main, ())
    child.end(10.0)
    assert (child.code, child.complaint()) == (1, [f"recorder: {line}"])
