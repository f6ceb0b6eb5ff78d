"""RobStride's private protocol: ids of 29 bits, each order answered with where the motor is.

    id      type << 24 | data << 8 | node; data: host, of type 1 the torque
    00      who are you: answered by 00 with data node, to FE, a number of 64 bits
    01      operation: position, velocity, stiffness, damping; 16 bits each, highest byte first
    02      feedback: data mode << 14 | faults << 8 | node, to the host; position, velocity, torque,
            ten times the temperature
    03 04   on; off, with a first byte of 1 faults are forgotten
    06 07   here is 0; be node (data >> 8) from now on, answered by 00
    11 12   read, write: number, 0, four bytes; for no such number data is 1 << 8 | node
    15      faults, warnings, four bytes each; sent by itself, too, when one comes
    16      save: answered, and kept until power-off as all settings are
    17 19   another bit rate, another protocol: refused, and counted by its name
    18      report: with a seventh byte of 1 feedback comes every 5 (EPScan_time + 1) ms

    T = stiffness (q_d - q) + damping (w_d - w) + t                               operation 0 (1)
    T = k iq_ref                                                                  current   3 (2)
    w_d goes to spd_ref at acc_rad, T of `loops` (2)                              velocity  2 (3)
    q_d goes to loc_ref at most vel_max fast, acc_set each way; (1), (2) of `loops`   PP    1 (4)
    w_d = loc_kp (loc_ref - q), |w_d| <= limit_spd                                CSP       5 (5)

|T| <= limit_torque, in 1, 2 and 5 also k limit_cur; k is torque_constant. loc_kp, spd_kp in A s/rad
and spd_ki in A/rad are the drive's gains: Kp, Kv = k rated spd_kp, Ki = spd_ki/spd_kp.

    C dTemp/dt = R i^2 - (Temp - ambient)/R_th                                                (6)
    VBUS = supply - R_s (T w + R i^2)/supply                                                  (7)

A VBUS out of bounds, a Temp above its own, and canTimeout (50 us each, 0 is none) without an order
take the torque away; the first three until faults are forgotten. Source: the motors' manual,
RS00 of 2025-11 for types, numbers and full scale. damper, zero_sta and filters have no effect.
"""

from pcpc.drivers.can.codec import four_bytes
from pcpc.drivers.compiled.jit import loop_function
from pcpc.drivers.compiled.numbered import NumberedEnum
from pcpc.drivers.compiled.records import Byte, Cells, int64
from pcpc.drivers.compiled.rows import FLAGS, LENGTH
from pcpc.drivers.compiled.structures import data_of
from pcpc.drivers.drive.layout import Whose
from pcpc.drivers.drive.outbox import put
from pcpc.drivers.drive.ways import toward
from pcpc.drivers.robots.fields import (
    big_word,
    coded,
    decoded,
    put_big,
    row_of,
    value_in,
    value_word,
    write,
)
from pcpc.drivers.robots.layout import Mistake, Robot
from pcpc.drivers.robots.loops import (
    follow_trapezoid,
    place_at,
    start_here,
    torque_for,
    velocity_gain,
    wanted_velocity,
)
from pcpc.drivers.robots.settings import LARGEST, Setting, keys_of

NODES = 128
EXTENDED, REMOTE = int64(1 << 31), int64(1 << 30)
TICK_S, EVERYBODY, HOST = 50e-6, 0xFE, 0xFD
POSITION_MOST = 12.566370614359172  # 4 pi
SERIAL = 0x5043_5043  # the first half of the number of 64 bits, the second is the node at the start
NO_NUMBER = -1


class Kind(NumberedEnum):
    """Types of frames."""

    IDENTITY, OPERATION, FEEDBACK, ON, OFF = range(5)
    ZERO, NODE = 6, 7
    READ, WRITE, FAULTS, SAVE, BIT_RATE, REPORT, PROTOCOL = 0x11, 0x12, 0x15, 0x16, 0x17, 0x18, 0x19


class Power(NumberedEnum):
    """The mode that feedback tells."""

    RESET, CALIBRATION, RUN = range(3)


