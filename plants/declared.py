"""A file of a plant that declares things by name, as drawing.py: it is run, once a process."""

from pathlib import Path
from typing import Any

from pcpc.drivers.errors import UserError
from pcpc.executive.own_laws.law_errors import cause
from pcpc.executive.own_laws.modules import module_of, own_streams


def declared(file: Path, error: type[UserError]) -> Any:
    """Return the module of a file; `error` says where and why one cannot be run, in one line."""
    try:
        with own_streams():
            return module_of("", file)
    except (Exception, SystemExit) as found:
        raise error(cause(found)) from None
