"""What shards come to as one table: one campaign, each run once, none missing; else a refusal."""

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError
from pcpc.tools.cli import main
from pcpc.tools.study.engine import RunVerdict
from pcpc.tools.study.sweep import shards, store
from pcpc.tools.study.sweep.campaign import Shard
from pcpc.tools.study.sweep.results import RAN, REFUSED

SPEC: dict[str, Any] = {
    "rig": "arm.yaml", "title": "an arm", "controllers": ["pid", "pd"], "vary": ["arm.m=1:2"],
    "variations": ["arm.m=1:2"], "draws": 64, "sampling": "random", "seed": 1, "settings": [],
    "origin": {"rig": "a", "law.py": "b"},
}  # fmt: skip


def row(draw: int, controller: str) -> RunVerdict:
    return RunVerdict(
        draw, controller, 1 + draw, {"arm.m": 1.5}, RAN, True, metrics={"rms": draw / 3.0}
    )


def shard(folder: Path, number: int, of: int, spec: dict[str, Any] = SPEC) -> Path:
    """Write a shard of a campaign whose runs are all ok."""
    own = store.Store(folder, spec, Shard(number, of))
    draws = range(number - 1, spec["draws"], of)
    own.add(row(draw, name) for draw in draws for name in spec["controllers"])
    own.complete()
    own.close()
    return own.path


def changed(path: Path, *statements: str) -> None:
    """Change a file as any program may."""
    with closing(sqlite3.connect(path)) as db, db:
        for one in statements:
            db.execute(one)


def with_its_digest(path: Path) -> None:
    """Write the digest of the rows that are there now."""
    with closing(sqlite3.connect(path)) as db, db:
        store.write_digest(db, store.sum_of(db.execute("SELECT * FROM run")))


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


