"""`pcpc new DIR`: a rig of the user's own to run and to change: a motor, a cart, or nearly nothing.

Its files are those of template/, with `--cart` of template/cart, with `--bare` of template/bare,
rigs like any other; only their name becomes the folder's, also in the names of the DBC file and
of the test. How to run it stands in the README.md of the motor, for all; the tables of files are
those below.
With `--drive` also the rig of a drive, with `--device` also the files of template/device, whose
README.md continues that of the motor.
"""

import json
import re
import shlex
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError, code_of
from pcpc.tools.make.commands import NewRequest
from pcpc.tools.run.rig_schema import rig_schema
from pcpc.tools.terminal import screen

TEMPLATE = Path(__file__).with_name("template")
FILES = {
    "rig.yaml": "what runs and how it is wired; begin here",
    "model.py": "the plant: driver, winding, rotor with friction, encoder",
    "laws/pid.py": "the law: PID on the encoder's angle",
    "motor.dbc": "the CAN frames, with counters and CRC",
    "evaluation.py": "figures of merit and the picture",
    "drawing.py": "how it is drawn while it moves",
    "identification.py": "what `pcpc fit` estimates of it from a log",
    "layout.json": "the curves with which the page of `pcpc host` opens",
    "test_motor.py": "tests, for pytest",
    "README.md": "what one sees, and what to change first",
}
CART_FILES = {
    "rig.yaml": FILES["rig.yaml"],
    "model.py": "the plant: drive, cart, pole, two encoders",
    "laws/state_feedback.py": "the law: feedback of the full state, poles chosen",
    "cart.dbc": FILES["motor.dbc"],
    **{file: FILES[file] for file in ("evaluation.py", "drawing.py", "identification.py")},
    "layout.json": FILES["layout.json"],
    "test_cart.py": FILES["test_motor.py"],
    "README.md": FILES["README.md"],
}
BARE_FILES = {
    "rig.yaml": FILES["rig.yaml"],
    "model.py": "the plant: one input, one output",
    "laws/p.py": "the law: a gain on the error",
    "bare.dbc": FILES["motor.dbc"],
    "test_bare.py": FILES["test_motor.py"],
    "README.md": "what to write in place of what",
}
DRIVE_FILES = {"drive.yaml": "the motor as a drive, for any master"}
DEVICE_FILES = {
    "device.py": "the law as a program of its own, in place of the executive",
    "device.yaml": "the rig for it, or for your firmware",
    "test_device.py": "a test of the device",
}
NEXT = {
    "pcpc simulate .": "virtual time, in one process",
    "pcpc run .": "real processes, frames on a bus",
    "pcpc run . --pacing lockstep": "the same without a clock",
    "pcpc run . --only plant": "two terminals: the plant here ...",
    "pcpc run . --only executive": "... and the control there",
    "pytest": "its tests",
}
NEXT_DEVICE = "pcpc run device.yaml --pacing lockstep --device python device.py {bus}"
SCHEMA = "rig.schema.json"
_MODELINE = f"# yaml-language-server: $schema={SCHEMA}\n"
_TO_RUN = re.compile("(?<=\n)## Four ways to run it\n.*?(?=## )", re.DOTALL)  # in a README.md
_NAME = re.compile("(?!-)[a-z0-9._-]{1,64}")  # of a rig


@dataclass(frozen=True)
class Template:
    """A rig that is written: its folder, what it is, its files with what each is for."""

    folder: Path
    rig: str
    what: str
    files: Mapping[str, str]

    def renamed(self, text: str, name: str) -> str:
        """Return `text` with the rig's name, and with the files that are named by it."""
        stem = re.sub(r"\W", "_", name, flags=re.ASCII)
        text = text.replace(f"rig: {self.rig}\n", f"rig: {name}\n")
        for file in (f"{self.rig}.dbc", f"test_{self.rig}.py"):
            text = re.sub(rf"\b{re.escape(file)}\b", file.replace(self.rig, stem), text)
        return text


MOTOR = Template(TEMPLATE, "motor", "a DC motor with an encoder", FILES)
CART = Template(TEMPLATE / "cart", "cart", "a pole on a cart", CART_FILES)
BARE = Template(TEMPLATE / "bare", "bare", "a first-order lag to replace", BARE_FILES)


