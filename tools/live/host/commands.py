"""Commands: host."""

from pathlib import Path

from pcpc.drivers.errors import Exit
from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command
from pcpc.tools.terminal.rooms import offers


def host(add: Add) -> None:
    """Take what is shown, to whom, and whether they may tune."""
    add(
        "what",
        nargs="?",
        metavar="RIG|RUN|LOG",
        help="a rig whose run is shown, or a run folder, log or latest; what runs",
    )
    add("--node", default="", metavar="NAME", help="where several run: a node, by its full name")
    page(add)
    add(
        "--address",
        default="127.0.0.1",
        metavar="IP",
        help="where it listens; %(default)s: for this machine only",
    )
    add(
        "--name",
        action="append",
        default=[],
        metavar="HOST",
        help="another name of this machine that browsers may use",
    )
    add("--tls-cert", metavar="FILE", help="certificate (PEM), and with")
    add("--tls-key", metavar="FILE", help="its key, what is sent is encrypted")
    add(
        "--plain",
        action="store_true",
        help="other addresses without TLS: all on the way can read and tune",
    )
    add("--new-token", action="store_true", help="pages opened before lose their right")
    for more in offers("BESIDE_HOST"):
        more(add)
    take.code_of_laws(add)


def beside(add: Add) -> None:
    """Take the page beside a run."""
    add(
        "--host", action="store_true", help="a page beside the run, as of `pcpc host`; ends with it"
    )
    page(add, "--host: ")


def page(add: Add, of: str = "") -> None:
    """Take what a page may do, where it listens and records to; `of`: what else must be given."""
    add("--write", action="store_true", help=f"{of}let the page tune, stop, reset, begin faults")
    add("--port", type=int, metavar="N", help=f"{of}default: the first free from 8642 on")
    add(
        "--recordings",
        type=Path,
        metavar="DIR",
        help=f"{of}where the page records to, and saves what was; default runs/host",
    )
    add(
        "--recordings-mb",
        type=take.positive,
        metavar="N",
        help=f"{of}the most that all of them together have, MB; default 4000",
    )


BESIDE_RUN = beside
COMMANDS = (
    Command(
        "host",
        "show a run or a log in any browser: moving plots, tuning, timing",
        "pcpc host --write\npcpc host latest\npcpc host --foxglove",
        host,
        reads_logs=True,
        module="live.host.cli",
        codes={
            Exit.OK: "Ctrl-C",
            Exit.WRONG_INPUT: "",
            Exit.ENVIRONMENT: "a package or the port is missing",
        },
        first=True,
    ),
)
