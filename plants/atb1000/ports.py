"""The barrel plant's variables by name and unit, and where each lies in the views of a step.

A setting is what a rig may change; its value for the nominal plant stands in parameters.yaml and
only there. Those that the step uses as they are (`_DIRECT`) are parameters too, by the same name.
"""

from collections.abc import Sequence
from pathlib import Path

import yaml

from pcpc.executive.laws.block import Port
from pcpc.plants.noise import STREAM_SIZE

HULL_COMPONENTS = 24
INTEGRATED = 16  # leading states that Runge-Kutta advances
NOISY_CHANNELS = 6
_TINY = 1e-9  # lower limit of what must be positive
_FAST = 1e6

_DIRECT = (
    Port("length_m", "m", "barrel from trunnion to muzzle", low=0.1, high=20.0),
    Port("unbalance_Nm", "N m", "muzzle-heavy moment of the hub at 0 deg", low=-1e4, high=1e4),
    Port("gear_ratio", "", "motor turns per hub turn, N", low=1.0, high=1e4),
    Port("gap_rad", "rad", "total play at the output", low=0.0, high=0.1),
    Port("ks_Nm_rad", "N m/rad", "drive shaft stiffness at the output", low=0.0, high=1e9),
    Port("cs_Nms_rad", "N m s/rad", "drive shaft damping at the output", low=0.0, high=1e6),
    Port("p0_rad", "rad", "penetration at which damping is full", low=_TINY, high=0.1),
    Port("motor_inertia_kg_m2", "kg m^2", "rotor", low=_TINY, high=1e3),
    Port("motor_lag_s", "s", "torque loop time constant", low=1e-4, high=1.0),
    Port("motor_peak_Nm", "N m", "peak torque", low=0.0, high=1e4),
    Port("motor_stall_Nm", "N m", "torque at standstill on full voltage", low=0.0, high=1e4),
    Port("motor_no_load_rad_s", "rad/s", "speed without load", low=1.0, high=1e5),
    Port("motor_coulomb_Nm", "N m", "Coulomb friction of the motor", low=0.0, high=1e3),
    Port("motor_reverse_rad_s", "rad/s", "speed over which it reverses", low=1e-3, high=1e3),
    Port("motor_viscous_Nms_rad", "N m s/rad", "viscous friction of the motor", low=0.0, high=1e3),
    Port("mesh_loss", "", "friction per gear torque at the motor", low=0.0, high=1.0),
    Port("friction_model", "", "trunnion: 0 none, 1 Stribeck, 2 LuGre", low=0.0, high=2.0),
    Port("coulomb_Nm", "N m", "trunnion Coulomb friction Fc", low=_TINY, high=1e4),
    Port("breakaway_Nm", "N m", "trunnion breakaway friction Fs", low=_TINY, high=1e4),
    Port("stribeck_rad_s", "rad/s", "Stribeck speed vs", low=1e-6, high=1e3),
    Port("sig0_Nm_rad", "N m/rad", "bristle stiffness", low=_TINY, high=1e9),
    Port("sig1_Nms_rad", "N m s/rad", "bristle damping", low=0.0, high=1e6),
    Port("sig2_Nms_rad", "N m s/rad", "viscous friction of the trunnion", low=0.0, high=1e6),
    Port("bristle_fade_rad_s", "rad/s", "speed over which sig1 fades", low=1e-6, high=1e3),
    Port("reverse_rad_s", "rad/s", "speed over which Stribeck reverses", low=1e-6, high=1e3),
    Port("fire", "", "1 fires the shot, 0 does not", low=0.0, high=1.0),
    Port("fire_hub_Nm", "N m", "peak hub moment, half sine, upward", low=-1e6, high=1e6),
    Port("fire_hub_start_s", "s", "start of the hub moment", low=0.0, high=1e6),
    Port("fire_hub_lasts_s", "s", "length of the hub moment", low=1e-6, high=10.0),
    Port("fire_muzzle_N", "N", "peak muzzle force, half sine, upward", low=-1e6, high=1e6),
    Port("fire_muzzle_start_s", "s", "start of the muzzle force", low=0.0, high=1e6),
    Port("fire_muzzle_lasts_s", "s", "length of the muzzle force", low=1e-6, high=10.0),
    Port("gyro_bandwidth_hz", "Hz", "hub and muzzle gyros", low=0.1, high=5e3),
    Port("strain_bandwidth_hz", "Hz", "root strain gauge", low=0.1, high=5e3),
    Port("torque_bandwidth_hz", "Hz", "shaft torque sensor", low=0.1, high=5e3),
    Port("hub_gyro_noise_rad_s", "rad/s", "standard deviation", low=0.0, high=1.0),
    Port("muzzle_gyro_noise_rad_s", "rad/s", "standard deviation", low=0.0, high=1.0),
    Port("hull_pitch_noise_rad", "rad", "standard deviation", low=0.0, high=1.0),
    Port("hull_rate_noise_rad_s", "rad/s", "standard deviation", low=0.0, high=1.0),
    Port("strain_noise_ue", "ue", "standard deviation", low=0.0, high=1e3),
    Port("torque_noise_Nm", "N m", "standard deviation", low=0.0, high=1e3),
)

