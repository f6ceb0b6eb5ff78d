"""The barrel's laws without a network: their identities, closed forms and nominal figures."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ROOT

from pcpc.executive.laws.block import Block
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.actuators import friction
from pcpc.plants.atb1000.beam import Tube, modal_data
from pcpc.plants.atb1000.laws import (
    lqg,
    pd,
    pd_adaptive,
    pd_feedforward,
    pd_observer,
    super_twisting,
)
from pcpc.plants.atb1000.ports import load_parameters

ATB1000 = ROOT / "plants" / "atb1000"
T_S = 1e-3
LAWS = {
    "pd_feedforward": pd_feedforward.BLOCK, "pd_observer": pd_observer.BLOCK,
    "super_twisting": super_twisting.BLOCK, "pd_adaptive": pd_adaptive.BLOCK, "lqg": lqg.BLOCK,
}  # fmt: skip
OFF = {
    "pd_feedforward": dict.fromkeys(
        ("hub_inertia_kg_m2", "rotor_inertia_kg_m2", "unbalance_Nm", "friction_share"), 0.0
    ),
    "pd_observer": dict.fromkeys(
        ("hub_inertia_kg_m2", "rotor_inertia_kg_m2", "observer_per_s"), 0.0
    ),
    "super_twisting": dict.fromkeys(("inertia_kg_m2", "k1_Nm", "k2_Nm_s"), 0.0),
    "pd_adaptive": dict.fromkeys(
        ("inertia_rate", "coulomb_rate", "breakaway_rate", "viscous_rate", "unbalance_rate"), 0.0
    ),
}  # fmt: skip

BY_HAND = {"kv_Nms_rad": 110.0, "lam_per_s": 16.0}  # of pd in the rig


class Law:
    """A law of the rig with some parameters changed, stepped by hand."""

    def __init__(self, name: str, **changed: float) -> None:
        nodes = load_rig(ATB1000 / "rigs" / "hull.yaml", name).nodes()
        values = dict(next(b for b in nodes["executive"].blocks if b.name == "controller").settings)
        assert set(changed) <= set(values), changed
        self.block: Block = LAWS.get(name, pd.BLOCK)
        values |= changed
        made = self.block.prepare(values, 1000.0, 1).parameters if self.block.prepare else values
        self.p = np.concatenate([np.atleast_1d(made[q.name]) for q in self.block.parameters])
        self.x = np.zeros(self.block.size(self.block.states))
        self.u = np.zeros(self.block.size(self.block.inputs))
        self.y = np.zeros(self.block.size(self.block.outputs))

    def step(self, period_s: float = T_S, **given: float) -> "Law":
        """Make a step; inputs that are not given are 0."""
        names = [port.name for port in self.block.inputs]
        assert set(given) <= set(names), given
        self.u[:] = [given.get(name, 0.0) for name in names]
        self.block.step(0.0, period_s, self.p, self.x, self.u, self.y)
        return self

    def __getitem__(self, name: str) -> float:
        """Return an output."""
        return float(self.y[[port.name for port in self.block.outputs].index(name)])

    def state(self, name: str) -> float:
        """Return a state of size 1."""
        place = 0
        for port in self.block.states:
            if port.name == name:
                return float(self.x[place])
            place += port.size
        raise KeyError(name)


def moving(seed: int, count: int) -> list[dict[str, float]]:
    """Return random inputs of PD, without a desired acceleration."""
    rng = np.random.default_rng(seed)
    names = [port.name for port in pd.Inputs.ports]
    return [dict(zip(names, rng.normal(0.0, 0.05, len(names)), strict=True)) for _ in range(count)]


@pytest.mark.parametrize("name", OFF)
def test_without_its_own_part_each_is_pd_bit_for_bit(name: str) -> None:
    law, plain = Law(name, **OFF[name], **BY_HAND), Law("pd")
    for inputs in moving(1, 200):
        told, expected = law.step(**inputs), plain.step(**inputs)
        assert told["motor_torque_Nm"] == expected["motor_torque_Nm"]


@pytest.mark.parametrize("name", LAWS)
def test_none_asks_for_more_than_the_limit_or_for_no_number(name: str) -> None:
    law = Law(name)
    for inputs in moving(2, 500):
        many = {key: 20.0 * value for key, value in inputs.items()}
        law.step(**many)
        assert abs(law["motor_torque_Nm"]) <= 115.0 / 60.0
        assert np.isfinite(law.x).all() and np.isfinite(law.y).all()


# ------------------------------------------------------------------------- nominal figures


def nominal() -> tuple[dict[str, float], Any]:
    s = load_parameters(ATB1000 / "parameters.yaml")
    names = ("length_m", "outer_m", "inner_m", "young_Pa", "density_kg_m3", "tip_mass_kg")
    return s, modal_data(Tube(*(s[name] for name in names)))


def test_the_laws_know_the_nominal_barrel() -> None:
    s, beam = nominal()
    n = s["gear_ratio"]
    hub, rotor = s["hub_inertia_kg_m2"] + beam.inertia_kg_m2, s["motor_inertia_kg_m2"] * n * n
    sag = beam.root / beam.root[0] * beam.static_sag()
    expected = {
        "hub_inertia_kg_m2": hub, "rotor_inertia_kg_m2": rotor, "inertia_kg_m2": hub + rotor,
        "motor_coulomb_Nm": s["motor_coulomb_Nm"] * n,
        "motor_viscous_Nms_rad": s["motor_viscous_Nms_rad"] * n * n,
        "viscous_Nms_rad": s["sig2_Nms_rad"], "coupling": beam.coupling[0],
        "clamped_rad_s": beam.omega_rad_s[0], "clamped_damping": s["zeta1"],
        "deflection_s2_rad": beam.coupling[0] / beam.omega_rad_s[0] ** 2,
        "gravity_mode": -sag.sum(), "strain_ue_per_mode": 0.5e6 * s["outer_m"] * beam.root[0],
        "rate_noise_rad_s": s["hub_gyro_noise_rad_s"], "strain_noise_ue": s["strain_noise_ue"],
    } | {
        name: s[name]
        for name in ("unbalance_Nm", "coulomb_Nm", "breakaway_Nm", "stribeck_rad_s", "mesh_loss",
                     "motor_lag_s")
    }  # fmt: skip
    seen = set()
    for law in LAWS:
        nodes = load_rig(ATB1000 / "rigs" / "hull.yaml", law).nodes()
        known = next(b for b in nodes["executive"].blocks if b.name == "controller").settings
        for name in set(known) & set(expected):
            assert abs(known[name] / expected[name] - 1) < 1e-6, f"{law}.{name}: {expected[name]}"
            seen.add(name)
    assert seen == set(expected), set(expected) - seen


# ------------------------------------------------------------------------------ feedforward


@pytest.mark.parametrize("speed", [-0.3, -0.01, -1e-3, 0.0, 2e-4, 0.004, 0.05, 1.0])
def test_the_friction_fed_forward_is_the_plants_own_on_the_desired_speed(speed: float) -> None:
    s, _ = nominal()
    v0, n = 1e-3, s["gear_ratio"]
    law = Law("pd_feedforward", reverse_rad_s=v0, friction_share=1.0)
    law.step(q_d_rate_rad_s=speed + 0.2, hull_rate_rad_s=0.2, q_d_rad=0.3)
    g = friction.sliding(speed, s["coulomb_Nm"], s["breakaway_Nm"], s["stribeck_rad_s"])
    trunnion = friction.stribeck(speed, g, v0, s["sig2_Nms_rad"])
    hub = trunnion + s["unbalance_Nm"] * math.cos(0.3)
    loss = s["motor_coulomb_Nm"] + s["mesh_loss"] * abs(hub) / n
    motor = n * friction.coulomb_viscous(n * speed, loss, n * v0, s["motor_viscous_Nms_rad"])
    assert abs(law["friction_Nm"] - (trunnion + motor)) < 1e-12, law["friction_Nm"]
    assert abs(law["fed_Nm"] - (hub + motor)) < 1e-12, law["fed_Nm"]


def test_the_hull_s_acceleration_is_known_after_its_lag() -> None:
    law = Law("pd_feedforward", friction_share=0.0, unbalance_Nm=0.0)
    for k in range(200):
        law.step(hull_rate_rad_s=0.3 * k * T_S)
        expected = -1.44 * 0.3 * (1.0 - (1.0 - T_S / 0.01) ** k)
        assert abs(law["fed_Nm"] - expected) < 1e-9, f"{k}: {law['fed_Nm']} N m"


# -------------------------------------------------------------------------------- observer


def test_the_observer_converges_to_a_constant_torque_with_its_time_constant() -> None:
    per_s, d = 25.0, -4.0
    law = Law("pd_observer", observer_per_s=per_s)
    rate, angle, inertia = 0.0, 0.0, law.p[5] + law.p[6]
    sent = [0.0, 0.0]  # computed at k - 1 acts from k + 1: in [k, k + 1] what was sent at k - 1
    for k in range(400):
        law.step(hub_rate_rad_s=rate, encoder_rad=angle, motor_speed_rad_s=60.0 * rate)
        left = (d - law["compensated_Nm"]) / d
        assert abs(left - (1.0 - per_s * T_S) ** k) < 1e-9, f"step {k}: {left} left"
        sent.append(60.0 * law["motor_torque_Nm"])
        rate += T_S / inertia * (sent[-2] - d)
        angle += T_S * rate
    assert left < 1e-4


# -------------------------------------------------------------------------- super-twisting


def reached(law: Law, to: float, seconds: float) -> float:
    """Return the last time at which |s| exceeds `to`, behind a bounded disturbance, in s."""
    rate, angle, late, dt = 0.4, 0.02, 0.0, 1e-5
    for k in range(round(seconds / dt)):
        t = k * dt
        d = 3.0 + 2.0 * math.sin(2.0 * t)  # |d'| <= 4 N m/s
        law.step(dt, hub_rate_rad_s=rate, encoder_rad=angle, motor_speed_rad_s=60.0 * rate)
        if abs(law["r_rad_s"]) > to:
            late = t
        angle += dt * rate
        rate += dt / 3.5804563 * (law["tau_Nm"] - d)
    return late


def test_super_twisting_reaches_the_surface_in_finite_time_and_stays() -> None:
    # K1^2 > 4 J K2 (K2 + D)/(K2 - D) = 307 with D = 4
    law = Law("super_twisting", kv_Nms_rad=0.0, k1_Nm=18.0, k2_Nm_s=12.0, lam_per_s=4.0)
    assert (late := reached(law, 1e-5, 2.5)) < 2.0, f"outside until {late:.2f} s"
    plain = Law("super_twisting", kv_Nms_rad=18.0, k1_Nm=0.0, k2_Nm_s=0.0, lam_per_s=4.0)
    assert reached(plain, 1e-2, 2.5) > 2.4, "a linear law should not reach it"


# ------------------------------------------------------------------------------- adaptation

BOX = {"inertia_kg_m2": (0.0, 7.2), "coulomb_Nm": (0.0, 13.0), "breakaway_Nm": (0.0, 4.0),
       "viscous_Nms_rad": (0.0, 4.6), "unbalance_Nm": (-5.0, 5.0)}  # fmt: skip
RATES = {"inertia_rate": 3.0, "coulomb_rate": 50.0, "breakaway_rate": 70.0, "viscous_rate": 5.0,
         "unbalance_rate": 20.0}  # fmt: skip


def test_the_lyapunov_function_falls_by_kv_r_squared() -> None:
    law = Law("pd_adaptive", **RATES, **BY_HAND)
    true, gain = np.array([3.58, 3.2, 1.0, 1.2, 2.5]), np.array([*RATES.values()])
    place = [port.name for port in law.block.states].index("inertia_kg_m2")
    law.x[place : place + 5] = [2.0, 1.0, 2.0, 3.0, 1.0]
    dt, rng, checked = 1e-7, np.random.default_rng(3), 0
    for _ in range(50):
        e, rate, q_d, acc, v = rng.uniform(-1, 1, 5) * (0.004, 0.02, 0.5, 2.0, 0.05)
        before = law.x[place : place + 5].copy()
        law.step(dt, q_d_rad=q_d, encoder_rad=q_d - e, q_d_rate_rad_s=v, hub_rate_rad_s=v - rate,
                 q_d_acc_rad_s2=acc, motor_speed_rad_s=60.0 * (v - rate))  # fmt: skip
        after, r = law.x[place : place + 5], law["r_rad_s"]
        regressor = law.x[place + 5 : place + 10]
        slope = r * (regressor @ true - law["tau_Nm"])  # d/dt of J r^2/2
        slope += ((before - true) / gain) @ (after - before) / dt
        if abs(r) < 0.3 and abs(e) > 1e-4:
            checked += 1
            expected = -110.0 * r * r
            assert abs(slope - expected) < 1e-6 * (1.0 + abs(slope)), f"{slope}, not {expected}"
    assert checked > 30


@settings(max_examples=50, derandomize=True, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_projection_keeps_the_estimates_in_their_box(seed: int) -> None:
    law = Law("pd_adaptive", **dict.fromkeys(RATES, 1e5))
    for inputs in moving(seed, 30):
        law.step(**inputs)
        for name, (low, high) in BOX.items():
            assert low <= law.state(name) <= high, f"{name}: {law.state(name)}"


# -------------------------------------------------------------------------------- regulator


def lqg_settings() -> dict[str, float]:
    nodes = load_rig(ATB1000 / "rigs" / "hull.yaml", "lqg").nodes()
    return dict(next(b for b in nodes["executive"].blocks if b.name == "controller").settings)


@pytest.mark.parametrize("rate_hz", [500.0, 1000.0, 4000.0])
def test_regulator_and_filter_are_stable_at_every_rate(rate_hz: float) -> None:
    a, b, k, gain = (np.array(m) for m in lqg.lqg_matrices(lqg_settings(), rate_hz))
    ac, bc = np.zeros((6, 6)), np.eye(6)[:, 5:]
    ac[:5, :5], ac[:5, 5:] = a[:5, :5], b[:5]
    assert abs(np.linalg.eigvals(ac - bc @ k)).max() < 1.0 - 1e-4
    measured = np.eye(6)[:3]
    assert abs(np.linalg.eigvals(a - a @ gain @ measured)).max() < 1.0 - 1e-4


def test_the_filter_finds_the_state_and_the_disturbance_of_its_own_model() -> None:
    law, s = Law("lqg"), lqg_settings()
    a, b, _, _ = (np.array(m) for m in lqg.lqg_matrices(s, 1000.0))
    x, v = np.array([0.01, 0.1, 1e-3, 0.0, 0.0, -3.0]), 0.0
    for _ in range(3000):
        strain = (x[2] - s["gravity_mode"]) * s["strain_ue_per_mode"]
        law.step(
            encoder_rad=x[0], hub_rate_rad_s=x[1], motor_speed_rad_s=60.0 * x[1], strain_ue=strain
        )
        x, v = a @ x + b[:, 0] * v, 60.0 * law["motor_torque_Nm"]
    assert abs(x[0]) < 1e-6, f"{x[0]} rad from the target"
    assert abs(law["compensated_Nm"] + 3.0) < 1e-4, law["compensated_Nm"]
