"""What can be identified of a plant from a log: `identification.py` beside its evaluation.

    PARAMETERS    {"BLOCK.NAME": "a run that excites it", ...}        what `pcpc fit` estimates
    SENSORS       {"FRAME.signal": "BLOCK.PORT", ...}                 what is compared with what
    MODEL         {"BLOCK.NAME": number, ...}                         the model's own settings

All three may be left out. PARAMETERS: then every setting of the plant that has a unit and is not 0.
SENSORS: then every signal that the plant sends, as it is sent. An own PORT is what the signal is
before the model rounds it: a difference of rounded numbers has no slope. MODEL: settings that are
not to be those of the recorded plant. Those with `noise` in their name are 0 in any case: the model
predicts what a sensor says but for its noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pcpc.executive.errors import RigError
from pcpc.executive.rig.reading import Rig
from pcpc.plants.declared import declared


class IdentificationError(RigError):
    """An identification.py that says nothing that can be used: where and why, in one line."""


@dataclass(frozen=True)
class Identification:
    """A plant's identification.py; None where it does not say, or is not there."""

    parameters: Mapping[str, str] | None = None
    sensors: Mapping[str, str] | None = None
    model: Mapping[str, float] | None = None


def identification_of(rig: Rig) -> Identification:
    """Return what the plant's folder says; IdentificationError. It runs its Python."""
    beside = Path(rig.evaluation.file) if rig.evaluation else rig.path
    file = beside.with_name("identification.py")
    if not file.is_file():
        return Identification()
    module = declared(file, IdentificationError)
    texts, numbers = '{"NAME": "text", ...}', '{"BLOCK.NAME": number, ...}'
    return Identification(
        _mapping(module, file, "PARAMETERS", str, texts),
        _mapping(module, file, "SENSORS", str, texts),
        _mapping(module, file, "MODEL", (int, float), numbers),
    )


def _mapping(module: Any, file: Path, name: str, kind: Any, expected: str) -> Any:
    mapping = getattr(module, name, None)
    if mapping is None:
        return None
    if not isinstance(mapping, dict) or not all(
        isinstance(key, str) and isinstance(value, kind) for key, value in mapping.items()
    ):
        raise IdentificationError(f"{file}: {name}: expected {expected}")
    return mapping
