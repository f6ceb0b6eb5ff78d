"""Compiled code in a thread of its own, watched by the main one: a step that hangs is named.

The loop holds no GIL, so that the main thread hears signals and looks, every POLL_S, whether a node
has stood in the same step since: for HANG_S, or HANG_PERIODS where they are longer. Looks are
counted, not seconds: a process that was stopped and goes on has not hung.
"""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from typing import Any

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.variables import T_S
from pcpc.executive.own_laws.law_errors import cause

POLL_S = 0.05
HANG_S = 3.0  # less than the other node's patience in lockstep, so that the cause is told first
HANG_PERIODS = 20.0
HURRY_S = 0.5  # once the user wants the end


class StepError(UserError):
    """A step does not return, or ended with an exception; the node's fault says which."""

    code = Exit.SAFETY_STOP


class Work(threading.Thread):
    """A call in a thread that does not keep the process alive; `after` is told of its end."""

    def __init__(self, call: Callable[[], Any], after: Callable[[], None] = lambda: None) -> None:
        super().__init__(daemon=True)
        self._call, self._after = call, after
        self._outcome: Future[Any] = Future()

    def run(self) -> None:
        """Do the call."""
        try:
            self._outcome.set_result(self._call())
        except BaseException as error:
            self._outcome.set_exception(error)
        finally:
            with suppress(OSError):  # a socket that says an error at its end is closed all the same
                self._after()

    @property
    def error(self) -> BaseException | None:
        """What the call raised, once it is over."""
        return self._outcome.exception()

    @property
    def result(self) -> Any:
        """What the call returned, once it is over."""
        return self._outcome.result()


class Watch:
    """Looks at the LOOP records of nodes; `stands` is to be called every POLL_S."""

    def __init__(self, loops: Sequence[Any]) -> None:
        self._loops = loops
        self._looks = 0
        self._seen: list[tuple[int, int, float]] = []
        period_s = max(1e-9 * int(loop.clock.period_ns) for loop in loops)
        self._limit_s = max(HANG_S, HANG_PERIODS * period_s)

    def stands(self, hurry: bool = False) -> Any:
        """Return the record of the node that hangs in a step, None if none does."""
        now = [
            (int(n.control.passes), int(n.control.stepping), float(n.v[T_S])) for n in self._loops
        ]
        inside = [n for n, (_, step, _) in zip(self._loops, now, strict=True) if step]
        same = repr(now) == repr(self._seen)  # a time that is NaN stays the same too
        self._looks = self._looks + 1 if same and inside else 0
        self._seen = now
        limit_s = HURRY_S if hurry else self._limit_s
        return inside[0] if inside and self._looks * POLL_S >= limit_s else None


def watched_result(
    call: Callable[[], Any], loops: Sequence[Any], hurry: Callable[[], bool] = lambda: False
) -> Any:
    """Return what `call` returns, from a thread; StepError, with the node's fault set."""
    work, watch = Work(call), Watch(loops)
    work.start()
    work.join(POLL_S)
    while work.is_alive():
        found = watch.stands(hurry())
        if found is not None:
            found.control.fault = Fault.STEP_HANGS
            raise StepError
        work.join(POLL_S)
    if work.error is not None:
        raise loop_error(work.error, loops) from work.error
    return work.result


def loop_error(error: BaseException, loops: Sequence[Any]) -> BaseException:
    """Return what to raise for an exception out of the loop: of a step, StepError with its line."""
    inside = [n for n in loops if n.control.stepping]
    if not inside or not isinstance(error, Exception):
        return error
    inside[0].control.fault = Fault.STEP_RAISED
    return StepError(cause(error))
