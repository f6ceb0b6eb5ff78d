"""What Linux says of a CAN interface: state, bit rates, queue, counters; from `ip` and /sys."""

import json
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct

from pcpc.drivers.can.bus import BusAddress
from pcpc.drivers.can.wire_layout import FRAME_BYTES
from pcpc.tools.terminal.answer import Count

_NET = Path("/sys/class/net")
_SOFTWARE = "vcan", "vxcan"  # kinds of interfaces without a controller
_OFF, _STOPPED = "BUS-OFF", "STOPPED"
_STATISTICS = ("errors", "dropped", "over_errors")


class ChannelFacts(Struct, frozen=True):
    """A channel, and what its counters gained meanwhile."""

    bus: str
    kind: str
    "of the interface: can, vcan, udp_multicast, or a name of python-can"
    driver: str
    "of the kernel; empty: none, or unknown"
    state: str
    "of the controller, as `ip` names it; empty: unknown"
    bitrate: int | None
    "bit/s; null: unknown, or none"
    data_bitrate: int | None
    "of CAN FD, bit/s; null: unknown, or none"
    fd: bool | None
    "the interface takes FD frames; null: unknown"
    queue: int | None
    "frames that may wait to be sent; null: unknown, or none"
    counters: dict[str, Count] | None
    "errors that the controller and its driver counted; null: there are none"

    @property
    def software(self) -> bool:
        """Whether it is of the kernel alone."""
        return self.kind in (*_SOFTWARE, "udp_multicast", "virtual")

    def since(self, before: "ChannelFacts") -> "ChannelFacts":
        """Return it with what its counters gained."""
        if self.counters is None or before.counters is None:
            return self
        gained = {
            name: max(count - before.counters.get(name, 0), 0)
            for name, count in self.counters.items()
        }
        fields = {name: getattr(self, name) for name in self.__struct_fields__}
        return ChannelFacts(**fields | {"counters": gained})


def channel_of(bus: BusAddress) -> ChannelFacts:
    """Return what is known of a bus."""
    if bus.interface != "socketcan":
        fd = True if bus.interface == "udp_multicast" else None
        return ChannelFacts(str(bus), bus.interface, "", "", None, None, fd, None, None)
    return interface_facts(bus.channel, _link(bus.channel))


def _link(name: str) -> Mapping[str, Any]:
    """Return what `ip` says of an interface; nothing where it cannot."""
    words = ["ip", "-json", "-details", "-statistics", "link", "show", "dev", name]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=20)
        found = json.loads(done.stdout)[0]
    except (OSError, subprocess.TimeoutExpired, ValueError, IndexError):
        return {}
    return found if isinstance(found, dict) else {}


def interface_facts(name: str, link: Mapping[str, Any]) -> ChannelFacts:
    """Return what an interface is, by the JSON of `ip -details -statistics link show`."""
    about = link.get("linkinfo", {})
    data, kind = about.get("info_data", {}), about.get("info_kind", "")
    kind = kind or (name.rstrip("0123456789") if name.startswith(_SOFTWARE) else "can")
    counters = None
    if kind not in _SOFTWARE and link:
        counters = _counters(link, about, data)
    mtu, queue = link.get("mtu") or _number(name, "mtu"), link.get("txqlen")
    return ChannelFacts(
        bus=name,
        kind=kind,
        driver=_driver(name),
        state=data.get("state", ""),
        bitrate=data.get("bittiming", {}).get("bitrate"),
        data_bitrate=data.get("data_bittiming", {}).get("bitrate"),
        fd=None if mtu is None else mtu >= FRAME_BYTES,
        queue=_number(name, "tx_queue_len") if queue is None else queue,
        counters=counters,
    )


def _counters(
    link: Mapping[str, Any], about: Mapping[str, Any], data: Mapping[str, Any]
) -> dict[str, int]:
    own = {f"{side}_error_counter": n for side, n in data.get("berr_counter", {}).items()}
    own |= {name: n for name, n in about.get("info_xstats", {}).items() if isinstance(n, int)}
    own.pop("arbitration_lost", None)  # is normal
    sides = link.get("stats64", {})
    return own | {
        f"{side}_{name}": sides[side][name]
        for side in ("rx", "tx")
        for name in _STATISTICS
        if name in sides.get(side, {})
    }


def _number(name: str, file: str) -> int | None:
    try:
        return int((_NET / name / file).read_text())
    except (OSError, ValueError):
        return None


def _driver(name: str) -> str:
    link = _NET / name / "device/driver"
    return link.resolve().name if link.exists() else ""


def is_off(channel: ChannelFacts) -> bool:
    """Return whether the controller has left the bus."""
    return channel.state in (_OFF, _STOPPED)
