"""A calibration session by pyXCP, unchanged: python xcp_master.py PORT udp|tcp ROWS NAMES.

It uploads the A2L file, finds addresses in it, measures NAMES (JSON) for ROWS cycles, sets a gain
in the meantime and prints JSON.
"""

import json
import re
import struct
import sys
import threading

from pyxcp.config import create_application_from_config, set_application
from pyxcp.daq_stim import DaqList, DaqOnlinePolicy
from pyxcp.master import Master

OBJECT = re.compile(r"/begin (\w+) (\S+) \".*\"\n\s+(?:VALUE|.*\n\s+ECU_ADDRESS) (0x[0-9A-F]+)")
GAIN, VALUES = "controller.kv_Nms_rad", (101.0, 102.5, 103.25)


class Measured(DaqOnlinePolicy):
    """What came, until there are enough rows."""

    def __init__(self, lists: list[DaqList], enough: int) -> None:
        super().__init__(lists)
        self.rows: list[list[object]] = []
        self.enough, self.full = enough, threading.Event()

    def on_daq_list(self, number: int, host: int, stamp: int, values: list[float]) -> None:
        self.rows.append([stamp, [struct.pack("<d", value).hex() for value in values]])
        if len(self.rows) >= self.enough:
            self.full.set()

    def initialize(self) -> None:
        """Nothing."""

    def finalize(self) -> None:
        """Nothing."""


def session(port: int, protocol: str, rows: int, names: list[str]) -> dict[str, object]:
    ethernet = {"host": "127.0.0.1", "port": port, "protocol": protocol.upper()}
    app = create_application_from_config({"Transport": {"Eth": ethernet}}, log_level=50)
    app.transport.layer = "ETH"
    set_application(app)
    with Master("ETH", config=app) as master:
        master.connect()
        told = master.getDaqInfo()
        a2l = master.fetch(master.getId(4).length).decode()
        places = {name: (kind, int(at, 16)) for kind, name, at in OBJECT.findall(a2l)}
        master.disconnect()
    entries = [(name, places[name][1], 0, "F64") for name in names]
    lists = [DaqList("all", 0, False, True, entries, 0, 1)]
    measured = Measured(lists, rows)
    with Master("ETH", config=app, policy=measured) as master:
        master.connect()
        measured.setup()
        measured.start()
        read = []
        for value in VALUES:
            master.shortDownload(places[GAIN][1], 0, struct.pack("<d", value))
            read.append(struct.unpack("<d", master.shortUpload(8, places[GAIN][1]))[0])
        assert measured.full.wait(60)
        measured.stop()
        master.disconnect()
    return {
        "a2l": a2l, "events": told["channels"], "rows": measured.rows, "read": read,
        "places": places,
    }  # fmt: skip


if __name__ == "__main__":
    port, protocol, rows, names = sys.argv[1:]
    print(json.dumps(session(int(port), protocol, int(rows), json.loads(names)), default=str))
