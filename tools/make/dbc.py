"""`pcpc dbc RIG`: the DBC file of a rig of two nodes, written from its wiring.

    FRAME.signal of `transmit`     a signal of that frame, from the node that says so to the other
    supervisor.state               as `mode` of 4 bits; supervisor.nmt alone in a frame: a heartbeat
    range                          of `limits` if the signal has them, else of the port that is sent
    bits                           32, 24 or 16, the most with which the frame's signals fit into 6
                                   bytes, counter and crc behind them; with a crc of 16 bits 20,
                                   too, and into 5, behind crc and counter
    resolution                     the smallest of 1, 2, 5 times a power of ten with that range,
                                   offset 0: 0 is exactly 0

SYNC 0x080, frames of every cycle from 0x0A0 (executive) and 0x120 (plant) on, heartbeats 0x701 and
0x702. The wiring of all controllers of the rig counts.
"""

import math
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pcpc.executive.log.signals  # noqa: F401  tables may be signals of a log
from pcpc.drivers.can import dbc
from pcpc.drivers.canopen.layout import Heartbeat
from pcpc.drivers.errors import Exit, printable
from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.laws.block import Port
from pcpc.executive.loop.states import State
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.reading import NodeSpec, Rig, load_rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.make.commands import DbcRequest
from pcpc.tools.start.settings import settings
from pcpc.tools.terminal import screen
from pcpc.tools.terminal.outfile import new_file

_CODES: dict[str, tuple[int, dict[int, str]]] = {  # bits and names of what the loop has to say
    "supervisor.state": (4, {int(one): one.name for one in State}),
    "supervisor.nmt": (8, {int(one): one.name for one in Heartbeat}),
    "supervisor.status_word": (16, {}),
    "supervisor.error_code": (16, {}),
    "supervisor.error_register": (8, {}),
}
_OWN = ("counter", "crc", "sequence")  # the loop's
_PAYLOAD = {  # by bits of the crc: first and number of the others' bits, and each one's
    8: (0, 48, (32, 24, 16)),
    16: (24, 40, (32, 24, 20, 16)),
}
_FIRST_ID: dict[Role, int] = {"executive": 0x0A0, "plant": 0x120}
_HEARTBEAT: dict[Role, int] = {"executive": 0x701, "plant": 0x702}
_NAME = re.compile(r"[A-Za-z_]\w{0,31}", re.ASCII)  # of a DBC's frame or signal
_HEAD = """VERSION "1"

NS_ :
	CM_
	BA_DEF_
	BA_
	VAL_
	BA_DEF_DEF_

BS_:
"""
_ATTRIBUTES = """BA_DEF_ "BusType" STRING ;
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "GenMsgSendType" ENUM "EveryCycle","Cyclic";
BA_DEF_DEF_ "BusType" "CAN";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "GenMsgSendType" "Cyclic";
BA_ "BusType" "CAN";"""


@dataclass(frozen=True)
class SignalLine:
    """One line SG_; `start` and `nbits` as in a DBC, little endian."""

    name: str
    unit: str
    help: str
    low: float
    high: float
    nbits: int = 0  # until it is placed, if it has no codes
    start: int = 0
    factor: float = 1.0
    codes: tuple[tuple[int, str], ...] = ()

    @property
    def signed(self) -> bool:
        """Whether it has negative values."""
        return self.low < 0.0


@dataclass(frozen=True)
class MessageLine:
    """One message; `every_ms` 0 for every cycle, then protected."""

    can_id: int
    name: str
    sender: str
    receiver: str
    nbytes: int
    every_ms: int
    signals: tuple[SignalLine, ...]
    crc_bits: int = 8


def command(request: DbcRequest) -> int:
    """Write the file and say what is in it."""
    document = yamlfile.load(request.rig)
    given = document.place(("dbc",)).folder / str(document.data.get("dbc", "rig.dbc"))
    target = Path(request.output or given)
    rigs = rigs_of(Path(request.rig))
    frames = frames_of(rigs, request.crc)
    nodes = [node.name for node in rigs[0].nodes().values()]
    text = dbc_text(frames, nodes, rigs[0].config.rate_hz)
    dbc.parse(target, text, strict=True)
    with new_file(target, force=False, cure="-o FILE writes another one") as unfinished:
        unfinished.write_text(text, encoding="utf-8")
    print(f"{yamlfile.display_path(target)}: {len(frames)} frames")
    print(
        "\n".join(
            screen.table(
                [
                    (
                        f"  0x{frame.can_id:03X}",
                        frame.name,
                        frame.sender,
                        ", ".join(map(_signal_text, frame.signals)),
                    )
                    for frame in frames
                ]
            )
        )
    )
    return Exit.OK


def _signal_text(signal: SignalLine) -> str:
    if signal.codes or signal.name in _OWN:
        return signal.name
    return f"{signal.name} {signal.factor:g} {signal.unit}".rstrip()


