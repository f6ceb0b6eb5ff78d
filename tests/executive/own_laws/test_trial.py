"""Laws of the user's that are wrong: told in one line with file and line, before they run.

Each is a law of the probe's plant in a folder of its own. The trial is interpreted; what it lets
pass and numba refuses is told in the same words.
"""

import json
import os
import runpy
import shutil
import subprocess
from pathlib import Path

import pytest
from copies import program
from places import ROOT

from pcpc.executive.errors import RigError
from pcpc.executive.nodes.plan import plan
from pcpc.executive.own_laws import trial
from pcpc.executive.own_laws.law_errors import cause
from pcpc.executive.rig import law_lookup as laws
from pcpc.executive.rig.reading import load_rig

PROBE = ROOT / "plants" / "probe"
HEAD = """\
import numpy as np
from pcpc.executive.laws.block import Block, Nothing, Ports, Prepared, flat, inline, port, stage
TABLE = np.array([1.0, 2.0])
class Gains(Ports):
    gain = port("", "k")
    target = port("", "r")
class States(Ports):
    w = port("", "weights", shape=(2, 3))
    done_s = port("s", "time done")
class Inputs(Ports):
    position = port("", "measured")
class Outputs(Ports):
    command = port("", "what the lag is told")
"""
STEP = (
    "@stage\ndef step(t: float, dt: float, p: Gains, x: States, u: Inputs, y: Outputs) -> None:\n"
)
FIRST = HEAD.count("\n") + 3  # the line of a body behind STEP
GOOD = f"{STEP}    y.command = p.gain * (p.target - u.position)\n"


def rig_with(folder: Path, law: str, more: str = "", *lines: str) -> Path:
    """Write the probe with another law; return its rig file."""
    folder.mkdir(exist_ok=True)
    for name in ("model.py", "probe.dbc", "rig.yaml"):
        shutil.copy(PROBE / name, folder)
    (folder / "law.py").write_text(f"{HEAD}{law}BLOCK = Block(step{more})\n")
    rig = folder / "rig.yaml"
    rig.write_text(rig.read_text() + "\n".join(lines) + "\n")
    return rig


def refusal(rig: Path) -> str:
    """Return the one line with which the executive's plan is refused."""
    with pytest.raises(RigError) as refused:
        plan(load_rig(rig), "executive", "lockstep")
    text = str(refused.value)
    assert "\n" not in text and text.startswith(f"{rig}:"), text
    return text


OUTSIDE = {  # a body; its line, counted from 0, with what is said; the source line
    "an input": ("u[7] = 0.0", 0, "u[7]: say the port's name: u.position"),
    "an output": ("y.comand = 1.0", 0, "Outputs has no port comand; did you mean command"),
    "a state": ("y.command = x.v[0, 0]", 0, "States has no port v"),
    "a row": ("y.command = x.w[2, 0]", 0, "x.w[2, 0]: x.w has 2 x 3 elements"),
    "a column": ("y.command = x.w[1][3]", 0, "x.w[1][3]: x.w[1] has 3 elements"),
    "below 0": ("x.w[-1, 0] += u.position", 0, "x.w[-1, 0]: x.w has 2 x 3 elements; an index co"),
    "computed": ("k = int(p.gain) - 9\n    x.w[0, k] = 1.0", 1, "x.w[0, -5]: x.w has 2 x 3 el"),
    "whole": ("x.w = 0.0", 0, "w has several values: set them one by one"),
    "of a loop": ("for i in range(3):\n        x.w[i, 0] = 1.0", 1, "x.w[2, 0]: x.w has 2 x 3"),
    "of a table": ("y.command = TABLE[2]", 0, "IndexError: index 2 is"),
    "only later": ("if t > 90.0:\n        x.w[0, 3] = 0.0", 1, "x.w[0, 3]: x.w has"),
    "by input": ("x.w[0, int(2.0 * u.position * u.position)] = 0.0", 0, "x.w[0, "),
    "not set": ("if t < 0.0:\n        k = 1.0\n    y.command = k", 2, "Unbound"),
    "endless": ("while t < 1.0:\n        y.command = 1.0", 0, "does not return within 0.2 s"),
    "leaves": ("raise SystemExit(3)", 0, "ends the process; it"),
    "raises": ("raise ValueError('no')", 0, "ValueError: no"),
    "forgotten": (
        "y.command = tanh(u.position)",
        0,
        "NameError: name 'tanh' is not defined; from pcpc.executive.laws.emath import t",
    ),
    "unknown": ("y.command = tanhh(u.position)", 0, "name 'tanhh' is not defined, in"),
}


