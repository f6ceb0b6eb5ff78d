"""Commands: generate."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Command, codes
from pcpc.tools.terminal.request import Offers, Request
from pcpc.tools.terminal.rooms import Room


class CRequest(Request):
    """Laws or a rig, where their C goes, and what is told of it."""

    what: Annotated[
        str,
        "LAW|RIG",
        "a law: pd, references:sine, plants/atb1000/model.py; or a rig: a name (pcpc rigs), a file",
    ]
    controller: Annotated[str | None, "NAME", "of a rig: use this controller"] = None
    set: Annotated[Sequence[str], "NAME=VALUE", "of a rig: change a value of it or of a block"] = ()
    output: Annotated[Path | None, "-o", "DIR", "folder; default: NAME_c"] = None
    device: Annotated[
        bool, "of a rig: also frames, CRC, supervisor, a main for Linux and Cortex-M"
    ] = False
    check: Annotated[
        bool,
        "of a rig: run its closed loop in C, in every build that this machine can make, "
        "and compare with `pcpc simulate`",
    ] = False
    single: Annotated[
        bool, "float, not double; --check compares the builds, and the run with double"
    ] = False
    cost: Annotated[bool, "instructions and stack on Cortex-M7 and M4"] = False
    cycles: Annotated[
        int, take.positive, "N", "--check, --cost: number of cycles; default: %(default)s"
    ] = 200
    beside: Annotated[Offers, "BESIDE_C"] = Offers()
    quiet: take.ShortQuiet = False


_PARTS = (
    Command(
        "c",
        "write readable C99 of a law, or of a rig's executive",
        "pcpc generate c pd_nn_fast -o firmware\n"
        "pcpc generate c hull --controller pd_nn_fast --check",
        CRequest,
        compiles=True,
        module="make.generate.cli",
        codes=codes(
            NOT_MET="a build gives other bits",
            ENVIRONMENT="a compiler is missing, or DIR cannot be written",
        ),
    ),
)

COMMANDS = (
    Command(
        "generate",
        "write bit-identical C of laws and rigs, or an FMU of a plant",
        "pcpc generate c pd -o firmware",
        compiles=True,
        parts=_PARTS,
    ),
)
ROOM = Room(
    "docs/howto/generate.md",
    "tests/tools/make/generate/test_generate_command.py",
    "generate c probe",
    needed_by=("dev/bench", "make/fmu/cli.py", "make/web"),
)
