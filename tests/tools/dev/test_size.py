"""`make size` counts what is read as code, also what hides in strings: no docstring or comment."""

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


def test_words_in_strings_count_but_not_those_of_docstrings() -> None:
    assert size.words(TOLD) == size.words(BARE) == 1
    assert size.words("FIELDS = 'gain: f8, missing: i8'\n") == 4
    assert size.words("print(f'{n} of {total} frames')\n'no docstring'\n") == 4


def test_what_a_reader_pays_is_counted_where_it_stands(tmp_path: Path) -> None:
    loop, tools = tmp_path / "executive/loop/a.py", tmp_path / "tools/b.py"
    for file, text in (
        (loop, "intrusion = 1\ndef f(n: Any, k: int) -> None:\n    pass\n"),
        (tools, BARE),
    ):
        file.parent.mkdir(parents=True)
        file.write_text(text)
    assert size.untyped_arguments(tmp_path) == (1, 2)
    features = size.files_of_features(tmp_path)
    assert features.pop("intrusion") == "1, and in 0 of the lists"
    assert set(features.values()) == {"0, and in 0 of the lists"}
    assert size.longest_functions(tmp_path) == [
        (2, "executive/loop/a.py: f"),
        (2, "tools/b.py: f"),
    ]


def test_a_list_and_a_mere_mention_are_no_files_of_a_feature(tmp_path: Path) -> None:
    for name, text in {
        "executive/nodes/parts.py": "import planned_losses, planned_keyframes\n",
        "executive/loop/a.py": '"""Of losses."""\nx = 1  # losses\n',
        "drivers/b.py": "said = 'no losses'\nimport losses\n",
        "tools/c.py": "import losses\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    features = size.files_of_features(tmp_path)
    assert (
        features["losses"] == "1, and in 1 of the lists"
        and features["keyframes"] == "0, and in 1 of the lists"
    )
