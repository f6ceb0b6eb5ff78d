"""Which commit `pcpc bisect` names, in histories of a real git whose runs are made up."""

import math
import random
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest
from bisected import git

from pcpc.drivers.errors import UserError
from pcpc.tools.after.bisect.search import ends, suspects
from pcpc.tools.after.compare.repository import Repository

Parents = Mapping[int, Sequence[int]]


def history(folder: Path, parents: Parents) -> dict[int, str]:
    """Make a repository with these commits, numbered from 1; return their hashes."""
    git(folder, "init", "-q", "-b", "main")
    lines = []
    for n, above in parents.items():
        lines += ["commit refs/heads/main", f"mark :{n}", f"committer x <x@x> {10**9 + n} +0000"]
        lines += [f"data {len(str(n))}", str(n)]
        lines += [f"{'merge' if i else 'from'} :{p}" for i, p in enumerate(above)]
        lines += [f"M 644 inline {n}", "data 1", "x", ""]
    words = ["git", "-C", str(folder), "fast-import", "--quiet", "--force", "--export-marks=marks"]
    subprocess.run(words, input="\n".join(lines).encode(), check=True)
    marks = dict(line.split() for line in (folder / "marks").read_text().splitlines())
    return {int(mark[1:]): commit for mark, commit in marks.items()}


def above(parents: Parents, n: int) -> set[int]:
    """Return a commit and its ancestors."""
    found, todo = set(), [n]
    while todo:
        one = todo.pop()
        if one not in found:
            found.add(one)
            todo += parents[one]
    return found


class Search:
    """A search from the first commit to the last one, what it runs and says."""

    def __init__(self, folder: Path, parents: Parents, bad: set[int], broken: set[int]) -> None:
        self.ran: list[int] = []
        self.told: list[tuple[int, str]] = []
        folder.mkdir()
        hashes = history(folder, parents)
        number = {commit: n for n, commit in hashes.items()}

        def differs(commit: str) -> bool | None:
            self.ran.append(number[commit])
            return None if number[commit] in broken else number[commit] in bad

        good, last = hashes[min(parents)], hashes[max(parents)]
        left, parent = suspects(
            Repository(folder), good, last, differs, lambda n, c: self.told.append((n, c))
        )
        self.left, self.parent = [number[one] for one in left], number[parent]


def line(count: int) -> Parents:
    return {n: [n - 1] if n > 1 else [] for n in range(1, count + 1)}


@pytest.mark.parametrize(("count", "first"), [(2, 2), (3, 2), (3, 3), (9, 4), (31, 17), (32, 2)])
def test_the_first_of_a_line_is_found_in_few_runs(count: int, first: int, tmp_path: Path) -> None:
    found = Search(tmp_path / "r", line(count), set(range(first, count + 1)), set())
    assert (found.left, found.parent) == ([first], first - 1)
    assert len(found.ran) == len(set(found.ran)) <= math.ceil(math.log2(count))
    assert [n for n, _ in found.told] == sorted((n for n, _ in found.told), reverse=True)
    assert not found.told or (found.told[0][0] == count - 2 and found.told[-1][0] >= 1)


def test_the_first_of_any_history_is_found(tmp_path: Path) -> None:
    drawn = random.Random("bisect")
    for case in range(12):
        count = drawn.randrange(3, 24)
        parents = {
            1: [],
            **{
                n: sorted(
                    {
                        n - 1 if drawn.random() < 0.5 or n == count else drawn.randrange(1, n),
                        drawn.randrange(1, n),
                    },
                    reverse=True,
                )[: drawn.choice((1, 2))]
                for n in range(2, count + 1)
            },
        }
        first = drawn.choice(sorted(above(parents, count) - {1}))
        bad = {n for n in parents if first in above(parents, n)}
        found = Search(tmp_path / f"r{case}", parents, bad, set())
        assert found.left == [first], (parents, found.ran)
        assert found.parent in parents[first] and found.parent not in bad


def test_with_commits_that_cannot_be_run_all_that_it_can_be_are_named(tmp_path: Path) -> None:
    drawn = random.Random("broken")
    for case in range(8):
        count = drawn.randrange(4, 20)
        first = drawn.randrange(2, count + 1)
        broken = {n for n in range(2, count) if drawn.random() < 0.5}
        found = Search(tmp_path / f"r{case}", line(count), set(range(first, count + 1)), broken)
        last_equal = max(n for n in range(1, first) if n not in broken)
        first_bad = min(n for n in range(first, count + 1) if n not in broken)
        assert found.left == list(range(last_equal + 1, first_bad + 1))
        assert found.parent == last_equal


def test_of_changes_that_come_and_go_one_is_found(tmp_path: Path) -> None:
    for case, bad in enumerate(({3, 4, 8, 9}, {2, 9}, {5, 7, 9})):
        found = Search(tmp_path / f"r{case}", line(9), bad, set())
        (one,) = found.left
        assert one in bad and one - 1 not in bad and found.parent == one - 1


def test_a_merge_of_a_branch_that_is_older_than_good_is_named_itself(tmp_path: Path) -> None:
    folder = tmp_path / "r"
    folder.mkdir()
    hashes = history(folder, {1: [], 2: [1], 3: [1], 4: [2], 5: [4, 3], 6: [5]})
    ran = []

    def differs(commit: str) -> bool:
        ran.append(commit)
        return commit in (hashes[5], hashes[6])

    found = suspects(Repository(folder), hashes[2], hashes[6], differs, lambda *_: None)
    assert found == ([hashes[5]], hashes[4])
    assert hashes[3] not in ran, "it lacks what GOOD has"


def test_the_ends_are_two_commits_one_above_the_other(tmp_path: Path) -> None:
    hashes = history(tmp_path, {1: [], 2: [1], 3: [2], 4: [2]})
    repository = Repository(tmp_path)
    assert ends(repository, hashes[1], "main") == (hashes[1], hashes[4])
    git(tmp_path, "tag", "-a", "-m", "annotated", "v1", hashes[2])
    assert ends(repository, "v1", hashes[3][:9])[0] == hashes[2]
    for good, bad, said in (
        (hashes[3], "main", "is no ancestor of BAD main; name a commit before it"),
        ("main", hashes[1], "; exchange the two"),
        ("main", "HEAD", "GOOD and BAD are one commit"),
        ("nosuch", "HEAD", "nosuch: git: Needed a single revision; `git log` lists"),
        ("main~3", "HEAD", "main~3: git: Needed a single revision"),
        ("", "HEAD", ": git: Needed a single revision"),
        ("-x", "HEAD", "-x: git: Needed a single revision"),
        ("--all", "HEAD", "--all: git: Needed a single revision"),
        (f"{hashes[1]}..main", "HEAD", "git: Needed a single revision"),
        ("main:1", "HEAD", "main:1: git: "),
        ("\u00e9\n", "HEAD", "\u00e9\\n: git: Needed a single revision"),
    ):
        with pytest.raises(UserError) as error:
            ends(repository, good, bad)
        assert said in str(error.value), str(error.value)
    shallow = tmp_path / "shallow"
    git(
        tmp_path,
        "clone",
        "-q",
        "--depth",
        "1",
        "--no-single-branch",
        f"file://{tmp_path}",
        str(shallow),
    )
    git(shallow, "fetch", "-q", "--depth", "1", "origin", hashes[1])
    with pytest.raises(UserError, match="shallow: `git fetch --unshallow`"):
        ends(Repository(shallow), hashes[1], "HEAD")
