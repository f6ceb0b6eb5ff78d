"""What went wrong in a law, an evaluation or a study, in a line with the user's place and source.

    law.py:12: cannot be compiled: untyped global name 'plain' ..., in `y[0] = plain(u[0])`

numba's message names places from the innermost helper outwards; the first one in a file that is
neither numba's nor another library's is the user's. Elsewhere it is the innermost frame.
"""

import linecache
import re
import sysconfig
import traceback
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

from pcpc.drivers.compiled.compile_cache import present_place
from pcpc.executive.errors import RigError, display_path
from pcpc.executive.own_laws.instead import cure

_PROJECT = Path(__file__).resolve().parents[2]
_LIBRARIES = [
    _PROJECT / "drivers" / "compiled",
    *(Path(sysconfig.get_path(name)) for name in ("stdlib", "purelib", "platlib")),
]
_OWN = {  # how laws are read and stepped, evaluations read and asked
    _PROJECT / f"{name}.py"
    for name in (
        "executive/laws/block", "executive/laws/ports",
        "executive/own_laws/modules", "executive/own_laws/preparation", "executive/rig/law_lookup",
        "executive/own_laws/trial", "plants/drawing", "plants/evaluation", "plants/judging",
        "plants/pages", "plants/scene", "plants/statistics", "plants/study",
        "plants/families/two_link/joints", "tools/study/experiment/cli",
        "tools/after/verdict/judge",
    )
}  # fmt: skip
_COLOUR = re.compile("\x1b\\[[0-9;]*m")
_PLACE = re.compile(r'File "(?P<a>[^"\n]+)", line (?P<b>\d+)|at (?P<c>/[^\n]+?) \((?P<d>\d+)\)')
_LINE = 100  # letters of a source line or a reason that are shown
_REFUSED = "cannot be compiled: "
_NO_MEMORY = "NRT required but not enabled"
_NO_ROOM = "it needs memory of its own (a list, a new array, text), which a step cannot have"
_INSIDE = re.compile(r', defined at .*|: %".*')  # where numba has it, what LLVM has of it
_MAKES = re.compile(r"(zeros|ones|full|empty|array|asarray|copy|arange|linspace|eye)(_like)?\(")


def cause(error: BaseException) -> str:
    """Return `file:line: what, in source` for an error of a law's module, `prepare` or step."""
    if isinstance(error, SyntaxError) and error.filename:
        place = f"{display_path(Path(error.filename))}:{error.lineno}"
        return f"{place}: {type(error).__name__}: {error.msg}"
    if is_numba_error(error):
        return located_message(_compile_place(error), _compile_reason(error))
    return located_message(users_place(error.__traceback__), error_text(error))


def error_text(error: BaseException) -> str:
    """Return the kind of an error and its text, in one line."""
    if isinstance(error, SystemExit):
        return "ends the process; it must not"
    if isinstance(error, RigError):  # its own words
        return str(error)
    text, name = " ".join(str(error).split()), type(error).__name__
    cure = _import_of(str(error.name)) if isinstance(error, NameError) else ""
    return f"{name}: {text}{cure}" if text else name


def _import_of(name: str) -> str:
    """Return how a name is imported that our modules for laws and evaluations offer."""
    for module in ("executive.laws.emath", "executive.laws.block", "plants.evaluation"):
        text = (_PROJECT / f"{module.replace('.', '/')}.py").read_text("utf-8")
        offered = text if module.endswith("emath") else text[text.find("__all__") :]
        if re.search(rf'^def {re.escape(name)}\(|"{re.escape(name)}"', offered, re.M):
            return f"; from pcpc.{module} import {name}"
    return ""


def is_numba_error(error: BaseException) -> bool:
    """Return whether numba refused to compile."""
    frames = traceback.extract_tb(error.__traceback__)
    return type(error).__module__.partition(".")[0] == "numba" or (
        bool(frames) and "numba" in Path(frames[-1].filename).parts
    )


def located_message(where: tuple[str, int] | None, message: str) -> str:
    """Return `file:line: what, in source`."""
    if where is None:
        return message
    file, line = where
    source = _shortened_line(linecache.getline(file, line).strip())
    return f"{display_path(Path(file))}:{line}: {message}{f', in `{source}`' if source else ''}"


def users_place(frames: TracebackType | None) -> tuple[str, int] | None:
    """Return file and line of the innermost frame that is the user's; else the innermost one."""
    found = [(present_place(f.filename), f.lineno or 0) for f in traceback.extract_tb(frames)]
    ours = [frame for frame in found if is_users(frame[0])]
    both = ours or found
    return both[-1] if both else None


def is_users(file: str) -> bool:
    """Return whether a source file is neither a library's nor part of how laws are read."""
    if file.startswith("<") or not file.endswith(".py"):
        return False
    path = Path(file).resolve()
    return path not in _OWN and not any(path.is_relative_to(folder) for folder in _LIBRARIES)


def _shortened_line(text: str) -> str:
    return text if len(text) <= _LINE else f"{text[: _LINE - 3]}..."


def _compile_place(error: BaseException) -> tuple[str, int] | None:
    for file, line in _places(_COLOUR.sub("", str(error))):
        if is_users(file):
            return file, line
    location = getattr(error, "loc", None)
    if location is not None and is_users(str(location.filename)):
        return str(location.filename), int(location.line)
    return users_place(error.__traceback__)


def _places(text: str) -> Iterator[tuple[str, int]]:
    for found in _PLACE.finditer(text):
        file = found["a"] or found["c"]
        yield str(Path(file).resolve()), int(found["b"] or found["d"])


def _compile_reason(error: BaseException) -> str:
    """Return the first line of numba's message that says something, and what to write instead."""
    text = _COLOUR.sub("", str(error))
    if _NO_MEMORY in text:
        return f"{_REFUSED}{_NO_ROOM}"
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    lines = [line for line in lines if not line.startswith("Failed in nopython mode")]
    reason = lines[0] if lines else type(error).__name__
    call = next((line[4:] for line in lines if line.startswith(">>> ")), "")
    if reason.startswith("No implementation of function") and call:
        makes = _MAKES.match(call) is not None
        reason = _NO_ROOM if makes else f"there is no {call}"
    reason = _INSIDE.sub("", reason).removesuffix(". Raised from None").rstrip(". ")
    if "<class 'function'>" in reason:
        reason = f"{reason.partition(':')[0]} is plain Python; put @inline above its def"
    reason = reason[:1].lower() + reason[1:] if reason[1:2].islower() else reason
    if re.search(r"\b(Lane|Mask)\(", reason):
        return f"in lanes {reason.partition('(')[0]}{cure(reason)}"
    return f"{_REFUSED}{_shortened_line(reason)}{cure(reason)}"
