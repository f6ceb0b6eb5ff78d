"""What the rougher world of the barrel may be told, and what it keeps: see rough.py.

Defaults are for logs and rigs from before there was one; the numbers stand in parameters.yaml.
"""

from pcpc.executive.laws.block import Ports, group, port
from pcpc.plants.noise import STREAM_SIZE

DEVICES = 6  # each with an age of its own
SIGNALS = 10  # that they may show late
PAST = 16  # periods that are remembered of each
GYROS = 3  # of the hub, the muzzle, the hull


class Rough(Ports):
    """Seven switches, and the numbers of what they switch on."""

    rough = port("", "1 switches on all that follows, 0 what its own switch says", 0.0, 0.0, 1.0)
    rough_gyros = port("", "1: bias and drift of the gyros", 0.0, 0.0, 1.0)
    rough_encoder = port("", "1: the encoder's scale runs out of centre", 0.0, 0.0, 1.0)
    rough_motor = port("", "1: cogging and torque ripple", 0.0, 0.0, 1.0)
    rough_bearing = port("", "1: friction falls as the bearing warms", 0.0, 0.0, 1.0)
    rough_hull = port("", "1: the hull gives way to what moves the barrel", 0.0, 0.0, 1.0)
    rough_timing = port("", "1: samples of different ages", 0.0, 0.0, 1.0)
    hub_gyro_bias_rad_s = port("rad/s", "at the start", 0.0, -1.0, 1.0)
    muzzle_gyro_bias_rad_s = port("rad/s", "at the start", 0.0, -1.0, 1.0)
    hull_gyro_bias_rad_s = port("rad/s", "at the start", 0.0, -1.0, 1.0)
    gyro_walk_rad_s_rts = port("rad/s/sqrt(s)", "rate random walk of each", 0.0, 0.0, 1.0)
    encoder_once_rad = port("rad", "error once a turn of the hub", 0.0, 0.0, 0.1)
    encoder_once_phase_rad = port("rad", "its phase at 0 deg", 0.0, -7.0, 7.0)
    encoder_twice_rad = port("rad", "error twice a turn of the hub", 0.0, 0.0, 0.1)
    encoder_twice_phase_rad = port("rad", "its phase at 0 deg", 0.0, -7.0, 7.0)
    cogging_Nm = port("N m", "cogging of the motor, peak", 0.0, 0.0, 1e3)
    cogging_per_turn = port("", "its periods a turn of the motor", 1.0, 1.0, 1e4)
    cogging_phase_rad = port("rad", "its phase at motor angle 0", 0.0, -7.0, 7.0)
    ripple = port("", "torque ripple over torque, peak", 0.0, 0.0, 1.0)
    ripple_per_turn = port("", "its periods a turn of the motor", 1.0, 1.0, 1e4)
    ripple_phase_rad = port("rad", "its phase at motor angle 0", 0.0, -7.0, 7.0)
    friction_fall_per_K = port("1/K", "fall of friction with warmth", 0.0, 0.0, 0.5)
    ambient_K = port("K", "surroundings, above the friction's reference", 0.0, -60.0, 60.0)
    bearing_J_K = port("J/K", "heat capacity of what rubs", 1.0, 1e-3, 1e6)
    bearing_W_K = port("W/K", "heat that it loses to the surroundings", 0.0, 0.0, 1e4)
    hull_inertia_kg_m2 = port("kg m^2", "hull about the trunnion", 1.0, 1e-2, 1e9)
    hull_spring_Nm_rad = port("N m/rad", "holds it to the given motion", 0.0, 0.0, 1e9)
    hull_damper_Nms_rad = port("N m s/rad", "beside the spring", 0.0, 0.0, 1e9)
    encoder_age_s = port("s", "age of its samples", 0.0, 0.0, 0.01)
    gyro_age_s = port("s", "of the samples of hub and muzzle gyro", 0.0, 0.0, 0.01)
    hull_age_s = port("s", "of the samples of hull pitch and hull rate", 0.0, 0.0, 0.01)
    strain_age_s = port("s", "of the samples of the strain gauge", 0.0, 0.0, 0.01)
    torque_age_s = port("s", "of the samples of shaft torque", 0.0, 0.0, 0.01)
    motor_age_s = port("s", "of the drive's angle, speed and torque", 0.0, 0.0, 0.01)


SWITCHES = tuple(one.name for one in Rough.ports if one.name.startswith("rough"))
AGES = tuple(one.name for one in Rough.ports if one.name.endswith("_age_s"))


class World(Ports):
    """What is integrated beside the motion of the barrel."""

    hull_yield_rad = port("rad", "hull from where it is told to be")
    hull_yield_rate_rad_s = port("rad/s", "its rate")
    bearing_K = port("K", "bearing above the friction's reference")


class Surroundings(Ports):
    """The states of the rougher world, and what a step of it works on."""

    world = group(World, "world_", recorded=False)
    world_slope = group(World, "world_slope_", recorded=False)
    world_total = group(World, "world_total_", recorded=False)
    world_between = group(World, "world_between_", recorded=False)
    gyro_bias_rad_s = port("rad/s", "hub, muzzle, hull", shape=GYROS, recorded=False)
    walk_rng = port("", "noise streams", shape=(GYROS, STREAM_SIZE), recorded=False)
    shares = port("", "of what is seen now, in the order of AGES", shape=DEVICES, recorded=False)
    seen = port("", "signals at the ages of their samples", shape=SIGNALS, recorded=False)
    past = port("", "of seen, newest first", shape=(SIGNALS, PAST), recorded=False)
    seen_s = port("s", "when past was written", recorded=False)


class Errors(Ports):
    """Truths of the rougher world; out of the log, which is the same without it."""

    hull_yield_rad = port("rad", "truth: hull from where it is told to be", recorded=False)
    bearing_K = port("K", "truth: bearing above the friction's reference", recorded=False)
    hub_gyro_error_rad_s = port("rad/s", "truth: bias of the hub gyro", recorded=False)
    encoder_error_rad = port("rad", "truth: encoder out of centre", recorded=False)
    cogging_torque_Nm = port("N m", "truth: cogging and ripple against the rotor", recorded=False)
