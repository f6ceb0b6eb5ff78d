"""Each reference of any unit in C: the whole run of a rig has the bits of Python, in its unit."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from pcpc.executive.laws import profiles
from pcpc.executive.laws.block import Block
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make.generate import builds
from pcpc.tools.make.generate.closed import ClosedLoop, digest_of
from pcpc.tools.make.generate.library import write
from pcpc.tools.make.new import TEMPLATE

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here: apt install gcc")

CYCLES = 1000  # all of the run; each profile below begins, moves and ends in it
BUILDS = ("gcc -O0", "gcc -O3 native")
_HOLD = "{over_s: 0.05}, {to: 0.2, by: line, over_s: 0.1}, {to: 0, by: step, over_s: 0.1}"
_SEGMENTS = f"[{{to: 0.5, by: quintic, over_s: 0.2}}, {_HOLD}]"
PROFILES = {  # parameters beside start_s: 0.1, and whether the acceleration is ever not 0
    "step": ("{amplitude: 0.5, offset: 0.1, ", False),
    "ramp": ("{slope: 2.0, end_s: 0.6, ", False),
    "sine": ("{amplitude: 0.5, frequency_hz: 3, phase_rad: 0.3, ", True),
    "chirp": ("{amplitude: 0.5, from_hz: 1, to_hz: 8, sweep_s: 0.6, ", True),
    "quintic": ("{amplitude: 0.5, move_s: 0.3, back_s: 0.5, ", True),
    "sequence": ("{repeat: 1, ", True),
}
RIG = """
base: {base}
rig: moved
executive:
  blocks:
    reference: {{law: "profiles:{name}", parameters: {given}amplitude_rad: null}}, {more}}}
    controller: {{inputs: {{q_d_rad: reference.value}}}}
evaluation: null
expect: null
require: null
"""


def test_every_profile_is_tested_here() -> None:
    found = {name for name, value in vars(profiles).items() if isinstance(value, Block)}
    assert found == set(PROFILES)


@pytest.mark.parametrize("name", PROFILES)
def test_a_run_with_it_in_c_has_the_bits_of_python(name: str, tmp_path: Path) -> None:
    given, bends = PROFILES[name]
    more = f"segments: {_SEGMENTS}" if name == "sequence" else ""
    text = RIG.format(base=TEMPLATE / "rig.yaml", name=name, given=given, more=more)
    (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
    rig = load_rig(tmp_path / "rig.yaml")
    closed, log = ClosedLoop(rig), in_memory(rig)
    found = log.node["executive"].columns
    value, acc = found["reference.value"], found["reference.acc"]
    assert len(value) == CYCLES and np.ptp(value) >= 0.5 and acc.any() == bends
    write(closed.files(CYCLES), tmp_path)
    assert "[rad/s2] its second" in (tmp_path / "executive_reference.h").read_text()
    builds.fixed_files(tmp_path)
    expected = digest_of(log, closed.columns(), CYCLES)
    digests = {one.name: one.digest(tmp_path) for one in builds.builds() if one.name in BUILDS}
    assert digests == dict.fromkeys(BUILDS, expected)
