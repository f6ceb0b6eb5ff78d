"""The step of an FMU against one that is made of callbacks here: no library, no compiler."""

import ctypes
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from pcpc.drivers.fmi.layout import DTYPES, KINDS, TYPES, Doing, Head, Role, Status
from pcpc.executive.rig import fmu_block

DT = 0.25
_P, _INT, _F = ctypes.c_void_p, ctypes.c_int32, ctypes.c_double
EXCHANGE = {2: ctypes.CFUNCTYPE(_INT, _P, _P, _P, _P), 3: ctypes.CFUNCTYPE(_INT, *[_P] * 5)}
DO_STEP = {
    2: ctypes.CFUNCTYPE(_INT, _P, _F, _F, _INT),
    3: ctypes.CFUNCTYPE(_INT, _P, _F, _F, _INT, *[_P] * 4),
}


@dataclass
class Fmu:
    """An instance whose one input or parameter, two values, is its output."""

    version: int = 3
    kind: str = "Float64"
    role: Role = Role.INPUT
    status: dict[str, int] = field(default_factory=dict)  # by call, what it returns
    tells: tuple[int, int, int] = (0, 0, 0)
    calls: list[Any] = field(default_factory=list)

    def __post_init__(self) -> None:
        code = KINDS[self.kind]
        self.given, self.taken = (np.zeros(2, DTYPES[code]) for _ in range(2))
        self.last, self.places = np.array([7.0, 7.0]), np.array([1, 0])
        self.references = np.array([4, 5], np.uint32)
        self.memory = np.zeros(1, Head.dtype).view(np.recarray)
        self.head: Any = self.memory[0]
        kept: Any = EXCHANGE[self.version]
        self.kept = [kept(self._set), kept(self._get), DO_STEP[self.version](self._step)]
        setter, getter, step = (ctypes.cast(one, _P).value for one in self.kept)
        rest = (code, 2, self.references.ctypes.data, 2)
        more = self.places.ctypes.data, self.last.ctypes.data
        self.head.groups[0] = (self.role, setter, *rest, self.given.ctypes.data, *more)
        self.head.groups[1] = (Role.OUTPUT, getter, *rest, self.taken.ctypes.data, *more)
        self.head.version, self.head.instance, self.head.do_step = self.version, 99, step
        self.head.n_groups = self.head.n_out = 2
        self.x = np.array([float(self.memory.ctypes.data), 0.0])
        self.y = np.zeros(2)

    def _set(self, *arguments: int) -> int:
        return self._exchanged("set", arguments)

    def _get(self, *arguments: int) -> int:
        self.taken[:] = self.given
        return self._exchanged("get", arguments)

    def _exchanged(self, name: str, arguments: tuple[int, ...]) -> int:
        values = self.given if name == "set" else self.taken
        wanted = (99, self.references.ctypes.data, 2, values.ctypes.data, 2)
        assert arguments == wanted[: 2 + self.version]
        self.calls.append(name)
        return self.status.get(name, 0)

    def _step(self, instance: int, t: float, h: float, never: int, *told: int) -> int:
        assert (instance, never) == (99, 1) and len(told) == (4 if self.version == 3 else 0)
        self.calls.append((t, h))
        for place, value in zip(told, self.tells, strict=False):
            ctypes.c_uint8.from_address(place).value = value
        if told:
            ctypes.c_double.from_address(told[3]).value = t + h
        return self.status.get("step", 0)

    def cycle(self, *values: float) -> list[Any]:
        """Step with these values, in the order of the block; return what was called."""
        own, none = np.array(values), np.zeros(1)
        p, u = (own, none) if self.role == Role.PARAMETER else (none, own)
        del self.calls[:]
        fmu_block.step(0.0, DT, p, self.x, u, self.y)
        return list(self.calls)


def nearest(kind: str, value: float) -> float:
    """Return the value of a type that is nearest, in Python's whole numbers."""
    dtype = np.dtype(TYPES[kind])
    if dtype.kind == "f":
        return float(dtype.type(value))
    if np.isnan(value):
        return 0.0
    low, high = int(np.iinfo(dtype).min), int(np.iinfo(dtype).max)
    if kind.startswith("Boolean"):
        low, high = 0, 1
    whole = min(max(value, low), high)
    most = max(one for one in (high, high - (high >> 53)) if int(float(one)) <= high)
    return float(min(int(np.floor(whole + 0.5)), most))


