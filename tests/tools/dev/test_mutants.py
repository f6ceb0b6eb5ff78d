"""The safety code is as the documents say, compiled and interpreted; its mutants are noticed."""

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest

from pcpc.drivers.errors import Exit
from pcpc.executive.loop import tuning
from pcpc.tools.dev.evidence import cli, compared, mutants
from pcpc.tools.dev.evidence.comparison import Compared, Episodes
from pcpc.tools.dev.evidence.mutation import build
from pcpc.tools.dev.evidence.options import EvidenceRequest


@pytest.mark.deep
def test_the_compiled_code_is_as_expected_and_every_mutant_of_it_is_noticed() -> None:
    """All mutants: 70 s of processor time to compile, 20 to compare."""
    found = mutants.results()
    assert not [*cli.failures({"mutants": found})]
    assert found["mutants"] == found["noticed"] + sum(found["argued"].values()) > 1000


@pytest.fixture(scope="module")
def interpreted_compares() -> dict[str, Episodes]:
    """Return the comparisons of interpreted code over as many episodes as of compiled code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compared, "FEW", compared.EPISODES)
        return mutants.mutants_and_compares.__wrapped__(False)[1]


@pytest.mark.deep
@np.errstate(all="ignore")
@pytest.mark.parametrize("name", mutants.DRIVERS)
def test_the_interpreted_code_is_as_expected_in_every_episode(
    interpreted_compares: dict[str, Episodes], name: str
) -> None:
    assert not interpreted_compares[name].difference(0), name


def test_every_function_has_mutants_and_each_is_one_change_at_its_line() -> None:
    every, _ = mutants.mutants_and_compares(compiled=False)
    assert len(every) > 500 and {one.function for one in every} == {
        name for names in mutants.TARGETS.values() for name in names
    }
    assert [one.number for one in every] == [*range(1, len(every) + 1)]
    wrong = [one for one in every if one.was == one.becomes or "_m[" in one.was]
    assert not wrong, wrong[0]


def test_mutants_that_nobody_notices_and_reasons_of_none_are_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    first, second, third, *_ = mutants.mutants_and_compares(compiled=False)[0]
    monkeypatch.setattr(mutants, "score", lambda: ([first, second, third], [second, third], []))
    monkeypatch.setattr(mutants, "reason", lambda one: "so it is" if one is third else "")
    told = mutants.results()
    assert (told["mutants"], told["noticed"], told["left"]) == (3, 1, [str(second)])
    assert told["argued"] == {"so it is": 1} and told["idle"] == [*mutants.ARGUED]
    assert [*cli.failures({"mutants": told})] == [
        f"nobody notices {second}",
        *(f"a reason of no mutant: {one}" for one in mutants.ARGUED),
    ]


def test_modules_without_a_mutant_have_a_reason_or_are_not_as_stated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lacking = set(mutants.modules_without_mutants())
    assert lacking == {*mutants.ELSEWHERE}, lacking ^ {*mutants.ELSEWHERE}
    assert not {"reception", "intrusion", "tuning", "bus_state", "shared"} & lacking
    assert "reception.gather" in mutants.unchanged_functions()
    told = {"mutants": {"elsewhere": dict.fromkeys(["rings", "timing"], "why")}}
    assert cli.conclusion([], told) == "all as stated; no mutants of rings, timing"
    fewer = {key: names for key, names in mutants.TARGETS.items() if "supervisor" not in key}
    monkeypatch.setattr(mutants, "TARGETS", fewer)
    monkeypatch.setattr(mutants, "score", lambda: ([], [], []))
    monkeypatch.setattr(mutants, "ARGUED", {})
    wrong = [*cli.failures({"mutants": mutants.results()})]
    assert wrong == ["executive/loop/supervisor.py: no mutants, and no reason why"]


def _accepts_all(n: Any, count: Any, lock: Any) -> Any:
    return 0, 0


@np.errstate(all="ignore")
def test_code_that_is_broken_itself_is_told_and_not_met(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The loop takes every request; the others are as they were."""
    monkeypatch.setattr(tuning, "judge_request", _accepts_all)
    afresh = mutants.mutants_and_compares.__wrapped__
    monkeypatch.setattr(mutants, "mutants_and_compares", lambda compiled: afresh(False))
    request = EvidenceRequest(parts=["mutants"], output=str(tmp_path / "e"), quiet=True)
    assert cli.command(request) == Exit.NOT_MET
    told = capsys.readouterr().out.splitlines()
    where, what = told[0].split(": the code itself ")
    assert where.startswith("tunings: ") and what == "is not as expected, its mutants tell nothing"
    assert told[1] == "1 not as stated"


