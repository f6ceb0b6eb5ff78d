"""Records of different nodes belong together by time; figures are taken over the rig's windows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pcpc.executive.log.reader import FRAME, Log, NodeLog
from pcpc.plants.evaluation import EACH, LATE, RUN, Evaluation, Mean, Peak
from pcpc.plants.judging import DeclarationError, Run

CYCLES, PERIOD_NS = 200, 1_000_000
PHASES_NS = {"executive": 70_000, "local": 40_000, "plant": 0}  # they wake one after the other
NODES = tuple(PHASES_NS)


def told_by(node: str, skipped: range, pacing: str) -> NodeLog:
    """Return a node that counts the periods in `NODE.k`; a cycle that was skipped is not there."""
    k = np.setdiff1d(np.arange(CYCLES), skipped)
    stamps = k * PERIOD_NS + (PHASES_NS[node] if pacing == "real" else 0)
    columns = {f"{node}.k": k.astype(float)}
    return NodeLog(k, stamps, columns, {}, np.empty(0, FRAME), [], [], {})


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
    with pytest.raises(
        DeclarationError, match=r"no signal locl:local.k; did you mean local:local.k\?"
    ):
        run["locl:local.k"]


def test_a_node_that_fell_silent_tells_nothing() -> None:
    whole = log()
    local = replace(
        whole.node["local"],
        cycle=np.arange(100),
        stamp_ns=np.arange(100) * PERIOD_NS,
        columns={"local.k": np.arange(100.0)},
    )
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


SHOWN = "late {late_k_max:.0f}, early {early_k_mean:.1f}"
EVALUATION = Evaluation(
    signals={"k": lambda run: run["plant:plant.k"], "twice": lambda run: 2.0 * run["k"]},
    merits={
        "k_mean": Mean("k", EACH),
        "twice_max": Peak("twice", RUN),
        "late_k_max": Peak("k", LATE),
        "early_k_max": Peak("k", "early"),
        "bound_share": Mean(lambda run: run["k"] > run.numbers["bound"], needs="bound"),
        "spread": lambda judged: judged.measured({"k": Peak("k", RUN)})["k"] / 2.0,
        "gone": Peak("executive:controller.other_laws_only", RUN),
    },
    notes=((SHOWN, "gone {gone}"), (lambda metrics: f"of {len(metrics)}",)),
    numbers=("bound",),
)


def told(**numbers: float) -> dict[str, float]:
    """Return the figures of a virtual run of 200 cycles, window 50 to 100 ms."""
    return EVALUATION.judge(log(pacing="virtual"), (0.05, 0.1), numbers, 1e-3)


def test_a_merit_is_taken_over_the_windows_that_the_rig_has() -> None:
    assert told() == {
        "k_mean": 74.5, "twice_max": 398.0, "late_k_max": 199.0, "spread": 99.5,
    }  # fmt: skip
    found = told(early_from_s=0.01, early_to_s=0.02, rest_from_s=0.19, bound=90.0)
    assert found["early_k_mean"] == 14.5 and found["early_k_max"] == 19.0, found
    assert found["rest_k_mean"] == 194.5, f"{found}: no _to_s means the end"
    assert found["bound_share"] == 9 / 50, found
    assert EVALUATION.judge(log(pacing="virtual"), (1.0, 2.0), {}, 1e-3) == {}, "behind the end"


def test_numbers_that_nothing_asks_for_are_named() -> None:
    given = {"bound": 1.0, "any_from_s": 0.0, "any_to_s": 0.1, "bond": 1.0, "lost_to_s": 0.1}
    assert dict(EVALUATION.unknown(given)) == {
        "bond": "; did you mean bound?",
        "lost_to_s": " without lost_from_s",
    }
