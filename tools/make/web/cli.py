"""`pcpc generate web`: a rig as one HTML file that any browser runs, bit for bit."""

import base64
import hashlib
import html
import re
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.executive.rig.messages import check_no_drive
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make.generate.words import identifier
from pcpc.tools.make.web.commands import WebRequest
from pcpc.tools.make.web.contents import contents
from pcpc.tools.start import rigs
from pcpc.tools.terminal import outfile
from pcpc.tools.terminal.progress import Progress

_HOST = "pcpc.tools.live.host"
_STYLES = (_HOST, "uplot.css"), (_HOST, "host.css"), (__package__, "web.css")
_SCRIPTS = (
    (_HOST, "axes.js"),
    (_HOST, "drawing.js"),
    (__package__, "fzstd.js"),
    (_HOST, "phase.js"),
    (__package__, "run.js"),
    (__package__, "vectors.js"),
    (__package__, "monitors.js"),
    (__package__, "judge.js"),
    (__package__, "mcap.js"),
    (__package__, "frames.js"),
    (__package__, "log.js"),
    (__package__, "scene.js"),
    (__package__, "view.js"),
    (__package__, "plant.js"),
    (__package__, "panes.js"),
    (__package__, "main.js"),
)
_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; worker-src blob:; "
    "script-src 'wasm-unsafe-eval' {hashes}"
)


def command(request: WebRequest) -> int:
    """Write a page; return the exit code. RigError, UserError."""
    path = Path(rigs.find(request.rig))
    rig = load_rig(path, request.controller, request.set)
    check_no_drive(rig, "a page has no drive; make it of a rig without one")
    progress = Progress(quiet=request.quiet)
    shipped = {one.path.resolve(): one.name for one in rigs.shipped_rigs()}
    name = shipped.get(path.resolve(), request.rig)
    made = contents(path, name, request.controller, [*request.set], progress.show)
    progress.close()
    output = request.output or Path(f"{identifier(rig.config.rig)}.html")
    text = page(rig.config.title or rig.config.rig, made.payload())
    outfile.write_text(output, text)
    there, absent = made.about["controllers"], made.about["absent"]
    print(f"{output}: {len(text) / 1e3:,.0f} kB, {', '.join(one['name'] for one in there)}")
    for one in absent:
        print(f"without {one['name']}: {one['why']}")
    return Exit.OK


def page(title: str, payload: str) -> str:
    """Return the HTML with its styles, scripts and a payload in it."""
    worker = _read(__package__, "worker.js")
    scripts = [_read(_HOST, "uplot.js"), "\n".join(_plain(_read(*one)) for one in _SCRIPTS)]
    hashes = " ".join(f"'sha256-{_sha256(text)}'" for text in scripts)
    shell = _read(__package__, "page.html")
    parts = {
        "policy": _POLICY.format(hashes=hashes + " blob:"),
        "title": html.escape(title),
        "styles": "\n".join(_read(*one) for one in _STYLES),
        "worker": worker,
        "payload": payload,
        "scripts": "\n".join(f"<script>{text}</script>" for text in scripts),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], shell)


def _plain(text: str) -> str:
    """Return a module as a part of one script."""
    return "\n".join(_lines(text))


def _lines(text: str) -> Iterator[str]:
    for line in text.splitlines():
        if not line.startswith("import "):
            yield line.removeprefix("export ")


def _sha256(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _read(package: str, name: str) -> str:
    return (resources.files(package) / "page" / name).read_text(encoding="utf-8")
