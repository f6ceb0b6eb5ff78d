"""Fixtures of the contracts: the recorded run of a rig, one a session; a refused command."""

from pathlib import Path

import pytest
from recorded import Recorded, record
from refusing import refused
from rigs import given

__all__ = ["refused"]
_recorded: dict[str, Recorded] = {}


@pytest.fixture
def run(rig: str, tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Return the recorded run of a test's rig."""
    if rig not in _recorded:
        folder: Path = tmp_path_factory.mktemp(rig)
        _recorded[rig] = record(given(rig, folder), folder / "log.mcap")
    return _recorded[rig]
