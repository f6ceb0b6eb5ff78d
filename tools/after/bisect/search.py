"""The first commit whose run differs from GOOD's, with few runs: `git bisect`, but for bits.

The suspects are BAD and its ancestors that descend from GOOD. git names the one that halves them
best. If its bits are GOOD's, so are those of its ancestors; if not, only its ancestors are left.
A commit that cannot be run is passed over; those that it hides stay suspects. A merge is named if
the lines that it joins have GOOD's bits and it has not, as that of a branch older than GOOD.
"""

from collections.abc import Callable

from pcpc.drivers.errors import UserError
from pcpc.tools.after.compare.repository import Repository


def ends(repository: Repository, good: str, bad: str) -> tuple[str, str]:
    """Return the hashes of two revisions; UserError unless the first is an ancestor."""
    good_commit, bad_commit = (repository.commit(ref, option="") for ref in (good, bad))
    if good_commit == bad_commit:
        raise UserError(f"GOOD and BAD are one commit, {good_commit[:10]}; name two")
    if not repository.git("rev-list", "-1", good_commit, "--not", bad_commit):
        return good_commit, bad_commit
    cure = "name a commit before it"
    if not repository.git("rev-list", "-1", bad_commit, "--not", good_commit):
        cure = "exchange the two"
    elif repository.git("rev-parse", "--is-shallow-repository").strip() == "true":
        cure = "this clone is shallow: `git fetch --unshallow` gets the rest"
    raise UserError(f"GOOD {good} is no ancestor of BAD {bad}; {cure}")


def suspects(
    repository: Repository,
    good: str,
    bad: str,
    differs: Callable[[str], bool | None],
    tell: Callable[[int, str], None],
) -> tuple[list[str], str]:
    """Return the commits of which one is the first, oldest first, and a parent with GOOD's bits.

    `differs` returns None for what cannot be run; `tell` gets how many are left, and the next.
    """
    equal, skipped = [good], set[str]()
    listed = "rev-list", "--ancestry-path"
    while True:
        halves = repository.git(*listed, "--bisect-all", bad, "--not", *equal).splitlines()
        todo = [c for c in (line.split()[0] for line in halves) if c not in {bad, *skipped}]
        if not todo:
            break
        tell(len(todo), todo[0])
        answer = differs(todo[0])
        if answer is None:
            skipped.add(todo[0])
        elif answer:
            bad = todo[0]
        else:
            equal.append(todo[0])
    left = repository.git(*listed, "--topo-order", "--reverse", bad, "--not", *equal).split()
    parents = [p for one in left for p in repository.git("rev-parse", f"{one}^@").split()]
    return left, next(one for one in parents if one in equal)
