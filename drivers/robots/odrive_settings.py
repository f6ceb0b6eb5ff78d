"""What `drivers.robots.odrive` speaks of: commands, states, errors, settings (no numba here).

SENT       commands that are sent by themselves, with the periods of the first settings
LENGTHS    bytes that a command needs
OWN        1 for commands whose data only the drive sends
SETS       rows of the settings to which a command gives its two numbers
"""

import numpy as np

from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.robots.settings import Setting, keys_of

_AXIS, _CAN = "axis0.", "axis0.config.can."
_CONTROL, _TRAJECTORY = "axis0.controller.config.", "axis0.trap_traj.config."


class CommandId(NumberedEnum):
    """The lower five bits of an id."""

    VERSION, HEARTBEAT, ESTOP, ERROR, READ_OR_WRITE, ANSWER = range(6)
    STATE, ENCODER, MODE, POSITION, VELOCITY, TORQUE, LIMITS = 7, 9, 11, 12, 13, 14, 15
    TRAJECTORY_VELOCITY, TRAJECTORY_ACCELERATION, INERTIA = 17, 18, 19
    IQ, TEMPERATURE, REBOOT, BUS, CLEAR, ABSOLUTE = 20, 21, 22, 23, 24, 25
    POSITION_GAIN, VELOCITY_GAINS, TORQUES, POWERS = 26, 27, 28, 29


class Axis(NumberedEnum):
    """States of the axis."""

    IDLE, CLOSED_LOOP = 1, 8


class Error(NumberedEnum):
    """Bits of what is wrong."""

    NONE, BAD_CONFIG, VELOCITY = 0, 1 << 4, 1 << 15
    WATCHDOG, ESTOP = 1 << 24, 1 << 25


class ProcedureResult(NumberedEnum):
    """How the last procedure ended."""

    SUCCESS, DISARMED, INVALID_STATE = 0, 3, 13


class Input(NumberedEnum):
    """Input modes."""

    INACTIVE, PASSTHROUGH, VELOCITY_RAMP, POSITION_FILTER = 0, 1, 2, 3
    TRAPEZOID, TORQUE_RAMP = 5, 6


class Control(NumberedEnum):
    """Control modes."""

    TORQUE, VELOCITY, POSITION = 1, 2, 3


_SENT = (  # by themselves, in the order of their settings
    CommandId.HEARTBEAT, CommandId.ENCODER, CommandId.ERROR, CommandId.IQ, CommandId.TEMPERATURE,
    CommandId.BUS, CommandId.TORQUES, CommandId.POWERS,
)  # fmt: skip
SENT = np.array(_SENT, np.int64)
LENGTHS = np.zeros(32, np.int64)  # of commands that carry something
for _command, _length in {
    CommandId.READ_OR_WRITE: 4,
    CommandId.STATE: 4,
    CommandId.MODE: 8,
    CommandId.POSITION: 8,
    CommandId.VELOCITY: 8,
    CommandId.TORQUE: 4,
    CommandId.LIMITS: 8,
    CommandId.TRAJECTORY_VELOCITY: 4,
    CommandId.TRAJECTORY_ACCELERATION: 8,
    CommandId.INERTIA: 4,
    CommandId.ABSOLUTE: 4,
    CommandId.POSITION_GAIN: 4,
    CommandId.VELOCITY_GAINS: 8,
}.items():
    LENGTHS[_command] = _length
OWN = np.zeros(32, np.int64)  # commands that only the drive sends data for
OWN[[*_SENT, CommandId.VERSION, CommandId.ANSWER]] = 1

_LIST: tuple[tuple[str, float, float, bool], ...] = (  # name, start, highest, whole
    (f"{_CAN}heartbeat_msg_rate_ms", 100.0, 65535.0, True),
    (f"{_CAN}encoder_msg_rate_ms", 10.0, 65535.0, True),
    *(
        (f"{_CAN}{name}_msg_rate_ms", 0.0, 65535.0, True)
        for name in ("error", "iq", "temperature", "bus_voltage", "torques", "powers")
    ),
    (f"{_AXIS}config.enable_watchdog", 0.0, 1.0, True),
    (f"{_AXIS}config.watchdog_timeout", 0.0, 1e6, False),
    (f"{_CONTROL}control_mode", 3.0, 3.0, True),
    (f"{_CONTROL}input_mode", 1.0, 6.0, True),
    (f"{_CONTROL}vel_limit", 2.0, 1e9, False),
    (f"{_CONTROL}vel_limit_tolerance", 1.2, 1e9, False),
    (f"{_AXIS}config.torque_soft_max", 1e9, 1e9, False),
    (f"{_CONTROL}vel_ramp_rate", 1.0, 1e9, False),
    (f"{_CONTROL}torque_ramp_rate", 0.01, 1e9, False),
    (f"{_CONTROL}input_filter_bandwidth", 2.0, 1e4, False),
    (f"{_CONTROL}inertia", 0.0, 1e9, False),
    (f"{_TRAJECTORY}vel_limit", 2.0, 1e9, False),
    (f"{_TRAJECTORY}accel_limit", 0.5, 1e9, False),
    (f"{_TRAJECTORY}decel_limit", 0.5, 1e9, False),
    (f"{_AXIS}config.motor.torque_constant", 1.0, 1e9, False),
    ("vbus_voltage", 24.0, 1e6, False),
    (f"{_AXIS}motor.motor_thermistor.temperature", 25.0, 1e3, False),
)
_READ_ONLY = ("vbus_voltage", f"{_AXIS}motor.motor_thermistor.temperature")
SETTINGS = tuple(
    Setting(name, i, start, 0.0, high, whole, name not in _READ_ONLY)
    for i, (name, start, high, whole) in enumerate(_LIST)
)
Key = keys_of("Odrive", SETTINGS)
SETS = np.full((32, 2), -1)  # the settings that a command gives values, both or none
for _command, _keys in {
    CommandId.MODE: (Key.CONTROL_MODE, Key.INPUT_MODE),
    CommandId.LIMITS: (Key.VEL_LIMIT, Key.TORQUE_SOFT_MAX),
    CommandId.TRAJECTORY_VELOCITY: (Key.TRAP_TRAJ_VEL_LIMIT, -1),
    CommandId.TRAJECTORY_ACCELERATION: (
        Key.TRAP_TRAJ_ACCEL_LIMIT, Key.TRAP_TRAJ_DECEL_LIMIT,
    ),
    CommandId.INERTIA: (Key.INERTIA, -1),
}.items():  # fmt: skip
    SETS[_command] = _keys
