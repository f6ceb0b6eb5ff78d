"""Instances of FMUs: unpacked, loaded, set up, and described to the loop by their addresses.

The part makes one for each block that is an FMU, for each memory that is to run; it is freed with
the plan. What goes wrong before the first step is a RigError with the FMU's own words, what goes
wrong later a fault of the loop, which `Fmus.failures` puts into words.

FMUs are unpacked once, into a folder beside the compiled code that is named by their hash.
"""

import ctypes
import os
import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcpc.drivers.compiled import compile_cache
from pcpc.drivers.fmi.layout import DTYPES, KINDS, Head, Role, Status
from pcpc.executive.errors import RigError, one_line
from pcpc.executive.loop.layout import Loop
from pcpc.executive.nodes.part import Part, Plan
from pcpc.executive.rig.blocks import BlockSpec
from pcpc.executive.rig.fmu_model import FmuVariable
from pcpc.executive.rig.reading import Rig

_FOLDER = "fmus"
_MOST_WORDS = 20  # messages of an FMU that are kept, the first ones
_STATUS = ("ok", "warning", "discard", "error", "fatal", "an end of the simulation")
_DID = ("", "setting its inputs", "its step", "getting its outputs")  # by `Doing`
_live: dict[str, int] = {}  # instances in this process by hash
_keys = count(1)
_said: dict[int, "_Said"] = {}  # what instances said, by their keys
_loggers: list[Any] = []  # for as long as the process lives


@dataclass
class _Said:
    """What an instance said of discards and errors, and of warnings: the first, and how many."""

    words: list[str] = field(default_factory=list)
    warning: str = ""
    warnings: int = 0

    def take(self, status: int, text: bytes | None) -> None:
        """Keep what an FMU says; its code calls it."""
        message = " ".join((text or b"").decode(errors="replace").split())
        if status >= 2 and len(self.words) < _MOST_WORDS:
            self.words.append(message)
        elif status == 1:
            self.warning, self.warnings = self.warning or message, self.warnings + 1


def step_of(spec: BlockSpec) -> Any:
    """Return the FmuStep of a block that is an FMU, else None."""
    return spec.block.step if hasattr(spec.block.step, "model") else None


class Fmus(Part):
    """Blocks that are FMUs."""

    def in_no_lane(self, rig: Rig) -> str:
        """Return that there is one."""
        return (
            "it has an FMU"
            if any(step_of(spec) for node in rig.nodes().values() for spec in node.blocks)
            else ""
        )

    def install(self, made: Plan, loop: Loop) -> None:
        """Make an instance of each, and tell `loop` where its calls are; RigError."""
        for spec in made.spec.blocks:
            step = step_of(spec)
            if step is None or spec.name in made.external:
                continue
            where, model, file = spec.where("law"), step.model, step.file
            if file is None:
                what = f"the log does not hold the FMU {model.name} (sha256 {model.sha256[:16]})"
                raise RigError(f"{what}, only its description; say where it is: --fmu FILE")
            if model.once and _live.get(model.sha256):
                continue  # its step does nothing: the memory of the warm-up
            one = Instance(spec, where)
            made.opened.append(one)
            loop.v[made.table.index[f"{spec.name}.fmi_address"]] = float(one.address)

    def failures(self, made: Plan) -> Iterator[str]:
        """Yield a line for each that failed, or warned."""
        first = {one.name: one for one in reversed(made.opened)}  # others are of warm-ups
        for one in reversed(first.values()):
            if text := one.failure() or one.warning():
                yield text

    def close(self, made: Plan) -> None:
        """Free the instances."""
        while made.opened:
            made.opened.pop().close()


