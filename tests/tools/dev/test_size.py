"""`make size` counts what is read as code: no docstring, comment or layout."""

from pathlib import Path

from pcpc.tools.dev import size

BARE = "def f(x):\n    return x + 'a'\n"
TOLD = '''"""A module."""

def f(x):  # why
    """Return it.

    At length.
    """

    return x + 'a'
'''


def test_docstrings_comments_and_layout_are_no_tokens() -> None:
    names_and_marks = ["def", "f", "(", "x", ")", ":", "return", "x", "+", "'a'"]
    assert size.tokens(BARE) == len(names_and_marks)
    assert size.tokens(TOLD) == size.tokens(BARE)
    assert size.tokens("x = 'no docstring'\n'nor this'\n") == 4


def test_rooms_are_summed_and_what_a_user_installs_apart(tmp_path: Path) -> None:
    for name in ("tools/study/fit/a.py", "tools/study/fit/book/b.py", "tools/dev/c.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(BARE)
    found = size.sizes(tmp_path)
    assert found["tools/study/fit", "tokens"] == 20 and found["tools/study/fit", "lines"] == 4
    assert found["sum", "tokens"] == 30 and found["what a user installs", "tokens"] == 10
