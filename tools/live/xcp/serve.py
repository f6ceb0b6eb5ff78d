"""`pcpc xcp`: a running node as an XCP slave over UDP, TCP or CAN, beside its loop.

What is measured comes out of the recorder's ring, which costs the loop nothing; what is written
goes through the mailbox and is in the log as a tuning. Each master has a session of its own. One
that does not read is cut off (TCP) or loses packets, and is told by EV_DAQ_OVERLOAD.
"""

import os
import selectors
import socket
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from pcpc.drivers.can import plain_bus
from pcpc.drivers.can.bus import BusAddress, bus_named, parse
from pcpc.drivers.errors import Exit, UserError
from pcpc.drivers.machine import claim
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LiveError, level_of
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.buses import master_side, on_line, side_of
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.live.local_nodes import Nodes
from pcpc.tools.live.xcp.a2l import a2l_text, ethernet, variables_of, version
from pcpc.tools.live.xcp.commands import XcpRequest
from pcpc.tools.live.xcp.daq_rows import DaqRows
from pcpc.tools.live.xcp.on_can import IDLE_S, CanMaster, CanPlace
from pcpc.tools.live.xcp.packets import (
    ETHERNET,
    EV_DAQ_OVERLOAD,
    EV_SESSION_TERMINATED,
    EVENT,
    HEAD,
    CommandRefused,
    Err,
)
from pcpc.tools.live.xcp.slave import NodeTable, XcpSession

PORT = 5555
DAQ_S = 0.01  # between looks at what was measured: more of them cost the loop's processor time
MOST_SESSIONS, MOST_WAITING = 16, 4 << 20  # masters; bytes that one has not read
Address3 = tuple[str, str, int]  # UDP or TCP, address, port


def command(request: XcpRequest) -> int:
    """Serve a node until it ends; return the exit code. LiveError, UserError."""
    live = Nodes().find(request.node or "executive")
    if request.can:
        request.refuse("not with --can", "udp", "tcp")
        with on_bus(live) as server:
            return _until_its_end(live, server)
    udp, tcp = request.ports.udp, request.tcp
    if udp is None and tcp is None:
        udp = PORT
    ports = [
        (kind, request.ports.address, port)
        for kind, port in (("UDP", udp), ("TCP", tcp))
        if port is not None
    ]
    with XcpServer(ports) as server:
        return _until_its_end(live, server)


def _until_its_end(live: Live, server: "XcpServer") -> int:
    print("\n".join(f"{live.name}: {one}" for one in server.addresses), flush=True)
    server.serve(live)
    print(f"{live.name} has ended")
    return Exit.OK


def on_bus(live: Live) -> "XcpServer":
    """Return the slave of a running node on its bus; RigError, BusError."""
    description = live.block.description
    data = yamlfile.load("rig.yaml", description["attachments"]["rig-resolved.yaml"]).data
    data |= {"evaluation": None} | ({} if isinstance(data.get("xcp"), dict) else {"xcp": "can"})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.yaml"
        database = path.with_name(Path(data["dbc"]).name)
        data["dbc"] = database.name
        database.write_text(description["attachments"][database.name], "utf-8")
        rig = load_rig(path, text=yamlfile.dump(data), resolve=False)
        bus = bus_named(*parse(description["metadata"]["bus"]))
        return XcpServer.of_rig(rig, bus, description["node"])


def table_of(live: Live, columns: list[int], a2l: bytes) -> NodeTable:
    """Return a running node as a slave has it."""

    def read() -> tuple[int, Any]:
        try:
            now = live.read()
        except LiveError:  # it stands still in the middle of a cycle
            raise CommandRefused(Err.RESOURCE_TEMPORARY_NOT_ACCESSIBLE) from None
        return now.cycle, now.array

    def write(changes: Mapping[str, float]) -> int:
        if any(live.variables[name].range is None for name in changes):
            raise CommandRefused(Err.WRITE_PROTECTED)
        try:
            return live.tune(changes)
        except LiveError:
            if level_of(live.block) != "none":
                raise CommandRefused(Err.ACCESS_LOCKED) from None
            with suppress(LiveError):
                live.check(changes)
                raise CommandRefused(Err.RESOURCE_TEMPORARY_NOT_ACCESSIBLE) from None
            raise CommandRefused(Err.OUT_OF_RANGE) from None

    rig = str(live.block.description.get("rig"))
    return NodeTable(live.name, rig, live.period_ns, [*live.variables], columns, a2l, read, write)


