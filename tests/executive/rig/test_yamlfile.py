"""Strict YAML: YAML 1.2 scalars, places, bases, refusals, and dump as the inverse of load."""

import random
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from places import ROOT

from pcpc.executive.errors import RigError, did_you_mean, near_file
from pcpc.executive.rig import yaml_parser, yamlfile
from pcpc.executive.rig.yaml_parser import reads_the_same
from pcpc.executive.rig.yamlfile import Document, Keys, Place, dump, load, parse_scalar, parse_value

PLANTS = ROOT / "plants"


def document(folder: Path, text: str, name: str = "rig.yaml") -> Document:
    file = folder / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return load(file)


def message(folder: Path, text: str) -> str:
    with pytest.raises(RigError) as caught:
        document(folder, text)
    assert "\n" not in str(caught.value), caught.value
    return str(caught.value).replace(f"{folder.resolve()}/", "")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1e-3", 1e-3), ("1E5", 1e5), (".5", 0.5), ("5.", 5.0), ("-2", -2), ("+7", 7), ("0", 0),
        ("0.0", 0.0), ("0x1F", 31), (".inf", float("inf")), ("-.inf", float("-inf")),
        ("yes", "yes"), ("no", "no"), ("on", "on"), ("off", "off"), ("true", True), ("null", None),
        ("1:30", "1:30"), ("1_000", "1_000"), ("2020-01-01", "2020-01-01"), ("=", "="), ("", None),
        ("inf", "inf"), ("nan", "nan"), ("'1'", "1"), ('"null"', "null"),
    ],
)  # fmt: skip
def test_scalars_are_those_of_yaml_1_2(tmp_path: Path, text: str, expected: Any) -> None:
    read = document(tmp_path, f"a: {text}\n").data["a"]
    assert read == expected and type(read) is type(expected), f"{text} -> {read!r}"


@pytest.mark.parametrize(
    "text", ["010", "-007", "08.5", "0o10", ".nan", "1e999", "9" * 30, "9" * 5000]
)
def test_numbers_that_hide_a_mistake_are_refused_with_their_place(
    tmp_path: Path, text: str
) -> None:
    what = message(tmp_path, f"b: 1\na: [2, {text}]\n")
    assert what.startswith("rig.yaml:2:8: ") and ";" in what, what


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: 1\nb: 2\na: 3\n", "rig.yaml:3:1: a: given twice, first at FOLDER/rig.yaml:1:1; "),
        ("a: {x: 1, x: 2}\n", "rig.yaml:1:11: x: given twice"),
        ("a:\n\tb: 1\n", "rig.yaml:2:1: found a tab; indent with spaces"),
        ("a: b: c\n", "rig.yaml:1:5: mapping values are not allowed here"),
        ("a: [1, 2\n", "rig.yaml:2:1: "),
        ("a: 'x\n", "rig.yaml:2:1: "),
        ("a: &x 1\nb: *x\n", "rig.yaml:1:4: anchors are not supported; share values with `base:`"),
        ("a: {<<: {b: 1}}\n", "rig.yaml:1:5: merge keys are not supported"),
        ("a: !!python/name:os.system 1\n", "rig.yaml:1:4: tag "),
        ("a: !!str 1\n", "rig.yaml:1:4: tag "),
        ("? [1]\n: 2\n", "rig.yaml:1:3: expected text as the key"),
        ("'': 2\n", "rig.yaml:1:1: expected text as the key"),
        ("- 1\n", "rig.yaml:1:1: expected a mapping"),
        ("", "rig.yaml:1:1: expected a mapping"),
        ("a: 1\n---\nb: 1\n", "rig.yaml:2:1: but found another document"),
        ("a: 1\nb: \x07\n", "rig.yaml:2:4: character "),
        ("a: " + "[" * 1000 + "\n", "rig.yaml:1:1: nested too deeply"),
        ("base: 3\n", "rig.yaml:1:1: base: expected the path of a file"),
        ("x: 1\nbase: gone.yaml\n", "rig.yaml:2:1: base: FOLDER/gone.yaml: no such file"),
    ],
)
def test_a_bad_file_is_refused_in_one_line_with_its_place(
    tmp_path: Path, text: str, expected: str
) -> None:
    with pytest.raises(RigError) as caught:
        document(tmp_path, text)
    folder = str(tmp_path.resolve())
    assert str(caught.value).startswith(f"{folder}/{expected.replace('FOLDER', folder)}"), (
        caught.value
    )
    assert "\n" not in str(caught.value), caught.value


