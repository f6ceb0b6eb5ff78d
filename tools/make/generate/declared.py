"""The supervisor's declarations in C: states and the table between them, faults, limits."""

from collections.abc import Iterator
from typing import Any

from pcpc.drivers.canopen.layout import LIMITED, WARNING, Heartbeat, Power
from pcpc.drivers.compiled.numbered import NumberedEnum, NumberedKind
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.limits import FINITE, Quick
from pcpc.executive.loop.states import NEXT, Condition, State
from pcpc.executive.loop.strangers import REPEATED_CYCLES, REPEATED_FRAMES
from pcpc.executive.nodes.planned_run import PATIENCE_S

_ABOUT = "/* Declared in executive/ and drivers/ of pcpc, written by `pcpc generate c`. */"
_HEADER = f"""\
#ifndef SUPERVISOR_H
#define SUPERVISOR_H

#include <stdbool.h>

{_ABOUT}

%s

#define FINITE {FINITE:g}
#define PATIENCE_MS {1000 * PATIENCE_S:.0f}u
#define REPEATED_FRAMES {REPEATED_FRAMES}u /* in so many cycles are a fault */
#define REPEATED_CYCLES {REPEATED_CYCLES}u
#define WARNING {WARNING}u /* in a status word, as LIMITED */
#define LIMITED {LIMITED}u

/* By state and condition: the next state. */
extern const state_t NEXT[{len(State)}][{len(Condition)}];

/* What a state does. expects: silence of the plant is a fault; sends: what the law wants. */
extern const struct state_info {{
    bool runs, expects, ramps, sends;
    double heartbeat;
}} DOES[{len(State)}];

/* CiA 301's error code and register of each fault. */
extern const struct fault_info {{
    double code, error_register;
}} ERRORS[{len(Fault)}];

#endif
"""


def files() -> dict[str, str]:
    """Return supervisor.h and supervisor.c."""
    kinds = (
        (State, "state_t"), (Condition, "condition_t"), (Heartbeat, "heartbeat_t"),
        (Fault, "fault_t"), (Quick, "quick_t"), (Power, "power_t"),
    )  # fmt: skip
    enums = "\n\n".join(_enum(kind, name) for kind, name in kinds)
    return {"supervisor.h": _HEADER % enums, "supervisor.c": "\n".join(_tables())}


def _enum(kind: NumberedKind, name: str) -> str:
    every: Any = kind
    members = [f"    {_name(one)} = {getattr(one, 'word', int(one))}," for one in every]
    return "\n".join(["typedef enum {", *members, f"}} {name};"])


def _name(one: NumberedEnum) -> str:
    return f"{type(one).__name__.upper()}_{one.name}"


def _tables() -> Iterator[str]:
    every = list(State)
    yield from ('#include "supervisor.h"', "", _ABOUT, "")
    yield f"const state_t NEXT[{len(State)}][{len(Condition)}] = {{"
    yield from (f"    {{{', '.join(_name(every[to]) for to in row)}}}," for row in NEXT.tolist())
    yield from ("};", "", f"const struct state_info DOES[{len(State)}] = {{")
    for state in State:
        does = (state.runs, state.expects, state.ramps, state.sends)
        words = ", ".join("true" if one else "false" for one in does)
        yield f"    {{{words}, {float(state.heartbeat)}}}, /* {state.name} */"
    yield from ("};", "", f"const struct fault_info ERRORS[{len(Fault)}] = {{")
    yield from (
        f"    {{{fault.code}.0, {fault.code.register}.0}}, /* {fault.name} */" for fault in Fault
    )
    yield from ("};", "")
