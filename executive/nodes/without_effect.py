"""What stands in a rig and would do nothing there: told at the start instead of ignored.

    window, schedule   an evaluation window or a tuning behind the end of the run
    watch              a variable that no node has
    --set              a setting with which the block is prepared as with any other value, such as
                       the seed of random waves where the sea is calm

A run that `--set duration_s=...` shortens may end before its window: that is a change, not a
mistake. Called before a run; not for a log, which is what it is.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from pcpc.executive.errors import RigError
from pcpc.executive.laws.block import Block, Port
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig.blocks import BlockSpec
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.yamlfile import display_path

_SWITCH_VALUES = 4  # a setting between whole numbers this close together chooses among cases


def check(made: Plan) -> None:
    """Raise RigError for what would have no effect in the node of this plan."""
    if made.role == "executive":
        _check_times(made.rig)
        _check_watch(made)
    for spec in made.spec.blocks:
        if spec.block.prepare is not None:
            for name in spec.settings:
                if spec.where(f"parameters.{name}").startswith("--set "):
                    _check_effect(made.rig, spec, name)


def _check_times(rig: Rig) -> None:
    config, end_s = rig.config, rig.config.duration_s
    times = {f"schedule[{i}].at_s": tuning.at_s for i, tuning in enumerate(config.schedule)}
    late = {path: at_s for path, at_s in times.items() if at_s >= end_s}
    if rig.evaluation is not None and rig.evaluation.window_s[1] > end_s:
        late["evaluation.window_s"] = rig.evaluation.window_s[1]
    if rig.evaluation is not None and config.expect:  # a further window is that of a limit
        for name, at_s in rig.evaluation.numbers.items():
            path = f"evaluation.{name}"
            if name.endswith("_to_s") and at_s > end_s and not _is_left_from_a_base(rig, path):
                late[path] = at_s
    shortened = rig.where("duration_s").startswith("--set ")
    duration = f", duration_s in {rig.where('duration_s')}"
    for path, at_s in late.items():
        if not shortened or rig.where(path).startswith("--set "):
            raise rig.error(
                path, f"{at_s:g} s is after the end of the run at {end_s:g} s{duration}"
            )


def _is_left_from_a_base(rig: Rig, path: str) -> bool:
    """Return whether a value is of a base whose `duration_s` the rig's own file replaces."""
    own = display_path(rig.path)
    return _file_of(rig, "duration_s") == own != _file_of(rig, path)


def _file_of(rig: Rig, path: str) -> str:
    """Return the file that gives a value; of one given with --set, the rig's own."""
    place = rig.where(path)
    return display_path(rig.path) if place.startswith("--set ") else place.rsplit(":", 2)[0]


def _check_watch(made: Plan) -> None:
    known, watch = dict.fromkeys(made.names), made.rig.config.watch
    for role, node in made.rig.nodes().items():
        if role != made.role:
            known |= dict.fromkeys(_variables(node.blocks))
    if watch is not None:
        made.rig.known("watch", watch, known, "variable")


def _variables(specs: list[BlockSpec]) -> Iterator[str]:
    for spec in specs:
        block = spec.block
        own = (block.inputs, block.outputs, block.states, block.parameters)
        yield from (f"{spec.name}.{n}" for ports in own for port in ports for n in port.names())


def _check_effect(rig: Rig, spec: BlockSpec, name: str) -> None:
    """Raise RigError if the value of a setting makes no difference, with the switch that would."""
    if _matters(rig, spec.block, spec.settings, name):
        return
    cures = [
        f"{spec.name}.{port.name}={value:g}"
        for port in spec.block.settings
        if port.name != name
        for value in _other_cases(port, spec.settings[port.name])
        if _matters(rig, spec.block, {**spec.settings, port.name: value}, name)
    ]
    cure = f"; it has one with {' or '.join(cures)}" if cures else ""
    raise RigError(f"{spec.where(f'parameters.{name}')}: has no effect in this rig{cure}")


def _other_cases(port: Port, value: float) -> list[float]:
    """Return the other values of a setting that chooses among a few cases."""
    if port.size > 1 or not port.high - port.low < _SWITCH_VALUES or port.low != int(port.low):
        return []
    cases = np.arange(port.low, port.high + 1.0)
    return [float(case) for case in cases if case != value] if value in cases else []


def _matters(rig: Rig, block: Block, settings: dict[str, float], name: str) -> bool:
    """Return whether another value of a setting prepares the block differently."""
    port = next(port for port in block.settings if name in port.names())
    value = settings[name]
    others = (value + 1.0, value - 1.0, 1.5 * value, 0.5 * value, port.low, port.high)
    usual = _preparation(rig, block, settings)
    return any(
        _preparation(rig, block, {**settings, name: other}) != usual
        for other in others
        if other != value and port.low <= other <= port.high and np.isfinite(other)
    )


def _preparation(rig: Rig, block: Block, settings: dict[str, float]) -> Any:
    """Return what `prepare` makes of settings; None where it refuses them."""
    assert block.prepare is not None, "asked of blocks that prepare"
    try:
        prepared = block.prepare(settings, rig.config.rate_hz, rig.config.seed)
    except Exception:  # values that nobody gave; those of the rig were prepared before
        return None
    return [
        {key: np.asarray(value, float).tolist() for key, value in part.items()}
        for part in (prepared.parameters, prepared.states)
    ]
