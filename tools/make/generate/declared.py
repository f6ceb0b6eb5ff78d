"""The supervisor's declarations in C: states and the table between them, faults and their codes."""

from collections.abc import Iterator
from typing import Any

from pcpc.drivers.compiled.numbered import Numbered, NumberedKind
from pcpc.executive.loop.faults import Fault
from pcpc.executive.loop.states import NEXT, Condition, Heartbeat, State

_ABOUT = "/* Declared in executive/loop/states.py and faults.py, written by `pcpc generate c`. */"
_HEADER = f"""\
#ifndef SUPERVISOR_H
#define SUPERVISOR_H

#include <stdbool.h>

{_ABOUT}

%s

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
        (Fault, "fault_t"),
    )  # fmt: skip
    enums = "\n\n".join(_enum(kind, name) for kind, name in kinds)
    return {"supervisor.h": _HEADER % enums, "supervisor.c": "\n".join(_tables())}


def _enum(kind: NumberedKind, name: str) -> str:
    every: Any = kind
    members = [f"    {_name(one)} = {int(one)}," for one in every]
    return "\n".join(["typedef enum {", *members, f"}} {name};"])


def _name(one: Numbered) -> str:
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
        f"    {{{fault.code}.0, {fault.register}.0}}, /* {fault.name} */" for fault in Fault
    )
    yield from ("};", "")
