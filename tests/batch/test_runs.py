"""What runs in lanes hand back."""

from pathlib import Path

import pytest

from pcpc.executive.batch.runs import Case, Runs
from pcpc.executive.log import names

HULL = Path(__file__).resolve().parents[2] / "plants/atb1000/rigs/hull.yaml"


def test_a_log_of_lanes_knows_the_variables_that_it_did_not_keep() -> None:
    done = Runs(HULL, "pd", ["duration_s=0.3"], {"plant": ["barrel.theta_rad"]}).done([Case(3)])
    log = done[0].log
    assert log is not None and not done[0].alone
    assert len(log.node["plant"].columns["barrel.theta_rad"]) == 301
    for name in ("plant:barrel.theta_rad", "executive:controller.e_rad"):
        assert names.place(log, name), "what a run has is the same in lanes and alone"
    with pytest.raises(KeyError):
        log.node["executive"].columns["controller.e_rad"]
