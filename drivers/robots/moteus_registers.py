"""What `drivers.robots.moteus` speaks of: registers, modes, faults, settings (no numba here).

    SCALES     what 1 of an int8, int16, int32 is, three for each kind
    KIND       by register: how its value is coded; -1: it cannot be read
    ROW        by register: the row of the settings that it is; -1: it is measured, or none
    READ_ONLY  by register: 1 where a write is refused with error 2

The commands come first: a mode is written together with them, and takes all that were not.
"""

import math

import numpy as np

from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.robots.settings import LARGEST, Setting, keys_of


class MoteusMode(NumberedEnum):
    """Register 0x000."""

    STOPPED, FAULT, CURRENT, POSITION, TIMEOUT = 0, 1, 9, 10, 11
    ZERO_VELOCITY, STAY_WITHIN, BRAKE = 12, 13, 15


class MoteusFault(NumberedEnum):
    """Register 0x00f."""

    NONE, OUTSIDE_LIMIT, STOP_POSITION = 0, 39, 45


class Coding(NumberedEnum):
    """How a register is coded as a whole number; a WORD is read as int32 only."""

    (
        WHOLE, POSITION, VELOCITY, TORQUE, SHARE, VOLTAGE, TEMPERATURE, TIME, CURRENT,
        ACCELERATION, POWER, WORD,
    ) = range(12)  # fmt: skip


SCALES = np.array([
    (1.0, 1.0, 1.0), (0.01, 1e-4, 1e-5), (0.1, 0.00025, 1e-5), (0.5, 0.01, 0.001),
    (1.0 / 127.0, 1.0 / 32767.0, 1.0 / 2147483647.0), (0.5, 0.1, 0.001), (1.0, 0.1, 0.001),
    (0.01, 0.001, 1e-6), (1.0, 0.1, 0.001), (0.05, 0.001, 1e-5), (10.0, 0.05, 1e-4),
    (1.0, 1.0, 1.0),
]).reshape(-1)  # fmt: skip


class Register(NumberedEnum):
    """Those that the drive does something with, or measures."""

    MODE, POSITION, VELOCITY, TORQUE, Q_CURRENT, D_CURRENT, ABSOLUTE, POWER = range(8)
    COMPLETE, HOME, FAULT = 0x00B, 0x00C, 0x00F
    PROPORTIONAL, INTEGRAL, DERIVATIVE, FED_FORWARD, DEMANDED = range(0x030, 0x035)
    CONTROL_POSITION, CONTROL_VELOCITY, CONTROL_TORQUE = range(0x038, 0x03B)
    POSITION_ERROR, VELOCITY_ERROR, TORQUE_ERROR = range(0x03B, 0x03E)
    ENCODER_POSITION, ENCODER_VELOCITY, VALID, MILLISECONDS = 0x050, 0x051, 0x058, 0x070
    MULTIPLEX_ID, NEAREST, EXACT, RECAPTURE = 0x110, 0x130, 0x131, 0x133


