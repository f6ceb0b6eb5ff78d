"""Clients that others wrote, unchanged, as masters of a drive that `pcpc run --only plant` runs."""

import asyncio
import json
import math
import signal
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple, TypeVar

import can
import moteus
import numpy as np
import pytest
import robstride
import robstride_dynamics
from can.interfaces.udp_multicast import UdpMulticastBus
from damiao_motor import DaMiaoController
from odrive_can.odrive import ODriveCAN
from places import PATIENCE_S, ROOT
from processes import Running, own_bus, pcpc, until

from pcpc.executive.log import reader as logs
from pcpc.executive.loop import shared as sh
from pcpc.executive.loop import sharing
from pcpc.executive.nodes.live import Live

pytestmark = pytest.mark.deep  # processes, each with the cycle of a drive
TEMPLATE = ROOT / "tools/make/template"
T = TypeVar("T")


@contextmanager
def drive(kind: str, folder: Path, *words: str) -> Iterator[str]:
    """Run the drive; afterwards its log is recomputed."""
    bus, rig = own_bus(), TEMPLATE / f"drive_{kind}.yaml"
    with Running(
        "run", "--only=plant", str(rig), "--bus", bus, "-o", str(folder), "--quiet", *words
    ) as run:
        block = run.block("motor-drive", bus, "plant")
        until(lambda: block.control.passes > 10, "first cycles")
        yield bus
        run.process.send_signal(signal.SIGINT)
        assert run.done().code == 130, run
    done = pcpc("replay", str(folder))
    assert done.code == 0 and "bit-identical" in done.out, done


async def patiently(ask: Callable[[], Awaitable[T]]) -> T:
    """Ask again where the client gave up: it waits for half a second or one, and no longer."""
    end_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return await ask()
        except TimeoutError:
            assert time.monotonic() < end_s


def test_odrive_can_moves_it(tmp_path: Path) -> None:
    with drive("odrive", tmp_path / "run") as name:
        group, port = name.split(":")[1:]
        bus = can.Bus(group, interface="udp_multicast", port=int(port))
        asyncio.run(with_odrive(ODriveCAN(0, bus)))
        plant = Live(sharing.attach(sh.block_name("motor-drive", name, "plant")))
        gains = [f"drive.{one}_per_s" for one in ("position_gain", "integral_gain")]
        until(lambda: [plant.read()[one] for one in gains] == [33.0, 5.0], "the master's gains")
    log = tmp_path / "frames.log"
    assert pcpc("log", "export", str(tmp_path / "run"), "-o", str(log)).code == 0
    remote = [message for message in can.CanutilsLogReader(log) if message.is_remote_frame]
    assert {one.arbitration_id for one in remote} == {23, 9} and "009#R" in log.read_text()
    known = json.loads((tmp_path / "run/drive-settings.json").read_text())["endpoints"]
    assert known["axis0.controller.config.vel_limit"]["value"] == 10.0


async def with_odrive(client: ODriveCAN) -> None:
    """Do what a client does with a new axis."""
    places: list[float] = []
    client.feedback_callback = lambda message, _: places.append(message.data["Pos_Estimate"])
    await client.start()
    await patiently(client.wait_for_heartbeat)
    client.check_alive()
    client.check_errors()
    assert client.axis_state == "IDLE"
    client.set_controller_mode("POSITION_CONTROL", "TRAP_TRAJ")
    await patiently(lambda: client.set_axis_state("CLOSED_LOOP_CONTROL"))
    client.set_input_pos(1.5)
    end_s = time.monotonic() + PATIENCE_S
    while not places or abs(places[-1] - 1.5) > 0.01:
        await asyncio.sleep(0.02)
        assert time.monotonic() < end_s, places[-5:]
    voltage = await patiently(client.get_bus_voltage_current)  # a remote frame
    assert voltage["Bus_Voltage"] == 24.0
    found = await patiently(client.get_encoder_estimates)  # or cyclic ones, which come anyway
    assert abs(found["Pos_Estimate"] - 1.5) < 0.05, found
    await patiently(lambda: client.set_axis_state("IDLE"))
    client.set_pos_gain(33.0)
    client.set_vel_gains(0.5, 2.5)
    client.stop()


