"""Whether packages beyond the plain installation are there, asked before anything is computed."""

from importlib.util import find_spec

from pcpc.drivers.errors import Exit, UserError
from pcpc.drivers.machine.packages import pip_install

FIGURE = "matplotlib.figure"


def need(what: str, *modules: str) -> None:
    """Raise UserError, `what` needs it and how to install it, unless all modules are there.

    Packages around them are loaded.
    """
    missing, reasons = [], []
    for name in modules:
        try:
            there = find_spec(name) is not None
        except ImportError as error:
            there = False
            reasons.append(str(error))
        if not there:
            missing.append(name.partition(".")[0])
    if missing:
        why = f" ({'; '.join(reasons)})" if reasons else ""
        cure = pip_install(*missing)
        raise UserError(f"{what} {' and '.join(missing)}: {cure}{why}", Exit.ENVIRONMENT)


def need_for_sweep() -> None:
    """Raise UserError unless a campaign has what it needs."""
    need("a sweep needs", "scipy.special", "pyarrow", FIGURE, "cma")