class _Master:
    """A master, and what it has not got yet. `put`: sends bytes, returns how many went."""

    def __init__(self, session: XcpSession, put: Callable[[bytes], int], stream: bool) -> None:
        self.session, self._put, self._stream = session, put, stream
        self._counter, self._waiting, self._came = 0, bytearray(), bytearray()
        self.lost = False

    @property
    def wait_s(self) -> float:
        """How long there is nothing to do."""
        return DAQ_S if self.session.daq.running else IDLE_S

    def take(self, data: bytes) -> None:
        """Answer what came; ValueError: it is no message."""
        self._came += data
        while len(self._came) >= HEAD.size:
            length, _ = HEAD.unpack_from(self._came)
            if not 0 < length <= ETHERNET.cto:
                raise ValueError(f"a packet of {length} bytes")
            if len(self._came) < HEAD.size + length:
                break
            packet = bytes(self._came[HEAD.size : HEAD.size + length])
            del self._came[: HEAD.size + length]
            self.send(self.session.answers(packet))
        if not self._stream:
            self._came.clear()

    def send(self, packets: list[bytes]) -> None:
        """Send packets; ValueError: the master does not read them."""
        if self.lost:
            packets, self.lost = [bytes([EVENT, EV_DAQ_OVERLOAD]), *packets], False
        for packet in packets:
            message = HEAD.pack(len(packet), self._counter) + packet
            self._counter = (self._counter + 1) & 0xFFFF
            if self._stream:
                self._waiting += message
            elif not self._put(message):
                self.lost = True
        if self._stream:
            self.flush()
            if len(self._waiting) > MOST_WAITING:
                raise ValueError("it does not read")

    def flush(self) -> None:
        """Send on what waits."""
        while self._waiting and (count := self._put(bytes(self._waiting[: 1 << 16]))):
            del self._waiting[:count]

    def end(self) -> None:
        """Tell it that nothing follows."""
        self.send([bytes([EVENT, EV_SESSION_TERMINATED])])


def port_of(rig: Rig, role: Role) -> Address3:
    """Return where a node is served on Ethernet: one port higher than the node before it."""
    kind, _, word = str(rig.config.xcp or "udp").partition(":")
    port = int(word or PORT)
    return kind.upper(), "127.0.0.1", port and port + rig.roles.index(role)


