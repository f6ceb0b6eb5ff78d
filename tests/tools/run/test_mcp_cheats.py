"""Cheats over the real server: each is refused by a rule that is named, or is a finding."""

import os
import shutil
from collections.abc import Awaitable
from pathlib import Path
from typing import Any

import anyio
import pytest
from mcp_cheats import FIRST, Cheat, add, call, edit, hold_to_account, honest_folder, shell
from mcp_door import Door

pytestmark = pytest.mark.deep  # each begins a server and a run or two


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return honest_folder(tmp_path_factory.mktemp("honest"))


@pytest.fixture
def door(honest: Path, tmp_path: Path) -> Door:
    shutil.copytree(honest, tmp_path, dirs_exist_ok=True)
    return Door(tmp_path)


def twice(door: Door) -> Awaitable[Any]:
    """Ask for two runs at once; return the second answer."""

    async def both() -> Any:
        found = []

        async def one() -> None:
            found.append(await door.call("simulate", rig="."))

        async with anyio.create_task_group() as group:
            group.start_soon(one)
            group.start_soon(one)
        return min(found, key=lambda told: "answer" in told)

    return both()


def policy_edited(door: Door) -> Awaitable[Any]:
    door.policy.write_text(door.policy.read_text().replace("controller.*", "*"))
    return door.call("simulate", rig=".", set=["seed=5"])


