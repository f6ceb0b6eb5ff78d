"""The barrel plant's variables by name and unit.

A setting is what a rig may change; its value for the nominal plant stands in parameters.yaml and
only there. Those that the step uses as they are (`Direct`) are parameters too, by the same name.
"""

from pathlib import Path

import yaml

from pcpc.executive.laws.block import Ports, group, port
from pcpc.plants.atb1000.rough_ports import Errors, Rough, Surroundings
from pcpc.plants.noise import STREAM_SIZE
from pcpc.plants.transport import DELAY_SIZE

HULL_COMPONENTS = 24
NOISY_CHANNELS = 6
_TINY = 1e-9  # lower limit of what must be positive
_FAST = 1e6


class Direct(Ports):
    """Settings that are parameters as they are."""

    length_m = port("m", "barrel from trunnion to muzzle", low=0.1, high=20.0)
    unbalance_Nm = port("N m", "muzzle-heavy moment of the hub at 0 deg", low=-1e4, high=1e4)
    gear_ratio = port("", "motor turns per hub turn, N", low=1.0, high=1e4)
    gap_rad = port("rad", "total play at the output", low=0.0, high=0.1)
    ks_Nm_rad = port("N m/rad", "drive shaft stiffness at the output", low=0.0, high=1e9)
    cs_Nms_rad = port("N m s/rad", "drive shaft damping at the output", low=0.0, high=1e6)
    p0_rad = port("rad", "penetration at which damping is full", low=_TINY, high=0.1)
    motor_inertia_kg_m2 = port("kg m^2", "rotor", low=_TINY, high=1e3)
    motor_lag_s = port("s", "torque loop time constant", low=1e-4, high=1.0)
    motor_peak_Nm = port("N m", "peak torque", low=0.0, high=1e4)
    motor_stall_Nm = port("N m", "torque at standstill on full voltage", low=0.0, high=1e4)
    motor_no_load_rad_s = port("rad/s", "speed without load", low=1.0, high=1e5)
    motor_coulomb_Nm = port("N m", "Coulomb friction of the motor", low=0.0, high=1e3)
    motor_reverse_rad_s = port("rad/s", "speed over which it reverses", low=1e-3, high=1e3)
    motor_viscous_Nms_rad = port("N m s/rad", "viscous friction of the motor", low=0.0, high=1e3)
    mesh_loss = port("", "friction per gear torque at the motor", low=0.0, high=1.0)
    friction_model = port("", "trunnion: 0 none, 1 Stribeck, 2 LuGre", low=0.0, high=2.0)
    coulomb_Nm = port("N m", "trunnion Coulomb friction Fc", low=_TINY, high=1e4)
    breakaway_Nm = port("N m", "trunnion breakaway friction Fs", low=_TINY, high=1e4)
    stribeck_rad_s = port("rad/s", "Stribeck speed vs", low=1e-6, high=1e3)
    sig0_Nm_rad = port("N m/rad", "bristle stiffness", low=_TINY, high=1e9)
    sig1_Nms_rad = port("N m s/rad", "bristle damping", low=0.0, high=1e6)
    sig2_Nms_rad = port("N m s/rad", "viscous friction of the trunnion", low=0.0, high=1e6)
    bristle_fade_rad_s = port("rad/s", "speed over which sig1 fades", low=1e-6, high=1e3)
    reverse_rad_s = port("rad/s", "speed over which Stribeck reverses", low=1e-6, high=1e3)
    fire = port("", "1 fires the shot, 0 does not", low=0.0, high=1.0)
    fire_hub_Nm = port("N m", "peak hub moment, half sine, upward", low=-1e6, high=1e6)
    fire_hub_start_s = port("s", "start of the hub moment", low=0.0, high=1e6)
    fire_hub_lasts_s = port("s", "length of the hub moment", low=1e-6, high=10.0)
    fire_muzzle_N = port("N", "peak muzzle force, half sine, upward", low=-1e6, high=1e6)
    fire_muzzle_start_s = port("s", "start of the muzzle force", low=0.0, high=1e6)
    fire_muzzle_lasts_s = port("s", "length of the muzzle force", low=1e-6, high=10.0)
    gyro_bandwidth_hz = port("Hz", "hub and muzzle gyros", low=0.1, high=5e3)
    strain_bandwidth_hz = port("Hz", "root strain gauge", low=0.1, high=5e3)
    torque_bandwidth_hz = port("Hz", "shaft torque sensor", low=0.1, high=5e3)
    hub_gyro_noise_rad_s = port("rad/s", "standard deviation", low=0.0, high=1.0)
    muzzle_gyro_noise_rad_s = port("rad/s", "standard deviation", low=0.0, high=1.0)
    hull_pitch_noise_rad = port("rad", "standard deviation", low=0.0, high=1.0)
    hull_rate_noise_rad_s = port("rad/s", "standard deviation", low=0.0, high=1.0)
    strain_noise_ue = port("ue", "standard deviation", low=0.0, high=1e3)
    torque_noise_Nm = port("N m", "standard deviation", low=0.0, high=1e3)
    delay_samples = port("", "further age of the command, whole", 0.0, 0.0, DELAY_SIZE - 1.0)


