"""The barrel plant: energy, linear modes, signs, start, timing of the command, portable bits."""

import time
from typing import Any

import numpy as np
import pytest
import yaml
from barrel_plant import AT, LOSSLESS, NOMINAL, PARAMETERS_FILE, Plant, Vector

from pcpc.plants.atb1000.beam import GRAVITY_M_S2
from pcpc.plants.atb1000.model import BLOCK, half_sine, prepare
from pcpc.plants.atb1000.ports import External, Motion

MECHANICAL = 10  # leading states: barrel, then rotor


def _relative_energy_drift(integrator_hz: float, for_s: float = 10.0) -> tuple[float, float]:
    plant = Plant(integrator_hz=integrator_hz, **LOSSLESS)
    motion = plant.states.motion
    motion.values()[:] = 0.0
    motion.theta_rate_rad_s = 0.5
    motion.q[:] = 3e-3, 3e-4, 5e-5
    plant.states.held_Nm = 0.0
    start = plant.step()[AT["energy_J"]]
    for _ in range(round(for_s / plant.dt)):
        end = plant.step()[AT["energy_J"]]
    return start, (end - start) / start


def test_undamped_barrel_keeps_its_energy_to_fifth_order() -> None:
    start, coarse = _relative_energy_drift(8000.0)
    _, fine = _relative_energy_drift(16000.0)
    _, finest = _relative_energy_drift(32000.0)
    assert start == pytest.approx(0.324346, abs=0.51e-6)
    assert fine == pytest.approx(-2.53e-6, abs=0.02e-6), f"drift {fine:.3e} in 10 s"
    assert 30.0 < coarse / fine < 34.0, f"{coarse:.2e} / {fine:.2e} per halving"
    assert 30.0 < fine / finest < 34.0, f"{fine:.2e} / {finest:.2e} per halving"


@pytest.mark.parametrize("model", [1.0, 2.0])
def test_friction_and_damping_only_take_energy(model: float) -> None:
    plant = Plant(friction_model=model)
    motion = plant.states.motion
    motion.theta_rate_rad_s, motion.q[0] = 0.3, 4e-3
    motion.motor_torque_Nm = plant.states.held_Nm = 0.0
    sig0 = NOMINAL["sig0_Nm_rad"]

    def stored() -> float:
        return float(plant.step()[AT["energy_J"]] + 0.5 * sig0 * motion.bristle_rad**2)

    energy = np.array([stored() for _ in range(1000)])
    rise = np.max(np.diff(energy))
    assert rise < 1e-6 * energy[0], f"energy rose by {rise:.1e} J in a period"
    assert energy[-1] < 0.5 * energy[0], f"{energy[0]:.4f} -> {energy[-1]:.4f} J"


def nothing(kind: Any) -> Any:
    """Return a declaration's view of zeros."""
    return kind(np.zeros(kind.size))


def barrel_rates(d: Motion) -> Vector:
    """Return theta'' and q'' of a derivative."""
    return np.array([d.theta_rate_rad_s, *d.q_rate])


def _frequencies_hz(plant: Plant, penetration_rad: float) -> Vector:
    """Return |lambda|/2 pi of the vibrating modes, linearised without gravity at this gear load."""
    w, s = nothing(External), nothing(Motion)
    w.heave_acc_m_s2 = -GRAVITY_M_S2
    if penetration_rad > 0.0:
        flank = 0.5 * plant.parameters.gap_rad
        s.motor_angle_rad = plant.parameters.gear_ratio * (flank + penetration_rad)
    jacobian = np.empty((MECHANICAL, MECHANICAL))
    for i in range(MECHANICAL):
        step = np.zeros(16)
        step[i] = 1e-7
        ends = [plant.slopes(Motion(s.values() + sign * step), w).values() for sign in (1, -1)]
        jacobian[:, i] = (ends[0] - ends[1])[:MECHANICAL] / 2e-7
    hz = np.abs(np.linalg.eigvals(jacobian)) / (2.0 * np.pi)
    vibrating: Vector = np.sort(hz[hz > 1.0])[::2]
    return vibrating


