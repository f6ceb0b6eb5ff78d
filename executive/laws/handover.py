"""Which of several controllers is in charge, and the step between two of them fades.

    y(k)  = y_n(k) + s (y_o - y_n)(k_h)       n in charge since cycle k_h, o before           (1)
    s     = max(1 - (k - k_h) T / over_s, 0)                                                   (2)

y_o is what would have been sent in cycle k_h without the change, with what was left of an earlier
fade, so there is no step at k_h, and from k_h + over_s/T on (1) is y_n to the last bit. What is
wired to nothing switches at k_h: flags and displays mean the law in charge.

All laws compute along, with the measured feedback. What adapts (`port(..., adapts=True)`: weights,
integrals) is put back after the step of a law that is not in charge, since it would integrate
errors that the law does not cause; it goes on from there when the law takes over.

A law with an output that is no finite number is not taken; the change is then refused for good,
until `to` changes again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pcpc.executive.laws.block import Block, Port, Ports, flat, port, stage
from pcpc.executive.laws.emath import where

FINITE = 1e300  # from here on, and as NaN, a value counts as not finite, as in the loop


@dataclass(frozen=True)
class Output:
    """An output of the controller: its name, `has` for each law whether it has it, whether (1)."""

    name: str
    unit: str
    has: Sequence[bool]
    fades: bool


class States(Ports):
    """The last request and what is left of the fade."""

    asked = port("", "the last request", recorded=False)
    share = port("", "s (2)")
    pace = port("", "its change a cycle", recorded=False)


def input_ports(
    outputs: Sequence[Output], laws: Sequence[str], adapted: Sequence[Port]
) -> list[Port]:
    """Return the inputs: the outputs of each law in turn, then what each law adapted."""
    law_ports = [
        Port(f"{one.name}_of_{law}", one.unit, f"{one.name} as {law} wants it")
        for law in laws
        for one in outputs
    ]
    return law_ports + [Port(f"adapted_{i}", one.unit, one.help) for i, one in enumerate(adapted)]


def output_ports(laws: Sequence[str], adapted: Sequence[Port]) -> list[Port]:
    """Return the outputs behind the controller's own."""
    numbers = ", ".join(f"{j} {law}" for j, law in enumerate(laws))
    return [
        Port("in_charge", "", f"whose outputs are the controller's: {numbers}"),
        Port("refused", "", "requests that were refused"),
        *(
            Port(f"usable_{law}", "", f"1 while {law} can take over: all it says is finite")
            for law in laws
        ),
        *(Port(f"kept_{i}", one.unit, one.help, recorded=False) for i, one in enumerate(adapted)),
    ]


def block(
    laws: Sequence[str], outputs: Sequence[Output], adapted: Sequence[Port], owners: Sequence[int]
) -> Block:
    """Return the block behind the last of `laws`; `owners`: the law of each of `adapted`."""
    numbers = ", ".join(f"{j} {law}" for j, law in enumerate(laws))
    last = float(len(laws) - 1)
    parameters = _port_class(
        "Parameters",
        {
            "to": port("", f"who is in charge: {numbers}", 0.0, 0.0, last),
            "over_s": port("s", "time in which the step fades", None, 0.0, 3600.0),
        },
    )
    states = type(
        "States",
        (States,),
        {
            "__doc__": States.__doc__,
            "step": port("", "y_o - y_n (1)", shape=len(outputs)),
        },
    )
    inputs = _port_class("Inputs", _ports(input_ports(outputs, laws, adapted)))
    before = [Port(f"out_{i}", one.unit, one.name) for i, one in enumerate(outputs)]
    ends = _port_class("Outputs", _ports([*before, *output_ports(laws, adapted)]))
    return Block(_step(parameters, states, inputs, ends, outputs, owners))


def _port_class(name: str, ports: dict[str, Any]) -> Any:
    return type(name, (Ports,), {"__doc__": f"{name} of a hand-over.", **ports})


def _ports(ports: Sequence[Port]) -> dict[str, Any]:
    return {one.name: port(one.unit, one.help, recorded=one.recorded) for one in ports}


def _step(
    parameters: Any,
    states: Any,
    inputs: Any,
    ends: Any,
    outputs: Sequence[Output],
    owners: Sequence[int],
) -> Any:
    has = np.array([one.has for one in outputs], np.bool_).T.copy()
    fades = np.array([one.fades for one in outputs], np.bool_)
    owner = np.array([*owners, -1], np.float64)
    n, m, h = *has.shape, len(owners)

    @stage
    def step(t: float, dt: float, p: parameters, x: states, u: inputs, y: ends) -> None:
        """Equations (1), (2)."""
        own, out = flat(u), flat(y)
        asked, was = x.asked, out[m]
        zero = where(was == was, 0.0, 0.0)  # one in each lane
        fit = zero
        for j in range(n):
            asked = where(abs(p.to - 1.0 * j) < 0.5, 1.0 * j, asked)
        for j in range(n):
            usable = 1.0
            for i in range(m):
                if has[j, i]:
                    usable = where(abs(own[j * m + i]) < FINITE, usable, 0.0)
            out[m + 2 + j] = usable
            fit = where(asked == 1.0 * j, usable, fit)
        wanted = (asked != x.asked) & (asked != was)
        takes = wanted & (fit > 0.5)
        out[m + 1] += where(wanted & (fit < 0.5), 1.0, 0.0)
        now = where(takes, asked, was)
        left = where(x.share > x.pace, x.share - x.pace, 0.0)
        x.share = where(takes, where(p.over_s > 0.0, 1.0, 0.0), left)  # (2)
        x.pace = where(takes, dt / where(p.over_s > dt, p.over_s, dt), x.pace)
        x.asked, out[m] = asked, now
        for i in range(m):
            old, new, lent = zero, zero, zero
            for j in range(n):
                value = own[j * m + i]
                old = where(was == 1.0 * j, value, old)
                new = where(now == 1.0 * j, value, new)
                if not has[j, i]:
                    lent = where(now == 1.0 * j, 1.0, lent)
            if fades[i]:
                gap = old + left * x.step[i] - new
                gap = where(abs(gap) < FINITE, gap, 0.0)
                x.step[i] = where(takes, gap, x.step[i])
                new = where(x.share > 0.0, new + x.share * x.step[i], new)  # (1)
            stays = where(abs(new) < FINITE, 0.0, lent)
            out[i] = where(stays > 0.5, out[i], new)
        for i in range(h):
            place = m + 2 + n + i
            out[place] = where(now == owner[i], own[n * m + i], out[place])

    return step
