"""A device for the probe in plain Python, by its DBC file: the other side of docs/device.md.

    command = gain (target - position)                 gain 4, target 1, as plants/probe/rig.yaml

It needs python-can and cantools, and nothing of pcpc:  python probe.py BUS [CYCLES [RATE_HZ]]

    BUS      vcan0, udp_multicast:239.74.163.2:43113, any INTERFACE:CHANNEL of python-can
    CYCLES   after as many it stops the run; 0: it goes on until the plant has ended
    RATE_HZ  on a clock of its own; 0: lockstep, each cycle begins with the plant's feedback

Exit code 0 at the end of a run, 1 if the plant fell silent.
"""

import sys
import time
from pathlib import Path
from typing import Any, cast

import can
import cantools

DBC = Path(__file__).parents[1] / "probe.dbc"
READY, RUN, STOP = 1, 2, 5  # CMD.mode
NMT = {READY: 127, RUN: 5, STOP: 4}  # heartbeats
STOPPED, HEARTBEAT_EVERY = 4, 100  # its turn is 100 ms, in cycles of 1 kHz
GAIN, TARGET = 4.0, 1.0
GREET_S, PATIENCE_S, MAX_DELTA = 0.02, 5.0, 4


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
        self.bus = bus
        self.db = cast(Any, cantools.database.load_file(DBC))
        self.names = {message.frame_id: message.name for message in self.db.messages}
        self.met = self.done = self.fresh = False
        self.counter, self.position = -1, 0.0
        self.heartbeat_every = HEARTBEAT_EVERY

    # What it sends

    def send(self, name: str, **signals: float) -> None:
        """Send a frame, with its CRC if it has one."""
        message = self.db.get_message_by_name(name)
        protected = any(signal.name == "crc" for signal in message.signals)
        data = bytearray(message.encode(signals | ({"crc": 0} if protected else {})))
        if protected:
            data[-1] = crc8(message.frame_id, data[:-1])
        self.put(name, message.frame_id, data)

    def put(self, name: str, can_id: int, data: bytearray) -> None:
        """Put a frame on the bus."""
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def send_cycle(self, k: int, command: float, mode: int) -> None:
        """Send the frames of cycle `k` in the contract's order."""
        if k % self.heartbeat_every == 0:
            self.send("HB_EXEC", nmt_state=NMT[mode])
        self.send("CMD", command=command, mode=mode, counter=k % 16)
        self.send("SYNC", sequence=(k + 1) % 256)

    # What it hears

    def hear(self, within_s: float) -> bool:
        """Take one message; return False if none came in time."""
        message = self.bus.recv(within_s)
        if message is not None and not message.is_error_frame and not message.is_extended_id:
            self.take(self.names.get(message.arbitration_id, ""), message)
        return message is not None

    def take(self, name: str, message: can.Message) -> None:
        """Take a frame of the plant."""
        if name == "HB_PLANT":
            stopped = message.data[0] == STOPPED
            self.done |= self.met and stopped  # of this run: one that ended before says so, too
            self.met |= not stopped
        elif name == "FB" and crc8(message.arbitration_id, message.data[:-1]) == message.data[-1]:
            values = self.db.decode_message(name, message.data)
            counter = int(values["counter"])
            delta = (counter - self.counter) % 16 if self.counter >= 0 else 1
            self.counter = counter
            if 1 <= delta <= MAX_DELTA:
                self.position, self.fresh = float(values["position"]), True

    # A run

    def meet(self) -> None:
        """Greet until the plant is there, then ask for the sample of t = 0."""
        while not self.met:
            self.send("HB_EXEC", nmt_state=NMT[READY])
            self.hear(GREET_S)
        self.send("HB_EXEC", nmt_state=NMT[READY])
        self.send("SYNC", sequence=0)

    def wait(self) -> bool:
        """Wait for the feedback of a cycle; return False if the plant ended or fell silent."""
        self.fresh = False
        while not self.fresh and not self.done:
            if not self.hear(PATIENCE_S):
                return False
        return not self.done

    def wake(self, deadline_s: float) -> bool:
        """Take what comes until a deadline; return False if the plant ended."""
        while (left_s := deadline_s - time.monotonic()) > 0.0:
            self.hear(left_s)
        while self.hear(0.0):
            pass
        return not self.done

    def law(self) -> float:
        """Return the command of this cycle."""
        return GAIN * (TARGET - self.position)

    def run(self, cycles: int = 0, rate_hz: float = 0.0) -> int:
        """Close the loop until the end; return the exit code."""
        if rate_hz > 0.0:
            self.heartbeat_every = max(1, round(0.1 * rate_hz))
        self.meet()
        if rate_hz > 0.0 and not self.wait():
            return int(not self.done)
        begin_s, k = time.monotonic(), 0
        while cycles == 0 or k < cycles:
            goes_on = self.wake(begin_s + (k + 1) / rate_hz) if rate_hz > 0.0 else self.wait()
            if not goes_on:
                return int(not self.done)
            self.send_cycle(k, self.law(), READY if k == 0 else RUN)
            k += 1
        self.send_cycle(k, 0.0, STOP)
        return 0


def main(words: list[str]) -> int:
    """Run the device of a command line; return its exit code."""
    with open_bus(words[0]) as bus:
        return Device(bus).run(
            *(kind(word) for kind, word in zip((int, float), words[1:], strict=False))
        )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
