"""`pcpc.bounds`: a run against the theorem of its law, as an object."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pcpc.plants.theorem import NoTheorem
from pcpc.tools.after.record import Run
from pcpc.tools.after.trust import Trust
from pcpc.tools.start.settings import settings
from pcpc.tools.study.bounds.bounds import Bounds, bounds_of
from pcpc.tools.study.bounds.observed import BoundsError


def bounds(
    what: str | Path | Run,
    controller: str | None = None,
    *,
    set: Mapping[str, Any] | None = None,
    law: str | None = None,
    trust: bool = False,
) -> Bounds:
    """Check a run against the theorem of its law: V, V' in two ways, the ultimate bound.

        found = pcpc.bounds("friction-c", set={"controller.kappa": 0.02})
        found.holds, found.account.checks(), found.account.proof.asked
        found.account.own.error, found.account.largest      the bound, and the largest |r|
        found.account.unexplained                           V' of the run minus that of the proof
        found.draw("bounds.png"), found.to_dict()

    what        a Run, a log file, a run folder, "latest"; or a rig, which is simulated
    controller, set   of a rig, as in `pcpc.simulate`
    law         use the theorem of this law of the plant
    trust       run the laws in the log if their files have moved

    Raises BoundsError (a pcpc.Error): no theorem of the law is known, or the log cannot be
    recomputed bit-identically.
    """
    place = what.path if isinstance(what, Run) else Path(what)
    try:
        return bounds_of(str(place), controller, settings(set), law, Trust(trust))
    except NoTheorem as error:
        raise BoundsError(f"{place}: no theorem: {error}") from None