UNDAMPED = {**LOSSLESS, "gap_rad": 1e-3}
VISCOUS_ONLY = {
    "friction_model": 1.0, "coulomb_Nm": 1e-9, "breakaway_Nm": 1e-9,
    "motor_coulomb_Nm": 0.0, "mesh_loss": 0.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("settings", "penetration_rad", "expected_hz"),
    [
        ({**UNDAMPED, "hub_inertia_kg_m2": 1e9}, 0.0, [10.240, 66.757, 191.445]),
        (UNDAMPED, 0.0, [13.527, 67.381, 191.664]),
        ({**UNDAMPED, "ks_Nm_rad": 1e9}, 1e-5, [11.866, 67.039, 191.544]),
        (UNDAMPED, 1e-3, [11.751, 48.111, 67.735, 191.672]),
        (VISCOUS_ONLY, 1e-3, [11.752, 48.145, 67.687, 191.672]),
    ],
    ids=["clamped", "hub free", "rotor rigidly geared", "complete undamped", "complete"],
)
def test_linear_modes_are_the_tabulated_ones(
    settings: dict[str, float], penetration_rad: float, expected_hz: list[float]
) -> None:
    found = _frequencies_hz(Plant(**settings), penetration_rad)[: len(expected_hz)]
    assert found == pytest.approx(expected_hz, abs=0.51e-3), f"found {found} Hz"


def _mass_matrix(plant: Plant, q: Vector) -> tuple[Vector, Vector]:
    upper = plant.parameters.centrifugal
    c = np.zeros((3, 3))
    c[np.triu_indices(3)] = upper
    c = c + c.T - np.diag(np.diag(c))
    m = np.eye(4)
    m[0, 0] = plant.parameters.rigid_inertia_kg_m2 + q @ c @ q
    m[0, 1:] = m[1:, 0] = plant.parameters.coupling
    return m, c


def test_velocity_forces_do_no_work_beyond_the_change_of_inertia() -> None:
    plant = Plant(**{**LOSSLESS, "gap_rad": 1.0})
    moving, still = nothing(Motion), nothing(Motion)
    q, rates = np.array([0.02, -0.01, 0.005]), np.array([0.7, 0.4, -0.3, 0.9])
    moving.q[:] = still.q[:] = q
    moving.theta_rate_rad_s, moving.q_rate[:] = rates[0], rates[1:]
    m, c = _mass_matrix(plant, q)
    v = m @ (barrel_rates(plant.slopes(still)) - barrel_rates(plant.slopes(moving)))
    change_of_inertia = 2.0 * q @ c @ rates[1:]
    power = rates[0] ** 2 * change_of_inertia - 2.0 * rates @ v  # x'(Mdot - 2V)x
    assert abs(power) < 1e-12 and abs(rates @ v) > 1e-3, f"{power:.1e} of {rates @ v:.1e} W"
    assert v[0] == pytest.approx(2.0 * rates[0] * q @ c @ rates[1:], rel=1e-9)
    assert v[1:] == pytest.approx(-(rates[0] ** 2) * c @ q, rel=1e-9)


@pytest.mark.parametrize("unbalance_Nm", [2.5, -2.5])
@pytest.mark.parametrize("theta0_rad", [0.0, 0.6])
def test_resting_plant_stays_put_under_the_held_command(
    unbalance_Nm: float, theta0_rad: float
) -> None:
    plant = Plant(unbalance_Nm=unbalance_Nm, theta0_rad=theta0_rad)
    held, before = plant.states.held_Nm, plant.x[:16].copy()
    for _ in range(200):
        y = plant.step(held)
    moved = np.max(np.abs(plant.x[:12] - before[:12]))
    assert moved < 1e-12, f"a state moved by {moved:.1e}"
    assert y[AT["muzzle_rad"]] - theta0_rad == pytest.approx(y[AT["droop_rad"]], abs=1e-12)
    assert y[AT["gear_torque_Nm"]] * unbalance_Nm > 0.0


def test_gear_torque_raises_the_hub_and_slows_the_rotor() -> None:
    plant = Plant(**{**UNDAMPED, "unbalance_Nm": 0.0})
    n, jm = NOMINAL["gear_ratio"], NOMINAL["motor_inertia_kg_m2"]
    s = nothing(Motion)
    free = plant.slopes(s).values()
    s.motor_angle_rad = n * (0.5e-3 + 1e-4)
    torque = NOMINAL["ks_Nm_rad"] * 1e-4
    change = Motion(plant.slopes(s).values() - free)
    m, _ = _mass_matrix(plant, np.zeros(3))
    hub = np.linalg.solve(m, [torque, 0.0, 0.0, 0.0])
    assert barrel_rates(change) == pytest.approx(hub, rel=1e-9) and hub[0] > 0.0
    assert change.motor_speed_rad_s == pytest.approx(-torque / n / jm, rel=1e-9)


