"""From the settings of a block to its parameters and initial states; what a block may look like.

numba is not needed here: the trial of a law (`executive.own_laws.trial`) uses it as well.
"""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from pcpc.executive.errors import did_you_mean
from pcpc.executive.loop.shared import MAX_VARIABLES
from pcpc.executive.own_laws.law_errors import cause

if TYPE_CHECKING:
    from pcpc.executive.laws.block import Block, Port

MOST_VALUES = (
    100 * MAX_VARIABLES
)  # of a block that is looked at; `executive.nodes.plan` says the rest
Values = list[tuple[str, float]]  # name and value of each element, in the order of the ports


def check_size(block: "Block") -> None:
    """Raise ValueError if a block has more ports than a node can hold by far."""
    total = 0
    for kind in ("inputs", "outputs", "parameters", "states", "settings"):
        for port in getattr(block, kind):
            total += port.size
            if total > MOST_VALUES:
                what = f"{kind}: port {port.name} of size {port.size} makes {total} variables"
                raise ValueError(f"{what}; one node holds {MAX_VARIABLES}")


def prepared_values(
    block: "Block", settings: Mapping[str, float], rate_hz: float, seed: int
) -> tuple[Values, Values]:
    """Return parameters and initial states, from `prepare` where there is one; ValueError."""
    from pcpc.executive.laws.block import Prepared  # numba

    parameters: Mapping[str, Any] = dict(settings)
    states: Mapping[str, Any] = {}
    if block.prepare is not None:
        try:
            made = block.prepare(settings, rate_hz, seed)
        except ValueError:
            raise
        except (Exception, SystemExit) as error:
            raise ValueError(f"prepare: {cause(error)}") from error
        if not isinstance(made, Prepared):
            raise ValueError(f"prepare returned {_short_text(made)}; expected Prepared(parameters)")
        parameters, states = made.parameters, made.states
    ports = block.parameters
    computed = block.prepare is not None
    if computed:
        _check_names((*ports, *block.states), (*parameters, *states), settings)
    return _values(ports, parameters, computed), _values(block.states, states, computed)


def _check_names(
    ports: "Sequence[Port]", names: Sequence[str], settings: Mapping[str, float]
) -> None:
    """Raise ValueError for a name that is no port's, and no setting handed on."""
    others = set(names) - settings.keys() - {port.name for port in ports}
    if others and (others := others - {name for port in ports for name in port.names()}):
        known = {name for port in ports for name in (port.name, *port.names())}
        name = next(name for name in names if name in others)
        raise ValueError(f"prepare gave {name}: no such port{did_you_mean(name, known)}")


def _values(ports: "Sequence[Port]", by_name: Mapping[str, Any], computed: bool) -> Values:
    """Return name and value of each element; a port of several is given whole or by element."""
    pairs: Values = []
    for port in ports:
        if port.size == 1:
            default = 0.0 if port.default is None else port.default
            value = by_name.get(port.name, default)
            pairs.append((port.name, _number(port.name, value) if computed else float(value)))
        else:
            pairs += _elements(port, by_name, computed)
    return pairs


def _elements(port: "Port", by_name: Mapping[str, Any], computed: bool) -> Values:
    names = _names(port.name, port.size)
    default = 0.0 if port.default is None else port.default
    if port.name in by_name:
        try:
            values = np.asarray(by_name[port.name], float)
        except (TypeError, ValueError):
            raise ValueError(
                f"{port.name}: prepare gave {_short_text(by_name[port.name])}"
            ) from None
        if values.shape != (port.size,):
            raise ValueError(
                f"{port.name}: prepare gave shape {values.shape}, expected ({port.size},)"
            )
        if computed:
            return list(zip(names, _numbers(port.name, values.tobytes()), strict=True))
        pairs = list(zip(names, values.tolist(), strict=True))
    elif by_name.keys().isdisjoint(names):
        own = _number(port.name, default) if computed else float(default)
        return [(name, own) for name in names]
    else:
        pairs = [(name, by_name.get(name, default)) for name in names]
    return [(name, _number(name, value) if computed else float(value)) for name, value in pairs]


@lru_cache(maxsize=4096)
def _names(name: str, size: int) -> tuple[str, ...]:
    """Return the names of the elements of a port of several, as `Port.names`."""
    return tuple(f"{name}_{i}" for i in range(size))


@lru_cache(maxsize=1024)  # in a campaign most of them stay what they were
def _numbers(name: str, values: bytes) -> list[float]:
    """Return the prepared numbers of a port of several, as `_number`."""
    return [_number(f"{name}_{i}", value) for i, value in enumerate(np.frombuffer(values))]


def _number(name: str, value: Any) -> float:
    """Return a prepared number to 12 digits: numpy's last bits depend on the processor."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: prepare gave {_short_text(value)}; expected a number") from None
    if math.isnan(number):
        raise ValueError(f"{name}: prepare gave nan; expected a number")
    return _in_12_digits(number) if number else number  # 0 and -0 would be the same to a cache


@lru_cache(maxsize=4096)  # as `_numbers`
def _in_12_digits(value: float) -> float:
    return float(f"{value:.12g}")


def _short_text(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 40 else f"{text[:37]}..."
