"""The code blocks of a page, and how each is carried out, in order, in a folder that begins empty.

    sh        run by bash, from where the block before ended; must end with 0
    output    lines that the last sh block printed; `...` stands for anything
    python    run, all blocks of a page in one namespace
    yaml      parsed
    diff      applied to the file that its first line names: `--- FILE`
    text      a drawing, a form of input: not carried out; math, dbc neither

A python or yaml block whose first line is `# FILE` is written there instead. A comment
`<!-- not run: REASON -->` above a block says why nothing happens with it.
"""

import os
import re
import signal
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from copies import copies

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/**/*.md"), *ROOT.glob("plants/*/*.md")])
SHOWN = {"text", "math", "dbc"}
KNOWN = {"sh", "output", "python", "yaml", "diff", *SHOWN}
_FENCE = re.compile(
    r"^(?:<!-- not run: (?P<reason>.*) -->\n)?```(?P<language>.*)\n(?P<text>(?s:.*?))^```$",
    re.MULTILINE,
)
_LIMIT_S = 900.0  # for a block; the longest takes a minute on two idle processors
_FILE = re.compile(r"# (\S+\.(?:py|yaml))\n")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page."""

    where: str  # page:line
    language: str
    text: str
    reason: str | None  # why it is not run


def blocks_of(page: Path) -> list[Block]:
    """Return the blocks of a page in their order."""
    text = page.read_text("utf-8")
    name = page.relative_to(ROOT) if page.is_relative_to(ROOT) else page.name
    return [
        Block(
            f"{name}:{text.count(chr(10), 0, found.start('language')) + 1}",
            found["language"],
            found["text"],
            found["reason"],
        )
        for found in _FENCE.finditer(text)
    ]


@dataclass
class Reader:
    """Somebody who types what a page says."""

    folder: Path
    printed: str = ""
    names: dict[str, object] = field(default_factory=dict)

    def follow(self, block: Block) -> None:
        """Carry out a block; AssertionError with its place if it does not do what it says."""
        named = _FILE.match(block.text)
        if block.reason is not None or block.language in SHOWN:
            return
        if block.language == "yaml":
            yaml.safe_load(block.text)
        if named:
            path = self.folder / named[1]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text, "utf-8")
        elif block.language == "python":
            exec(compile(block.text, block.where, "exec"), self.names)
        elif block.language == "sh":
            self._run(block)
        elif block.language == "output":
            self._compare(block)
        elif block.language == "diff":
            self._patch(block)

    def _run(self, block: Block) -> None:
        environment = os.environ | {
            "PATH": f"{copies().bin_folder()}:{Path(sys.executable).parent}:{os.environ['PATH']}",
            "COLUMNS": "80",
        }
        with subprocess.Popen(
            ["bash", "-euo", "pipefail", "-c", block.text + "\npwd\n"],
            cwd=self.folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        ) as shell:
            try:
                self.printed, _ = shell.communicate(timeout=_LIMIT_S)
            except subprocess.TimeoutExpired:
                os.killpg(shell.pid, signal.SIGKILL)
                raise AssertionError(f"{block.where}: not at its end in {_LIMIT_S} s") from None
        assert shell.returncode == 0, (
            f"{block.where}: ended with {shell.returncode}\n{self.printed}"
        )
        *_, last = self.printed.splitlines()
        self.folder = Path(last)

    def _compare(self, block: Block) -> None:
        printed = [" ".join(line.split()) for line in self.printed.splitlines()]
        for line in block.text.splitlines():
            form = ".*".join(re.escape(part) for part in " ".join(line.split()).split("..."))
            found = any(re.fullmatch(form, one) for one in printed)
            assert found, f"{block.where}: not printed: {line}\n{self.printed}"

    def _patch(self, block: Block) -> None:
        head, *lines = block.text.splitlines()
        path = self.folder / head.removeprefix("--- ")
        for hunk in "\n".join(lines).split("@@\n"):
            old = [line[1:] for line in hunk.splitlines() if line[:1] != "+"]
            new = [line[1:] for line in hunk.splitlines() if line[:1] != "-"]
            text, before = path.read_text("utf-8"), "\n".join(old)
            assert text.count(before) == 1, f"{block.where}: not once in {path.name}:\n{before}"
            path.write_text(text.replace(before, "\n".join(new)), "utf-8")
