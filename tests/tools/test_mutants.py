"""Changes of the safety code are noticed: some of them here, all by `pcpc evidence mutants`."""

import numpy as np
import pytest

from pcpc.tools.evidence import cli, mutants
from pcpc.tools.evidence.mutation import build

EVERY = 20


@np.errstate(all="ignore")
def test_mutants_are_noticed() -> None:
    """One of twenty, of those that can be noticed."""
    every, _ = mutants.prepared(compiled=False)
    chosen = [one for one in every if not mutants.reason(one)][::EVERY]
    left = [str(one) for one in chosen if not mutants.noticed(one, compiled=False)]
    assert len(chosen) > 20 and not left, "\n".join(["nobody notices:", *left])


@pytest.mark.parametrize("name", ["supervisor", "receiver", "sender", "codec", "senders"])
def test_the_code_itself_is_as_expected(name: str) -> None:
    _, compares = mutants.prepared(compiled=False)
    assert not compares[name](0), name


def test_every_function_has_mutants_and_each_is_one_change_at_its_line() -> None:
    every, _ = mutants.prepared(compiled=False)
    assert len(every) > 500 and {one.function for one in every} == {
        name for names in mutants.TARGETS.values() for name in names
    }
    assert [one.number for one in every] == [*range(1, len(every) + 1)]
    wrong = [one for one in every if one.was == one.becomes or "_m[" in one.was]
    assert not wrong, wrong[0]


def test_mutants_that_nobody_notices_and_reasons_of_none_are_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, second, third, *_ = mutants.prepared(compiled=False)[0]
    monkeypatch.setattr(mutants, "score", lambda: ([first, second, third], [second, third]))
    monkeypatch.setattr(mutants, "reason", lambda one: "so it is" if one is third else "")
    told = mutants.found()
    assert (told["mutants"], told["noticed"], told["left"]) == (3, 1, [str(second)])
    assert told["argued"] == {"so it is": 1} and told["idle"] == [*mutants.ARGUED]
    assert [*cli.missed({"mutants": told})] == [
        f"nobody notices {second}", *(f"a reason of no mutant: {one}" for one in mutants.ARGUED)
    ]  # fmt: skip


def test_mutants_of_a_function_are_what_they_say() -> None:
    every, _ = build({"drivers.codec": ("frame_of",)}, {}, "", {}, compiled=False)
    changes = {f"{one.was} -> {one.becomes}" for one in every}
    assert "frames[row, dbc.CAN_ID] == number -> frames[row, dbc.CAN_ID] != number" in changes
    assert "word & can_id.ID -> word | can_id.ID" in changes
