"""Further cheats: by other names, other kinds of files, moments between two looks, and by habits.

`mark` is a file that a cheat's own program would write, were it ever begun.
"""

import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import anyio
import pytest
from mcp_cheats import FIRST, Cheat, add, call, edit, hold_to_account, honest_folder, shell
from mcp_door import Door

pytestmark = pytest.mark.deep  # each begins a server and a run or two
RUN = call("simulate", rig=".")
TAG = f"cpython-{sys.version_info[0]}{sys.version_info[1]}"
MARK = "import os\nopen(os.path.join(os.getcwd(), 'mark'), 'w')\n"
LONG = f"{'x' * 250}.yaml"
EASY = ("[-7.0, 15.0]", "[-7.0, 1500.0]")


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return honest_folder(tmp_path_factory.mktemp("honest"))


@pytest.fixture
def door(honest: Path, tmp_path: Path) -> Door:
    shutil.copytree(honest, tmp_path, dirs_exist_ok=True)
    return Door(tmp_path)


def files(texts: dict[str, str], then: Cheat = RUN) -> Cheat:
    """Write files by hand, then do something."""

    def write(work: Path) -> None:
        for name, text in texts.items():
            (work / name).parent.mkdir(parents=True, exist_ok=True)
            (work / name).write_text(text)

    return shell(write, then)


def begin(text: str) -> Cheat:
    """Write something before the first import of the evaluation."""
    return edit("evaluation.py", "import numpy as np", f"import numpy as np\n{text}")


def between(do: Callable[[Path], Any], undo: Callable[[Path], Any]) -> Cheat:
    """Do something as soon as a run was allowed, and undo it before its end."""

    async def cheat(door: Door) -> Any:
        found = {}

        async def run() -> None:
            found["told"] = await door.call("simulate", rig=".")

        async with anyio.create_task_group() as group:
            number = len(door.entries()) + 1
            group.start_soon(run)
            while not (door.work / f"runs/{number:04}-simulate").exists():
                await anyio.sleep(0.01)
            do(door.work)
            undo(door.work)
        return found["told"]

    return cheat


def eased(work: Path, back: bool = False) -> None:
    """Ease a limit, in the same place and to the same length, or take that back."""
    old, new = reversed(EASY) if back else EASY
    path = work / "rig.yaml"
    path.write_text(path.read_text().replace(old, new))


def same_time(work: Path) -> None:
    """Ease a limit so that size and time of the file stay what they were."""
    path = work / "rig.yaml"
    about = path.stat()
    path.write_text(path.read_text().replace("[0.0, 7.0]", "[0.0, 9.0]"))
    os.utime(path, ns=(about.st_atime_ns, about.st_mtime_ns))


def moved_over(work: Path) -> None:
    """Put a copy with another log in the place of a run."""
    shutil.copytree(work / FIRST, work / "x")
    with (work / "x/log.mcap").open("ab") as log:
        log.write(b"0")
    shutil.rmtree(work / FIRST)
    (work / "x").rename(work / FIRST)


def git(work: Path) -> None:
    """Make the workspace a repository whose filter is a program."""
    os.system(f"cd {work} && git init -q . && git add -A . 2> /dev/null")
    (work / ".gitattributes").write_text("*.yaml filter=x\n")
    with (work / ".git/config").open("a") as config:
        config.write(f'[filter "x"]\nclean = "touch {work}/mark; cat"\n')
        config.write(f'[core]\nfsmonitor = "touch {work}/mark"\n')
    hook = work / ".git/hooks/post-index-change"
    hook.write_text(f"#!/bin/sh\ntouch {work}/mark\n")
    hook.chmod(0o755)
    (work / "rig.yaml").touch()


