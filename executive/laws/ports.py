"""The ports of a block, declared once: name, unit, meaning, range, shape. Steps use them by name.

    class Gains(Ports):
        kv_Nms_rad = port("N m s/rad", "gain on the filtered error", None, 0.0, 1000.0)

    class States(Ports):
        w = port("", "output weights", shape=(20, 2), recorded=False)
        network = group(Network)                        the ports of another declaration

A step that takes `p: Gains, x: States` says `p.kv_Nms_rad`, `x.w[n, j]`, `x.network`. The order of
declaration is the order in memory, and known nowhere else; a derived class begins with the ports of
its bases. In the table, elements of a port with a shape are `w_0`, `w_1`, ... row by row; with
`named="position_#_rad"` they are `position_1_rad`, `position_2_rad`, .... Groups add no prefix of
their own.

Compiled, such an argument is a pointer whose type holds places and shapes
(`drivers.compiled.views`). Interpreted, it is an object of the class over a float64 view of the
table.
"""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeVar, cast

from pcpc.drivers.compiled.views import Field, Layout
from pcpc.executive.errors import did_you_mean

ANY_UNIT = "?"  # in the unit of a port: that of the port which it feeds
MOST_VALUES = 1_000_000  # of a declaration; a node holds far less, `executive.nodes.plan` says it
_T = TypeVar("_T", bound="Ports")


@dataclass(frozen=True)
class Port:
    """One variable of a block (or `size` of them, named name_0, name_1, ...).

    `name` is snake_case and ends in its unit where that helps (`hub_rate_rad_s`). `unit` is the
    text that wiring compares ("rad/s", "N m", "" for none). `default` None: a rig file must give
    the value (settings), or `prepare` does (parameters). A state starts at its default or 0.
    `recorded` False keeps it out of the log: scratch, random generators, weights. A state that
    `adapts`, a weight or an integral, is frozen while another controller is in charge.
    """

    name: str
    unit: str
    help: str
    default: float | None = None
    low: float = -math.inf
    high: float = math.inf
    size: int = 1
    recorded: bool = True
    adapts: bool = False

    def names(self) -> list[str]:
        """Return the table names of this port's elements."""
        if self.size == 1:
            return [self.name]
        return [f"{self.name}_{i}" for i in range(self.size)]


@dataclass(frozen=True)
class _PortDeclaration:
    """What `port` returns until the class is complete."""

    about: Port
    shape: tuple[int, ...]
    named: str
    defaults: tuple[float, ...]


def port(
    unit: str,
    help: str,
    default: float | Sequence[float] | None = None,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    shape: int | tuple[int, ...] = (),
    named: str = "",
    recorded: bool = True,
    adapts: bool = False,
) -> Any:
    """Declare a port of the class around it; see Port.

    `shape` (n,) or (n, m) makes it an array. `named` names its elements in the table, # counts from
    1; `default` may then be a sequence. ValueError: a name, default or shape that cannot be.
    """
    extents = (shape,) if isinstance(shape, int) else tuple(shape)
    if any(type(extent) is not int or extent < 1 for extent in extents):
        raise ValueError(f"shape {shape!r}: at least 1 in each dimension")
    size = math.prod(extents)
    several = isinstance(default, Sequence)
    defaults = tuple(float(value) for value in default) if isinstance(default, Sequence) else ()
    if several and (not named or len(defaults) != size):
        raise ValueError(f"{len(defaults)} defaults for {size} elements; with `named`, one each")
    one = None if several else default
    assert not isinstance(one, Sequence)
    about = Port("", unit, help, one, low, high, size, recorded, adapts)
    return _PortDeclaration(about, extents, named, defaults)


def group(ports: type[_T], prefix: str = "", recorded: bool = True) -> _T:
    """Include the ports of another declaration as a part: `x.network.w`.

    `prefix` begins their names in the table; `recorded` False keeps them out of the log.
    """
    return cast(_T, _Group(ports, prefix, recorded))


def required(ports: type[_T]) -> type[_T]:
    """Return the declaration without its defaults: a rig must give every port. No groups."""
    bare = {
        name: replace(what, about=replace(what.about, default=None), defaults=())
        for name, what in ports._declared.items()
        if isinstance(what, _PortDeclaration)
    }
    return cast("type[_T]", type(ports.__name__, (Ports,), {"__doc__": ports.__doc__, **bare}))


@dataclass(frozen=True)
class _Group:
    ports: "type[Ports]"
    prefix: str
    recorded: bool

    def elements(self) -> "list[Port]":
        """Return the table's ports."""
        return [
            replace(one, name=self.prefix + one.name, recorded=one.recorded and self.recorded)
            for one in self.ports.ports
        ]


