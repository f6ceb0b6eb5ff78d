"""The kill matrix on a few runs, and that it tells what it is for."""

from typing import Any

import pytest

from pcpc.tools.dev.evidence import kills

pytestmark = [pytest.mark.deep, pytest.mark.paced]

WELL: dict[str, Any] = {
    "process": "host", "signal": "KILL", "at": 5, "unsafe": [], "exposed": {"plant": 70},
    "limit": 70, "opens": True, "why": "", "missing_ms": 500.0, "holes": 0, "left": [], "next": 0,
}  # fmt: skip


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    return kills.run(6, seed=3)


def test_whatever_is_killed_the_commands_are_safe_in_time_and_all_is_tidy(
    rows: list[dict[str, Any]],
) -> None:
    done = [(row["process"], row["signal"]) for row in rows]
    assert done == [
        *((one, "KILL") for one in kills.PROCESSES),
        ("host", "TERM"),
        ("executive", "TERM"),
    ]
    assert [row for row in rows if not row["ok"]] == []
    assert all(row["at"] >= row["cycle"] for row in rows), rows


@pytest.mark.parametrize(("killed", "other"), [("executive", "plant"), ("plant", "executive")])
def test_the_node_that_is_left_faults_and_its_ramp_is_seen(
    rows: list[dict[str, Any]], killed: str, other: str
) -> None:
    (row,) = [row for row in rows if (row["process"], row["signal"]) == (killed, "KILL")]
    assert row["fault"][other].startswith("no valid input frame"), row
    assert row["limit"] - 3 <= row["exposed"][other] <= row["limit"], row
    assert row["state"][killed] in ("RUN", "HOLD"), row  # HOLD: a frame late in that cycle


def test_a_log_without_its_recorder_ends_early_and_opens(rows: list[dict[str, Any]]) -> None:
    (row,) = [row for row in rows if (row["process"], row["signal"]) == ("recorder", "KILL")]
    assert row["opens"] and row["holes"] == 0 and row["missing_ms"] <= kills.MOST_MS, row


@pytest.mark.parametrize(("change", "says"), [
    ({"unsafe": ["plant"]}, "plant ended with a command that is not safe"),
    ({"exposed": {"plant": 71}}, "plant had no safe command for 71 cycles, the limit is 70"),
    ({"opens": False, "why": "empty"}, "the log does not open: empty"),
    ({"missing_ms": 1001.0}, "the log lacks 1001 ms and 0 cycles before"),
    ({"holes": 2}, "the log lacks 500 ms and 2 cycles before"),
    ({"left": ["executive"]}, "left behind: executive"),
    ({"next": 5}, "the next run ended with 5"),
])  # fmt: skip
def test_what_is_wrong_is_told(change: dict[str, Any], says: str) -> None:
    assert kills.failures_of(WELL) == []
    assert kills.failures_of(WELL | change) == [says]


def test_the_table_counts_and_fits_a_terminal() -> None:
    never = {"process": "recorder", "signal": "SLOW", "ok": False, "wrong": "never got there"}
    late = WELL | {"exposed": {"plant": 1000}, "missing_ms": 700.0}
    killed = [WELL] * 58 + [late, WELL | {"left": ["plant"], "next": 5}, never]
    head, *lines = kills.table(killed)
    assert [" ".join(line.split()) for line in lines] == [
        "host KILL 60 59 1000 60 500 700 1 59",
        "recorder SLOW 1 0 0 0 0 0",
    ], lines
    assert max(map(len, [head, *lines])) <= 80
    safe, bound = kills.safe_of(killed[:60])
    assert safe == 59 and bound == pytest.approx(0.923, abs=5e-4)


def test_signals_with_the_same_figures_share_a_line() -> None:
    rows = [
        WELL | {"process": "plant", "signal": one, "next": 3 * (one == "STOP")}
        for one in kills.SIGNALS
    ]
    assert [line.split()[:5] for line in kills.table(rows)[1:]] == [
        ["plant", "KILL", "TERM", "SLOW", "1"],
        ["plant", "STOP", "1", "1", "70"],
    ]
