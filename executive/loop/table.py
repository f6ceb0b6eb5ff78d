"""The state-variable table of a node: each variable has a name, a unit, one writer, a meaning.

Names are dotted: `controller.kv_Nms_rad`, `rx.FB_A.hub_rate`, `supervisor.state`,
`timing.wake_late_us`. A block's parameters, states, inputs and outputs are contiguous slices of one
float64 vector, so that its step works on views. Wiring is by name and checked: the source exists,
the units agree, one writer each.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from pcpc.executive.errors import RigError, did_you_mean
from pcpc.executive.laws.block import Block, Port


@dataclass(frozen=True)
class Variable:
    """One entry of the table."""

    name: str
    unit: str
    kind: str
    writer: str
    help: str
    low: float = float("-inf")
    high: float = float("inf")
    recorded: bool = True
    timing: bool = False  # recorded with what depends on clocks


@dataclass
class Table:
    """Variables in the order of the vector, and their places."""

    variables: list[Variable] = field(default_factory=list)
    index: dict[str, int] = field(default_factory=dict)

    def add(self, variable: Variable) -> int:
        """Append a variable and return its place; RigError when its name has a writer already."""
        if variable.name in self.index:
            other = self.variables[self.index[variable.name]]
            raise RigError(
                f"{variable.name}: two writers: {other.writer} and {variable.writer}; rename one"
            )
        self.index[variable.name] = len(self.variables)
        self.variables.append(variable)
        return self.index[variable.name]

    def add_ports(self, block: str, ports: Sequence[Port], kind: str, recorded: bool) -> range:
        """Append all elements of `ports` under `block`; return their contiguous range."""
        first = len(self.variables)
        for port in ports:
            for name in port.names():
                keep = recorded and port.recorded
                self.add(
                    Variable(
                        f"{block}.{name}",
                        port.unit,
                        kind,
                        block,
                        port.help,
                        port.low,
                        port.high,
                        keep,
                    )
                )
        return range(first, len(self.variables))

    def source(self, name: str, unit: str, place: str, target: str) -> int:
        """Return the index of wiring source `name` for `target`, which has `unit`.

        `place` is file:line:column for the message. Raises RigError: unknown name, unit mismatch.
        """
        if name not in self.index:
            readable = [v.name for v in self.variables if v.kind != "input"]
            raise RigError(f"{place}: {target}: no variable {name!r}{did_you_mean(name, readable)}")
        source = self.variables[self.index[name]]
        if source.unit != unit:
            raise RigError(
                f"{place}: {target} is in {unit or '1'!r} but {name} is in {source.unit or '1'!r}; "
                "wire a variable of the same unit"
            )
        return self.index[name]


@dataclass(frozen=True)
class Views:
    """Where a block's views lie in the vector; `judged`: how many outputs must be finite."""

    parameters: range
    states: range
    inputs: range
    outputs: range
    judged: int | None = None  # all


def add_block(table: Table, name: str, block: Block) -> Views:
    """Append all variables of `block` under `name`."""
    return Views(
        table.add_ports(name, block.parameters, "parameter", False),
        table.add_ports(name, block.states, "state", True),
        table.add_ports(name, block.inputs, "input", False),
        table.add_ports(name, block.outputs, "output", True),
    )
