"""A minute of motion by each master that others wrote, unchanged; its log is recomputed to the bit.

Each goes forward and back in turn: at a velocity, or, in RobStride's operation mode, to a place.
"""

import asyncio
import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import NamedTuple

import can
import canopen
import moteus
import numpy as np
import pytest
import robstride
import robstride_dynamics
from canopen.profiles.p402 import BaseNode402
from damiao_motor import DaMiaoController
from odrive_can.odrive import ODriveCAN
from places import PATIENCE_S
from processes import until
from test_clients import WholeIds, drive, float_of, patiently

from pcpc.executive.log import reader as logs
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing

pytestmark = pytest.mark.deep  # a minute each
MINUTE_S, HELD_S = 60.0, 1.0
Go = Callable[[float], float]  # commands a share of the size, returns what is measured


class Master(NamedTuple):
    """A package: what connects it to a bus and a run's folder, of which drive, how far it goes."""

    connected: Callable[[str, Path], AbstractContextManager[Go]]
    kind: str
    size: float  # rad/s or rad, of an ODrive and a moteus turns/s
    words: tuple[str, ...] = ()
    moved: str = "motor.speed_rad_s"


@contextmanager
def by_canopen(name: str, folder: Path) -> Iterator[Go]:
    group, port = name.split(":")[1:]
    network = canopen.Network()
    network.connect(
        interface="udp_multicast", channel=group, port=int(port),
        can_filters=[{"can_id": 0x080, "can_mask": 0x080}, {"can_id": 0x700, "can_mask": 0x780}],
    )  # fmt: skip
    node = network.add_node(BaseNode402(5, str(folder / "drive.eds")))
    node.nmt.state = "OPERATIONAL"
    node.setup_402_state_machine()
    node.op_mode = "PROFILED VELOCITY"
    node.sdo[0x60FF].raw = 0
    node.state = "OPERATION ENABLED"

    def go(share: float) -> float:
        node.sdo[0x60FF].raw = round(3000 * share)
        return float(node.sdo[0x606C].raw) / 1000.0

    try:
        yield go
    finally:
        network.disconnect()


@contextmanager
def by_odrive_can(name: str, _: Path) -> Iterator[Go]:
    group, port = name.split(":")[1:]
    with asyncio.Runner() as runner:
        client = ODriveCAN(0, can.Bus(group, interface="udp_multicast", port=int(port)))
        told: dict[str, float] = {}
        client.feedback_callback = lambda message, _: told.update(message.data)

        async def begin() -> None:
            await client.start()
            await patiently(client.wait_for_heartbeat)
            client.set_controller_mode("VELOCITY_CONTROL", "PASSTHROUGH")
            await patiently(lambda: client.set_axis_state("CLOSED_LOOP_CONTROL"))

        async def step(share: float) -> float:
            client.set_input_vel(0.5 * share)
            await asyncio.sleep(0.02)  # cyclic messages come; it takes them for answers, too
            return told.get("Vel_Estimate", math.inf)

        runner.run(begin())
        yield lambda share: runner.run(step(share))
        client.stop()


@contextmanager
def by_damiao(name: str, _: Path) -> Iterator[Go]:
    group, port = name.split(":")[1:]
    with pytest.MonkeyPatch.context() as patch:
        only = [{"can_id": 0x11, "can_mask": 0x7FF}]
        patch.setenv("CAN_CONFIG", json.dumps({"port": int(port), "can_filters": only}))
        controller = DaMiaoController(group, "udp_multicast")
    try:
        motor = controller.add_motor(1, 0x11, "4310")
        motor.write_register(10, 3)

        def go(share: float) -> float:
            motor.enable()
            motor.send_cmd_vel(3.0 * share)
            return float(motor.get_states().get("vel", math.inf))

        yield go
    finally:
        controller.shutdown()


