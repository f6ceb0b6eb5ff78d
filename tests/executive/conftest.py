"""Fixtures of the loop's tests: the puppet rig, planned, a closed loop of it; rings to record."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import standing
from engine import Bench, both, puppet_rig
from rings import block_of
from small_rig import LAWS, MODEL, PARAMETERS, RIG, Write

from pcpc.executive.loop import shared
from pcpc.executive.nodes.plan import Plan
from pcpc.executive.rig.reading import load_rig


@pytest.fixture(scope="module")
def plans(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, Plan]:
    """Return both plans of the puppet rig; the executive has a clock."""
    return both(load_rig(puppet_rig(tmp_path_factory.mktemp("puppet"))))


@pytest.fixture(scope="module")
def clocked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, Plan]:
    """Return both plans of the puppet rig, each node with its own clock."""
    return both(load_rig(puppet_rig(tmp_path_factory.mktemp("puppet"))), "real")


@pytest.fixture
def bench(plans: tuple[Plan, Plan]) -> Bench:
    """Return a closed loop that sends 1 N m and has done ten cycles."""
    made = Bench(plans)
    made.executive["controller.torque_Nm"] = 1.0
    assert made.run(10) == 10 and made.executive.state == "RUN"
    return made


@pytest.fixture
def name() -> Iterator[str]:
    """Return a node's name of this test; what stands under it ends afterwards."""
    yield f"test-recorder-{os.getpid()}"
    standing.end_all()


@pytest.fixture
def block(name: str) -> shared.NodeMemory:
    """Return an executive's block."""
    return block_of(name)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder for files as they stand here: their laws are compiled once."""
    return tmp_path_factory.mktemp("compiled")


@pytest.fixture
def write(compiled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Write a small rig to an own folder, with `old` replaced by `new` in any of its files."""

    def write(old: str = "", new: str = "") -> Path:
        texts = {
            "small.yaml": RIG, "parameters.yaml": PARAMETERS, "laws.py": LAWS, "model.py": MODEL,
            "small.dbc": "", "evaluation.py": "", "none.py": "",
        }  # fmt: skip
        assert not old or sum(text.count(old) for text in texts.values()) == 1, old
        for name, text in texts.items():
            (tmp_path / name).unlink(missing_ok=True)
            if name in ("laws.py", "model.py") and (not old or old not in text):
                if not (compiled / name).exists():
                    (compiled / name).write_text(text)
                (tmp_path / name).symlink_to(compiled / name)
            else:
                (tmp_path / name).write_text(text.replace(old, new) if old else text)
        return Path("small.yaml")

    monkeypatch.chdir(tmp_path)
    return write
