"""Controllers on standby: the checks of their names; who is there besides the controller."""

import re

from pcpc.executive.errors import did_you_mean
from pcpc.executive.rig.schema import Config, Tuning
from pcpc.executive.rig.yamlfile import Document, Keys

BLOCK, IN_CHARGE, TO = "handover", "handover.in_charge", "handover.to"
_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
_TAKEN = {*Config.__struct_fields__, "fallback", "rx", "tx", "timing", "time", "health", "fault"}


def laws(config: Config) -> tuple[str, ...]:
    """Return the controllers that one can hand over to, the rig's own first."""
    return (config.controller, *config.standby)


def check(document: Document, config: Config) -> None:
    """Raise RigError for a name on standby that is none, twice there, or already taken."""
    if not config.standby:
        return
    if config.overrun.fallback is not None:
        what = "overrun.fallback is given too; choose one of the two"
        raise document.error(("standby",), what)
    for i, name in enumerate(config.standby):
        if name not in config.controllers:
            cure = did_you_mean(name, config.controllers)
            raise document.error(("standby", i), f"no controller {name}{cure}")
        if name == config.controller:
            raise document.error(("standby", i), f"{name} is the controller itself; take it out")
        if name in config.standby[:i]:
            raise document.error(("standby", i), f"{name} stands there twice; take one out")
    blocks = {name: role for role, node in config.sections.items() for name in node.blocks}
    for name in laws(config):
        at: Keys = ("controllers", name)
        if not _NAME.fullmatch(name):
            what = f"{name} names variables; with standby: a letter, then letters, digits and _"
            raise document.error(at, what)
        if name in blocks:
            what = f"the {blocks[name]} has a block {name}; with standby, rename one"
            raise document.error(at, what)
        if name in _TAKEN:
            raise document.error(at, f"with standby, {name} is taken; rename it")


def tunings(document: Document, config: Config, place: int, tuning: Tuning) -> dict[str, float]:
    """Return what a scheduled tuning sets, `handover` among it; RigError."""
    if tuning.handover is None:
        if not tuning.set:
            raise document.error(("schedule", place), "give set, handover or both")
        return tuning.set
    at: Keys = ("schedule", place, "handover")
    if not config.standby:
        raise document.error(at, f"nobody is on standby; write standby: [{tuning.handover}]")
    if tuning.handover not in laws(config):
        cure = did_you_mean(tuning.handover, laws(config))
        what = f"{tuning.handover} is not on standby{cure}"
        raise document.error(at, what)
    return {**tuning.set, TO: float(laws(config).index(tuning.handover))}
