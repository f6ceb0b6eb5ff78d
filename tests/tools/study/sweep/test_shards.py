"""What shards come to as one table: one campaign, each run once, none missing; else a refusal."""

import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet
import pytest

from pcpc.drivers.errors import UserError
from pcpc.executive.errors import RigError
from pcpc.tools.cli import main
from pcpc.tools.study.engine import Row
from pcpc.tools.study.sweep import shards, store
from pcpc.tools.study.sweep.campaign import Shard
from pcpc.tools.study.sweep.results import RAN, REFUSED

SPEC: dict[str, Any] = {
    "rig": "arm.yaml", "title": "an arm", "controllers": ["pid", "pd"], "vary": ["arm.m=1:2"],
    "variations": ["arm.m=1:2"], "draws": 64, "sampling": "random", "seed": 1, "settings": [],
    "origin": {"rig": "a", "law.py": "b"},
}  # fmt: skip


def row(draw: int, controller: str) -> Row:
    return Row(draw, controller, 1 + draw, {"arm.m": 1.5}, RAN, True, metrics={"rms": draw / 3.0})


def shard(folder: Path, number: int, of: int, spec: dict[str, Any] = SPEC) -> Path:
    """Write a shard of a campaign whose runs are all ok."""
    own = store.Store(folder, spec, Shard(number, of))
    draws = range(number - 1, spec["draws"], of)
    own.add(row(draw, name) for draw in draws for name in spec["controllers"])
    own.complete()
    own.close()
    return own.table


def refused(folders: Sequence[Path]) -> str:
    with pytest.raises(RigError) as error:
        shards.merge(folders)
    return str(error.value)


def test_all_shards_are_the_whole_in_one_folder_or_several(tmp_path: Path) -> None:
    shard(tmp_path / "whole", 1, 1)
    whole, _ = shards.merge([tmp_path / "whole"])
    for number in (3, 1, 4, 2):
        shard(tmp_path / "one", number, 4)
        shard(tmp_path / str(number), number, 4)
    assert shards.merge([tmp_path / "one"])[0].equals(whole)
    assert shards.merge([tmp_path / str(n) for n in (4, 2, 1, 3)])[0].equals(whole)
    for number, of in ((1, 2), (2, 4), (4, 4)):
        shard(tmp_path / "mixed", number, of)
    assert shards.merge([tmp_path / "mixed"])[0].equals(whole), "of 2 and of 4, none twice"


@pytest.mark.parametrize(
    ("there", "what"),
    [
        ([1], "48 of 64 draws are missing, those of shards 2, 3, 4 of 4; do them"),
        ([4, 2, 3], "16 of 64 draws are missing, those of shard 1 of 4; do them"),
        ([2, 2], "48 of 64 draws are missing, those of shards 1, 3, 4 of 4"),
    ],
)
def test_a_shard_that_is_missing_is_named(there: list[int], what: str, tmp_path: Path) -> None:
    for i, number in enumerate(there):
        shard(tmp_path / str(i), number, 4)
    assert what in refused([tmp_path / str(i) for i in range(len(there))])


