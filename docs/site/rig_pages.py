"""Pages of `pcpc generate web` in the site: a mark in a page's Markdown names rig and controllers.

    <!--rig:NAME:CONTROLLER,CONTROLLER-->

GitHub shows nothing in its place, the site the rig at work. Pages are kept in build/rigs under a
digest of the sources, and made again only if that changes. As a script it makes one:
`rig_pages.py NAME CONTROLLER,CONTROLLER FILE`.
"""

import hashlib
import html
import logging
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from mkdocs.exceptions import PluginError

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "build" / "rigs"
SOURCES = ("drivers", "executive", "plants", "tools")
PROSE = (".md", ".png", ".gif", ".pyc")  # nothing of it is in a page
MARK = re.compile(r"^<!--rig:([^:\s]+):([^:\s]+)-->$", re.MULTILINE)
ENVIRONMENT = 4  # the exit code where there is no compiler
_LOG = logging.getLogger("mkdocs.hooks.rig_pages")


class Shown(NamedTuple):
    """A rig in a page, and its controllers; the page begins with the first."""

    rig: str
    controllers: str

    @property
    def uri(self) -> str:
        """Return where its page is in the site."""
        return f"rigs/{self.rig}-{self.controllers.replace(',', '-')}.html"


def shown(markdown: str) -> list[Shown]:
    """Return what the marks of a page name."""
    return [Shown(*found) for found in MARK.findall(markdown)]


def made(wanted: Iterable[Shown]) -> dict[str, Path]:
    """Return the files of pages by their place in the site; those that cannot be made are told.

    PluginError: a page is wrong for another reason than a machine without a compiler.
    """
    key = _key()
    files = {one: KEPT / f"{Path(one.uri).stem}-{key}.html" for one in wanted}
    new = [one for one, file in files.items() if not file.exists()]
    if new:
        KEPT.mkdir(parents=True, exist_ok=True)
        _LOG.info("Making %d pages of rigs, kept in %s", len(new), KEPT.relative_to(ROOT))
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            told = set(pool.map(lambda one: _make(one, files[one]), new)) - {""}
        for why in sorted(told):
            _LOG.info("Pages without a rig at work: %s", why)
    for file in set(KEPT.glob("*.html")) - set(files.values()):
        file.unlink(missing_ok=True)
    return {one.uri: file for one, file in files.items() if file.exists()}


def embedded(markdown: str, near: str, there: Iterable[str]) -> str:
    """Return a page's Markdown with rigs in the place of marks.

    `near`: what leads from the page to the top of the site; `there`: the pages there are.
    """
    return MARK.sub(lambda mark: _block(Shown(mark[1], mark[2]), near, there), markdown)


def _block(one: Shown, near: str, there: Iterable[str]) -> str:
    rig, laws = html.escape(one.rig), html.escape(one.controllers.replace(",", " and "))
    if one.uri not in there:
        return f'<p class="rig">No page of {rig} here: this site was built without a compiler.</p>'
    at = html.escape(f"{near}{one.uri}")
    return (
        f'<div class="rig"><p>This is <code>{rig}</code> with {laws}, computed by your browser: '
        f'press <em>run</em>, and change what you like. <a href="{at}">Open it whole</a></p>'
        f'<iframe src="{at}" title="{rig}, a rig at work" loading="lazy"></iframe></div>'
    )


def _make(one: Shown, file: Path) -> str:
    """Write a page; return why there is none on this machine."""
    command = [sys.executable, __file__, one.rig, one.controllers, str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    said = done.stderr.strip().rpartition("\n")[2]
    if done.returncode not in (0, ENVIRONMENT):
        raise PluginError(f"no page of {one.rig} with {one.controllers}: {said}")
    return said if done.returncode else ""


def _key() -> str:
    """Return a digest of all that a page is made of."""
    found = hashlib.sha256(platform.machine().encode())
    below = [path for room in SOURCES for path in (ROOT / room).rglob("*") if path.is_file()]
    for path in sorted([*below, ROOT / "pyproject.toml", Path(__file__)]):
        if path.suffix not in PROSE and "shipped" not in path.parts:
            found.update(f"{path.relative_to(ROOT)}\0".encode() + path.read_bytes())
    return found.hexdigest()[:16]


def _write(rig: str, controllers: str, file: Path) -> None:
    """Write a page of a rig; UserError."""
    from pcpc.executive.rig.reading import load_rig
    from pcpc.tools.make.web.cli import page
    from pcpc.tools.make.web.contents import Contents
    from pcpc.tools.start.rigs import find

    path = Path(find(rig))
    rigs = [load_rig(path, name, []) for name in controllers.split(",")]
    contents = Contents(rigs[0], rig, [])
    for one in rigs:
        contents.add(one)
    half = file.with_suffix(f".{os.getpid()}")
    half.write_text(page(rigs[0].config.title or rig, contents.payload()), "utf-8")
    half.replace(file)


def main() -> int:
    """Make the page that the command line names; return the exit code."""
    from pcpc.drivers.errors import UserError

    try:
        _write(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
    except UserError as error:
        print(error, file=sys.stderr)
        return error.code
    return 0


if __name__ == "__main__":
    sys.exit(main())
