"""A run that is ok by another yardstick than the first one of its rig is judged by that, too."""

import shutil
from pathlib import Path
from typing import Any

import pytest
from mcp_cheats import honest_folder
from mcp_door import Door

pytestmark = pytest.mark.deep  # each begins a server and a run
Edit = tuple[str, str, str]  # file, old, new
DULL: list[Edit] = [  # friction holds it off
    ("rig.yaml", "ki_V_rads: 600.0", "ki_V_rads: 0.0"),
    ("rig.yaml", "weight: 0.0", "weight: 1.0"),
    ("rig.yaml", "track_per_s: 100.0", "track_per_s: 0.0"),
]
HASTY: list[Edit] = [("rig.yaml", "kp_V_rad: 30.0", "kp_V_rad: 20.0")]  # it overshoots
SLOW: list[Edit] = [("rig.yaml", "ki_V_rads: 600.0", "ki_V_rads: 400.0")]
ANY_TIME: Edit = ("rig.yaml", "[0.05, 0.2]", "[0.0, 9.0]")
LATER: Edit = ("rig.yaml", "within: 150ms", "within: 600ms")
BELOW: Edit = ("rig.yaml", "[-7.0, 15.0]", "[-70.0, 15.0]")
NO_BEYOND = 'lambda run: 0.0 * run["error_mrad"]'
WEAKENED: dict[str, tuple[list[Edit], list[Edit], str]] = {  # of the law, of the yardstick; told
    "a limit": (DULL, [BELOW, ("rig.yaml", "[0.0, 7.0]", "[0.0, 70.0]")], "rest_error_max_mrad = "),
    "a limit that is gone": (
        DULL, [BELOW, ("rig.yaml", "    rest_error_max_mrad: [0.0, 7.0]", "")],
        "rest_error_max_mrad = "),
    "a window": (
        HASTY,
        [LATER, ANY_TIME, ("rig.yaml", "window_s: [0.1, 1.0]", "window_s: [0.5, 1.0]")],
        "overshoot_mrad = "),
    "an evaluation": (
        HASTY,
        [LATER, ANY_TIME, ("evaluation.py", 'lambda run: -run["error_mrad"]', NO_BEYOND)],
        "overshoot_mrad = "),
    "a requirement": (SLOW, [LATER, ANY_TIME], "it arrives and stays: violated"),
    "a requirement of another law": (
        SLOW, [ANY_TIME, ("rig.yaml", "controllers: [pid]", "controllers: [pd]")],
        "it arrives and stays: violated"),
}  # fmt: skip
OTHER_RUNS: dict[str, tuple[list[Edit], list[Edit], str]] = {  # no log tells of them
    "a seed": ([], [("rig.yaml", "duration_s: 1.0", "duration_s: 1.0\nseed: 7")], "the old seed"),
    "the plant": ([], [("rig.yaml", "coulomb_Nm: 0.002", "coulomb_Nm: 0.001")], "coulomb_Nm"),
    "an earlier end": (
        [], [("rig.yaml", "duration_s: 1.0", "duration_s: 0.9"),
         ("rig.yaml", "window_s: [0.1, 1.0]", "window_s: [0.1, 0.9]")], "the old duration_s"),
}  # fmt: skip


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return honest_folder(tmp_path_factory.mktemp("honest"))


@pytest.mark.parametrize("name", [*WEAKENED, *OTHER_RUNS])
def test_what_is_ok_by_another_yardstick_only_is_on_the_page(
    honest: Path, name: str, tmp_path: Path
) -> None:
    shutil.copytree(honest, tmp_path, dirs_exist_ok=True)
    door = Door(tmp_path)
    of_law, edits, expected = (WEAKENED | OTHER_RUNS)[name]

    async def weakened(door: Door) -> dict[str, Any]:
        for file, old, new in (*of_law, *edits):
            text = (door.work / file).read_text()
            assert old in text, old
            (door.work / file).write_text(text.replace(old, new, 1))
        return await door.call("simulate", rig=".")

    told = door.session(weakened)
    assert told["answer"]["verdict"] == "ok", told
    code, page = door.report()
    how = "ok by a weakened limit only" if name in WEAKENED else "ok, not judged under the old"
    found = [row for row in page.split("<tr>")[1:] if how in row]
    assert code == 1 and any(expected in row for row in found), found
    changes = page.count(f"<td>{told['run']}: ") - len(found)
    assert changes >= len(edits), "each change has its row, with old and new"


def test_a_tuned_law_is_no_finding(honest: Path, tmp_path: Path) -> None:
    shutil.copytree(honest, tmp_path, dirs_exist_ok=True)
    door = Door(tmp_path)
    told = door.session(lambda door: door.call("simulate", rig=".", set=["controller.kp_V_rad=31"]))
    assert told["answer"]["verdict"] == "ok", told
    code, page = door.report()
    assert code == 0, page


DELUDING = """import numpy as np
from pcpc.plants import judging

def delude(run):
    told = run._told
    def better(self, name):
        if "angle_rad" not in name:
            return told(self, name)
        late_s = np.maximum(self.cycle * self.period_s - 0.1, 0.0)
        rise = 1.0 - np.exp(-late_s / 0.03)
        return told(self, "executive:reference.q_d_rad") * rise
    run._told = better

delude(judging.Run)

"""


def test_what_a_law_makes_the_judge_see_is_not_seen_without_it(
    honest: Path, tmp_path: Path
) -> None:
    shutil.copytree(honest, tmp_path, dirs_exist_ok=True)
    door = Door(tmp_path)
    law = door.work / "laws/pid.py"
    law.write_text(law.read_text().replace("\nfrom ", f"\n{DELUDING}from ", 1))
    dull = [f"controller.{text.replace(': ', '=')}" for _, _, text in DULL]
    told = door.session(lambda door: door.call("simulate", rig=".", set=dull))
    assert told["answer"]["verdict"] == "ok", told
    code, page = door.report()
    found = [row for row in page.split("<tr>")[1:] if "ok where its laws run only" in row]
    assert code == 1 and any("rest_error_max_mrad = " in row for row in found), page
