"""What a campaign's statement came to: its rows, counted in blocks as they came, to the decision.

The text of a campaign that ends, of one that was complete before, and of its report are the same,
as all of them follow from the rows.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from pcpc.tools.study.engine import REFUSED
from pcpc.tools.study.sweep import statements
from pcpc.tools.study.sweep.results import HELD, Counts, Results, counts

LOOK, LATER = 64, 16  # draws between two looks at the statement, or this part of those done


@dataclass(frozen=True)
class Decision:
    """Of one controller: HOLDS, REFUTED, NOT_SHOWN or OPEN, and a line that says so."""

    controller: str
    outcome: str
    text: str


def blocks() -> Iterator[int]:
    """Yield how many draws are counted before the next look, without end."""
    done = 0
    while True:
        yield (size := max(LOOK, done // LATER))
        done += size


def decisions(results: Results, until: str) -> list[Decision]:
    """Return what became of the statement `until`, by controller."""
    statement = statements.parse(until)
    return [_decision(results, name, statement) for name in results.controllers]


def _decision(results: Results, name: str, statement: statements.Statement) -> Decision:
    if statement.requirement is not None and statement.requirement not in results.requirements:
        what = f"{statement}: no run was judged by {statement.requirement}"
        raise statements.NothingToTellError(what)
    own = results.column("controller") == name
    outcomes = results.column("outcome")[own].tolist()
    of = statement.requirement
    judged = results.column("ok" if of is None else HELD + of)[own].tolist()
    found, done, sizes = Counts(), 0, blocks()
    while done < len(outcomes) and statement.outcome(*found) == statements.OPEN:
        size = next(sizes)
        more = counts(outcomes[done : done + size], judged[done : done + size])
        found, done = found.plus(more), done + size
    refused = outcomes[:done].count(REFUSED)
    text = (f"{name}: " if name else "") + statement.text(*found)
    text += f"; not counted: {refused:,} refused" if refused else ""
    return Decision(name, statement.outcome(*found), text)
