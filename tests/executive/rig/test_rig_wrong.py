"""Each class of error in a rig file, with its place."""

import pytest
from small_rig import Case, Write, message
from wrong_rigs import BLOCKS, SCHEMA

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
