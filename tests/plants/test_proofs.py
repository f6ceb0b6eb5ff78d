"""The books' proofs on runs made up, where no term is small: each follows its identity."""

import importlib
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from made_runs import Made, N, T
from made_systems import MADE, WIDE

from pcpc.plants.lyapunov import Account, Proof

SEEDS = (2, 12)
NOTHING: Mapping[str, Any] = {}
EXACT = ("backlash_map", "deadzone_map", "map_chains")


@cache
def made(plant: str, seed: int) -> Made:
    """Return a run made up."""
    return MADE[plant](seed)


def proof_of(plant: str, seed: int, changed: Mapping[str, Any] = NOTHING) -> Proof:
    """Return what the theorem of a plant says of a run made up, with other columns or settings."""
    module = importlib.import_module(f"pcpc.plants.{plant}.book.theorem")
    with np.errstate(all="ignore"):
        return next(iter(module.THEOREMS.values())).prove(made(plant, seed).cycles(**changed))


@cache
def account(plant: str, seed: int) -> Account:
    """Return the account of a run made up."""
    return Account(proof_of(plant, seed), 0.5 * T)


@pytest.mark.parametrize("plant", MADE)
@pytest.mark.parametrize("seed", SEEDS)
def test_a_difference_of_v_is_what_the_proof_says(plant: str, seed: int) -> None:
    """Of the least of its terms no hundredth is missing; in the first cycle V is made V*."""
    one = account(plant, seed)
    right = one.proved_slope + sum(values[:-1] for values in one.proof.beyond.values())
    parts = (one.proof.damping, *one.proof.terms.values(), *one.proof.beyond.values())
    least = min(float(np.abs(values).max()) for values in parts)
    off = float(np.abs(one.slope - right)[1:].max()) / least
    assert off < (1e-12 if plant in EXACT else 1e-2), off


def test_nodes_that_are_too_large_are_forgotten_by_the_norm_of_their_matrix() -> None:
    test_a_difference_of_v_is_what_the_proof_says("backlash_map", WIDE)


@pytest.mark.parametrize("plant", MADE)
@pytest.mark.parametrize("seed", SEEDS)
def test_weights_that_obey_the_law_move_as_the_proof_has_them(plant: str, seed: int) -> None:
    one = account(plant, seed)
    for layer in one.proof.tuned:
        late = replace(layer, moved=layer.moved[1:], driven=layer.driven[1:])
        assert late.apart(one.period_s[1:]) < 1e-7, layer.name
    rates = [layer.rate for layer in one.proof.tuned]
    assert sorted(rates) == sorted(made(plant, seed).declared.values())


@pytest.mark.parametrize("plant", MADE)
@pytest.mark.parametrize("seed", SEEDS)
def test_what_nothing_cancels_is_below_the_constants(plant: str, seed: int) -> None:
    proof = account(plant, seed).proof
    most = proof.constants.c0 + proof.constants.c1 * proof.weights
    assert (proof.rest <= most * (1.0 + 1e-9))[:-1].all(), (proof.rest / most).max()


SIDES = 0.7 * math.sqrt(2.0)  # of the widths of the map
CONSTANTS: dict[str, dict[str, Any]] = {
    "atb1000": {"damping": 5.0 + 0.3 * 9.0, "kappa": 0.7, "low": 1.99, "high": 1.99, "gamma": 2.0},
    "backlash_map": {
        "damping": 0.5 * (1.0 - 11.0 * 1.3 * 0.05), "kappa": 1.3 * 0.3 / 0.05,
        "gamma": 0.05 / 1.3, "leak": "constant",
    },
    "backlash_pendulum": {
        "damping": 4.0 + 0.3 * 8.0 - 0.1, "kappa": 0.7, "other_rate": 2.5, "gamma": 2.0,
    },
    "deadzone_arm": {"damping": 5.0, "kappa": 0.6, "gamma": 2.0, "leak": "error"},
    "deadzone_map": {
        "damping": 0.5 * (0.3 - 0.32**2), "kappa": 0.2 / 0.3 * 0.9, "ideal": SIDES, "gamma": 0.3,
        "extra": 0.04 * SIDES**2 / 0.3, "leak": "constant",
    },
    "friction_arm": {"damping": 4.0 + 0.3 * 9.0, "kappa": 0.7, "gamma": 2.0, "other_rate": np.inf},
    "map_chains": {
        "damping": 0.5 * (0.3 - 0.32**2), "kappa": 0.2 / 0.3 * 0.9, "gamma": 0.3,
        "ideal": math.sqrt(2.0 * (0.25 + 0.64)), "leak": "constant",
    },
    "payload_arm": {"kappa": 0.6, "gamma": 3.0, "leak": "constant"},
    "quarter_car": {"damping": 500.0, "leak": "error", "c1": 0.0, "other_rate": np.inf},
    "telerobot": {"kappa": 0.6, "gamma": 3.0, "leak": "constant", "extra": 0.0},
}  # fmt: skip


@pytest.mark.parametrize("plant", CONSTANTS)
def test_constants_are_those_of_the_settings(plant: str) -> None:
    found = account(plant, 2).proof.constants
    for name, value in CONSTANTS[plant].items():
        assert getattr(found, name) == (value if value == "constant" else pytest.approx(value)), (
            name
        )


