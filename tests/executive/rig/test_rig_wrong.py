"""Each class of error in a rig file, with its place."""

import pytest
from small_rig import Case, Write, message

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
    Case("watch: ", "more_plants: {}\nwatch: ",
         "34:1: more_plants: unknown key; did you mean plant?"),
    Case("watch: ", "plant_17: {like: plant}\nwatch: ", "34:1: plant_17: unknown key; did"),
    Case("watch: ", "plant_3: 5\nwatch: ", "34:1: plant_3: expected a mapping or null, got 5"),
    Case("watch: ", "plant_16: {like: plant, nod: P}\nwatch: ",
         "34:25: plant_16.nod: unknown key; did you mean node?"),
    Case("[3.1, 3.8]", "[3.1]", "35:15: expect.pd.error_rms_rad: expected a list of length 2"),
    Case("[3.1, 3.8]", "[3.1, x]", "35:36: expect.pd.error_rms_rad[1]: expected a number"),
    Case("[3.1, 3.8]", "[3.9, 3.8]", "35:15: expect.pd.error_rms_rad: 3.9 is above 3.8"),
    Case("[3.1, 3.8]", "[-.inf, .inf]", "35:15: expect.pd.error_rms_rad: limits nothing"),
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
    Case('"laws.py:PD"', "a:b:c", "10:5: controllers.pd.law: 'a:b:c' is not a law; expected NAME"),
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


@pytest.mark.quick
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
        (
            "watchdog.silent_cycles=0",
            "no such setting; write watchdog: {silent_cycles: ...} into the rig file, then --set "
            "can change it",
        ),
        ("watchdog=0", "expected a mapping or null, got 0"),
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
