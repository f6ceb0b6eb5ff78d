"""What a shell is offered, asked in its own way: argcomplete's variables and file descriptor 8."""

import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import standing
from processes import PCPC

SEPARATOR = "\013"
HEAD = {
    "variables": [
        ["a.gain", "", "parameter", "a", ""], ["a.error", "rad", "output", "a", ""],
        ["b.gain", "", "parameter", "b", ""],
    ],
    "ranges": {"a.gain": [0.0, 1.0], "b.gain": [0.0, 1.0]},
    "state_columns": [], "timing_columns": [], "period_ns": 1_000_000, "rig": "stand",
}  # fmt: skip


def asked(line: str, folder: Path, **environment: str) -> tuple[list[str], str]:
    """Return the words that may come next, and stderr."""
    read, write = os.pipe()
    about = {
        "_ARGCOMPLETE": "1", "_ARGCOMPLETE_SHELL": "bash", "COMP_LINE": line, "IFS": SEPARATOR,
        "COMP_POINT": str(len(line.encode())), "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
    }  # fmt: skip
    done = subprocess.run(
        ["bash", "-c", f'exec "{PCPC}" 8>&{write}'],
        cwd=folder,
        pass_fds=[write],
        text=True,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        env=os.environ | about | environment,
    )
    os.close(write)
    with os.fdopen(read) as words:
        return [word.strip() for word in words.read().split(SEPARATOR) if word], done.stderr


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("pcpc repl", {"replay"}),
        ("pcpc log rec", {"recover"}),
        ("pcpc run hull --pac", {"--pacing"}),
        ("pcpc run hull --pacing lo", {"lockstep"}),
        ("pcpc run telerobot-", {"telerobot-u0", "telerobot-u1", "telerobot-u2"}),
        ("pcpc simulate hull --controller pd_st", {"pd_star"}),
        ("pcpc simulate own.y", {"own.yaml"}),
        ("pcpc simulate nosuch --controller p", set()),
        ("pcpc rigs friction_", {"friction_arm"}),
        ("pcpc experiment chapter9", {"chapter9"}),
        ("pcpc log info la", {"latest"}),
        ("pcpc replay runs/fi", {"runs/first"}),
        ("pcpc replay la", {"latest"}),
        ("pcpc operate lock t", {"tune"}),
        ("pcpc bu", {"bus"}),
        ("pcpc bus em", {"emulate"}),
        ("pcpc bus hul", {"hull", "hullrand"}),
        ("pcpc bus emulate a b --in", {"--in-order"}),
        ("pcpc  sweep  rerun a 1 --on", {"--on-bus"}),
        ("pcpc completion z", {"zsh"}),
    ],
)
def test_a_shell_is_offered_what_may_come_next(
    line: str, offered: set[str], tmp_path: Path
) -> None:
    (tmp_path / "own.yaml").touch()
    (tmp_path / "runs/first").mkdir(parents=True)
    words, _ = asked(line, tmp_path)
    assert set(words) == offered, words


@pytest.fixture
def node() -> Iterator[str]:
    name = f"completed.{os.getpid()}.executive"
    standing.stand(name, HEAD)
    yield name
    standing.end_all()


def test_variables_of_live_nodes_are_offered(node: str, tmp_path: Path) -> None:
    for line, offered in (
        (f"pcpc get --node {node} a.", {"a.gain", "a.error"}),
        (f"pcpc set --node {node} ", {"a.gain=", "b.gain="}),
        ("pcpc watch a.err", {"a.error"}),
        (f"pcpc get --node completed.{os.getpid()}", {node}),
    ):
        words = {word for word in asked(line, tmp_path)[0] if not word.startswith("-")}
        assert words >= offered, (line, words)
        assert words == offered or "watch" in line, (line, words)  # of nodes of other runs too


def test_an_answer_needs_no_numba(node: str, tmp_path: Path) -> None:
    for line in ("pcpc run hul", "pcpc run hull --controller p", "pcpc get a.", "pcpc experiment "):
        words, imports = asked(line, tmp_path, PYTHONPROFILEIMPORTTIME="1")
        assert words and "argcomplete" in imports, imports
        assert not re.search(r"\| +(numba|llvmlite|matplotlib)\b", imports), line


def test_bash_completes_after_what_the_command_prints(tmp_path: Path) -> None:
    script = f"""
        export PATH={Path(PCPC).parent}:$PATH
        eval "$(pcpc completion bash)"
        complete -p pcpc
        COMP_LINE="pcpc run hull --controller nn_back" COMP_POINT=34 COMP_TYPE=9
        _python_argcomplete pcpc
        echo "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    registered, offered = done.stdout.splitlines()
    assert registered.endswith("-F _python_argcomplete pcpc"), registered
    assert offered.split() == ["nn_backstepping"], offered
