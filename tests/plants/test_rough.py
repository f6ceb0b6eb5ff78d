"""The rougher world of the barrel: conservation, closed forms, and nothing of it when it is off."""

from collections.abc import Iterator

import numpy as np
import pytest
from barrel_plant import AT, LOSSLESS, NOMINAL, Plant, Vector

from pcpc.plants.atb1000.model import prepare
from pcpc.plants.atb1000.rough_ports import SWITCHES, Rough

QUIET = {name: 0.0 for name in NOMINAL if "_noise_" in name}
FREE_HULL = {"rough_hull": 1.0, "hull_damper_Nms_rad": 0.0}
STEP_S = 1.0 / 16000.0
TURN = 2.0 * np.pi * np.arange(180) / 180


def simpson(values: Vector) -> float:
    """Return the integral over an odd number of values, a step of the integrator apart."""
    middle = 4.0 * values[1:-1:2].sum() + 2.0 * values[2:-2:2].sum()
    return float(values[0] + middle + values[-1]) * STEP_S / 3.0


def swinging(**settings: float) -> Plant:
    """Return a plant at rest but for its barrel, which turns and swings; the drive is off."""
    plant = Plant(**settings)
    motion = plant.states.motion
    motion.values()[:] = 0.0
    motion.theta_rate_rad_s, motion.q[:] = 0.5, (3e-3, 3e-4, 5e-5)
    plant.states.held_Nm = plant.states.world.hull_yield_rad = 0.0
    plant.states.sent_Nm[:] = 0.0
    return plant


def relative_energy_drift(**settings: float) -> float:
    plant = swinging(**{**LOSSLESS, **settings})
    energy = [plant.step()[AT["energy_J"]] for _ in range(1001)]
    return float((energy[-1] - energy[0]) / energy[0])


def test_hull_rotor_and_barrel_change_momentum_by_gravity_alone() -> None:
    plant = Plant(16000.0, rough_motor=1.0, hull_spring_Nm_rad=0.0, **FREE_HULL)
    p, s, world = plant.parameters, plant.states.motion, plant.states.world
    s.theta_rate_rad_s, s.q[0] = 0.3, s.q[0] + 2e-3
    c = np.zeros((3, 3))
    c[np.triu_indices(3)] = p.centrifugal
    c = c + c.T - np.diag(np.diag(c))
    momentum, weight = [], []
    for k in range(1601):
        y = plant.step(1.5 * np.sin(0.01 * k))
        q, hull = np.array(s.q), world.hull_yield_rate_rad_s
        barrel = (p.rigid_inertia_kg_m2 + q @ c @ q) * s.theta_rate_rad_s
        barrel += np.array(p.coupling) @ np.array(s.q_rate)
        rotor = p.motor_inertia_kg_m2 * (s.motor_speed_rad_s + hull)
        momentum.append(p.hull_inertia_kg_m2 * hull + rotor + barrel)
        lever = 9.81 * np.sin(s.theta_rad) * (np.array(p.gravity) @ q)
        weight.append(lever - p.unbalance_Nm * np.cos(s.theta_rad))
    change, impulse = momentum[-1] - momentum[0], simpson(np.array(weight))
    assert abs(p.hull_inertia_kg_m2 * hull) > 0.1 and y[AT["friction_torque_Nm"]] != 0.0
    assert change == pytest.approx(impulse, abs=1e-12), f"{change - impulse:.1e} N m s"


def test_a_hull_on_a_spring_keeps_the_energy_to_fifth_order() -> None:
    drift = [relative_energy_drift(integrator_hz=hz, **FREE_HULL) for hz in (8e3, 16e3)]
    assert abs(drift[1]) < 1e-6, f"relative drift {drift[1]:.1e} in 1 s"
    assert 30.0 < drift[0] / drift[1] < 34.0, f"{drift[0]:.2e} / {drift[1]:.2e} per halving"


def test_the_hulls_damper_only_takes_energy() -> None:
    plant = swinging(**LOSSLESS, rough_hull=1.0)
    energy = np.array([plant.step()[AT["energy_J"]] for _ in range(1001)])
    assert np.diff(energy).max() < 1e-7 * energy[0], f"rose by {np.diff(energy).max():.1e} J"
    assert energy[-1] < 0.99 * energy[0], f"{energy[0]:.4f} -> {energy[-1]:.4f} J"