def command(request: NewRequest) -> int:
    """Write the rig, and say what can be done with it. UserError: wrong input."""
    if request.cart and request.bare:
        raise UserError("--cart and --bare: choose one of them")
    template = CART if request.cart else BARE if request.bare else MOTOR
    if not request.dir:
        flag = f"--{template.rig} " if template is not MOTOR else ""
        raise UserError(f"DIR is missing: name a new folder, as in pcpc new {flag}{template.rig}")
    folder = Path(request.dir)
    write(folder, request.device, template, request.drive)
    print(f"{folder}: a rig of your own, {template.what}")
    files = {
        **template.files, SCHEMA: "what an editor knows of rig.yaml",
        **(DEVICE_FILES if request.device else {}), **(DRIVE_FILES if request.drive else {}),
    }  # fmt: skip
    rig = folder.resolve().name
    rows = [(f"  {template.renamed(name, rig)}", what) for name, what in files.items()]
    print("\n".join(screen.table(rows)))
    print(f"next:\n  cd {shlex.quote(str(folder))}")
    print("\n".join(screen.table([(f"  {line}", what) for line, what in NEXT.items()])))
    if request.device:
        print(f"  {NEXT_DEVICE}")
    if request.drive:
        print("  pcpc run drive.yaml --only plant         the drive, for your master")
    return Exit.OK


def write(
    folder: Path, device: bool = False, template: Template = MOTOR, drive: str | None = None
) -> None:
    """Write the rig into `folder`, which is new or empty, also for a device or as a `drive`.

    UserError: wrong input, or it cannot be written.
    """
    if drive and template is not MOTOR:
        raise UserError(f"--drive makes a drive of the motor; leave out --{template.rig}")
    if device and template is not MOTOR:
        what = "--device writes a program for the motor; leave it out"
        raise UserError(f"{what}: pcpc generate c {folder} --device makes one of the law")
    name = folder.resolve().name
    if not _NAME.fullmatch(name):
        cure = re.sub("[^a-z0-9._-]+", "-", name.lower()).strip("-")[:64]
        cure = cure if cure.strip(".") else template.rig
        what = f"'{name}' cannot be a rig's name, which is of a-z, 0-9, '.', '_' and '-'"
        what += ", which is not its first" if name.startswith("-") else ""
        what += ", at most 64 of them" if len(name) > 64 else ""
        raise RigError(f"{folder}: {what}; try {cure}")
    texts = _texts(template, device, drive)
    is_new, written = not folder.exists(), []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise RigError(f"{folder}: is not empty; name a folder that is new or empty")
        for file, text in texts.items():
            path = folder / template.renamed(file, name)
            path.parent.mkdir(exist_ok=True)
            written.append(path)
            path.write_text(template.renamed(text, name), encoding="utf-8")
    except FileExistsError:
        raise RigError(f"{folder}: is a file; name a folder that is new or empty") from None
    except OSError as error:
        with suppress(OSError):  # nothing half done is left
            for path in written:
                path.unlink(missing_ok=True)
            for inner in {path.parent for path in written} - {folder}:
                inner.rmdir()
            if is_new:
                folder.rmdir()
        what = f"{folder}: cannot be written: {error.strerror}; choose another folder"
        raise UserError(what, code_of(error)) from None


def _texts(template: Template, device: bool, drive: str | None) -> dict[str, str]:
    """Return what is written, by file."""
    texts = {file: _text(template.folder / file) for file in template.files}
    rows = [f"| `{file}` | {what} |\n" for file, what in template.files.items()]
    shared = "| file | what |\n|---|---|\n" + "".join(rows[:-1]) + "\n"  # all but itself
    if template is not MOTOR:
        shared += _TO_RUN.findall(_text(TEMPLATE / "README.md"))[0]
    texts["README.md"] = texts["README.md"].replace("## ", f"{shared}## ", 1)
    if device:
        more = TEMPLATE / "device"
        texts |= {file: _text(more / file) for file in DEVICE_FILES}
        texts["README.md"] += _text(more / "README.md")
    texts[SCHEMA] = screen.json_text(rig_schema(), 1) + "\n"
    if drive:
        texts["drive.yaml"] = _drive(drive)
    return {
        file: f"{_MODELINE if file.endswith('.yaml') else ''}{text}" for file, text in texts.items()
    }


def _drive(profile: str) -> str:
    """Return the motor as a drive; UserError where the package of its dialect is broken."""
    if (file := TEMPLATE / f"drive_{profile}.yaml").is_file():
        return _text(file)
    from pcpc.executive.nodes.planned_robot import kind_of  # here, because it loads numba

    node = kind_of(profile).nodes[0]
    text = _text(TEMPLATE / "drive.yaml").replace("node: 1", f"node: {node}")
    return text.replace("profile: mit", f"profile: {json.dumps(profile)}")


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8")