@np.errstate(all="ignore")
@pytest.mark.parametrize(("kind", "name"), [(1, "guard.pace"), (0, "control.stale"), (1, "v[101]")])
def test_a_difference_has_the_name_of_what_differs(kind: int, name: str) -> None:
    compare = mutants.mutants_and_compares(compiled=False)[1]["supervisor"]
    seen = compare.about.real if kind else compare.about.whole
    place = 17, compare.about.names(seen).index(name)
    expected = compare._episodes[1][2][kind]
    expected[place] += 1.0
    words = f"{name} is {expected[place] - 1}, expected {expected[place]}, in step 17 of episode 1"
    assert compare.difference(0) == words
    expected[place] -= 1.0
    assert expected[place].tobytes() == compare._episodes[1][2][kind][place].tobytes()


def test_a_number_that_is_none_is_equal_to_itself_alone() -> None:
    about = Compared(Given, _accepts_all, whole={}, real={"guard.gain": int, "guard.pace": int})
    came, expected = np.array([[np.nan, np.nan]]), np.array([[np.nan, 1.0]])
    told = Episodes(about, _accepts_all)._where(about.real, came, expected)
    assert told == "guard.pace is nan, expected 1.0, in step 0"


class Given(NamedTuple):
    """Of a step."""

    k: int
    share: float
    wire: Annotated[list[int], "u1", 8]


def test_names_lead_to_the_loop_and_stand_for_one_or_several() -> None:
    about = Compared(Given, _accepts_all, whole={
        "came": int, "guard.pace": int, "v[3:5]": int, "v[GAIN]": int,
        "rx.state[max(given.k, 0)].lost": int, "refused(n)": int, "wire.tx[0:2]": int,
    })  # fmt: skip
    assert about.names(about.whole) == [
        "came", "guard.pace", "v[3]", "v[4]", "v[GAIN]", "rx.state[max(given.k, 0)].lost",
        "refused(n)", "wire.tx[0]", "wire.tx[1]",
    ]  # fmt: skip
    lines = [line.strip() for line in about.driver.splitlines()[5:]]
    assert lines == [
        "whole[s, 0] = came", "whole[s, 1] = n.guard.pace",
        "whole_2 = n.v", "for i in range(3, 5):", "whole[s, -1 + i] = whole_2[i]",
        "whole[s, 4] = n.v[3]", "whole[s, 5] = n.rx.state[max(given.k, 0)].lost",
        "whole[s, 6] = refused(n)",
        "whole_7 = n.wire.tx", "for i in range(0, 2):", "whole[s, 7 + i] = whole_7[i]",
    ]  # fmt: skip
    assert [about.record[name].str for name in Given._fields] == ["<i8", "<f8", "|V8"]


def test_mutants_of_a_function_are_what_they_say() -> None:
    every, _ = build({"drivers.can.codec": ("frame_of",)}, {}, {}, {}, compiled=False)
    changes = {f"{one.was} -> {one.becomes}" for one in every}
    assert "frames[row].can_id == number -> frames[row].can_id != number" in changes
    assert "word & can_id.ID -> word | can_id.ID" in changes
