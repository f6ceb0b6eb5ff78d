"""Commands: host."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pcpc.tools.terminal import arguments as take
from pcpc.tools.terminal.command import Add, Command, codes
from pcpc.tools.terminal.request import WORD, Offers, Request
from pcpc.tools.terminal.rooms import Room


class PageRequest(Request):
    """What a page may do, where it listens and records to."""

    write: Annotated[bool, "let the page tune, stop, reset, begin faults"] = False
    port: Annotated[int | None, take.port, "N", "port; default: the first free from 8642 on"] = None
    recordings: Annotated[
        Path | None, "DIR", "folder of the page's recordings; default: runs/host"
    ] = None
    recordings_mb: Annotated[
        int | None, take.positive, "N", "largest size of all recordings, MB; default: 4000"
    ] = None


class HostRequest(Request):
    """What is shown, to whom, and whether they may tune.

    `once`: the token is kept in no file and lasts as long as the page.
    """

    what: Annotated[
        str | None,
        WORD,
        "RIG|RUN|LOG",
        "a rig or run in progress, or a log; default: the run in progress",
    ] = None
    node: Annotated[str, "NAME", "full name of a node, if several run"] = ""
    page: PageRequest = PageRequest()
    address: Annotated[
        str, "IP", "address to listen on; default: %(default)s, this machine only"
    ] = "127.0.0.1"
    name: Annotated[Sequence[str], "HOST", "another name of this machine in browsers"] = ()
    tls_cert: Annotated[str | None, "FILE", "TLS certificate (PEM)", {"reads": True}] = None
    tls_key: Annotated[str | None, "FILE", "TLS key", {"reads": True}] = None
    plain: Annotated[bool, "no TLS on other addresses: anyone on the network can read, tune"] = (
        False
    )
    new_token: Annotated[bool, "make a new token: pages opened before lose access"] = False
    once: bool = False
    beside: Annotated[Offers, "BESIDE_HOST"] = Offers()
    code: take.CodeOfLaws = take.CodeOfLaws()


class PageOfRun(PageRequest):
    """The same of a page beside a run."""

    @classmethod
    def add_to(cls, add: Add) -> None:
        """Add its options to a parser; their help names what else must be given."""

        def add_to_host(*names: str, **about: Any) -> Any:
            return add(*names, **about | {"help": f"--host: {about['help']}"})

        super().add_to(add_to_host)


class BesideRun(Request):
    """The page beside a run."""

    host: Annotated[bool, "show the page of `pcpc host` during the run"] = False
    page: PageOfRun = PageOfRun()


BESIDE_RUN = BesideRun
COMMANDS = (
    Command(
        "host",
        "show a run or a log in a browser: live plots, tuning, timing",
        "pcpc host --write\npcpc host latest\npcpc host --foxglove",
        HostRequest,
        reads_logs=True,
        module="live.host.cli",
        codes=codes(OK="Ctrl-C", ENVIRONMENT="a package is missing, or the port is taken"),
        first=True,
    ),
)
ROOM = Room(
    "docs/howto/page.md",
    "tests/tools/live/host/test_host_attacks.py",
    "run probe --host",
    refused="no option --host",
    needed_by=("make/web",),
)
