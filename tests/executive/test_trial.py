"""Laws of the user's that are wrong: told in one line with file and line, before they run.

Each is a law of the probe's plant in a folder of its own. The trial is interpreted; what it lets
pass and numba refuses is told in the same words.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pcpc.executive.errors import RigError
from pcpc.executive.nodes.plan import plan
from pcpc.executive.rig import resolve as laws
from pcpc.executive.rig import trial
from pcpc.executive.rig.reading import load_rig

PROBE = Path(__file__).resolve().parents[2] / "plants" / "probe"
HEAD = """\
import numpy as np
from pcpc.executive.laws.block import Block, Port, Prepared, inline, stage
TABLE = np.array([1.0, 2.0])
"""
STEP = "@stage\ndef step(t, dt, p, x, u, y):\n"
GOOD = f"{STEP}    y[0] = p[0] * (p[1] - u[0])\n"
BLOCK = """\
BLOCK = Block(
    step,
    inputs=(Port("position", "", "measured"),),
    outputs=(Port("command", "", "what the lag is told"),),
    settings=(Port("gain", "", "k"), Port("target", "", "r")),
    {more}
)
"""


def rig_with(folder: Path, law: str, more: str = "", *lines: str) -> Path:
    """Write the probe with another law; return its rig file."""
    folder.mkdir(exist_ok=True)
    for name in ("model.py", "probe.dbc", "rig.yaml"):
        shutil.copy(PROBE / name, folder)
    (folder / "law.py").write_text(f"{HEAD}{law}{BLOCK.format(more=more)}")
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


OUTSIDE = {
    "an input": (
        "    y[0] = u[7]\n",
        "law.py:6: u[7]: the block has 1 input (pos|`y[0] = u[7]`",
    ),
    "an output": (
        "    y[5000] = 1.0\n",
        "law.py:6: y[5000]: the block has|`y[5000] = 1.0`",
    ),
    "added to": ("    x[0] += u[0]\n", "law.py:6: x[0]: the block has no state|`x[0] += u[0]`"),
    "below 0": (
        "    y[0] = u[-1]\n",
        "u[-1]: the block has 1 input (position); an index counts",
    ),
    "computed": (
        "    k = int(p[0]) - 9\n    y[0] = p[k]\n",
        "law.py:7: p[-5]: the|`y[0] = p[k]`",
    ),
    "too wide": ("    y[0] = p[0:4][1]\n", "p[0:4]: the block has 2 parameters (gain, target)"),
    "of a part": ("    y[0] = p[1:2][1]\n", "p[1:2][1]: this part has 1 element"),
    "of a loop": (
        "    for i in range(3):\n        y[0] = p[i]\n",
        "law.py:7: p[2]:|`y[0] = p[i]`",
    ),
    "of a table": (
        "    y[0] = TABLE[2]\n",
        "law.py:6: IndexError: index 2 is|`y[0] = TABLE[2]`",
    ),
    "only later": (
        "    if t > 90.0:\n        y[1] = 0.0\n",
        "law.py:7: y[1]: the b|`y[1] = 0.0`",
    ),
    "by input": ("    y[int(2.0 * u[0] * u[0])] = 0.0\n", "law.py:6: y["),
    "not set": (
        "    if t < 0.0:\n        k = 1.0\n    y[0] = k\n",
        "law.py:8: Unbound|`y[0] = k`",
    ),
    "endless": ("    while t < 1.0:\n        y[0] = 1.0\n", "does not return within 0.2 s"),
    "leaves": (
        "    raise SystemExit(3)\n",
        "ends the process; a|`raise SystemExit(3)`",
    ),
    "raises": (
        "    raise ValueError('no')\n",
        "law.py:6: ValueError: no|`raise ValueError('no')`",
    ),
}


@pytest.mark.parametrize("kind", OUTSIDE)
def test_a_step_that_reaches_outside_is_told_with_its_line(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    body, said = OUTSIDE[kind]
    case = trial_case(rig_with(tmp_path, f"{STEP}{body}"))
    monkeypatch.setattr(trial, "STEP_S", 0.2)
    monkeypatch.setattr(trial, "STEP_PERIODS", 0.0)
    before = os._exit, os.abort
    problem = in_this_process(case)
    assert (os._exit, os.abort) == before
    assert all(part in problem for part in said.split("|")), problem


def trial_case(rig: Path) -> trial.Case:
    settings = {"gain": 4.0, "target": 1.0}
    return trial.Case(str(rig.with_name("law.py")), "", "BLOCK", settings, 1000.0, 1)


def in_this_process(case: trial.Case) -> str:
    """Return what the child finds, without a child; its step is interpreted."""
    from pcpc.executive.laws import block

    stage = block.stage
    block.stage = lambda step: step
    try:
        return trial._problem(case, lambda phase: None)
    finally:
        block.stage = stage


def test_a_helper_is_named_where_it_reaches_outside(tmp_path: Path) -> None:
    """The whole way: a child, the rig's place, the line of the helper."""
    helper = "@inline\ndef last(v, n):\n    return v[n]\n\n\n"
    text = refusal(rig_with(tmp_path, f"{helper}{STEP}    y[0] = last(u, 3)\n"))
    assert "controllers.proportional.law" in text, text
    assert "law.py:6: u[3]: the block has 1 input (position), in `return v[n]`" in text, text