@pytest.mark.parametrize("theta0_rad", [0.0, 0.6])
def test_a_resting_barrel_stays_put_on_a_hull_that_has_yielded_to_it(theta0_rad: float) -> None:
    plant = Plant(rough_hull=1.0, theta0_rad=theta0_rad)
    before = plant.x[:12].copy()
    for _ in range(200):
        y = plant.step(plant.states.held_Nm)
    moved = np.abs(plant.x[:12] - before).max()
    assert moved < 1e-11, f"a state moved by {moved:.1e}"
    yielded = -y[AT["gear_torque_Nm"]] / NOMINAL["hull_spring_Nm_rad"]
    assert y[AT["hull_yield_rad"]] == pytest.approx(yielded, rel=1e-9)
    assert y[AT["hull_rad"]] == y[AT["hull_yield_rad"]]


def test_what_friction_takes_warms_the_bearing_or_leaves_it() -> None:
    lossless = {name: value for name, value in LOSSLESS.items() if name != "friction_model"}
    plant = Plant(16000.0, rough_bearing=1.0, **lossless)
    p, states = plant.parameters, plant.states
    states.motion.theta_rate_rad_s = 0.3
    states.motion.motor_torque_Nm = states.held_Nm = 0.0
    states.sent_Nm[:] = 0.0
    energy, warmth = [], []
    for _ in range(4801):
        y = plant.step()
        bristle = 0.5 * p.sig0_Nm_rad * states.motion.bristle_rad**2
        energy.append(y[AT["energy_J"]] + bristle)
        warmth.append(y[AT["bearing_K"]])
    lost, stored = energy[0] - energy[-1], p.bearing_J_K * (warmth[-1] - warmth[0])
    carried_off = p.bearing_W_K * simpson(np.array(warmth) - p.ambient_K)
    assert lost > 0.05 and carried_off > 0.01 * lost, f"{lost} J, {carried_off} J"
    left = lost - stored - carried_off
    assert abs(left) < 1e-6 * lost, f"{left:.1e} of {lost:.3f} J are nowhere"


@pytest.mark.parametrize("model", [1.0, 2.0])
def test_a_cold_bearing_rubs_as_much_more_as_the_exponential_says(model: float) -> None:
    """Of LuGre's the viscous part here, without bristles; the heat's balance has the rest."""
    for warmth, settings in ((-20.0, {}), (15.0, {"ambient_K": 15.0})):
        drags = []
        for on in (0.0, 1.0):
            plant = Plant(rough_bearing=on, friction_model=model, **settings)
            plant.states.motion.theta_rate_rad_s = 0.5
            drags.append(plant.step()[AT["friction_torque_Nm"]])
        assert drags[1] / drags[0] == pytest.approx(np.exp(-0.02 * warmth), rel=1e-12)


def cogging_at(angle_rad: float, torque_Nm: float, **settings: float) -> tuple[float, float]:
    """Return torque (N m) and energy (J) at a motor angle and torque."""
    plant = Plant(**{**LOSSLESS, "gap_rad": 1.0, "rough_motor": 1.0, **settings})
    motion = plant.states.motion
    motion.motor_angle_rad, motion.motor_torque_Nm = angle_rad, torque_Nm
    y = plant.step()
    return float(y[AT["cogging_torque_Nm"]]), float(y[AT["energy_J"]])


def test_cogging_is_the_slope_of_its_energy_and_does_no_work_in_a_turn() -> None:
    pairs = np.array([cogging_at(angle, 0.0) for angle in TURN])
    work = pairs[:, 0].mean() * 2.0 * np.pi
    assert abs(work) < 1e-15 and np.ptp(pairs[:, 1]) > 1e-4, f"{work:.1e} J in a turn"
    line = np.abs(np.fft.rfft(pairs[:, 0])) / (0.5 * len(pairs))
    assert line[60] == pytest.approx(NOMINAL["cogging_Nm"], rel=1e-9)
    for angle in (0.3, 1.7):
        ends = [cogging_at(angle + d, 0.0)[1] for d in (1e-5, -1e-5)]
        slope = (ends[0] - ends[1]) / 2e-5
        assert cogging_at(angle, 0.0)[0] == pytest.approx(slope, rel=1e-5, abs=1e-8)


def test_with_cogging_the_energy_stays() -> None:
    drift = relative_energy_drift(rough_motor=1.0, ripple=0.0)
    assert abs(drift) < 2e-6, f"relative drift {drift:.1e} in 1 s"