class _Derived(Ports):
    """Parameters that `prepare` computes."""

    substeps = port("", "Runge-Kutta steps per control period")
    rigid_inertia_kg_m2 = port("kg m^2", "hub and straight barrel, Mrr0")
    coupling = port("", "modal coupling to the hub, m", shape=3)
    gravity = port("", "modal weight, gamma", shape=3)
    tip = port("", "modal deflection at the muzzle", shape=3)
    slope = port("", "modal slope at the muzzle", shape=3)
    root_strain_ue = port("ue", "root strain per modal coordinate", shape=3)
    stiffness_per_s2 = port("1/s^2", "omega^2", shape=3)
    damping_per_s = port("1/s", "2 zeta omega", shape=3)
    centrifugal = port("", "C_11 C_12 C_13 C_22 C_23 C_33", shape=6)
    horizontal_droop_rad = port("rad", "static muzzle slope at 0 deg; times cos(elevation)")
    hull_sines = port("", "number of hull components in use")
    heave_cos_m = port("m", "lever times cos(heave phase)")
    heave_sin_m = port("m", "lever times sin(heave phase)")
    hull_amplitude_rad = port("rad", "amplitudes", shape=HULL_COMPONENTS)
    hull_omega_rad_s = port("rad/s", "angular frequencies", shape=HULL_COMPONENTS)
    hull_phase_rad = port("rad", "phases at t = 0", shape=HULL_COMPONENTS)
    hull_turn_cos = port("", "cos(omega h/2)", shape=HULL_COMPONENTS)
    hull_turn_sin = port("", "sin(omega h/2)", shape=HULL_COMPONENTS)


class Parameters(_Derived, Direct, Rough):
    """What the step knows of the plant."""


class _Given(Ports):
    """Settings from which parameters are computed."""

    integrator_hz = port("Hz", "Runge-Kutta steps per second", low=1e3, high=_FAST)
    outer_m = port("m", "barrel outer diameter", low=1e-3, high=1.0)
    inner_m = port("m", "barrel bore", low=0.0, high=1.0)
    young_Pa = port("Pa", "Young's modulus", low=1e6, high=1e12)
    density_kg_m3 = port("kg/m^3", "density", low=1.0, high=1e5)
    tip_mass_kg = port("kg", "point mass at the muzzle", low=0.0, high=1e3)
    zeta1 = port("", "damping ratio of clamped mode 1", low=0.0, high=1.0)
    zeta2 = port("", "damping ratio of clamped mode 2", low=0.0, high=1.0)
    zeta3 = port("", "damping ratio of clamped mode 3", low=0.0, high=1.0)
    hub_inertia_kg_m2 = port("kg m^2", "hub without barrel and rotor", low=1e-3, high=1e6)
    theta0_rad = port("rad", "inertial elevation at the start", low=-1.6, high=1.6)
    hull_motion = port("", "0 none, 1 three sines, 2 random sea of sines", low=0.0, high=2.0)
    hull_lever_m = port("m", "trunnion ahead of the hull's centre", low=-10.0, high=10.0)
    heave_phase_rad = port("rad", "heave ahead of pitch acceleration", low=-7.0, high=7.0)
    hull_amplitude_rad = port(
        "rad", "sine #: amplitude", low=0.0, high=1.0, shape=3, named="hull#_amplitude_rad"
    )
    hull_frequency_hz = port(
        "Hz", "sine #: frequency", low=0.0, high=50.0, shape=3, named="hull#_frequency_hz"
    )
    hull_phase_rad = port(
        "rad", "sine #: phase", low=0.0, high=7.0, shape=3, named="hull#_phase_rad"
    )
    hullrand_seed = port("", "whole number, draws frequencies and phases", low=0.0, high=1e9)
    hullrand_rms_rad = port("rad", "rms pitch", low=0.0, high=1.0)
    hullrand_first_hz = port("Hz", "lowest of the sines before the shift", low=0.01, high=50.0)
    hullrand_last_hz = port("Hz", "highest of the sines before the shift", low=0.01, high=50.0)
    hullrand_shift_hz = port("Hz", "largest shift of a sine", low=0.0, high=10.0)
    hullrand_peak_hz = port("Hz", "natural frequency of the shaping filter", low=0.01, high=50.0)
    hullrand_zeta = port("", "damping ratio of the shaping filter", low=0.01, high=10.0)


class Settings(_Given, Direct, Rough):
    """What a rig may set."""