def test_damiao_motor_moves_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = ("--set", "rate_hz=200")  # it drops one frame of the plant a millisecond, not more
    with drive("mit", tmp_path / "run", *slow) as name:
        group, port = name.split(":")[1:]
        only = [{"can_id": 0x11, "can_mask": 0x7FF}]  # the package takes its own for feedback
        monkeypatch.setenv("CAN_CONFIG", json.dumps({"port": int(port), "can_filters": only}))
        controller = DaMiaoController(group, "udp_multicast")
        try:
            motor = controller.add_motor(1, 0x11, "4310")

            def is_in_mit_mode() -> bool:
                with suppress(TimeoutError):  # it waits for a second, and no longer
                    motor.ensure_control_mode("MIT")
                    return True
                return False

            until(is_in_mit_mode, "its mode")
            assert [motor.get_register(rid, PATIENCE_S) for rid in (21, 8)] == [12.5, 1]

            def is_in(status: str, ask: Callable[[], None]) -> bool:
                ask()  # it tells where it is when it is asked
                return motor.get_states().get("status") == status

            until(lambda: is_in("ENABLED", motor.enable), "it is on")

            def at(target: float) -> bool:
                motor.send_cmd_mit(target, 0.0, 0.2, 0.004, 0.0)
                return abs(motor.get_states()["pos"] - target) < 0.1

            until(lambda: at(2.0), "its place")
            motor.write_register(10, 3)
            motor.send_cmd_vel(3.0)
            until(
                lambda: bool(motor.send_cmd_vel(3.0)) or abs(motor.get_states()["vel"] - 3.0) < 0.2,
                "its velocity",
            )
            until(lambda: is_in("DISABLED", motor.disable), "it is off")
        finally:
            controller.shutdown()


