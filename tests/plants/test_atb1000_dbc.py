"""The wire contract of ATB1000: complete, consistent, readable by common tools, within the bus."""

import math
import subprocess
import sys

import pytest
from places import ROOT

from pcpc.drivers.can import dbc

PATH = ROOT / "plants/atb1000/atb1000.dbc"
DATABASE = dbc.load(PATH)
FRAMES = {message.name: dbc.frame(message) for message in DATABASE.messages}
UNITS = {"rad", "rad/s", "N m", "ue", "V", "degC", "us", ""}

# name: id, dlc, sender, cycle in ms (0: every cycle)
FRAME_SET = {
    "SYNC": (0x080, 2, "EXEC", 0), "CMD": (0x0A0, 8, "EXEC", 0), "FB_A": (0x120, 8, "PLANT", 0),
    "FB_B": (0x121, 8, "PLANT", 0), "FB_C": (0x122, 8, "PLANT", 0), "REF": (0x200, 8, "EXEC", 10),
    "CTL": (0x201, 8, "EXEC", 10), "MOTPOS": (0x202, 8, "PLANT", 10),
    "DRV": (0x203, 8, "PLANT", 10), "PARAM": (0x600, 8, "EXEC", 100),
    "EVENT": (0x610, 8, "EXEC", 100), "STAT": (0x620, 8, "EXEC", 100),
    "HB_EXEC": (0x701, 1, "EXEC", 100), "HB_PLANT": (0x702, 1, "PLANT", 100),
}  # fmt: skip


def test_the_frame_set_is_complete() -> None:
    got = {
        message.name: (
            message.frame_id, message.length, *message.senders, FRAMES[message.name].cycle_ms,
        )
        for message in DATABASE.messages
    }  # fmt: skip
    assert got == FRAME_SET, f"{got}"


def test_each_node_receives_what_the_other_sends_for_it() -> None:
    executive = [entry.name for entry in dbc.frames(DATABASE, "EXEC", "rx")]
    plant = [entry.name for entry in dbc.frames(DATABASE, "PLANT", "rx")]
    assert executive == ["FB_A", "FB_B", "FB_C", "MOTPOS", "DRV", "HB_PLANT"], f"{executive}"
    assert plant == ["SYNC", "CMD", "HB_EXEC"], f"{plant}"


def test_all_but_parameters_events_statistics_and_heartbeats_are_protected() -> None:
    got = {name for name, entry in FRAMES.items() if not entry.protected}
    assert got == {"PARAM", "EVENT", "STAT", "HB_EXEC", "HB_PLANT"}, f"{got}"
    assert [n for n, entry in FRAMES.items() if entry.has_sequence] == ["SYNC"]


def test_every_frame_and_signal_has_a_meaning_and_a_known_unit() -> None:
    bare = [m.name for m in DATABASE.messages if not m.comment]
    bare += [f"{m.name}.{s.name}" for m in DATABASE.messages for s in m.signals if not s.comment]
    assert not bare, f"without comment: {bare}"
    units = {s.unit or "" for m in DATABASE.messages for s in m.signals}
    assert units == UNITS, f"{units}"


def test_limits_are_the_full_raw_range_scaled() -> None:
    for name, entry in FRAMES.items():
        for s in entry.signals:
            low = -(1 << (s.nbits - 1)) if s.signed else 0
            full: tuple[float, float] = (low, low + (1 << s.nbits) - 1)
            if s.is_float:
                full = (-3.4028234663852886e38, 3.4028234663852886e38)
            assert s.codes == full, f"{name}.{s.name}: {s.codes}, not {full}"
            error = max(abs(s.low - full[0] * s.factor), abs(s.high - full[1] * s.factor))
            assert error <= 1e-6 * s.factor, f"{name}.{s.name}: limits off by {error}"


def test_angles_are_exact_fractions_of_a_turn() -> None:
    factors = {s.name: s.factor for entry in FRAMES.values() for s in entry.signals}
    assert factors["encoder"] == 2 * math.pi / 2**18, f"{factors['encoder']!r}"
    assert factors["motor_angle"] == 2 * math.pi / 4096, f"{factors['motor_angle']!r}"


def test_value_tables_name_the_states() -> None:
    mode = {s.name: s for s in FRAMES["CMD"].signals}["mode"].choices
    assert list(mode.values()) == ["INIT", "READY", "RUN", "HOLD", "FAULT", "STOP"], f"{mode}"
    nmt = FRAMES["HB_PLANT"].signals[0].choices
    assert list(nmt) == [0, 4, 5, 127] and nmt == FRAMES["HB_EXEC"].signals[0].choices, f"{nmt}"


@pytest.mark.parametrize(
    ("rate_hz", "percent"),
    [(500, 36.7), (1000, 67.4), (1200, 79.7), (1500, 98.2), (2000, 128.9), (4000, 251.9)],
)
def test_worst_case_load_at_1_mbit_per_s(rate_hz: int, percent: float) -> None:
    got = 100 * dbc.bus_load(DATABASE, rate_hz, 1e6)
    assert abs(got - percent) <= 0.05, f"{got:.2f} % at {rate_hz} Hz, not {percent} %"


def test_cantools_on_the_command_line_dumps_and_decodes() -> None:
    def cantools(*arguments: str, text: str = "") -> str:
        command = [sys.executable, "-m", "cantools", *arguments]
        return subprocess.run(
            command, input=text, capture_output=True, text=True, check=True
        ).stdout

    dumped = cantools("dump", str(PATH))
    missing = [name for name in FRAME_SET if name not in dumped]
    assert not missing, f"not in the dump: {missing}"
    line = "  vcan0  0A0   [8]  10 27 D4 FE D0 27 00 00\n"
    decoded = cantools("decode", "--single-line", str(PATH), text=line)
    for part in ("motor_torque: 1.0 N m", "tau_des: -3.0 N m", "torque_limit: 2.0 N m", "RUN"):
        assert part in decoded, decoded