SETTINGS = (
    Port("integrator_hz", "Hz", "Runge-Kutta steps per second", low=1e3, high=_FAST),
    Port("outer_m", "m", "barrel outer diameter", low=1e-3, high=1.0),
    Port("inner_m", "m", "barrel bore", low=0.0, high=1.0),
    Port("young_Pa", "Pa", "Young's modulus", low=1e6, high=1e12),
    Port("density_kg_m3", "kg/m^3", "density", low=1.0, high=1e5),
    Port("tip_mass_kg", "kg", "point mass at the muzzle", low=0.0, high=1e3),
    Port("zeta1", "", "damping ratio of clamped mode 1", low=0.0, high=1.0),
    Port("zeta2", "", "damping ratio of clamped mode 2", low=0.0, high=1.0),
    Port("zeta3", "", "damping ratio of clamped mode 3", low=0.0, high=1.0),
    Port("hub_inertia_kg_m2", "kg m^2", "hub without barrel and rotor", low=1e-3, high=1e6),
    Port("theta0_rad", "rad", "inertial elevation at the start", low=-1.6, high=1.6),
    Port("hull_motion", "", "0 none, 1 three sines, 2 random sea of sines", low=0.0, high=2.0),
    Port("hull_lever_m", "m", "trunnion ahead of the hull's centre", low=-10.0, high=10.0),
    Port("heave_phase_rad", "rad", "heave ahead of pitch acceleration", low=-7.0, high=7.0),
    *(
        Port(f"hull{i}_{name}", unit, f"sine {i}: {name.split('_')[0]}", low=0.0, high=high)
        for i in (1, 2, 3)
        for name, unit, high in (
            ("amplitude_rad", "rad", 1.0), ("frequency_hz", "Hz", 50.0), ("phase_rad", "rad", 7.0),
        )
    ),
    Port("hullrand_seed", "", "whole number, draws frequencies and phases", low=0.0, high=1e9),
    Port("hullrand_rms_rad", "rad", "rms pitch", low=0.0, high=1.0),
    Port("hullrand_first_hz", "Hz", "lowest of the sines before the shift", low=0.01, high=50.0),
    Port("hullrand_last_hz", "Hz", "highest of the sines before the shift", low=0.01, high=50.0),
    Port("hullrand_shift_hz", "Hz", "largest shift of a sine", low=0.0, high=10.0),
    Port("hullrand_peak_hz", "Hz", "natural frequency of the shaping filter", low=0.01, high=50.0),
    Port("hullrand_zeta", "", "damping ratio of the shaping filter", low=0.01, high=10.0),
    *_DIRECT,
)  # fmt: skip

PARAMETERS = (
    Port("substeps", "", "Runge-Kutta steps per control period"),
    Port("rigid_inertia_kg_m2", "kg m^2", "hub and straight barrel, Mrr0"),
    Port("coupling", "", "modal coupling to the hub, m", size=3),
    Port("gravity", "", "modal weight, gamma", size=3),
    Port("tip", "", "modal deflection at the muzzle", size=3),
    Port("slope", "", "modal slope at the muzzle", size=3),
    Port("root_strain_ue", "ue", "root strain per modal coordinate", size=3),
    Port("stiffness_per_s2", "1/s^2", "omega^2", size=3),
    Port("damping_per_s", "1/s", "2 zeta omega", size=3),
    Port("centrifugal", "", "C_11 C_12 C_13 C_22 C_23 C_33", size=6),
    Port("horizontal_droop_rad", "rad", "static muzzle slope at 0 deg; times cos(elevation)"),
    Port("hull_sines", "", "number of hull components in use"),
    Port("heave_cos_m", "m", "lever times cos(heave phase)"),
    Port("heave_sin_m", "m", "lever times sin(heave phase)"),
    Port("hull_amplitude_rad", "rad", "amplitudes", size=HULL_COMPONENTS),
    Port("hull_omega_rad_s", "rad/s", "angular frequencies", size=HULL_COMPONENTS),
    Port("hull_phase_rad", "rad", "phases at t = 0", size=HULL_COMPONENTS),
    Port("hull_turn_cos", "", "cos(omega h/2)", size=HULL_COMPONENTS),
    Port("hull_turn_sin", "", "sin(omega h/2)", size=HULL_COMPONENTS),
    *_DIRECT,  # ends with the noise of the noisy outputs, in their order
)

