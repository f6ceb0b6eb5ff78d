"""The evidence: a run that is set back is a run, the code's weights, rows that are not kept."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from pcpc.drivers.can import e2e
from pcpc.drivers.compiled.lanes import WIDTH
from pcpc.executive.batch.runs import BatchRuns
from pcpc.executive.batch.runs import Case as One
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.dev.command import main
from pcpc.tools.dev.evidence import alarms, campaign, cli, matrix, report, residual
from pcpc.tools.dev.evidence.campaign import WARM, Bench
from pcpc.tools.dev.evidence.cases import CASES, Case
from pcpc.tools.dev.evidence.options import COMMAND

pytestmark = pytest.mark.deep

SETTINGS = [f"duration_s={matrix.LONGEST_S}"]


@pytest.fixture(scope="module")
def bench() -> Bench:
    """Return the rig of the evidence."""
    return matrix.bench()


@pytest.mark.parametrize("name", ["loss", "delay_6", "encoder_stuck", "plant_stall_2",
                                  "executive_stall_6", "friction_x5", "law_nan"])  # fmt: skip
def test_a_run_that_was_set_back_is_one_of_its_own(name: str, bench: Bench) -> None:
    bench.run_once((name,), 20, 5)  # leave something behind
    bench.run_once((name,), 7, 3)
    begin = WARM + int(np.random.default_rng(3).integers(2, campaign.SPREAD))
    words = [f"faults.{name}.from={begin}ms", f"faults.{name}.for=7ms"]
    whole = in_memory(load_rig(matrix.RIG, matrix.CONTROLLER, [*SETTINGS, *words]))
    for node, role in enumerate(("executive", "plant")):
        own = whole.node[role]
        rows = bench.rows(node)
        at = np.searchsorted(own.cycle, rows[0, 0])
        length = min(len(rows), len(own.cycle) - at)
        assert length > 40 and begin in range(int(rows[0, 0]), int(rows[-1, 0]))
        np.testing.assert_array_equal(rows[:length, 0], own.cycle[at : at + length])
        for column, values in own.columns.items():
            found = bench.column(node, column)[:length]
            assert found.tobytes() == values[at : at + length].tobytes(), (role, column)


def test_a_few_runs_of_every_case_are_as_stated(bench: Bench) -> None:
    rows = [
        matrix.row(
            case,
            [
                matrix.bench(case.rig).run_once(case.faults, case.cycles, seed)
                for seed in range(900, 906)
            ],
        )
        for case in CASES
    ]
    assert [row["fault"] for row in rows if not row["kept"] and row["wanted"] == 6] == []
    assert all(row["noticed"] == 0 for row in rows if row["limit_cycles"] is None)
    page = "".join(report._parts({"matrix": {
        "rows": rows, "seed": 900, "after_cycles": 60, "clean_mrad": 0.23}}))  # fmt: skip
    assert all(row["fault"].rpartition(", ")[0] in " ".join(page.split()) for row in rows)
    assert "\n| encoder_bias | 100 |" in page and "loss (1)" in page and "| FAULT 15 |" in page
    assert max(len(line) for line in page.splitlines() if not line.startswith("|")) <= 120


@pytest.mark.parametrize("changed", [
    {"limit": 0, "cycles": 10, "faults": ("counter_frozen",)},  # it takes a cycle to be seen
    {"answer": "none", "faults": ("loss",)},  # HOLD follows
    {"limit": None, "faults": ("loss",)},  # it is noticed
    {"limit": 0, "faults": ("payload_frozen",)},  # nothing notices it
])  # fmt: skip
def test_a_row_that_is_not_as_stated_is_told(changed: dict[str, object], bench: Bench) -> None:
    case = Case(("loss",), 1, 0, "HOLD")._replace(**changed)  # type: ignore[arg-type]
    seen = [bench.run_once(case.faults, case.cycles, seed) for seed in range(4)]
    assert not matrix.row(case, seen)["kept"]


@pytest.mark.parametrize(
    ("code", "distance", "first"),
    [
        (residual.CRC_8, 3, 198),
        (residual.CRC_16, 4, 64),
    ],
)
def test_the_weights_of_the_code_are_those_that_counting_gives(
    code: residual.CheckCode, distance: int, first: int
) -> None:
    single, known = residual.syndromes(code), residual.weights(code)
    words = 2 ** (residual.BITS - code.crc_bits)
    assert known[0] == 1 and sum(known) == words, "all words whose CRC is right"
    for w in (1, 2, 3, 4):
        found = sum(_xor(some) == 0 for some in itertools.combinations(single, w))
        assert known[w] == found, w
    assert not any(known[1:distance]) and known[distance] == first


def test_a_share_that_is_not_the_predicted_one_is_told_with_its_crc() -> None:
    found = {**residual.residual(2000, 7)}
    wide = found["crc_16"]
    wide["drawn_frames"] = {"kept": False, "used": 7}
    wide["weights"] = [{**wide["weights"][0], "kept": False, "measured": 0.5}]
    assert [*cli.failures({"residual": found})] == [
        "CRC-16: 1 wrong bits: 0.5, 0 predicted",
        "CRC-16: drawn frames: 7 used",
    ]


def _xor(some: tuple[int, ...]) -> int:
    total = 0
    for one in some:
        total ^= one
    return total


def test_measured_shares_are_the_predicted_ones() -> None:
    found = residual.residual(20_000, 7)
    for one, distance in ((found, 3), (found["crc_16"], 4)):
        assert all(row["kept"] for row in one["weights"]) and one["drawn_frames"]["kept"]
        assert one["distance"] == distance
    assert [*cli.failures({"residual": found})] == []
    assert found["weights"][2]["measured"] > 0.0
    assert residual.state_counts(3, 100, 1).sum() == 100 and e2e.MAX_DELTA == 4


def test_a_clean_run_of_each_rig_has_no_alarm_and_each_is_another() -> None:
    for rig, about in enumerate(alarms.RIGS):
        assert alarms.case(rig, 5) != alarms.case(rig, 6) and alarms.case(rig, 5).seed == 5
        runs = alarms._runs(rig)
        runs = BatchRuns(runs.path, runs.controller, ["duration_s=0.5"], runs.wanted)
        found = alarms.alarm_counts(runs.done([alarms.case(rig, seed) for seed in range(WIDTH)]))
        assert sum(found.values()) == 0, (about.name, found)
    assert sum(one.tenths for one in alarms.RIGS) == 10


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("share: 0.1", "health.held_cycles"),
        ("share: 0.5, burst: 20", "supervisor.fault"),
    ],
)
def test_a_run_that_is_not_clean_is_an_alarm(words: str, told: str, tmp_path: Path) -> None:
    clean, path = alarms._runs(0), tmp_path / "lossy.yaml"
    path.write_text(f"base: {clean.path.resolve()}\nrig: lossy\nlosses: {{FB_A: {{{words}}}}}\n")
    runs = BatchRuns(path, clean.controller, ["duration_s=0.5"], clean.wanted)
    found = alarms.alarm_counts(runs.done([One(1)]))
    assert found[told] > 0, found


def test_the_page_and_its_numbers_are_written(tmp_path: Path) -> None:
    page = report.write(tmp_path / "new", {"residual": residual.residual(2000, 1)})
    assert "| 3 | 41,664 | 198 |" in page.read_text() and "| 64 |" in page.read_text()
    assert (tmp_path / "new/faults.json").is_file()


def test_a_part_is_done_anew_beside_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report.write(tmp_path, {"frames": [], "residual": {}})
    words = ["residual", "--frames", "2000", "-q", "-o", str(tmp_path)]
    assert main(COMMAND, words) == 0 and "all as stated" in capsys.readouterr().out
    found = report.read(tmp_path)
    assert [*found] == ["residual", "frames"] and found["residual"]["drawn_frames"]["runs"] == 2000
    (tmp_path / report.NUMBERS).write_text("{")
    assert main(COMMAND, words) == 2 and "faults.json: " in capsys.readouterr().err
