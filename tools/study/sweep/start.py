"""`pcpc sweep` in a process of its own: compiled for this machine's processor, with equal bits.

But not `rerun`: one run is not worth the loop compiled anew, beside that of `simulate` and `run`.
"""

from pcpc.tools.start.native import native
from pcpc.tools.study.sweep.commands import MergeRequest, RerunRequest, SweepRequest
from pcpc.tools.study.sweep.numbers import LIMITS, check_whole
from pcpc.tools.terminal.extras import need, need_for_sweep


def command(request: SweepRequest | MergeRequest | RerunRequest) -> int:
    """Carry out `pcpc sweep`; return the exit code."""
    need_for_sweep()
    if isinstance(request, SweepRequest):
        if request.scheduler is not None:
            need("--scheduler needs", "distributed")
        for name, most in LIMITS.items():  # before a minute of compiling
            if (value := getattr(request, name)) is not None:
                check_whole(name, value, 1, most)
    with native(not isinstance(request, RerunRequest)):
        from pcpc.tools.study.sweep import cli, rerun  # which import numba

        if isinstance(request, RerunRequest):
            return rerun.command(request)
        return cli.merge(request) if isinstance(request, MergeRequest) else cli.command(request)
