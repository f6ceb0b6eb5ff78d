"""Commands: host."""

from pathlib import Path

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes
from pcpc.tools.terminal.rooms import offers


def host(add: Add) -> None:
    """Take what is shown, to whom, and whether they may tune."""
    add(
        "what",
        nargs="?",
        metavar="RIG|RUN|LOG",
        help="a rig or run in progress, or a log; default: the run in progress",
    )
    add("--node", default="", metavar="NAME", help="full name of a node, if several run")
    page(add)
    add(
        "--address",
        default="127.0.0.1",
        metavar="IP",
        help="address to listen on; default: %(default)s, this machine only",
    )
    take.several(add, "--name", "HOST", "another name of this machine in browsers")
    add("--tls-cert", reads=True, metavar="FILE", help="TLS certificate (PEM)")
    add("--tls-key", reads=True, metavar="FILE", help="TLS key")
    add(
        "--plain",
        action="store_true",
        help="no TLS on other addresses: anyone on the network can read, tune",
    )
    add(
        "--new-token", action="store_true", help="make a new token: pages opened before lose access"
    )
    for more in offers("BESIDE_HOST"):
        more(add)
    take.code_of_laws(add)


def page_options(add: Add) -> None:
    """Take the page beside a run."""
    add("--host", action="store_true", help="show the page of `pcpc host` during the run")
    page(add, "--host: ")


def page(add: Add, of: str = "") -> None:
    """Take what a page may do, where it listens and records to; `of`: what else must be given."""
    add("--write", action="store_true", help=f"{of}let the page tune, stop, reset, begin faults")
    first = "the first free from 8642 on"
    add("--port", type=take.port, metavar="N", help=f"{of}port; default: {first}")
    add(
        "--recordings",
        type=Path,
        metavar="DIR",
        help=f"{of}folder of the page's recordings; default: runs/host",
    )
    add(
        "--recordings-mb",
        type=take.positive,
        metavar="N",
        help=f"{of}largest size of all recordings, MB; default: 4000",
    )


BESIDE_RUN = page_options
COMMANDS = (
    Command(
        "host",
        "show a run or a log in a browser: live plots, tuning, timing",
        "pcpc host --write\npcpc host latest\npcpc host --foxglove",
        host,
        reads_logs=True,
        module="live.host.cli",
        codes=codes(OK="Ctrl-C", ENVIRONMENT="a package is missing, or the port is taken"),
        first=True,
    ),
)
