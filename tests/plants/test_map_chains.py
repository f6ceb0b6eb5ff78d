"""Two chains behind deadzones or gaps: the second-order maps within them, order, coupling."""

from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from judged import judged
from stepped import Stepped

from pcpc.executive.errors import RigError
from pcpc.executive.laws.block import Block
from pcpc.executive.nodes.plan import check_pacing
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.backlash_map import model as gap_model
from pcpc.plants.backlash_map.laws import backlash_nn_discrete
from pcpc.plants.deadzone_map import model as zone_model
from pcpc.plants.deadzone_map.laws import deadzone_fuzzy
from pcpc.plants.map_chains import evaluation, model
from pcpc.plants.map_chains.laws import chains_fuzzy, chains_nn, chains_pd

RIGS = Path(model.__file__).parent / "rigs"
SINGLE = {"order": 2.0, "coupling": 0.0, "c": 0.1875}
GAINS = {"lam": 0.2, "kv": 0.3, "model_c": 0.15, "r_max": 15.0}
TUNING = {"alpha": 0.1, "gam": 0.001}
run = cache(partial(judged, evaluation))


def wanted(k: int) -> tuple[float, float, float, float]:
    """Return x_d of k - 2 to k + 1."""
    before, previous, now, after = np.cos(0.05 * np.arange(k - 2, k + 2))
    return before, previous, now, after


def asked(k: int, sample: object, *more: str) -> list[float]:
    """Return what a chain's law is given."""
    states = [getattr(sample, name) for name in ("x1", "x2", "x3", *more)]
    return [*wanted(k), *states]


def test_chains_of_second_order_are_the_map_behind_its_deadzone_bit_for_bit() -> None:
    zones, steps = (0.1, 0.3), 300
    both = Stepped(model.BLOCK, {**SINGLE, "a_dead": zones[0], "b_dead": zones[1]}, 0.1)
    law = Stepped(chains_fuzzy.BLOCK, {**GAINS, **TUNING}, 0.1)
    found, u = np.zeros((2, steps, 3)), (0.0, 0.0)
    for k in range(steps):
        y = both.step(*u, 0.0)
        told = law.step(*asked(k, y.sample_a), *asked(k, y.sample_b))
        u = (told.a.command, told.b.command)
        found[:, k] = (y.a.x2, y.a.x3, u[0]), (y.b.x2, y.b.x3, u[1])
    for of_one, d in zip(found, zones, strict=True):
        one = Stepped(zone_model.BLOCK, {"c": 0.1875, "d": d}, 0.1)
        fuzzy = Stepped(deadzone_fuzzy.BLOCK, {**GAINS, **TUNING}, 0.1)
        command = 0.0
        for k in range(steps):
            y = one.step(command).true
            command = fuzzy.step(y.x1, y.x2, *wanted(k)[1:]).command
            assert (y.x1, y.x2, command) == tuple(of_one[k]), f"width {d}, step {k}"


def test_chains_of_second_order_are_the_map_behind_its_gap_bit_for_bit() -> None:
    gaps, steps = (0.2, 0.1), 400
    given = {
        f"{c}_{n}": v
        for c, g in zip("ab", gaps, strict=True)
        for n, v in (("gap", g), ("slope", 0.5))
    }
    both = Stepped(model.BLOCK, {**SINGLE, **given}, 1e-3)
    law = Stepped(chains_nn.BLOCK, {"network_seed": 3.0, "r_max": 1e3}, 1e-3)
    found, u = np.zeros((2, steps, 4)), (0.0, 0.0)
    for k in range(steps):
        y = both.step(*u, 1.0)
        told = law.step(*asked(k, y.sample_a, "tau"), *asked(k, y.sample_b, "tau"))
        u = (told.a.command, told.b.command)
        found[:, k] = (y.a.x2, y.a.x3, y.a.tau, u[0]), (y.b.x2, y.b.x3, y.b.tau, u[1])
    for seed, (of_one, gap) in enumerate(zip(found, gaps, strict=True), start=3):
        settings = {"c": 0.1875, "d_plus": gap, "d_minus": -gap, "slope": 0.5}
        quanta = dict.fromkeys(("delay_samples", "x_lsb", "tau_lsb", "command_lsb"), 0.0)
        one = Stepped(gap_model.BLOCK, settings | quanta, 1e-3)
        single = Stepped(backlash_nn_discrete.BLOCK, {"network_seed": float(seed)}, 1e-3)
        command = 0.0
        for k in range(steps):
            y = one.step(command, 1.0).true
            command = single.step(*wanted(k)[1:], y.x1, y.x2, y.tau).command
            assert (y.x1, y.x2, y.tau, command) == tuple(of_one[k]), f"gap {gap}, step {k}"