class RunMode(NumberedEnum):
    """Of `run_mode`."""

    OPERATION, PROFILE, VELOCITY, CURRENT, POSITION = 0, 1, 2, 3, 5


class Fault(NumberedEnum):
    """Bits of faults."""

    HOT, UNDERVOLTAGE, OVERVOLTAGE = 1, 4, 8


SETTINGS = tuple(Setting(*row) for row in (  # name, number, start, low, high, whole, writable
    ("run_mode", 0x7005, 0.0, 0.0, 5.0, True),
    ("iq_ref", 0x7006, 0.0, -1e3, 1e3),
    ("spd_ref", 0x700A, 0.0, -1e3, 1e3),
    ("limit_torque", 0x700B, 14.0, 0.0, 1e3),
    ("cur_kp", 0x7010, 0.125, 0.0, 1e3),
    ("cur_ki", 0x7011, 0.0158, 0.0, 1e3),
    ("cur_filt_gain", 0x7014, 0.1, 0.0, 1.0),
    ("loc_ref", 0x7016, 0.0, -LARGEST, LARGEST),
    ("limit_spd", 0x7017, 33.0, 0.0, 1e3),
    ("limit_cur", 0x7018, 16.0, 0.0, 1e3),
    ("mechPos", 0x7019, 0.0, -LARGEST, LARGEST, False, False),
    ("iqf", 0x701A, 0.0, -LARGEST, LARGEST, False, False),
    ("mechVel", 0x701B, 0.0, -LARGEST, LARGEST, False, False),
    ("VBUS", 0x701C, 48.0, -LARGEST, LARGEST, False, False),
    ("loc_kp", 0x701E, 0.0, 0.0, 1e6),  # this and the next two: of the drive's gains
    ("spd_kp", 0x701F, 0.0, 0.0, 1e6),
    ("spd_ki", 0x7020, 0.0, 0.0, 1e6),
    ("spd_filt_gain", 0x7021, 0.05, 0.0, 1.0),
    ("acc_rad", 0x7022, 100.0, 1e-6, 1e6),
    ("vel_max", 0x7024, 10.0, 0.0, 1e3),
    ("acc_set", 0x7025, 10.0, 1e-6, 1e6),
    ("EPScan_time", 0x7026, 1.0, 1.0, 65535.0, True),
    ("canTimeout", 0x7028, 0.0, 0.0, 4294967295.0, True),
    ("zero_sta", 0x7029, 0.0, 0.0, 1.0, True),
    ("damper", 0x702A, 0.0, 0.0, 1.0, True),
    ("CAN_ID", 0x200A, 1.0, 0.0, 127.0, True, False),
    ("faultSta", 0x3022, 0.0, 0.0, 4294967295.0, True, False),
    ("torque_fdb", 0x302C, 0.0, -LARGEST, LARGEST, False, False),
    ("V_MAX", NO_NUMBER, 33.0, 1e-6, 1e3),  # full scale, as of the model
    ("T_MAX", NO_NUMBER, 14.0, 1e-6, 1e3),
    ("KP_MAX", NO_NUMBER, 500.0, 1e-6, 1e6),
    ("KD_MAX", NO_NUMBER, 5.0, 1e-6, 1e6),
    ("torque_constant", NO_NUMBER, 1.0, 1e-9, 1e6),
    ("resistance_ohm", NO_NUMBER, 0.0, 0.0, 1e3),
    ("thermal_K_W", NO_NUMBER, 5.0, 1e-6, 1e6),
    ("thermal_J_K", NO_NUMBER, 100.0, 1e-6, 1e6),
    ("ambient_C", NO_NUMBER, 25.0, -100.0, 1e3),
    ("warm_C", NO_NUMBER, 135.0, -100.0, 1e4),
    ("hot_C", NO_NUMBER, 145.0, -100.0, 1e4),
    ("temperature_C", NO_NUMBER, 25.0, -100.0, 1e4),
    ("supply_V", NO_NUMBER, 48.0, 1e-3, 1e4),
    ("supply_ohm", NO_NUMBER, 0.0, 0.0, 1e3),
    ("low_V", NO_NUMBER, 12.0, 0.0, 1e4),
    ("high_V", NO_NUMBER, 60.0, 0.0, 1e4),
))  # fmt: skip
Key = keys_of("Robstride", SETTINGS)


