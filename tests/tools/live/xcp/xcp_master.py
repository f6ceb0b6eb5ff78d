"""A calibration session by pyXCP, unchanged: python xcp_master.py WHERE LAYER ROWS NAMES GAIN.

WHERE is a port for the layer udp or tcp, INTERFACE,CHANNEL,PORT,ID,ID for can or canfd. It uploads
the A2L file, finds addresses in it, measures NAMES (JSON) for ROWS cycles, sets GAIN in the
meantime and prints JSON. On classic CAN it measures halves of doubles, and sets one by a block.
"""

import json
import re
import struct
import sys
import threading
from typing import Any

from pyxcp.config import create_application_from_config, set_application
from pyxcp.daq_stim import DaqList, DaqOnlinePolicy
from pyxcp.master import Master

OBJECT = re.compile(r"/begin (\w+) (\S+) \".*\"\n\s+(?:VALUE|.*\n\s+ECU_ADDRESS) (0x[0-9A-F]+)")
PATIENCE_S = 240.0  # as in places.py, which is not on the path of a program
VALUES = 91.0, 92.5, 93.25


class Measured(DaqOnlinePolicy):
    """What came, until there are enough rows."""

    def __init__(self, lists: list[DaqList], enough: int, halves: bool) -> None:
        super().__init__(lists)
        self.halves = halves
        self.rows: list[list[object]] = []
        self.enough, self.full = enough, threading.Event()

    def on_daq_list(self, number: int, host: int, stamp: int, values: list[float]) -> None:
        if self.halves:
            data = struct.pack(f"<{len(values)}I", *map(int, values))
        else:
            data = struct.pack(f"<{len(values)}d", *values)
        self.rows.append([stamp, [data[at : at + 8].hex() for at in range(0, len(data), 8)]])
        if len(self.rows) >= self.enough:
            self.full.set()

    def initialize(self) -> None:
        """Nothing."""

    def finalize(self) -> None:
        """Nothing."""


def application(where: str, layer: str) -> Any:
    """Return pyXCP's settings, in force."""
    can = layer.startswith("can")
    ethernet = {} if can else {"host": "127.0.0.1", "port": int(where), "protocol": layer.upper()}
    app = create_application_from_config({"Transport": {"Eth": ethernet}}, log_level=50)
    app.transport.layer, app.transport.timeout = "CAN" if can else "ETH", 20.0
    if can:
        bus = app.transport.can
        bus.interface, bus.channel, port, down, up = where.split(",")
        bus.can_id_master, bus.can_id_slave = int(down, 16), int(up, 16)
        bus.fd, bus.max_dlc_required = layer == "canfd", layer == "can"
        if bus.interface == "udp_multicast":
            bus.udp_multicast.port = int(port)
    set_application(app)
    return app


def session(where: str, layer: str, rows: int, names: list[str], gain: str) -> dict[str, object]:
    app = application(where, layer)
    with Master(app.transport.layer, config=app) as master:
        master.connect()
        master.getCommModeInfo()
        told = master.getDaqInfo()
        a2l = master.fetch(master.getId(4).length).decode()
        places = {name: (kind, int(at, 16)) for kind, name, at in OBJECT.findall(a2l)}
        master.disconnect()
    classic = layer == "can"
    parts = [(0, "U32"), (4, "U32")] if classic else [(0, "F64")]
    entries = [(f"{n}+{at}", places[n][1] + at, 0, kind) for n in names for at, kind in parts]
    lists = [DaqList("all", 0, False, True, entries, 0, 1)]
    measured = Measured(lists, rows, classic)
    with Master(app.transport.layer, config=app, policy=measured) as master:
        master.connect()
        measured.setup()
        measured.start()
        read = []
        for value in VALUES:
            data = struct.pack("<d", value)
            if classic:
                master.setMta(places[gain][1])
                master.download(data[:6], 8)
                master.downloadNext(data[6:], 2, last=True)
            else:
                master.shortDownload(places[gain][1], 0, data)
            master.setMta(places[gain][1])
            read.append(struct.unpack("<d", master.upload(8)[:8])[0])
        assert measured.full.wait(PATIENCE_S)
        measured.stop()
        master.disconnect()
    return {
        "a2l": a2l, "events": told["channels"], "rows": measured.rows, "read": read,
        "places": places,
    }  # fmt: skip


if __name__ == "__main__":
    where, layer, rows, names, gain = sys.argv[1:]
    print(json.dumps(session(where, layer, int(rows), json.loads(names), gain), default=str))