def rigs_of(path: Path) -> list[Rig]:
    """Return the rig with each of its controllers, whatever its DBC file is; RigError."""
    with tempfile.NamedTemporaryFile(suffix=".dbc") as empty:  # nobody reads it
        words = settings({"dbc": empty.name})
        first = load_rig(path, None, words)
        others = [name for name in first.config.controllers if name != first.config.controller]
        return [first, *(load_rig(path, name, words) for name in others)]


def frames_of(rigs: list[Rig], crc_bits: int = 8) -> list[MessageLine]:
    """Return the frames of a rig, by id; RigError for what the wiring does not say."""
    rig = rigs[0]
    if rig.config.local is not None:
        raise rig.error("local", "`pcpc dbc` writes files of two nodes; write that of three")
    names = {role: rig.nodes()[role].name for role in rig.roles}
    sync = MessageLine(
        0x080,
        "SYNC",
        names["executive"],
        names["plant"],
        1 + crc_bits // 8,
        0,
        (
            SignalLine(
                "sequence", "", "Cycle number modulo 256.", 0.0, 255.0, 8, 16 * (crc_bits > 8)
            ),
        ),
        crc_bits,
    )
    frames = [sync]
    ends: tuple[tuple[Role, Role], ...] = (("executive", "plant"), ("plant", "executive"))
    for role, other in ends:
        sent: dict[str, SignalLine] = {}
        for one in rigs:
            _add_sent(sent, one, role)
        for one in rigs:
            _check_received(one, other, sent)
        frames += _frames(rig, role, sent, names[role], names[other], crc_bits)
    return sorted(frames, key=lambda frame: frame.can_id)


def _add_sent(sent: dict[str, SignalLine], rig: Rig, role: Role) -> None:
    """Add the signals that a node sends under a controller; of equal names the wider range."""
    node = rig.nodes()[role]
    for name, source in node.transmit.items():
        signal, known = _signal(rig, role, node, name, source), sent.get(name)
        if known is not None and known.unit != signal.unit:
            what = f"'{signal.unit}' where another controller sends '{known.unit}'"
            raise rig.error(f"{role}.transmit.{name}", what)
        if known is not None:
            low, high = min(known.low, signal.low), max(known.high, signal.high)
            signal = replace(known, low=low, high=high)
        sent[name] = signal


def _signal(rig: Rig, role: Role, node: NodeSpec, name: str, source: str) -> SignalLine:
    """Return the signal FRAME.signal that a node sends."""
    at, (frame, _, short) = f"{role}.transmit.{name}", name.partition(".")
    if not (_NAME.fullmatch(frame) and _NAME.fullmatch(short)):
        raise rig.error(at, "expected FRAME.signal, each of at most 32 letters, digits and _")
    if short in _OWN or frame == "SYNC":
        raise rig.error(at, f"{short if short in _OWN else frame} is sent without being wired")
    if source in _CODES:
        nbits, codes = _CODES[source]
        highest = float((1 << nbits) - 1)
        return SignalLine(short, "", source, 0.0, highest, nbits, codes=tuple(codes.items()))
    ports = _ports(node)
    rig.known(at, source, [*ports, *_CODES], "output")
    port, limit = ports[source], node.limits.get(name)
    low, high = port.low, port.high
    if limit is not None:
        low, high = max(low, limit.low), min(high, limit.high)
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        cure = f"give its port low and high, as port({port.unit!r}, ..., low=-10.0, high=10.0)"
        cure += f", or {name} bounds in executive.limits" * (role == "executive")
        raise rig.error(at, f"{source} has no range; {cure}")
    return SignalLine(short, port.unit, port.help, low, high)


def _ports(node: NodeSpec) -> dict[str, Port]:
    """Return what the blocks of a node compute, by the names of the elements."""
    return {
        f"{spec.name}.{name}": port
        for spec in node.blocks
        for port in (*spec.block.outputs, *spec.block.states)
        for name in port.names()
    }


def _check_received(rig: Rig, role: Role, sent: dict[str, SignalLine]) -> None:
    """Refuse inputs and safe values of signals that the other node does not send so."""
    node = rig.nodes()[role]
    wanted = {f"{role}.safe.{name}": name for name in node.safe}
    places = {at: rig.where(at) for at in wanted}
    units: dict[str, str] = {}
    for spec in node.blocks:
        ports = {name: port for port in spec.block.inputs for name in port.names()}
        for name, source in spec.inputs.items():
            if source.startswith("rx."):
                at = f"{spec.name}.{name}"
                wanted[at], places[at] = source[3:], spec.where(f"inputs.{name}")
                units |= {at: ports[name].unit} if name in ports else {}
    for at, name in wanted.items():
        if name not in sent:
            raise RigError(
                f"{places[at]}: {at}: nobody sends {name}{did_you_mean(name, sent)}; add it to "
                "transmit of the other node"
            )
        unit = sent[name].unit
        if units.get(at, unit) != unit:
            raise RigError(
                f"{places[at]}: {at} is in {units[at] or '1'!r}, what is sent as {name} in "
                f"{unit or '1'!r}; give both ports the same unit: nothing is converted"
            )


