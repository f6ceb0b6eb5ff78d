"""`pcpc dbc`: a DBC file from the wiring of a rig, which cantools reads and with which it runs."""

import shutil
from pathlib import Path

import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from processes import ROOT, pcpc

import pcpc as api
from pcpc.drivers.can import dbc
from pcpc.drivers.can.dbc import Protection
from pcpc.executive.errors import RigError
from pcpc.tools.dev.evidence.expected import crc16
from pcpc.tools.make.dbc import MessageLine, SignalLine, dbc_text, frames_of, resolution, rigs_of
from pcpc.tools.make.new import TEMPLATE

COUNT_RAD = 2.0 * np.pi / 2000.0


@pytest.fixture
def motor(tmp_path: Path) -> Path:
    """Return a rig file of the template, without its DBC file."""
    folder = tmp_path / "motor"
    shutil.copytree(TEMPLATE, folder, ignore=shutil.ignore_patterns("*.dbc", "__pycache__"))
    return folder / "rig.yaml"


def test_a_rig_without_a_dbc_file_gets_one_and_runs_as_before(motor: Path) -> None:
    lacking = pcpc("check", str(motor))
    assert lacking.code == 2 and "`pcpc dbc` writes one" in lacking.err, str(lacking)
    done = pcpc("dbc", "motor", cwd=motor.parents[1])
    assert done.code == 0 and max(map(len, done.out.splitlines())) <= 80, str(done)
    database = cantools.database.load_file(motor.with_name("motor.dbc"))
    names = {(m.frame_id, m.name, m.senders[0]) for m in database.messages}  # type: ignore[union-attr]
    wanted = cantools.database.load_file(TEMPLATE / "motor.dbc").messages  # type: ignore[union-attr]
    assert names == {(m.frame_id, m.name, m.senders[0]) for m in wanted}
    run = api.simulate(motor, quiet=True).check()
    shutil.copy(TEMPLATE / "motor.dbc", motor.parent)
    before = api.simulate(motor, quiet=True)
    apart = np.abs(run["plant:motor.angle_rad"] - before["plant:motor.angle_rad"]).max()
    assert apart < COUNT_RAD, f"{apart} rad apart, a count of the encoder is {COUNT_RAD}"
    assert all(node.identical for node in run.replay())


def test_with_a_crc_of_16_bits_it_runs_and_replays(motor: Path) -> None:
    done = pcpc("dbc", str(motor), "--crc", "16")
    assert done.code == 0, str(done)
    entries = dbc.frames(dbc.load(motor.with_name("motor.dbc")), "EXEC", "tx")
    found = {entry.name: (entry.crc[0], entry.dlc) for entry in entries}
    assert found == {
        "SYNC": (Protection.CRC_16, 3),
        "CMD": (Protection.CRC_16, 8),
        "HB_EXEC": (0, 1),
    }
    shown = pcpc("check", str(motor))
    assert shown.out.count("counter, crc16") == 3, str(shown)
    run = api.simulate(motor, quiet=True)
    sent = run.frames[(run.frames["name"] == "CMD") & (run.frames["sender"] == "executive")]
    assert len(sent) > 900 and all(
        int.from_bytes(row[:2], "little") == crc16(bytes(row[2:]) + b"\xa0\x00")
        for row in sent["data"]
    )
    assert all(node.identical for node in run.replay())


def test_a_file_that_is_there_stays(motor: Path) -> None:
    motor.with_name("motor.dbc").write_text("mine")
    done = pcpc("dbc", str(motor))
    assert done.code == 2 and "exists; -o FILE writes another one" in done.err, str(done)
    assert motor.with_name("motor.dbc").read_text() == "mine"


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("CMD.mode: supervisor.state", "CMD.e: controller.e_rad",
         "rig.yaml:38:5: executive.transmit.CMD.e: controller.e_rad has no range; give its port "),
        ("encoder_rad: rx.FB.encoder", "encoder_rad: rx.FB.encode",
         "nobody sends FB.encode; did you mean FB.encoder?"),
        ("CMD.voltage: controller.voltage_V", "CMD.voltage: controller.voltage",
         "no output controller.voltage; did you mean controller.voltage_V?"),
        ("encoder_rad: rx.FB.encoder", "encoder_rad: rx.FB.current",
         "controller.encoder_rad is in 'rad', what is sent as FB.current in 'A'; give both ports"),
        ("CMD.mode: supervisor.state", "CMD.crc: supervisor.state", "crc is sent without being"),
        ("CMD.mode: supervisor.state", "CMD.the mode: supervisor.state", "expected FRAME.signal"),
        ("safe: {CMD.voltage: 0.0}", "safe: {CMD.volts: 0.0}", "plant.safe.CMD.volts: nobody"),
        ("    FB.current: motor.sample_current_A",
         "\n".join(f"    FB.{name}: motor.sample_current_A" for name in "abc"),
         "4 signals, of at least 16 bits each, do not fit into 6 bytes; send some in another"),
    ],
)  # fmt: skip
def test_what_the_wiring_does_not_say_is_told_with_its_place(
    old: str, new: str, why: str, motor: Path
) -> None:
    text = motor.read_text(encoding="utf-8")
    assert old in text
    motor.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(RigError) as error:
        frames_of(rigs_of(motor))
    assert why in str(error.value) and "rig.yaml:" in str(error.value), str(error.value)


def test_a_rig_of_three_nodes_is_refused() -> None:
    with pytest.raises(RigError, match="writes files of two nodes"):
        frames_of(rigs_of(ROOT / "plants" / "telerobot" / "rigs" / "telerobot-u1.yaml"))


numbers = st.floats(-1e6, 1e6, allow_nan=False).filter(lambda x: x == 0.0 or abs(x) > 1e-6)


@given(
    ends=st.tuples(numbers, numbers).filter(lambda ends: ends[0] != ends[1]).map(sorted),
    share=st.floats(0.0, 1.0),
    nbits=st.sampled_from((16, 24, 32)),
)
def test_every_value_of_a_range_comes_back_within_half_a_quantum(
    ends: list[float], share: float, nbits: int
) -> None:
    low, high = ends
    value = min(max(low + share * (high - low), low), high)
    factor = resolution(low, high, nbits)
    signal = SignalLine("value", "", "", low, high, nbits, factor=factor)
    frame = MessageLine(0x120, "FB", "PLANT", "EXEC", 8, 0, (signal,))
    database = cantools.database.load_string(dbc_text([frame], ["EXEC", "PLANT"], 1000.0))
    data = database.encode_message("FB", {"value": value, "counter": 0, "crc": 0}, strict=False)  # type: ignore[union-attr]
    back = database.decode_message("FB", data)["value"]  # type: ignore[union-attr]
    rounding = 1e-12 * max(abs(low), abs(high))
    assert abs(back - value) <= 0.5 * factor + rounding, f"{value} came back as {back}"
    assert factor <= 5.0 * max(abs(low), abs(high)) / (2 ** (nbits - (low < 0.0)) - 1)
