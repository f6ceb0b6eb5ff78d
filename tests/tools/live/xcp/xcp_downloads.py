"""Downloads in one session of pyXCP over TCP: python xcp_downloads.py PORT ADDRESSES VALUES.

It prints a list of the first cycles that the event packets told, one a download, in their order.
A download that is refused or not answered ends it with an error. ADDRESSES take turns; JSON.
"""

import json
import struct
import sys
import threading

from pyxcp.config import create_application_from_config, set_application
from pyxcp.master import Master
from xcp_master import PATIENCE_S


class Told:
    """The cycles of EV_USER, in the place of pyXCP's chain of handlers."""

    def __init__(self, enough: int) -> None:
        self.cycles: list[int] = []
        self.enough, self.all = enough, threading.Event()

    def process(self, code: int, packet: bytes) -> bool:
        if code == 0xFE:
            self.cycles.append(struct.unpack("<Q", bytes(packet[2:]))[0])
            if len(self.cycles) == self.enough:
                self.all.set()
        return code == 0xFE


def session(port: int, addresses: list[int], values: list[float]) -> list[int]:
    ethernet = {"host": "127.0.0.1", "port": port, "protocol": "TCP"}
    app = create_application_from_config({"Transport": {"Eth": ethernet}}, log_level=50)
    app.transport.layer = "ETH"
    set_application(app)
    with Master("ETH", config=app) as master:
        master.transport.event_handler = told = Told(len(values))
        master.connect()
        for number, value in enumerate(values):
            address = addresses[number % len(addresses)]
            master.shortDownload(address, 0, struct.pack("<d", value))
            (read,) = struct.unpack("<d", master.shortUpload(8, address))
            assert read == value, f"download {number}: {read} instead of {value}"
        assert told.all.wait(PATIENCE_S), f"{len(told.cycles)} of {len(values)} events"
        master.disconnect()
    return told.cycles


if __name__ == "__main__":
    print(json.dumps(session(int(sys.argv[1]), *map(json.loads, sys.argv[2:]))))
