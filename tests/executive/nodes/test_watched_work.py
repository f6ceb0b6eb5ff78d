"""A call in a thread of its own: what it comes to, whatever its end says."""

import errno

import pytest

from pcpc.executive.nodes.watched import Work


@pytest.mark.filterwarnings("error")
def test_an_error_at_the_end_of_a_work_is_none_of_it() -> None:
    def after() -> None:
        raise OSError(errno.EIO, "Input/output error")

    work = Work(lambda: 3, after)
    work.start()
    work.join()
    assert (work.result, work.error) == (3, None)
