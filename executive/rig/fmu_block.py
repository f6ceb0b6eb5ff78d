"""An FMU as a block: the ports that its description makes.

    inputs        variables of causality input that the rig wires; the others keep their start
    outputs       variables of causality output
    parameters    tunable parameters, which `pcpc set` may change
    settings      all parameters, and starts of inputs and of what begins `exact`, as NAME_start

Everything is a float64: integers are rounded, booleans are 0 and 1, an array is element by element,
NAME_1, NAME_2, .... Text, binary data and clocks are left out. The description also stands in the
log, so that a log is read where the FMU is not; only `executive.nodes.fmus` loads its code.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pcpc.drivers.compiled.stage import Stage, stage
from pcpc.drivers.compiled.views import Field, Layout
from pcpc.drivers.fmi.step import advance
from pcpc.executive.laws.block import Block, Ports, Prepared, port
from pcpc.executive.rig.fmu_model import INPUT, OUTPUT, PARAMETER, START, FmuModel, FmuVariable


class FmuValues:
    """The values of a block whose names only the FMU knows, as `x.of[i]`."""

    layout, size = Layout("Values", (Field("of", 0, (1,), None),)), 0

    def __init__(self, of: Any, letter: str = "") -> None:
        self.of = of


class States(Ports):
    """What the loop keeps of an FMU."""

    address = port(
        "", "where its calls are described", named="fmi_address", shape=1, recorded=False
    )
    status = port(
        "", "0 OK, 1 warning, 2 discard, 3 error, 4 fatal, 5 ended", named="fmi_status", shape=1
    )


@stage
def step(t: float, dt: float, p: FmuValues, x: States, u: FmuValues, y: FmuValues) -> None:
    """Step an FMU, see `drivers.fmi.step`; do nothing without an instance."""
    x.status[0] = advance(dt, x.address[0], p.of, u.of, y.of)


class FmuStep(Stage):
    """The step of one FMU, whose instance is made where it runs. `file` None: of a log."""

    is_opaque = True

    def __init__(
        self,
        model: FmuModel,
        file: Path | None,
        declared: tuple[Any, ...],
        wired: list[FmuVariable],
        tunable: list[FmuVariable],
    ) -> None:
        self.model, self.file, self.declared = model, file, declared
        self.wired, self.tunable = wired, tunable
        self.py_func, self.__name__, self.__doc__ = step.py_func, model.name, step.__doc__

    @property
    def entry(self) -> Any:
        """What `drivers.compiled.stage.call` takes."""
        return step.entry

    @property
    def entry_of_lanes(self) -> int:
        """Refuse: an FMU is not stepped in lanes. Raises TypeError."""
        raise TypeError("an FMU runs one by one")

    def __call__(self, t: float, dt: float, p: Any, x: Any, u: Any, y: Any) -> None:
        """Step on float64 vectors."""
        step(t, dt, p, x, u, y)


def block(model: FmuModel, file: Path | None, wired: Mapping[str, str]) -> Block:
    """Return the block of an FMU whose inputs `wired`, by their names here, have sources."""
    whole = {(one.kind, one.reference) for one in model.of(INPUT) if one.name in wired}  # arrays
    inputs = [one for one in model.of(INPUT) if (one.kind, one.reference) in whole]
    tunable = [one for one in model.of(PARAMETER) if one.tunable]
    settings = [
        one
        for one in model.of(PARAMETER, START)
        if not (one.role == START and one.given in {wire.given for wire in inputs})
    ]
    declared = (
        _ports("Parameters", tunable),
        States,
        _ports("Inputs", inputs),
        _ports("Outputs", model.of(OUTPUT)),
    )
    names = [one.name for one in tunable]

    def prepare(given: Mapping[str, float], rate_hz: float, seed: int) -> Prepared:
        return Prepared({name: given[name] for name in names})

    own = FmuStep(model, file, declared, inputs, tunable)
    return Block(own, _ports("Settings", settings), prepare)


def _ports(kind: str, variables: list[FmuVariable]) -> Any:
    """Return a declaration with a port of one value for each variable, under its name."""
    ports = {
        f"v{i}": port(
            variable.unit,
            variable.help,
            variable.start,
            -float("inf") if variable.low is None else variable.low,
            float("inf") if variable.high is None else variable.high,
            named=variable.name,
            shape=1,
        )
        for i, variable in enumerate(variables)
    }
    return type(kind, (Ports,), {"__doc__": "Of an FMU.", **ports})
