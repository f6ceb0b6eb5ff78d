"""Whether a picture can be drawn to a file, asked before anything is computed for it."""

from pathlib import Path

from pcpc.drivers.errors import UserError
from pcpc.tools.terminal.extras import FIGURE, need


def check_picture(option: str, path: Path | None) -> None:
    """Raise UserError if matplotlib is missing or no picture can be `path`; of None not.

    `option` named it.
    """
    if path is None:
        return
    if path.suffix.lower() not in (".png", ".svg", ".pdf"):
        raise UserError(f"{option} {path}: not a picture; expected FILE.png, .svg or .pdf")
    if not path.parent.is_dir():
        raise UserError(f"{option} {path}: there is no folder {path.parent}")
    need(f"{option} {path}: a picture needs", FIGURE)
