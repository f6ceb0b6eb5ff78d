"""The step of an FMU: inputs set, doStep, outputs got, from the compiled loop through addresses.

    call k = 0    tunable parameters that have changed, inputs, outputs               t = 0
    call k > 0    tunable parameters that have changed, inputs, doStep, outputs       t = k T

Time is counted in steps: doStep goes from (k - 1) T to k T. What is not OK (nor a warning) makes
all outputs NaN from then on, which is a fault of the loop; Head says what it was.
"""

from typing import Any

import numpy as np

from pcpc.drivers.compiled.jit import inline
from pcpc.drivers.fmi.calls import call, instance_at, read, write
from pcpc.drivers.fmi.layout import (
    FLOAT64,
    HIGHEST,
    INT8,
    INT64,
    LOWEST,
    TOLD,
    Doing,
    Role,
    Status,
)

NEVER = np.int32(1)  # is an earlier state set again
ENDS = 0xFFFF00  # of what doStep tells: bytes 1 and 2, it wants an end, it returned early


@inline
def set_value(kind: Any, address: Any, i: Any, value: Any) -> None:
    """Set value `i` of an array: the nearest that the type has, 0 for NaN."""
    if kind >= INT8:
        if value != value:
            value = 0.0
        value = np.floor(min(max(value, LOWEST[kind]), HIGHEST[kind]) + 0.5)
    write(kind, address, i, value)


@inline
def exchange(head: Any, group: Any) -> Any:
    """Call the function of a group on its values; return its status."""
    if head.version == 3:
        return call(
            group.function,
            (head.instance, group.references, group.n_references, group.values, group.n_values),
        )
    return call(group.function, (head.instance, group.references, group.n_references, group.values))


@inline
def give(head: Any, role: Any, own: Any) -> Any:
    """Give the FMU its inputs, or the parameters if one of them has changed; return the status."""
    worst = np.int64(Status.OK)
    for g in range(head.n_groups):
        group = head.groups[g]
        if group.role != role:
            continue
        changed = role == Role.INPUT
        for i in range(group.n_values):
            value = own[np.int64(read(INT64, group.places, i))]
            if role == Role.INPUT:
                set_value(group.kind, group.values, i, value)
            elif value != read(FLOAT64, group.last, i):
                changed = True
                write(FLOAT64, group.last, i, value)
                set_value(group.kind, group.values, i, value)
        if changed:
            worst = max(worst, exchange(head, group))
    return worst


@inline
def take(head: Any, own: Any) -> Any:
    """Take the outputs; return the status."""
    worst = np.int64(Status.OK)
    for g in range(head.n_groups):
        group = head.groups[g]
        if group.role == Role.OUTPUT:
            worst = max(worst, exchange(head, group))
            for i in range(group.n_values):
                place = np.int64(read(INT64, group.places, i))
                own[place] = read(group.kind, group.values, i)
    return worst


@inline
def do_step(head: Any, told: Any, t: Any, dt: Any) -> Any:
    """Let the FMU go on from t by dt; return its status. `told`: where FMI 3.0 tells more."""
    if head.version != 3:
        return call(head.do_step, (head.instance, t, dt, NEVER))
    status = call(head.do_step, (head.instance, t, dt, NEVER, told, told + 1, told + 2, told + 8))
    return Status.ENDED if status <= Status.WARNING and head.told & ENDS != 0 else status


@inline
def note(head: Any, status: Any, doing: Any) -> None:
    """Keep the worst status, and where it came first."""
    if status > head.status:
        head.status, head.failed = status, doing


@inline
def advance(dt: Any, address: Any, p: Any, u: Any, y: Any) -> Any:
    """Step the instance that is described at an address; return its status, a float64."""
    if address == 0.0:
        return 0.0
    head = instance_at(np.int64(address))
    if head.status <= Status.WARNING:
        k = head.steps
        head.steps = k + 1
        note(head, max(give(head, Role.PARAMETER, p), give(head, Role.INPUT, u)), Doing.SETTING)
        if k > 0 and head.status <= Status.WARNING:
            t = (k - 1) * dt
            told = np.int64(address) + TOLD
            note(head, do_step(head, told, t, k * dt - t), Doing.STEPPING)
        if head.status <= Status.WARNING:
            note(head, take(head, y), Doing.GETTING)
    if head.status > Status.WARNING:
        for i in range(head.n_out):
            y[i] = np.nan
    return np.float64(head.status)
