"""A check in which nothing was compared or judged is not passed."""

from pathlib import Path

import pytest
from logcommand import run_here
from processes import RIGS

from pcpc.executive.nodes.virtual import VirtualRun, simulate
from pcpc.executive.rig.reading import load_rig


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a log without a cycle, of a rig with a requirement."""
    path = tmp_path_factory.mktemp("empty") / "log.mcap"
    required = "require=[{name: calm, always: abs(controller.e_rad) < 1 mrad}]"
    VirtualRun(load_rig(RIGS / "slew10.yaml", "pd", [required]), path).close()
    return path


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("compare", "--bits", "LOG", "LOG"), 3, "nothing compared"),
        (("compare", "LOG", "LOG"), 3, "nothing was compared: the logs share no cycle"),
        (("report", "--requirements", "LOG"), 1, "calm: not judged"),
        (("replay", "LOG"), 3, "nothing to compare"),
    ],
)
def test_a_log_without_a_cycle_passes_no_check(
    words: tuple[str, ...], code: int, said: str, empty: Path
) -> None:
    done = run_here(*(str(empty) if word == "LOG" else word for word in words))
    assert done.code == code and said in " ".join(done.out.split()), done


def test_a_log_that_cannot_be_read_on_both_sides_is_not_left_out(tmp_path: Path) -> None:
    for side in ("old", "new"):
        (tmp_path / side / "good").mkdir(parents=True)
        (tmp_path / side / "bad").mkdir()
        rig = load_rig(RIGS / "slew10.yaml", "pd", ["duration_s=0.05"])
        simulate(rig, tmp_path / side / "good" / "log.mcap")
        (tmp_path / side / "bad" / "log.mcap").write_text("no log\n")
    done = run_here("compare", str(tmp_path / "old"), str(tmp_path / "new"))
    assert done.code == 1 and done.out.count("not an MCAP file") == 2, done
