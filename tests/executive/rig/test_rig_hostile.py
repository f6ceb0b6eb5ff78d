"""Rig files that nobody should write: each is read, or refused in one line that says where."""

import copy
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from places import ROOT

from pcpc.drivers.errors import BusError
from pcpc.executive.errors import RigError
from pcpc.executive.nodes.plan import describe, plan
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.reading import load_rig

PLANTS = ROOT / "plants"
PROBE = PLANTS / "probe" / "rig.yaml"
BASE = f"base: {PROBE}\n"
RIGS = {
    file: yamlfile.load(file).data
    for file in (PROBE, PLANTS / "atb1000/rigs/engage.yaml", PLANTS / "telerobot/rig.yaml")
}
NUMBERS = (
    0, -1, 2, -0.0, 0.5, 5e-324, 1e-300, 1e300, -1e300, float("inf"), float("-inf"), 2**63 - 1,
    -(2**63), True, False, None,
)  # fmt: skip
TEXTS = (
    "", "x", "a" * 300, "a" * 5000, "nul\0nul", "a\nb", "../..", "/dev/zero", "/", "é", "\ud800",
    "\u2028", ".py", ":", "a:b:c", "..x:y", "references:step", "0s", "9" * 400 + "s",
    "999999999min", "rx.FB_A.hub_rate", "controller.kv_Nms_rad",
)  # fmt: skip
SHAPES: tuple[Any, ...] = (
    [],
    {},
    [1],
    {"a": 1},
    {"": 1},
    {"a\0": {"b": [{}]}},
    [[[[1]]]],
    ["x"] * 999,
)


