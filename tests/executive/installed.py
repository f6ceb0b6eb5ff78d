"""The LOOP record of a node of the probe, as its parts have written it."""

from typing import Any

import numpy as np
from places import ROOT

from pcpc.executive.loop import shared as sh
from pcpc.executive.nodes import install as installing
from pcpc.executive.nodes import plan as planning
from pcpc.executive.rig.reading import load_rig
from pcpc.executive.rig.roles import Role

PROBE = ROOT / "plants/probe/rig.yaml"


def loop_of(role: Role, pacing: str, *settings: str, text: str = "") -> Any:
    """Return the LOOP record of a node of the probe with more in its rig."""
    own = f"base: {PROBE}\nrig: more\n{text}\n"
    rig = load_rig(PROBE.with_name("more.yaml"), settings=settings, text=own)
    loop = np.recarray(1, sh.LOOP, sh.blank())[0]
    installing.install(planning.plan(rig, role, pacing), loop)
    return loop