COMMANDS = 18
ACTIVE = 40  # row of the first command that is obeyed
_NONE = math.nan
_Row = tuple[str, int, Coding, float, float, float]
_COMMANDS: tuple[_Row, ...] = tuple(
    (f"command.{name}", number, coding, start, -LARGEST, LARGEST)
    for name, number, coding, start in (
        ("position", 0x020, Coding.POSITION, 0.0), ("velocity", 0x021, Coding.VELOCITY, 0.0),
        ("feedforward_torque", 0x022, Coding.TORQUE, 0.0),
        ("kp_scale", 0x023, Coding.SHARE, 1.0), ("kd_scale", 0x024, Coding.SHARE, 1.0),
        ("maximum_torque", 0x025, Coding.TORQUE, _NONE),
        ("stop_position", 0x026, Coding.POSITION, _NONE),
        ("watchdog_timeout", 0x027, Coding.TIME, 0.0),
        ("velocity_limit", 0x028, Coding.VELOCITY, _NONE),
        ("accel_limit", 0x029, Coding.ACCELERATION, _NONE),
        ("fixed_voltage_override", 0x02A, Coding.VOLTAGE, _NONE),
        ("ilimit_scale", 0x02B, Coding.SHARE, 1.0),
        ("fixed_current_override", 0x02C, Coding.CURRENT, _NONE),
        ("ignore_position_bounds", 0x02D, Coding.WHOLE, 0.0),
        ("q_current", 0x01C, Coding.CURRENT, 0.0), ("d_current", 0x01D, Coding.CURRENT, 0.0),
        ("lower_bound", 0x040, Coding.POSITION, 0.0), ("upper_bound", 0x041, Coding.POSITION, 0.0),
    )
)  # fmt: skip
_NO_REGISTER = -1
_CONFIGURATION: tuple[_Row, ...] = (
    ("torque_constant", _NO_REGISTER, Coding.WHOLE, 1.0, 1e-9, 1e9),
    ("servo.max_current_A", _NO_REGISTER, Coding.WHOLE, 100.0, 0.0, 1e9),
    ("servo.default_timeout_s", _NO_REGISTER, Coding.WHOLE, 0.1, 0.0, 1e9),
    ("servo.timeout_mode", _NO_REGISTER, Coding.WHOLE, 12.0, 0.0, 15.0),
    ("servo.default_velocity_limit", _NO_REGISTER, Coding.WHOLE, _NONE, 0.0, LARGEST),
    ("servo.default_accel_limit", _NO_REGISTER, Coding.WHOLE, _NONE, 0.0, LARGEST),
    ("servopos.position_min", _NO_REGISTER, Coding.WHOLE, _NONE, -LARGEST, LARGEST),
    ("servopos.position_max", _NO_REGISTER, Coding.WHOLE, _NONE, -LARGEST, LARGEST),
    ("servo.max_position_slip", _NO_REGISTER, Coding.WHOLE, _NONE, 0.0, LARGEST),
    ("servo.pid_position.ilimit", _NO_REGISTER, Coding.WHOLE, 1e9, 0.0, 1e9),
    ("voltage", 0x00D, Coding.VOLTAGE, 24.0, 0.0, 1e6),
    ("temperature", 0x00E, Coding.TEMPERATURE, 25.0, -1e3, 1e3),
    ("motor_temperature", 0x00A, Coding.TEMPERATURE, 25.0, -1e3, 1e3),
)
_IDENTITY: tuple[_Row, ...] = tuple(
    (name, number, Coding.WORD, start, 0.0, 2147483647.0)
    for name, number, start in (
        ("model_number", 0x100, 0.0), ("firmware_version", 0x101, float(0x010000)),
        ("register_map_version", 0x102, 5.0), ("serial_number1", 0x120, 1.0),
        ("serial_number2", 0x121, 0.0), ("serial_number3", 0x122, 0.0),
    )
)  # fmt: skip
_ROWS = (*_COMMANDS, *_CONFIGURATION, *_IDENTITY)
_WHOLE = ("command.ignore_position_bounds", "servo.timeout_mode")
SETTINGS = tuple(
    Setting(name, number, start, low, high, coding == Coding.WORD or name in _WHOLE, i < COMMANDS)
    for i, (name, number, coding, start, low, high) in enumerate(_ROWS)
)
Key = keys_of("Moteus", SETTINGS)
REGISTERS = 0x160
KIND, ROW = np.full(REGISTERS, -1), np.full(REGISTERS, -1)
for _i, (_name, _number, _coding, *_) in enumerate(_ROWS):
    if _number >= 0:
        KIND[_number], ROW[_number] = _coding, _i
for _shadow, _number in enumerate((0x022, 0x023, 0x024, 0x025, 0x027, 0x02B, 0x02D), 0x042):
    KIND[_shadow], ROW[_shadow] = KIND[_number], ROW[_number]
_MEASURED = {
    Coding.WHOLE: (0x000, 0x00B, 0x00C, 0x00F, 0x058, 0x05E, 0x05F, 0x070),
    Coding.POSITION: (0x001, 0x006, 0x038, 0x03B, 0x050),
    Coding.VELOCITY: (0x002, 0x039, 0x03C, 0x051),
    Coding.TORQUE: (0x003, *range(0x030, 0x035), 0x03A, 0x03D),
    Coding.CURRENT: (0x004, 0x005), Coding.POWER: (0x007,), Coding.WORD: (0x110,),
}  # fmt: skip
for _coding, _numbers in _MEASURED.items():
    KIND[list(_numbers)] = _coding
READ_ONLY = ((KIND >= 0) & ((ROW < 0) | (ROW >= COMMANDS))).astype(np.int64)
READ_ONLY[Register.MODE] = 0
