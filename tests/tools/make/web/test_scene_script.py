"""A page draws a plant as its drawing.py does: every scene, at known and unknown values."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from judging_node import node_json

from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.plants import drawing
from pcpc.plants.drawing import Drawing, DrawingError, drawing_of, settings_of
from pcpc.plants.judging import Judged
from pcpc.tools.make.web.scene_script import scene_data
from pcpc.tools.make.web.symbols import Unrecordable
from pcpc.tools.start.rigs import find, shipped_rigs

DRAWN = {rig.plant: rig.path for rig in reversed([*shipped_rigs()])}
ODD = (math.nan, math.inf, -math.inf, 1e300, -1e300, 0.0, -0.0)
FINE = 2e-4  # of the longer side: what Scene.json rounds to, twice
_SCRIPT = """
import { readFileSync } from "node:fs";
import { sceneOf } from "./scene.mjs";
const { data, asked } = JSON.parse(readFileSync("asked.json", "utf8"));
const number = (all) => Object.fromEntries(Object.entries(all).map(([k, v]) => [k, Number(v)]));
const told = asked.map(([now, p]) => sceneOf(data, number(now), number(p)));
process.stdout.write(JSON.stringify(told));
"""


def plain(values: Mapping[str, float]) -> dict[str, str]:
    return {
        k: repr(float(v)).replace("inf", "Infinity").replace("nan", "NaN")
        for k, v in values.items()
    }


def drawn_by_a_page(
    folder: Path,
    data: Mapping[str, Any],
    asked: list[tuple[Mapping[str, float], Mapping[str, float]]],
) -> list[dict[str, Any]]:
    told = [[plain(now), plain(p)] for now, p in asked]
    (folder / "asked.json").write_text(json.dumps({"data": data, "asked": told}, allow_nan=False))
    return list(node_json(folder, _SCRIPT, ("scene",)))


def assert_same(page: dict[str, Any], made: Drawing, now: Mapping[str, float], p: Any) -> None:
    native = made.scene(now, p).json()
    x0, y0, x1, y1 = native["bounds"]
    side = max(x1 - x0, y1 - y0)
    assert page["bounds"] == pytest.approx(native["bounds"], rel=1e-12)
    assert page["note"] == native["note"]
    assert [one[:2] for one in page["shapes"]] == [one[:2] for one in native["shapes"]], now
    for ours, theirs in zip(page["shapes"], native["shapes"], strict=True):
        assert ours[2] == pytest.approx(theirs[2], abs=FINE * side, rel=1e-9), (theirs, now)
        assert ours[3:] == pytest.approx(theirs[3:]), now


@pytest.mark.parametrize("plant", DRAWN)
def test_every_plants_scene_is_the_same(plant: str, tmp_path: Path) -> None:
    rig = load_rig(DRAWN[plant], settings=["duration_s=1.5"])
    made, p = drawing_of(rig), settings_of(rig)
    assert made is not None
    columns = made.columns(Judged(in_memory(rig), 1.0 / rig.config.rate_hz).run())
    random = np.random.default_rng(17)
    rows = random.integers(0, len(columns["t"]), 40)
    instants = [{name: float(values[row]) for name, values in columns.items()} for row in rows]
    for now in list(instants[:20]):
        far = {
            name: value * random.normal() * 10.0 ** random.integers(0, 3)
            for name, value in now.items()
        }
        instants += [far, *(now | {name: random.choice(ODD)} for name in (*made.needs, "t"))]
    found = drawn_by_a_page(tmp_path, scene_data(made, p), [(now, {}) for now in instants])
    for page, now in zip(found, instants, strict=True):
        assert_same(page, made, now, p)


@pytest.mark.parametrize(
    ("plant", "changed"),
    [("payload_arm", "a1_m=0.7"), ("deadzone_map", "d=0.31"), ("quarter_car", "road_m=0.03"),
     ("backlash_pendulum", "length_m=0.8"), ("backlash_map", "slope=1.4"),
     ("deadzone_arm", "d_plus_Nm=22")],
)  # fmt: skip
def test_a_changed_setting_is_drawn(plant: str, changed: str, tmp_path: Path) -> None:
    name, _, value = changed.partition("=")
    rig = load_rig(DRAWN[plant])
    made, p = drawing_of(rig), settings_of(rig)
    assert made is not None and name in p
    now = {one: 0.3 + 0.1 * i for i, one in enumerate((*made.needs, "t"))}
    ((page),) = drawn_by_a_page(tmp_path, scene_data(made, p), [(now, {name: float(value)})])
    assert_same(page, made, now, {**p, name: float(value)})


def test_a_setting_that_a_drawing_takes_as_a_plain_number_is_told(tmp_path: Path) -> None:
    rig = load_rig(find("hull"))
    made, p = drawing_of(rig), settings_of(rig)
    assert made is not None
    now = dict.fromkeys((*made.needs, "t"), 0.01)
    data = scene_data(made, p)
    longer, stiffer, own = drawn_by_a_page(
        tmp_path,
        data,
        [(now, {"length_m": 1.3}), (now, {"young_Pa": 1e11}), (now, {"gap_rad": 0.001})],
    )
    told = [
        one[3] for scene in (longer, stiffer, own) for one in scene["shapes"] if one[0] == "text"
    ]
    assert (
        "drawn with the rig's own length_m" in told and "drawn with the rig's own young_Pa" in told
    )
    assert sum("drawn with" in one for one in told) == 2
    longer["shapes"].pop(), stiffer["shapes"].pop()
    assert_same(longer, made, now, p)
    assert_same(own, made, now, {**p, "gap_rad": 0.001})


HEAD = (
    "import math\nimport numpy as np\nfrom pcpc.plants.drawing import *\n"
    "NEEDS = {'a': 'x', 'b': 'y'}\nB = (-9, -9, 9, 9)\n"
)


def of(text: str, folder: Path) -> Drawing:
    (folder / "drawing.py").write_text(
        f"{HEAD}def scene(now, p):\n    a, b = now['a'], now['b']\n{text}"
    )
    return drawing.load(folder / "drawing.py")


@pytest.mark.parametrize(
    "text",
    [
        "    return Scene(B, text((0, 0), f'{a:.3g} {b:+.1f} {a:g} {b:.2e} {a}'))",
        "    xs = np.sin(np.array([a, b])) * 2\n"
        "    return Scene(B, line([(x, x * x) for x in xs], 'moving'))",
        "    return Scene(B, [disc((a, b), p['r'], 'body')] if a > b else [])",
        "    role = 'force' if a * b < 0 else 'moving' if a else 'ghost'\n"
        "    return Scene(B, box((max(a, b, 1), min([a, b])), abs(a), 1 / b, role))",
        "    return Scene(B, disc((math.log(a, 2), math.hypot(a, b, 3)), "
        "sum([a, b]), 'note'), arrow((a, b), (round(a, 1), b % 2)), note=f'{p[\"r\"]:g}')",
        "    return Scene(B, [disc((i * a, math.copysign(b, -a)), 1, 'moving') "
        "for i in range(int(p['r'] * 10))], turn((0, 0), 1, a, b), "
        "spring((0, 0), (a, b), 0.1, 'body'))",
    ],
)  # fmt: skip
def test_what_a_drawing_may_write(text: str, tmp_path: Path) -> None:
    made, p = of(text, tmp_path), {"r": 0.5}
    random = np.random.default_rng(3)
    asked = [{"a": x, "b": y, "t": 0.0} for x, y in np.abs(random.normal(0, 3, (9, 2)))]
    if "log" not in text:
        asked += [{"a": x, "b": y, "t": 0.0} for x, y in random.normal(0, 3, (30, 2))]
    if "copysign" in text:
        asked += [{"a": x, "b": 2.0, "t": 0.0} for x in (0.0, -0.0)]
    found = drawn_by_a_page(tmp_path, scene_data(made, p), [(now, {}) for now in asked])
    for page, now in zip(found, asked, strict=True):
        assert_same(page, made, now, p)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("    return Scene(B, disc((float(a), 0), 1, 'body'))", "as a plain float"),
        ("    return Scene(B, [disc((i, 0), 1, 'body') for i in range(int(a))])", "whole"),
        ("    return Scene(B, text((0, 0), f'{a:>8.3f}'))", "the format >8.3f"),
        ("    return Scene(B, disc((math.gamma(a), 0), 1, 'body'))", "as a plain float"),
        ("    return Scene(B, disc((a, b), p['no'], 'body'))", "KeyError: 'no'"),
        ("    for i in range(9):\n        b += a > i and 1.0\n    return Scene(B)", "too often"),
    ],
)  # fmt: skip
def test_what_cannot_be_written_down_is_told(text: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(Unrecordable, match=why):
        scene_data(of(text, tmp_path), {})


def test_a_way_on_which_a_drawing_fails_says_so(tmp_path: Path) -> None:
    text = "    return Scene(B, disc((a, b), 1 if a > 0 else p['no'], 'body'))"
    made = of(text, tmp_path)
    good, bad = drawn_by_a_page(
        tmp_path, scene_data(made, {}), [({"a": x, "b": 0}, {}) for x in (1, -1)]
    )
    assert_same(good, made, {"a": 1.0, "b": 0.0, "t": math.nan}, {})
    assert "KeyError: 'no'" in bad["shapes"][0][3]
    with pytest.raises(DrawingError, match="KeyError: 'no'"):
        made.scene({"a": -1.0, "b": 0.0}, {})


def test_functions_are_themselves_again_afterwards(tmp_path: Path) -> None:
    before = math.cos, math.hypot, max, min
    scene_data(
        of("    return Scene(B, disc((math.cos(a), max(a, b)), 1, 'body'))", tmp_path),
        {},
    )
    assert before == (math.cos, math.hypot, max, min)
