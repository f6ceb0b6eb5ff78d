"""Types of what commands print as JSON; a struct says what it has.

The words of a field stand below it. docs/reference/schemas are made of both.
"""

from typing import Annotated, Literal

from msgspec import Meta


def one_of(*values: str | int) -> Meta:
    """Return what says that a text, or a number, is one of these."""
    return Meta(extra_json_schema={"enum": [*values]})


COMMON = "common.json#/$defs/"
Count = Annotated[int, Meta(ge=0)]
Positive = Annotated[int, Meta(ge=1)]
NodeName = Annotated[str, Meta(extra_json_schema={"$ref": f"{COMMON}Node"})]
AnyNode = Annotated[str, Meta(extra_json_schema={"$ref": f"{COMMON}AnyNode"})]
VariableName = Annotated[str, Meta(pattern=r"^.+\..+$")]
Pacing = Literal["real", "sync", "lockstep"]
Number = Annotated[float, Meta(extra_json_schema={"$ref": f"{COMMON}Number"})]  # JSON may lack it
Finite = Annotated[float, Meta(extra_json_schema={"finite": True})]  # in a study