class Instance:
    """One instance, initialised for t = 0; RigError. `head`: Head of `drivers.fmi.layout`."""

    def __init__(self, spec: BlockSpec, where: str) -> None:
        self.name, self._where = spec.name, where
        self._key = next(_keys)
        self.said = _said[self._key] = _Said()
        self._step = step_of(spec)
        self.model = self._step.model
        self._kept: list[Any] = []  # arrays that the loop reads
        folder = unpacked_folder(self._step.file, self.model.sha256)
        self._fmu = self._fmpy_instance(folder)
        self._three = self.model.fmi != "2.0"
        try:
            self._instantiate()
        except Exception as error:
            raise self._error("it cannot be instantiated", error) from None
        self.close = weakref.finalize(self, _end, self._fmu, self.model.sha256, self._key)
        self.close.atexit = False  # the loop's thread may still be in it
        _live[self.model.sha256] = _live.get(self.model.sha256, 0) + 1
        try:
            self._initialise(spec.settings)
        except Exception as error:
            raise self._error("it cannot be initialised", error) from None
        self._memory = np.zeros(1, Head.dtype).view(np.recarray)
        self.head: Any = self._memory[0]
        self.address = int(self._memory.ctypes.data)
        self._describe(spec)

    def failure(self) -> str:
        """Return what became of it, with its own words; "" if it is well."""
        status = int(self.head.status)
        if status <= Status.WARNING:
            return ""
        k = int(self.head.steps) - 1
        what = _DID[int(self.head.failed)]
        answer = _STATUS[status] if status < len(_STATUS) else f"status {status}"
        return self._message(f"{self.name}: {what} in cycle {k} returned {answer}")

    def warning(self) -> str:
        """Return of what it warned, and how often; "" if it did not."""
        did, messages = [], self.said
        if self.head.status == Status.WARNING:
            did.append(f"{_DID[int(self.head.failed)]} returned a warning")
        if messages.warnings:
            did.append(f"{messages.warnings:,} messages of warning, the first: {messages.warning}")
        return one_line(f"{self.name}: {'; '.join(did)}") if did else ""

    def _message(self, what: str) -> str:
        words = self.said.words
        return one_line(f"{what}: {'; '.join(words)}" if words else what)

    def _error(self, failure: str, error: Exception) -> RigError:
        told = str(error)
        own = "" if self.said.words and "Failed to instantiate" in told else f": {told}"
        return RigError(
            self._message(f"{self._where}: {self.name}: {self.model.name}: {failure}{own}")
        )

    def _fmpy_instance(self, folder: Path) -> Any:
        """Return FMPy's object for the library."""
        from fmpy.fmi2 import FMU2Slave
        from fmpy.fmi3 import FMU3Slave

        kind = FMU2Slave if self.model.fmi == "2.0" else FMU3Slave
        folder_before = os.getcwd()
        try:
            return kind(
                guid=self.model.token,
                modelIdentifier=self.model.identifier,
                unzipDirectory=str(folder),
                instanceName=self.name,
            )
        except Exception as error:
            os.chdir(folder_before)
            raise self._error("its library cannot be loaded", error) from None

    def _instantiate(self) -> None:
        if self._three:
            said = self.said
            self._fmu.instantiate(logMessage=lambda _, status, __, text: said.take(status, text))
            return
        from fmpy import calloc, fmi2, free

        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = _logger()
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        callbacks.componentEnvironment = self._key
        self._fmu.instantiate(callbacks=callbacks)

    def _initialise(self, settings: Mapping[str, float]) -> None:
        """Give it the rig's values, where they are not its own, and initialise it for t = 0."""
        if not self._three:
            self._fmu.setupExperiment(startTime=0.0)
        set_variables = [one for one in self.model.variables if one.name in settings]
        changed = {
            (one.kind, one.reference) for one in set_variables if settings[one.name] != one.start
        }  # in FMI 2.0 each type counts its references of its own
        for which in sorted(changed):
            self._start(
                [one for one in set_variables if (one.kind, one.reference) == which], settings
            )
        self._fmu.enterInitializationMode()
        self._fmu.exitInitializationMode()

    def _start(self, elements: list[FmuVariable], settings: Mapping[str, float]) -> None:
        """Set one variable, all its elements."""
        chosen = {one.element: one for one in elements}
        kind = _method(chosen[0].kind, self._three)
        values = [settings[chosen[i].name] for i in sorted(chosen)]
        typed: list[Any] = values
        if kind == "Boolean":
            typed = [value > 0.5 for value in values]
        elif kind not in ("Real", "Float32", "Float64"):
            typed = [round(value) for value in values]
        getattr(self._fmu, f"set{kind}")([chosen[0].reference], typed)

    def _describe(self, spec: BlockSpec) -> None:
        """Fill `head`."""
        step, outputs, head = self._step, self.model.of("output"), self.head
        rows = [
            *self._groups(Role.PARAMETER, step.tunable, spec.settings),
            *self._groups(Role.INPUT, step.wired, {}),
            *self._groups(Role.OUTPUT, outputs, {}),
        ]
        head.groups[: len(rows)] = rows
        head.version, head.instance = 3 if self._three else 2, self._fmu.component
        head.do_step = self._address("DoStep")
        head.n_groups, head.n_out = len(rows), len(outputs)

    def _groups(
        self, role: int, variables: list[FmuVariable], settings: Mapping[str, float]
    ) -> Iterator[tuple[int, ...]]:
        """Yield a row of ValueGroup for the variables of each type."""
        for kind in dict.fromkeys(_method(one.kind, self._three) for one in variables):
            of_kind = [
                (place, one)
                for place, one in enumerate(variables)
                if _method(one.kind, self._three) == kind
            ]
            code = KINDS[kind if self._three or kind != "Boolean" else "Boolean32"]
            values = [settings.get(one.name, 0.0) for _, one in of_kind]
            references = [one.reference for _, one in of_kind if one.element == 0]
            verb = "Get" if role == Role.OUTPUT else "Set"
            yield (
                role, self._address(f"{verb}{kind}"), code,
                len(references), self._keep(np.array(references, np.uint32)),
                len(of_kind), self._keep(np.array(values).astype(DTYPES[code])),
                self._keep(np.array([place for place, _ in of_kind], np.int64)),
                self._keep(np.array([float(f"{value:.12g}") for value in values])),
            )  # fmt: skip

    def _keep(self, array: NDArray[Any]) -> int:
        """Keep an array as long as this lives; return its address."""
        self._kept.append(array)
        return int(array.ctypes.data)

    def _address(self, function: str) -> int:
        name = f"fmi{3 if self._three else 2}{function}"
        found = ctypes.cast(getattr(self._fmu.dll, name), ctypes.c_void_p).value
        assert found is not None, "FMPy has looked for it"
        return found