class XcpServer:
    """Sockets of a node's slave, and its masters by connection or address."""

    def __init__(
        self, wanted: Sequence[Address3], can: CanPlace | None = None, bus: BusAddress | None = None
    ) -> None:
        """Listen, or with `can` on `bus`; UserError, BusError."""
        self._select = selectors.SelectSelector()  # microseconds, where epoll has milliseconds
        self._sockets: list[Any] = []
        self._masters: dict[Any, _Master | CanMaster] = {}
        self._ports: list[Address3] = []
        self._can = can
        if can is not None and bus is not None:
            self._sockets = [plain_bus.open_bus(bus, [can.ids[0]])]
            ids_lock = claim.hold(f"xcp/{bus}/{can.ids}")
            if ids_lock is None:
                self.close()
                raise UserError(f"{can}: another slave has these ids on {bus}; end it")
            self._sockets.append(ids_lock)
        try:
            for kind, address, port in wanted:
                self._open(kind, address, port)
        except OSError as error:
            self.close()
            what = f"{kind} {address}:{port}: {error.strerror}; give another port"
            raise UserError(what, Exit.ENVIRONMENT) from None
        except OverflowError:
            self.close()
            raise UserError(f"{kind} {address}:{port}: no such port") from None
        self.addresses = [f"XCP over {kind} on {at}:{port}" for kind, at, port in self._ports]

    @classmethod
    def of_rig(cls, rig: Rig, bus: BusAddress, role: Role) -> "XcpServer":
        """Listen where a rig with the key `xcp` says; RigError, UserError, BusError."""
        can = CanPlace.of(rig, role)
        if can is None:
            return cls([port_of(rig, role)])
        made = cls([], can, side_of(rig, bus, role if role in on_line(rig) else "executive"))
        made.addresses = [f"{can}, on {master_side(rig, bus)}"]
        return made

    def _open(self, kind: str, address: str, port: int) -> None:
        made = socket.socket(type=socket.SOCK_DGRAM if kind == "UDP" else socket.SOCK_STREAM)
        self._sockets.append(made)
        if kind == "TCP":
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((address, port))
        made.setblocking(False)
        on_data = self._datagrams
        if kind == "TCP":
            made.listen()
            on_data = self._accept
        self._select.register(made, selectors.EVENT_READ, on_data)
        self._ports.append((kind, address, made.getsockname()[1]))

    def __enter__(self) -> "XcpServer":
        return self

    def __exit__(self, *what: object) -> None:
        for key in [*self._masters]:
            with suppress(ValueError, OSError):
                self._masters[key].end()
            self._leave(key)
        self.close()

    def close(self) -> None:
        """Listen no more."""
        self._select.close()
        for one in self._sockets:
            one.close()

    def serve(self, live: Live) -> None:
        """Answer for a node until it ends."""
        os.nice(5)  # the loop and its bus go first
        description = live.block.description
        described = variables_of(description)
        rows = DaqRows(live, described)
        rig, role = str(description.get("rig")), live.name.rpartition(".")[2]
        can, link = self._can, ETHERNET if self._can is None else self._can.link
        lines = ethernet(self._ports) if can is None else can.a2l()
        text = a2l_text(rig, role, version(), live.period_ns, described, lines, link)
        self._node = table_of(live, rows.columns, text.encode())
        if can is not None:
            self._masters[can] = CanMaster(can, self._sockets[0], XcpSession(self._node, link))
        while live.running:
            wait_s = min((one.wait_s for one in self._masters.values()), default=IDLE_S)
            for key, _ in self._select.select(wait_s):
                key.data(key.fileobj)
            for key, one in [*self._masters.items()]:
                self._do_guarded(key, one.flush)
            self._send_measured(rows)
        self._send_measured(rows)

    def _send_measured(self, rows: DaqRows) -> None:
        before = rows.missed
        cycle, values = rows.take()
        for key, master in [*self._masters.items()]:
            master.lost |= rows.missed > before
            if master.session.daq.running and len(cycle):
                self._do_guarded(key, master.send, master.session.packets(cycle, values))

    def _do_guarded(self, key: Any, work: Callable[..., None], *arguments: Any) -> None:
        """Do what may end with a master's end; on CAN OSError goes on."""
        try:
            work(*arguments)
        except (ValueError, OSError):
            if key == self._can:
                raise
            self._leave(key)

    def _leave(self, key: Any) -> None:
        self._masters.pop(key, None)
        if isinstance(key, socket.socket):
            with suppress(KeyError, ValueError):
                self._select.unregister(key)
            key.close()

    # UDP

    def _datagrams(self, end: socket.socket) -> None:
        for _ in range(256):
            try:
                data, address = end.recvfrom(2048)
            except OSError:
                return
            if address not in self._masters:
                self._admit(address, partial(_sent_bytes, end.sendto, address), False)
            self._take(address, data)
            if (one := self._masters.get(address)) and not one.session.connected:
                self._leave(address)

    # TCP

    def _accept(self, end: socket.socket) -> None:
        with suppress(OSError):
            made, _ = end.accept()
            made.setblocking(False)
            made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._admit(made, partial(_sent_bytes, made.send, None), True)
            self._select.register(made, selectors.EVENT_READ, self._stream)

    def _stream(self, end: socket.socket) -> None:
        try:
            data = end.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._leave(end)
        elif end in self._masters:
            self._take(end, data)

    def _take(self, key: Any, data: bytes) -> None:
        one = self._masters[key]
        assert isinstance(one, _Master), "on CAN they come by `flush`"
        self._do_guarded(key, one.take, data)

    def _admit(self, key: Any, put: Callable[[bytes], int], stream: bool) -> None:
        """Take a new master; the one that has been there longest without measuring goes."""
        if len(self._masters) >= MOST_SESSIONS:
            idle = [one for one, it in self._masters.items() if not it.session.daq.running]
            self._leave((idle or [*self._masters])[0])
        self._masters[key] = _Master(XcpSession(self._node), put, stream)


def _sent_bytes(send: Callable[..., int], to: Any, message: bytes) -> int:
    """Return how many bytes went; OSError: the way is broken."""
    try:
        return send(message) if to is None else send(message, to)
    except (BlockingIOError, ConnectionRefusedError):
        return 0