@loop_function
def boot(r: Robot) -> None:
    """Be as after power-on."""
    r.state.boots += 1
    r.state.host, r.value[Key.CAN_ID] = HOST, r.node
    start_here(r)


@loop_function
def begin(r: Robot) -> None:
    """Begin where the motor is, as fast as it is."""
    start_here(r)
    r.value[Key.LOC_REF], r.state.way_velocity = r.state.position, r.state.velocity


@loop_function
def hear(r: Robot) -> int:
    """Take the frame in `rx`; return whose it is."""
    x, word, node = r.state, four_bytes(r.rx, 0), int64(r.value[Key.CAN_ID])
    if x.boots == 0:
        boot(r)
        node = r.node
    kind, data, whom = word >> int64(24) & 31, word >> int64(8) & 0xFFFF, word & 255
    if word & EXTENDED == 0 or word & REMOTE != 0 or r.rx[FLAGS] != 0:
        return int64(Whose.OTHER)
    told = kind == Kind.FEEDBACK or (kind == Kind.IDENTITY and whom == EVERYBODY)
    if data & 255 == node and told:
        return int64(Whose.TWIN)
    if whom != node:
        return int64(Whose.OTHER)
    if kind != Kind.OPERATION:
        x.host = data & 255
    if r.rx[LENGTH] < 8:
        r.mistakes[Mistake.FRAME_SHORT] += 1
    else:
        x.fed_at = r.k
        obey(r, kind, data)
    return int64(Whose.OURS)


@loop_function
def obey(r: Robot, kind: int, data: int) -> None:
    """Do what a frame wants, and answer."""
    x, content = r.state, data_of(r.rx)
    if kind == Kind.READ:
        return read(r)
    if kind == Kind.FAULTS:
        return tell_faults(r)
    if kind == Kind.IDENTITY or (kind == Kind.NODE and write_node(r, data >> int64(8))):
        return tell_identity(r)
    if kind == Kind.OPERATION:
        take_operation(r, data)
    elif kind == Kind.ON and x.errors == 0:
        if x.power != Power.RUN:
            begin(r)
        x.power = Power.RUN
    elif kind == Kind.OFF:
        x.power = Power.RESET
        if content[0] == 1:
            x.errors = 0
    elif kind == Kind.ZERO and int64(r.value[Key.RUN_MODE]) != RunMode.PROFILE:
        place_at(r, 0.0)
        x.target_position = x.way_position = r.value[Key.LOC_REF] = 0.0
    elif kind == Kind.WRITE:
        take_value(r, content)
    elif kind == Kind.REPORT:
        x.reports = 1 if content[6] == 1 else 0
    elif kind == Kind.PROTOCOL and content[6] <= 2:
        r.mistakes[Mistake.TO_CANOPEN - 1 + content[6]] += 1 if content[6] != 0 else 0
    elif kind != Kind.SAVE and kind != Kind.NODE:
        r.mistakes[Mistake.COMMAND_REFUSED] += 1
    feed_back(r)


@loop_function
def write_node(r: Robot, node: int) -> bool:
    """Be another node from now on; return whether it is one."""
    if not 0 < node < NODES:
        r.mistakes[Mistake.VALUE_REFUSED] += 1
        return False
    r.value[Key.CAN_ID] = node
    return True


@loop_function
def take_operation(r: Robot, torque: int) -> None:
    """Take the five numbers of (1)."""
    x, v, word = r.state, r.value, big_word(r)
    if x.power != Power.RUN or int64(v[Key.RUN_MODE]) != RunMode.OPERATION:
        r.mistakes[Mistake.COMMAND_REFUSED] += 1
        return
    x.target_position = decoded(word, 48, 16, -POSITION_MOST, POSITION_MOST)
    x.target_velocity = decoded(word, 32, 16, -v[Key.V_MAX], v[Key.V_MAX])
    x.stiffness = decoded(word, 16, 16, 0.0, v[Key.KP_MAX])
    x.damping = decoded(word, 0, 16, 0.0, v[Key.KD_MAX])
    x.target_torque = decoded(torque, 0, 16, -v[Key.T_MAX], v[Key.T_MAX])