SPIKE = np.where(np.arange(N) == 150, 1e9, 0.0)
BELOW = "|r| <= |tt + c_r r|/(1 - |Kv + c_r|) in the second half"
CHANGES: list[tuple[str, str, dict[str, Any]]] = [
    ("atb1000", "leak kappa above 0", {".kappa": 0.0}),
    ("atb1000", "the network is on in the end", {".network_on": np.arange(N) < N - 1.0}),
    ("atb1000", "the gap is never open", {".penetration_rad": 0.0}),
    ("atb1000", "tau is not limited", {".tau_Nm": -SPIKE}),
    ("atb1000", "tuning rests in no cycle", {".e_rad": -1.0}),
    ("backlash_map", "forgetting Gam above 0", {".gamma": 0.0}),
    ("backlash_map", "the network is on", {".network_on": 0.0}),
    ("backlash_map", "11 m alpha < 1, |Kv + c_r| < 1", {".kv": 1.3}),
    ("backlash_map", "11 m alpha < 1, |Kv + c_r| < 1", {".kv": -0.9}),
    ("backlash_map", "11 m alpha < 1, |Kv + c_r| < 1", {".slope": 2.0}),
    ("backlash_map", "the model is exact", {".model_c": 0.91}),
    ("backlash_map", "the gap is never open", {"map.tau": np.arange(N) // 2.0}),
    ("backlash_map", "u is not limited", {".u_max": 1.0}),
    ("backlash_map", BELOW, {"map.x2": SPIKE}),
    ("backlash_map", BELOW, {"map.x2": -SPIKE}),
    ("backlash_pendulum", "leak kappa above 0", {".kappa": 0.0}),
    ("backlash_pendulum", "the network is on", {".network_on": 0.0}),
    ("backlash_pendulum", "the model of the pendulum is exact", {".model_gravity_Nm": 2.9}),
    ("backlash_pendulum", "the model of the pendulum is exact", {".model_gravity_Nm": 3.1}),
    ("backlash_pendulum", "the model of the pendulum is exact", {".model_time_constant_s": 1.4}),
    ("backlash_pendulum", "the model of the pendulum is exact", {".model_time_constant_s": 1.6}),
    ("backlash_pendulum", "the gap is never open", {".torque_Nm": np.arange(N) // 2.0}),
    ("backlash_pendulum", "what acts is u", {".command_Nm": -9.0}),
    ("backlash_pendulum", "what acts is u", {".command_Nm": 9.0}),
    ("deadzone_arm", "leak k1 above 0", {".k1": 0.0}),
    ("deadzone_arm", "W, Wi, y, u are in use", {".network_on": 0.0}),
    ("deadzone_arm", "u is not limited", {".u_max_Nm": 1.0}),
    ("deadzone_arm", "u is not limited", {".tau_d_2_Nm": -2e4}),
    *(
        ("deadzone_arm", "what acts is what the law computes", {name: 1.01})
        for name in (".d_plus_Nm", ".d_minus_Nm", ".m_plus", ".m_minus")
    ),
    ("deadzone_map", "forgetting Gam above 0", {".gam": 0.0}),
    ("deadzone_map", "Kv^2 < 1 - alpha, about", {".kv": 0.7}),
    ("deadzone_map", "the model is exact", {".model_c": 0.9}),
    ("deadzone_map", "the command leaves the deadzone", {".command": -0.6}),
    ("friction_arm", "leak kappa above 0", {".kappa": 0.0}),
    ("friction_arm", "Z_B is above |Z*|", {".z_bound": 1e9}),
    ("friction_arm", "friction is a function of x", {".friction_model": 2.0}),
    ("friction_arm", "friction is a function of x", {".rate_2_rad_s": 0.0}),
    ("map_chains", "the model is exact", {".model_c": 0.9, ".model_coupling": 0.4}),
    ("map_chains", "the commands leave the deadzones", {".b_command": -0.7}),
    ("payload_arm", "leak kap2 above 0", {".kap2": 0.0}),
    ("payload_arm", "both networks are on", {".action_on": 0.0}),
    ("payload_arm", "both networks are on", {".critic_on": 0.0}),
    ("payload_arm", "beta^2 < 4 Kv |s1|^2 (1 - 1/(4 kap1)), alpha = kap1", {".alpha": 2.0}),
    ("payload_arm", "beta^2 < 4 Kv |s1|^2 (1 - 1/(4 kap1)), alpha = kap1", {".beta": 90.0}),
    ("payload_arm", "kz is above |w|", {".kz": 1e-3}),
    ("payload_arm", "kz is above |w|", {".learned_1_rad_s2": SPIKE}),
    ("payload_arm", "Mhat is M", {".outer_mass_kg": 0.8}),
    ("payload_arm", "what acts is what the law computes", {".torque_2_Nm": 0.0}),
    ("quarter_car", "leak kap above 0", {".kap_per_m": 0.0}),
    ("quarter_car", "the rules are on", {".fl_on": 0.0}),
    ("quarter_car", "the rules are on", {".exact_drift": 1.0}),
    ("quarter_car", "the spool's travel is enough", {".wanted_spool_m": -SPIKE}),
    ("telerobot", "leak kap above 0", {".kap": 0.0}),
    ("telerobot", "the network is on", {".local_law": 3.0}),
    ("telerobot", "Mhat is M", {".mass_kg": 0.8}),
    ("telerobot", "every u is there in time", {".held_u": 1.0}),
]


@pytest.mark.parametrize(("plant", "what", "changed"), CHANGES)
def test_what_a_theorem_asks_for_is_told_from_what_it_is_not(
    plant: str, what: str, changed: dict[str, Any]
) -> None:
    """In one of the runs at least."""

    def flips(seed: int) -> bool:
        first, second = account(plant, seed).proof.asked, proof_of(plant, seed, changed).asked
        assert [one.what for one in first] == [one.what for one in second]
        return any(a.holds != b.holds for a, b in zip(first, second, strict=True) if a.what == what)

    assert any(flips(seed) for seed in SEEDS)
