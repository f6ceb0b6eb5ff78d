"""A DBC file's well-formed entries, written anew for cantools: what the loop and the logs use.

Frames and signals have other names there, so that a name may be any, and twice, and an entry finds
what it means. `Writing.names` has the true ones, which long names are. Of the attributes only those
are written that have a meaning here, with values that their definitions allow.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field

from pcpc.drivers.can.dbc_entries import (
    NOBODY,
    DescribedFrame,
    DescribedSignal,
    Description,
    is_name,
    whole_number,
)
from pcpc.drivers.can.dbc_syntax import NUMBER, DbcEntry, names, parts
from pcpc.drivers.errors import printable

_USED = ("GenMsgCycleTime", "GenMsgSendType", "VFrameFormat", "CANFD_BRS", "E2EDataId")
_OF_FILE = "ProtocolType"
_LONG_FRAME, _LONG_SIGNAL = "SystemMessageLongSymbol", "SystemSignalLongSymbol"
_LONG_NODE = "SystemNodeLongSymbol"
_FORMATS = 16  # values of VFrameFormat
_FLOAT_BITS = {"1": (16, 32), "2": (64,)}  # of SIG_VALTYPE_
_KINDS = {"GenMsgSendType": ("ENUM", "STRING"), "VFrameFormat": ("ENUM", "INT")}
_ANY_KIND = ("INT", "FLOAT", "ENUM", "STRING")


@dataclass
class _Attribute:
    """The definition of an attribute; `default` as the file writes it."""

    kind: str
    choices: list[str] = field(default_factory=list)
    default: str = ""

    def value(self, text: str) -> str | None:
        """Return a value as cantools reads it; None if the definition does not allow it."""
        number = whole_number(text)
        if self.kind == "ENUM":
            if text in self.choices:
                return str(self.choices.index(text))
            is_one = number is not None and 0 <= number < len(self.choices)
            return str(number) if is_one else None
        if self.kind == "STRING":
            return text if text.startswith('"') else f'"{text}"'
        if self.kind == "FLOAT":
            return _number(text.strip('"')) if re.fullmatch(NUMBER, text.strip('"')) else None
        return None if number is None else str(number)

    def written_default(self) -> str | None:
        """Return the default as cantools reads it: of choices the text."""
        value = self.value(self.default)
        return self.choices[int(value)] if self.kind == "ENUM" and value is not None else value


class Writing:
    """The text for cantools, and the true name of each frame, or frame and signal, in it."""

    def __init__(self, described: Description) -> None:
        self.described = described
        self.names: dict[tuple[str, str], str] = {}
        self._alias: dict[int, str] = {}  # by id() of a frame or signal
        self._attributes: dict[str, _Attribute] = {}
        self.nodes: dict[str, str] = {}  # the true name of each alias
        self._nodes: dict[str, str] = {}
        self.long_nodes: dict[str, str] = {}
        self._lines: list[str] = []
        self._of_file = ""
        for i, frame in enumerate(described.frames.values()):
            self._alias[id(frame)] = alias = f"frame_{i}"
            self.names[alias, ""] = frame.name
            for k, signal in enumerate(frame.signals):
                self._alias[id(signal)] = f"signal_{k}"
                self.names[alias, f"signal_{k}"] = signal.name

    @property
    def is_j1939(self) -> bool:
        """Whether the whole file is of J1939."""
        return "J1939" in self._of_file

    def text(self) -> str:
        """Return the whole text."""
        self._define()
        for entry in self.described.others.get("BA_", []):
            self._attribute(entry)
        self._number_names()
        writers: dict[str, Callable[[DbcEntry, DescribedFrame, list[DescribedSignal]], None]] = {
            "BO_TX_BU_": self._senders, "CM_": self._comment, "VAL_": self._table,
            "SIG_VALTYPE_": self._value_type,
        }  # fmt: skip
        for keyword, writer in writers.items():
            for entry in self.described.others.get(keyword, []):
                if entry.number is not None and (meant := self.described.those_meant(entry)):
                    writer(entry, *meant)
        nodes = " ".join(self._node(name) for name in self.described.nodes)
        frames = [line for one in self.described.frames.values() for line in self._frame(one)]
        return "\n".join(["BU_: " + nodes, *frames, *self._lines, ""])

    def _node(self, name: str) -> str:
        """Return a node's alias."""
        if name == NOBODY:
            return name
        alias = self._nodes.setdefault(name, f"node_{len(self._nodes)}")
        self.nodes[alias] = self.long_nodes.get(name, name)
        return alias

    def _frame(self, frame: DescribedFrame) -> list[str]:
        """Return the lines of a frame and of its multiplexer."""
        head = f"BO_ {frame.number} {self._alias[id(frame)]}: {frame.length} "
        lines, ranges = [head + self._node(frame.sender)], []
        for signal in frame.signals:
            lines.append(self._signal(signal))
            if signal.chooser is not None:
                own, chooser = self._alias[id(signal)], self._alias[id(signal.chooser)]
                layouts = ",".join(f"{low}-{high}" for low, high in signal.ranges)
                ranges.append(f"SG_MUL_VAL_ {frame.number} {own} {chooser} {layouts};")
        return lines + ranges

    def _signal(self, signal: DescribedSignal) -> str:
        groups, marker = signal.groups, ""
        if signal.chooser is not None:
            marker = f"m{signal.ranges[0][0]}"
        marker += "M" if signal.chooses else ""
        receivers = ",".join(self._node(name) for name in names(groups["names"])) or NOBODY
        factor, offset, low, high = (
            _number(groups[key]) for key in ("factor", "offset", "low", "high")
        )
        return (
            f" SG_ {self._alias[id(signal)]} {marker} : {int(groups['start'])}|{groups['bits']}"
            f"@{groups['order']}{groups['sign']} ({factor},{offset}) [{low}|{high}]"
            f" {groups['unit']} {receivers}"
        )

    # attributes

    def _define(self) -> None:
        """Read the definitions of attributes, and write those that are used."""
        for entry in self.described.others.get("BA_DEF_", []):
            name, values = entry.groups["name"].strip('"'), parts(entry.groups["values"])
            self._attributes[name] = _Attribute(entry.groups["type"], values)
        for entry in self.described.others.get("BA_DEF_DEF_", []):
            name = entry.groups["name"].strip('"')
            if name in self._attributes:
                self._attributes[name].default = entry.groups["value"]
        self._of_file = self._attributes.get(_OF_FILE, _Attribute("")).default
        for name in _USED:
            self._write_definition(name)

    def _write_definition(self, name: str) -> None:
        attribute = self._attributes.get(name)
        if attribute is None:
            return
        attribute.kind = "INT" if attribute.kind == "HEX" else attribute.kind
        if attribute.kind not in _KINDS.get(name, _ANY_KIND):
            del self._attributes[name]
            return
        if name == "VFrameFormat" and attribute.kind == "INT":
            attribute.default = attribute.default or "0"  # cantools has the choices
        choices = ",".join(attribute.choices) if attribute.kind == "ENUM" else ""
        self._lines.append(f'BA_DEF_ BO_ "{name}" {attribute.kind} {choices};')
        if (default := attribute.written_default()) is not None:
            self._lines.append(f'BA_DEF_DEF_ "{name}" {default};')

    def _attribute(self, entry: DbcEntry) -> None:
        """Write the value of an attribute, or take the long name that it is."""
        name, value = entry.groups["name"].strip('"'), entry.groups["value"]
        if name == _LONG_NODE and is_name(value.strip('"')) and "node" in entry.groups:
            self.long_nodes[entry.groups["node"]] = value.strip('"')
        elif name == _OF_FILE and entry.number is None:
            self._of_file = value
        elif entry.number is not None and (meant := self.described.those_meant(entry)):
            frame, signals = meant
            if name == (_LONG_SIGNAL if signals else _LONG_FRAME):
                self._long_name(entry, frame, signals, value.strip('"'))
            elif name in _USED and not signals:
                self._written_value(entry, frame, name, value)

    def _written_value(self, entry: DbcEntry, frame: DescribedFrame, name: str, value: str) -> None:
        attribute = self._attributes.get(name)
        text = attribute.value(value) if attribute else None
        if name == "VFrameFormat" and attribute and attribute.kind != "ENUM":
            text = text if text is not None and 0 <= int(text) < _FORMATS else None
        if text is None:
            kinds = " or ".join(_KINDS.get(name, _ANY_KIND))
            what = f"not defined as {kinds}" if attribute is None else "not one of its values"
            said = f'frame {frame.name}: BA_ "{name}" {printable(value[:40])}: {what}'
            self.described.leave_out(entry.place, f"{said}; correct it", frame)
            return
        self._lines.append(f'BA_ "{name}" BO_ {frame.number} {text};')

    def _long_name(
        self, entry: DbcEntry, frame: DescribedFrame, signals: list[DescribedSignal], name: str
    ) -> None:
        if not is_name(name):
            what = f"{printable(repr(name[:80]))} is no name; use letters, digits and _"
            self.described.leave_out(entry.place, f"frame {frame.name}: {what}")
            return
        for alias in [self._alias[id(one)] for one in signals] or [""]:
            self.names[self._alias[id(frame)], alias] = name

    def _number_names(self) -> None:
        """Let frames of equal names differ; a multiplexer has a name of its own in its frame."""
        seen: set[str] = set()
        for frame in self.described.frames.values():
            alias = self._alias[id(frame)]
            name = self.names[alias, ""]
            if name in seen:
                self.names[alias, ""] = longer = f"{name}_{frame.number & 0x1FFFFFFF:X}"
                what = f"frame {name}: another one has this name; read as {longer}"
                self.described.leave_out(frame.place, f"{what}; make them differ", frame)
            seen.add(self.names[alias, ""])
            self._number_multiplexers(frame, alias)

    def _number_multiplexers(self, frame: DescribedFrame, alias: str) -> None:
        keys = [(alias, self._alias[id(one)]) for one in frame.signals]
        signal_names = [self.names[one] for one in keys]
        for i, (signal, key) in enumerate(zip(frame.signals, keys, strict=True)):
            if signal.chooses and signal_names.count(signal_names[i]) > 1:
                self.names[key] = longer = f"{signal_names[i]}_{signal.groups['start']}"
                problem = f"frame {frame.name}: {signal_names[i]}: another signal has this name"
                cure = f"read as {longer}; make them differ"
                self.described.leave_out(frame.place, f"{problem}; {cure}", frame)

    # what refers to frames and signals

    def _senders(self, entry: DbcEntry, frame: DescribedFrame, _: list[DescribedSignal]) -> None:
        senders = ",".join(self._node(name) for name in names(entry.groups["names"]))
        if senders:
            self._lines.append(f"BO_TX_BU_ {frame.number} : {senders};")

    def _comment(self, entry: DbcEntry, frame: DescribedFrame, them: list[DescribedSignal]) -> None:
        value = entry.groups["value"]
        if not them:
            self._lines.append(f"CM_ BO_ {frame.number} {value};")
        self._lines += [f"CM_ SG_ {frame.number} {self._alias[id(one)]} {value};" for one in them]

    def _table(self, entry: DbcEntry, frame: DescribedFrame, them: list[DescribedSignal]) -> None:
        flat = parts(entry.groups["pairs"])
        pairs = [(whole_number(key), text) for key, text in zip(flat[::2], flat[1::2], strict=True)]
        if any(key is None for key, _ in pairs):
            what = f"VAL_ {entry.number} {entry.groups['signal']}: a key is no whole number"
            self.described.leave_out(entry.place, what)
            return
        table = " ".join(f"{key} {text}" for key, text in pairs)
        for one in them:
            self._lines.append(f"VAL_ {frame.number} {self._alias[id(one)]} {table} ;")

    def _value_type(
        self, entry: DbcEntry, frame: DescribedFrame, them: list[DescribedSignal]
    ) -> None:
        kind = entry.groups["value"]
        for one in them:
            bits = int(one.groups["bits"])
            if kind != "0" and bits not in _FLOAT_BITS.get(kind, ()):
                problem = (
                    f"SIG_VALTYPE_ {entry.number} {one.name}: {kind} is no type of {bits} bits"
                )
                read = "as a whole number" if kind not in _FLOAT_BITS else "by its length"
                self.described.leave_out(entry.place, f"{problem}, read {read}", frame)
            self._lines.append(f"SIG_VALTYPE_ {frame.number} {self._alias[id(one)]} : {kind};")


def _number(text: str) -> str:
    """Return a number as cantools reads it: with a digit before its point."""
    return re.sub(r"^([-+]?)\.", r"\g<1>0.", text)
