"""The run folder of a drive that is started alone: its log, and what its master reads of it."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from pcpc.drivers.canopen import eds
from pcpc.executive.errors import RigError
from pcpc.executive.nodes.live import Live
from pcpc.executive.nodes.mailbox import LiveError
from pcpc.executive.nodes.planned_drive import CIA402, dictionary_of, is_lone_drive
from pcpc.executive.nodes.planned_robot import settings_of
from pcpc.executive.rig.bus_keys import Drive
from pcpc.executive.rig.reading import Rig
from pcpc.executive.rig.roles import Role
from pcpc.tools.after.verdict.masters import counter_lines
from pcpc.tools.run.commands import RunRequest
from pcpc.tools.start.folder import LOG, run_folder

EDS, SETTINGS = "drive.eds", "drive-settings.json"


@contextmanager
def folder_of_drive(request: RunRequest, rig: Rig, roles: Sequence[Role]) -> Iterator[Path | None]:
    """Make the folder with their EDS, if these nodes are drives; else yield None. RigError.

    The file of plant_2 has that name before its own.
    """
    is_alone = is_lone_drive(rig, roles)
    _check_asked(request, rig, is_alone)
    if not is_alone:
        yield None
        return
    texts = {}
    for role in roles:
        drive, prefix = rig.config.drives[role], "" if role == "plant" else f"{role}-"
        if drive.profile == CIA402:
            texts[prefix + EDS] = eds.text(dictionary_of(rig, role))
        else:
            texts[prefix + SETTINGS] = settings_text(rig, drive)
    with run_folder(request.kept.output, rig) as folder:
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="ascii")
        try:
            yield folder
        finally:
            log = folder / LOG
            if not log.is_file() or not log.stat().st_size:  # nothing ran
                for name in texts:
                    (folder / name).unlink()


def _check_asked(request: RunRequest, rig: Rig, keeps_log: bool) -> None:
    """Refuse what would come to nothing without an executive; RigError."""
    asked = {"-o": request.kept.output is not None and not keeps_log,
             "--json": request.kept.json, "--judge": request.kept.judge}  # fmt: skip
    if given := [name for name, is_asked in asked.items() if is_asked]:
        what = "leave it out, the run is kept and judged where its executive is"
        raise RigError(f"{request.rig}: {', '.join(given)}: {what}")


def settings_text(rig: Rig, drive: Drive) -> str:
    """Return the settings of a robot's drive by the numbers of endpoints or registers, as JSON."""
    settings = {
        setting.name: {
            "id": setting.number if setting.number >= 0 else None,
            "type": "uint32" if setting.whole else "float",
            "access": "rw" if setting.writable else "r",
            "value": setting.start if setting.start == setting.start else None,
        }
        for setting in settings_of(rig, drive)
    }
    return json.dumps({"endpoints": settings}, indent=1) + "\n"


def of_the_master(node: Live | None) -> list[str]:
    """Return what the master of a drive did wrong, as the drive counted it until its end."""
    if node is None:
        return []
    with suppress(LiveError):
        return counter_lines(node.read(), {name: one.help for name, one in node.variables.items()})
    return []
