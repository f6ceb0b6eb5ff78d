"""Ways of a rig that is handed on: a page in Node, an FMU of its plant, a device in C.

They take programs of others (Node, gcc), and seconds each; see `ways`.
"""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from free_bus import own_bus
from logcommand import run_here
from places import ROOT
from processes import pcpc
from recorded import Recorded, Refused, columns_differing, loaded_words

from pcpc.drivers.errors import BusError, UserError
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.plan import plan
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.make.fmu import cli as fmu
from pcpc.tools.make.generate.device import device

IN_NODE = ROOT / "tests/tools/make/web/in_node.mjs"


def need(*programs: str) -> None:
    """Skip the test where a program is missing."""
    for program in programs:
        if shutil.which(program) is None:
            pytest.skip(f"no {program} here: make firmware-tools browser-tools")


def in_a_page(run: Recorded, folder: Path) -> list[str]:
    """Run the module of the rig's page in Node; its digest is the native one."""
    need("node")
    page = folder / "page.html"
    done = run_here("generate", "web", *loaded_words(run.given), "-o", page, "-q")
    if done.code:
        raise Refused(done.err)
    asked = {"page": str(page), "runs": [{"controller": run.rig.config.controller}]}
    answer = subprocess.run(
        ["node", str(IN_NODE)], input=json.dumps(asked), capture_output=True, text=True, check=True
    )
    (found,) = json.loads(answer.stdout)
    native = run_here("simulate", *loaded_words(run.given), "--digest", "--no-figure",
                      "--quiet", "-o", folder / "native")  # fmt: skip
    same = found["digest"] and found["digest"] in native.out
    return [] if same else [f"digest {found['digest']}, {native.out}{native.err} {found['why']}"]


def with_fmu(rig: Rig, folder: Path) -> tuple[str, set[str]]:
    """Return the text of a rig with an FMU in the place of its plant's block; the block's states.

    Raises RigError, UserError. The FMU lies in the folder, absolute paths lead to it and the DBC.
    """
    need("gcc")
    made = plan(rig, "plant", "lockstep")
    spec = fmu.chosen_block(made, None)
    fmu.write(made, spec, folder / "plant.fmu")
    data = yamlfile.load(rig.path, rig.resolved()).data
    inputs = data["plant"]["blocks"][spec.name]["inputs"]
    block = {"law": "fmu", "file": str(folder / "plant.fmu"), "inputs": inputs}
    data["plant"]["blocks"][spec.name] = block
    data |= {"dbc": str(rig.dbc), "evaluation": None}
    states = {f"{spec.name}.{name}" for port in spec.block.states for name in port.names()}
    return yamlfile.dump(data), states


def as_an_fmu(run: Recorded, folder: Path) -> list[str]:
    """Simulate with an FMU that was generated of the plant's block in its place."""
    try:
        text, states = with_fmu(run.rig, folder)
        log = in_memory(load_rig(run.rig.path.with_name("of_an_fmu.yaml"), text=text))
    except (RigError, UserError) as why:  # a drive looks at a state, which an FMU does not show
        raise Refused(str(why)) from None
    return columns_differing(run.log, log, states)


def as_a_device(run: Recorded, folder: Path) -> list[str]:
    """Run the executive as a program in C on a bus, and the plant by its side."""
    need("cc", "make")
    try:
        files = device(run.rig)
    except (RigError, BusError, UserError) as why:
        raise Refused(str(why)) from None
    for name, text in files.items():
        (folder / name).write_text(text)
    subprocess.run(["make", "-s", "-C", str(folder), "linux", "CFLAGS=-O1 -Werror"], check=True)
    words = (
        "run",
        "--only=plant",
        *loaded_words(run.given),
        "--bus",
        own_bus(),
        "-o",
        str(folder / "run"),
    )
    program = ("--device", str(folder / "linux"), "{bus}")
    done = pcpc(*words, "--pacing", "lockstep", "--no-figure", "--json", *program)
    if done.code == 2:
        raise Refused(done.err)
    assert done.code in (0, 1, 5), done
    log = logs.read(folder / "run/log.mcap")
    alone = logs.Log(run.path, {"plant": run.log.node["plant"]}, {}, run.log.metadata, [])
    return columns_differing(alone, log, whole=False)  # the device says when it ends