def test_ripple_grows_with_the_torque_and_has_no_mean_over_a_turn() -> None:
    half, full = (
        np.array([cogging_at(a, torque, cogging_Nm=0.0)[0] for a in TURN]) for torque in (1.0, 2.0)
    )
    assert abs(full.mean()) < 1e-15
    assert full == pytest.approx(2.0 * half, abs=1e-15)
    assert full[0] == pytest.approx(0.02 * 2.0 * np.sin(NOMINAL["ripple_phase_rad"]), rel=1e-12)
    line = np.abs(np.fft.rfft(full)) / (0.5 * len(full))
    assert line[30] == pytest.approx(0.02 * 2.0, rel=1e-9), line[30]
    assert np.delete(line, 30).max() < 1e-12


def test_cogging_brakes_the_rotor() -> None:
    speeds = []
    for on in (0.0, 1.0):
        plant = Plant(rough_motor=on, ripple=0.0, **{**LOSSLESS, "gap_rad": 1.0})
        motion = plant.states.motion
        motion.motor_angle_rad, motion.motor_torque_Nm = np.pi / 120.0, 0.0  # of the largest T_c
        plant.states.held_Nm = 0.0
        plant.step()
        plant.step()
        speeds.append(motion.motor_speed_rad_s)
    fall = NOMINAL["cogging_Nm"] / NOMINAL["motor_inertia_kg_m2"] * 1e-3
    assert speeds[0] - speeds[1] == pytest.approx(fall, rel=2e-2)


def test_an_eccentric_scale_errs_by_two_sines_of_no_mean() -> None:
    errors = []
    for angle in TURN:
        plant = Plant(rough_encoder=1.0)
        plant.states.motion.theta_rad = angle
        y = plant.step()
        errors.append(y[AT["encoder_rad"]] - y[AT["rel_rad"]])
        assert y[AT["encoder_error_rad"]] == pytest.approx(errors[-1], abs=1e-15)
    line = np.fft.rfft(errors) / (0.5 * len(errors))
    assert abs(line[0]) < 1e-15, f"mean {line[0].real:.1e} rad"
    sines = [1j * line[1], 1j * line[2]]
    wanted = [2e-4 * np.exp(0.5j), 1e-4 * np.exp(2.0j)]
    assert sines == pytest.approx(wanted, abs=1e-12), f"{sines}"
    assert np.abs(line[3:]).max() < 1e-12


def test_gyros_begin_with_their_bias_and_walk_as_far_as_the_closed_form() -> None:
    """Variance sigma^2 t over many seeds, each gyro on its own."""
    steps, given = 20, np.array([1e-3, -1e-3, -1e-3])
    ends = []
    for seed in range(300):
        plant = Plant(seed=seed, rough_gyros=1.0, integrator_hz=1000.0)
        first = plant.step()
        assert first[AT["hub_gyro_error_rad_s"]] == 1e-3
        for _ in range(steps - 1):
            plant.step(plant.states.held_Nm)
        ends.append(np.array(plant.states.gyro_bias_rad_s) - given)
    walked = np.array(ends) / (NOMINAL["gyro_walk_rad_s_rts"] * np.sqrt(steps * 1e-3))
    assert walked.std(axis=0) == pytest.approx([1.0] * 3, abs=0.13), walked.std(axis=0)  # 3 sigma
    assert np.abs(walked.mean(axis=0)).max() < 3.0 / np.sqrt(300), walked.mean(axis=0)
    apart = np.corrcoef(walked.T)[np.triu_indices(3, 1)]
    assert np.abs(apart).max() < 3.0 / np.sqrt(300), f"gyros walk together: {apart}"


def test_each_gyro_shows_its_own_bias() -> None:
    settings = {**QUIET, "gyro_walk_rad_s_rts": 0.0, "muzzle_gyro_bias_rad_s": 3e-3}
    true, false = Plant(**settings).step(), Plant(rough_gyros=1.0, **settings).step()
    names = ("hub_rate_rad_s", "muzzle_rate_rad_s", "hull_rate_rad_s")
    assert [false[AT[n]] - true[AT[n]] for n in names] == pytest.approx([1e-3, 3e-3, -1e-3])


@pytest.mark.parametrize("age_s", [0.0, 0.25e-3, 1e-3, 5.4e-3])
def test_a_sample_that_is_late_by_an_age_lags_on_a_ramp_by_rate_times_age(age_s: float) -> None:
    free = {**LOSSLESS, "gap_rad": 1.0, "rough_timing": 1.0, "motor_age_s": age_s}
    plant = Plant(**free)
    motion = plant.states.motion
    motion.motor_angle_rad, motion.motor_speed_rad_s = 0.0, 3.0  # in the middle of the play
    motion.motor_torque_Nm = plant.states.held_Nm = 0.0
    plant.states.sent_Nm[:] = 0.0
    for k in range(20):
        y = plant.step()
        lag = motion.motor_angle_rad - y[AT["motor_angle_rad"]]
        wanted = 3.0 * min(age_s, k * 1e-3)  # before the start nothing moved
        assert lag == pytest.approx(wanted, abs=1e-12), f"cycle {k}: {lag}"


