"""Commands: verify."""

from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command


def verify(add: Add) -> None:
    """Take logs, and what is written of them or held against them."""
    add(
        "logs", nargs="*", metavar="LOG", help="logs, folders (all *.mcap); default: beside --check"
    )
    add("--table", type=Path, metavar="FILE", help="write digests and verdicts")
    add("--sign", metavar="KEY", help="sign the table with an SSH key: FILE.sig")
    add("--check", type=Path, reads=True, metavar="FILE", help="check the logs against a table")
    about = "check its signature: allowed signers of ssh-keygen"
    add("--signers", reads=True, metavar="FILE", help=about)
    add("--identity", metavar="WHO", help="who must have signed it")
    add("--junit", type=Path, metavar="FILE", help="a testcase for each log")
    take.node(add)
    add(
        "--jobs",
        type=take.positive,
        metavar="N",
        help="processes; default: one a processor, fewer for small logs",
    )
    take.code_of_laws(add)
    take.json(add)
    take.quiet(add)


COMMANDS = (
    Command(
        "verify",
        "recompute many logs and check them against a signed table",
        "pcpc verify runs --table runs/verified.txt --sign ~/.ssh/id_ed25519\n"
        "pcpc verify --check runs/verified.txt --signers signers --identity me@lab",
        verify,
        codes={
            Exit.OK: "all identical",
            Exit.NOT_MET: "one differs, or is not as in the table; or the signature is wrong",
            Exit.WRONG_INPUT: "",
            Exit.LOSS: "one is incomplete or missing",
            Exit.ENVIRONMENT: "",
            Exit.INTERRUPTED: "",
        },
        judges=True,
        compiles=True,
        module="after.verify.cli",
    ),
)
