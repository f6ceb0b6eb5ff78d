"""Fixtures of the loop's tests: the puppet rig, planned, a closed loop of it; rings to record."""

import os
from collections.abc import Iterator

import pytest
import standing
from engine import Bench, both, puppet_rig
from rings import block_of

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
def block(name: str) -> shared.Shared:
    """Return an executive's block."""
    return block_of(name)
