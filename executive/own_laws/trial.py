"""A law of the user's tried before it runs: a few interpreted steps with guarded views, in a child.

Compiled code checks no index: `u[7]` of two inputs reads foreign memory. So the module is imported,
prepared and stepped once in a process of its own, interpreted, on views that refuse what lies
outside, with the initial states and inputs of 0 and then within the ports' ranges. What goes wrong
there is told with file and line; so is what hangs, ends the process or reads the terminal. A law
that passed is remembered by its sources and the tables that it read, beside the compiled code.

    python -m pcpc.executive.own_laws.trial CASE    the child; CASE is JSON, its answer JSON lines
"""

import hashlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

import pcpc
from pcpc.drivers.compiled import compile_cache
from pcpc.executive.errors import display_path
from pcpc.executive.own_laws.carried_files import Reads, add_reads, noted_reads, sha256
from pcpc.executive.own_laws.law_errors import cause, is_users, located_message, users_place

if TYPE_CHECKING:
    from pcpc.executive.laws.block import Block, Port
    from pcpc.executive.own_laws.preparation import Values

IMPORT_S, PREPARE_S, STEP_S = 20.0, 60.0, 10.0  # until a part counts as never returning
STEP_PERIODS = 200.0  # a step may also take so many periods: interpreted is some 100 times slower
ENOUGH_S = 5.0  # of steps
LATE, LATE_S = 4, 0.5  # after a leap in time a law may have much to make up
CYCLES = (0, 1, 2, 3, 4, 10, 100, 1000, 10_000, 100_000, 1_000_000)
_RECORDS = "laws"  # the folder of what is remembered
_passes: set[str] = set()  # records and cases, in this process
_suspensions: list[bool] = []
_prepare_reads: Reads = {}  # by `prepare`, in the child


@dataclass(frozen=True)
class TrialCase:
    """A law as a rig uses it; `file` is that of its module, `module` its dotted name or ""."""

    file: str
    module: str
    name: str
    settings: Mapping[str, float]
    rate_hz: float
    seed: int


@contextmanager
def without_trials() -> Iterator[None]:
    """Try no law meanwhile: those of a log ran before, and open their files by other names."""
    _suspensions.append(True)
    try:
        yield
    finally:
        _suspensions.pop()


def law_problem(case: TrialCase) -> str:
    """Return "" for a law that passes or has passed before, else what is wrong, in a line."""
    record = _record_name(case)
    if _suspensions or record in _passes:
        return ""
    problem = "" if _has_passed(record, case) else trial_problem(case)
    if not problem:
        _passes.add(record)
    return problem