def _frames(
    rig: Rig, role: Role, sent: dict[str, SignalLine], sender: str, receiver: str, crc_bits: int
) -> Iterator[MessageLine]:
    """Yield the frames of a node; RigError if one has more signals than fit."""
    grouped: dict[str, list[SignalLine]] = {}
    for name, signal in sent.items():
        grouped.setdefault(name.partition(".")[0], []).append(signal)
    number, beats = 0, 0
    for name, signals in grouped.items():
        if all(signal.help == "supervisor.nmt" for signal in signals):
            beats += 1
            if beats > 1 or len(signals) > 1:
                raise rig.error(f"{role}.transmit", "a node has one heartbeat, of one signal")
            yield MessageLine(_HEARTBEAT[role], name, sender, receiver, 1, 100, tuple(signals))
            continue
        placed = _placed_signals(
            rig, f"{role}.transmit.{name}.{signals[0].name}", signals, crc_bits
        )
        yield MessageLine(_FIRST_ID[role] + number, name, sender, receiver, 8, 0, placed, crc_bits)
        number += 1


def _placed_signals(
    rig: Rig, at: str, signals: list[SignalLine], crc_bits: int
) -> tuple[SignalLine, ...]:
    """Return the signals of a frame with bits and resolution, those with codes last."""
    start, most, widths = _PAYLOAD[crc_bits]
    free = most - sum(signal.nbits for signal in signals)
    ranged = [signal for signal in signals if not signal.codes]
    fitting = [width for width in widths if width * len(ranged) <= free]
    if not fitting:
        room = f"{most // 8} bytes"
        what = f"{len(signals)} signals, of at least 16 bits each, do not fit into {room}"
        raise rig.error(at, f"{what}; send some in another frame")
    found = []
    for signal in (*ranged, *(signal for signal in signals if signal.codes)):
        nbits = signal.nbits or fitting[0]
        factor = 1.0 if signal.codes else resolution(signal.low, signal.high, nbits)
        found.append(replace(signal, start=start, nbits=nbits, factor=factor))
        start += nbits
    return tuple(found)


def resolution(low: float, high: float, nbits: int) -> float:
    """Return the smallest of 1, 2, 5 times a power of ten with which `nbits` hold the range."""
    steps = (1 << nbits - (low < 0.0)) - 1
    least = max(abs(low), abs(high)) / steps
    power = math.floor(math.log10(least))
    return next(
        factor
        for factor in (float(f"{m}e{e}") for e in (power, power + 1) for m in (1, 2, 5))
        if factor >= least
    )


def dbc_text(frames: list[MessageLine], nodes: list[str], rate_hz: float) -> str:
    """Return the text of a DBC file."""
    lines = [_HEAD, f"BU_: {' '.join(nodes)}", ""]
    for frame in frames:
        lines += [f"BO_ {frame.can_id} {frame.name}: {frame.nbytes} {frame.sender}"]
        lines += [_sg(signal, frame.receiver) for signal in (*frame.signals, *_tail(frame))]
        lines.append("")
    for frame in frames:
        for signal in frame.signals:
            lines.append(f'CM_ SG_ {frame.can_id} {signal.name} "{_comment(signal.help)}";')
    lines += ["", _ATTRIBUTES]
    cycle_ms = max(1, round(1000.0 / rate_hz))
    for frame in frames:
        lines.append(f'BA_ "GenMsgCycleTime" BO_ {frame.can_id} {frame.every_ms or cycle_ms};')
        lines.append(f'BA_ "GenMsgSendType" BO_ {frame.can_id} {int(frame.every_ms > 0)};')
    lines.append("")
    for frame in frames:
        for signal in frame.signals:
            if signal.codes:
                words = " ".join(f'{code} "{word}"' for code, word in signal.codes)
                lines.append(f"VAL_ {frame.can_id} {signal.name} {words} ;")
    return "\n".join(lines) + "\n"


def _tail(frame: MessageLine) -> tuple[SignalLine, ...]:
    """Return what `drivers.can.e2e` fills in; in SYNC the sequence is the counter."""
    if frame.every_ms:
        return ()
    if frame.crc_bits == 8:
        crc = SignalLine("crc", "", "", 0.0, 255.0, 8, 8 * (frame.nbytes - 1))
        counter = SignalLine("counter", "", "", 0.0, 15.0, 4, 8 * (frame.nbytes - 2))
    else:
        crc = SignalLine("crc", "", "", 0.0, 65535.0, 16)
        counter = SignalLine("counter", "", "", 0.0, 255.0, 8, 16)
    return (crc,) if frame.name == "SYNC" else (counter, crc)


def _sg(signal: SignalLine, receiver: str) -> str:
    place = f"{signal.start}|{signal.nbits}@1{'-' if signal.signed else '+'}"
    scale = f"({signal.factor:.15g},0) [{signal.low:.15g}|{signal.high:.15g}]"
    return f' SG_ {signal.name} : {place} {scale} "{_comment(signal.unit)}" {receiver}'


def _comment(text: str) -> str:
    return printable(text).replace('"', "'").replace("\\", "/")
