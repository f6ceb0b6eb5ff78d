"""The law, laws/pid.py, as a program of its own in the executive's place, as your firmware will be.

    pcpc run device.yaml --pacing lockstep --device python device.py {bus}

It needs python-can and cantools, and nothing of pcpc:  python device.py BUS [RATE_HZ]

    BUS      vcan0, udp_multicast:239.74.163.2:43113, any INTERFACE:CHANNEL of python-can
    RATE_HZ  on a clock of its own; without it lockstep: the motor's feedback begins each cycle

Frames, counters, CRC, and who begins: docs/device.md of pcpc. Equations (1) to (5): laws/pid.py;
its (6) is for controllers that take turns. It goes on until the motor has ended. Exit code 0 then,
1 if the motor fell silent.
"""

import sys
import time
from pathlib import Path
from typing import Any, cast

import can
import cantools

DBC = Path(__file__).with_name("motor.dbc")
PERIOD_S, HEARTBEAT_EVERY = 1e-3, 100  # of rig.yaml; in cycles, of the DBC file
READY, RUN = 1, 2  # CMD.mode
NMT = {READY: 127, RUN: 5}  # heartbeats
STOPPED = 4
GREET_S, PATIENCE_S, MAX_DELTA = 0.02, 5.0, 4
STEP_RAD, STEP_AT = 3.0, 100  # the reference of rig.yaml; its cycle


class Pid:
    """The law, with the gains of rig.yaml."""

    kp_V_rad, ki_V_rads, kd_Vs_rad = 30.0, 600.0, 0.47
    weight, filter_s, u_max_V = 0.0, 0.002, 24.0

    def __init__(self) -> None:
        self.filtered_rad = self.integral_V = 0.0

    def step(self, q_d_rad: float, encoder_rad: float) -> float:
        """Return the command of a cycle, in V."""
        dt = PERIOD_S
        self.filtered_rad += dt / (self.filter_s + dt) * (encoder_rad - self.filtered_rad)
        speed_rad_s = (encoder_rad - self.filtered_rad) / self.filter_s  # (1)
        e_rad = q_d_rad - encoder_rad  # (2)
        proportional_V = self.kp_V_rad * (self.weight * q_d_rad - encoder_rad)
        wanted_V = proportional_V - self.kd_Vs_rad * speed_rad_s + self.integral_V  # (3)
        voltage_V = min(max(wanted_V, -self.u_max_V), self.u_max_V)  # (4)
        if (wanted_V - voltage_V) * e_rad <= 0.0:
            self.integral_V += dt * self.ki_V_rads * e_rad  # (5)
        return voltage_V


def crc8(can_id: int, data: bytes | bytearray) -> int:
    """Return the CRC-8 SAE J1850 over two bytes of the id, low first, and `data`."""
    crc = 0xFF
    for byte in (can_id & 0xFF, can_id >> 8 & 0xFF, *data):
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ (0x1D if crc & 0x80 else 0)) & 0xFF
    return crc ^ 0xFF


def open_bus(name: str) -> can.BusABC:
    """Open a bus as pcpc names it."""
    interface, _, channel = name.partition(":")
    if interface == "udp_multicast":
        group, _, port = channel.partition(":")
        return can.Bus(group, interface="udp_multicast", port=int(port or 43113))
    return can.Bus(channel, interface=interface) if channel else can.Bus(interface, "socketcan")


class Device:
    """The device between its start and its end."""

    def __init__(self, bus: can.BusABC) -> None:
        self.bus, self.law = bus, Pid()
        self.db = cast(Any, cantools.database.load_file(DBC))
        self.names = {message.frame_id: message.name for message in self.db.messages}
        self.met = self.done = self.fresh = False
        self.counter, self.encoder_rad = -1, 0.0

    # What it sends

    def send(self, name: str, **signals: float) -> None:
        """Send a frame, with its CRC if it has one."""
        message = self.db.get_message_by_name(name)
        protected = any(signal.name == "crc" for signal in message.signals)
        data = bytearray(message.encode(signals | ({"crc": 0} if protected else {})))
        if protected:
            data[-1] = crc8(message.frame_id, data[:-1])
        self.bus.send(can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=False))

    def send_cycle(self, k: int) -> None:
        """Compute cycle `k`, and send its frames in the contract's order."""
        mode = READY if k == 0 else RUN
        voltage_V = self.law.step(STEP_RAD if k >= STEP_AT else 0.0, self.encoder_rad)
        if k % HEARTBEAT_EVERY == 0:
            self.send("HB_EXEC", nmt_state=NMT[mode])
        self.send("CMD", voltage=voltage_V, mode=mode, counter=k % 16)
        self.send("SYNC", sequence=(k + 1) % 256)

    # What it hears

    def hear(self, within_s: float) -> bool:
        """Take one message; return False if none came in time."""
        message = self.bus.recv(within_s)
        if message is not None and not message.is_error_frame and not message.is_extended_id:
            self.take(self.names.get(message.arbitration_id, ""), message)
        return message is not None

    def take(self, name: str, message: can.Message) -> None:
        """Take a frame of the motor."""
        if name == "HB_PLANT":
            stopped = message.data[0] == STOPPED
            self.done |= self.met and stopped  # of this run: one that ended before says so, too
            self.met |= not stopped
        elif name == "FB" and crc8(message.arbitration_id, message.data[:-1]) == message.data[-1]:
            told = self.db.decode_message(name, message.data)
            counter = int(told["counter"])
            delta = (counter - self.counter) % 16 if self.counter >= 0 else 1
            self.counter = counter
            if 1 <= delta <= MAX_DELTA:
                self.encoder_rad, self.fresh = float(told["encoder"]), True

    # A run

    def meet(self) -> None:
        """Greet until the motor is there, then ask for the sample of t = 0."""
        while not self.met:
            self.send("HB_EXEC", nmt_state=NMT[READY])
            self.hear(GREET_S)
        self.send("HB_EXEC", nmt_state=NMT[READY])
        self.send("SYNC", sequence=0)

    def wait(self) -> bool:
        """Wait for the feedback of a cycle; return False if the motor ended or fell silent."""
        self.fresh = False
        while not self.fresh and not self.done:
            if not self.hear(PATIENCE_S):
                return False
        return not self.done

    def wake(self, deadline_s: float) -> bool:
        """Take what comes until a deadline; return False if the motor ended."""
        while (left_s := deadline_s - time.monotonic()) > 0.0:
            self.hear(left_s)
        while self.hear(0.0):
            pass
        return not self.done

    def run(self, rate_hz: float = 0.0) -> int:
        """Close the loop until the end; return the exit code."""
        self.meet()
        k, goes_on, begin_s = 0, self.wait(), time.monotonic()
        while goes_on:
            self.send_cycle(k)
            k += 1
            goes_on = self.wake(begin_s + k / rate_hz) if rate_hz > 0.0 else self.wait()
        return int(not self.done)


if __name__ == "__main__":
    with open_bus(sys.argv[1]) as bus:
        sys.exit(Device(bus).run(*map(float, sys.argv[2:3])))
