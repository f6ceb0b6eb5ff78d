"""What a rig needs of an FMU's description; it is read without the compiler."""

from msgspec import Struct

INPUT, OUTPUT, PARAMETER, START = "input", "output", "parameter", "start"  # roles


class FmuVariable(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One value of an FMU: `name` as pcpc has it, `given` as the FMU has it.

    `kind`: the type's name in FMI; `reference`: its value reference, `element`: which of an array;
    `low`, `high`: the description's, None for none.
    """

    name: str
    given: str
    role: str
    kind: str
    reference: int
    element: int = 0
    unit: str = ""
    help: str = ""
    start: float | None = None
    low: float | None = None
    high: float | None = None
    tunable: bool = False


class FmuModel(Struct, frozen=True, kw_only=True):
    """What an FMU's description says, as far as a rig needs it; `sha256` is that of its file."""

    name: str
    fmi: str
    identifier: str
    token: str
    sha256: str
    once: bool  # only one instance in a process
    made_by: str
    variables: tuple[FmuVariable, ...]

    def of(self, *roles: str) -> list[FmuVariable]:
        """Return the variables of these roles."""
        return [one for one in self.variables if one.role in roles]