def test_hull_acceleration_leaves_the_rotor_behind_and_heave_weighs_on_the_hub() -> None:
    plant = Plant(**UNDAMPED)
    w, s = nothing(External), nothing(Motion)
    still = plant.slopes(s, w)
    w.pitch_acc_rad_s2 = 1.7
    assert plant.slopes(s, w).motor_speed_rad_s - still.motor_speed_rad_s == -1.7
    w.pitch_acc_rad_s2, w.heave_acc_m_s2 = 0.0, 1.0
    m, _ = _mass_matrix(plant, np.zeros(3))
    weight = np.array([2.5 / GRAVITY_M_S2, *plant.parameters.gravity])
    change = barrel_rates(plant.slopes(s, w)) - barrel_rates(still)
    assert m @ change == pytest.approx(-weight, rel=1e-9)


def test_shot_pushes_hub_and_muzzle_up_by_the_stated_impulse() -> None:
    plant = Plant(**UNDAMPED)
    w, s = nothing(External), nothing(Motion)
    still = plant.slopes(s, w)
    w.hub_moment_Nm, w.muzzle_force_N = 60.0, 20.0
    change = barrel_rates(plant.slopes(s, w)) - barrel_rates(still)
    m, _ = _mass_matrix(plant, np.zeros(3))
    load = np.array([60.0 + NOMINAL["length_m"] * 20.0, *(20.0 * plant.parameters.tip)])
    assert m @ change == pytest.approx(load, rel=1e-9)
    t = np.linspace(0.99, 1.02, 30_001)
    pulse = np.array([half_sine(at_s, 60.0, 1.0, 0.012) for at_s in t])
    assert np.trapezoid(pulse, t) == pytest.approx(2.0 / np.pi * 60.0 * 0.012, rel=1e-6)
    assert np.all(pulse[(t < 1.0) | (t > 1.012)] == 0.0)


def test_shot_on_a_moving_hull_is_integrated_to_fourth_order() -> None:
    def end(integrator_hz: float) -> Vector:
        plant = Plant(
            integrator_hz=integrator_hz,
            hull_motion=1.0,
            fire=1.0,
            fire_hub_start_s=0.004,
            fire_muzzle_start_s=0.007,
            **LOSSLESS,
        )
        for _ in range(31):
            plant.step(plant.states.held_Nm)
        state: Vector = plant.x[:8].copy()
        return state

    exact = end(128000.0)
    coarse, fine = end(16000.0) - exact, end(32000.0) - exact
    ratio = np.linalg.norm(coarse) / np.linalg.norm(fine)
    assert np.linalg.norm(coarse) < 1e-6, f"off by {np.linalg.norm(coarse):.1e}"
    assert 14.0 < ratio < 18.0, f"the error falls by {ratio:.1f} per halving"


def _sines(kind: float) -> tuple[Vector, Vector, Vector]:
    if kind == 1.0:
        hz = np.array([0.5, 1.1, 2.1])
        return np.array([12e-3, 6e-3, 2.5e-3]), 2 * np.pi * hz, np.array([0.3, 1.7, 4.0])
    rng = np.random.default_rng(101)
    hz = 0.2 + 3.8 * np.arange(24) / 23 + rng.uniform(-0.07, 0.07, 24)
    phase = rng.uniform(0.0, 2 * np.pi, 24)
    w, w0 = 2 * np.pi * hz, 2 * np.pi * 0.8
    a = 1.0 / np.hypot(w0**2 - w**2, 2 * 0.35 * w0 * w)
    return a * np.sqrt(2e-4 / np.sum(a**2)), w, phase


@pytest.mark.parametrize(
    ("kind", "rms_mrad", "rms_rate_mrad_s"), [(1.0, 9.7, 46.0), (2.0, 10.0, None)]
)
def test_hull_moves_as_the_formula_says(
    kind: float, rms_mrad: float, rms_rate_mrad_s: float | None
) -> None:
    a, w, phase = _sines(kind)
    plant = Plant(hull_motion=kind)
    error = 0.0
    for k in range(3001):
        plant.step(plant.states.held_Nm)
        angle = w * (k * plant.dt) + phase
        expected = [
            np.sum(a * np.sin(angle)),
            np.sum(a * w * np.cos(angle)),
            -np.sum(a * w * w * np.sin(angle)),
            0.5 * np.sum(a * w * w * np.cos(angle + 1.0)),
        ]
        error = max(error, np.max(np.abs(plant.states.external.values()[:4] - expected)))
    assert error < 1e-13, f"largest error {error:.1e}"
    assert 1e3 * np.sqrt(np.sum(a**2) / 2) == pytest.approx(rms_mrad, abs=0.06)
    if rms_rate_mrad_s is not None:
        assert 1e3 * np.sqrt(np.sum((a * w) ** 2) / 2) == pytest.approx(rms_rate_mrad_s, abs=0.6)