@pytest.mark.parametrize("kind", OUTSIDE)
def test_a_step_that_reaches_outside_is_told_with_its_line(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    body, line, said = OUTSIDE[kind]
    case = trial_case(rig_with(tmp_path, f"{STEP}    {body}\n"))
    monkeypatch.setattr(trial, "STEP_S", 0.2)
    monkeypatch.setattr(trial, "STEP_PERIODS", 0.0)
    before = os._exit, os.abort
    problem = in_this_process(case)
    assert (os._exit, os.abort) == before
    assert said in problem, problem
    if kind != "endless":
        source = body.splitlines()[line].strip()
        assert f"law.py:{FIRST + line}: " in problem and f"in `{source}`" in problem, problem


def trial_case(rig: Path) -> trial.TrialCase:
    settings = {"gain": 4.0, "target": 1.0}
    return trial.TrialCase(str(rig.with_name("law.py")), "", "BLOCK", settings, 1000.0, 1)


def in_this_process(case: trial.TrialCase) -> str:
    """Return what the child finds, without a child; its step is interpreted."""
    from pcpc.drivers.compiled import stage

    before = stage.JIT_OFF
    stage.JIT_OFF = True
    try:
        return trial._problem(case, lambda phase: None)
    finally:
        stage.JIT_OFF = before


def test_a_helper_is_named_where_it_reaches_outside(tmp_path: Path) -> None:
    """The whole way: a child, the rig's place, the line of the helper."""
    helper = "@inline\ndef last(v, n):\n    return v[n]\n\n\n"
    law = f"{helper}{STEP}    y.command = last(x.w[0], 3)\n"
    text = refusal(rig_with(tmp_path, law))
    assert "controllers.proportional.law" in text, text
    assert f"law.py:{FIRST}: x.w[0][3]: x.w[0] has 3 elements, in `return v[n]`" in text, text


HUGE = "class Huge(Ports):\n    s = port('', '', shape={shape})\n"
BLOCKS = {
    "None": ("", "prepare=lambda s, r, n: None", "prepare returned None; expected Prepared(param"),
    "raises": ("", "prepare=lambda s, r, n: {}['k']", "KeyError|prepare=lambda s, r, n: {}['k']"),
    "leaves": ("", "prepare=lambda s, r, n: exit(3)", "ends the process; it must not"),
    "unknown": (
        "", 'prepare=lambda s, r, n: Prepared({"gian": 1.0})', "gave gian: no such port; did",
    ),
    "text": ("", 'prepare=lambda s, r, n: Prepared({"gain": "x"})', "gain: prepare gave 'x'; exp"),
    "nan": ("", 'prepare=lambda s, r, n: Prepared({"gain": np.nan})', "gain: prepare gave nan; e"),
    "huge": (HUGE.format(shape="10**9"), "settings=Huge", "size 1000000000 makes 1000000011 varia"),
    "negative": (HUGE.format(shape=-3), "", "ValueError: shape -3: at least 1"),
    "zero": (HUGE.format(shape=0), "", "ValueError: shape 0: at least 1"),
    "half": (HUGE.format(shape="(2.5,)"), "", "ValueError: shape (2.5,): at least 1"),
    "twice": ("class Twice(Gains):\n    gain = port('', '')\n", "", "two ports are named gain"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BLOCKS)
def test_a_block_that_no_node_can_hold_is_refused(tmp_path: Path, kind: str) -> None:
    before, more, said = BLOCKS[kind]
    law = f"{before}{GOOD}"
    problem = in_this_process(trial_case(rig_with(tmp_path, law, more and f", {more}")))
    assert all(part in problem for part in said.split("|")), problem
    assert "\n" not in problem, problem


MODULES = {
    "exit": (
        "import sys\nsys.exit(0)\n",
        f"law.py:{FIRST + 2}: ends the process; it|`sys.exit(0)`",
    ),
    "_exit": (
        "import os\nos._exit(0)\n",
        f"law.py:{FIRST + 2}: ends the process; a|`os._exit(0)`",
    ),
    "signal": ("import os\nos.kill(os.getpid(), 9)\n", "process ended in its import with SIGKILL"),
    "reads": ("input('name? ')\n", f"law.py:{FIRST + 1}: EOFError|`input('name? ')`"),
}


@pytest.mark.parametrize("kind", MODULES)
def test_a_module_that_ends_or_reads_is_told_in_a_line(tmp_path: Path, kind: str) -> None:
    code, said = MODULES[kind]
    text = refusal(rig_with(tmp_path, f"{GOOD}{code}"))
    assert all(part in text for part in said.split("|")), text


def test_a_law_that_makes_up_for_a_leap_in_time_does_not_hang(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trial, "LATE_S", 0.1)
    law = f"{STEP}    while x.done_s < t:\n        x.done_s += 1e-5\n    y.command = x.done_s\n"
    assert in_this_process(trial_case(rig_with(tmp_path, law))) == ""


def test_the_laws_of_the_project_are_not_tried() -> None:
    use = laws.Use({}, 1000.0, 1)
    assert {"actuators", "families", "probe", "quarter_car"} < laws.shipped_plants()
    for name in laws.shipped_plants():
        for file in (PROBE.parent / name).rglob("*.py"):
            assert laws.users_case(f"{file.name}:BLOCK", file, use) is None, file
    assert laws.users_case("pd", Path(), use) is None
    assert laws.users_case("references:step", Path(), use) is None


def test_an_endless_import_is_told_with_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trial, "IMPORT_S", 0.2)
    problem = in_this_process(trial_case(rig_with(tmp_path, f"{GOOD}while True:\n    pass\n")))
    assert "does not return within 0.2 s" in problem and "law.py:" in problem, problem


@pytest.mark.parametrize("changed", ["own_helper.py", "table.txt", "prepared.txt"])
def test_a_law_that_passed_is_not_tried_again_until_it_or_what_it_reads_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], changed: str
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(trial, "_passes", set())
    rig = rig_with(tmp_path / "rig", f"{READING}{GOOD}", ", prepare=prepare")
    contents = {"own_helper.py": "A = {}\n", "table.txt": "{}\n", "prepared.txt": "{}\n"}
    for name, content in contents.items():
        rig.with_name(name).write_text(content.format(1.0))
    case = trial_case(rig)
    assert trial.law_problem(case) == ""
    assert "law.py: prints: hello" in capfd.readouterr().err
    trial._passes.clear()
    assert trial.law_problem(case) == "" and capfd.readouterr().err == "", "remembered"
    rig.with_name(changed).write_text(contents[changed].format(2.0))
    trial._passes.clear()
    assert trial.law_problem(case) == "" and "hello" in capfd.readouterr().err, "tried again"


