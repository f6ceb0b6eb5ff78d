"""What a rig cannot use of an FMU is told in one line, with the cure; what fails is named."""

import re
import shutil
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from processes import pcpc
from reference_fmus import PLATFORM, columns, fmu, made, rig

from pcpc.executive.errors import RigError
from pcpc.executive.nodes import fmus
from pcpc.executive.nodes.plan import failures
from pcpc.executive.nodes.virtual import VirtualRun, in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make.fmu import checks

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here: apt install gcc")

COLD = {  # in model.c of VanDerPol: from 0.5 s on it does not give x0
    r"case vr_x0:\n            ASSERT_NVALUES\(1\);\n            values":
    'case vr_x0:\n            ASSERT_NVALUES(1);\n if (comp->time > 0.5) '
    '{ logError(comp, "The oven is %s.", "cold"); return Error; }\n            values',
}  # fmt: skip
NOTHING = {key: re.sub(r"\{.*\}", "{ values[(*index)++] = 0.0 / 0.0; return OK; }", text)
           for key, text in COLD.items()}  # fmt: skip
CRASH = {key: re.sub(r"\{.*\}", "*(volatile int*)8 = 1;", text) for key, text in COLD.items()}


def refused(path: Path) -> str:
    """Return why a rig is refused, the place in its file taken away."""
    with pytest.raises(RigError) as error:
        in_memory(load_rig(path))
    text = str(error.value)
    assert "\n" not in text and str(path) in text
    return text


def test_a_file_that_is_not_there_or_is_no_fmu(tmp_path: Path) -> None:
    path = rig(tmp_path, tmp_path / "none.fmu", "fmu.x")
    assert "none.fmu" in refused(path) and "no such file" in refused(path)
    (tmp_path / "none.fmu").write_text("an essay about oscillators")
    assert "not an FMU, which is a zip archive" in refused(path)
    with zipfile.ZipFile(tmp_path / "none.fmu", "w") as archive:
        archive.writestr("readme.txt", "nothing")
    assert "there is no modelDescription.xml in it" in refused(path)


def test_a_damaged_fmu(tmp_path: Path) -> None:
    file = tmp_path / "hurt.fmu"
    shutil.copy(fmu("VanDerPol", 2), file)
    data = bytearray(file.read_bytes())
    path = rig(tmp_path, file, "fmu.x0")
    file.write_bytes(data[: len(data) // 2])
    assert "not an FMU, which is a zip archive" in refused(path)
    at = data.index(b"\x7fELF") + 500
    data[at] ^= 0xFF
    file.write_bytes(data)
    assert "does not have its checksum" in refused(path)


@pytest.mark.parametrize(
    ("edits", "words"),
    [
        ({'fmiVersion="2.0"': 'fmiVersion="1.0"'}, "FMI 1.0; 2.0 and 3.0 are supported"),
        ({'fmiVersion="2.0"': 'fmiVersion="9"'}, "FMI 9; 2.0 and 3.0 are supported"),
        ({r"(?s)<CoSimulation.*</CoSimulation>": ""}, "an FMU for model exchange only; export it"),
        ({"<CoSimulation": '<CoSimulation needsExecutionTool="true"'}, "needs Reference FMUs"),
        ({'causality="output"': 'causality="exit"'}, "modelDescription.xml: "),
        ({"<ModelVariables>": "<ModelVariables><"}, "modelDescription.xml: "),
        ({"{BD403596": "{BD4"}, "VanDerPol: it cannot be instantiated: Wrong GUID."),
    ],
)  # fmt: skip
def test_what_its_description_says_is_believed(
    edits: dict[str, str], words: str, tmp_path: Path
) -> None:
    file = made("VanDerPol", 2, tmp_path / "a.fmu", {re.sub(r"^\{", r"\{", k): v
                                                     for k, v in edits.items()})  # fmt: skip
    found = refused(rig(tmp_path, file, "fmu.x0"))
    assert words.replace("VanDerPol", "Van der Pol oscillator") in found, found


def test_an_fmu_for_another_machine(tmp_path: Path) -> None:
    file = made("VanDerPol", 2, tmp_path / "a.fmu", platform="win64")
    wanted = f"nothing for this machine, binaries/{PLATFORM[2]}/VanDerPol.so; it has win64"
    assert wanted in refused(rig(tmp_path, file, "fmu.x0"))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ("inputs: {Int32_inptu: rx.CMD.mode}", "has no input Int32_inptu; did you mean Int32_i"),
        ("inputs: {Int32_output: rx.CMD.mode}", "Int32_output of Feedthrough-3.fmu is of causality "
         "output; only inputs are wired"),
        ("parameters: {Float64_fixed_paramter: 1}", "unknown parameter; did you mean "
         "Float64_fixed_parameter"),
        ("inputs: {Float64_continuous_input: time.t_s}", "is in '1' but time.t_s is in 's'"),
        ("blocks: {fmu: {law: fmu, file: a.fmu}}", "a block fmu is there, too; rename that"),
    ],
)  # fmt: skip
def test_names_and_units_of_its_variables(more: str, words: str, tmp_path: Path) -> None:
    found = refused(rig(tmp_path, fmu("Feedthrough", 3), "fmu.Int32_output", more))
    assert words in found, found