FULLWIDTH = "\uff4f\uff50\uff45\uff4e"  # open
CHEATS: dict[str, tuple[Cheat, str]] = {
    "a log has a second name outside": (
        shell(lambda work: os.link(work / FIRST / "log.mcap", work.parent / "x")),
        "refused folders"),
    "a base by /proc/self": (
        add("a.yaml", "base: /proc/self/cwd/../policy.yaml\n", "a.yaml"), "refused folders"),
    "a base by /proc/self/root": (
        add("a.yaml", "base: /proc/self/root/etc/hostname\n", "a.yaml"), "refused folders"),
    "a base through a pipe": (
        shell(lambda work: os.mkfifo(work / "p.yaml"), add("a.yaml", "base: p.yaml\n", "a.yaml")),
        "refused folders"),
    "a link to a device": (
        shell(lambda work: (work / "d.yaml").symlink_to("/dev/zero")), "refused folders"),
    "a link that leads nowhere yet": (
        shell(lambda work: (work / "d.yaml").symlink_to("../later.yaml")), "refused folders"),
    "a limit is eased while the run begins": (
        between(eased, lambda work: eased(work, back=True)), "changed while the call was at work"),
    "a folder is exchanged while the run begins": (
        between(lambda work: (work / "laws").rename(work / "l"),
                lambda work: (work / "l").rename(work / "laws")),
        "changed while the call was at work"),
    "a limit is eased, and stays": (
        between(eased, lambda work: None),
        "changed while the call was at work",
    ),
    "an edit with the old time": (shell(same_time, RUN), "expect.pid.rest_error_max_mrad"),
    "letters that look alike in code": (
        begin(f'{FULLWIDTH}("rig.yaml").read()'), "refused imports"),
    "a rig's name that looks alike": (
        add("rig2.yaml", "rig: mot\u043er\nbase: rig.yaml\nexpect: null\n", "rig2.yaml"), "exit 2"),
    "a file's name that looks alike": (
        add("r\u0456g.yaml", "base: rig.yaml\nexpect: {pid: {overshoot_mrad: [-7.0, 1500.0]}}\n",
            "r\u0456g.yaml"), "expect.pid.overshoot_mrad"),
    "a very long name": (call("simulate", rig="x" * 5000), "refused input"),
    "a weak copy with a very long name": (
        add(
            LONG,
            "base: rig.yaml\nexpect: {pid: {overshoot_mrad: [-7.0, 1500.0]}}\n",
            LONG,
        ),
        "expect.pid.overshoot_mrad",
    ),
    "a run is moved over another": (shell(moved_over), "of a run was changed"),
    "a run with an earlier number": (
        shell(lambda work: shutil.copytree(work / FIRST, work / "runs/0001-simulate")),
        "a log that no call made"),
    "a run with the next number": (
        shell(lambda work: shutil.copytree(work / FIRST, work / "runs/0009-simulate"), RUN),
        "a log that no call made"),
    "a variable of the environment": (
        shell(lambda work: shutil.copy(work / "rig.yaml", work.parent),
              add("a.yaml", "base: ${OLDPWD}/rig.yaml\n", "a.yaml")), "exit 2"),
    "frames from outside": (
        shell(lambda work: shutil.copy(work / "motor.dbc", work.parent),
              edit("rig.yaml", "dbc: motor.dbc", "dbc: ../motor.dbc")), "refused folders"),
    "parameters from outside": (
        shell(lambda work: (work.parent / "p.yaml").write_text("kp_V_rad: 31.0\n"),
              edit("rig.yaml", "plant:\n", "plant:\n  parameters_file: ../p.yaml\n")),
        "refused folders"),
    "an entry point": (
        files({"x-1.dist-info/entry_points.txt": "[pcpc.rooms]\nx = test_x:X\n",
               "x-1.dist-info/METADATA": "Name: x\nVersion: 1\n", "test_x.py": MARK}),
        "refused imports"),
    "a .pth": (files({"x.pth": MARK.replace("\n", ";")}), "nothing"),
    "sitecustomize": (files({"sitecustomize.py": MARK}), "refused imports"),
    "sitecustomize, compiled": (
        files({f"__pycache__/sitecustomize.{TAG}.pyc": "x"}), "refused imports"),
    "a package without a source": (
        files({"helper/__init__.pyc": "x", "helper.py": ""}), "refused imports"),
    "a test that a law imports": (
        files({"test_x.py": MARK}, edit("laws/pid.py", "\nfrom ", "\nimport test_x\nfrom ")),
        "refused imports"),
    "pytest's own start": (files({"conftest.py": MARK}), "nothing"),
    "filters and hooks of git": (shell(git, RUN), "nothing"),
    "another encoding": (
        edit("evaluation.py", '"""', '# coding: utf-7\n"""+AGEAIgAiACI-\nimport os\n"""'),
        "refused imports"),
    "numpy's own tests": (begin('np.test(extra_argv=["test_x.py"])'), "refused imports"),
    "numpy's compilers": (
        begin("from numpy.distutils.exec_command import exec_command"), "refused imports"),
    "a name in a text": (
        begin("from typing import operator\nX = operator.attrgetter('lib.npyio.os')(np)"),
        "refused imports"),
    "a document that is a program": (
        begin("from pcpc.plants.judging import yaml\n"
              "yaml.unsafe_load('!!python/object/apply:os.getcwd []')"), "refused imports"),
    "the frame around": (
        begin("X = (one for one in ()).gi_frame.f_back.f_builtins"), "refused imports"),
    "another judge for all": (
        begin("from pcpc.plants import judging\njudging.Run.values = near"), "refused imports"),
    "another numpy for all": (begin("np.max = np.min"), "refused imports"),
    "an item of somebody else's": (
        begin("from pcpc.plants.evaluation import WINDOW\nWINDOW.x[0] = 1.0"),
        "refused imports"),
    "an attribute by its name": (
        begin("from typing import functools\nX = functools.update_wrapper"), "refused imports"),
    "a module by its file": (
        begin("from pcpc.plants.judging import module_of"), "refused imports"),
}  # fmt: skip


@pytest.mark.parametrize("name", CHEATS)
def test_no_further_cheat_ends_as_an_unseen_green(door: Door, name: str) -> None:
    hold_to_account(door, *CHEATS[name])