def test_a_missing_or_unreadable_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "latin.yaml").write_bytes(b"a: \xe9\n")
    cases = {"gone.yaml": "no such file", ".": "Is a directory", "latin.yaml": "not UTF-8 text"}
    for name, reason in cases.items():
        with pytest.raises(RigError, match=reason):
            load(tmp_path / name)


def test_every_path_has_the_place_of_its_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = document(tmp_path, "a:\n  b: [{c: 1}, {c: 2}, {x: 0, c: 3}]\nt: {CMD.tau: u.y}\n")
    monkeypatch.chdir(tmp_path)
    assert read.where("a.b[2].c") == "rig.yaml:2:30"
    assert read.where("a.b[1]") == "rig.yaml:2:15"
    assert read.where("t.CMD.tau") == "rig.yaml:3:5"
    assert read.where(("t", "CMD.tau")) == "rig.yaml:3:5"
    assert read.where("a.b[7].nothing") == "rig.yaml:2:3", "the nearest thing around it"
    assert read.where("") == read.where("zzz") == "rig.yaml:1:1"
    assert str(read.error("a.b", "what; cure")) == "rig.yaml:2:3: a.b: what; cure"
    monkeypatch.chdir("/")
    assert read.where("a") == f"{str(tmp_path.resolve())[1:]}/rig.yaml:1:1"


def test_a_file_goes_over_its_base(tmp_path: Path) -> None:
    document(tmp_path, "a: {x: 1, y: [1, 2], z: {k: 1, l: 2}}\nb: 5\nc: {d: 1}\n", "top.yaml")
    document(tmp_path, "base: ../top.yaml\na: {z: {k: 7}}\nc: scalar\n", "mid/mid.yaml")
    read = document(tmp_path, "base: mid/mid.yaml\na: {y: [3], x: null, w: 4}\nn: null\n")
    assert read.data == {
        "a": {"y": [3], "z": {"k": 7, "l": 2}, "w": 4},
        "b": 5,
        "c": "scalar",
        "n": None,
    }
    assert read.text.startswith("base: mid/mid.yaml") and len(read.sources) == 3
    place = {name: read.where(name).removeprefix(f"{tmp_path.resolve()}/") for name in (
        "a", "a.y", "a.y[0]", "a.z.k", "a.z.l", "b", "c", "c.d",
    )}  # fmt: skip
    assert place == {
        "a": "rig.yaml:2:1", "a.y": "rig.yaml:2:5", "a.y[0]": "rig.yaml:2:9",
        "a.z.k": "mid/mid.yaml:2:9", "a.z.l": "top.yaml:1:32", "b": "top.yaml:2:1",
        "c": "mid/mid.yaml:3:1", "c.d": "mid/mid.yaml:3:1",
    }  # fmt: skip
    assert read.place("c").folder == tmp_path.resolve() / "mid", "relative paths start there"


def test_the_order_is_the_bases_unless_the_file_names_every_key(tmp_path: Path) -> None:
    document(tmp_path, "s: {a: 1, b: 2, c: 3}\n", "base.yaml")
    kept = document(tmp_path, "base: base.yaml\ns: {d: 4, c: 5}\n")
    assert list(kept.data["s"]) == ["a", "b", "c", "d"]
    ruled = document(tmp_path, "base: base.yaml\ns: {c: 5, d: 4, b: null, a: 1}\n")
    assert list(ruled.data["s"]) == ["c", "d", "a"]


def test_files_that_build_on_each_other_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("base: b.yaml\n")
    (tmp_path / "b.yaml").write_text("x: 1\nbase: a.yaml\n")
    with pytest.raises(
        RigError, match=r"b.yaml:2:1: base: the files build on each other: "
    ) as caught:
        load(tmp_path / "a.yaml")
    assert str(caught.value).count("a.yaml") == 2 and "->" in str(caught.value), caught.value


