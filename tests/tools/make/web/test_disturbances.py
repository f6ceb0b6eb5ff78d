"""The buttons of a page: of the rig's schedule, of its blocks' events, of rigs beside it."""

from pathlib import Path

import pytest

from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make.web.disturbances import disturbances
from pcpc.tools.start.rigs import find


def of(rig: str, *settings: str) -> dict[str, dict[str, tuple[float, int]]]:
    """Return what each button of a rig sets."""
    found = disturbances(load_rig(find(rig), None, settings), [*settings])
    return {
        one["label"]: {name: (value, later) for name, value, later in one["set"]} for one in found
    }


def test_an_event_begins_at_the_press_with_its_parts_as_far_apart_as_they_were() -> None:
    fire = of("hull")["fire now"]
    assert fire["plant:barrel.fire"] == (1.0, 0)
    assert fire["plant:barrel.fire_hub_start_s"] == (0.0, 1)
    assert fire["plant:barrel.fire_muzzle_start_s"] == (0.003, 1)
    assert fire["plant:barrel.fire_muzzle_lasts_s"] == (0.003, 0)


@pytest.mark.parametrize("rig", ["telerobot-u0", "telerobot-u2"])
def test_an_event_without_effect_is_as_strong_and_long_as_in_a_rig_beside(rig: str) -> None:
    assert of(rig)["load now"] == {
        "plant:arm.load_kg": (2.5, 0),
        "plant:arm.load_from_s": (0.0, 1),
        "plant:arm.load_to_s": (5.0, 1),
    }


def test_rigs_beside_one_give_their_values_and_there_is_a_way_back() -> None:
    found = of("suspension-58", "car.road_m=0.02")
    assert found["as suspension-8: road_rad_s = 8 rad/s"] == {"plant:car.road_rad_s": (8.0, 0)}
    assert found["back to suspension-58"]["plant:car.road_rad_s"] == (58.0, 0)
    assert not any("road_m" in name for values in found.values() for name in values)


def test_what_is_scheduled_can_be_had_now() -> None:
    assert of("engage")["controller.network_on = 1 now"] == {"controller.network_on": (1.0, 0)}


def test_a_rig_alone_without_any_has_no_button() -> None:
    assert not of("probe")


def test_files_beside_a_rig_that_are_none_are_left_alone(tmp_path: Path) -> None:
    base = Path(find("probe")).resolve()
    slower = "plant: {blocks: {lag: {parameters: {tau_s: 0.2}}}}"
    for name, text in {
        "own.yaml": f"base: {base}\nrig: own\n",
        "other.yaml": f"base: {base}\nrig: other\n{slower}\n",
        "broken.yaml": "rig: [\n",
        "notes.yaml": "- a list\n",
    }.items():
        (tmp_path / name).write_text(text)
    assert [*of(str(tmp_path / "own.yaml"))] == ["as other: tau_s = 0.2 s", "back to own"]
