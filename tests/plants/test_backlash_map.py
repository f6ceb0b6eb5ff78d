"""The map behind backlash: whose step a command is for, a second derivation, what is reached."""

from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from judged import judged
from stepped import Stepped, parameters

from pcpc.executive.errors import RigError
from pcpc.executive.nodes.plan import check_pacing
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.backlash_map import evaluation
from pcpc.plants.backlash_map.laws import backlash_nn_discrete
from pcpc.plants.backlash_map.model import BLOCK
from pcpc.plants.families.maps.laws import map_pd

PLANT = Path(evaluation.__file__).parent
NOMINAL = parameters(PLANT)
T_S = 1e-3
run = cache(partial(judged, evaluation))


def plant(**settings: float) -> Stepped:
    assert set(settings) <= set(NOMINAL), settings
    return Stepped(BLOCK, NOMINAL | settings, T_S)


def x_d(k: int) -> float:
    return float(np.sin(0.5 * k * T_S + np.pi / 2))


def play(tau: float, u: float) -> float:
    return min(max(tau, 0.5 * (u - 0.2)), 0.5 * (u + 0.2))


def test_a_command_for_this_step_acts_in_it_and_one_ahead_in_the_next() -> None:
    now, ahead = plant(), plant()
    for made in (now, ahead):
        made.step(0.0, 0.0)
    assert now.step(1.0, 0.0).sample.x2 == 0.4, "for this step: tau = play(1) = 0.4 is in x2"
    first = ahead.step(1.0, 1.0).sample
    assert (first.x2, first.tau) == (0.0, 0.4), f"ahead: x2, tau {first.x2}, {first.tau}"
    assert ahead.step(1.0, 1.0).sample.x2 == 0.4, "one step later"


def test_every_law_says_itself_which_step_its_command_is_for() -> None:
    assert Stepped(map_pd.BLOCK, {}, T_S).step(0, 0, 0, 0, 0).ahead == 0.0
    for on in (0.0, 1.0):
        law = Stepped(backlash_nn_discrete.BLOCK, {"network_on": on}, T_S)
        assert law.step(0, 0, 0, 0, 0, 0).ahead == 1.0
    wiring = load_rig(PLANT / "rigs" / "backlash-map.yaml").config
    assert wiring.executive.transmit["CMD.ahead"] == "controller.ahead"
    assert wiring.plant.blocks["map"].inputs["ahead"] == "rx.CMD.ahead"


def test_on_a_clock_the_network_is_refused_with_a_cure() -> None:
    rig = load_rig(PLANT / "rigs" / "backlash-map.yaml", "nn")
    with pytest.raises(RigError, match=r"one sample of delay more.*--controller pd or inversion"):
        check_pacing(rig, "real")
    check_pacing(load_rig(PLANT / "rigs" / "backlash-map.yaml", "nn_detuned"), "real")


def test_without_gap_the_filtered_error_falls_by_kv_a_step() -> None:
    law, made = Stepped(map_pd.BLOCK, {}, T_S), plant(d_plus=0.0, d_minus=0.0, slope=1.0)
    u, errors = 0.0, []
    for k in range(200):
        y = made.step(u, 0.0).sample
        u = law.step(x_d(k - 1), x_d(k), x_d(k + 1), y.x1, y.x2).command
        errors.append(law.y.r)
    ratios = np.array(errors[2:]) / np.array(errors[1:-1])
    worst = np.abs(ratios - 0.998).max()
    assert worst < 1e-9, f"off by {worst:.1e}"


def reference(n: int, seed: int, jumps: bool) -> np.ndarray:
    """Return x1, x2, tau, u (n, 4) of plant and law in plain numpy, as published."""
    v, w = np.random.default_rng(seed).uniform(-1.0, 1.0, (6, 10)), np.zeros(12)
    x1 = x2 = tau = u = g = 0.0
    s, before, rows = None, None, np.zeros((n, 4))
    for k in range(n):
        e2, e1 = x2 - x_d(k), x1 - x_d(k - 1)
        r = e2 + 0.2 * e1
        f = -3.0 / 16.0 * x1 / (1.0 + x2**2) + x2
        tau_d = x_d(k + 1) - 0.2 * e2 - f + 0.998 * r
        tt = tau_d - tau
        if s is not None:
            norm = np.linalg.norm(np.eye(12) - 0.15 * np.outer(s, s), 2)
            w = w + 0.15 * s * (tt - 0.3 * r) - 1e-5 * norm * w
        g = 0.0 if before is None else 0.9 * g + 0.1 * (tau_d - before)
        before = tau_d
        a = v.T @ np.array([1.0, r, x_d(k - 1), x_d(k), tt, tau])
        s = np.concatenate([1.0 / (1.0 + np.exp(-a)), [jumps * (tt > 0), jumps * (tt < 0)]])
        coming = float(np.clip(-0.3 * tt + tau_d + g + w @ s, -10.0, 10.0))
        rows[k] = x1, x2, tau, u
        x1, x2 = x2, f + tau
        u = coming
        tau = play(tau, u)
    return rows


