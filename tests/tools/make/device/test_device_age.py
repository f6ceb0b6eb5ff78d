"""How old a device's commands are, from numbers made up; with a device itself in test_device."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from processes import ROOT

from pcpc.drivers.can.dbc import Protection
from pcpc.drivers.can.e2e_states import FrameState
from pcpc.executive.errors import RigError
from pcpc.executive.log import reader as logs
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make.device import age
from pcpc.tools.make.device.behaviour import Behaviour

RIG = load_rig(ROOT / "plants" / "probe" / "device" / "rig.yaml", resolve=False)
N, STOP = 300, 10**6
CYCLE = np.arange(N)
LAW = (CYCLE * 7919) % 1009  # N numbers, each once
SETTLED = np.minimum(CYCLE, 60)  # what changes in 60 cycles only


def late(law: np.ndarray[Any, Any], by: int) -> np.ndarray[Any, Any]:
    """Return what is sent `by` cycles later than by a law, until the device's end."""
    sent = np.concatenate((np.full(by, -1), law))[: len(law)]
    sent[-1] = STOP
    return sent


@pytest.mark.parametrize(
    ("law", "sent", "cycles"),
    [
        *((LAW, late(LAW, by), by) for by in (0, 1, 16, 256, N - 21)),
        (LAW, late(LAW, N - 20), None),  # 19 that are compared: fewer than FEWEST
        (SETTLED, late(SETTLED, 0), 0),
        (SETTLED, late(SETTLED, 30), 30),
        (np.zeros(N), late(np.zeros(N), 0), None),  # as the law, however old
        (CYCLE // 299, late(CYCLE // 299, 0), None),  # its only change is the device's end
        (CYCLE // 298, late(CYCLE // 298, 0), 0),
        (CYCLE % 10, late(CYCLE % 10, 256), None),  # 10 numbers
        (CYCLE % 50, late(CYCLE % 50, 256), 256),
        (CYCLE // 4, late(CYCLE // 4, 16), 16),
        (LAW, np.where(CYCLE < 170, late(LAW, 16), -CYCLE), 16),  # more than half
        (LAW, np.where(CYCLE < 140, late(LAW, 16), -CYCLE), None),
        (LAW, np.where(CYCLE == 40, -2, LAW), None),  # one of another law
        (late(LAW, 16), LAW, None),  # before the law
    ],
)
def test_the_age_is_that_of_most_of_what_a_law_answers(law: Any, sent: Any, cycles: Any) -> None:
    assert age.age_of(CYCLE, law.astype(np.int64), CYCLE, sent.astype(np.int64)) == cycles


def test_commands_of_cycles_that_were_lost_are_not_compared() -> None:
    came = np.flatnonzero(CYCLE % 3)
    assert age.age_of(CYCLE, LAW, came, LAW[came]) == 0
    assert age.age_of(CYCLE, LAW, came, late(LAW, 40)[came]) == 40
    assert age.age_of(CYCLE, LAW, came[:0], LAW[:0]) is None


def frames_of(command: np.ndarray[Any, Any], state: int = FrameState.OK) -> np.ndarray[Any, Any]:
    """Return frames CMD with these commands, of any counter and CRC."""
    found = np.zeros(len(command), logs.FRAME)
    found["id"], found["cycle"], found["dlc"], found["e2e"] = (
        0x0A0,
        np.arange(len(command)),
        8,
        state,
    )
    found["data"][:, :4] = command.astype("<i4")[:, None].view(np.uint8)
    found["data"][:, 6], found["data"][:, 7] = CYCLE % 16, CYCLE % 251
    return found


def noted(sent: Any, pacing: str = "lockstep", received: int = N) -> Behaviour:
    """Return what is noted of frames that a device sent, beside those of the law."""
    found = Behaviour({"CMD": {"received": received}})
    answers = {"side_effect": sent} if isinstance(sent, Exception) else {"return_value": sent}
    with patch.object(age, "_answers", **answers):
        age.note_ages(found, RIG, logs.Log(ROOT, {}, {}, {}, []), pacing)
    return found


def test_an_age_that_nothing_tells_is_a_warning() -> None:
    law = frames_of(LAW)
    of_age = "device: CMD: the age of its commands is known modulo 16 cycles only: "
    for told, why in (
        (noted((frames_of(-LAW), law)), "they do not change, or are not those of the rig's law"),
        (noted(RigError("no law.py")), "the rig's law cannot be run again: no law.py"),
        (noted((law, law), "sync"), "a run in lockstep compares them with the rig's law"),
        (noted((law, law), "real"), "a run in lockstep compares them with the rig's law"),
    ):
        assert (told.warned, told.problems, told.ages) == ([of_age + why], [], {})


def test_an_age_is_named_whatever_counter_and_crc_say() -> None:
    law = frames_of(LAW)
    law["data"][:, 6:] = 0
    for by, old in ((1, "1 cycle"), (16, "16 cycles")):
        told = noted((frames_of(late(LAW, by)), law))
        assert told.problems == [f"device: CMD: its commands are {old} old"] and not told.warned
    fine = noted((frames_of(LAW), law))
    assert (fine.problems, fine.warned, fine.ages) == ([], [], {"CMD": 0})


@pytest.mark.parametrize(
    ("counter", "crc", "left"),
    [
        ((6, 0, 15), (Protection.CRC_8, 7, 0), "fffffffffffff000"),
        ((1, 4, 3), (Protection.CRC_8, 7, 0), "ffcfffffffffff00"),
        ((2, 0, 255), (Protection.CRC_16, 0, 0), "000000ffffffffff"),
    ],
)
def test_a_payload_is_all_but_counter_and_crc(counter: Any, crc: Any, left: str) -> None:
    (frame,) = (one for _, one in age.NodesBelow(RIG).heard if one.name == "CMD")
    frame = replace(frame, counter=counter, crc=crc)
    assert age._payload(frame, np.full((2, 8), 255, np.uint8)).tobytes().hex() == 2 * left


def test_frames_that_were_not_used_are_not_compared() -> None:
    sent = frames_of(LAW)
    sent["data"][40, :4], sent["e2e"][40] = 99, FrameState.ERROR
    assert noted((sent, frames_of(LAW))).ages == {"CMD": 0}
    sent["e2e"][40] = FrameState.OK_SOME_LOST
    assert noted((sent, frames_of(LAW))).ages == {}


def test_without_a_counter_nothing_of_an_age_is_known() -> None:
    (frame,) = (one for _, one in age.NodesBelow(RIG).heard if one.name == "CMD")
    bare = SimpleNamespace(heard=[("plant", replace(frame, counter=(0,) * 3, crc=(0,) * 3))])
    with patch.object(age, "NodesBelow", lambda rig: bare):
        (warning,) = noted((frames_of(-LAW), frames_of(LAW))).warned
    assert "the age of its commands is known not at all: " in warning


def test_a_frame_that_never_came_has_no_age() -> None:
    told = noted((frames_of(LAW)[:0], frames_of(LAW)), received=0)
    assert (told.problems, told.warned) == ([], [])
