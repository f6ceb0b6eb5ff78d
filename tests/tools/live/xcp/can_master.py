"""A calibration session on CAN by pyXCP, unchanged: can_master.py BUS PID ADDRESSES GAIN WRONG.

It measures the doubles at ADDRESSES (JSON) of every cycle. Once it has ROWS of them it sets the one
at GAIN, then tries to set that at WRONG. Once the run has ended it prints JSON. The slave has no
clock and is process PID, which goes on only while nothing waits for this one: all is heard.
"""

import fcntl
import json
import os
import signal
import socket
import struct
import sys
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from pyxcp.config import create_application_from_config, set_application
from pyxcp.daq_stim import DaqList
from pyxcp.events import EventHandler
from pyxcp.master import Master
from pyxcp.types import XcpResponseError, XcpTimeoutError
from xcp_master import PATIENCE_S, Measured

from pcpc.tools.live.xcp.packets import EV_SESSION_TERMINATED, EV_USER

MASTER_ID, SLAVE_ID = 0x7E0, 0x7E1
ROWS, GAIN, STARTS_S = 100, 104.5, 15.0


class Parts(Measured):
    """Doubles that are measured as two words each, since eight bytes fit into no packet."""

    def on_daq_list(self, number: int, host: int, stamp: int, words: list[int]) -> None:
        self.rows.append([stamp, struct.pack(f"<{len(words)}I", *words).hex()])
        if len(self.rows) >= self.enough:
            self.full.set()


class Ear(EventHandler):
    """The events of the slave: when what was written acts, and the end of the session."""

    def __init__(self, transport: Any) -> None:
        super().__init__(transport)
        self.cycles: list[int] = []
        self.ended = threading.Event()

    def can_handle(self, event_code: int, packet: bytes) -> bool:
        return True

    def handle(self, event_code: int, packet: bytes) -> bool:
        if event_code == EV_USER:
            self.cycles.append(int.from_bytes(packet[2:], "little"))
        elif event_code == EV_SESSION_TERMINATED:
            self.ended.set()
        return True


def download(master: Master, address: int, value: float) -> None:
    """Set a double by a block of two packets, for `Master.push` sends it as two blocks."""
    data = struct.pack("<d", value)
    master.setMta(address)
    master.download(data[:6], len(data))
    master.downloadNext(data[6:], 2, last=True)


def connect(master: Master) -> None:
    """Connect to a device that may be starting: what comes before it is on the bus is lost."""
    patience_ns, master.transport.timeout = master.transport.timeout, int(1e9 * STARTS_S)
    for _ in range(20):
        with suppress(XcpTimeoutError):
            master.connect()
            master.transport.timeout = patience_ns
            return
    raise TimeoutError("no device answers")


@contextmanager
def paced(device: int, end: int, ended: threading.Event) -> Iterator[None]:
    """Let a process run for a moment whenever a socket, which gets more room, is empty."""
    with socket.socket(fileno=os.dup(end)) as same:
        same.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)

    def pace() -> None:
        while not ended.is_set():
            if struct.unpack("i", fcntl.ioctl(end, termios.FIONREAD, bytes(4)))[0] == 0:
                os.kill(device, signal.SIGCONT)
                time.sleep(0.001)
                os.kill(device, signal.SIGSTOP)
            time.sleep(0.001)
        os.kill(device, signal.SIGCONT)

    thread = threading.Thread(target=pace)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def session(bus: str, device: int, addresses: list[int], gain: int, wrong: int) -> dict[str, Any]:
    group, port = bus.split(":")[1], int(bus.split(":")[2])
    place = {"interface": "udp_multicast", "channel": group}
    ids = {"can_id_master": MASTER_ID, "can_id_slave": SLAVE_ID}
    app = create_application_from_config({"Transport": {"CAN": place | ids}}, log_level=50)
    app.transport.layer, app.transport.can.udp_multicast.port = "CAN", port
    app.transport.timeout = 60.0
    set_application(app)
    app.general.disable_error_handling = True  # it would leave the program
    entries = [(f"{at + part}", at + part, 0, "U32") for at in addresses for part in (0, 4)]
    measured = Parts([DaqList("all", 0, False, True, entries, 0, 1)], ROWS, True)
    told: dict[str, Any] = {}
    with Master("CAN", config=app, policy=measured) as master:
        ear = master.transport.event_handler = Ear(master.transport)
        connect(master)
        master.getCommModeInfo()
        told["rig"] = master.fetch(master.getId(1).length).decode()
        told["events"] = [one["name"] for one in master.getDaqInfo()["channels"]]
        measured.setup()
        measured.start()
        end = master.transport.can_interface.can_interface.fileno()
        with paced(device, end, ear.ended):
            print("ready", flush=True)
            assert measured.full.wait(PATIENCE_S)
            download(master, gain, GAIN)
            master.setMta(gain)
            told["read"] = struct.unpack("<d", master.fetch(8))[0]
            try:
                download(master, wrong, 0.0)
            except XcpResponseError as error:
                told["refused"] = int(error.get_error_code())
            assert ear.ended.wait(PATIENCE_S)
    return told | {"rows": measured.rows, "cycles": ear.cycles}


if __name__ == "__main__":
    bus, device, addresses, gain, wrong = sys.argv[1:]
    told = session(bus, int(device), json.loads(addresses), int(gain), int(wrong))
    print(json.dumps(told, default=str))
