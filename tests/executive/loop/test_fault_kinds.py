"""The table of faults on purpose: the page that explains them, the schema, the recorded numbers."""

import re
from typing import get_args, get_type_hints

import pytest
from places import ROOT

from pcpc.executive.errors import RigError
from pcpc.executive.loop.fault_kinds import (
    BY_THEMSELVES,
    HOWS,
    KINDS,
    FaultKind,
    WrongFrame,
    WrongNode,
    WrongValue,
)
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig.reading import load_rig
from pcpc.executive.rig.schema import Fault

SEAMS = WrongValue, WrongFrame, WrongNode
PAGE = (ROOT / "docs/rig.md").read_text("utf-8").partition("## Faults on purpose")[2]


def listed(text: str) -> dict[str, str]:
    """Return what a list of the page says of each kind."""
    found: dict[str, str] = {}
    for line in re.findall(r"^- (`.*?)(?=\n\n|\n- )", text, re.MULTILINE | re.DOTALL):
        names, _, says = " ".join(line.split()).partition(": ")
        words = re.findall(r"`(\w+)`", names)
        texts = says.split("; ") if len(words) > 1 else [says]
        one_text = len(texts) != len(words)
        found |= dict(zip(words, texts * len(words) if one_text else texts, strict=True))
    return found


@pytest.mark.quick
@pytest.mark.parametrize(("seam", "head"), [
    (WrongValue, "the kinds give:"), (WrongFrame, "For a frame the\nkinds give:"),
])  # fmt: skip
def test_the_page_says_of_each_kind_what_the_table_says(seam: type[FaultKind], head: str) -> None:
    text = PAGE.partition(head)[2].split("\n\n")[1]
    assert listed(f"{text}\n\n") == {kind.word: kind.row.says for kind in seam}


@pytest.mark.quick
def test_the_page_says_what_concerns_a_node() -> None:
    for kind in WrongNode:
        assert f"- `{kind.word}` {kind.row.says}" in PAGE, kind


@pytest.mark.quick
def test_a_size_that_is_given_stands_in_the_text() -> None:
    given = {kind: kind.row.given for seam in SEAMS for kind in seam if kind.row.given is not None}
    for kind, size in given.items():
        assert f"({size:g})" in kind.row.says or kind is WrongValue.DELAY, kind
        assert kind.row.sized and kind.row.low <= size <= kind.row.high, kind


@pytest.mark.quick
def test_the_schema_has_the_ways_of_the_table() -> None:
    how, _ = get_args(get_type_hints(Fault, include_extras=True)["how"])
    assert get_args(how) == HOWS and set(BY_THEMSELVES) < set(HOWS)
    assert all(set(kind.row.hows) <= set(HOWS) for seam in SEAMS for kind in seam)


@pytest.mark.quick
def test_numbers_of_kinds_are_those_of_recorded_runs() -> None:
    """A log replays with the numbers that it was written with: kinds are only ever appended."""
    assert WrongValue.words()[:14] == (
        "value", "bias", "gain", "drift", "stuck", "dropout", "noise", "random", "quantise",
        "delay", "saturation", "rate", "dead_zone", "nan",
    )  # fmt: skip
    assert WrongFrame.words()[:13] == (
        "loss", "corruption", "repetition", "sequence", "delay", "insertion", "masquerade",
        "addressing", "length", "counter", "checksum", "payload", "forgery",
    )  # fmt: skip
    assert all([int(kind) for kind in seam] == list(range(len(seam))) for seam in SEAMS)
    assert (int(WrongNode.STALL), int(WrongNode.FLOOD)) == (0, 1)


@pytest.mark.quick
@pytest.mark.parametrize("word", ["Noise", "NOISE", "\u017ftuck", "", "delay ", "loss"])
def test_only_the_word_itself_is_a_kind_of_value(word: str) -> None:
    assert WrongValue.of(word) is None
    assert {WrongValue.of("delay"), WrongFrame.of("delay")} == {WrongValue.DELAY, WrongFrame.DELAY}
    assert len(KINDS) == len(set(KINDS)) == sum(map(len, SEAMS)) - 1