def test_a_put_value_is_placed_at_its_option(tmp_path: Path) -> None:
    read = document(tmp_path, "a: {b: {c: 1}}\n")
    place = Place(read.path, option="--set a.b=2")
    read.put(("a", "b"), 2, place)
    read.put(("new", "deep"), 3, place)
    assert read.data == {"a": {"b": 2}, "new": {"deep": 3}}
    assert str(read.error("a.b", "wrong")) == "--set a.b=2: wrong"
    assert read.where("a.b.c") == "--set a.b=2", "nothing is left of what was there"


def test_an_options_value_is_read_like_one_in_a_file(tmp_path: Path) -> None:
    place = Place(tmp_path, option="--set x=010")
    assert parse_value("[1, 2e3]", place) == [1, 2e3] and parse_value("", place) is None
    assert parse_value("yes", place) == "yes"
    for text in ("010", "[1", "{a: 1, a: 2}", "*x"):
        with pytest.raises(RigError, match=r"^--set x=010: "):
            parse_value(text, place)


def test_a_colon_without_a_blank_is_no_key(tmp_path: Path) -> None:
    """YAML reads {a:1} as a key "a:1" of nothing."""
    place = Place(tmp_path, option="--set x={a:1}")
    for text in ("{a:1}", "{b: 1, a:1}", "[{a:1}]"):
        with pytest.raises(RigError, match=r"a:1: write a blank behind the colon$"):
            parse_value(text, place)
    assert parse_value('{"a:1": , b:c: 2}', place) == {"a:1": None, "b:c": 2}


def test_did_you_mean_looks_past_the_unit() -> None:
    names = ["kp_Nm_rad", "kv_Nms_rad", "torque_max_Nm"]
    assert did_you_mean("kvv", names) == "; did you mean kv_Nms_rad?"
    assert did_you_mean("controller.torque", [f"controller.{n}" for n in names]).endswith("max_Nm?")
    assert did_you_mean("zzz", names) == "; known: kp_Nm_rad, kv_Nms_rad, torque_max_Nm"
    assert did_you_mean("zzz", []) == "" == did_you_mean("zzz", map(str, range(100)))


def test_what_is_suggested_is_another_file_that_would_do(tmp_path: Path) -> None:
    (tmp_path / "motors").mkdir()
    (tmp_path / "motor.yaml").touch()
    for text, cure in (("motr.yaml", "motor.yaml"), ("motor.yaml", ""), ("motor", "motor.yaml")):
        wanted = f"; did you mean {tmp_path / cure}?" if cure else ""
        assert near_file(tmp_path / text) == wanted, text
    assert near_file(tmp_path / "motor", Path.is_dir) == f"; did you mean {tmp_path / 'motors'}?"
    assert near_file(Path("/")) == near_file(tmp_path) == ""
    assert "there is no folder" in near_file(tmp_path / "none/motor.yaml")


SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False)
    | st.text(st.characters(codec="utf-8"), max_size=20)
    | st.sampled_from(["1e-3", "yes", "010", ".5", "<<", "=", "~", "0x1", "1_0", " a", "a: b", "#"])
)
KEYS = st.text(st.characters(codec="utf-8"), min_size=1, max_size=8).filter(
    lambda key: key != "base"
)
DATA = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner)
)


@settings(max_examples=50, suppress_health_check=list(HealthCheck), deadline=None)
@given(st.dictionaries(KEYS, DATA, max_size=4))
def test_what_is_dumped_is_read_back(data: dict[str, Any]) -> None:
    text = dump(data)
    read = load("/nowhere/rig.yaml", text).data
    assert repr(read) == repr(data), text


LINES = st.text(st.sampled_from("ab :,#-?'\"\n{}[]&*!|>%@`.0"), max_size=130)


