"""The opener: what it hands to those who lay out a rig, what it reads, and whose code may run."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pcpc.drivers.errors import UserError
from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import rig as log_rig
from pcpc.tools.after.opened import Opened, opened
from pcpc.tools.after.trust import ASKED, FOLDER, Trust, words_of
from pcpc.tools.terminal.arguments import CodeOfLaws

TOLD = Trust(True, ["a.py"], "b.yaml", ["c.fmu"])


def test_a_rig_is_asked_for_by_the_users_word_and_its_files_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def answer(*words: Any) -> Any:
        asked.append(words)
        return "it", ""

    for name in ("judged_rig", "drawing_of_log", "rig_of"):
        monkeypatch.setattr(log_rig, name, answer)
    asked: list[Any] = []
    log: Any = SimpleNamespace(path=Path("a.mcap"))
    with opened(log, TOLD) as run:
        assert run.judged(["a=1"]) == run.drawing() == run.rig("pd", ["b=2"], True) == ("it", "")
        assert run.stated() == "it"
        folder = asked[0][1]
        assert folder.is_dir() and folder.name.startswith(FOLDER)
        want: Any = [(folder, TOLD, ["a=1"]), (folder, TOLD), (TOLD, "pd", ["b=2"], True)]
        assert asked == [(log, *one) for one in (*want, (folder, None))]
    assert not folder.exists()


def test_a_log_that_was_read_is_not_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs, "read", lambda path: f"{path}, whole")
    monkeypatch.setattr(logs, "head", lambda path: f"{path}, its head")
    run = Opened(Path("a"))
    assert (run.head, run.log) == ("a, its head", "a, whole")
    run = Opened(Path("a"))
    assert run.log == run.head == "a, whole" and run.trust == ASKED
    run.close()


@pytest.mark.parametrize("given", [(), ("trust",), ("rig", "fmu"), Trust._fields])
def test_what_a_command_line_does_not_give_is_not_trusted(given: tuple[str, ...]) -> None:
    own = {name: getattr(TOLD, name) for name in given}
    assert Trust.of(CodeOfLaws(**own)) == ASKED._replace(**own)
    assert ASKED == (False, (), None, ())


def test_words_do_not_tell_where_the_files_of_a_log_are_laid_out() -> None:
    told = f"a.mcap: /tmp/x/{FOLDER}a_1/rig.yaml:7:3: wrong, see {FOLDER}b/own.py"
    assert words_of(UserError(told)) == "a.mcap: rig.yaml:7:3: wrong, see own.py"
