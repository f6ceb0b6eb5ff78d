"""`pcpc bounds`: the same of a rig and of its log, exit codes, JSON, a picture, what it refuses."""

import json
from pathlib import Path

import pytest
from processes import pcpc

import pcpc as pcpc_package
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.experiments import theorems

RIG = Path(__file__).resolve().parents[2] / "plants/friction_arm/rigs/friction-c.yaml"
SHORT = "duration_s=1.5"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a short run."""
    path = tmp_path_factory.mktemp("bounds") / "log.mcap"
    simulate(load_rig(RIG, settings=[SHORT]), path)
    return path


def test_a_log_says_what_its_rig_says(log: Path, tmp_path: Path) -> None:
    """Weights are in no log: they are recomputed."""
    picture = tmp_path / "bounds.png"
    of_log = pcpc("bounds", str(log), "--json", "--plot", str(picture))
    of_rig = pcpc("bounds", "friction-c", "--set", SHORT, "--json")
    assert of_log.code == of_rig.code == 0, of_log
    found = json.loads(of_log.out)
    assert found == json.loads(of_rig.out)
    assert found["theorem"] == "Theorem 3.2.2" and found["holds"]
    assert picture.stat().st_size > 20_000


def test_a_violation_ends_with_1_and_is_named() -> None:
    done = pcpc("bounds", "friction-c", "--set", SHORT, "--set", "controller.kappa=0.0")
    assert done.code == 1, done
    assert "VIOLATED   leak kappa above 0: kappa 0" in done.out
    assert max(map(len, done.out.splitlines())) <= 80


def test_where_there_is_no_theorem_a_line_says_so() -> None:
    done = pcpc("bounds", "friction-c", "--controller", "pd", "--set", SHORT)
    assert done.code == 0, done
    assert done.out == (
        "no theorem: none is known here of the law arm_pd; its plant has those of friction_nn\n"
    )


def test_what_it_refuses(log: Path) -> None:
    done = pcpc("bounds", "friction-c", "--as", "friction_n")
    assert done.code == 2 and "did you mean friction_nn" in done.err, done
    done = pcpc("bounds", str(log), "--set", "controller.kappa=0.1")
    assert done.code == 2 and "a log is what it is" in done.err, done


def test_python_says_the_same(log: Path, tmp_path: Path) -> None:
    found = pcpc_package.bounds(log)
    of_rig = pcpc_package.bounds("friction-c", set={"duration_s": 1.5})
    assert found.holds and found.to_dict() == of_rig.to_dict()
    assert found.draw(tmp_path / "bounds.png").stat().st_size > 20_000
    with pytest.raises(
        pcpc_package.Error, match="no theorem: none is known here of the law arm_pd"
    ):
        pcpc_package.bounds("friction-c", "pd")


def test_the_experiment_finds_what_is_mistuned_and_what_is_switched_off() -> None:
    rig = str(RIG.parents[2] / "deadzone_map/rigs/fuzzy-d03.yaml")
    rows = theorems.rows_of((rig, "fuzzy"))
    assert [bool(row.violated) for row in rows] == [False, True, True, True], rows
    off = theorems.rows_of(
        (str(RIG.parents[2] / "backlash_map/rigs/backlash-map.yaml"), "inversion")
    )
    assert len(off) == 1 and off[0].off, off
    text = theorems.report([*rows, *off])
    assert "fuzzy-d03 | fuzzy | theorem of chapter 4.3" in text
    assert "which violates: backlash-map inversion" in text


def test_a_picture_is_drawn_of_each_plant_that_has_a_theorem() -> None:
    plants = {path.parent.name for path in theorems.PLANTS.glob("*/theorem.py")}
    assert plants == set(theorems.SHOWN)