@pytest.mark.parametrize("age_s", [0.0, 0.3e-3, 0.33e-3, 2e-3, 5.4e-3])
def test_the_hull_is_seen_as_it_was_an_age_before(age_s: float) -> None:
    plant = Plant(rough_timing=1.0, hull_motion=1.0, hull_age_s=age_s, **QUIET)
    p = plant.parameters
    for k in range(100):
        y = plant.step(plant.states.held_Nm)
        if k > 6:
            angle = p.hull_omega_rad_s * (k * plant.dt - age_s) + p.hull_phase_rad
            pitch = np.sum(p.hull_amplitude_rad * np.sin(angle))
            rate = np.sum(p.hull_amplitude_rad * p.hull_omega_rad_s * np.cos(angle))
            assert y[AT["hull_pitch_rad"]] == pytest.approx(pitch, abs=1e-9), f"cycle {k}"
            assert y[AT["hull_rate_rad_s"]] == pytest.approx(rate, abs=1e-8), f"cycle {k}"


AGED = {
    "encoder_age_s": {"encoder_rad"}, "gyro_age_s": {"hub_rate_rad_s", "muzzle_rate_rad_s"},
    "hull_age_s": {"hull_pitch_rad", "hull_rate_rad_s"}, "strain_age_s": {"strain_ue"},
    "torque_age_s": {"shaft_torque_Nm"},
    "motor_age_s": {"motor_speed_rad_s", "motor_torque_Nm", "motor_angle_rad"},
}  # fmt: skip


def test_every_age_is_that_of_its_own_samples() -> None:
    def end(**ages: float) -> Vector:
        plant = Plant(rough_timing=1.0, hull_motion=1.0, **{**dict.fromkeys(AGED, 0.0), **ages})
        for _ in range(10):
            y = plant.step(0.5)
        return y

    prompt = end()
    for name, signals in AGED.items():
        changed = np.flatnonzero(end(**{name: 2e-3}) != prompt)
        assert {n for n, i in AT.items() if i in changed} == signals, name


@pytest.mark.parametrize("samples", range(8))
def test_the_command_acts_its_samples_of_delay_later(samples: int) -> None:
    prompt, late = Plant(), Plant(delay_samples=float(samples))
    held = prompt.states.held_Nm
    told = [held, 1.0, 0.3, -0.5, 0.8] + [held] * 9
    torques = [[plant.step(u)[AT["motor_torque_Nm"]] for u in told] for plant in (prompt, late)]
    rest = torques[0][0]
    assert torques[1][: samples + 2] == pytest.approx([rest] * (samples + 2), abs=1e-12)
    rising = slice(2, 5)
    shifted = torques[1][2 + samples : 5 + samples]
    assert shifted == pytest.approx(torques[0][rising], abs=1e-6), f"{torques}"
    assert abs(torques[0][2] - rest) > 0.1


def others(switch: str) -> Iterator[str]:
    yield from (name for name in SWITCHES if name not in ("rough", switch))


def rows(**settings: float) -> bytes:
    plant = Plant(hull_motion=1.0, **settings)
    return b"".join(plant.step(0.04 + 0.5 * (-1.0) ** (k // 4)).tobytes() for k in range(12))


def test_what_is_off_changes_no_bit_and_each_switch_changes_some() -> None:
    numbers = [one.name for one in Rough.ports if one.name not in SWITCHES]
    plain = rows()
    assert rows(**{name: 0.5 * NOMINAL[name] for name in numbers}) == plain
    each = {rows(**{name: 1.0}) for name in SWITCHES}
    assert len(each | {plain}) == 1 + len(SWITCHES)
    together = dict.fromkeys(others(""), 1.0)
    assert rows(**together) == rows(rough=1.0) == rows(rough=1.0, **together)


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"rough": 0.5}, "rough is 0.5; expected 0 .off. or 1 .on."),
        ({"rough_motor": 2.0}, "rough_motor is 2.0"),
        ({"rough_timing": 1.0, "hull_age_s": 9e-3}, "hull_age_s 0.009 s is 18 periods of 2000 Hz"),
    ],
)
def test_what_the_world_cannot_be_is_refused(settings: dict[str, float], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        prepare({**NOMINAL, **settings}, 2000.0, 1)
