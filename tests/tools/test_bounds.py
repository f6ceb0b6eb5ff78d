"""`pcpc bounds`: the same of a rig and of its log, exit codes, JSON, a picture, what it refuses."""

import json
from pathlib import Path

import pytest
from processes import pcpc

from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig

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
