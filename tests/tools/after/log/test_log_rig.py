"""Laws from outside the project, recomputed: with their files, wherever they lay, when trusted."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from processes import Done, pcpc
from spring import EVALUATION, LAW, MODEL, RIG, spring_dbc

from pcpc.executive.log import reader as logs

BASE = RIG.replace("rig: spring\n", "").replace("dbc: spring.dbc", "dbc: can/spring.dbc")
GAIN = '''\
"""A gain and a table for the law beside it."""

from pathlib import Path

GAIN = 1.0
TABLE = [float(x) for x in (Path(__file__).parent / "data" / "table.csv").read_text().split()]
'''
READING = (
    LAW.replace("from pcpc.executive.laws.block import Block, Ports, port, stage", "{imports}")
    .replace("p.ki_N_ms * (", "G * p.ki_N_ms * (")
    .replace(
        "{imports}",
        "import sys\nfrom pathlib import Path\n\nimport numpy as np\n\n"
        "from pcpc.executive.laws.block import Block, Ports, Prepared, port, stage\n"
        "from helper import GAIN, TABLE\n\nG = GAIN * TABLE[1]\n\n\n"
        "def prepare(settings, rate_hz, seed):\n"
        "    shift = np.load('shift.npy') + np.loadtxt(ABSOLUTE)\n"
        "    return Prepared({'ki_N_ms': settings['ki_N_ms'] + shift.sum(), "
        "'target_m': settings['target_m']})\n",
    )
    .replace("BLOCK = Block(step)", "BLOCK = Block(step, settings=Gains, prepare=prepare)")
)


def laid_out(folder: Path) -> Path:
    """Make a plant as the project's are laid out: rigs/ above a base, laws and data beside it."""
    for name in ("rigs", "can", "laws/data", "elsewhere"):
        (folder / name).mkdir(parents=True)
    absolute = folder / "elsewhere" / "offset.txt"
    law = READING.replace("ABSOLUTE", repr(str(absolute)))
    texts = {
        "rig.yaml": BASE.replace("law.py:BLOCK", "laws/law.py:BLOCK"), "model.py": MODEL,
        "evaluation.py": EVALUATION, "laws/law.py": law, "laws/helper.py": GAIN,
        "laws/data/table.csv": "0.5 1.0\n", "elsewhere/offset.txt": "0.25\n",
        "rigs/one.yaml": "base: ../rig.yaml\nrig: one\nduration_s: 0.2\n"
        "expect: null\nevaluation: null\n",
        "can/spring.dbc": spring_dbc(),
    }  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    np.save(folder / "shift.npy", np.array([0.5, -0.25]))
    return folder / "rigs" / "one.yaml"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the folder of a plant that was run from there, and the log."""
    folder = tmp_path_factory.mktemp("plant")
    rig = laid_out(folder)
    words = ("simulate", str(rig), "-o", str(folder / "run"), "--quiet", "--no-figure")
    done = pcpc(*words, cwd=folder)
    assert done.code == 0, str(done)
    log = tmp_path_factory.mktemp("log") / "log.mcap"
    shutil.move(folder / "run" / "log.mcap", log)
    return folder, log


def replayed(log: Path, *words: str, cwd: Path) -> Done:
    return pcpc("replay", str(log), "--quiet", *words, cwd=cwd)


def test_a_log_carries_what_its_laws_read(recorded: tuple[Path, Path]) -> None:
    folder, log = recorded
    head = logs.head(log)
    files = {entry["name"] for entry in head.node["executive"].description["files"]}
    assert files == {
        "../model.py", "../laws/law.py", "../laws/helper.py", "../laws/data/table.csv",
        "../shift.npy", "../elsewhere/offset.txt",
    }, files  # fmt: skip
    assert (folder / "shift.npy").read_bytes() in head.files.values()


def test_any_layout_is_recomputed_in_place_elsewhere_and_from_the_log(
    recorded: tuple[Path, Path], tmp_path: Path
) -> None:
    folder, log = recorded
    in_place = replayed(log, cwd=tmp_path)
    assert in_place.code == 0 and in_place.out.count("bit-identical") == 2, str(in_place)
    moved = tmp_path / "moved"
    shutil.move(folder, moved)
    try:
        refused = replayed(log, cwd=tmp_path)
        assert refused.code == 2 and refused.err.count("\n") == 1, str(refused)
        said = ("laws/law.py (sha256 ", "data/table.csv (sha256 ", "--trust", "--law", "not there")
        assert all(text in refused.err for text in said), str(refused)
        beside = replayed(log, "--rig", str(moved / "rigs" / "one.yaml"), cwd=tmp_path)
        assert beside.code == 0, str(beside)
        trusted = replayed(log, "--trust", cwd=tmp_path)
        assert trusted.code == 0 and trusted.out.count("bit-identical") == 2, str(trusted)
        (moved / "laws" / "helper.py").write_text(GAIN.replace("GAIN = 1.0", "GAIN = 2.0"))
        other = replayed(log, "--rig", str(moved / "rigs" / "one.yaml"), cwd=tmp_path)
        assert other.code == 2 and "helper.py" in other.err, str(other)
        named = ("--law", str(moved / "laws" / "helper.py"), "--rig", str(moved / "rigs/one.yaml"))
        changed = replayed(log, *named, "--json", cwd=tmp_path)
        assert changed.code == 1 and json.loads(changed.out)[0]["first"], str(changed)
    finally:
        (moved / "laws" / "helper.py").write_text(GAIN)
        shutil.move(moved, folder)


def test_a_table_that_changed_is_not_in_old_compiled_code(
    recorded: tuple[Path, Path], tmp_path: Path
) -> None:
    folder, log = recorded
    table = folder / "laws" / "data" / "table.csv"
    before = table.read_text()
    table.write_text("0.5 2.0\n")
    try:
        words = ("simulate", str(folder / "rigs" / "one.yaml"), "-o", str(tmp_path), "--quiet")
        assert pcpc(*words, "--no-figure", cwd=folder).code == 0
    finally:
        table.write_text(before)
    old, new = (logs.digest(path, "/state") for path in (log, tmp_path / "log.mcap"))
    assert old != new, "the law computes with the old table"