class WholeIds(UdpMulticastBus):
    """As SocketCAN it takes ids that are of numpy, as one of the clients has them."""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a message."""
        msg.arbitration_id = int(msg.arbitration_id)
        super().send(msg, timeout)


@pytest.mark.parametrize("client", ["robstride", "robstride_dynamics"])
def test_robstride_moves_it(tmp_path: Path, client: str) -> None:
    host = {"robstride": 0xAA, "robstride_dynamics": 0xFF}[client]
    with drive("robstride", tmp_path / "run") as name:
        group, port = name.split(":")[1:]
        only = [{"can_id": host, "can_mask": 0xFF, "extended": True}]  # it hears its own frames
        with WholeIds(group, port=int(port), can_filters=only) as bus:
            {"robstride": with_robstride, "robstride_dynamics": with_dynamics}[client](bus)
        plant = Live(sharing.attach(sh.block_name("motor-drive", name, "plant")))
        assert plant.read()["drive.state"] == 0.0
    known = json.loads((tmp_path / "run/drive-settings.json").read_text())["endpoints"]
    assert known["limit_spd"] == {"id": 0x7017, "type": "float", "access": "rw", "value": 33.0}


def with_robstride(bus: can.BusABC) -> None:
    """Go at 3 rad/s, then to a place, with the client of that name."""
    client = robstride.Client(bus, recv_timeout=PATIENCE_S)
    client.write_param(1, "run_mode", robstride.RunMode.Speed)
    client.write_param(1, "spd_ref", 3.0)
    client.enable(1)
    until(lambda: abs(float_of(client, "mechvel") - 3.0) < 0.2, "its velocity")
    client.disable(1)
    client.write_param(1, "run_mode", robstride.RunMode.Position)
    client.enable(1)
    client.write_param(1, "loc_ref", 1.0)
    until(lambda: abs(float_of(client, "mechpos") - 1.0) < 0.02, "its place")
    assert not client.disable(1).errors and client.error_rate() == 0.0


def float_of(client: robstride.Client, name: str) -> float:
    """Return a parameter that is a number."""
    value = client.read_param(1, name)
    assert isinstance(value, float)
    return value


def with_dynamics(bus: can.BusABC) -> None:
    """Hold a place in operation mode, with the other client, whose `connect` takes SocketCAN."""
    client = robstride_dynamics.RobstrideBus("bus", {"joint": robstride_dynamics.Motor(1, "rs-01")})
    client.channel_handler = bus
    client.enable("joint")

    def at(target: float) -> bool:
        client.write_operation_frame("joint", target, 0.2, 0.004)
        return abs(client.read_operation_frame("joint")[0] - target) < 0.1

    until(lambda: at(2.0), "its place")
    assert client.read("joint", robstride_dynamics.ParameterType.VELOCITY_LIMIT) == 33.0
    client.disable("joint")
    client.channel_handler = None


class Wrong(NamedTuple):
    """A frame that a drive should not hear, what its verdict then says, by which variable."""

    kind: str
    can_id: int
    data: bytes
    said: str
    variable: str
    extended: bool = False
    fd: bool = False


MIT_ON, STATE_8, SDO = (
    bytes([255] * 7 + [0xFC]),
    bytes([8, 0, 0, 0]),
    bytes([0x40, 0x41, 0x60, *[0] * 5]),
)
ENABLE, STOP, TWIN = 0x0300_FD01, bytes([1, 0, 0]), "another sender of"
CANOPEN, FAULT = "frame to this node was CANopen's", "supervisor.fault"
WRONG = {  # the first is how the bus of lerobot (0.4.4) switches a RobStride on
    "MIT to RobStride": Wrong("robstride", 1, MIT_ON, "was MIT mode's", "drive.master.from_mit"),
    "CANopen to RobStride": Wrong("robstride", 0x601, SDO, CANOPEN, "drive.master.from_cia402"),
    "CANopen to MIT": Wrong("mit", 0x601, SDO, CANOPEN, "drive.master.from_cia402"),
    "CANopen to moteus": Wrong("moteus", 0x601, SDO, CANOPEN, "drive.master.from_cia402"),
    "ODrive to CANopen": Wrong(
        "cia402", 5 << 5 | 7, STATE_8, "an ODrive's", "drive.master.from_odrive"
    ),
    "RobStride to MIT": Wrong(
        "mit", ENABLE, bytes(8), "a RobStride's", "drive.master.from_robstride", True
    ),
    "RobStride's second": Wrong("robstride", 0x0200_01FD, bytes(8), TWIN, FAULT, True),
    "MIT's second": Wrong("mit", 0x11, bytes(8), TWIN, FAULT),
    "moteus' second": Wrong("moteus", 0x100, STOP, TWIN, FAULT, False, True),
    "ODrive's second": Wrong("odrive", 0x001, bytes(8), TWIN, FAULT),
    "CANopen's second": Wrong("cia402", 0x185, bytes(8), TWIN, FAULT),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_master_or_a_second_drive_of_its_number_is_in_the_verdict_within_a_second(
    what: str, tmp_path: Path
) -> None:
    """Of running time: from the frame's cycle in the log, or that of the first one sent."""
    one, bus, folder = WRONG[what], own_bus(), tmp_path / "run"
    rig = TEMPLATE / f"drive_{one.kind}.yaml"
    with Running("run", "--only=plant", str(rig), "--bus", bus, "-o", str(folder)) as run:
        block = run.block("motor-drive", bus, "plant")
        until(lambda: block.control.passes > 10, "first cycles")
        group, port = bus.split(":")[1:]
        message = can.Message(
            arbitration_id=one.can_id, data=one.data, is_extended_id=one.extended, is_fd=one.fd
        )
        with can.Bus(group, interface="udp_multicast", port=int(port), fd=one.fd) as sending:
            before = int(block.control.cycle)
            for _ in range(3 if one.said == TWIN else 1):
                sending.send(message)
            if one.said != TWIN:  # else it ends by itself
                plant = Live(sharing.attach(sh.block_name("motor-drive", bus, "plant")))
                until(lambda: plant.read()[one.variable] == 1.0, "it is told")
                run.process.send_signal(signal.SIGTERM)
        done = run.done()
    assert one.said in done.err and done.code == (5 if one.said == TWIN else 130), done
    log = logs.read(folder / "log.mcap").node["plant"]
    told = int(log.cycle[np.argmax(log.columns[one.variable] > 0.0)])
    assert log.columns[one.variable].any() and told - before < 1000, (before, told)


