"""The keys of a rig file that a run is judged by, and the words that several keys are made of."""

import math
from collections.abc import Iterator
from typing import Annotated

from msgspec import Meta

from pcpc.executive.rig.keyed import Keyed

Name = Annotated[str, Meta(pattern=r"\A[a-z0-9._-]{1,64}\Z")]  # it becomes part of a file's name
Word = Annotated[str, Meta(max_length=200)]
Duration = Annotated[str, Meta(pattern=r"\A[0-9]{1,9}(\.[0-9]{1,9})?(ms|s|min)\Z")]
Condition = Annotated[str, Meta(max_length=300)]  # see `rig.expressions`
Id = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9._/#-]{0,39}\Z")]  # of a requirement


class Requirement(Keyed, omit_defaults=True, rename={"for_": "for"}):
    """What has to hold in time, in one of the forms of `rig.requirements`, for `controllers`."""

    id: Id | None = None
    name: Word | None = None
    always: Condition | None = None
    never: Condition | None = None
    until: Condition | None = None
    when: Condition | None = None
    then: Condition | None = None
    settles: Condition | None = None
    to: Condition | float | None = None
    into: Condition | float | None = None
    overshoot: Condition | None = None
    over: Condition | None = None
    rate: Condition | None = None
    at_most: Condition | float | None = None
    within: Duration | None = None
    for_: Duration | None = None
    after: Duration | None = None
    before: Duration | None = None
    controllers: list[Name] | None = None


class Expected(Keyed, omit_defaults=True):
    """A limit of `expect` in full: the lowest and highest value, and the requirement's id."""

    low: float = -math.inf
    high: float = math.inf
    id: Id | None = None

    def __iter__(self) -> Iterator[float]:
        """Yield the pair that most rigs write."""
        yield from (self.low, self.high)