@loop_function
def take_value(r: Robot, data: Cells[Byte]) -> None:
    """Write a setting; those of the loops are gains of the drive."""
    x, v, g = r.state, r.value, r.gains
    show(r)
    row = row_of(r, int64(data[0]) | int64(data[1]) << int64(8))
    if row < 0 or (row == Key.RUN_MODE and data[4] == 4):
        r.mistakes[Mistake.VALUE_REFUSED] += 1
    elif not write(r, row, value_in(r, row, data, 4)):
        return
    elif row == Key.RUN_MODE:
        begin(r)
    elif Key.LOC_KP <= row <= Key.SPD_KI:
        g.position_per_s = v[Key.LOC_KP]
        g.velocity = v[Key.SPD_KP] * v[Key.TORQUE_CONSTANT] * r.rated * r.velocity_scale
        g.integral_per_s = v[Key.SPD_KI] / v[Key.SPD_KP] if v[Key.SPD_KP] > 0.0 else 0.0
        x.regained = 1


@loop_function
def show(r: Robot) -> None:
    """Let the settings that are measured be so."""
    x, v, k = r.state, r.value, r.value[Key.TORQUE_CONSTANT]
    v[Key.MECHPOS], v[Key.MECHVEL], v[Key.TORQUE_FDB] = x.position, x.velocity, x.torque
    v[Key.IQF], v[Key.FAULTSTA] = x.torque / k, x.errors
    v[Key.LOC_KP], v[Key.SPD_KP] = r.gains.position_per_s, velocity_gain(r) / k
    v[Key.SPD_KI] = v[Key.SPD_KP] * r.gains.integral_per_s


@loop_function
def read(r: Robot) -> None:
    """Answer with a setting."""
    number = four_bytes(data_of(r.rx), 0) & 0xFFFF
    show(r)
    row = row_of(r, number)
    if row < 0:
        r.mistakes[Mistake.VALUE_REFUSED] += 1
        send(r, int64(Kind.READ), int64(256), number, int64(0))
    else:
        send(r, int64(Kind.READ), int64(0), number, value_word(r, row))


@loop_function
def id_of(r: Robot, kind: int, data: int) -> int:
    """Return the id of a frame to the host, of the node with more data."""
    node = int64(r.value[Key.CAN_ID])
    return EXTENDED | int64(kind) << int64(24) | (data | node) << int64(8) | r.state.host


@loop_function
def send(r: Robot, kind: int, data: int, low: int, high: int) -> None:
    """Send two words to the host."""
    put(r, id_of(r, kind, data), 8, low, high)


@loop_function
def tell_identity(r: Robot) -> None:
    """Say who this is, to everybody."""
    node = int64(r.value[Key.CAN_ID])
    put(r, EXTENDED | node << int64(8) | EVERYBODY, 8, int64(SERIAL), r.node)


@loop_function
def tell_faults(r: Robot) -> None:
    """Say what is wrong, and what soon will be."""
    warm = 1 if r.value[Key.TEMPERATURE_C] > r.value[Key.WARM_C] else 0
    send(r, int64(Kind.FAULTS), int64(0), r.state.errors, int64(warm))


@loop_function
def feed_back(r: Robot) -> None:
    """Say where the motor is, and how it is."""
    x, v = r.state, r.value
    wrong = (x.errors & Fault.UNDERVOLTAGE) >> 2 | (x.errors & Fault.HOT) << 2
    word = coded(x.position, 48, 16, -POSITION_MOST, POSITION_MOST)
    word |= coded(x.velocity, 32, 16, -v[Key.V_MAX], v[Key.V_MAX])
    word |= coded(x.torque, 16, 16, -v[Key.T_MAX], v[Key.T_MAX])
    word |= int64(min(max(10.0 * v[Key.TEMPERATURE_C], 0.0), 65535.0))
    put_big(r, id_of(r, int64(Kind.FEEDBACK), (x.power << 6 | wrong) << 8), word)


