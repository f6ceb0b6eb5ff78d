"""The processes of a study end with it, whatever ends it."""

import multiprocessing
import os
import signal

import pytest

from pcpc.tools.start.pool import PoolError, workers


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_no_process_lives_on_after_an_early_end(error: type[BaseException]) -> None:
    with pytest.raises(error), workers(2) as pool:
        for _ in range(5):
            pool.submit(signal.pause)  # for ever
        begun = multiprocessing.active_children()
        assert begun
        raise error
    for process in begun:
        process.join(20.0)
        # The kernel is asked: while the pool's own thread reaps it, Python still says "started".
        with pytest.raises(ProcessLookupError):
            os.kill(process.pid or 0, 0)


def test_a_process_that_is_killed_is_said_in_a_line() -> None:
    with pytest.raises(PoolError, match=r"was killed .*--jobs") as caught, workers(1) as pool:
        pool.submit(os._exit, 9).result()
    assert "\n" not in str(caught.value)


def test_results_come_and_ctrl_c_is_for_the_study_alone() -> None:
    with workers(jobs=3, most=1) as pool:
        number, process = pool.submit(os.getpid).result(), multiprocessing.active_children()
        os.kill(number, signal.SIGINT)
        assert pool.submit(os.getpid).result() == number
        assert len(process) == 1, process