@settings(max_examples=100, suppress_health_check=list(HealthCheck), deadline=None)
@given(st.dictionaries(KEYS | LINES.filter(bool), DATA | LINES, max_size=4))
@example({"0" * 123: None})
@example({"a": "\U0001f600"})
@example({"a": "\udc80"})
def test_libyaml_writes_the_bytes_of_pyyaml(data: dict[str, Any]) -> None:
    texts = [yamlfile._yaml_text(data, yamlfile._Slow, readable) for readable in (True, False)]
    assert dump(data) in texts


def test_libyaml_writes_the_shipped_rigs(monkeypatch: pytest.MonkeyPatch) -> None:
    rigs = [rig for rig in PLANTS.glob("*/rigs/*.yaml") if reads_the_same(rig.read_text())]
    documents = [load(rig).data for rig in rigs]
    slow = [yamlfile._yaml_text(data, yamlfile._Slow, True) for data in documents]
    monkeypatch.delattr(yamlfile, "_Slow")
    assert len(rigs) > 20 and [dump(data) for data in documents] == slow


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_way_to_write_a_float_reads_as_that_float(number: float) -> None:
    for text in (repr(number), f"{number:.17e}", f"{number:.17E}"):
        assert parse_scalar(text) == number, text


def tree(node: Any) -> Any:
    """Return kind, place, style and content of a tree of PyYAML's."""
    if isinstance(node.value, str):
        content = node.value
    else:
        content = [
            [tree(n) for n in (pair if isinstance(pair, tuple) else [pair])] for pair in node.value
        ]
    style = getattr(node, "style", None) or None
    return node.id, node.start_mark.line, node.start_mark.column, style, content


def test_both_parsers_read_the_same_from_the_same_place() -> None:
    draw = random.Random(1)
    rigs = [path.read_text() for path in sorted(PLANTS.glob("**/*.yaml"))]
    texts = [*rigs]
    for _ in range(600):
        whole = draw.choice(rigs)
        begin = draw.randrange(max(1, len(whole) - 300))
        text = list(whole[begin : begin + 300])
        for _ in range(draw.randrange(1, 6)):
            text[draw.randrange(len(text))] = draw.choice("{}[]:,-#!&*|>'\"%@` \n.~0e1a")
        texts.append("".join(text))
    quick = 0
    for text in texts:
        try:
            slow = yaml_parser.SlowLoader(text).get_single_node()
        except (yaml.YAMLError, ValueError):
            with pytest.raises(yaml.YAMLError):
                yaml_parser.compose(text)
            continue
        assert tree(yaml_parser.compose(text)) == tree(slow), text
        quick += yaml_parser.reads_the_same(text)
    assert quick > len(rigs), "libyaml read too few of them"


@pytest.mark.parametrize(
    ("path", "column"),
    [
        ("a", 1), ("a.b", 23), ("a.b.c", 5), ("a.b.x", 23), ("a.b[1]", 23), ("a.b.c[1].d", 15),
        ("a.b.c[1]", 14), ("a.b.c[7]", 5), ("a.bc", 1), ("a.b.c.d", 5), ("e", 1), ("", 1),
        (("a", "b.c", 1, "d"), 15), (("a", "b.c", 1, "x"), 14), (("a", "b", "c"), 23), ((), 1),
    ],
)  # fmt: skip
def test_a_path_has_the_place_of_its_nearest_key(path: str | Keys, column: int) -> None:
    """Keys may have dots: `b.c` beside `b`."""
    assert load("x.yaml", "a: {b.c: [1, {d: 2}], b: 3}\n").place(path).column == column


def test_a_key_that_is_gone_keeps_its_place_and_what_is_put_brings_its_own() -> None:
    found = load("x.yaml", "a: {b: {c: 1}}\n")
    found.data["a"].take("d", found.data["a"], "b")
    del found.data["a"]["b"]
    found.data["a"]["d"]["c"] = 2
    assert found.place("a.b").column == found.place("a.d").column == 5
    assert found.place("a.d.c").column == 9 and load("x.yaml", found.text).data["a"]["b"]["c"] == 1
    found.put(("e", "f"), 3, Place(Path(), option="--set e.f=3"))
    assert found.where("e.f") == "--set e.f=3" and found.place("e.g").line == 1
    assert dump(found.data) == "a:\n  d:\n    c: 2\ne:\n  f: 3\n"
