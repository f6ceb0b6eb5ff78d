"""`law: table`: numbers of a file over time as a block, in all pacings and without the file."""

import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pcpc
from pcpc.executive.errors import RigError
from pcpc.executive.laws import table
from pcpc.executive.laws.block import Block
from pcpc.executive.log import reader as logs
from pcpc.executive.rig import tables
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make.new import TEMPLATE

STEP = "      law: references:step\n      parameters: {amplitude_rad: 3.0, start_s: 0.1}\n"
TIMES = np.cumsum(np.random.default_rng(1).uniform(0.001, 0.5, 40))
VALUES = np.random.default_rng(2).normal(size=(40, 2))
COLUMNS = {"q_d_rad": "rad", "load_Nm": "N m"}


def answers(
    block: Block, times: list[float], step: Callable[..., None] | None = None
) -> np.ndarray:
    """Return the outputs of a block at rising times, a row each."""
    x, nothing, y = np.zeros(1), np.zeros(1), np.zeros(block.size(block.outputs))
    rows = []
    for t in times:
        (step or block.step)(t, 1e-3, nothing, x, nothing, y)
        rows.append(y.copy())
    return np.array(rows)


def interpreted(block: Block, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return the step of a block as Python carries it out."""
    declared = block.step.declared
    monkeypatch.setattr(table, "flat", lambda view: view.values())

    def step(t: float, dt: float, *views: np.ndarray) -> None:
        named = zip(declared, views, "pxuy", strict=True)
        block.step.py_func(t, dt, *(ports(view, letter) for ports, view, letter in named))

    return step


@cache
def compiled(linear: bool, repeat: bool) -> Block:
    """Return the block of TIMES and VALUES; each process compiles it."""
    return table.block(TIMES, VALUES, COLUMNS, linear, repeat)


HOLD, LINEAR, ROUND = (False, False), (True, False), (True, True)
rising = st.lists(st.floats(0.0, 15.0), min_size=1, max_size=30).map(sorted)


@given(times=rising)
def test_held_and_interpolated_values_are_those_of_numpy(times: list[float]) -> None:
    held, linear = answers(compiled(*HOLD), times), answers(compiled(*LINEAR), times)
    row = np.clip(np.searchsorted(TIMES, np.add(times, 1e-9), "right") - 1, 0, None)
    np.testing.assert_array_equal(held[:, :2], VALUES[row])
    assert not held[:, 2:].any(), "a held value has no slope"
    for c in range(2):
        np.testing.assert_allclose(linear[:, c], np.interp(times, TIMES, VALUES[:, c]), atol=1e-7)


@given(times=rising)
def test_a_repeated_table_has_the_period_of_its_rows(times: list[float]) -> None:
    period = TIMES[-1] - TIMES[0]
    once = [t if t < TIMES[0] else TIMES[0] + (t - TIMES[0]) % period for t in times]
    for c in range(2):
        expected = np.interp(once, TIMES, VALUES[:, c])
        away = [min(abs(o - TIMES[0]), abs(o - TIMES[-1])) > 1e-6 for o in once]  # of the jump
        np.testing.assert_allclose(
            answers(compiled(*ROUND), times)[away, c], expected[away], atol=1e-5
        )


@pytest.mark.parametrize("kind", [HOLD, LINEAR, ROUND], ids=["hold", "linear", "repeat"])
def test_compiled_and_interpreted_give_the_same_bits(
    kind: tuple[bool, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    block = compiled(*kind)
    times = (1e-3 * np.arange(12_000)).tolist()
    plain = answers(block, times, interpreted(block, monkeypatch))
    np.testing.assert_array_equal(answers(block, times), plain)


def test_a_straight_line_is_its_formula_with_its_slope() -> None:
    line = table.block(
        np.array([0.5, 2.5]), np.array([[1.0], [4.0]]), {"q_d_rad": "rad"}, True, False
    )
    times = np.arange(0.0, 3.0, 0.01)
    q, rate, acc = answers(line, times.tolist()).T
    np.testing.assert_allclose(q, 1.0 + 1.5 * (np.clip(times, 0.5, 2.5) - 0.5), rtol=1e-15)
    within = (times >= 0.5) & (times < 2.5)
    np.testing.assert_array_equal(rate, np.where(within, 1.5, 0.0))
    assert not acc.any()


@pytest.mark.parametrize(
    ("name", "unit", "rate", "acceleration"),
    [
        ("q_d_rad", "rad", ("q_d_rate_rad_s", "rad/s"), ("q_d_acc_rad_s2", "rad/s2")),
        ("v_rad_s", "rad/s", ("v_rate_rad_s2", "rad/s2"), ("v_acc_rad_s3", "rad/s3")),
        ("load_Nm", "N m", ("load_rate_Nm_s", "N m/s"), ("load_acc_Nm_s2", "N m/s2")),
        ("valve", "", ("valve_rate", "1/s"), ("valve_acc", "1/s2")),
    ],
)
def test_a_column_has_its_unit_and_its_derivatives(
    name: str, unit: str, rate: tuple[str, str], acceleration: tuple[str, str]
) -> None:
    assert table.unit_of(name) == unit
    assert table.derivative(name, unit, 1) == rate
    assert table.derivative(name, unit, 2) == acceleration


# In a rig


@pytest.fixture
def motor(tmp_path: Path) -> Callable[[str, str], Path]:
    """Return what writes the template's rig with a table as its reference."""

    def write(csv: str, keys: str = "interpolation: hold") -> Path:
        folder = tmp_path / "motor"
        shutil.copytree(TEMPLATE, folder, dirs_exist_ok=True)
        rig, entry = folder / "rig.yaml", f"      {{law: table, file: move.csv, {keys}}}\n"
        text = rig.read_text(encoding="utf-8")
        assert STEP in text
        text = text.replace(f"    reference:\n{STEP}", f"    reference:\n{entry}")
        rig.write_text(text, encoding="utf-8")
        (folder / "move.csv").write_text(csv, encoding="utf-8")
        return rig

    return write


def test_a_step_from_a_table_is_the_step_of_the_law_in_all_pacings_and_without_the_file(
    motor: Callable[..., Path], tmp_path: Path
) -> None:
    law = pcpc.simulate(TEMPLATE / "rig.yaml", quiet=True)
    rig = motor("# from the drawing\nt_s; q_d_rad\n0; 0\n0.1; 3  # the step\n1e3; 3\n")
    virtual = pcpc.simulate(rig, quiet=True, folder=tmp_path / "virtual")
    with pcpc.running(rig, pacing="lockstep", folder=tmp_path / "lockstep") as live:
        live.wait()
    for name in ("reference.q_d_rad", "controller.voltage_V", "plant:motor.angle_rad"):
        np.testing.assert_array_equal(virtual[name], law[name], err_msg=name)
    states = [
        logs.payloads(tmp_path / way / "log.mcap", "/state") for way in ("virtual", "lockstep")
    ]
    assert states[0] == states[1] and len(states[0]) == 1000
    (rig.parent / "move.csv").unlink()
    assert all(node.identical for node in pcpc.open(tmp_path / "lockstep").replay())


def test_a_logged_reference_reproduces_its_run_to_the_bit(
    motor: Callable[..., Path], tmp_path: Path
) -> None:
    first = pcpc.simulate(TEMPLATE / "rig.yaml", "pd", quiet=True, folder=tmp_path / "first")
    rig = motor("")
    text = rig.read_text(encoding="utf-8").replace(
        "interpolation: hold", "signal: reference.q_d_rad"
    )
    rig.write_text(text.replace("move.csv", "../first/log.mcap"), encoding="utf-8")
    again = pcpc.simulate(rig, "pd", quiet=True, folder=tmp_path / "again")
    for name in first.names:
        np.testing.assert_array_equal(again[name], first[name], err_msg=name)
    shutil.rmtree(tmp_path / "first")
    assert all(node.identical for node in pcpc.open(tmp_path / "again").replay())


@pytest.mark.parametrize(
    ("signal", "why"),
    [
        ("reference.q_d", "no signal reference.q_d; did you mean reference.q_d_rad?"),
        ("[plant:motor.angle_rad, controller.e_rad]", "signals of one node are needed"),
        ("motors:motor.angle_rad", "no node motors; it has executive, plant"),
    ],
)
def test_a_signal_that_a_log_does_not_have_is_refused(
    signal: str, why: str, motor: Callable[..., Path], tmp_path: Path
) -> None:
    pcpc.simulate(TEMPLATE / "rig.yaml", quiet=True, folder=tmp_path / "first")
    rig = motor("", f"signal: {signal}")
    rig.write_text(rig.read_text().replace("move.csv", "../first/log.mcap"))
    with pytest.raises(RigError) as error:
        load_rig(rig)
    assert why in str(error.value) and "log.mcap" in str(error.value), str(error.value)


def test_a_damaged_log_is_no_reference(motor: Callable[..., Path], tmp_path: Path) -> None:
    first = tmp_path / "first"
    pcpc.simulate(TEMPLATE / "rig.yaml", quiet=True, folder=first)
    whole = (first / "log.mcap").read_bytes()
    (first / "log.mcap").write_bytes(whole[: len(whole) // 2])
    rig = motor("", "signal: reference.q_d_rad")
    rig.write_text(rig.read_text().replace("move.csv", "../first/log.mcap"))
    with pytest.raises(RigError, match=r"log\.mcap: the end: nothing is readable after byte"):
        load_rig(rig)
    rig.write_text(rig.read_text().replace(", signal: reference.q_d_rad", ""))
    with pytest.raises(RigError, match="reference: give `signal: NAME` of the log"):
        load_rig(rig)


def test_the_newest_rows_count_however_often_a_file_is_changed(motor: Callable[..., Path]) -> None:
    for goal in (1.0, 2.0):
        run = pcpc.simulate(motor(f"t_s q_d_rad\n0 0\n0.1 {goal}\n"), quiet=True)
        assert run["reference.q_d_rad"][-1] == goal


@pytest.mark.parametrize(
    ("csv", "keys", "why"),
    [
        ("t_s,q_d_rad\n0,0\n1,x\n", "interpolation: hold",
         "move.csv:3: q_d_rad: expected a finite number, got 'x'"),
        ("t_s,q_d_rad\n0,0\n1,nan\n", "interpolation: hold", "move.csv:3: q_d_rad: expected a f"),
        ("t_s,q_d_rad\n0,0\n#\n0,1\n", "interpolation: hold",
         "move.csv:4: t_s 0 is not later than that of the row before, 0"),
        ("t_s,q_d_rad\n0,0\n1\n", "interpolation: hold",
         "move.csv:3: 1 values where the header has 2 columns"),
        ("t_s,q_d_rad\n0,0\n", "interpolation: hold",
         "move.csv: a header and at least two rows are needed, got 1"),
        ("q_d_rad\n0\n1\n", "interpolation: hold", "move.csv:1: the first line names the columns"),
        ("t_s,q d\n0,0\n1,1\n", "interpolation: hold", "column 'q d': expected a name"),
        ("t_s,a,a\n0,0,0\n1,1,1\n", "interpolation: hold", "column 'a': named twice"),
        ("\x93\xff", "interpolation: hold", "the first line names the columns"),
        ("t_s,q_d_rad\n0,0\n1,1\n", "repeat: true", ".reference: give `interpolation: linear` or"),
        ("t_s,q_d_rad\n0,0\n1,1\n", "signal: q_d_rad", "reference: only a log (.mcap) has sig"),
        ("t_s,q_dd_rad\n0,0\n1,1\n", "interpolation: linear",
         "no variable 'reference.q_d_rad'; did you mean reference.q_dd_rad?"),
        ("t_s,q_d_rad [deg]\n0,0\n1,1\n", "interpolation: linear", "wire a variable of the same"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_file_and_line(
    csv: str, keys: str, why: str, motor: Callable[..., Path]
) -> None:
    rig = motor(csv, keys)
    with pytest.raises(RigError) as error:
        pcpc.simulate(rig, quiet=True)
    assert why in str(error.value), str(error.value)


def test_a_missing_file_and_one_without_a_table_are_refused(motor: Callable[..., Path]) -> None:
    rig = motor("")
    (rig.parent / "move.csv").unlink()
    with pytest.raises(RigError, match=r"rig.yaml:\d+:\d+: .*reference.file: no such file: .*move"):
        load_rig(rig)
    rig.write_text(rig.read_text().replace("law: table", "law: references:sine"))
    with pytest.raises(RigError, match="only `law: table` takes file"):
        load_rig(rig)
    rig.write_text(rig.read_text().replace("law: references:sine, file: move.csv", "law: table"))
    with pytest.raises(RigError, match="law table needs `file`"):
        load_rig(rig)


def test_more_values_than_a_table_holds_are_refused(
    motor: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "MOST_VALUES", 3)
    rows = "".join(f"{i} {i}\n" for i in range(4))
    with pytest.raises(RigError, match=r"move.csv:5: more than 3 values; leave out rows"):
        load_rig(motor(f"t_s q_d_rad\n{rows}"))