def test_without_fmpy_the_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "fmpy", None)
    path = rig(tmp_path, fmu("VanDerPol", 2), "fmu.x0")
    assert f"FMUs need FMPy: {sys.executable} -m pip install 'fmpy~=" in refused(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text[:-20], "no description of an FMU"),
        (lambda text: text.replace('"name":"x1"', '"name":"x0"'), "two ports are named x0"),
        (lambda text: text, "only its description; say where it is: --fmu FILE"),
    ],
)  # fmt: skip
def test_a_description_from_a_log_runs_nothing(
    change: Callable[[str], str], words: str, tmp_path: Path
) -> None:
    path = rig(tmp_path, fmu("VanDerPol", 2), "fmu.x0")
    (text,) = load_rig(path).tables().values()
    (tmp_path / "kept.json").write_text(change(text), encoding="utf-8")
    path.write_text(path.read_text(encoding="utf-8").replace("VanDerPol-2.fmu", "kept.json"))
    with pytest.raises(RigError) as error:
        in_memory(load_rig(path))
    assert words in str(error.value)


def test_an_fmu_that_fails_is_a_fault_of_the_plant_with_its_own_words(tmp_path: Path) -> None:
    file = made("VanDerPol", 3, tmp_path / "cold.fmu", code=COLD)
    run = VirtualRun(load_rig(rig(tmp_path, file, "fmu.x0", duration=1.0)), None)
    for _ in run.advance():
        pass
    assert list(failures(run.plans[1])) == [
        "fmu: getting its outputs in cycle 51 returned error: The oven is cold."
    ]
    found = run.memory.log().node["plant"].columns
    assert np.isfinite(found["fmu.x0"][:51]).all() and np.isnan(found["fmu.x0"][51:]).all()
    assert set(found["fmu.fmi_status"][51:].tolist()) == {3.0}
    assert found["supervisor.fault"][-1] != 0.0


def test_a_number_that_is_none_is_a_fault_of_the_plant(tmp_path: Path) -> None:
    file = made("VanDerPol", 3, tmp_path / "nothing.fmu", code=NOTHING)
    found = columns(rig(tmp_path, file, "fmu.x0", duration=1.0))
    assert np.isnan(found["fmu.x0"][51]) and found["supervisor.fault"][-1] != 0.0


def test_check_runs_it_in_a_process_of_its_own(tmp_path: Path) -> None:
    from pcpc.executive.nodes.plan import plan

    made("VanDerPol", 3, tmp_path / "crash.fmu", code=CRASH)
    path = rig(tmp_path, tmp_path / "crash.fmu", "fmu.x0")
    with pytest.raises(RigError, match="fmu: its process ended with SIGSEGV"):
        checks.report(plan(load_rig(path), "plant", "real"))
    good = rig(tmp_path, fmu("VanDerPol", 3), "fmu.x0")
    (about,) = checks.report(plan(load_rig(good), "plant", "real"))
    assert about.steps == checks.STEPS and 0.0 < about.median_us <= about.worst_us
    slow = rig(tmp_path, fmu("VanDerPol", 3), "fmu.x0", rate=20000.0)
    assert checks.report(plan(load_rig(slow), "plant", "real"))[0].period_us == 50.0


@pytest.mark.parametrize("crashes", [True, False])
def test_a_crash_in_an_fmu_is_named_and_has_a_code(crashes: bool, tmp_path: Path) -> None:
    file = made("VanDerPol", 3, tmp_path / "crash.fmu", code=CRASH if crashes else {})
    path = rig(tmp_path, file, "fmu.x0", duration=1.0)
    words = ("simulate", str(path), "-o", str(tmp_path / "run"), "--no-figure", "--quiet")
    done = pcpc(*words)
    assert done.code == (5 if crashes else 0), done
    said = "fmu (van der Pol oscillator): ended by SIGSEGV in the code of an FMU; nothing is judged"
    assert [line for line in done.err.splitlines() if "SIG" in line] == [said] * crashes, done
    assert (tmp_path / "run" / "summary.json").is_file() != crashes


def test_a_warning_of_an_fmu_is_told_and_counted(tmp_path: Path) -> None:
    code = {r"\[\(\*index\)\+\+\] = M\(x0\);\n            return OK;":
            "[(*index)++] = M(x0); return comp->time > 0.5 ? Warning : OK;"}  # fmt: skip
    path = rig(tmp_path, made("VanDerPol", 3, tmp_path / "warm.fmu", code=code), "fmu.x0")
    words = ("-o", str(tmp_path / "run"), "--no-figure", "--set", "duration_s=1.0")
    done = pcpc("simulate", str(path), *words)
    assert done.code == 0, done
    assert "fmu: getting its outputs returned a warning" in done.err.splitlines(), done.err
    assert "plant: the FMU fmu returned a warning, first in cycle 51" in done.out, done.out
    assert "verdict  ok, with 1 warning above (" in done.out, done.out


def test_messages_of_warning_are_counted_and_the_first_is_kept() -> None:
    said = fmus._Said()
    for status, text in ((0, b"fine"), (1, b"warm  \n"), (1, b"hot"), (2, b"cold"), (1, None)):
        said.take(status, text)
    assert (said.words, said.warning, said.warnings) == (["cold"], "warm", 3)
