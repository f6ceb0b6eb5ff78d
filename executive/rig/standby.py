"""Controllers on standby: the checks of their names; who is there besides the controller."""

import re
from collections.abc import Iterator

from pcpc.executive.errors import did_you_mean
from pcpc.executive.rig.conversion import file_keys_of
from pcpc.executive.rig.schema import Config, Tuning
from pcpc.executive.rig.yamlfile import Document, Keys

BLOCK, IN_CHARGE, TO = "handover", "handover.in_charge", "handover.to"
_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
_TAKEN = {*file_keys_of(Config), "fallback", "rx", "tx", "timing", "time", "health", "fault"}


def laws(config: Config) -> tuple[str, ...]:
    """Return the controllers that one can hand over to, the rig's own first."""
    return (config.controller, *config.standby)


def problems(document: Document, config: Config) -> Iterator[tuple[Keys, str]]:
    """Yield names on standby that are none, twice there, or already taken."""
    if not config.standby:
        return
    if config.overrun.fallback is not None:
        yield ("standby",), "overrun.fallback is given too; choose one of the two"
    for i, name in enumerate(config.standby):
        document.known(("standby", i), name, config.controllers, "controller")
        if name == config.controller:
            yield ("standby", i), f"{name} is the controller itself; remove it"
        if name in config.standby[:i]:
            yield ("standby", i), f"{name} is there twice; remove one"
    blocks = {name: role for role, node in config.sections.items() for name in node.blocks}
    for name in laws(config):
        its_keys: Keys = ("controllers", name)
        if not _NAME.fullmatch(name):
            what = f"{name} names variables; with standby: a letter, then letters, digits and _"
            yield its_keys, what
        if name in blocks:
            yield its_keys, f"the {blocks[name]} has a block {name}; with standby, rename one"
        if name in _TAKEN:
            yield its_keys, f"with standby, {name} is taken; rename it"


def scheduled_values(
    document: Document, config: Config, place: int, tuning: Tuning
) -> dict[str, float]:
    """Return what a scheduled tuning sets, `handover` among it; RigError."""
    if tuning.handover is None:
        if not tuning.set:
            raise document.error(("schedule", place), "give set, handover or both")
        return tuning.set
    its_keys: Keys = ("schedule", place, "handover")
    if not config.standby:
        raise document.error(
            its_keys, f"no controller is on standby; write standby: [{tuning.handover}]"
        )
    if tuning.handover not in laws(config):
        cure = did_you_mean(tuning.handover, laws(config))
        what = f"{tuning.handover} is not on standby{cure}"
        raise document.error(its_keys, what)
    return {**tuning.set, TO: float(laws(config).index(tuning.handover))}
