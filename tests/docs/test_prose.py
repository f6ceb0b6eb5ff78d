"""Pages are read without stumbling: short sentences, few semicolons, no riddles, not too long.

Rules that hold for all pages together, and the checks of proselint that make sense for technical
prose. What a rule finds is named with its page, so that a writer sees what to change.
"""

import re
from collections.abc import Iterator

import pytest
from places import ROOT
from proselint.checks import __register__
from proselint.config import DEFAULT, Config
from proselint.registry import CheckRegistry
from proselint.tools import LintFile

pytestmark = pytest.mark.deep

PLACES = (
    "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/**/*.md", "plants/*/*.md",
    "tools/make/template/**/README.md",
)  # fmt: skip
PAGES = {
    page.relative_to(ROOT).as_posix(): page.read_text("utf-8")
    for place in PLACES
    for page in sorted(ROOT.glob(place))
}
LONG, LONG_SHARE = 40, 0.01  # words of a long sentence, share of all that may be long
SEMICOLONS = 0.1  # for each sentence
WORDS = 66_000  # of all pages, as `wc -w` counts; 60,000 + 10 % is the limit
OFF = (  # checks of proselint that do not fit
    "annotations",  # "note that" as a mark in a draft
    "archaism",  # "for ever"
    "cliches",  # "on the same page" is a page here
    "lexical_illusions",  # 11 1.5; a pattern below has words that stand twice
    "psychology",
    "restricted",  # a thousand words only
    "skunked_terms",
    "social_awareness",
    "terms",  # animals, citizens
    "typography",  # pages are ASCII
)
PATTERNS = {  # of sentences; what they forbid, and an example that is found
    "a predicate in front": (
        r"^(Not|Nor|Never) \w+ (is|are) (what|who)\b",
        "Not run is what has equal inputs.",
    ),
    "the subject at the end": (
        r"^(Which|What|That (the|an?|its?)|Whether|How)\b[^,:?]*"
        r" (says|tells|shows|decides) (the|a|an)\b[^,?]*$",
        "Which frames there are says the rig's DBC file.",
    ),
    "a thing that tells": (
        r"\b(tells|told) (the|a|an|of|how|what|which|whether|where|when|why|by|with|at|in)\b",
        "The command tells how many cycles were late.",
    ),
    "a relative clause without its noun": (
        r"\bwhat of (it|them|this|that|a|an|the)\b|^Who [^?]*$|\b(of|for|to|by) who\b",
        "Who looks at curves does not see a barrel bend.",
    ),
    "a noun where a verb belongs": (
        r"\*\*[\w ]+\*\* is an? \w+ (that|which|who) (says|tells)\b|\bis nobody's\b",
        "**Refused** is a law that says what is no finite number.",
    ),
    "a word twice": (r"\b(?!CODE)([A-Za-z]{2,}) \1\b", "It is the the end."),
    "a condition without if": (
        r"^(Should|Were|Had) (it|they|the|a|an|one)\b[^?]*$",
        "Should it die, the run goes on.",
    ),
}
NEVER = (  # sentences that were there once
    "That the barrel's own tuning violates the identity",
    "takes from what this says there",
    "time in which the watch itself was not run is nobody's silence",
    "a sensor that lies by little or slowly and the actuator, needs a second sensor",
    "Not run is what has equal inputs",
    "taken as a tuning, on the record, in effect from the cycle behind the one that is told",
    "is a law that says what is no finite number",
    "Which frames there are says the rig's DBC file",
    "that the study took when it was first measured is not reached",
    "costs no more than its size justifies",
)
_BLOCK = re.compile(r"^```.*?^```$|<!--.*?-->", re.MULTILINE | re.DOTALL)
_SKIPPED = re.compile(r"^(\||#|    |!\[|\[[^\]]+\]: )")  # tables, headings, code, pictures, links
_ITEM = re.compile(r"^ *([-*]|\d+\.) ")
_END = re.compile(
    r"(?<=[.!?])(?<!e\.g\.)(?<!i\.e\.)(?<!et al\.)[\"*)\]]*\s+(?=[\"(\[]*(?:\*|[A-Z0-9_]))"
)


def paragraphs(text: str) -> Iterator[str]:
    """Yield the prose of a page, a paragraph or item of a list at a time.

    Code blocks, indented code, tables, mathematics, headings, pictures and comments are left out;
    a bold head that ends in a full stop, too. Of a link its words stay; code in a line is one word.
    """
    found: list[str] = []
    for line in [*_BLOCK.sub("\n", text).splitlines(), ""]:
        nested = line.startswith("    ") and _ITEM.match(line)
        if _ITEM.match(line) or not line.strip() or (_SKIPPED.match(line) and not nested):
            if found:
                yield _plain(" ".join(found))
            found = []
        if line.strip() and (nested or not _SKIPPED.match(line)):
            found.append(_ITEM.sub("", line).strip())


def _plain(text: str) -> str:
    text = re.sub(r"``.+?``|`[^`]+`", "CODE", re.sub(r"^\*\*[^*]+\.\*\* ?", "", text))
    return re.sub(r"!?\[([^\]]*)\](\([^)]*\)|\[[^\]]*\])", r"\1", text)