VALUES = (0.0, 0.49, 0.5, 1.5, -0.5, -0.51, 127.4, 127.6, -128.6, 300.0, -300.0, 7e4, -7e4, 3e9,
          -3e9, 1e18, 9.3e18, -9.3e18, 1e19, 1e20, np.inf, -np.inf, np.nan)  # fmt: skip


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("version", [2, 3])
def test_an_input_is_the_nearest_value_of_its_type_and_comes_back(version: int, kind: str) -> None:
    fmu = Fmu(version, kind)
    with np.errstate(over="ignore"):
        for value, other in zip(VALUES, VALUES[::-1], strict=True):
            fmu.cycle(other, value)
            wanted = nearest(kind, value), nearest(kind, other)
            assert [*fmu.given.astype(float)] == pytest.approx(wanted, rel=0, nan_ok=True)
            assert [*fmu.y] == pytest.approx(wanted[::-1], rel=0, nan_ok=True), "at their places"


@pytest.mark.parametrize("version", [2, 3])
def test_calls_come_in_their_order_and_steps_are_counted(version: int) -> None:
    fmu = Fmu(version)
    assert fmu.cycle(1.0, 2.0) == ["set", "get"] and [*fmu.y] == [1.0, 2.0]
    assert fmu.cycle(1.0, 2.0) == ["set", (0.0, DT), "get"]
    assert fmu.cycle(3.0, 2.0) == ["set", (DT, DT), "get"] and [*fmu.y] == [3.0, 2.0]
    assert fmu.head.steps == 3 and fmu.x[1] == 0.0


def test_a_parameter_is_set_when_it_has_changed_and_only_then() -> None:
    fmu = Fmu(role=Role.PARAMETER)
    assert fmu.cycle(7.0, 7.0) == ["get"]
    assert fmu.cycle(7.0, 8.0)[0] == "set" and [*fmu.given] == [8.0, 0.0]
    assert "set" not in fmu.cycle(7.0, 8.0) and [*fmu.last] == [8.0, 7.0]


@pytest.mark.parametrize("name", ["set", "step", "get"])
@pytest.mark.parametrize("status", [1, 2, 3, 4])
def test_the_first_failure_is_kept_and_ends_it(name: str, status: int) -> None:
    fmu = Fmu()
    fmu.cycle(1.0, 2.0)
    fmu.status[name] = status
    called = [one if isinstance(one, str) else "step" for one in fmu.cycle(1.0, 2.0)]
    order = ["set", "step", "get"]
    ends = status > Status.WARNING
    assert called == (order[: order.index(name) + 1] if ends else order)
    doing = {"set": Doing.SETTING, "step": Doing.STEPPING, "get": Doing.GETTING}[name]
    assert (fmu.head.status, fmu.head.failed, fmu.x[1]) == (status, doing, status)
    assert np.isnan(fmu.y).all() == ends
    fmu.status = {"get": 1}
    assert bool(fmu.cycle(1.0, 2.0)) != ends
    assert (fmu.head.status, fmu.head.failed) == (status, doing), "the first of the worst"


@pytest.mark.parametrize(
    ("version", "tells", "status"),
    [(3, (1, 0, 0), 0), (3, (0, 1, 0), 5), (3, (0, 0, 1), 5), (2, (1, 1, 1), 0)],
)
def test_an_fmu_that_wants_an_end_has_it(
    version: int, tells: tuple[int, int, int], status: int
) -> None:
    fmu = Fmu(version, tells=tells)
    fmu.cycle(1.0, 2.0)
    fmu.cycle(1.0, 2.0)
    assert fmu.head.status == status
    assert fmu.head.failed == (Doing.STEPPING if status else Doing.NOTHING)


def test_a_step_that_failed_and_wants_an_end_is_told_by_its_failure() -> None:
    fmu = Fmu(status={"step": 3}, tells=(0, 1, 0))
    fmu.cycle(1.0, 2.0)
    fmu.cycle(1.0, 2.0)
    assert fmu.head.status == Status.ERROR


def test_a_block_without_an_instance_does_nothing() -> None:
    fmu = Fmu()
    fmu.x[0] = 0.0
    assert fmu.cycle(1.0, 2.0) == [] and [*fmu.y] == [0.0, 0.0] and fmu.x[1] == 0.0
