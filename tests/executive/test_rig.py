"""The rig file: values and their precedence, each class of error with its place, resolved()."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pcpc.drivers.compile_cache import user_cache
from pcpc.executive.errors import RigError
from pcpc.executive.rig import resolve
from pcpc.executive.rig.modules import project_name
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import ROLES

ROOT = Path(__file__).resolve().parents[2]
RIG = """\
rig: small
title: one joint
dbc: small.dbc
rate_hz: 1000
duration_s: 6.0
bus: {bitrate: 1000000}
controller: pd
controllers:
  pd:
    law: "laws.py:PD"
    parameters: {kv_Nms_rad: 110.0}
  nn:
    law: laws.py
    inputs: {extra: barrel.rate_rad_s}
executive:
  node: EXEC
  blocks:
    reference: {law: "laws.py:STEP", parameters: {size_rad: 1}}
    controller:
      inputs: {q_rad: rx.FB.angle, ref_rad: reference.ref_rad}
  transmit: {CMD.motor_torque: controller.tau_Nm}
  limits: {CMD.motor_torque: {low: -2.0, high: 2.0, rate_per_s: null}}
plant:
  node: PLANT
  parameters_file: parameters.yaml
  blocks:
    barrel:
      law: model.py:BARREL
      inputs: {tau_Nm: rx.CMD.motor_torque}
      parameters: {gap_rad: 0.003}
  transmit: {FB.angle: barrel.q_rad}
  safe: {CMD.motor_torque: 0.0}
evaluation: {file: evaluation.py, window_s: [3.25, 6.0], tolerance_rad: 0.01}
watch: controller.tau_Nm
expect: {pd: {error_rms_rad: [3.1, 3.8]}}
"""
PARAMETERS = """\
barrel:
  mass_kg: {value: 80, unit: kg, reason: drawing}
  gap_rad: {value: 0.002, unit: rad, reason: measured}
"""
LAWS = """\
from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage

class Gains(Ports):
    kv_Nms_rad = port("N m s/rad", "velocity gain", low=0, high=500)
    lam_per_s = port("1/s", "slope", default=16.0)

class Weights(Ports):
    w = port("", "weights", default=0.5, shape=3)

class Size(Ports):
    size_rad = port("rad", "height of the step")

@stage
def pd(t, dt, p: Gains, x: Nothing, u: Nothing, y: Nothing): pass

@stage
def weighted(t, dt, p: Weights, x: Nothing, u: Nothing, y: Nothing): pass

@stage
def step(t, dt, p: Size, x: Nothing, u: Nothing, y: Nothing): pass

PD, BLOCK, STEP = Block(pd), Block(weighted), Block(step)
NUMBER = 3
"""
MODEL = """\
from pcpc.executive.laws.block import Block, Nothing, Ports, port, stage

class Parameters(Ports):
    mass_kg = port("kg", "mass", low=0.1)
    gap_rad = port("rad", "clearance", low=0.0, high=0.1)

@stage
def step(t, dt, p: Parameters, x: Nothing, u: Nothing, y: Nothing): pass

BARREL = Block(step)
"""

Write = Callable[..., Path]


@dataclass
class Case:
    """A rig with one thing replaced, and the message that it must give."""

    old: str
    new: str
    expected: str


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder for files as they stand here: their laws are compiled once."""
    return tmp_path_factory.mktemp("compiled")


