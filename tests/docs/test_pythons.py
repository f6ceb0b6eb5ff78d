"""Which other Pythons continuous integration finds, and what it says of those that fail."""

import subprocess
import sys
from pathlib import Path

from blocks import ROOT

SCRIPT = ROOT / ".ci/pythons.py"
PROGRAM = """#!/bin/sh
exec {python} -c 'import sys; sys.version_info = (3, {minor}); exec(sys.argv[2])' "$@"
"""


def run(path: Path, *command: str) -> "subprocess.CompletedProcess[str]":
    """Run the script with `path` before all other places."""
    program = f"import sys; sys.path.insert(0, {str(SCRIPT.parent)!r}); import pythons\n"
    program += (
        f"pythons.PLACES = ({str(path)!r},); pythons.found.__defaults__ = (pythons.PLACES,)\n"
    )
    program += f"sys.exit(pythons.main({list(command)!r}))"
    return subprocess.run(
        [sys.executable, "-B", "-c", program], capture_output=True, text=True, check=False, cwd=ROOT
    )


def python(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text)
    (folder / name).chmod(0o755)


def test_each_python_that_works_is_used_and_the_others_are_named(tmp_path: Path) -> None:
    own = sys.version_info[1]
    older, newer = (minor for minor in (11, 12, 13) if minor != own)
    python(tmp_path, f"python3.{older}", PROGRAM.format(python=sys.executable, minor=older))
    python(tmp_path, f"python3.{newer}", "#!/bin/sh\necho 'pyenv: command not found'; exit 127\n")
    done = run(tmp_path, "sh", "-c", "echo $PYTHON $VENV")
    lines = done.stdout.splitlines()
    assert done.returncode == 0, done.stderr
    assert lines[0].startswith("not here, so not tested: ") and f"python3.{newer}" in lines[0]
    assert f"python3.{own}" not in done.stdout, "it is the one that runs the tests anyway"
    program = tmp_path / f"python3.{older}"
    assert lines[1:] == [f"python3.{older}: {program}", f"{program} build/python3.{older}"]


def test_a_python_with_which_the_tests_fail_fails_the_whole(tmp_path: Path) -> None:
    other = 12 if sys.version_info[1] != 12 else 13
    python(tmp_path, f"python3.{other}", PROGRAM.format(python=sys.executable, minor=other))
    done = run(tmp_path, "false")
    assert (done.returncode, done.stderr) == (1, f"failed with python3.{other}\n")