READING = """\
from pathlib import Path
import own_helper
HERE = Path(__file__).parent
TWO = float((HERE / "table.txt").read_text()) + own_helper.A
print("hello")
def prepare(settings, rate_hz, seed):
    return Prepared({**settings, "gain": float((HERE / "prepared.txt").read_text())})
"""


REFUSED = {  # by numba; the trial lets them pass: a body, its line, what is said
    "text": ("k = 'a'\n    y.command = len(k + 'b')", 1, "cannot be"),
    "list": (
        "k = [u.position, 1.0]\n    y.command = k[1]",
        0,
        "it needs memory of its own (a list",
    ),
    "array": ("k = np.zeros(3)\n    y.command = k[0]", 0, "cannot be co"),
    "prints": ("y.command = 1.0\n    print(u.position)", -2, "a step cannot print or make text; w"),
    "returns": ("y.command = 1.0\n    return u.position", 1, "cannot be compiled"),
    "plain": ("y.command = plain(u.position)", 0, "name 'plain' is plain Python; put @inline abo"),
    "deep": ("y.command = deep(u.position)", -3, "cannot be compiled"),
}
HELPERS = "def plain(a):\n    return a\n@inline\ndef deep(a):\n    return {1.0: a}[1.0]\n"


@pytest.mark.parametrize("kind", REFUSED)
def test_what_numba_refuses_is_told_with_the_users_line(tmp_path: Path, kind: str) -> None:
    body, line, said = REFUSED[kind]
    text = refusal(rig_with(tmp_path, f"{HELPERS}{STEP}    {body}\n"))
    assert said in text and f"law.py:{FIRST + HELPERS.count(chr(10)) + line}: " in text, text
    assert "site-packages" not in text, text