def trial_problem(case: TrialCase) -> str:
    """Try a law, whatever other processes remember; return "" or what is wrong, in a line."""
    text = json.dumps([asdict(case), sys.path])
    if text in _passes:
        return ""
    words = [sys.executable, "-P", "-m", "pcpc.executive.own_laws.trial", text]
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "OPENBLAS_NUM_THREADS": "1"}
    folder = str(Path(pcpc.__file__).resolve().parents[1])
    path = os.pathsep.join(filter(None, [folder, os.environ.get("PYTHONPATH")]))
    where = display_path(Path(case.file))
    limit_s = IMPORT_S + PREPARE_S + 2.0 * max(STEP_S, STEP_PERIODS / case.rate_hz)
    try:
        child = subprocess.run(
            words,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=limit_s,
            env=environment | {"PYTHONPATH": path},
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"{where}: its trial does not return within {limit_s:.0f} s"
    lines = [json.loads(line) for line in child.stdout.splitlines() if line.startswith(b"{")]
    phase = next((line["phase"] for line in reversed(lines) if "phase" in line), "start")
    if not lines or "problem" not in lines[-1]:
        end = (
            signal.Signals(-child.returncode).name
            if child.returncode < 0
            else f"exit code {child.returncode}"
        )
        said = child.stderr.decode(errors="replace").strip().splitlines()[-1:]
        return ": ".join([where, f"its process ended in its {phase} with {end}", *said])
    if lines[-1]["said"]:
        print(f"{where}: prints: {lines[-1]['said']}", file=sys.stderr)
    if not lines[-1]["problem"]:
        _passes.add(text)
        _note_pass(_record_name(case), case, lines[-1]["sources"])
    return str(lines[-1]["problem"])


# What is remembered


def _records() -> str:
    return f"{_RECORDS}_{compile_cache.full_hash()}"


def _record_name(case: TrialCase) -> str:
    digest = hashlib.sha256(f"{case.module}:{case.name}\n".encode())
    with suppress(OSError):
        digest.update(Path(case.file).read_bytes())
    return f"{digest.hexdigest()[:32]}.json"


def _has_passed(record: str, case: TrialCase) -> bool:
    """Return whether the law passed, and all that it imports and reads is as it was."""
    folder = Path(case.file).parent
    for kept in compile_cache.folders():
        with suppress(OSError, ValueError, AttributeError):
            sources = json.loads((kept / _records() / record).read_text(encoding="utf-8"))
            if all(sha256(folder / name) == found for name, found in sources.items()):
                return True
    return False


def _note_pass(record: str, case: TrialCase, sources: list[str]) -> None:
    """Note that a law passed; where nothing can be written it is tried again the next time."""
    folder = Path(case.file).parent
    with suppress(OSError):
        digests = {
            os.path.relpath(source, folder)
            if Path(source).is_relative_to(folder)
            else source: sha256(Path(source))
            for source in sources
        }
        place = compile_cache.writable_folder(_records())
        draft = place / f"{record}.{os.getpid()}"
        draft.write_text(json.dumps(digests), encoding="utf-8")
        draft.replace(place / record)


# The child


class IndexOutside(Exception):
    """A step reached beyond a view."""


class UnusableBlock(Exception):
    """A block is not what a rig can use; without a line."""


class EndlessPart(BaseException):
    """A part of a law does not return."""


class ProcessExit(BaseException):
    """A law wants to end the process."""


class GuardedArray(np.ndarray):
    """An array that refuses indices outside, and those below 0, which would wrap.

    `about`: what a message calls it (`x.w`).
    """

    about: str

    def __array_finalize__(self, source: Any) -> None:
        """Take over what the array is about."""
        self.about = getattr(source, "about", "")

    def __getitem__(self, key: Any) -> Any:
        """Return an element or a part."""
        self._check(key)
        part = super().__getitem__(key)
        if isinstance(part, GuardedArray) and not isinstance(key, slice):
            part.about = f"{self.about}[{_text(key)}]"
        return part

    def __setitem__(self, key: Any, value: Any) -> None:
        """Set an element or a part."""
        self._check(key)
        super().__setitem__(key, value)

    def __iter__(self) -> Iterator[Any]:
        """Go through the elements."""
        return (self[i] for i in range(len(self)))

    def _check(self, key: Any) -> None:
        keys = key if isinstance(key, tuple) else (key,)
        for index, size in zip(keys, self.shape, strict=False):
            if isinstance(index, int | np.integer) and not 0 <= int(index) < size:
                extents = " x ".join(map(str, self.shape))
                text = f"{self.about}[{_text(key)}]: {self.about} has {extents} elements"
                below = "; an index counts from 0 up" if int(index) < 0 else ""
                raise IndexOutside(text + below)


def _text(key: Any) -> str:
    return ", ".join(map(str, key if isinstance(key, tuple) else (key,)))


def _view(values: list[float]) -> GuardedArray:
    return np.array(values, np.float64).view(GuardedArray)


@contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    """Raise Hangs where the process is after so many seconds."""

    def ring(number: int, frame: FrameType | None) -> NoReturn:
        raise EndlessPart(f"does not return within {seconds:g} s")

    signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _refuse_exit(*_: Any) -> NoReturn:
    raise ProcessExit("ends the process; a law must not")


def main(text: str) -> None:
    """Try the law of a case; answer on the original stdout, all else goes to a file of its own."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    output = open(os.memfd_create("said"), "r+b", buffering=0)  # noqa: SIM115  to the end
    for descriptor in (1, 2):
        os.dup2(output.fileno(), descriptor)
    given, sys.path[:] = json.loads(text)
    case, end = TrialCase(**given), os._exit
    os._exit = os.abort = _refuse_exit  # type: ignore[assignment]
    before = set(sys.modules)
    problem = _problem(case, lambda phase: print(json.dumps({"phase": phase}), file=answers))
    sys.stdout.flush()
    output.seek(0)
    words = " ".join(output.read(400).decode(errors="replace").split())
    answer = {"problem": problem, "said": words[:80], "sources": _sources(before)}
    print(json.dumps(answer), file=answers, flush=True)
    end(0)  # a law's threads are not waited for


def _sources(before: set[str]) -> list[str]:
    """Return the user's files that came with the law: modules, and what they or `prepare` read."""
    from pcpc.executive.own_laws.modules import opened_files  # time

    files = [getattr(sys.modules[name], "__file__", None) for name in set(sys.modules) - before]
    users = {Path(file).resolve() for file in files if file and is_users(file)}
    return sorted(map(str, {*users, *opened_files(), *_prepare_reads}))


def _problem(case: TrialCase, begin: Any) -> str:
    try:
        _try(case, begin)
    except IndexOutside as error:
        return located_message(users_place(error.__traceback__), str(error))
    except (EndlessPart, ProcessExit) as error:
        return located_message(users_place(error.__traceback__), str(error))
    except UnusableBlock as error:
        return str(error)
    except (Exception, SystemExit) as error:
        return cause(error)
    return ""


def _try(case: TrialCase, begin: Any) -> None:
    from pcpc.executive.own_laws.modules import module_of  # time
    from pcpc.executive.own_laws.preparation import check_size

    begin("import")
    try:
        with _time_limit(IMPORT_S):
            block = getattr(module_of(case.module, Path(case.file)), case.name, None)
    except (Exception, SystemExit, EndlessPart, ProcessExit) as error:
        here = located_message(users_place(error.__traceback__), str(error))
        what = here if isinstance(error, EndlessPart | ProcessExit) else cause(error)
        raise UnusableBlock(
            f"{case.module or Path(case.file).name} cannot be imported: {what}"
        ) from None
    if block is None or not hasattr(block, "step"):
        return  # `laws` says so
    begin("prepare")
    try:
        check_size(block)
        parameters, states = _prepare(block, case)
    except ValueError as error:
        raise UnusableBlock(f"{display_path(Path(case.file))}: {error}") from error
    begin("step")
    views = [_view([value for _, value in values]) for values in (parameters, states)]
    _steps(block, views, case.rate_hz)


def _prepare(block: "Block", case: TrialCase) -> "tuple[Values, Values]":
    from pcpc.executive.own_laws.preparation import prepared_values  # time

    settings = {
        name: case.settings.get(name, _default_value(port))
        for port in block.settings
        for name in port.names()
    }
    with _time_limit(PREPARE_S), noted_reads() as reads:
        values = prepared_values(block, settings, case.rate_hz, case.seed)
    add_reads(_prepare_reads, reads)
    return values


def _default_value(port: "Port") -> float:
    if port.default is not None:
        return port.default
    low, high = (edge if math.isfinite(edge) else 0.0 for edge in (port.low, port.high))
    return 0.5 * (low + high)


def _steps(block: "Block", views: list[GuardedArray], rate_hz: float) -> None:
    """Step with inputs of 0 and of their ranges, from the start and at late times."""
    chance = np.random.default_rng(1)
    dt, began = np.float64(1.0 / rate_hz), time.monotonic()
    for inputs in range(3):
        p, x = (view.copy() for view in views)
        for k in CYCLES:
            u = _view(_inputs(block, inputs, chance))
            y = _view([0.0] * block.size(block.outputs))
            late = k > LATE
            limit_s = LATE_S if late else max(STEP_S, STEP_PERIODS / rate_hz)
            with np.errstate(all="ignore"):
                try:
                    with _time_limit(limit_s):
                        block.step(np.float64(k * dt), dt, p, x, u, y)
                except ArithmeticError:  # compiled code has infinity or NaN there
                    break
                except EndlessPart:
                    if not late:
                        raise
                    break
                except ValueError as error:
                    if "math domain error" not in str(error) and "NaN" not in str(error):
                        raise
                    break
            if time.monotonic() - began > ENOUGH_S:
                return


def _inputs(block: "Block", kind: int, chance: np.random.Generator) -> list[float]:
    """Return values of all inputs: 0, then by chance within their ranges, at most -1..1 or 10."""
    most = (0.0, 1.0, 10.0)[kind]
    values: list[float] = []
    for port in block.inputs:
        low, high = max(port.low, -most), min(port.high, most)
        if low > high:
            low = high = port.low if port.low > most else port.high
        values += chance.uniform(low, high, port.size).tolist()
    return values


if __name__ == "__main__":
    main(sys.argv[1])