@pytest.mark.parametrize("jumps", [True, False])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_second_derivation_in_numpy_gives_the_same_run(seed: int, jumps: bool) -> None:
    given = {"network_seed": float(seed), "jumps_on": float(jumps)}
    law, made = Stepped(backlash_nn_discrete.BLOCK, given, T_S), plant()
    u, n = 0.0, 1500
    rows = np.zeros((n, 4))
    for k in range(n):
        y = made.step(u, 1.0)
        rows[k] = *y.true.values(), y.acting
        u = law.step(x_d(k - 1), x_d(k), x_d(k + 1), *y.sample.values()).command
    worst = np.abs(rows - reference(n, seed, jumps)).max()
    assert worst < 1e-9, f"differ by {worst:.1e} within {n} steps"


def test_without_a_network_u_never_leaves_the_gap() -> None:
    for controller in ("pd", "inversion"):
        found = run("backlash-map", controller)[1]
        assert found["x2_max"] == 0.0, f"{controller}: x2 moved by {found['x2_max']:.1e}"
        assert found["error_rms"] == pytest.approx(0.7568, abs=1e-4), f"{found['error_rms']:.4f}"
        assert found["early_error_rms"] == pytest.approx(0.5244, abs=1e-4)


def test_without_a_gap_pd_settles_in_one_and_a_half_seconds() -> None:
    found = run("backlash-map-ideal", "pd")[1]
    assert found["settled_s"] == pytest.approx(1.496, abs=2e-3), f"{found['settled_s']:.3f} s"
    assert found["error_rms"] < 1e-8, f"{found['error_rms']:.1e}"


@pytest.mark.parametrize("seed", range(6))
def test_the_network_follows_through_the_gap(seed: int) -> None:
    found = run("backlash-map", "nn", f"controller.network_seed={seed}.0")[1]
    rms, early = found["error_rms"], found["error_half_max"]  # worst of 80 runs: 0.0077, 0.0009
    assert 1e-4 < rms < 0.01, f"rms over 10 to 20 s {rms:.4f}"
    assert early < 0.05, f"largest from 0.5 to 5 s {early:.4f}"


def test_the_network_pays_with_jumps_of_the_command() -> None:
    found = run("backlash-map", "nn")[1]
    median, share = found["command_jump_median"], found["command_jumps_share"]
    assert 0.3 < median < 0.42, f"median {median:.3f}: about the gap of 0.4"
    assert 0.4 < share < 0.95, f"{share:.2f} of the steps beyond 0.3"


def test_without_jump_nodes_a_limit_cycle_stays() -> None:
    found = run("backlash-map", "nn_sigmoid")[1]
    assert found["error_rms"] == pytest.approx(0.0704, rel=0.05), f"{found['error_rms']:.4f}"


def test_a_model_error_costs_the_network_a_hundredfold() -> None:
    found = run("backlash-map", "nn", "controller.model_c=0.15")[1]
    assert 0.05 < found["error_rms"] < 0.075, f"{found['error_rms']:.4f}"


def test_one_sample_of_delay_more_is_unstable_and_the_slow_gains_are_not() -> None:
    fast, slow = (run("backlash-map-late", name)[1] for name in ("nn", "nn_detuned"))
    assert fast["error_rms"] > 1.0, f"{fast['error_rms']:.3f}"
    assert 0.035 < slow["error_rms"] < 0.055, f"{slow['error_rms']:.3f}"
    assert slow["settled_s"] > 15.0, f"{slow['settled_s']:.1f} s: better than it can be"


def test_coarse_samples_spoil_it() -> None:
    coarse = ("map.x_lsb=1e-3", "map.tau_lsb=1e-3", "map.command_lsb=1e-3")
    found = run("backlash-map", "nn", *coarse)[1]
    assert found["error_rms"] > 0.01, f"{found['error_rms']:.4f}"


def test_the_guard_ends_a_run_away_and_stays() -> None:
    log, found = run("backlash-map", "nn", "controller.cr=1.0")
    columns = log.node["executive"].columns
    diverged, command = columns["controller.diverged"], columns["controller.command"]
    first = int(np.argmax(diverged))
    assert found["diverged"] == 1.0 and (diverged[first:] == 1.0).all(), "not latched"
    assert (command[first:] == 0.0).all() and command[first - 1] != 0.0