BLOCKS = {
    "huge": ('states=(Port("s", "", "", size=10**9),)', "size 1000000000 makes 1000000002 variabl"),
    "negative": ('states=(Port("s", "", "", size=-3),)', "port s has size -3; at least 1"),
    "zero": ('states=(Port("s", "", "", size=0),)', "port s has size 0; at least 1"),
    "half": ('states=(Port("s", "", "", size=2.5),)', "port s has size 2.5; at least 1"),
    "no port": ("states=(1, 2)", "states is (1, 2); expected a tuple of Port"),
    "None": ("prepare=lambda s, r, n: None", "prepare returned None; expected Prepared(param"),
    "raises": ("prepare=lambda s, r, n: {}['k']", "KeyError|`prepare=lambda s, r, n: {}['k']`"),
    "leaves": ("prepare=lambda s, r, n: exit(3)", "ends the process; a law must not"),
    "unknown": ('prepare=lambda s, r, n: Prepared({"gian": 1.0})', "gave gian: no such port; did"),
    "text": ('prepare=lambda s, r, n: Prepared({"gain": "x"})', "gain: prepare gave 'x'; expect"),
    "nan": ('prepare=lambda s, r, n: Prepared({"gain": np.nan})', "gain: prepare gave nan; exp"),
}


@pytest.mark.parametrize("kind", BLOCKS)
def test_a_block_that_no_node_can_hold_is_refused(tmp_path: Path, kind: str) -> None:
    more, said = BLOCKS[kind]
    problem = in_this_process(trial_case(rig_with(tmp_path, GOOD, more)))
    assert all(part in problem for part in said.split("|")), problem
    assert "\n" not in problem, problem