def paths(data: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every value below `data`."""
    children: Any = ()
    if isinstance(data, dict | list):
        children = data.items() if isinstance(data, dict) else enumerate(data)
    for key, child in children:
        yield (*above, key)
        yield from paths(child, (*above, key))


PLACES = {file: sorted(paths(data), key=str) for file, data in RIGS.items()}


@st.composite
def rigs(draw: st.DrawFn) -> tuple[Path, str]:
    """Draw a rig file with one to three values replaced, removed or renamed."""
    file = draw(st.sampled_from(list(RIGS)))
    data = copy.deepcopy(RIGS[file])
    for place in draw(st.lists(st.sampled_from(PLACES[file]), min_size=1, max_size=3)):
        at: Any = data
        for key in place[:-1]:
            at = at[key] if place[0] in data and isinstance(at, dict) and key in at else {}
        if not isinstance(at, dict) or place[-1] not in at:
            continue
        evil = st.sampled_from((*NUMBERS, *TEXTS, *SHAPES)) | st.floats(allow_nan=False) | st.text()
        match draw(st.sampled_from(("put", "put", "put", "drop", "rename"))):
            case "put":
                at[place[-1]] = draw(evil)
            case "drop":
                del at[place[-1]]
            case "rename":
                at[draw(st.sampled_from(("x", "é", "a" * 300, "base", "k\0")))] = at.pop(place[-1])
    return file, yamlfile.dump(data)


@settings(
    max_examples=100, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True
)
@given(rigs())
def test_a_changed_rig_is_planned_or_refused_in_a_line(given: tuple[Path, str]) -> None:
    file, text = given
    try:
        rig = load_rig(file, text=text)
        for role in rig.roles:
            describe(plan(rig, role, rig.config.pacing), {})
    except (RigError, BusError) as error:
        assert "\n" not in str(error) and "\0" not in str(error), str(error)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.text() | st.text(alphabet="{}[]:,&*!|>'\"%@`-?# \n\ta1.~<="))
def test_any_text_is_read_or_refused_in_a_line(text: str) -> None:
    for read in (
        lambda: yamlfile.load(PROBE, text),
        lambda: load_rig(PROBE, None, [f"seed={text}"]),
    ):
        try:
            read()
        except RigError as error:
            assert "\n" not in str(error), str(error)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("title: " + "[" * 100_000, "nested too deeply"),
        ("\n".join(" " * i + "a:" for i in range(400)), "nested too deeply"),
        ("evaluation: " + "{a: " * 250 + "}" * 250, "evaluation: key file is missing"),
        ("a: &a [x, x]\nb: [*a, *a]", "2:4: anchors"),
        ('dbc: "a\\0b"', r"2:1: dbc: character '\x00' is not allowed"),
        ('bus: {channel: "a\\0b"}', r"2:7: bus.channel: character '\x00' is not allowed"),
        (r'title: "\e[31mred"', r"2:1: title: character '\x1b' is not allowed"),
        (r'title: "\x9b31mred"', r"2:1: title: character '\x9b' is not allowed"),
        (r'title: "\u202Eder"', r"2:1: title: character '\u202e' is not allowed"),
        (r'title: "a\rok"', r"2:1: title: character '\r' is not allowed"),
        ('title: "\\ud800"', r"2:1: title: character '\ud800' is not allowed"),
        ("title: a\0b", r"2:9: character '\x00' is not allowed"),
        ('controller: "a\\nb"', r"2:1: controller: no controller a\nb; known: proportional"),
        ("dbc: " + "a" * 300, "is no file: File name too long"),
        ("schedule: [{at_s: .inf, set: {}}]", "2:13: schedule[0].at_s: expected a number <= "),
        ("schedule: [{at_s: 1e300, set: {}}]", "2:13: schedule[0].at_s: expected a number <= "),
        ("record: {keep: " + "9" * 400 + "s}", "2:10: record.keep: expected text of the form"),
        ("record: {keep: 999999999min}", "2:10: record.keep: 999999999min: expected more than 0"),
        ("record: {keep: 0s}", "2:10: record.keep: 0s: expected more than 0"),
        ("xcp: tcp:65535", "2:1: xcp: expected a port of at most 65534"),
        ("rig: " + "a" * 210, "2:1: rig: expected text of the form [a-z0-9._-]{1,64}"),
        ("losses: {SYNC: {share: 0.1, burst: .inf}}", "losses.SYNC.burst: expected a number <= "),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_rig_is_said_with_its_place(text: str, said: str) -> None:
    with pytest.raises(RigError) as caught:
        load_rig(PROBE.with_name("own.yaml"), text=BASE + text + "\n")
    line = str(caught.value)
    assert said in line and "own.yaml:" in line and "\n" not in line and len(line) < 600, line


def test_a_rig_that_is_no_file_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    os.symlink("loop", "loop")
    os.mkfifo("fifo")
    Path("utf16").write_bytes(BASE.encode("utf-16"))
    Path("huge").write_bytes(b"#" * (yamlfile.MOST_BYTES + 1))
    for name, said in {
        "loop": "a loop of links",
        "fifo": "is no regular file",
        ".": "Is a directory",
        "/dev/zero": "is no regular file",
        "a" * 300: "File name too long",
        "a\0b": "no name",
        "utf16": "not UTF-8",
        "huge": "more than 1 MiB",
    }.items():
        with pytest.raises(RigError, match=said):
            load_rig(name)
        Path("own.yaml").write_text(yamlfile.dump({"base": name}))
        with pytest.raises(RigError, match=r"own.yaml:1:\d: "):
            load_rig("own.yaml")


def test_a_rig_is_read_where_the_working_folder_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    os.rmdir(tmp_path / "gone")
    assert load_rig(PROBE, None, ["seed=3"]).config.seed == 3
    with pytest.raises(RigError, match="the working folder is gone"):
        load_rig("rig.yaml")
    with pytest.raises(RigError, match=str(PROBE)):
        load_rig(PROBE, text=f"{BASE}seed: x\n")


def test_line_ends_and_marks_of_other_systems_are_read(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + BASE.replace("\n", "\r\n").encode() + b"seed: 3\r\n")
    assert load_rig(file).config.seed == 3