@pytest.mark.parametrize(
    ("rig", "other"), [("two-deadzones", "chains.b_dead=0.2"), ("two-gaps", "chains.b_gap=0.15")]
)
def test_without_coupling_a_chain_knows_nothing_of_the_other(rig: str, other: str) -> None:
    def newest(chain: str, *settings: str) -> bytes:
        columns = run(rig, None, "duration_s=3.0", *settings)[0].node["plant"].columns
        return bytes(columns[f"chains.{chain}_x3"].tobytes())

    alone = ("chains.coupling=0.0", "controller.model_coupling=0.0")
    assert newest("a", *alone) == newest("a", *alone, other)
    assert newest("b", *alone) != newest("b", *alone, other), "the setting does nothing"
    assert newest("a") != newest("a", other), "coupled, yet nothing is seen"


@pytest.mark.parametrize("order", [2.0, 3.0])
@pytest.mark.parametrize("kappa", [0.0, 0.4])
@pytest.mark.parametrize(
    ("block", "more"), [(chains_pd.BLOCK, {}), (chains_fuzzy.BLOCK, {"alpha": 0.0, "gam": 0.0})]
)
def test_with_an_exact_model_r_falls_by_kv_and_e_by_the_roots_of_lam(
    order: float, kappa: float, block: Block, more: dict[str, float]
) -> None:
    """Roots of z^2 + lam z + lam_2: -0.5 and 0.3; of z + lam in second order: -0.2."""
    made = Stepped(model.BLOCK, {"order": order, "c": 0.1875, "coupling": kappa}, 0.1)
    lam, lam_2 = (0.2, -0.15) if order == 3.0 else (0.2, 0.0)
    given = {"order": order, "lam": lam, "lam_2": lam_2, "kv": 0.7, "model_coupling": kappa}
    law = Stepped(block, GAINS | {"model_c": 0.1875} | given | more, 0.1)
    made.x.a.x3, made.x.b.x3, made.x.b.x2 = 0.4, -1.1, 0.3
    u, rows = (0.0, 0.0), []
    for k in range(40):
        y = made.step(*u, 0.0)
        told = law.step(*asked(k, y.sample_a), *asked(k, y.sample_b))
        u = (told.a.command, told.b.command)
        rows.append([told.a.r, told.a.e, told.b.r, told.b.e])
    r_a, e_a, r_b, e_b = np.array(rows).T
    for r, e in ((r_a, e_a), (r_b, e_b)):
        assert np.abs(r[1:] - 0.7 * r[:-1]).max() < 1e-13
        assert np.abs(e[4:] + lam * e[3:-1] + lam_2 * e[2:-2] - r[4:]).max() < 1e-13
        assert abs(e[-1]) < 1e-4 < abs(e[0])


