"""Nodes that are started one by one: those whose rigs have other plants do not begin."""

from pathlib import Path

import pytest
from processes import RIGS, Running, own_bus, pcpc

from pcpc.executive.nodes.greeting import plant_of
from pcpc.executive.rig.reading import load_rig

SLEW10, HULL = str(RIGS / "slew10.yaml"), str(RIGS / "hull.yaml")


@pytest.mark.parametrize(
    ("other", "words"), [(HULL, ()), (SLEW10, ("--set", "barrel.coulomb_Nm=9.0"))]
)
def test_an_executive_beside_another_rigs_plant_does_not_begin(
    other: str, words: tuple[str, ...], tmp_path: Path
) -> None:
    usual = "--bus", own_bus(), "--pacing", "lockstep", "--quiet"
    with Running("run", "--only=plant", other, *words, *usual) as plant:
        done = pcpc(
            "run", "--only=executive", SLEW10, *usual, "--no-figure", "-o", str(tmp_path / "run")
        )
        ended = plant.done()
    assert done.code == ended.code == 4, f"{done}\n{ended}"
    for one in (done, ended):
        assert "the other node has another plant" in one.err, one


def test_what_the_plant_is_does_not_depend_on_what_the_executive_does(tmp_path: Path) -> None:
    own = plant_of(load_rig(SLEW10))
    for same in ("controller.kv_Nms_rad=90.0", "duration_s=1.0", "controller=pid", "require=[]"):
        assert plant_of(load_rig(SLEW10, settings=[same])) == own, same
    for other in ("barrel.coulomb_Nm=9.0", "seed=2", "rate_hz=500.0"):
        assert plant_of(load_rig(SLEW10, settings=[other])) != own, other
    assert plant_of(load_rig(HULL)) != own


def test_a_changed_law_is_another_plant(tmp_path: Path) -> None:
    found = []
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
        folder = tmp_path / name / "motor"
        assert pcpc("new", str(folder)).code == 0
        if name == "c":
            law = folder / "model.py"
            law.write_text(law.read_text() + "\n# another one\n")
        found.append(plant_of(load_rig(folder / "rig.yaml")))
    assert found[0] == found[1] != found[2], "wherever the files lie"