MODULES = {
    "exit": (
        "import sys\nsys.exit(0)\n",
        "law.py:8: ends the process; a|`sys.exit(0)`",
    ),
    "_exit": (
        "import os\nos._exit(0)\n",
        "law.py:8: ends the process; a|`os._exit(0)`",
    ),
    "signal": ("import os\nos.kill(os.getpid(), 9)\n", "process ended in its import with SIGKILL"),
    "reads": ("input('name? ')\n", "law.py:7: EOFError|`input('name? ')`"),
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
    more = 'states=(Port("done_s", "s", "time done"),)'
    law = f"{STEP}    while x[0] < t:\n        x[0] += 1e-5\n    y[0] = x[0]\n"
    assert in_this_process(trial_case(rig_with(tmp_path, law, more))) == ""


def test_the_laws_of_the_project_are_not_tried() -> None:
    use = laws.Use({}, 1000.0, 1)
    for name in laws._PLANTS:
        files = sorted((PROBE.parent / name).glob("*.py"))
        assert files, name
        for file in files:
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
    monkeypatch.setattr(trial, "_passed", set())
    rig = rig_with(tmp_path / "rig", f"{READING}{GOOD}", "prepare=prepare,")
    contents = {"own_helper.py": "A = {}\n", "table.txt": "{}\n", "prepared.txt": "{}\n"}
    for name, content in contents.items():
        rig.with_name(name).write_text(content.format(1.0))
    case = trial_case(rig)
    assert trial.ensure(case) == ""
    assert "law.py: prints: hello" in capfd.readouterr().err
    trial._passed.clear()
    assert trial.ensure(case) == "" and capfd.readouterr().err == "", "remembered"
    rig.with_name(changed).write_text(contents[changed].format(2.0))
    trial._passed.clear()
    assert trial.ensure(case) == "" and "hello" in capfd.readouterr().err, "tried again"


READING = """\
from pathlib import Path
import own_helper
HERE = Path(__file__).parent
TWO = float((HERE / "table.txt").read_text()) + own_helper.A
print("hello")
def prepare(settings, rate_hz, seed):
    return Prepared({**settings, "gain": float((HERE / "prepared.txt").read_text())})
"""


REFUSED = {  # by numba; the trial lets them pass
    "text": (
        "    k = 'a'\n    y[0] = len(k + 'b')\n",
        "law.py:7: cannot be|`y[0] = len(k + 'b')`",
    ),
    "list": ("    k = [u[0], 1.0]\n    y[0] = k[1]\n", "it needs memory of its own (a list, a new"),
    "array": (
        "    k = np.zeros(3)\n    y[0] = k[0]\n",
        "law.py:6: cannot be co|`k = np.zeros(3)`",
    ),
    "returns": (
        "    y[0] = 1.0\n    return u[0]\n",
        "law.py:7: cannot be compiled|`return u[0]`",
    ),
    "plain": ("    y[0] = plain(u[0])\n", "name 'plain' is plain Python; put @inline above its"),
    "deep": ("    y[0] = deep(u[0])\n", "law.py:8: cannot be compiled|`return {1.0: a}[1.0]`"),
}
HELPERS = (
    "def plain(a):\n    return a\n@inline\ndef deep(a):\n    return {1.0: a}[1.0]\n"  # lines 4 to 8
)


@pytest.mark.parametrize("kind", REFUSED)
def test_what_numba_refuses_is_told_with_the_users_line(tmp_path: Path, kind: str) -> None:
    body, said = REFUSED[kind]
    lines = {"law.py:6": "law.py:11", "law.py:7": "law.py:12"}
    for line, moved in lines.items() if kind != "deep" else ():
        said = said.replace(line, moved)
    text = refusal(rig_with(tmp_path, f"{HELPERS}{STEP}{body}"))
    assert all(part in text for part in said.split("|")), text
    assert "site-packages" not in text, text


def test_a_step_without_stage_is_told_so(tmp_path: Path) -> None:
    law = "def step(t, dt, p, x, u, y):\n    y[0] = u[0]\n"
    assert "step is plain Python; put @stage above its def" in refusal(rig_with(tmp_path, law))


def test_check_steps_a_law_with_the_rigs_settings_even_if_it_passed_before(tmp_path: Path) -> None:
    rig = rig_with(tmp_path, f"{STEP}    y[0] = p[int(p[0]) - 4]\n")
    words = [sys.executable, "-m", "pcpc.tools.cli", "check", str(rig), "--json"]
    good = subprocess.run(words, capture_output=True, text=True)
    assert good.returncode == 0 and json.loads(good.stdout)["rig"] == "probe", good
    words += ["--set", "controller.gain=9.0"]
    bad = subprocess.run(words, capture_output=True, text=True)
    assert bad.returncode == 2, bad
    assert "p[5]: the block has 2 parameters (gain, target)" in bad.stderr, bad
    assert bad.stdout == "" and len(bad.stderr.splitlines()) == 1, bad