def plain(steps: int, widths: tuple[float, float]) -> np.ndarray:
    """Return x3 of both chains and four widths, computed another way: third order, matrices."""
    x, learned, fired = np.zeros((2, 3)), np.zeros(4), None
    amplitude, omega, phase = np.array([1.0, 0.8]), np.array([0.5, 0.7]), np.array([np.pi / 2, 0.0])
    rows = []
    for k in range(steps):
        x_d = [amplitude * np.sin(omega * 0.1 * (k + i) + phase) for i in (-2, -1, 0, 1)]
        e = np.array([x[:, 2] - x_d[2], x[:, 1] - x_d[1], x[:, 0] - x_d[0]])
        r = np.array([1.0, 0.2, 0.01]) @ e
        if fired is not None:
            norm = np.linalg.norm(np.eye(2) - 0.1 * np.diag([1.0, 0.0]), 2)
            learned = learned - 0.1 * fired * np.repeat(r, 2) - 0.001 * norm * learned
        f = -0.15 * x[:, 0] / (1.0 + x[:, 2] ** 2) + x[:, 2]
        w = x_d[3] - np.array([0.2, 0.01]) @ e[:2] - f + 0.3 * r
        fired = np.where(np.repeat(w >= 0.0, 2), [1.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, -1.0])
        u = w + (learned * fired).reshape(2, 2).sum(axis=1)
        tau = np.sign(u) * np.maximum(np.abs(u) - np.array(widths), 0.0)
        rows.append([*x[:, 2], *learned])
        true = -0.1875 * x[:, 0] + 0.05 * x[::-1, 2]
        x = np.column_stack([x[:, 1], x[:, 2], true / (1.0 + x[:, 2] ** 2) + x[:, 2] + tau])
    return np.array(rows)


def test_the_coupled_rig_of_third_order_runs_as_matrices_do() -> None:
    log = run("two-deadzones", "fuzzy")[0]
    states, law = log.node["plant"].columns, log.node["executive"].columns
    names = ("a_d_plus", "a_d_minus", "b_d_plus", "b_d_minus")
    found = [
        states["chains.a_x3"],
        states["chains.b_x3"],
        *(law[f"controller.{name}"] for name in names),
    ]
    worst = [
        float(np.abs(one[:300] - other).max())
        for one, other in zip(found, plain(300, (0.1, 0.3)).T, strict=True)
    ]
    assert max(worst) < 1e-3, f"{worst}; frames carry steps of 2e-6, and rules switch at 0"


@pytest.mark.parametrize("chain", ["a", "b"])
def test_four_widths_are_learned_and_the_errors_fall(chain: str) -> None:
    pd, fuzzy = (run("two-deadzones", law)[1] for law in ("pd", "fuzzy"))
    times = pd[f"error_{chain}_rms"] / fuzzy[f"error_{chain}_rms"]
    assert 6.0 < times < 25.0, f"{times:.1f} times better"
    width = {"a": 0.1, "b": 0.3}[chain]
    for side in ("plus", "minus"):  # they take in what the model does not know of coupling and c
        assert abs(fuzzy[f"{chain}_d_{side}"] - width) < 0.06, fuzzy
    assert fuzzy[f"{chain}_diverged"] == 0.0


@pytest.mark.parametrize("seed", [1, 2, 11])
def test_two_networks_follow_through_two_gaps(seed: int) -> None:
    found = run("two-gaps", "nn", f"controller.network_seed={seed}.0")[1]
    for chain in "ab":
        assert 1e-4 < found[f"error_{chain}_rms"] < 0.01, found
    assert found["a_diverged"] == found["b_diverged"] == 0.0


def test_without_networks_nothing_moves_and_without_the_coupling_known_little_is_left() -> None:
    log, found = run("two-gaps", "pd_slow")
    states = log.node["plant"].columns
    assert not states["chains.a_x3"].any() and not states["chains.b_x3"].any()
    assert found["error_a_rms"] == pytest.approx(0.7568, abs=1e-4)
    unaware, nn = (run("two-gaps", law)[1] for law in ("nn_unaware", "nn"))
    for chain in "ab":
        assert unaware[f"error_{chain}_rms"] > 20.0 * nn[f"error_{chain}_rms"]


def test_on_a_clock_the_laws_that_stand_no_late_sample_are_refused() -> None:
    for rig, law in (("two-deadzones", "fuzzy"), ("two-gaps", "nn")):
        with pytest.raises(RigError, match=r"--controller pd or pd_exact or pd_slow"):
            check_pacing(load_rig(RIGS / f"{rig}.yaml", law), "real")
