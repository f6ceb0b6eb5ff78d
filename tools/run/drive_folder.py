"""The run folder of a drive that is started alone: its log, and the EDS that its master reads."""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from pcpc.drivers.canopen import eds
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.executive.nodes.planned_drive import dictionary_of, is_lone_drive
from pcpc.executive.rig.reading import Rig
from pcpc.tools.after.verdict.masters import told
from pcpc.tools.start.folder import LOG, run_folder

EDS = "drive.eds"


@contextmanager
def folder_of_drive(
    options: argparse.Namespace, rig: Rig, roles: Sequence[str]
) -> Iterator[Path | None]:
    """Make the folder with the EDS in it, if these nodes are a drive; else yield None. RigError."""
    if not is_lone_drive(rig, roles):
        yield None
        return
    text = eds.text(dictionary_of(rig))
    with run_folder(options.output, rig) as folder:
        file = folder / EDS
        file.write_text(text, encoding="ascii")
        try:
            yield folder
        finally:
            log = folder / LOG
            if not log.is_file() or not log.stat().st_size:  # nothing ran
                file.unlink()


def of_the_master(node: Live | None) -> list[str]:
    """Return what the master of a drive did wrong, as the drive counted it until its end."""
    if node is None:
        return []
    with suppress(LiveError):
        return told(node.read(), {name: one.help for name, one in node.variables.items()})
    return []