def test_merge_of_one_of_four_shards_is_no_campaign(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shard(tmp_path, 1, 4)
    assert main(["sweep", "merge", str(tmp_path)]) == 2
    told = capsys.readouterr()
    assert "48 of 64 draws are missing" in told.err and told.out == ""
    assert not (tmp_path / "report.html").exists()


def test_a_shard_that_was_killed_is_missing(tmp_path: Path) -> None:
    shard(tmp_path, 1, 2)
    half = store.Store(tmp_path, SPEC, Shard(2, 2))
    half.add([row(1, "pid"), row(1, "pd"), row(3, "pid")])
    half.close()
    assert "32 of 64 draws are missing, those of shard 2 of 2" in refused([tmp_path])


def test_a_table_that_lost_rows_is_not_whole(tmp_path: Path) -> None:
    for number in (1, 2):
        path = shard(tmp_path, number, 2)
    pyarrow.parquet.write_table(store.with_seal(pyarrow.parquet.read_table(path)[:-1]), path)
    assert "1 of 64 draws are missing, those of shard 2 of 2" in refused([tmp_path])


def test_the_same_shard_twice_counts_once_if_it_is_the_same(tmp_path: Path) -> None:
    for number in (1, 2):
        shard(tmp_path / "a", number, 2)
    path = shard(tmp_path / "b", 2, 2)
    folders = [tmp_path / "a", tmp_path / "b"]
    assert shards.merge(folders)[0].num_rows == 128
    shard(tmp_path / "a", 1, 1)
    assert shards.merge([*folders, tmp_path / "a"])[0].num_rows == 128, "overlapping, and twice"
    table = pyarrow.parquet.read_table(path)
    metric = pa.array([1.0, *table["metric:rms"].to_pylist()[1:]])
    place = table.column_names.index("metric:rms")
    other = store.with_seal(table.set_column(place, "metric:rms", metric))
    pyarrow.parquet.write_table(other, path)
    said = refused(folders)
    assert str(path) in said and "draw 1 of pid had another result the second time" in said


@pytest.mark.parametrize(
    ("other", "what"),
    [
        ({"seed": 2}, "seed"),
        ({"draws": 60}, "draws"),
        ({"settings": ["arm.k=1"]}, "settings"),
        ({"controllers": ["pd", "pid"]}, "controllers"),
        ({"origin": {"rig": "a", "law.py": "c"}}, "law.py"),
        ({"origin": {"rig": "a", "law.py": "b", "data.csv": "d"}}, "data.csv"),
        ({"until": "p_fail < 0.1 at 90%"}, "until"),
    ],
)
def test_shards_of_two_campaigns_are_refused_also_in_one_folder(
    other: dict[str, Any], what: str, tmp_path: Path
) -> None:
    shard(tmp_path / "a", 1, 2)
    path = shard(tmp_path / "b", 2, 2, SPEC | other)
    said = refused([tmp_path / "a", tmp_path / "b"])
    assert said == (
        f"{tmp_path / 'b'}: another campaign than that of {tmp_path / 'a'}; it differs in {what}; "
        "merge one at a time"
    )
    moved = Path(shutil.copy(path, tmp_path / "a"))
    assert f"{moved}: belongs to another campaign than its folder; it differs in {what}" in refused(
        [tmp_path / "a"]
    )


def test_a_table_of_other_runs_than_its_name_says_is_refused(tmp_path: Path) -> None:
    path = shard(tmp_path, 1, 2)
    path.rename(tmp_path / "shard-2-of-2.parquet")
    shard(tmp_path, 1, 2)
    assert "rows that are not of shard 2 of 2; do it again" in refused([tmp_path])


@pytest.mark.parametrize(
    "wrong",
    [
        {"draw": -1}, {"draw": 64}, {"draw": None}, {"controller": "lqr"}, {"controller": None},
        {"outcome": "fine"}, {"outcome": None},
    ],
    ids=str,
)  # fmt: skip
def test_rows_that_no_campaign_writes_are_refused(wrong: dict[str, Any], tmp_path: Path) -> None:
    path = shard(tmp_path, 1, 1)
    table = pyarrow.parquet.read_table(path)
    rows = table.to_pylist()
    rows[0] |= wrong
    pyarrow.parquet.write_table(pa.Table.from_pylist(rows, schema=table.schema), path)
    assert "rows that are not of shard 1 of 1" in refused([tmp_path])


CHANGES: list[dict[str, Any]] = [
    {"seed": 9}, {"vary:arm.m": 1.25}, {"metric:rms": 0.0}, {"metric:rms": float("nan")},
    {"ok": False}, {"ok": None}, {"why": "x"}, {"alone": "x"},
]  # fmt: skip


@pytest.mark.parametrize("change", CHANGES, ids=str)
def test_a_table_with_a_changed_row_is_refused(change: dict[str, Any], tmp_path: Path) -> None:
    for number in (1, 2):
        path = shard(tmp_path, number, 2)
    table = pyarrow.parquet.read_table(path)
    rows = table.to_pylist()
    rows[3] |= change
    pyarrow.parquet.write_table(pa.Table.from_pylist(rows, schema=table.schema), path)
    what = "its rows are not those that were written; remove it and do it again"
    assert refused([tmp_path]) == f"{path}: {what}"


def test_a_table_without_its_last_rows_or_with_one_twice_is_refused(tmp_path: Path) -> None:
    path = shard(tmp_path, 1, 1)
    table = pyarrow.parquet.read_table(path)
    for wrong in (table[:-3], pa.concat_tables([table, table[:1]]), table[:0]):
        pyarrow.parquet.write_table(wrong, path)
        assert "its rows are not those that were written" in refused([tmp_path])
    other = table.replace_schema_metadata(table.schema.metadata | {b"outcome": b"p_fail = 0"})
    pyarrow.parquet.write_table(other, path)
    assert "its rows are not those that were written" in refused([tmp_path])
    pyarrow.parquet.write_table(table, path, compression="zstd", row_group_size=7)
    assert shards.merge([tmp_path])[0].equals(table), "rows in other groups are the same rows"


@pytest.mark.parametrize("change", [("true", "false"), ("1.5", "1.6"), ('"ran"', '"fault"')])
def test_a_changed_line_of_a_journal_is_done_again(change: tuple[str, str], tmp_path: Path) -> None:
    own = store.Store(tmp_path, SPEC, Shard())
    own.add(row(draw, "pid") for draw in range(4))
    own.close()
    lines = own.journal.read_text().splitlines(keepends=True)
    changed = lines[2].replace(*change)
    assert changed != lines[2]
    own.journal.write_text("".join([*lines[:2], changed, *lines[3:]]))
    again = store.Store(tmp_path, SPEC, Shard())
    assert sorted(again.rows) == [(0, "pid"), (1, "pid")]
    again.close()


def test_what_was_merged_into_another_folder_is_a_campaign_too(tmp_path: Path) -> None:
    for number in (1, 2):
        shard(tmp_path / str(number), number, 2)
    parts, whole = [str(tmp_path / "1"), str(tmp_path / "2")], tmp_path / "whole"
    assert main(["sweep", "merge", *parts, "-o", str(whole)]) == 0
    assert shards.merge([whole])[0].equals(shards.merge([Path(one) for one in parts])[0])
    shard(tmp_path / "other", 1, 1, SPEC | {"seed": 2})
    before = sorted((tmp_path / "other").iterdir())
    assert main(["sweep", "merge", *parts, "-o", str(tmp_path / "other")]) == 2
    assert sorted((tmp_path / "other").iterdir()) == before


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("more", [1.0]), ("metric:rms", ["x"]), ("draw", [0.0]), ("ok", [1.0]), ("draw", None),
        ("held:x", [1.0]), ("vary:arm.k", [1.0]), ("why", None), ("seed", ["1"]),
    ],
)  # fmt: skip
def test_columns_that_no_campaign_writes_are_refused(
    name: str, values: list[Any] | None, tmp_path: Path
) -> None:
    path = shard(tmp_path, 1, 1)
    table = pyarrow.parquet.read_table(path)
    rest = [one for one in table.column_names if one != name]
    made = table.select(rest)
    if values:
        made = made.append_column(name, pa.array(values * table.num_rows))
    pyarrow.parquet.write_table(made, path)
    assert f"no table of a shard: {'' if values else 'no '}column {name}" in refused([tmp_path])