class Ports:
    """Base of declarations; an instance is the interpreted meaning of a view."""

    layout: ClassVar[Layout] = Layout("Ports", ())
    size: ClassVar[int] = 0
    ports: ClassVar[tuple[Port, ...]] = ()  # in the order of memory
    _declared: ClassVar[dict[str, _PortDeclaration | _Group]] = {}

    def __init_subclass__(cls) -> None:
        """Lay out the ports of the bases, then those of the class itself."""
        declared: dict[str, _PortDeclaration | _Group] = {}
        for base in cls.__bases__:
            for name, declaration in getattr(base, "_declared", {}).items():
                _add(cls, declared, name, declaration)
        for name, declaration in list(vars(cls).items()):
            if isinstance(declaration, _PortDeclaration | _Group):
                _add(cls, declared, name, declaration)
        cls._declared = declared
        fields: list[Field] = []
        ports: list[Port] = []
        place = 0
        for name, declaration in declared.items():
            if isinstance(declaration, _Group):
                fields.append(Field(name, place, (), declaration.ports.layout))
                ports += declaration.elements()
                size = declaration.ports.size
            else:
                fields.append(Field(name, place, declaration.shape, None))
                ports += _elements(name, declaration)
                size = declaration.about.size
            setattr(cls, name, _Access(name, place, size, declaration))
            place += size
        if place <= MOST_VALUES:  # else a rig that uses it is refused
            counts = Counter(element for one in ports for element in one.names())
            for name in (name for name, count in counts.items() if count > 1):
                raise ValueError(f"{cls.__name__}: two ports are named {name}")
        cls.layout, cls.size, cls.ports = Layout(cls.__name__, tuple(fields)), place, tuple(ports)

    def __init__(self, values: Any, label: str = "") -> None:
        """Take the first `size` of `values`, a float64 vector; `label` is for messages."""
        object.__setattr__(self, "_values", values[: self.size])
        object.__setattr__(self, "_label", label)

    def __getitem__(self, key: Any) -> Any:
        """Refuse a number: ports are said by name."""
        raise self._by_number(key)

    def __setitem__(self, key: Any, value: Any) -> None:
        """Refuse a number: ports are said by name."""
        raise self._by_number(key)

    def _by_number(self, key: Any) -> TypeError:
        names = list(self._declared)[:6]
        known = ", ".join(f"{self._label}.{name}" for name in names) or "none"
        more = ", ..." if len(self._declared) > len(names) else ""
        return TypeError(f"{self._label}[{key}]: say the port's name: {known}{more}")

    def values(self) -> Any:
        """Return all values as one vector: `flat` of an interpreted view."""
        if hasattr(self._values, "about"):  # guarded, see executive.own_laws.trial
            self._values.about = f"flat({self._label})"
        return self._values

    def __setattr__(self, name: str, value: Any) -> None:
        """Refuse a name that is not declared: it would be lost."""
        if name not in self._declared:
            known = did_you_mean(name, list(self._declared))
            raise AttributeError(f"{type(self).__name__} has no port {name}{known}")
        object.__setattr__(self, name, value)

    def __getattr__(self, name: str) -> Any:
        """Say what was meant."""
        known = did_you_mean(name, list(self._declared))
        raise AttributeError(f"{type(self).__name__} has no port {name}{known}")


def _add(cls: type, declared: dict[str, Any], name: str, declaration: Any) -> None:
    if name in declared or hasattr(Ports, name):
        raise ValueError(f"{cls.__name__}: two ports are named {name}")
    declared[name] = declaration


def _elements(name: str, declaration: _PortDeclaration) -> list[Port]:
    """Return the table's ports: those with names of their own one by one."""
    array_port = replace(declaration.about, name=name)
    if not declaration.named:
        return [array_port]
    defaults = declaration.defaults or (array_port.default,) * array_port.size
    return [
        replace(
            array_port,
            name=declaration.named.replace("#", str(i + 1)),
            default=defaults[i],
            size=1,
            help=array_port.help.replace("#", str(i + 1)),
        )
        for i in range(array_port.size)
    ]


class _Access:
    """How an instance reads and sets one port."""

    def __init__(self, name: str, place: int, size: int, what: _PortDeclaration | _Group) -> None:
        self.name, self.place, self.past, self.what = name, place, place + size, what

    def __get__(self, view: Any, cls: type) -> Any:
        if view is None:
            return self
        if isinstance(self.what, _PortDeclaration) and not self.what.shape:
            return view._values[self.place]
        part = view._values[self.place : self.past]
        if isinstance(self.what, _Group):
            return self.what.ports(part, f"{view._label}.{self.name}")
        part = part.reshape(self.what.shape)
        if hasattr(part, "about"):  # guarded, see executive.own_laws.trial
            part.about = f"{view._label}.{self.name}"
        return part

    def __set__(self, view: Any, value: Any) -> None:
        if isinstance(self.what, _Group) or self.what.shape:
            raise AttributeError(f"{self.name} has several values: set them one by one")
        view._values[self.place] = value


class Nothing(Ports):
    """No ports, for a block without states, inputs or parameters."""