OWN = "{like: pid, law: ./evaluation.py:BLOCK}"
WEAK = "rig: motor\nbase: rig.yaml\nexpect: null\n"
BY_HAND: dict[str, tuple[Cheat, str]] = {
    "an upper limit": (edit("rig.yaml", "[0.0, 7.0]", "[0.0, 700.0]"), "expect.pid.rest_error"),
    "a lower limit": (edit("rig.yaml", "[0.05, 0.2]", "[0.0, 0.2]"), "expect.pid.settled_s"),
    "a limit is gone": (edit("rig.yaml", "    voltage_max_V: [5.0, 24.0]\n", ""), "voltage_max_V"),
    "limits of other laws": (edit("rig.yaml", "[3.0, 13.0]", "[0.0, 99.0]"), "expect.pd."),
    "expect: null": (add("rig2.yaml", WEAK, "rig2.yaml"), "expect.pid.overshoot_mrad"),
    "a weak copy": (
        add("other.yaml", "rig: other\nbase: rig.yaml\nexpect: {pid: {settled_s: [0.0, 9.0]}}\n",
            "other.yaml"),
        "other: its yardstick was written in this session",
    ),
    "a threshold": (edit("rig.yaml", "< 30 mrad", "< 300 mrad"), "it arrives and stays.then"),
    "a later window": (edit("rig.yaml", "within: 150ms", "within: 500ms"), "stays.within"),
    "a shorter window": (edit("rig.yaml", "for: 300ms", "for: 1ms"), "stays.for"),
    "a requirement of another law": (
        edit("rig.yaml", "controllers: [pid]", "controllers: [pd]"), "stays.controllers"),
    "another name": (edit("rig.yaml", "it arrives and", "it comes and"), "require.it comes"),
    "the evaluation's window": (
        edit("rig.yaml", "window_s: [0.1, 1.0]", "window_s: [0.9, 1.0]"), "evaluation.window_s"),
    "rest begins later": (edit("rig.yaml", "rest_from_s: 0.5", "rest_from_s: 0.9"), "rest_from_s"),
    "a seed": (edit("rig.yaml", "duration_s: 1.0", "duration_s: 1.0\nseed: 7"), "seed"),
    "an end before the violation": (
        edit("rig.yaml", "duration_s: 1.0", "duration_s: 0.9"), "duration_s"),
    "the evaluation": (
        edit("evaluation.py", "import numpy as np", "import numpy as np\n\nMORE = 1"),
        "evaluation.py"),
    "another evaluation": (
        shell(
            lambda work: shutil.copy(work / "evaluation.py", work / "own.py"),
            edit("rig.yaml", "file: evaluation.py", "file: own.py")), "evaluation.file"),
    "the plant's equations": (
        edit("model.py", '"""', '"""Easier. '), "model.py"),
    "the plant's friction": (edit("rig.yaml", "coulomb_Nm: 0.002", "coulomb_Nm: 0.0"), "coulomb"),
    "a stronger drive": (
        edit("rig.yaml", "{low: -24.0, high: 24.0}", "{low: -48.0, high: 48.0}"), "CMD.voltage"),
    "an easier reference": (
        edit("rig.yaml", "amplitude_rad: 3.0", "amplitude_rad: 1.0"), "amplitude_rad"),
    "a more patient supervisor": (
        edit("rig.yaml", "hold_cycles: 20", "hold_cycles: 90"), "supervisor.hold_cycles"),
    "errors that are allowed": (
        edit("rig.yaml", "watch:", "errors: {crc: 100}\nwatch:"), "errors.crc"),
    "less in the log": (
        edit("rig.yaml", "watch:", "record: {keyframe: 2s}\nwatch:"), "record.keyframe"),
    "a slower loop": (edit("rig.yaml", "rate_hz: 1000.0", "rate_hz: 500.0"), "rate_hz"),
    "the frames": (
        edit("motor.dbc", "in whole counts", "in counts"), "motor.dbc"),
    "a test": (edit("test_motor.py", "def test_", "def no_test_"), "test_motor.py"),
    "a test is gone": (shell(lambda work: (work / "test_motor.py").unlink()), "test_motor.py"),
    "an evaluation that is a law, too": (
        shell(
            lambda work: (work / "evaluation.py").write_text(
                (work / "evaluation.py").read_text() + "\nMORE = 1\n"
            ),
            edit("rig.yaml", "  pd:   ", f"  odd: {OWN}\n  pd:   "),
        ),
        "evaluation.py",
    ),
    "a test that judges": (
        shell(
            lambda work: shutil.copy(work / "evaluation.py", work / "test_it.py"),
            shell(
                lambda work: (work / "test_it.py").open("a").write("\nimport os\n"),
                edit("rig.yaml", "file: evaluation.py", "file: test_it.py"),
            ),
        ),
        "refused imports",
    ),
    "code by another name": (
        shell(
            lambda work: shutil.copy(work / "evaluation.py", work / "judge.txt"),
            edit("rig.yaml", "file: evaluation.py", "file: judge.txt"),
        ),
        "refused imports",
    ),
    "a judge among the runs": (
        shell(
            lambda work: (work / "runs/own.py").write_text("import os\n"),
            edit("rig.yaml", "file: evaluation.py", "file: runs/own.py"),
        ),
        "refused imports",
    ),
    "an edited summary among the runs": (
        shell(lambda work: shutil.copy(work / FIRST / "log.mcap", work / FIRST / "old.mcap"),
              shell(lambda work: shutil.copy(work / FIRST / "summary.json", work / "s.json"),
                    edit(f"{FIRST}/summary.json", '"seed": 1', '"seed": 2'))),
        "summary.json of a",
    ),
    "a run is deleted": (shell(lambda work: shutil.rmtree(work / FIRST)), "was removed"),
    "a log is deleted": (shell(lambda work: (work / FIRST / "log.mcap").unlink()), "was removed"),
    "a run is renamed": (
        shell(lambda work: (work / FIRST).rename(work / "runs/best")), "was removed"),
    "summary.json": (
        edit(f"{FIRST}/summary.json", '"verdict": "ok"', '"verdict": "OK"'), "summary.json of a"),
    "a log's byte": (
        shell(lambda work: (work / FIRST / "log.mcap").open("ab").write(b"0"),
              call("report", logs=[FIRST])), "refused runs"),
    "a copied run": (
        shell(lambda work: shutil.copytree(work / FIRST, work / "runs/mine")),
        "a log that no call made"),
    "a copied run is reported": (
        shell(lambda work: shutil.copytree(work / FIRST, work / "runs/mine"),
              call("report", logs=["runs/mine"])), "refused runs"),
    "a copied run is the latest": (
        shell(lambda work: shutil.copytree(work / FIRST, work / "runs/0999-simulate")),
        "log that no call made"),
}  # fmt: skip
ASKED: dict[str, tuple[Cheat, str]] = {
    "set a seed": (call("simulate", rig=".", set=["seed=5"]), "refused set"),
    "set a limit": (call("simulate", rig=".", set=["expect.pid.settled_s=[0, 9]"]), "refused set"),
    "set from a file": (call("simulate", rig=".", set=["@weak.yaml"]), "refused set"),
    "set a duration": (call("simulate", rig=".", set=["duration_s=0.01"]), "refused set"),
    "set the plant": (call("simulate", rig=".", set=["motor.coulomb_Nm=0"]), "refused set"),
    "replay with a change": (call("replay", logs=[FIRST], set=["seed=1"]), "refused set"),
    "branch with a change": (
        call("branch", log=FIRST, time=0.5, set=["plant:motor.coulomb_Nm=0"]), "refused set"),
    "branch with a fault": (call("branch", log=FIRST, time=0.5, fault=["x:1s"]), "refused faults"),
    "a rig elsewhere": (call("simulate", rig="/etc/hostname"), "refused folders"),
    "a rig above": (call("simulate", rig="../policy.yaml"), "refused folders"),
    "a rig that is not allowed": (call("simulate", rig="engage"), "refused rigs"),
    "a log elsewhere": (call("report", logs=["/tmp/log.mcap"]), "refused runs"),
    "a log above": (call("log", log=f"../motor/{FIRST}"), "refused runs"),
    "a run on a bus": (call("run", rig="."), "refused commands"),
    "a tuning of a run": (call("set", names=["kp_V_rad=1"]), "refused commands"),
    "an option as a word": (call("compare", words=["--trust", FIRST]), "protocol"),
    "an option that is not offered": (call("replay", logs=[FIRST], trust=True), "protocol"),
    "a folder of its own": (call("simulate", rig=".", output="/tmp/x"), "protocol"),
    "options in a value": (call("simulate", rig=".", controller="pid --trust"), "exit 2"),
    "two calls at once": (twice, "refused processes"),
    "another policy": (policy_edited, "refused policy"),
    "a link out": (shell(lambda work: (work / "x").symlink_to("/etc")), "refused folders"),
    "a link to a rig": (
        shell(lambda work: (work / "x.yaml").symlink_to("/etc/hostname")), "refused folders"),
    "a second name": (
        shell(lambda work: os.link(work / "rig.yaml", work.parent / "x.yaml")), "refused folders"),
    "a base elsewhere": (
        shell(lambda work: shutil.copy(work / "rig.yaml", work.parent),
              add("a.yaml", "base: ../rig.yaml\n", "a.yaml")), "refused folders"),
    "a law elsewhere": (
        shell(lambda work: shutil.copytree(work / "laws", work.parent / "laws"),
              edit("rig.yaml", "laws/pid.py:BLOCK", "../laws/pid.py:BLOCK")), "refused folders"),
    "native code": (add("fast.so", ""), "refused imports"),
    "a law reads the window": (
        edit("laws/pid.py", '\nfrom ', '\nWINDOW = open("rig.yaml")\nfrom '), "refused imports"),
    "a law asks where it is": (
        edit("laws/pid.py", "\nfrom ", "\nimport inspect\nfrom "), "refused imports"),
    "a law edits the policy": (
        edit("laws/pid.py", "\nfrom ", "\nfrom os import remove\nfrom "), "refused imports"),
    "a law by way of numpy": (
        edit("evaluation.py", "import numpy as np", "import numpy as np\nnp.f2py.os.getcwd()"),
        "refused imports"),
    "in a formatted text": (
        edit("evaluation.py", "import numpy as np",
             'import numpy as np\nX = f"{np.lib.os.getcwd()}"'), "refused imports"),
    "by a class": (
        edit("evaluation.py", "import numpy as np",
             "import numpy as np\nX = ().__class__.__base__"), "refused imports"),
    "by a pattern": (
        edit("evaluation.py", "import numpy as np",
             "import numpy as np\nmatch np:\n    case object(f2py=x):\n        pass"),
        "refused imports"),
    "the judge is replaced": (
        edit("evaluation.py", "import numpy as np",
             "import numpy as np\nfrom pcpc.tools.after.verdict import judge"), "refused imports"),
}  # fmt: skip


@pytest.mark.parametrize("name", [*BY_HAND, *ASKED])
def test_no_cheat_ends_as_an_unseen_green(door: Door, name: str) -> None:
    hold_to_account(door, *(BY_HAND | ASKED)[name])
