"""The settings of a robot's drive: declared once, changed by a rig, installed (no numba here)."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from pcpc.drivers.compiled.numbered import NumberedEnum

LARGEST = 3.4e38  # of a float32
_numbered: Any = NumberedEnum
_UNSAID = (  # parts of names
    "AXIS0", "CONFIG", "CONTROLLER", "MOTOR", "MOTOR_THERMISTOR", "COMMAND", "SERVO", "SERVOPOS",
)  # fmt: skip


class Setting(NamedTuple):
    """A setting: its name, its number in the protocol, its value at the start and its bounds."""

    name: str
    number: int
    start: float
    low: float = 0.0
    high: float = LARGEST
    whole: bool = False
    writable: bool = True


def keys_of(dialect: str, settings: Iterable[Setting]) -> Any:
    """Return their rows by name, as a Numbered class: TRAP_TRAJ_VEL_LIMIT."""
    parts = (one.name.upper().split(".") for one in settings)
    names = ["_".join(part for part in name if part not in _UNSAID) for name in parts]
    return _numbered(f"{dialect}Key", names, start=0)


def changed_settings(settings: Sequence[Setting], starts: Mapping[str, float]) -> list[Setting]:
    """Return the settings with other values at the start; ValueError says what is wrong."""
    names = {one.name: i for i, one in enumerate(settings)}
    changed = list(settings)
    for name, value in starts.items():
        if name not in names:
            known = ", ".join(one for one in names if one.split(".")[-1] == name.split(".")[-1])
            raise ValueError(f"{name}: the drive has no such setting" + (known and f"; {known}?"))
        setting = settings[names[name]]
        if not setting.low <= value <= setting.high or (setting.whole and value != int(value)):
            kind = "a whole number" if setting.whole else "a number"
            raise ValueError(
                f"{name}: {value:g} is not {kind} from {setting.low:g} to {setting.high:g}"
            )
        changed[names[name]] = setting._replace(start=float(value))
    return changed


def install(r: object, settings: Sequence[Setting]) -> None:
    """Write settings into the zeroed Robot record `r`, which is as after power-on."""
    into: Any = r
    into.n = len(settings)
    for i, setting in enumerate(settings):
        into.settings[i] = (
            setting.number,
            setting.whole,
            setting.writable,
            setting.start,
            setting.low,
            setting.high,
        )
        into.value[i] = setting.start