STATES = (
    Port("x_theta_rad", "rad", "inertial hub angle"),
    Port("x_theta_rate_rad_s", "rad/s", "inertial hub rate"),
    Port("x_q", "", "modal coordinates, sqrt(kg) m", size=3),
    Port("x_q_rate", "", "their rates, sqrt(kg) m/s", size=3),
    Port("x_motor_angle_rad", "rad", "rotor relative to the hull"),
    Port("x_motor_speed_rad_s", "rad/s", "rotor relative to the hull"),
    Port("x_motor_torque_Nm", "N m", "motor torque"),
    Port("x_bristle_rad", "rad", "LuGre bristle deflection"),
    Port("x_hub_rate_rad_s", "rad/s", "hub gyro after its lag"),
    Port("x_muzzle_rate_rad_s", "rad/s", "muzzle gyro after its lag"),
    Port("x_strain_ue", "ue", "root strain after its lag"),
    Port("x_shaft_torque_Nm", "N m", "shaft torque after its lag"),
    Port("x_held_Nm", "N m", "motor torque command in force until the next tick"),
    Port("rng", "", "noise streams", size=NOISY_CHANNELS * STREAM_SIZE, recorded=False),
    Port(
        "scratch", "", "Runge-Kutta stages, external inputs, hull sines", size=112, recorded=False
    ),
)

INPUTS = (Port("motor_command_Nm", "N m", "newest valid motor torque command", default=0.0),)

OUTPUTS = (
    Port("encoder_rad", "rad", "sensor: hub relative to the hull"),
    Port("hub_rate_rad_s", "rad/s", "sensor: inertial hub rate"),
    Port("muzzle_rate_rad_s", "rad/s", "sensor: inertial muzzle rate"),
    Port("hull_pitch_rad", "rad", "sensor: hull pitch"),
    Port("hull_rate_rad_s", "rad/s", "sensor: hull pitch rate"),
    Port("strain_ue", "ue", "sensor: bending strain at the barrel root"),
    Port("shaft_torque_Nm", "N m", "sensor: torque on the hub"),
    Port("motor_speed_rad_s", "rad/s", "sensor and truth: rotor relative to the hull"),
    Port("motor_torque_Nm", "N m", "sensor and truth: motor torque"),
    Port("motor_angle_rad", "rad", "sensor and truth: rotor relative to the hull"),
    Port("theta_rad", "rad", "truth: inertial hub angle"),
    Port("theta_rate_rad_s", "rad/s", "truth: inertial hub rate"),
    Port("muzzle_rad", "rad", "truth: theta + slope'q, static droop included"),
    Port("elastic_slope_rad", "rad", "truth: slope'q"),
    Port("slope1_rad", "rad", "truth: share of mode 1"),
    Port("droop_rad", "rad", "static muzzle slope at the present theta"),
    Port("q1", "", "truth: modal coordinate 1, sqrt(kg) m"),
    Port("q2", "", "truth: modal coordinate 2, sqrt(kg) m"),
    Port("q3", "", "truth: modal coordinate 3, sqrt(kg) m"),
    Port("rel_rad", "rad", "truth: hub relative to the hull"),
    Port("hull_rad", "rad", "truth: hull pitch"),
    Port("gear_torque_Nm", "N m", "truth: torque on the hub, T_s"),
    Port("friction_torque_Nm", "N m", "truth: trunnion friction, T_f"),
    Port("penetration_rad", "rad", "truth: flank penetration, 0 in the gap"),
    Port("energy_J", "J", "truth: kinetic, elastic and potential energy"),
)


(
    ENCODER, HUB_RATE, MUZZLE_RATE, HULL_PITCH, HULL_RATE, STRAIN, SHAFT_TORQUE, MOTOR_SPEED,
    MOTOR_TORQUE, MOTOR_ANGLE, THETA, THETA_RATE, MUZZLE, ELASTIC_SLOPE, SLOPE1, DROOP, Q1, Q2, Q3,
    REL, HULL, GEAR_TORQUE, FRICTION_TORQUE, PENETRATION, ENERGY,
) = range(len(OUTPUTS))  # fmt: skip
NOISY = HUB_RATE  # the first of NOISY_CHANNELS outputs in a row


def offsets(ports: Sequence[Port]) -> dict[str, int]:
    """Return where each port starts in its view."""
    at, start = {}, 0
    for port in ports:
        at[port.name] = start
        start += port.size
    return at


def load_parameters(path: Path) -> dict[str, float]:
    """Return {setting: value} of a parameters.yaml: {group: {name: {value, unit, reason}}}."""
    groups = yaml.safe_load(path.read_text(encoding="utf-8"))
    return {name: entry["value"] for group in groups.values() for name, entry in group.items()}
