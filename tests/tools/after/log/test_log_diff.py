"""`pcpc compare --bits`: equal runs are equal bit for bit; of others it tells where they part."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from json_schemas import holds
from logcommand import PLANT, barrel_log, run_here

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.after.log import diff


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return a function that simulates the barrel with other values, once each."""
    folder, made = tmp_path_factory.mktemp("other"), dict[tuple[str, ...], Path]()

    def log(*settings: str) -> Path:
        if settings not in made:
            made[settings] = folder / f"{len(made)}.mcap"
            rig = load_rig(PLANT / "rigs" / "slew10.yaml", "pd", settings)
            simulate(rig, made[settings])
        return made[settings]

    return log


def compared(a: Path, b: Path, *words: str, code: int) -> dict[str, Any]:
    """Return what `--json` says."""
    done = run_here("compare", "--bits", a, b, *words, "--json", "-")
    assert done.code == code, done
    return dict(holds("compare --bits", done.out))


def test_same_run_again_is_equal_bit_for_bit(other: Any) -> None:
    report = compared(barrel_log("pd"), other("duration_s=0.3"), code=0)
    assert report["equal"] and report["cycles"] == {"executive": 300, "plant": 301}, f"{report}"
    assert report["variables"] > 100 and report["frames"] > 3000, f"{report}"
    assert run_here("compare", "--bits", barrel_log("pd"), other("duration_s=0.3")).out.endswith(
        "equal\n"
    )


def test_first_and_largest_difference_are_found_where_they_are(other: Any) -> None:
    a, b = barrel_log("pd"), other("duration_s=0.3", "controller.kv_Nms_rad=111")
    report = compared(a, b, code=1)
    ours, theirs = (logs.read(path).node["executive"] for path in (a, b))
    name = "rx.FB_A.hub_rate"
    x, y = ours.columns[name], theirs.columns[name]
    first, largest = int(np.flatnonzero(x != y)[0]), int(np.argmax(np.abs(x - y)))
    (row,) = [d for d in report["differences"] if d["name"] == name]
    at_first = (first, repr(float(x[first])), repr(float(y[first])))
    assert (row["cycle"], row["a"], row["b"]) == at_first, f"{row}"
    assert row["count"] == int((x != y).sum()), f"{row}"
    assert row["largest"] == abs(x - y)[largest], f"{row}"
    assert row["largest_time_s"] == pytest.approx(largest * 1e-3, abs=1e-9), f"{row}"
    times = [d["time_s"] for d in report["differences"]]
    assert times == sorted(times) and len(times) > 50, f"{times}"
    assert "frame CMD sent" in [d["name"] for d in report["differences"]]


def test_tolerances_and_names_limit_what_is_compared(other: Any) -> None:
    a, b = barrel_log("pd"), other("duration_s=0.3", "controller.kv_Nms_rad=111")
    report = compared(a, b, "controller.e_rad", "tx.CMD.*", "--absolute", "1e9", code=0)
    assert 1 < report["variables"] < 10, f"{report}"
    assert report["frames"] == 0, "named variables leave the frames out"
    assert compared(a, b, "--absolute", "1e9", code=0)["frames"] > 3000
    assert compared(a, b, "tx.CMD.motor_torque", "--tolerance", "1e-6", code=1)["differences"]


def test_cycles_and_variables_of_one_log_are_told(other: Any) -> None:
    report = compared(barrel_log("pd"), other("duration_s=0.2"), code=1)
    assert any("100 cycles of executive: 200 to 299" in line for line in report["only"]), report
    assert report["cycles"]["executive"] == 200
    report = compared(barrel_log("pd"), barrel_log(), code=1)
    assert any(" variables: " in line for line in report["only"]), f"{report['only']}"


def test_nan_equals_nan_and_differs_from_numbers() -> None:
    log = logs.read(barrel_log("pd"))
    node = log.node["executive"]
    for value, expected in ((math.nan, 1), (math.inf, 1), (-0.0, 1)):
        changed = {k: v.copy() for k, v in node.columns.items()}
        changed["supervisor.fault"][7] = value
        new = logs.NodeLog(**{**vars(node), "columns": changed})
        twin = logs.Log(log.path, {"executive": new}, log.attachments, log.metadata, [])
        lone = logs.Log(log.path, {"executive": node}, log.attachments, log.metadata, [])
        report = diff.compare(lone, twin)
        assert len(report.differences) == expected, f"{value}: {report.differences}"
        assert report.differences[0].cycle == 7 and diff.compare(twin, twin).equal


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("controller.e_rat",), "no variable controller.e_rat"),
        (("--tolerance", "-1"), "--tolerance"),
    ],
)
def test_wrong_input_is_one_line(words: tuple[str, ...], part: str) -> None:
    done = run_here("compare", "--bits", barrel_log("pd"), barrel_log("pd"), *words)
    assert done.code == 2 and part in done.err and done.err.count("\n") == 1, done
    done = run_here("compare", "--bits", barrel_log("pd"), Path("/nowhere.mcap"))
    assert done.code == 2 and "/nowhere.mcap" in done.err and done.err.count("\n") == 1, done