@pytest.fixture
def write(compiled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Write a small rig to an own folder, with `old` replaced by `new` in any of its files."""

    def write(old: str = "", new: str = "") -> Path:
        texts = {
            "small.yaml": RIG, "parameters.yaml": PARAMETERS, "laws.py": LAWS, "model.py": MODEL,
            "small.dbc": "", "evaluation.py": "", "none.py": "",
        }  # fmt: skip
        assert not old or sum(text.count(old) for text in texts.values()) == 1, old
        for name, text in texts.items():
            (tmp_path / name).unlink(missing_ok=True)
            if name in ("laws.py", "model.py") and (not old or old not in text):
                if not (compiled / name).exists():
                    (compiled / name).write_text(text)
                (tmp_path / name).symlink_to(compiled / name)
            else:
                (tmp_path / name).write_text(text.replace(old, new) if old else text)
        return Path("small.yaml")

    monkeypatch.chdir(tmp_path)
    return write


def message(path: Path, controller: str | None = None, *options: str) -> str:
    with pytest.raises(RigError) as caught:
        load_rig(path, controller, options)
    assert "\n" not in str(caught.value), caught.value
    return str(caught.value)


def test_a_rig_has_its_values_and_defaults(write: Write, tmp_path: Path) -> None:
    rig = load_rig(write())
    config = rig.config
    assert (config.rig, config.rate_hz, config.seed, config.pacing) == ("small", 1000.0, 1, "real")
    assert type(config.rate_hz) is float, "an int is accepted where a float is expected"
    assert (config.bus.interface, config.bus.channel, config.bus.bitrate) == ("auto", None, 1000000)
    assert (config.supervisor.fault_after_cycles, config.realtime.executive.priority) == (3, 80)
    assert config.expect == {"pd": {"error_rms_rad": (3.1, 3.8)}}
    assert rig.dbc == tmp_path.resolve() / "small.dbc" and rig.document.text == RIG
    evaluation = rig.evaluation
    assert evaluation and evaluation.window_s == (3.25, 6.0), evaluation
    assert evaluation.numbers == {"tolerance_rad": 0.01}
    assert evaluation.file == str(tmp_path.resolve() / "evaluation.py")


def test_each_node_has_real_time_settings_which_earlier_rigs_put_elsewhere(write: Write) -> None:
    earlier = "{priority: 60, cpu: 2, local_phase: 0.25, plant_cpu: null, plant_phase: 0.4}"
    now = "{executive: {priority: 60, cpu: 2}, local: {phase: 0.25}, plant: {phase: 0.4}}"
    found = [load_rig(write("bus:", f"realtime: {text}\nbus:")).config for text in (earlier, now)]
    options = ("realtime.priority=60", "realtime.cpu=2", "realtime.local_phase=0.25")
    found.append(load_rig(write(), None, (*options, "realtime.plant_phase=0.4")).config)
    realtime = found[0].realtime
    assert all(one.realtime == realtime for one in found), [one.realtime for one in found]
    control, local, plant = (realtime.of(role) for role in ROLES)
    assert (control.priority, control.phase, control.cpu) == (60, 0.0, 2)
    assert (local.priority, local.phase, local.cpu) == (75, 0.25, None), "it has a cpu of its own"
    assert (plant.priority, plant.phase, plant.cpu) == (70, 0.4, None)
    twice = write("bus:", "realtime: {plant_cpu: 1, plant: {priority: 9}}\nbus:")
    told = "realtime.plant_cpu: is realtime.plant.cpu today; write it there, small.yaml:"
    assert told in message(twice)


def test_nodes_are_complete_and_in_order(write: Write) -> None:
    control, plant = load_rig(write()).nodes().values()
    assert (control.name, plant.name) == ("EXEC", "PLANT")
    assert [spec.name for spec in control.blocks] == ["reference", "controller"]
    assert control.blocks[1].settings == {"kv_Nms_rad": 110.0, "lam_per_s": 16.0}
    assert control.blocks[1].inputs == {"q_rad": "rx.FB.angle", "ref_rad": "reference.ref_rad"}
    assert control.transmit == {"CMD.motor_torque": "controller.tau_Nm"}
    assert control.limits["CMD.motor_torque"].high == 2.0
    assert control.limits["CMD.motor_torque"].rate_per_s is None
    assert plant.blocks[0].settings == {"mass_kg": 80.0, "gap_rad": 0.003}
    assert plant.safe == {"CMD.motor_torque": 0.0}


def test_a_setting_comes_from_the_last_that_gives_it(write: Write) -> None:
    path = write()
    gaps = [
        load_rig(write("      parameters: {gap_rad: 0.003}\n", "")).nodes()["plant"].blocks[0],
        load_rig(write()).nodes()["plant"].blocks[0],
        load_rig(path, settings=["barrel.gap_rad=0.05"]).nodes()["plant"].blocks[0],
    ]
    assert [spec.settings["gap_rad"] for spec in gaps] == [0.002, 0.003, 0.05]
    assert [spec.where("parameters.gap_rad") for spec in gaps] == [
        "parameters.yaml:3:3", "small.yaml:30:20", "--set barrel.gap_rad=0.05",
    ]  # fmt: skip


def test_blocks_and_paths_know_their_place(write: Write) -> None:
    rig = load_rig(write(), "nn")
    controller = rig.nodes()["executive"].blocks[1]
    assert controller.settings == {"w_0": 0.5, "w_1": 0.5, "w_2": 0.5}
    assert controller.inputs["extra"] == "barrel.rate_rad_s"
    places = [controller.where(path) for path in ("", "law", "inputs.extra", "inputs.q_rad")]
    assert places == ["small.yaml:19:5", "small.yaml:13:5", "small.yaml:14:14", "small.yaml:20:16"]
    assert rig.where("executive.transmit.CMD.motor_torque") == "small.yaml:21:14"
    assert str(rig.error("plant.safe", "why")) == "small.yaml:32:3: plant.safe: why"


def test_a_controller_and_settings_apply(write: Write) -> None:
    options = ["rate_hz=2e3", "supervisor.ramp_s=1", "bus.bitrate=null", "bus.channel=can0"]
    options += ["controller=nn", "controller.w_1=7", "evaluation.window_s=[1, 2]", "seed=0"]
    options += ["executive.limits.CMD.motor_torque.high=1.5"]
    rig = load_rig(write(), settings=options)
    config = rig.config
    assert (config.rate_hz, config.supervisor.ramp_s, config.seed) == (2000.0, 1.0, 0)
    assert (config.bus.bitrate, config.bus.channel, config.controller) == (None, "can0", "nn")
    assert rig.nodes()["executive"].blocks[1].settings == {"w_0": 0.5, "w_1": 7.0, "w_2": 0.5}
    assert config.executive.limits["CMD.motor_torque"].high == 1.5
    assert rig.evaluation and rig.evaluation.window_s == (1.0, 2.0)


SCHEMA = [
    Case("rate_hz: 1000", "rate: 1000", "4:1: rate: unknown key; did you mean rate_hz?"),
    Case("duration_s: 6.0\n", "", "1:1: key duration_s is missing"),
    Case("rate_hz: 1000", "rate_hz: fast", "4:1: rate_hz: expected a number, got text 'fast'"),
    Case("rate_hz: 1000", "rate_hz: yes", "4:1: rate_hz: expected a number, got text 'yes'"),
    Case("rate_hz: 1000", "rate_hz: true", "4:1: rate_hz: expected a number, got true"),
    Case("rate_hz: 1000", "rate_hz: 0.5", "4:1: rate_hz: expected a number >= 1.0, got 0.5"),
    Case("rate_hz: 1000", "rate_hz: 1e9", "4:1: rate_hz: expected a number <= 20000.0, got 1"),
    Case("duration_s: 6.0", "duration_s: 0", "5:1: duration_s: expected a number > 0.0, got 0"),
    Case("rig: small", "rig: Small", "1:1: rig: expected text of the form [a-z0-9._-]{1,64}, got"),
    Case("watch: ", "seed: 1.5\nwatch: ", "34:1: seed: expected a whole number, got 1.5"),
    Case("watch: ", "seed: -1\nwatch: ", "34:1: seed: expected a whole number >= 0, got -1"),
    Case("watch: ", "pacing: rael\nwatch: ", "34:1: pacing: unknown value rael; did you mean real"),
    Case("watch: ", "supervisor: {fault_after_cycles: 1}\nwatch: ",
         "34:14: supervisor.fault_after_cycles: expected a whole number >= 2, got 1"),
    Case("watch: ", "supervisor: {ramp: 1}\nwatch: ",
         "34:14: supervisor.ramp: unknown key; did you mean ramp_s?"),
    Case("bus: {bitrate: 1000000}", "bus: null", "6:1: bus: expected a mapping, got null"),
    Case("kv_Nms_rad: 110.0", "kv_Nms_rad: [1]",
         "11:18: controllers.pd.parameters.kv_Nms_rad: expected a number, got [1]"),
    Case("kv_Nms_rad: 110.0", "kv_Nms_rad: 010", "11:30: 010 could be read as octal"),
    Case("law: laws.py\n", "lw: laws.py\n", "13:5: controllers.nn.lw: unknown key; did you"),
    Case("    barrel:\n", "    Barrel:\n", "27:5: plant.blocks.Barrel: expected text of the form"),
    Case("{low: -2.0,", "{low: 3.0,",
         "22:12: executive.limits.CMD.motor_torque: low 3 is not below high 2"),
    Case("rate_per_s: null", "rate_per_s: 0",
         "22:53: executive.limits.CMD.motor_torque.rate_per_s: expected a number > 0.0, got 0"),
    Case("rate_per_s: null", "rate_per_s: .inf",
         "22:53: executive.limits.CMD.motor_torque.rate_per_s: expected a finite number, got inf"),
    Case("rate_per_s: null", "safe: 2.5",
         "22:53: executive.limits.CMD.motor_torque.safe: 2.5 is outside -2..2"),
    Case("{low: -2.0, high: 2.0, rate_per_s: null}", "{safe: .inf}",
         "22:31: executive.limits.CMD.motor_torque.safe: expected a finite number, got inf"),
    Case("watch: ", "local: {node: L, blocks: {}, limits: {A.b: {low: 2, high: -2}}}\nwatch: ",
         "34:39: local.limits.A.b: low 2 is not below high -2"),
    Case("watch: ", "local: {node: L, blocks: {}, safe: {A.b: -.inf}}\nwatch: ",
         "34:37: local.safe.A.b: expected a finite number, got -inf"),
    Case("[3.1, 3.8]", "[3.1]", "35:15: expect.pd.error_rms_rad: expected a list of length 2"),
    Case("[3.1, 3.8]", "[3.1, x]", "35:36: expect.pd.error_rms_rad[1]: expected a number"),
    Case("[3.1, 3.8]", "[3.9, 3.8]", "35:15: expect.pd.error_rms_rad: 3.9 is above 3.8"),
    Case("expect: {pd:", "expect: {pdd:", "35:10: expect.pdd: no such controller; did"),
    Case("controller: pd\n", "controller: pdd\n",
         "7:1: controller: no controller pdd; did you mean pd?"),
    Case("window_s: [3.25, 6.0]", "window_s: [6, 3]", "33:35: evaluation.window_s: expected 0 <="),
    Case("tolerance_rad: 0.01", "tolerance_rad: x", "33:58: evaluation.tolerance_rad: expected"),
    Case("{file: evaluation.py, ", "{", "33:1: evaluation: key file is missing"),
]  # fmt: skip
BLOCKS = [
    Case("barrel:\n      law: model.py:BARREL\n", "barrel:\n",
         "27:5: plant.blocks.barrel: key law is missing"),
    Case("    barrel:\n", "    reference:\n", "27:5: plant.blocks.reference: the executive has"),
    Case("    barrel:\n", "    supervisor:\n", "27:5: plant.blocks.supervisor: this name is taken"),
    Case("    controller:\n", "    kontroller:\n      law: laws.py\n",
         "17:3: executive.blocks: block controller is missing"),
    Case("    controller:\n", "    controller:\n      law: laws.py\n",
         "20:7: executive.blocks.controller.law: belongs at controllers.pd.law"),
    Case("kv_Nms_rad: 110.0", "kvv: 110.0",
         "11:18: controllers.pd.parameters.kvv: unknown parameter; did you mean kv_Nms_rad?"),
    Case("kv_Nms_rad: 110.0", "kv_Nms_rad: 9000",
         "11:18: controllers.pd.parameters.kv_Nms_rad: 9000 is outside 0..500 N m s/rad"),
    Case(", parameters: {size_rad: 1}", "",
         "18:5: executive.blocks.reference: parameter size_rad [rad] is missing: height"),
]  # fmt: skip
FILES = [
    Case("dbc: small.dbc", "dbc: big.dbc", "3:1: dbc: no such file: big.dbc"),
    Case("file: evaluation.py", "file: e.py", "33:14: evaluation.file: no such file: e.py"),
    Case("parameters_file: parameters.yaml", "parameters_file: p.yaml",
         "25:3: plant.parameters_file: no such file: p.yaml"),
    Case("law: model.py:BARREL", "law: m.py:BARREL",
         "28:7: plant.blocks.barrel.law: no such file: m.py"),
]  # fmt: skip
LAW_FAULTS = [
    Case("law: model.py:BARREL", "law: model.py:BAREL",
         "28:7: plant.blocks.barrel.law: BAREL of model.py does not exist; did you mean BARREL?"),
    Case("law: model.py:BARREL", "law: model.py",
         "28:7: plant.blocks.barrel.law: BLOCK of model.py does not exist; known: BARREL"),
    Case("laws.py:PD", "laws.py:NUMBER",
         "10:5: controllers.pd.law: NUMBER of laws.py is of type int"),
    Case('"laws.py:PD"', "none.py",
         "10:5: controllers.pd.law: BLOCK of none.py does not exist; end the file with BLOCK = B"),
    Case('"laws.py:PD"', "a:b:c", "10:5: controllers.pd.law: 'a:b:c' is no law; expected NAME"),
    Case('"laws.py:PD"', "nosuchlaw",
         "10:5: controllers.pd.law: no law nosuchlaw"),
    Case('"laws.py:PD"', "no.such:LAW", "10:5: controllers.pd.law: no module no.such"),
    Case("BARREL = ", "import nosuch\nBARREL = ",
         "28:7: plant.blocks.barrel.law: model.py cannot be imported: "
         "model.py:10: ModuleNotFoundError: No module named 'nosuch'"),
    Case("BARREL = ", "1 / 0\nBARREL = ", "28:7: plant.blocks.barrel.law: model.py cannot be "
         "imported: model.py:10: ZeroDivisionError: division by zero"),
    Case("BARREL = ", "BARREL = = ", "28:7: plant.blocks.barrel.law: model.py cannot be "
         "imported: model.py:10: SyntaxError: invalid syntax"),
]  # fmt: skip


@pytest.mark.parametrize("case", [*SCHEMA, *BLOCKS, *FILES, *LAW_FAULTS], ids=lambda case: case.new)
def test_a_wrong_rig_is_refused_at_its_place(write: Write, case: Case) -> None:
    what = message(write(case.old, case.new))
    assert what.startswith(f"small.yaml:{case.expected}"), what


@pytest.mark.parametrize(
    "case",
    [
        Case("unit: kg", "unit: g",
             "2:24: barrel.mass_kg.unit: unit 'g' where block barrel has 'kg'"),
        Case("value: 80", "value: 0", "2:3: barrel.mass_kg: 0 is outside 0.1..inf kg"),
        Case("value: 80", "value: .inf", "2:3: barrel.mass_kg: inf is outside 0.1..inf kg"),
        Case("value: 80", "value: x", "2:13: barrel.mass_kg.value: expected a number, got"),
        Case(", reason: drawing", "", "2:3: barrel.mass_kg: key reason is missing"),
        Case("  gap_rad: {value", "  gap_mm: {value",
             "3:3: barrel.gap_mm: no block of the plant has gap_mm; did you mean gap_rad?"),
        Case("  gap_rad: {value", "g:\n  mass_kg: {value", "4:3: g.mass_kg: given twice, first at"),
    ],
    ids=lambda case: case.new,
)  # fmt: skip
def test_a_wrong_parameters_file_is_refused_at_its_place(write: Write, case: Case) -> None:
    what = message(write(case.old, case.new))
    assert what.startswith(f"parameters.yaml:{case.expected}"), what


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ("controller.kvv=3", "unknown parameter; did you mean kv_Nms_rad?"),
        ("controller.kv_Nms_rad=9000", "kv_Nms_rad: 9000 is outside 0..500 N m s/rad"),
        ("controller.kv_Nms_rad=x", "expected a number, got text 'x'"),
        ("controller.kv_Nms_rad=", "expected a number, got null"),
        ("barel.gap_rad=1", "no such setting; did you mean barrel.gap_rad?"),
        ("gap_rad=1", "no such setting; did you mean barrel.gap_rad?"),
        ("rate_h=1", "no such setting; did you mean rate_hz?"),
        ("rate_hz=0", "expected a number >= 1.0, got 0"),
        ("bus.bitrat=1", "no such setting; did you mean bus.bitrate?"),
        (
            "losses.FB.share=0.1",
            "no such setting; write losses: {FB: {share: ...}} into the rig "
            "file, then --set can change it",
        ),
        ("seed=010", "010 could be read as octal; write it in decimal, or quote it as text"),
        ("controller=pdd", "no controller pdd; did you mean pd?"),
        ("rate_hz", "expected NAME=VALUE"),
    ],
)
def test_a_wrong_option_is_its_own_place(write: Write, option: str, expected: str) -> None:
    assert message(write(), None, option) == f"--set {option}: {expected}"


def test_a_wrong_controller_option_is_its_own_place(write: Write) -> None:
    expected = "--controller np: no controller np; did you mean nn?"
    assert message(write(), "np").startswith(expected[:35])
    assert message(write(), "np", "controller.w_0=1").startswith(expected[:35])


def test_paths_start_from_the_file_that_says_them(write: Write, tmp_path: Path) -> None:
    write()
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "model.py").write_text(MODEL.replace('"clearance"', '"other"'))
    child = tmp_path / "sub" / "child.yaml"
    child.write_text(
        "base: ../small.yaml\nrig: child\nplant: {blocks: {barrel: {law: 'model.py:BARREL'}}}\n"
    )
    rig = load_rig(child)
    help_text = rig.nodes()["plant"].blocks[0].block.parameters[1].help
    assert (rig.config.rig, rig.dbc.name, help_text) == ("child", "small.dbc", "other")
    assert rig.where("rig") == "sub/child.yaml:2:1" and rig.where("dbc") == "small.yaml:3:1"
    again = load_rig(child, text=rig.resolved())
    assert effective(again) == effective(rig) and "../small.dbc" in rig.resolved()


def test_laws_are_found_by_name_module_or_file(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "laws_of_this_test"
    own.mkdir()
    (own / "pd_of_this_test.py").write_text(LAWS)
    monkeypatch.setattr(resolve, "shipped", lambda: {"bare": "laws_of_this_test.pd_of_this_test"})
    monkeypatch.syspath_prepend(str(tmp_path))
    by_name = load_rig(write('"laws.py:PD"', "bare:PD"))
    by_module = load_rig(write('"laws.py:PD"', "laws_of_this_test.pd_of_this_test:PD"))
    by_file = load_rig(write())
    for rig in (by_name, by_module, by_file):
        assert rig.nodes()["executive"].blocks[1].settings["lam_per_s"] == 16.0


def test_a_file_of_the_project_is_imported_under_its_own_name(write: Write) -> None:
    block = ROOT / "executive" / "laws" / "block.py"
    rig = load_rig(write("law: model.py:BARREL", f"law: {block}:Block"), resolve=False)
    with pytest.raises(RigError, match=r"block.py is of type type, not Block"):
        rig.nodes()
    twins = [name for name in sys.modules if name.startswith("block_")]
    assert not twins, f"imported twice: {twins}"


def test_reading_a_rig_imports_no_numba_until_a_law_is_needed(write: Write) -> None:
    write()
    code = (
        "import sys; from pcpc.executive.rig.reading import load_rig\n"
        "rig = load_rig('small.yaml', settings=['barrel.gap_rad=0.05'], resolve=False)\n"
        "assert rig.config.plant.blocks['barrel'].parameters == {'gap_rad': 0.05}\n"
        "print('numba' in sys.modules); rig.nodes(); print('numba' in sys.modules)\n"
    )
    project = str(ROOT)
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={"PYTHONPATH": project, "HOME": ".", "XDG_CACHE_HOME": str(user_cache())},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.stdout.split() == ["False", "True"], done.stdout + done.stderr


def effective(rig: Rig) -> Any:
    """All that a rig says, in plain data: its values, files and complete settings."""
    config = msgspec.to_builtins(rig.config)
    for section in ("executive", "plant"):
        config[section].pop("blocks")
    config["plant"].pop("parameters_file")
    config.pop("controllers")
    nodes = [
        (n.name, [(b.name, b.settings, b.inputs) for b in n.blocks], n.transmit, n.limits, n.safe)
        for n in rig.nodes().values()
    ]
    for name in ("dbc", "evaluation"):
        config.pop(name)
    return config, nodes, rig.dbc, rig.evaluation


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    title=st.text(st.characters(codec="utf-8"), max_size=12),
    rate_hz=st.floats(1, 20000),
    gain=st.floats(0, 500),
    gap=st.floats(0, 0.1),
    seed=st.integers(0, 2**63 - 1),
    channel=st.none() | st.integers(0, 9) | st.sampled_from(["vcan0", "010", "1e3", "yes", ""]),
    controller=st.sampled_from(["pd", "nn"]),
)
def test_resolved_text_loads_to_equal_values(
    write: Write, title: str, rate_hz: float, gain: float, gap: float, seed: int,
    channel: str | int | None, controller: str,
) -> None:  # fmt: skip
    path = write()
    options = [f"rate_hz={rate_hz!r}", f"barrel.gap_rad={gap!r}", f"seed={seed}"]
    options += [f"controller.kv_Nms_rad={gain!r}"] if controller == "pd" else []
    options += [f"title={msgspec.json.encode(title).decode()}"] if title.isprintable() else []
    options += [f"bus.channel={msgspec.json.encode(channel).decode()}"]
    rig = load_rig(path, controller, options)
    assert rig.config.bus.channel == channel and rig.config.rate_hz == rate_hz
    again = load_rig(path, text=rig.resolved())
    assert effective(again) == effective(rig), rig.resolved()
    assert again.resolved() == rig.resolved()


def test_a_law_beside_the_packages_has_one_name_whatever_the_path(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`python -m` puts the working folder on the path; the compile cache stores the name."""
    monkeypatch.syspath_prepend(str(ROOT))
    assert project_name(ROOT / "tests" / "executive" / "relay" / "law.py") is None
    assert project_name(ROOT / "plants" / "probe" / "law.py") == "pcpc.plants.probe.law"