@pytest.mark.parametrize("name", ["shard-0-of-2", "shard-1-of-0", "shard-9-of-2", "shard-3-of-4"])
def test_a_table_with_the_name_of_another_shard_is_refused(name: str, tmp_path: Path) -> None:
    path = shard(tmp_path, 1, 2)
    shard(tmp_path, 2, 2)
    shutil.copy(path, tmp_path / f"{name}.parquet")
    assert "holds rows that are not of shard" in refused([tmp_path])


@pytest.mark.parametrize("file", ["sweep.json", "shard-1-of-1.parquet"])
@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_what_is_no_file_is_told_at_once(
    make: Callable[[Path], None], file: str, tmp_path: Path
) -> None:
    shard(tmp_path, 1, 1)
    (tmp_path / file).unlink()
    make(tmp_path / file)
    assert "it is not a readable file" in refused([tmp_path])


@pytest.mark.parametrize("meta", [None, {"pcpc": "{"}, {"pcpc": "[1]"}, {"pcpc": "3"}])
def test_a_table_that_does_not_say_of_which_campaign_is_refused(
    meta: dict[str, str] | None, tmp_path: Path
) -> None:
    path = shard(tmp_path, 1, 1)
    table = pyarrow.parquet.read_table(path)
    pyarrow.parquet.write_table(table.replace_schema_metadata(meta), path)
    what = "belongs to another campaign" if meta is None else "no table of a shard"
    assert what in refused([tmp_path])