@loop_function
def watch(r: Robot) -> None:
    """Do a step of (6) and (7), and fail for what is out of bounds."""
    x, v, current = r.state, r.value, r.state.torque / r.value[Key.TORQUE_CONSTANT]
    loss, before = v[Key.RESISTANCE_OHM] * current * current, x.errors
    flow = loss - (v[Key.TEMPERATURE_C] - v[Key.AMBIENT_C]) / v[Key.THERMAL_K_W]
    v[Key.TEMPERATURE_C] += flow / (v[Key.THERMAL_J_K] * r.rate_hz)  # (6)
    power = x.torque * x.velocity + loss
    v[Key.VBUS] = v[Key.SUPPLY_V] - v[Key.SUPPLY_OHM] * power / v[Key.SUPPLY_V]  # (7)
    x.errors |= Fault.HOT if v[Key.TEMPERATURE_C] > v[Key.HOT_C] else 0
    x.errors |= Fault.UNDERVOLTAGE if v[Key.VBUS] < v[Key.LOW_V] else 0
    x.errors |= Fault.OVERVOLTAGE if v[Key.VBUS] > v[Key.HIGH_V] else 0
    if x.errors != before:
        tell_faults(r)
    patience = v[Key.CANTIMEOUT] * TICK_S * r.rate_hz
    if patience > 0.0 and x.power == Power.RUN and r.k - x.fed_at > patience:
        x.power = Power.RESET
        r.mistakes[Mistake.SILENT] += 1


@loop_function
def work(r: Robot) -> int:
    """Do a cycle, to the torque."""
    x, v = r.state, r.value
    if x.boots == 0:
        boot(r)
    watch(r)
    x.torque = 0.0
    if x.errors != 0:
        x.power = Power.RESET
    if x.power != Power.RUN:
        x.integral = 0.0
        return int64(0)
    k, limit, mode = v[Key.TORQUE_CONSTANT], v[Key.LIMIT_TORQUE], int64(v[Key.RUN_MODE])
    if mode == RunMode.OPERATION:
        torque = x.stiffness * (x.target_position - x.position)
        torque += x.damping * (x.target_velocity - x.velocity) + x.target_torque  # (1)
        x.torque = min(max(torque, -limit), limit)
    elif mode == RunMode.CURRENT:
        x.torque = min(max(k * v[Key.IQ_REF], -limit), limit)  # (2)
    else:
        wanted = wanted_of(r, mode, 1.0 / r.rate_hz)
        x.torque = torque_for(r, wanted, min(limit, k * v[Key.LIMIT_CUR]))
    return int64(0)


@loop_function
def wanted_of(r: Robot, mode: int, dt: float) -> float:
    """Return the velocity that a mode with loops wants."""
    x, v = r.state, r.value
    if mode == RunMode.VELOCITY:
        x.target_velocity = v[Key.SPD_REF]
        x.way_velocity = toward(x.way_velocity, v[Key.SPD_REF], v[Key.ACC_RAD] * dt)  # (3)
        return x.way_velocity
    x.target_position = v[Key.LOC_REF]
    if mode == RunMode.PROFILE:
        follow_trapezoid(r, v[Key.VEL_MAX], v[Key.ACC_SET], v[Key.ACC_SET], 0.0)  # (4)
        return wanted_velocity(r, LARGEST)
    x.way_position, x.way_velocity = x.target_position, 0.0
    return wanted_velocity(r, v[Key.LIMIT_SPD])  # (5)


@loop_function
def speak(r: Robot) -> int:
    """Send feedback when it is due."""
    x = r.state
    every = 5e-3 * (r.value[Key.EPSCAN_TIME] + 1.0) * r.rate_hz
    if x.reports != 0 and r.k - r.sent_at[0] >= every:
        r.sent_at[0] = r.k
        feed_back(r)
    return int64(0)