class Motion(Ports):
    """What Runge-Kutta advances; `d` of it is its derivative."""

    theta_rad = port("rad", "inertial hub angle")
    theta_rate_rad_s = port("rad/s", "inertial hub rate")
    q = port("", "modal coordinates, sqrt(kg) m", shape=3)
    q_rate = port("", "their rates, sqrt(kg) m/s", shape=3)
    motor_angle_rad = port("rad", "rotor relative to the hull")
    motor_speed_rad_s = port("rad/s", "rotor relative to the hull")
    motor_torque_Nm = port("N m", "motor torque")
    bristle_rad = port("rad", "LuGre bristle deflection")
    hub_rate_rad_s = port("rad/s", "hub gyro after its lag")
    muzzle_rate_rad_s = port("rad/s", "muzzle gyro after its lag")
    strain_ue = port("ue", "root strain after its lag")
    shaft_torque_Nm = port("N m", "shaft torque after its lag")


class External(Ports):
    """What acts on the plant from outside, at one moment."""

    pitch_rad = port("rad", "hull pitch")
    pitch_rate_rad_s = port("rad/s", "its rate")
    pitch_acc_rad_s2 = port("rad/s2", "its acceleration")
    heave_acc_m_s2 = port("m/s2", "of the trunnion")
    hub_moment_Nm = port("N m", "of the shot, d_r")
    muzzle_force_N = port("N", "of the shot, d_t")
    command_Nm = port("N m", "in force")
    step_s = port("s", "of the integration")
    friction_rise = port("", "of the trunnion's friction over the parameters', relative")
    cogging_Nm = port("N m", "against the rotor")


class _Barrel(Ports):
    """The states without the rougher world."""

    motion = group(Motion, "x_")
    held_Nm = port("N m", "motor torque command in force until the next tick", named="x_held_Nm")
    rng = port("", "noise streams", shape=(NOISY_CHANNELS, STREAM_SIZE), recorded=False)
    slope = group(Motion, "slope_", recorded=False)
    total = group(Motion, "total_", recorded=False)
    between = group(Motion, "between_", recorded=False)
    external = group(External, "external_", recorded=False)
    sines = port("", "sines, then cosines of the hull", shape=(2, HULL_COMPONENTS), recorded=False)
    sent_Nm = port("N m", "commands on their way", shape=DELAY_SIZE, recorded=False)


class States(_Barrel, Surroundings):
    """The motion, the command in force, the noise, and what one step needs to work on."""


class Inputs(Ports):
    """The command."""

    motor_command_Nm = port("N m", "newest valid motor torque command", default=0.0)


class _Samples(Ports):
    """Ten sensors, then the truth."""

    encoder_rad = port("rad", "sensor: hub relative to the hull")
    hub_rate_rad_s = port("rad/s", "sensor: inertial hub rate")
    muzzle_rate_rad_s = port("rad/s", "sensor: inertial muzzle rate")
    hull_pitch_rad = port("rad", "sensor: hull pitch")
    hull_rate_rad_s = port("rad/s", "sensor: hull pitch rate")
    strain_ue = port("ue", "sensor: bending strain at the barrel root")
    shaft_torque_Nm = port("N m", "sensor: torque on the hub")
    motor_speed_rad_s = port("rad/s", "sensor and truth: rotor relative to the hull")
    motor_torque_Nm = port("N m", "sensor and truth: motor torque")
    motor_angle_rad = port("rad", "sensor and truth: rotor relative to the hull")
    theta_rad = port("rad", "truth: inertial hub angle")
    theta_rate_rad_s = port("rad/s", "truth: inertial hub rate")
    muzzle_rad = port("rad", "truth: theta + slope'q, static droop included")
    elastic_slope_rad = port("rad", "truth: slope'q")
    slope1_rad = port("rad", "truth: share of mode 1")
    droop_rad = port("rad", "static muzzle slope at the present theta")
    q1 = port("", "truth: modal coordinate 1, sqrt(kg) m")
    q2 = port("", "truth: modal coordinate 2, sqrt(kg) m")
    q3 = port("", "truth: modal coordinate 3, sqrt(kg) m")
    rel_rad = port("rad", "truth: hub relative to the hull")
    hull_rad = port("rad", "truth: hull pitch")
    gear_torque_Nm = port("N m", "truth: torque on the hub, T_s")
    friction_torque_Nm = port("N m", "truth: trunnion friction, T_f")
    penetration_rad = port("rad", "truth: flank penetration, 0 in the gap")
    energy_J = port("J", "truth: kinetic, elastic and potential energy")


class Outputs(_Samples, Errors):
    """Ten sensors, then the truth, also of the rougher world."""


def load_parameters(path: Path) -> dict[str, float]:
    """Return {setting: value} of a parameters.yaml: {group: {name: {value, unit, reason}}}."""
    groups = yaml.safe_load(path.read_text(encoding="utf-8"))
    return {name: entry["value"] for group in groups.values() for name, entry in group.items()}
