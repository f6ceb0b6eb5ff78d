"""What a log needs besides the records: what its numbers are called, and what the run came from."""

from pathlib import Path

from pcpc.drivers.can import dbc
from pcpc.drivers.machine import outside
from pcpc.executive.log.description import NodeDescription
from pcpc.executive.loop.faults import FAULT_NAMES
from pcpc.executive.loop.states import STATE_NAMES
from pcpc.executive.nodes import planned_drive
from pcpc.executive.nodes.part import Part, Plan
from pcpc.executive.own_laws.modules import PROJECT
from pcpc.executive.rig.bus_keys import PROFILES
from pcpc.executive.rig.reading import Rig


class Names(Part):
    """The names of frames, states and faults, by their numbers."""

    def described(self, made: Plan) -> NodeDescription:
        """Return them; frames of a drive have some without a DBC file."""
        frames = {str(frame.can_id): frame.name for frame in (*made.rx_frames, *made.tx_frames)}
        return {
            "frames": planned_drive.names(made.rig, made.role) | frames,
            "state_names": list(STATE_NAMES),
            "fault_names": list(FAULT_NAMES),
        }


class Sources(Part):
    """The texts that a run was made from."""

    def described(self, made: Plan) -> NodeDescription:
        """Return rig, tables and DBC file, the laws from outside the project, who ran it."""
        rig = made.rig
        texts = {str(_short(path, rig.path)): text for path, text in rig.document.sources.items()}
        texts |= {"rig-resolved.yaml": rig.resolved()} if made.has_text else {}
        texts |= rig.tables()
        texts[rig.dbc.name] = dbc.text(rig.dbc)
        return {
            "attachments": texts,
            "files": rig.carried_files(made.read),
            "external": list(made.external),
            "metadata": made.metadata | _packages(rig),
        }


def _packages(rig: Rig) -> dict[str, str]:
    """Return the packages of others that the rig or its drives are of; {} of none."""
    dialects = {drive.profile for drive in rig.config.drives.values()}
    used = [one for one in outside.additions("drives") if one.name in dialects - {*PROFILES}]
    if not rig.path.is_relative_to(PROJECT):
        used += [one for one in outside.additions("plants") if rig.path.is_relative_to(one.folder)]
    names = sorted({f"{one.package} {one.version}" for one in used})
    return {"packages": ", ".join(names)} if names else {}


def _short(path: Path, rig: Path) -> Path:
    """Return `path` relative to the rig file's folder, or its name where it lies elsewhere."""
    folder = rig.parent
    return path.relative_to(folder) if path.is_relative_to(folder) else Path(path.name)
