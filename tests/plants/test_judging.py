"""Records of different nodes are brought together by time, whatever each of them skipped."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pcpc.executive.log.reader import FRAME, Log, Node
from pcpc.plants.judging import Mistake, Run

CYCLES, PERIOD_NS = 200, 1_000_000
PHASES_NS = {"executive": 70_000, "local": 40_000, "plant": 0}  # they wake one after the other
NODES = tuple(PHASES_NS)


def told_by(node: str, skipped: range, pacing: str) -> Node:
    """Return a node that counts the periods in `NODE.k`; a cycle that was skipped is not there."""
    k = np.setdiff1d(np.arange(CYCLES), skipped)
    stamps = k * PERIOD_NS + (PHASES_NS[node] if pacing == "real" else 0)
    columns = {f"{node}.k": k.astype(float)}
    return Node(k, stamps, columns, {}, np.empty(0, FRAME), [], [], {})


def log(skipping: str = "", pacing: str = "real", skipped: range = range(50, 57)) -> Log:
    """Return a log of three nodes, of which one skips cycles."""
    of = {n: told_by(n, skipped if n == skipping else range(0), pacing) for n in NODES}
    return Log(Path(), of, {}, {"executive": {"pacing": pacing}}, [])


def age(run: Run, node: str) -> NDArray[np.float64]:
    """Return how many periods older the record of `node` is than the cycle."""
    found: NDArray[np.float64] = run.cycle - run.get(f"{node}:{node}.k")
    return found


@pytest.mark.parametrize("pacing", ["real", "lockstep", "virtual"])
@pytest.mark.parametrize("skipping", NODES)
@pytest.mark.parametrize("leader", ["executive", "plant"])
def test_cycles_that_one_node_skips_shift_no_other(skipping: str, leader: str, pacing: str) -> None:
    run = Run(log(skipping, pacing), 1e-3, leader)
    for node in NODES:
        known = age(run, node)
        late = pacing == "real" and PHASES_NS[node] > PHASES_NS[leader]
        assert set(known[1:50]) == {1.0 if late else 0.0}, f"{node}: {known[:50]}"
        assert np.nanmax(known) <= (3.0 if late else 2.0), f"{node}: {np.nanmax(known)} periods old"
        if not late:
            assert (known[60:] == 0.0).all(), f"{node}: {known[60:]}"


def test_the_local_nodes_variables_are_its_own() -> None:
    run = Run(log("executive"), 1e-3)
    assert np.array_equal(run.get("local:local.k"), run.cycle), "the executive wakes after it"
    assert np.isnan(run.get("local:plant.k")).all(), "the plant's are not the local node's"
    with pytest.raises(Mistake, match=r"no signal locl:local.k; did you mean local:local.k\?"):
        run["locl:local.k"]


def test_a_node_that_fell_silent_tells_nothing() -> None:
    whole = log()
    local = replace(
        whole.node["local"], cycle=np.arange(100), stamp_ns=np.arange(100) * PERIOD_NS,
        columns={"local.k": np.arange(100.0)},
    )  # fmt: skip
    found = Run(replace(whole, node=whole.node | {"local": local}), 1e-3).get("local:local.k")
    assert np.array_equal(found[:100], np.arange(100.0)) and np.isnan(found[102:]).all(), found


def test_neighbours_of_a_gap_have_no_change() -> None:
    run = Run(log("executive"), 1e-3)
    values = run.cycle.astype(float) ** 2
    gap = int(np.searchsorted(run.cycle, 57))
    assert np.isnan(run.step(values)[[0, gap]]).all(), run.step(values)[gap - 1 : gap + 2]
    assert np.isnan(run.after(values)[[gap - 1, -1]]).all(), run.after(values)[gap - 2 : gap + 1]
    expected = np.delete(2.0 * run.cycle - 1.0, [0, gap])
    assert np.array_equal(np.delete(run.step(values), [0, gap]), expected)
