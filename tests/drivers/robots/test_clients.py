"""Clients that others wrote, unchanged, as masters of a drive that `pcpc plant` runs."""

import asyncio
import json
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest
from damiao_motor import DaMiaoController
from odrive_can.odrive import ODriveCAN
from processes import Running, own_bus, pcpc, until

from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.nodes.live import Live

pytestmark = pytest.mark.deep  # processes, each with the cycle of a drive
TEMPLATE = Path(__file__).parents[3] / "tools/make/template"


@contextmanager
def drive(kind: str, folder: Path, *words: str) -> Iterator[str]:
    """Run the drive; afterwards its log is recomputed."""
    bus, rig = own_bus(), TEMPLATE / f"drive_{kind}.yaml"
    with Running("plant", str(rig), "--bus", bus, "-o", str(folder), "--quiet", *words) as run:
        block = run.block("motor-drive", bus, "plant")
        until(lambda: block.control.passes > 10, "first cycles")
        yield bus
        run.process.send_signal(signal.SIGINT)
        assert run.done().code == 130, run
    done = pcpc("replay", str(folder))
    assert done.code == 0 and "bit-identical" in done.out, done


def settled(true: Callable[[], bool], what: str) -> None:
    until(true, what, 20.0)


def test_odrive_can_moves_it(tmp_path: Path) -> None:
    with drive("odrive", tmp_path / "run") as name:
        group, port = name.split(":")[1:]
        bus = can.Bus(group, interface="udp_multicast", port=int(port))
        asyncio.run(with_odrive(ODriveCAN(0, bus)))
        found = Live(sharing.attach(sh.block_name("motor-drive", name, "plant"))).read()
        gains = [found[f"drive.{one}_per_s"] for one in ("position_gain", "integral_gain")]
        assert gains == [33.0, 5.0], "the master's"
    log = tmp_path / "frames.log"
    assert pcpc("log", "export", str(tmp_path / "run"), "-o", str(log)).code == 0
    remote = [message for message in can.CanutilsLogReader(log) if message.is_remote_frame]
    assert [one.arbitration_id for one in remote] == [9, 23, 9] and "009#R" in log.read_text()
    known = json.loads((tmp_path / "run/drive-settings.json").read_text())["endpoints"]
    assert known["axis0.controller.config.vel_limit"]["value"] == 10.0


async def with_odrive(client: ODriveCAN) -> None:
    """Do what a client does with a new axis."""
    places: list[float] = []
    client.feedback_callback = lambda message, _: places.append(message.data["Pos_Estimate"])
    await client.start()
    client.check_alive()
    client.check_errors()
    assert client.axis_state == "IDLE"
    client.set_controller_mode("POSITION_CONTROL", "TRAP_TRAJ")
    await client.set_axis_state("CLOSED_LOOP_CONTROL")
    client.set_input_pos(1.5)
    end_s = time.monotonic() + 20.0
    while not places or abs(places[-1] - 1.5) > 0.01:
        await asyncio.sleep(0.02)
        assert time.monotonic() < end_s, places[-5:]
    found = await client.get_encoder_estimates()  # a remote frame
    assert abs(found["Pos_Estimate"] - 1.5) < 0.05, found
    voltage = await client.get_bus_voltage_current()
    assert voltage["Bus_Voltage"] == 24.0
    await client.set_axis_state("IDLE")
    client.set_pos_gain(33.0)
    client.set_vel_gains(0.5, 2.5)
    await client.get_encoder_estimates()  # they have come
    client.stop()


def test_damiao_motor_moves_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with drive("mit", tmp_path / "run") as name:
        group, port = name.split(":")[1:]
        only = [{"can_id": 0x11, "can_mask": 0x7FF}]  # the package takes its own for feedback
        monkeypatch.setenv("CAN_CONFIG", json.dumps({"port": int(port), "can_filters": only}))
        controller = DaMiaoController(group, "udp_multicast")
        try:
            motor = controller.add_motor(1, 0x11, "4310")
            motor.ensure_control_mode("MIT")
            assert motor.get_register(21) == 12.5 and motor.get_register(8) == 1
            motor.enable()
            until(lambda: motor.get_states().get("status") == "ENABLED", "it is on")

            def at(target: float) -> bool:
                motor.send_cmd_mit(target, 0.0, 0.2, 0.004, 0.0)
                return abs(motor.get_states()["pos"] - target) < 0.1

            settled(lambda: at(2.0), "its place")
            motor.write_register(10, 3)
            motor.send_cmd_vel(3.0)
            settled(
                lambda: bool(motor.send_cmd_vel(3.0)) or abs(motor.get_states()["vel"] - 3.0) < 0.2,
                "its velocity",
            )
            motor.disable()
            settled(lambda: motor.get_states()["status"] == "DISABLED", "it is off")
        finally:
            controller.shutdown()