def test_moteus_moves_it(tmp_path: Path) -> None:
    with drive("moteus", tmp_path / "run") as name:
        asyncio.run(with_moteus(name))
    log = tmp_path / "frames.log"
    assert pcpc("log", "export", str(tmp_path / "run"), "-o", str(log)).code == 0
    every = list(can.CanutilsLogReader(log))
    asked = [one for one in every if one.arbitration_id in (0x8001, 0x807F)]
    told = [one for one in every if one.arbitration_id == 0x100]
    assert len(told) == len(asked) > 20 and all(one.is_extended_id for one in asked)
    assert all(one.is_fd and one.bitrate_switch for one in asked + told)
    assert not any(one.is_extended_id for one in told)
    known = json.loads((tmp_path / "run/drive-settings.json").read_text())["endpoints"]
    assert known["command.kp_scale"] == {"id": 35, "type": "float", "access": "rw", "value": 1.0}
    assert known["servo.max_current_A"]["value"] == 6.0


async def with_moteus(name: str) -> None:
    """Do what a client does with a new controller."""
    group, port = name.split(":")[1:]
    filters = [{"can_id": 0x100, "can_mask": 0x1FFFFF80}]  # on this bus it hears its own frames
    transport = moteus.PythonCan(
        interface="udp_multicast", channel=group, port=int(port), fd=True, can_filters=filters
    )
    client = moteus.Controller(id=1, transport=transport)
    try:
        end_s = time.monotonic() + PATIENCE_S
        while not (found := await transport.discover(0, source=0)):  # waits 0.2 s
            assert time.monotonic() < end_s, "nobody answers"
        assert {one.can_id for one in found} == {1}, found
        state = await client.set_stop(query=True)
        state = await client.query()
        assert state.values[moteus.Register.MODE] == moteus.Mode.STOPPED
        assert state.values[moteus.Register.VOLTAGE] == 24.0
        query = moteus.QueryResolution()
        query._extra = {moteus.Register.REGISTER_MAP_VERSION: moteus.INT32}
        state = await client.query(query_override=query)
        assert state.values[moteus.Register.REGISTER_MAP_VERSION] == 5
        await asyncio.wait_for(
            client.set_position_wait_complete(
                position=0.5, velocity_limit=2.0, accel_limit=20.0, watchdog_timeout=60.0
            ),
            PATIENCE_S,
        )
        await until_of(client, moteus.Register.POSITION, 0.5, 0.02, position=math.nan)
        await until_of(client, moteus.Register.VELOCITY, 1.0, 0.1, position=math.nan, velocity=1.0)
        await client.set_position(position=math.nan, velocity=1.0, watchdog_timeout=0.1)
        await until_of(client, moteus.Register.MODE, moteus.Mode.TIMEOUT, 0.5)
        await client.set_stop()
        state = await client.query()
        assert state.values[moteus.Register.MODE] == moteus.Mode.STOPPED
        await client.set_position(position=math.nan, velocity_limit=1.0, stop_position=2.0)
        state = await client.query()
        assert state.values[moteus.Register.MODE] == moteus.Mode.FAULT
        assert state.values[moteus.Register.FAULT] == 45
        await client.set_stop()
    finally:
        transport.close()


async def until_of(
    client: moteus.Controller, register: int, value: float, near: float, **command: float
) -> None:
    """Command until a register has a value; without a command, wait."""
    end_s = time.monotonic() + PATIENCE_S
    while True:
        if command:
            state = await client.set_position(query=True, watchdog_timeout=60.0, **command)
        else:
            state = await client.query()
        if abs(state.values[register] - value) < near:
            return
        assert time.monotonic() < end_s, state
        await asyncio.sleep(0.02)