def test_one_of_four_shards_is_no_campaign_but_has_its_draws(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shard(tmp_path, 1, 4)
    assert main(["sweep", "merge", str(tmp_path)]) == 2
    told = capsys.readouterr()
    assert "48 of 64 draws are missing" in told.err and told.out == ""
    assert not (tmp_path / "report.html").exists()
    assert main(["sweep", "rerun", str(tmp_path), "3"]) == 2
    assert "no draw 3 of pid; it has 0 to 60" in capsys.readouterr().err


def test_a_shard_that_was_killed_is_missing(tmp_path: Path) -> None:
    shard(tmp_path, 1, 2)
    half = store.Store(tmp_path, SPEC, Shard(2, 2))
    half.add([row(1, "pid"), row(1, "pd"), row(3, "pid")])
    while_it_goes_on = refused([tmp_path])
    half.close()
    assert "32 of 64 draws are missing, those of shard 2 of 2" in while_it_goes_on
    assert refused([tmp_path]) == while_it_goes_on
    assert shards.merge([tmp_path], whole=False)[0].num_rows == 64


def test_rows_that_are_lost_with_their_digest_are_missing(tmp_path: Path) -> None:
    for number in (1, 2):
        path = shard(tmp_path, number, 2)
    changed(path, "DELETE FROM run WHERE draw = 63 AND controller = 'pd'")
    with_its_digest(path)
    assert "1 of 64 draws are missing, those of shard 2 of 2" in refused([tmp_path])


def test_the_same_shard_twice_counts_once_if_it_is_the_same(tmp_path: Path) -> None:
    for number in (1, 2):
        shard(tmp_path / "a", number, 2)
    path = shard(tmp_path / "b", 2, 2)
    folders = [tmp_path / "a", tmp_path / "b"]
    assert shards.merge(folders)[0].num_rows == 128
    shard(tmp_path / "a", 1, 1)
    assert shards.merge([*folders, tmp_path / "a"])[0].num_rows == 128, "overlapping, and twice"
    change = "replace(row, 'rms', 'RMS')"
    changed(path, f"UPDATE run SET row = {change} WHERE draw = 1 AND controller = 'pid'")
    with_its_digest(path)
    first = tmp_path / "a" / "shard-1-of-1.sqlite"
    what = "draw 1 of pid had another result the second time; one of the two is wrong"
    assert refused(folders) == f"{first} and {path}: {what}"
    shard(tmp_path / "c", 1, 2)
    others = [tmp_path / "c", *reversed(folders)]
    assert refused(others) == f"{path} and {first}: {what}", "whichever is less"


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


@pytest.mark.parametrize("name", ["shard-2-of-2", "shard-1-of-1", "shard-3-of-4"])
def test_a_file_with_the_name_of_another_shard_is_refused(name: str, tmp_path: Path) -> None:
    path = shard(tmp_path, 1, 2)
    shard(tmp_path, 2, 2)
    shutil.copy(path, tmp_path / f"{name}.sqlite")
    assert f"holds rows that are not of {name} but of shard-1-of-2" in refused([tmp_path])


OTHER_ROWS = "its rows are not those that were written; remove it and do it again"
CHANGES = {
    "UPDATE run SET row = replace(row, 'true', 'false') WHERE draw = 9": OTHER_ROWS,
    "UPDATE run SET row = replace(row, '1.5', '1.6') WHERE draw = 9": OTHER_ROWS,
    "UPDATE run SET draw = 99 WHERE draw = 9": OTHER_ROWS,
    "UPDATE run SET controller = 'lqr' WHERE draw = 9 AND controller = 'pd'": OTHER_ROWS,
    "UPDATE run SET row = CAST(row AS BLOB) WHERE draw = 9": OTHER_ROWS,
    "DELETE FROM run WHERE draw = 63": OTHER_ROWS,
    "DELETE FROM run": OTHER_ROWS,
    "INSERT INTO run SELECT 99, controller, row FROM run WHERE draw = 9": OTHER_ROWS,
    "UPDATE about SET value = replace(value, 'law.py', 'new.py') WHERE key = 'spec'": OTHER_ROWS,
    "UPDATE about SET value = 'p_fail = 0' WHERE key = 'outcome'": OTHER_ROWS,
    "UPDATE about SET value = 'shard-2-of-2' WHERE key = 'shard'": OTHER_ROWS,
    "UPDATE about SET value = upper(value) WHERE key = 'digest'": OTHER_ROWS,
    "DELETE FROM about WHERE key = 'digest'": OTHER_ROWS,
    "DELETE FROM about": OTHER_ROWS,
    "DROP TABLE run": "it has other tables",
    "CREATE TABLE more(x)": "it has other tables",
    "CREATE TRIGGER more AFTER INSERT ON run BEGIN DELETE FROM run; END": "it has other tables",
}


@pytest.mark.parametrize("statement", CHANGES)
def test_what_another_program_has_changed_is_refused_by_all(statement: str, tmp_path: Path) -> None:
    path = shard(tmp_path, 1, 1)
    changed(path, statement)
    assert f"{path}: " in refused([tmp_path]) and CHANGES[statement] in refused([tmp_path])
    with pytest.raises(RigError, match=CHANGES[statement]):
        store.Store(tmp_path, SPEC, Shard())


def test_a_row_that_stands_twice_is_refused(tmp_path: Path) -> None:
    """It needs another table, or bytes that no database has."""
    path = shard(tmp_path, 1, 1)
    old = "PRIMARY KEY(draw, controller)) WITHOUT ROWID"
    with closing(sqlite3.connect(path)) as db, db:
        (text,) = db.execute("SELECT sql FROM sqlite_master WHERE name = 'run'").fetchone()
        rows = db.execute("SELECT * FROM run").fetchall()
        db.execute("DROP TABLE run")
        db.execute(text.replace(f", {old}", ")"))
        db.executemany("INSERT INTO run VALUES (?, ?, ?)", [*rows, rows[7]])
    assert "it has other tables" in refused([tmp_path])
    changed(path, "PRAGMA writable_schema = 1",
            f"UPDATE sqlite_master SET sql = '{text}' WHERE name = 'run'")  # fmt: skip
    assert "no rows of a shard: " in refused([tmp_path])


@pytest.mark.parametrize("kind", ["complete", "broken off"])
def test_a_file_that_was_cut_or_damaged_is_refused(kind: str, tmp_path: Path) -> None:
    """At every page, and within one; what was cut to nothing has no rows."""
    own = store.Store(tmp_path, SPEC, Shard())
    own.add(row(draw, name) for draw in range(64) for name in SPEC["controllers"])
    if kind == "complete":
        own.complete()
    own.close()
    whole = own.path.read_bytes()
    for size in [99, *range(512, len(whole), 4096)]:
        for rest in (b"", bytes(64) + whole[size + 64 :]):
            if whole[:size] + rest == whole:  # nothing stands there
                continue
            own.path.write_bytes(whole[:size] + rest)
            with pytest.raises(RigError) as error:
                store.Store(tmp_path, SPEC, Shard())
            assert str(error.value).endswith("remove it and do it again"), (size, error.value)
            if kind == "complete":
                assert f"{own.path}: " in refused([tmp_path])


def test_a_page_that_no_row_has_is_refused(tmp_path: Path) -> None:
    path = shard(tmp_path, 1, 1)
    whole = path.read_bytes()
    pages = (len(whole) // 4096 + 1).to_bytes(4, "big")
    path.write_bytes(whole[:28] + pages + whole[32:] + bytes(4096))
    assert f"{path}: no rows of a shard: " in refused([tmp_path])
    path.write_bytes(whole)
    assert shards.merge([tmp_path])[0].num_rows == 128


def test_the_last_draw_of_a_campaign_that_its_statement_ended_is_one_of_its_draws(
    tmp_path: Path,
) -> None:
    own = store.Store(tmp_path, SPEC | {"until": "p_fail < 0.1 at 90%"}, Shard())
    own.add([row(0, "pid"), row(0, "pd"), row(1, "pid")])
    own.complete()
    own.close()
    assert "1 of 2 draws are missing; do them" in refused([tmp_path])


@pytest.mark.parametrize(
    "text", ["[]", "{", "{}", "null", '{"seed": "x"}', "[" * 100_000], ids=lambda text: text[:9]
)
def test_what_is_no_row_is_told_with_its_digest_too(text: str, tmp_path: Path) -> None:
    path = shard(tmp_path, 1, 1)
    changed(path, f"UPDATE run SET row = '{text}' WHERE draw = 9")
    with_its_digest(path)
    assert "no rows of a shard: " in refused([tmp_path])


@pytest.mark.parametrize("file", ["shard-1-of-1.parquet", "shard-2-of-4.jsonl"])
def test_a_campaign_of_an_older_version_is_told(file: str, tmp_path: Path) -> None:
    (tmp_path / store.SPEC).write_text(json.dumps(SPEC))
    (tmp_path / file).touch()
    said = f"{tmp_path / file}: rows as an older pcpc kept them; go on with the version that wrote"
    assert said in refused([tmp_path])
    with pytest.raises(RigError, match="rows as an older pcpc kept them"):
        store.Store(tmp_path, SPEC, Shard())


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="Not a directory; choose another folder") as error:
        store.Store(tmp_path / "file" / "a", SPEC, Shard())
    assert error.value.code == Exit.ENVIRONMENT
    path = shard(tmp_path / "a", 1, 2)
    path.with_name(f"{path.name}-wal").mkdir()  # which SQLite has to write
    with pytest.raises(UserError, match=r"1-of-2\.sqlite: .*; choose another folder"):
        store.Store(tmp_path / "a", SPEC, Shard(1, 2))


def test_a_file_that_another_program_holds_is_told(tmp_path: Path) -> None:
    path = shard(tmp_path, 1, 1)
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        said = f"{path}: another process works on this shard; wait for it"
        assert refused([tmp_path]) == said
        with pytest.raises(RigError) as error:
            store.Store(tmp_path, SPEC, Shard())
        assert str(error.value) == said
    assert shards.merge([tmp_path])[0].num_rows == 128


FULL = """
import resource, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from test_shards import SPEC, Shard, row, store
own = store.Store(Path(sys.argv[1]), SPEC, Shard())
own.add(row(0, name) for name in SPEC["controllers"])
resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))
try:
    for draw in range(1, 64):
        own.add([row(draw, name) for name in SPEC["controllers"]])
except Exception as error:
    print(type(error).__name__, int(error.code), error, sep="|")
own.close()
print(len(own))
"""


def test_a_full_disk_is_told_and_loses_no_row_that_was_kept(tmp_path: Path) -> None:
    words = [sys.executable, "-c", FULL, str(tmp_path), str(Path(__file__).parent)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    said, kept = done.stdout.splitlines()
    kind, code, text = said.split("|")
    assert (kind, int(code)) == ("UserError", Exit.LOSS), done
    assert f"{tmp_path / 'shard-1-of-1.sqlite'}: " in text and "; free space there, or" in text
    again = store.Store(tmp_path, SPEC, Shard())
    assert len(again) == int(kept) and 2 <= len(again) < 128
    assert dict(again) == {of: row(*of) for of in again}
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


@pytest.mark.parametrize("file", ["sweep.json", "shard-1-of-1.sqlite"])
@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir])
def test_what_is_no_file_is_told_at_once(
    make: Callable[[Path], None], file: str, tmp_path: Path
) -> None:
    shard(tmp_path, 1, 1)
    (tmp_path / file).unlink()
    make(tmp_path / file)
    assert "it is not a readable file" in refused([tmp_path])


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
    wrong: list[str], refused: Callable[..., None]
) -> None:
    Path("file").touch()
    shard(Path("rows"), 1, 1)
    shard(Path("none"), 5, 8, SPEC | {"draws": 4})
    refused(["sweep", *wrong], "")


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