WITHOUT_TRIAL = {  # a body, its line, what is said
    "several": ("y.command = x.w[0]", 0, "cannot cast Cells((3,), float64) to float64, in `y.com"),
    "flat": (
        "y.command = flat(x.w)[0]",
        0,
        "there is no flat(Cells((2, 3), float64)); write a loo",
    ),
    "numba's": ("x.w[0, 0] = x", -2, "no definition for lowering <built-in function setitem>(Cel"),
}


@pytest.mark.parametrize("kind", WITHOUT_TRIAL)
def test_what_the_trial_would_refuse_is_told_with_the_users_line_too(
    tmp_path: Path, kind: str
) -> None:
    body, line, said = WITHOUT_TRIAL[kind]
    rig_with(tmp_path, f"{STEP}    {body}\n")
    with pytest.raises(Exception) as refused:
        runpy.run_path(str(tmp_path / "law.py"))
    text = cause(refused.value)
    assert f"law.py:{FIRST + line}: cannot be compiled: {said}" in text, text


STEPS = {
    "plain": ("def step(t, dt, p, x, u, y):\n", "the step is plain Python; put @stage above its"),
    "bare": ("@stage\ndef step(t, dt, p, x, u, y):\n", "does not say which ports p has: `p: Gain"),
    "half": (
        "@stage\ndef step(t, dt, p: Gains, x: States, u: Inputs, y):\n", "which ports y has",
    ),
    "few": ("@stage\ndef step(t, p, x, u, y):\n", "the step is not step(t, dt, p, x, u, y)"),
}  # fmt: skip


@pytest.mark.parametrize("kind", STEPS)
def test_a_step_that_is_none_is_told_how_one_looks(tmp_path: Path, kind: str) -> None:
    head, said = STEPS[kind]
    text = refusal(rig_with(tmp_path, f"{head}    y.command = u.position\n"))
    assert said in text and "law.py:" in text, text


def test_check_steps_a_law_with_the_rigs_settings_even_if_it_passed_before(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, f"{STEP}    y.command = x.w[0, int(p.gain) - 4]\n")
    words = [program(), "check", str(rig), "--json"]
    good = subprocess.run(words, capture_output=True, text=True)
    assert good.returncode == 0 and json.loads(good.stdout)["rig"] == "probe", good
    words += ["--set", "controller.gain=9.0"]
    bad = subprocess.run(words, capture_output=True, text=True)
    assert bad.returncode == 2, bad
    assert "x.w[0, 5]: x.w has 2 x 3 elements" in bad.stderr, bad
    said = [line for line in bad.stderr.splitlines() if not line.startswith("compiling for")]
    assert bad.stdout == "" and len(said) == 1, bad