def test_first_call_only_samples() -> None:
    plant = Plant(hull_motion=1.0)
    before = plant.x[: Motion.size + 1].copy()  # and the command in force
    y = plant.step(1.0)
    assert np.array_equal(plant.x[: Motion.size + 1], before)
    assert y[AT["gear_torque_Nm"]] == pytest.approx(2.5, abs=1e-9)
    assert y[AT["hull_rad"]] == pytest.approx(
        np.sum(_sines(1.0)[0] * np.sin(_sines(1.0)[2])), abs=1e-15
    )


def test_command_acts_one_period_after_its_samples() -> None:
    plant = Plant()
    start = plant.step()[AT["motor_torque_Nm"]]
    assert plant.step(1.0)[AT["motor_torque_Nm"]] == pytest.approx(start, abs=1e-15)
    risen = plant.step(1.0)[AT["motor_torque_Nm"]]
    expected = 1.0 + (start - 1.0) * np.exp(-1.0)  # one time constant later
    assert risen == pytest.approx(expected, abs=1e-7), f"{risen:.9f} N m"


def test_saturated_command_settles_at_the_peak_torque() -> None:
    plant = Plant(**{"hub_inertia_kg_m2": 1e6})
    for _ in range(20):
        torque = plant.step(50.0)[AT["motor_torque_Nm"]]
    assert torque == pytest.approx(NOMINAL["motor_peak_Nm"], abs=1e-6), f"{torque} N m"


@pytest.mark.parametrize("rate_hz", [500.0, 2000.0, 4000.0, 16000.0])
def test_motion_under_a_held_command_does_not_depend_on_the_control_rate(rate_hz: float) -> None:
    plant = Plant(rate_hz, hull_motion=1.0)
    for _ in range(round(0.1 * rate_hz) + 1):
        y = plant.step(plant.states.held_Nm)
    reference = Plant(1000.0, hull_motion=1.0)
    for _ in range(101):
        expected = reference.step(reference.states.held_Nm)
    assert y[AT["theta_rad"]] == pytest.approx(expected[AT["theta_rad"]], abs=1e-12)


@pytest.mark.parametrize(
    ("rate_hz", "settings", "complaint"),
    [
        (1200.0, {}, "16000 is not a whole multiple of the rate 1200 Hz"),
        (32000.0, {}, "not a whole multiple"),
        (1000.0, {"inner_m": 0.02}, "inner_m 0.02 is not below outer_m 0.02"),
        (1000.0, {"hull_motion": 1.5}, "hull_motion is 1.5"),
        (1000.0, {"fire": 2.0}, "fire is 2.0"),
    ],
)
def test_impossible_settings_are_refused(
    rate_hz: float, settings: dict[str, float], complaint: str
) -> None:
    with pytest.raises(ValueError, match=complaint):
        prepare({**NOMINAL, **settings}, rate_hz, 1)


def test_every_setting_has_a_value_in_range_with_its_unit_and_a_reason() -> None:
    groups = yaml.safe_load(PARAMETERS_FILE.read_text(encoding="utf-8"))
    entries = {name: entry for group in groups.values() for name, entry in group.items()}
    assert set(entries) == {port.name for port in BLOCK.settings}
    for port in BLOCK.settings:
        entry = entries[port.name]
        assert set(entry) == {"value", "unit", "reason"}, port.name
        assert isinstance(entry["value"], float), f"{port.name}: {entry['value']!r}"
        assert port.low <= entry["value"] <= port.high, port.name
        assert entry["unit"] == port.unit, port.name


def test_names_are_unique_and_prepare_fills_every_parameter() -> None:
    groups = (BLOCK.inputs, BLOCK.outputs, BLOCK.parameters, BLOCK.states)
    names = [name for ports in groups for port in ports for name in port.names()]
    assert len(names) == len(set(names))
    prepared = prepare(NOMINAL, 1000.0, 1)
    assert set(prepared.parameters) == {port.name for port in BLOCK.parameters}
    assert set(prepared.states) <= {port.name for port in BLOCK.states}


def test_a_step_costs_a_small_part_of_its_period() -> None:
    plant = Plant(hull_motion=1.0)
    plant.step()
    cost_s = np.inf
    for _ in range(20):
        start = time.thread_time()
        for _ in range(50):
            plant.step(plant.states.held_Nm)
        cost_s = min(cost_s, (time.thread_time() - start) / 50)
    print(f"one step of 1 ms costs {cost_s * 1e6:.1f} us")
    assert cost_s < 0.2 * plant.dt, f"{cost_s * 1e6:.1f} us of 1000 us"