def test_a_shard_that_is_no_file_leaves_no_campaign(tmp_path: Path) -> None:
    (tmp_path / "shard-1-of-1.sqlite").mkdir()
    with pytest.raises(UserError, match="it is not a readable file; choose another"):
        store.Store(tmp_path, SPEC, Shard())
    assert [path.name for path in tmp_path.iterdir()] == ["shard-1-of-1.sqlite"]


@pytest.mark.parametrize("content", [b"text\n", b"SQLite format 3\0", b"\0" * 4096])
def test_what_is_no_database_is_told(content: bytes, tmp_path: Path) -> None:
    shard(tmp_path, 1, 1).write_bytes(content)
    assert "shard-1-of-1.sqlite: no rows of a shard: " in refused([tmp_path])


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
    path = shard(tmp_path / "b", 1, 2)
    store.Store(tmp_path / "b", SPEC, Shard(2, 2)).close()
    assert len(list((tmp_path / "b").iterdir())) == 2, "sweep.json, and the rows of the other"
    assert shard(tmp_path / "c", 5, 8, SPEC | {"draws": 4}).exists(), "it is complete"
    path.unlink()
    store.Store(tmp_path / "b", SPEC, Shard()).close()
    assert [one.name for one in (tmp_path / "b").iterdir()] == [store.SPEC], "it was there before"


def test_rows_of_a_run_without_a_value_are_the_same_alone_and_merged(tmp_path: Path) -> None:
    own = store.Store(tmp_path, SPEC | {"draws": 2}, Shard(1, 2))
    own.add(replace(row(0, name), metrics={"only": 1.0}) for name in SPEC["controllers"])
    own.complete()
    own.close()
    shard(tmp_path, 2, 2, SPEC | {"draws": 2})
    table, _ = shards.merge([tmp_path])
    assert repr(table["metric:only"].to_pylist()) == "[1.0, 1.0, nan, nan]"
