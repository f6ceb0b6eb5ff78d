"""Faults of values: each kind against its equation, on the output of a reference."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from places import ROOT

from pcpc.executive.errors import RigError
from pcpc.executive.loop.draws import FACTOR, PRIME, first
from pcpc.executive.loop.fault_kinds import WrongValue
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import Rig, load_rig

FROM, CYCLES, T = 30, 40, 1e-3
OTHERS = slice(0, FROM), slice(FROM + CYCLES, None)
Series = NDArray[np.float64]

STEP = "      law: references:step\n      parameters: {amplitude_rad: 3.0, start_s: 0.1}\n"
RAMP = "      law: references:ramp\n      parameters: {rate_rad_s: 8.0, rise_s: 0.02}\n"


def rig_with(folder: Path, fault: str, *settings: str) -> Rig:
    """Return the motor with a reference that rises all the time, and a fault."""
    motor = folder / "motor"
    if not motor.exists():
        shutil.copytree(ROOT / "tools/make/template", motor)
    text = (ROOT / "tools/make/template/rig.yaml").read_text().partition("watch:")[0]
    assert STEP in text
    text = text.replace(STEP, RAMP).replace("duration_s: 1.0", "duration_s: 0.1")
    path = motor / "wrong.yaml"
    path.write_text(f"{text}faults:\n  it: {{{fault}, from: 30ms, for: 40ms}}\n")
    return load_rig(path, settings=list(settings))


def reference(rig: Rig) -> Series:
    """Return what the reference gave."""
    return np.asarray(in_memory(rig).node["executive"].columns["reference.q_d_rad"])


@pytest.fixture(scope="module")
def true(tmp_path_factory: pytest.TempPathFactory) -> Series:
    """Return the reference without a fault."""
    off = "kind: bias, at: reference.q_d_rad, value: 0.0"
    x = reference(rig_with(tmp_path_factory.mktemp("true"), off))
    assert len(np.unique(x)) > 90, "it moves all the time"
    return x


def draws(count: int) -> Series:
    """Return the numbers of the fault's generator, computed here with Python's integers."""
    s, found = first(1, "it executive"), []
    for _ in range(count):
        s = s * FACTOR % PRIME
        found.append(s / PRIME)
    return np.array(found)


def expected(kind: str, x: Series, a: float) -> Series:
    """Return what a fault of `kind` makes of the true values while it is on."""
    on = x[FROM : FROM + CYCLES]
    n = np.arange(CYCLES)
    if kind == "noise":
        total = np.full(CYCLES, -6.0)
        for u in draws(12 * CYCLES).reshape(-1, 12).T:
            total += u
        return on + a * total
    if kind == "rate":
        found, last = [], on[0]
        for value in on:
            last = min(max(value, last - a * T), last + a * T)
            found.append(last)
        return np.array(found)
    made = {
        "value": np.full(CYCLES, a),
        "bias": on + a,
        "gain": a * on,
        "drift": on + a * (n * T),
        "stuck": np.full(CYCLES, on[0]),
        "dropout": np.full(CYCLES, on[0]),
        "random": a * (2.0 * draws(CYCLES) - 1.0),
        "quantise": a * np.floor(on / a + 0.5),
        "delay": on[np.maximum(n - 7, 0)],
        "saturation": np.clip(on, -a, a),
        "dead_zone": np.where(abs(on) <= a, 0.0, on - a * np.sign(on)),
    }
    return made[kind]


VALUES = {"noise": 0.02, "delay": 7.0, "quantise": 0.05, "rate": 3.0, "saturation": 0.3,
          "dead_zone": 0.2, "drift": -2.0, "gain": 0.5}  # fmt: skip


@pytest.mark.parametrize(
    "kind", [kind for kind in WrongValue.words() if kind != "nan"]
)  # it ends the run
def test_each_kind_is_its_equation_and_ends(kind: str, true: Series, tmp_path: Path) -> None:
    a = VALUES.get(kind, 0.125)
    value = "" if kind in ("stuck", "dropout") else f", value: {a}"
    x = reference(rig_with(tmp_path, f"kind: {kind}, at: reference.q_d_rad{value}"))
    wanted = expected(kind, true, a)
    np.testing.assert_array_equal(x[FROM : FROM + CYCLES], wanted)
    for part in OTHERS:
        np.testing.assert_array_equal(x[part], true[part])
    assert (wanted != true[FROM : FROM + CYCLES]).sum() > CYCLES // 2, "the case shows the kind"


def test_a_share_acts_that_often_in_bursts_of_that_length(true: Series, tmp_path: Path) -> None:
    fault = "kind: bias, at: reference.q_d_rad, value: 1.0, share: 0.25, burst: 4"
    long = rig_with(tmp_path, fault, "duration_s=20", "faults.it.for=20s")
    hit = np.diff(reference(long)) > 0.5
    clean = rig_with(tmp_path, fault, "duration_s=20", "faults.it.value=0")
    wrong = reference(long) - reference(clean) > 0.5
    share, bursts = wrong[FROM:].mean(), hit.sum()
    assert 0.22 < share < 0.28, "5 standard deviations of 20,000 draws in bursts of 4 are 0.03"
    assert 3.6 < wrong.sum() / bursts < 4.4


def test_another_seed_is_another_noise_and_the_same_seed_the_same(tmp_path: Path) -> None:
    fault = "kind: noise, at: reference.q_d_rad, value: 0.1"
    one, again, other = (reference(rig_with(tmp_path, fault, f"seed={n}")) for n in (3, 3, 4))
    np.testing.assert_array_equal(one, again)
    assert (one != other).sum() == CYCLES


def test_a_parameter_jumps_and_is_what_it_was_afterwards(tmp_path: Path) -> None:
    fault = "kind: gain, at: 'plant:motor.inertia_kg_m2', value: 3.0"
    columns = in_memory(rig_with(tmp_path, fault)).node["plant"].columns
    clean = in_memory(rig_with(tmp_path, fault, "faults.it.value=1")).node["plant"].columns
    same = [n for n, x in columns.items() if (x == clean[n])[:FROM].all()]
    assert len(same) == len(columns)
    wired = rig_with(tmp_path, fault, "faults.it.for=null")
    for_ever = in_memory(wired).node["plant"].columns["motor.speed_rad_s"]
    assert (for_ever != columns["motor.speed_rad_s"])[: FROM + CYCLES].sum() == 0
    assert (for_ever != columns["motor.speed_rad_s"])[FROM + CYCLES :].all(), "it was reset"


def test_an_actuator_and_a_sensor_are_disturbed_where_they_are(tmp_path: Path) -> None:
    dead = in_memory(rig_with(tmp_path, "kind: gain, at: 'plant:motor.voltage_V', value: 0.0"))
    volts = dead.node["plant"].columns["rx.CMD.voltage"]
    assert (volts[FROM:70] != 0.0).all(), "it was commanded"
    current = dead.node["plant"].columns["motor.current_A"]
    assert abs(current[FROM + 5]) < abs(current[FROM - 1])
    stuck = in_memory(rig_with(tmp_path, "kind: stuck, at: 'plant:tx.FB.encoder'"))
    heard = stuck.node["executive"].columns["rx.FB.encoder"]
    assert len(np.unique(heard[FROM : FROM + CYCLES])) == 1
    assert np.ptp(stuck.node["plant"].columns["motor.angle_rad"][FROM : FROM + CYCLES]) > 0.01


def test_no_number_from_a_block_is_a_fault_with_its_name(tmp_path: Path) -> None:
    log = in_memory(rig_with(tmp_path, "kind: nan, at: controller.voltage_V"))
    state = log.node["executive"].columns["supervisor.state"]
    assert state[FROM] == 2.0 and state[FROM + 1] == 4.0, "FAULT in the cycle after"


def test_several_at_once_are_carried_out_in_their_order(true: Series, tmp_path: Path) -> None:
    fault = "kind: gain, at: reference.q_d_rad, value: 2.0"
    more = "  also: {kind: bias, at: reference.q_d_rad, value: 1.0, from: 40ms, for: 10ms}\n"
    rig_with(tmp_path, fault)
    path = tmp_path / "motor" / "wrong.yaml"
    path.write_text(path.read_text() + more)
    x = reference(load_rig(path))
    np.testing.assert_array_equal(x[40:50], 2.0 * true[40:50] + 1.0)
    np.testing.assert_array_equal(x[50:70], 2.0 * true[50:70])


def test_what_is_stuck_in_part_shows_the_value_of_its_begin(true: Series, tmp_path: Path) -> None:
    x = reference(rig_with(tmp_path, "kind: stuck, at: reference.q_d_rad, share: 0.5"))
    wrong = (x != true)[FROM + 1 : FROM + CYCLES]
    assert 5 < wrong.sum() < CYCLES - 5
    assert set(x[FROM + 1 : FROM + CYCLES][wrong]) == {true[FROM]}


WRONG = [
    ("kind: corruption, frame: CMD, value: 1.0e+15", "outside 0..64, which a corruption may have"),
    ("kind: rate, at: reference.q_d_rad, value: -1", "outside 0..inf"),
    (
        "kind: bias, at: reference.q_d_rad, value: 1, every: 10ms, times: 3",
        "give either every or times",
    ),
    ("kind: bias, at: reference.q_d_rad, value: 1, node: plant", "at names the node"),
    ("kind: bios, at: reference.q_d_rad", "faults.it.kind: no kind bios; did you mean bias?"),
    ("kind: bias, at: reference.q_rad, value: 1", "did you mean reference.q_d_rad?"),
    ("kind: bias, at: reference.q_d_rad", "bias needs a value: how large it is"),
    ("kind: bias, value: 1", "what is disturbed?"),
    ("kind: loss, at: reference.q_d_rad", "loss is a fault of a frame; write frame: NAME"),
    ("kind: bias, frame: CMD, value: 1", "bias is a fault of a value; write at: VARIABLE"),
    ("kind: bias, at: rx.FB.encoder, value: 1", "disturb the input that it is wired to"),
    ("kind: bias, at: 'motor:x.y', value: 1", "faults.it.at: no node motor"),
    ("kind: loss, frame: CMDS", "no frame CMDS; did you mean CMD?"),
    ("kind: loss, frame: CMD, node: executive", "executive does not receive CMD"),
    ("kind: counter, frame: CMD, how: sometimes", "faults.it.how"),
    ("kind: payload, frame: FB", "payload needs how: freeze"),
    ("kind: stall", "a stall has node: executive or plant"),
    ("kind: addressing, frame: FB", "addressing, and nothing else, has data_of"),
    ("kind: bias, at: reference.q_d_rad, value: 1, share: 0", "faults.it.share"),
]


@pytest.mark.parametrize(("fault", "why"), WRONG)
def test_what_is_wrong_with_a_fault_is_said_with_its_place(
    fault: str, why: str, tmp_path: Path
) -> None:
    with pytest.raises(RigError) as caught:
        rig = rig_with(tmp_path, fault)
        for role in rig.roles:
            plan(rig, role, "lockstep")
    assert why in str(caught.value) and "wrong.yaml:" in str(caught.value)


MOMENTS = [
    ("from: 10s", "faults.it.from: 10s is after the end of the run at 0.1 s"),
    ("for: 10ms", "faults.it.for: when does it begin?"),
    ("every: 10ms", "faults.it.every: how long does it last each time?"),
]


@pytest.mark.parametrize(("moments", "why"), MOMENTS)
def test_a_fault_that_would_never_begin_or_never_end_is_refused(
    moments: str, why: str, tmp_path: Path
) -> None:
    rig_with(tmp_path, "kind: bias, at: reference.q_d_rad, value: 1")
    path = tmp_path / "motor" / "wrong.yaml"
    path.write_text(path.read_text().replace("from: 30ms, for: 40ms", moments))
    with pytest.raises(RigError) as caught:
        plan(load_rig(path), "executive", "lockstep")
    assert why in str(caught.value) and "wrong.yaml:" in str(caught.value)