@pytest.mark.parametrize(
    "wrong",
    [
        ["rerun", "rows", "9" * 5000], ["rerun", "rows", "9" * 18], ["rerun", "none", "0"],
        ["merge", "rows", "-o", "file"], ["merge", "rows", "-o", "file/x"],
        ["merge", "rows", "-o", "a\0"], ["merge", "a\0"], ["merge", "x" * 5000],
    ],
    ids=lambda words: " ".join(words)[:20],
)  # fmt: skip
def test_a_wrong_folder_or_draw_is_a_line_and_leaves_nothing(
    wrong: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    shard(Path("rows"), 1, 1)
    shard(Path("none"), 5, 8, SPEC | {"draws": 4})
    before = sorted(Path().rglob("*"))
    assert main(["sweep", *wrong]) == 2
    told = capsys.readouterr()
    assert told.out == "" and told.err.count("\n") == 1
    assert sorted(Path().rglob("*")) == before


def test_a_campaign_whose_runs_were_all_refused_is_wrong_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = store.Store(tmp_path, SPEC | {"title": "\x1b[31m red"}, Shard())
    for draw in range(SPEC["draws"]):
        own.add(
            replace(row(draw, name), outcome=REFUSED, ok=False, why="m = -1 is outside 0..9")
            for name in SPEC["controllers"]
        )
    own.complete()
    own.close()
    assert main(["sweep", "merge", str(tmp_path)]) == 2
    told = capsys.readouterr()
    assert "all runs were refused: m = -1 is outside 0..9" in told.err
    assert "refused" in told.out and "\x1b" not in told.out


def test_a_journal_that_is_no_file_leaves_no_campaign(tmp_path: Path) -> None:
    (tmp_path / "shard-1-of-1.jsonl").mkdir()
    with pytest.raises(UserError, match="Is a directory; choose another"):
        store.Store(tmp_path, SPEC, Shard())
    assert [path.name for path in tmp_path.iterdir()] == ["shard-1-of-1.jsonl"]


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1" * 100, b"\0" * 4096])
def test_what_is_no_table_is_told(content: bytes, tmp_path: Path) -> None:
    shard(tmp_path, 1, 1).write_bytes(content)
    assert "shard-1-of-1.parquet: no table of a shard: " in refused([tmp_path])
    pyarrow.parquet.write_table(pa.table({"x": [1]}), tmp_path / "shard-1-of-1.parquet")
    assert "no table of a shard" in refused([tmp_path])


@pytest.mark.parametrize(
    "text",
    [
        "", "[]", "{}", "null", "{", "[" * 100_000, "\xff", json.dumps(SPEC | {"draws": "64"}),
        json.dumps(SPEC | {"draws": -1}), json.dumps(SPEC | {"controllers": []}),
        json.dumps(SPEC | {"origin": {"rig": 1}}), json.dumps(SPEC | {"seed": None}),
        json.dumps({name: value for name, value in SPEC.items() if name != "origin"}),
    ],
    ids=lambda text: text[:20],
)  # fmt: skip
def test_a_spec_that_is_none_is_told(text: str, tmp_path: Path) -> None:
    shard(tmp_path, 1, 1)
    (tmp_path / store.SPEC).write_bytes(text.encode("latin-1"))
    assert f"{tmp_path / store.SPEC}: no campaign: " in refused([tmp_path])


def test_a_campaign_of_which_nothing_came_leaves_nothing(tmp_path: Path) -> None:
    store.Store(tmp_path / "a", SPEC, Shard()).close()
    assert not list((tmp_path / "a").iterdir())
    shard(tmp_path / "b", 1, 2)
    store.Store(tmp_path / "b", SPEC, Shard(2, 2)).close()
    assert len(list((tmp_path / "b").iterdir())) == 2, "sweep.json, and the table of the other"


def test_rows_of_a_run_without_a_value_are_the_same_alone_and_merged(tmp_path: Path) -> None:
    own = store.Store(tmp_path, SPEC | {"draws": 2}, Shard(1, 2))
    own.add(replace(row(0, name), metrics={"only": 1.0}) for name in SPEC["controllers"])
    own.complete()
    own.close()
    shard(tmp_path, 2, 2, SPEC | {"draws": 2})
    table, _ = shards.merge([tmp_path])
    assert repr(table["metric:only"].to_pylist()) == "[1.0, 1.0, nan, nan]"
