"""The Reference FMUs compiled for this machine, spoiled ones, and a rig around an FMU."""

import re
import shutil
import subprocess
import zipfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy
import numpy as np
from numpy.typing import NDArray

from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig

HERE = Path(__file__).resolve().parent
SOURCES = HERE / "reference"
PROBE = HERE.parents[3] / "plants" / "probe"
HEADERS = Path(fmpy.__file__).parent / "c-code"
PLATFORM = {2: fmpy.platform, 3: fmpy.platform_tuple}
_folder = TemporaryDirectory(prefix="pcpc-fmus-")

RIG = """\
rig: {name}
dbc: {probe}/probe.dbc
rate_hz: {rate:g}
duration_s: {duration:g}
controller: proportional
controllers:
  proportional:
    law: {probe}/law.py:BLOCK
    parameters: {{gain: 4.0, target: 1.0}}
executive:
  node: EXEC
  blocks:
    controller:
      inputs: {{position: rx.FB.position}}
  transmit:
    CMD.command: controller.command
    CMD.mode: supervisor.state
    HB_EXEC.nmt_state: supervisor.nmt
plant:
  node: PLANT
  fmu: {fmu}
{more}  transmit:
    FB.position: {output}
    HB_PLANT.nmt_state: supervisor.nmt
  safe: {{CMD.command: 0.0}}
"""


@cache
def fmu(name: str, version: int) -> Path:
    """Return a Reference FMU, compiled for this machine."""
    return made(name, version, Path(_folder.name) / f"{name}-{version}.fmu")


def made(
    name: str,
    version: int,
    file: Path,
    edits: Mapping[str, str] | None = None,
    code: Mapping[str, str] | None = None,
    platform: str = "",
) -> Path:
    """Compile a Reference FMU into `file`; `edits` of its description, `code` of its model.c.

    Each is a pattern and what comes instead. `platform`: another folder's name for its library.
    """
    with TemporaryDirectory() as text:
        folder = Path(text)
        model = (SOURCES / name / "model.c").read_text(encoding="utf-8")
        (folder / "model.c").write_text(_edited(model, code or {}), encoding="utf-8")
        library = folder / "library.so"
        sources = [folder / "model.c", SOURCES / f"src/fmi{version}Functions.c",
                   SOURCES / "src/cosimulation.c"]  # fmt: skip
        command = ["gcc", "-shared", "-fPIC", "-O1", f"-DFMI_VERSION={version}", "-DDISABLE_PREFIX",
                   *(f"-I{at}" for at in (SOURCES / name, SOURCES / "include", HEADERS)),
                   *map(str, sources), "-o", str(library), "-lm"]  # fmt: skip
        subprocess.run(command, check=True, capture_output=True)
        xml = (SOURCES / name / f"FMI{version}.xml").read_text(encoding="utf-8")
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("modelDescription.xml", _edited(xml, edits or {}))
            archive.write(library, f"binaries/{platform or PLATFORM[version]}/{name}.so")
    return file


def _edited(text: str, edits: Mapping[str, str]) -> str:
    for pattern, instead in edits.items():
        text, n = re.subn(pattern, instead, text)
        assert n, f"{pattern} is not there"
    return text


def rig(
    folder: Path, fmu: Path, output: str, more: str = "", rate: float = 100.0, duration: float = 3.0
) -> Path:
    """Write a rig around an FMU; `more`: keys of its plant. FMU and rig lie in `folder`."""
    here = folder / fmu.name
    if not here.exists() and fmu.exists():
        shutil.copy(fmu, here)
    name = re.sub("[^a-z0-9]", "-", fmu.stem.lower())
    text = RIG.format(
        name=name,
        probe=PROBE,
        rate=rate,
        duration=duration,
        fmu=here.name,
        output=output,
        more="".join(f"  {line}\n" for line in more.splitlines()),
    )
    (folder / "rig.yaml").write_text(text, encoding="utf-8")
    return folder / "rig.yaml"


def columns(path: Path, node: str = "plant") -> dict[str, NDArray[np.float64]]:
    """Return what a node of a rig recorded in virtual time."""
    return dict(in_memory(load_rig(path)).node[node].columns)
