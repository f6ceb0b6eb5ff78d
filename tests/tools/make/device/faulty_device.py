"""The probe's device in Python with one thing wrong: `faulty_device.py WHAT BUS CYCLES RATE_HZ`."""

import os
import signal
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[4] / "plants" / "probe" / "device"))

import can
import probe

AT = 60  # the cycle from which on it is wrong


def number_in(file: Path) -> int:
    """Return the number in a file, once it is there."""
    end_s = time.monotonic() + 60.0
    while not file.exists() or not file.read_text():
        assert time.monotonic() < end_s, f"{file} was not written"
        os.sched_yield()
    return int(file.read_text())


class Faulty(probe.Device):
    """A device that is wrong in cycle AT, or in all."""

    what, k = "", 0

    def __init__(self, bus: can.BusABC) -> None:
        super().__init__(bus)
        self.commands: list[float] = []

    def law(self) -> float:
        """Return the command of this cycle, with `old=N` that of N cycles ago."""
        self.commands.append(super().law())
        age = int(self.what.removeprefix("old=")) if self.what.startswith("old=") else 0
        return self.commands[-1 - age] if age < len(self.commands) else 0.0

    def meet(self) -> None:
        if self.what not in ("greets", "greets and more"):
            super().meet()
            return
        while True:  # as a device whose own part has not begun
            self.send("HB_EXEC", nmt_state=127)
            if self.what == "greets and more":
                self.put("SYNC", 0x80, bytearray((0, 0)))
            self.hear(probe.GREET_S)

    def send_cycle(self, k: int, command: float, mode: int) -> None:
        self.k = k
        if k == AT and self.what == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        if k == AT and self.what.startswith("kills="):  # the process whose number is in a file
            os.kill(number_in(Path(self.what.partition("=")[2])), signal.SIGKILL)
            sys.exit(5)
        if k == AT and self.what == "stopped":
            os.kill(os.getpid(), signal.SIGSTOP)
        if k == AT and self.what == "again":  # as after a reset: nothing of before is known
            self.what, self.met, self.counter = "", False, -1
            self.meet()
            return
        if self.what == "late" and k > AT:
            self.send("SYNC", sequence=(k + 1) % 256)
            self.send("CMD", command=command, mode=mode, counter=k % 16)
            return
        if self.what == "never":
            self.send("SYNC", sequence=(k + 1) % 256)
            return
        super().send_cycle(k, command, mode)

    def put(self, name: str, can_id: int, data: bytearray) -> None:
        if name == "CMD" and self.k == AT:
            if self.what == "crc":
                data[-1] ^= 0x10
            if self.what == "twice":
                super().put(name, can_id, data)
            if self.what == "jump":
                data[6] ^= 8
                data[7] = probe.crc8(can_id, data[:7])
        super().put(name, can_id, data)


if __name__ == "__main__":
    with probe.open_bus(sys.argv[2]) as bus:
        device = Faulty(bus)
        device.what = sys.argv[1]
        sys.exit(device.run(int(sys.argv[3]), float(sys.argv[4])))