PROBE = ROOT / "plants/probe/rig.yaml"
INF = float("inf")
BOUNDS = {  # as docs/rig.md and the codec have them; all other kinds take any number
    "corruption": (0, 64), "delay": (0, 63), "length": (0, 8), "counter": (-255, 255),
    "checksum": (-255, 255), "flood": (1, 200), "noise": (0, INF), "quantise": (0, INF),
    "saturation": (0, INF), "rate": (0, INF), "dead_zone": (0, INF),
}  # fmt: skip
NEEDS_NO_SIZE = {
    "stuck", "dropout", "nan", "loss", "corruption", "repetition", "sequence", "delay", "insertion",
    "masquerade", "addressing", "payload", "forgery", "stall",
}  # fmt: skip
PLACES = {WrongValue: "at: controller.command", WrongFrame: "frame: FB", WrongNode: "node: plant"}
EVERY = [kind for seam in SEAMS for kind in seam]


def refusal(kind: FaultKind, more: str = "", place: str = "") -> str:
    """Return why a fault of the probe is refused, "" if it is planned."""
    own = {"addressing": ", data_of: HB_PLANT", "payload": ", how: freeze"}.get(kind.word, "")
    fault = f"{{kind: {kind.word}, {place or PLACES[type(kind)]}{own}{more}}}"
    text = f"base: {PROBE}\nrig: wrong\nfaults: {{it: {fault}}}\n"
    rig = load_rig(PROBE.with_name("wrong.yaml"), text=text)
    try:
        for role in rig.roles:
            plan(rig, role, "lockstep")
    except RigError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("kind", EVERY, ids=lambda kind: f"{type(kind).__name__}.{kind.name}")
def test_a_kind_takes_the_sizes_of_its_row(kind: FaultKind) -> None:
    missing = refusal(kind)
    assert missing.endswith(f"{kind.word} needs a value: how large it is") or not missing
    assert bool(missing) == (kind.word not in NEEDS_NO_SIZE)
    low, high = BOUNDS.get(kind.word, (-INF, INF))
    for size, fits in ((low, True), (high, True), (low - 0.5, False), (high + 0.5, False)):
        if abs(size) < INF:
            said = refusal(kind, f", value: {size}")
            assert not said if fits else f"which a {kind.word} may have" in said, (size, said)


@pytest.mark.parametrize("kind", EVERY, ids=lambda kind: f"{type(kind).__name__}.{kind.name}")
def test_a_kind_takes_the_keys_of_its_row(kind: FaultKind) -> None:
    size = "" if kind.word in NEEDS_NO_SIZE else ", value: 1"
    assert ("has goes_on" in refusal(kind, f"{size}, goes_on: true")) == (kind.word != "counter")
    if kind.word not in ("addressing", "payload"):
        assert "nothing else, has data_of" in refusal(kind, f"{size}, data_of: HB_PLANT")
        for how in HOWS:
            takes = kind.word in ("counter", "checksum")
            assert (f"{kind.word} knows no how" in refusal(kind, f"{size}, how: {how}")) != takes
    if kind.word in ("counter", "checksum"):
        assert not refusal(kind, ", how: freeze") and not refusal(kind, ", how: random")
        assert "needs a value" in refusal(kind, ", how: offset")


@pytest.mark.parametrize("kind", WrongFrame, ids=lambda kind: kind.name)
def test_what_changes_counter_or_crc_needs_a_frame_that_has_both(kind: FaultKind) -> None:
    size = "" if kind.word in NEEDS_NO_SIZE else ", value: 1"
    said = refusal(kind, size.replace("HB_PLANT", "FB"), place="frame: HB_PLANT")
    both = kind.word in ("counter", "checksum", "payload", "masquerade", "forgery")
    assert ("HB_PLANT has no counter and CRC" in said) == both, said