def sentences(text: str) -> list[str]:
    """Return the sentences of a page's prose.

    A sentence ends at a full stop, question or exclamation mark before a blank and a capital,
    digit or code, or with its paragraph or item. Neither colon nor semicolon ends one.
    """
    return [one for part in paragraphs(text) for one in _END.split(part) if one.strip()]


def long_ones(text: str) -> list[str]:
    """Return the sentences of more than LONG words; a lone dash or sign is no word."""
    return [one for one in sentences(text) if len(re.findall(r"\S*\w\S*", one)) > LONG]


def semicolons(text: str) -> int:
    return sum(one.count(";") for one in sentences(text))


def patterns(text: str) -> list[str]:
    """Return sentences of the kinds that must not be, each behind what is wrong with it."""
    return [
        f"{what}: {one}"
        for one in sentences(text)
        for what, (pattern, _) in PATTERNS.items()
        if re.search(pattern, one)
    ]


def seen_before(text: str) -> list[str]:
    """Return the parts of NEVER that a page has, wherever its lines break."""
    flat = re.sub(r"[\s*`]+", " ", text)
    return [words for words in NEVER if words in flat]


def linted(text: str) -> list[str]:
    """Return what the checks of proselint say of a page's prose that are not OFF."""
    if not CheckRegistry().checks:
        CheckRegistry().register_many(__register__)
    checks = {name: on and name not in OFF for name, on in DEFAULT["checks"].items()}
    prose = "\n\n".join(paragraphs(text))
    found = LintFile("page", prose).lint(Config(max_errors=100, checks=checks)) if prose else []
    return [
        f"{one.check_result.check_path}: "
        f"{prose[max(one.check_result.span[0] - 31, 0) : one.check_result.span[1] + 29]!r}"
        for one in found
    ]


def test_long_sentences_are_the_exception() -> None:
    found = [f"{name}: {one}" for name, text in PAGES.items() for one in long_ones(text)]
    every = sum(len(sentences(text)) for text in PAGES.values())
    assert every > 1000, "sentences are not found"
    assert len(found) < LONG_SHARE * every, "\n".join([f"{len(found)} of {every}:", *found])


def test_semicolons_are_few() -> None:
    count = {name: semicolons(text) for name, text in PAGES.items()}
    every = sum(len(sentences(text)) for text in PAGES.values())
    worst = sorted(count.items(), key=lambda one: -one[1])[:15]
    assert sum(count.values()) <= SEMICOLONS * every, f"{sum(count.values())} of {every}: {worst}"


@pytest.mark.parametrize("page", PAGES)
def test_a_page_has_no_riddles(page: str) -> None:
    text = PAGES[page]
    found = [*patterns(text), *seen_before(text), *linted(text)]
    assert not found, "\n".join(found)


def test_the_pages_are_not_longer_than_they_may_be() -> None:
    words = {name: len(text.split()) for name, text in PAGES.items()}
    most = sorted(words.items(), key=lambda one: -one[1])[:15]
    assert sum(words.values()) <= WORDS, f"{sum(words.values())}: {most}"


def test_prose_is_what_is_left_without_code_tables_and_headings() -> None:
    text = (
        "# A head; ing\n\nOne `a; b. C` is [here](x.md#y). Two, e.g. 0.5 s: yes!\nIs it?\n\n"
        "| a; | b. C |\n|---|---|\n\n```sh\ncode; code. More\n```\n\n    indented; code\n\n"
        "<!-- a; comment -->\n- an item\n  in two lines\n- **Bold.** Another\n"
        "    - nested; item\n\n![a; picture](x.png)\n[x]: y;\n\n```math\na; b\n```\n"
    )
    assert sentences(text) == [
        "One CODE is here.", "Two, e.g. 0.5 s: yes!", "Is it?",
        "an item in two lines", "Another", "nested; item",
    ]  # fmt: skip
    assert semicolons(text) == 1


def test_each_rule_fires() -> None:
    words = "word " * LONG
    assert long_ones(f"{words}ends. It - is short.") == [f"{words}ends."]
    assert not long_ones(f"{words.strip()}.")
    assert semicolons("One; two; three.") == 2
    for what, (_, example) in PATTERNS.items():
        assert f"{what}: {example}" in patterns(f"Good. {example}"), what
    wrapped = (
        "taken as a tuning, on the record, in effect\nfrom the cycle behind the one that is told"
    )
    assert seen_before(f"It is {wrapped}.") == [NEVER[5]]
    assert seen_before("**Refused** is a law that says what is no finite number.") == [NEVER[6]]
    assert linted("It is very unique.")[0].startswith("uncomparables") and not linted("It is good.")


def test_what_is_right_is_not_found() -> None:
    good = (
        "Which frames a node sends is defined by the DBC file. Who tests it? "
        "Two are told apart. That plot shows the error. "
        "What a log holds, `pcpc log info` lists. `CODE` `CODE` are two. Not every rig has one."
    )
    assert [*patterns(good), *seen_before(good), *linted(good)] == []