@contextmanager
def by_moteus(name: str, _: Path) -> Iterator[Go]:
    group, port = name.split(":")[1:]
    transport = moteus.PythonCan(
        interface="udp_multicast", channel=group, port=int(port), fd=True,
        can_filters=[{"can_id": 0x100, "can_mask": 0x1FFFFF80}],
    )  # fmt: skip
    client = moteus.Controller(id=1, transport=transport)

    async def step(share: float) -> float:
        state = await asyncio.wait_for(
            client.set_position(
                position=math.nan, velocity=0.5 * share, watchdog_timeout=60.0, query=True
            ),
            PATIENCE_S,
        )
        return float(state.values[moteus.Register.VELOCITY])

    with asyncio.Runner() as runner:
        yield lambda share: runner.run(step(share))
        transport.close()


@contextmanager
def on_robstride(name: str) -> Iterator[can.BusABC]:
    group, port = name.split(":")[1:]
    hosts = [{"can_id": one, "can_mask": 0xFF, "extended": True} for one in (0xAA, 0xFF)]
    with WholeIds(group, port=int(port), can_filters=hosts) as bus:
        yield bus


@contextmanager
def by_robstride(name: str, _: Path) -> Iterator[Go]:
    with on_robstride(name) as bus:
        client = robstride.Client(bus, recv_timeout=PATIENCE_S)
        client.write_param(1, "run_mode", robstride.RunMode.Speed)
        client.enable(1)

        def go(share: float) -> float:
            client.write_param(1, "spd_ref", 3.0 * share)
            return float_of(client, "mechvel")

        yield go
        client.disable(1)


@contextmanager
def by_dynamics(name: str, _: Path) -> Iterator[Go]:
    with on_robstride(name) as bus:
        client = robstride_dynamics.RobstrideBus(
            "bus", {"joint": robstride_dynamics.Motor(1, "rs-01")}
        )
        client.channel_handler = bus
        client.enable("joint")

        def go(share: float) -> float:
            client.write_operation_frame("joint", 2.0 * share, 0.2, 0.004)
            return float(client.read_operation_frame("joint")[0])

        yield go
        client.disable("joint")
        client.channel_handler = None


MASTERS = {
    "canopen": Master(by_canopen, "cia402", 3.0),
    "odrive-can": Master(by_odrive_can, "odrive", 0.5),
    "damiao-motor": Master(by_damiao, "mit", 3.0, ("--set", "rate_hz=200")),  # it drops frames
    "moteus": Master(by_moteus, "moteus", 0.5),
    "robstride": Master(by_robstride, "robstride", 3.0),
    "robstride-dynamics": Master(by_dynamics, "robstride", 2.0, moved="motor.angle_rad"),
}


@pytest.mark.parametrize("package", MASTERS)
def test_a_minute_of_motion_is_recomputed(package: str, tmp_path: Path) -> None:
    one, folder = MASTERS[package], tmp_path / "run"
    with drive(one.kind, folder, *one.words) as name:
        control = sharing.attach(sh.block_name("motor-drive", name, "plant")).control
        rate_hz = 200.0 if one.words else 1000.0
        with one.connected(name, folder) as go:
            begin = int(control.cycle)
            while int(control.cycle) - begin < MINUTE_S * rate_hz:
                for share in (1.0, -1.0):
                    near = 0.2 * one.size
                    until(lambda: abs(go(share) - share * one.size) < near, f"{share}")  # noqa: B023
                    end_s = time.monotonic() + HELD_S
                    while time.monotonic() < end_s:
                        go(share)
                        time.sleep(0.02)
    plant = logs.read(folder / "log.mcap").node["plant"]
    moved = plant.columns[one.moved]
    assert plant.cycle[-1] - plant.cycle[0] >= MINUTE_S * rate_hz
    turns = np.count_nonzero(np.diff(np.sign(moved[np.abs(moved) > 0.5])))
    assert turns > 10, f"{turns} turns in a minute"
