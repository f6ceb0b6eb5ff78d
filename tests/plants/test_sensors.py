"""Sensors of the barrel plant: what they show, their lags, and their noise."""

import numpy as np
import pytest
from barrel_plant import AT, NAMES, NOMINAL, Plant, Vector
from places import ROOT

from pcpc.drivers.compiled.jit import compiled
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.sensors import lag_rate

PLANTS = ROOT / "plants"

NOISES = [
    "hub_gyro_noise_rad_s", "muzzle_gyro_noise_rad_s", "hull_pitch_noise_rad",
    "hull_rate_noise_rad_s", "strain_noise_ue", "torque_noise_Nm",
]  # fmt: skip
CHANNELS = [
    AT["hub_rate_rad_s"],
    AT["muzzle_rate_rad_s"],
    AT["hull_pitch_rad"],
    AT["hull_rate_rad_s"],
    AT["strain_ue"],
    AT["shaft_torque_Nm"],
]
QUIET = dict.fromkeys(NOISES, 0.0)


def _run(plant: Plant, steps: int) -> Vector:
    return np.array([plant.step(plant.states.held_Nm) for _ in range(steps)])


def test_noise_of_every_channel_has_its_stated_deviation_and_mean_zero() -> None:
    samples = _run(Plant(), 4000) - _run(Plant(**QUIET), 4000)
    for name, channel in zip(NOISES, CHANNELS, strict=True):
        noise = samples[:, channel] / NOMINAL[name]
        assert 0.955 < np.std(noise) < 1.045, f"{name}: {np.std(noise):.3f} of the stated"
        assert abs(np.mean(noise)) < 4.0 / np.sqrt(4000), f"{name}: mean {np.mean(noise):.3f}"
        assert noise[0] != 0.0, f"{name}: no noise at t = 0"
    correlation = np.corrcoef(samples[:, CHANNELS].T) - np.eye(6)
    assert np.max(np.abs(correlation)) < 4.5 / np.sqrt(4000), f"{np.max(np.abs(correlation)):.3f}"


def test_seed_changes_the_noise_and_nothing_else() -> None:
    first, again, other = (_run(Plant(seed=seed), 50) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    quiet = [c for c in range(first.shape[1]) if c not in CHANNELS]
    assert np.array_equal(first[:, quiet], other[:, quiet])
    for channel in CHANNELS:
        assert np.all(first[:, channel] != other[:, channel]), NAMES[channel]


def test_encoder_and_hull_pitch_add_up_to_the_inertial_angle() -> None:
    y = _run(Plant(hull_motion=1.0, **QUIET), 500)
    inertial = y[:, AT["encoder_rad"]] + y[:, AT["hull_pitch_rad"]]
    error = np.max(np.abs(inertial - y[:, AT["theta_rad"]]))
    assert error < 1e-16, f"off by {error:.1e} rad"
    assert np.array_equal(y[:, AT["hull_pitch_rad"]], y[:, AT["hull_rad"]])
    slope = np.gradient(y[:, AT["hull_rad"]], 1e-3)[1:-1]
    error = np.max(np.abs(slope - y[1:-1, AT["hull_rate_rad_s"]]))
    assert error < 1e-5, f"hull rate is off by {error:.1e} rad/s"


def test_gyros_follow_hub_and_muzzle_within_their_lag() -> None:
    plant = Plant(**QUIET)
    plant.step()
    y = np.array([plant.step(0.3 * np.sin(0.02 * k)) for k in range(2000)])
    lag_s = 1.0 / (2.0 * np.pi * NOMINAL["gyro_bandwidth_hz"])
    for sensor, angle in (
        (AT["hub_rate_rad_s"], AT["theta_rad"]),
        (AT["muzzle_rate_rad_s"], AT["muzzle_rad"]),
    ):
        true_rate = np.gradient(y[:, angle], 1e-3)
        late = true_rate - lag_s * np.gradient(true_rate, 1e-3)
        size, error = np.std(true_rate), np.std((y[:, sensor] - late)[2:-2])
        assert error < 0.03 * size, f"{error:.1e} of {size:.1e} rad/s"


def test_resting_sensors_show_weight_and_unbalance() -> None:
    y = _run(Plant(**QUIET), 3)[-1]
    beam_root = np.array([3.235057, -21.433401, 61.931083])
    q = y[[AT["q1"], AT["q2"], AT["q3"]]]
    assert y[AT["strain_ue"]] == pytest.approx(0.5e6 * NOMINAL["outer_m"] * beam_root @ q, rel=1e-6)
    assert y[AT["strain_ue"]] < 0.0, "a barrel that hangs has its upper side stretched, q < 0"
    assert y[AT["shaft_torque_Nm"]] == pytest.approx(NOMINAL["unbalance_Nm"], rel=1e-9)
    assert y[AT["motor_torque_Nm"]] == pytest.approx(2.5 / 60.0, rel=1e-9)


def test_samples_are_not_rounded_here() -> None:
    y = _run(Plant(hull_motion=1.0), 100)
    quanta = {
        AT["encoder_rad"]: 2 * np.pi / 2**18,
        AT["hull_pitch_rad"]: 1e-5,
        AT["strain_ue"]: 0.25,
    }
    for channel, quantum in quanta.items():
        parts = y[:, channel] / quantum
        off_grid = np.mean(np.abs(parts - np.round(parts)) > 1e-6)
        assert off_grid > 0.9, f"{NAMES[channel]}: {off_grid:.2f} off the grid"


@compiled()
def _gain(bandwidth_hz: float, signal_hz: float) -> float:
    h, lagged, peak = 1e-6, 0.0, 0.0
    for i in range(200_000):
        signal = np.sin(2.0 * np.pi * signal_hz * i * h)
        lagged += h * lag_rate(lagged, signal, bandwidth_hz)
        if i > 100_000:
            peak = max(peak, lagged)
    return peak


def test_lag_takes_3_db_at_its_bandwidth() -> None:
    gain = _gain(200.0, 200.0)
    assert gain == pytest.approx(np.sqrt(0.5), rel=2e-3), f"gain {gain:.4f}"


def test_a_plant_that_tells_a_truth_and_its_sample_names_them_alike() -> None:
    found = 0
    for rig in sorted(PLANTS.glob("*/rig.yaml")):
        scenario = next(iter(sorted(rig.parent.glob("rigs/*.yaml"))), rig)
        for spec in load_rig(scenario).nodes()["plant"].blocks:
            names = {port.name for port in spec.block.outputs}
            samples = {name for name in names if "sample" in name}
            wrong = {s for s in samples if s.removeprefix("sample_") not in names - samples}
            assert not wrong, f"{rig.parent.name}: samples without their truth: {wrong}"
            assert not {name for name in names if "true" in name}, f"{rig.parent.name}: {names}"
            found += len(samples)
    assert found > 20, f"only {found} samples looked at"