def _method(kind: str, three: bool) -> str:
    """Return the type in the name of its setter."""
    return ("Int64" if three else "Integer") if kind == "Enumeration" else kind


@cache
def _logger() -> Any:
    """Return the logger of all FMUs of FMI 2.0, which are told apart by their environments.

    FMPy's proxy, which writes out what messages are made of, has one logger for all, for good.
    """
    from fmpy import fmi2
    from fmpy.logging import addLoggerProxy

    def listen(key: int | None, name: bytes, status: int, category: bytes, text: bytes) -> None:
        messages = _said.get(key or 0)
        if messages is None:
            fmi2.printLogMessage(key, name, status, category, text)
        else:
            messages.take(status, text)

    callbacks = fmi2.fmi2CallbackFunctions()
    _loggers.append(fmi2.fmi2CallbackLoggerTYPE(listen))
    callbacks.logger = _loggers[0]
    addLoggerProxy(ctypes.byref(callbacks))
    _loggers.append(callbacks)
    return callbacks.logger


def _end(fmu: Any, sha256: str, key: int) -> None:
    """Free an instance; its library stays loaded."""
    from fmpy.fmi1 import FMICallException

    _live[sha256] -= 1
    with suppress(FMICallException):  # of one that failed
        fmu.terminate()
    free = getattr(fmu, "fmi3FreeInstance", None) or fmu.fmi2FreeInstance
    free(fmu.component)
    _said.pop(key, None)


def unpacked_folder(file: Path, sha256: str) -> Path:
    """Return the folder of an unpacked FMU; RigError."""
    from fmpy import extract

    for kept in compile_cache.folders():
        if (kept / _FOLDER / sha256 / "modelDescription.xml").is_file():
            return kept / _FOLDER / sha256
    folder = compile_cache.writable_folder(_FOLDER)
    draft = tempfile.mkdtemp(prefix="draft-", dir=folder)
    try:
        extract(file, draft)
        with suppress(OSError):  # another process was first
            os.rename(draft, folder / sha256)
    except Exception as error:
        raise RigError(f"{file}: cannot be unpacked: {error}") from None
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return folder / sha256
