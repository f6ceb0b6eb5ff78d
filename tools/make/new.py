"""`pcpc new DIR`: a rig of the user's own, a DC motor with an encoder, to run and to change.

Its files are those of template/, a rig like any other; only its name becomes the folder's.
With `--device` also those of template/device, whose README.md continues the other one.
"""

import argparse
import re
import shlex
from contextlib import suppress
from pathlib import Path

from pcpc.drivers.errors import Exit, UserError
from pcpc.executive.errors import RigError, code_of
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
DEVICE_FILES = {
    "device.py": "the law as a program of its own, in place of the executive",
    "device.yaml": "the rig for it, or for your firmware",
    "test_device.py": "a test of the device",
}
NEXT = {
    "pcpc simulate .": "virtual time, in one process",
    "pcpc run .": "real processes, frames on a bus",
    "pcpc run . --pacing lockstep": "the same without a clock",
    "pcpc plant .": "two terminals: the plant here ...",
    "pcpc exec .": "... and the control there",
    "pytest": "its tests",
}
NEXT_DEVICE = "pcpc plant device.yaml --pacing lockstep --device python device.py {bus}"
_NAME = re.compile("(?!-)[a-z0-9._-]{1,64}")  # of a rig


def command(options: argparse.Namespace) -> int:
    """Write the rig, and say what can be done with it."""
    folder: Path = options.dir
    write(folder, options.device)
    print(f"{folder}: a rig of your own, a DC motor with an encoder")
    files = FILES | (DEVICE_FILES if options.device else {})
    print("\n".join(screen.table([(f"  {name}", what) for name, what in files.items()])))
    print(f"next:\n  cd {shlex.quote(str(folder))}")
    print("\n".join(screen.table([(f"  {line}", what) for line, what in NEXT.items()])))
    if options.device:
        print(f"  {NEXT_DEVICE}")
    return Exit.OK


def write(folder: Path, device: bool = False) -> None:
    """Write the rig into `folder`, which is new or empty, also for a device; UserError."""
    name = folder.resolve().name
    if not _NAME.fullmatch(name):
        cure = re.sub("[^a-z0-9._-]+", "-", name.lower()).strip("-")[:64] or "motor"
        what = f"'{name}' cannot be a rig's name, which is of a-z, 0-9, '.', '_' and '-'"
        what += ", which is not its first" if name.startswith("-") else ""
        raise RigError(f"{folder}: {what}; try {cure}")
    is_new, written = not folder.exists(), []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise RigError(f"{folder}: is not empty; name a folder that is new or empty")
        for file, text in _texts(device).items():
            text = text.replace("rig: motor\n", f"rig: {name}\n") if file == "rig.yaml" else text
            path = folder / file
            path.parent.mkdir(exist_ok=True)
            written.append(path)
            path.write_text(text, encoding="utf-8")
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


def _texts(device: bool) -> dict[str, str]:
    """Return what is written, by file."""
    texts = {file: (TEMPLATE / file).read_text(encoding="utf-8") for file in FILES}
    if device:
        more = TEMPLATE / "device"
        texts |= {file: (more / file).read_text(encoding="utf-8") for file in DEVICE_FILES}
        texts["README.md"] += (more / "README.md").read_text(encoding="utf-8")
    return texts
