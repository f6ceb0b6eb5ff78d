"""The evidence in a process of its own: compiled for this machine's processor, equal bits."""

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import did_you_mean
from pcpc.tools.dev.evidence.options import PARTS, EvidenceRequest
from pcpc.tools.start.native import native


def command(request: EvidenceRequest) -> int:
    """Carry it out; return the exit code."""
    for name in request.parts:
        if name not in PARTS:
            raise UserError(f"{name}: no such part{did_you_mean(name, PARTS)}")
    with native():
        from pcpc.tools.dev.evidence import cli  # which imports numba

        return cli.command(request)
