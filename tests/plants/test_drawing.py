"""Each plant's drawing: what is drawn is where the log says, at every instant of every rig."""

import importlib
import json
import math
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import zstandard
from PIL import Image

from pcpc.executive.log.reader import Log, read
from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.plants import drawing, scene
from pcpc.plants.atb1000.beam import Tube, modal_data
from pcpc.plants.drawing import Drawing, DrawingError, drawing_of, settings_of, settings_of_log
from pcpc.plants.judging import Judged
from pcpc.tools.study.book import drawings

sys.path.append(str(Path(__file__).parents[1] / "golden"))
from golden import packed_log, rigs

ROOT = Path(__file__).resolve().parents[2]
DRAWN = [folder.parent.name for folder in sorted((ROOT / "plants").glob("*/drawing.py"))]
RUNS = {name: file for name, file, _ in rigs() if name.partition("/")[0] in DRAWN}
MOST_BYTES = 4096

Columns = Mapping[str, np.ndarray]
Settings = Mapping[str, float]


def of(plant: str) -> Drawing:
    return drawing.load(ROOT / "plants" / plant / "drawing.py")


def columns_of(made: Drawing, log: Log, rate_hz: float) -> Columns:
    return made.columns(Judged(log, 1.0 / rate_hz).run())


@cache
def golden(name: str) -> tuple[Drawing, Columns, Settings]:
    """Return drawing, columns and settings of a golden log."""
    file = ROOT / "build" / "drawing" / f"{name.replace('/', '-')}.mcap"
    file.parent.mkdir(parents=True, exist_ok=True)
    packed = packed_log(name).read_bytes()
    file.write_bytes(zstandard.ZstdDecompressor().decompress(packed, max_output_size=1 << 24))
    log = read(file)
    file.unlink()
    made = of(name.partition("/")[0])
    rate_hz = 1e9 / float(log.metadata["executive"]["period_ns"])
    return made, columns_of(made, log, rate_hz), settings_of_log(log)


def at(columns: Columns, row: int) -> dict[str, float]:
    return {name: float(values[row]) for name, values in columns.items()}


def sound(found: scene.Scene) -> str:
    """Return the scene as text, after a look at its size and numbers."""
    written = json.dumps(found.json(), allow_nan=False, separators=(",", ":"))
    assert len(written) < MOST_BYTES, len(written)
    return written


def words(found: scene.Scene) -> list[str]:
    return [str(one.size) for one in found.shapes if one.kind == "text"]


def roles(found: scene.Scene, kind: str, role: str) -> list[list[scene.Point]]:
    return [one.points for one in found.shapes if (one.kind, one.role) == (kind, role)]


@pytest.mark.parametrize("name", RUNS)
def test_the_log_of_every_rig_can_be_drawn(name: str) -> None:
    made, columns, p = golden(name)
    rows = {0, -1, *(int(of(v)) for v in columns.values() for of in (np.argmin, np.argmax))}
    scenes = [made.scene(at(columns, row), p) for row in sorted(rows)]
    assert all(sound(one) for one in scenes)
    assert len({one.bounds for one in scenes}) == 1, "the view jumps"
    assert not any("no data" in word for one in scenes for word in words(one)), words(scenes[0])


@pytest.mark.parametrize("name", RUNS)
def test_every_value_may_be_missing_or_beyond_all_bounds(name: str) -> None:
    made, columns, p = golden(name)
    now = at(columns, -1)
    for value in (math.nan, math.inf, 1e300, -1e300, 0.0):
        for lost in (*([one] for one in made.needs), [*made.needs, "t"]):
            found = made.scene(now | dict.fromkeys(lost, value), p)
            sound(found)
            told = any("no data" in word for word in words(found))
            assert told or math.isfinite(value), lost
            assert all(one in " ".join(words(found)) for one in lost if one != "t" and told)


def test_a_missing_node_leaves_what_is_known() -> None:
    made, columns, p = golden("atb1000/hull")
    found = made.scene(at(columns, 0) | {"q_d": math.nan}, p)
    assert "no data: q_d" in words(found)
    assert roles(found, "line", "magnified") and not roles(found, "line", "reference")


def test_painting_draws_every_shape_in_its_bounds() -> None:
    from matplotlib.figure import Figure

    made, columns, p = golden("atb1000/hull")
    found = made.scene(at(columns, 20), p)
    axes = Figure().subplots()
    found.paint(axes)
    drawn = [*axes.lines, *axes.patches, *axes.texts]
    assert len(drawn) == len(found.shapes) + 1, "and the note"
    x0, y0, x1, y1 = found.bounds
    assert (axes.get_xlim(), axes.get_ylim()) == ((x0, x1), (y0, y1))


# The barrel


def test_the_barrels_end_is_where_angle_and_modes_say() -> None:
    made, columns, p = golden("atb1000/hull")
    for row in (3, 17, -1):
        now = at(columns, row)
        (axis,) = roles(made.scene(now, p), "line", "magnified")
        tube = Tube(*(p[f] for f in Tube.__dataclass_fields__))
        beam, theta = modal_data(tube), now["theta"]
        bent = 40.0 * float(beam.tip @ [now["q1"], now["q2"], now["q3"]])
        along = np.array([math.cos(theta), math.sin(theta)])
        end = 1.2 * along + bent * np.array([-along[1], along[0]])
        np.testing.assert_allclose(axis[-1], end, rtol=0.0, atol=1e-12)
        (x0, y0), (x1, y1) = axis[0], axis[1]
        assert math.atan2(y1 - y0, x1 - x0) == pytest.approx(theta, abs=0.03), "clamped"


def test_a_barrel_at_rest_lies_on_the_flank_that_carries_it() -> None:
    made, columns, p = golden("atb1000/hull")
    slot = [one for one in made.scene(at(columns, 0), p).shapes if one.kind == "area"][-4:-2]
    assert [one.role for one in slot] == ["moving", "force"], slot
    assert slot[1].style == 1.0, "the gear carries the unbalance"
    wall = max(x for x, _ in slot[0].points[:4])
    assert slot[1].points[0][0] == pytest.approx(wall, abs=0.02)


@pytest.mark.parametrize(
    ("tooth", "solid"), [(-0.5, True), (-0.4, False), (0.4, False), (0.7, True)]
)
def test_a_tooth_is_solid_where_it_touches(tooth: float, solid: bool) -> None:
    walls, drawn = scene.slot((0.0, 0.0), 1.0, tooth, -0.5, 0.5, 2.0)
    assert drawn.points[0][0] == pytest.approx(0.5 * tooth), "to scale"
    assert [x for x, _ in walls.points[1:5:3]] == pytest.approx([-0.25, 0.25])
    assert (drawn.style == 1.0) is solid


def test_a_value_that_nobody_knows_is_drawn_nowhere() -> None:
    """Not at the end of its scale, where it would be a great one."""
    plane = scene.Plane((0.0, 0.0), 1.0, 2.0, 2.0)
    unknown = scene.Scene(
        (-1.0, -1.0, 1.0, 1.0),
        scene.turn((0.0, 0.0), 0.5, 0.0, math.nan),
        scene.disc(plane.at(math.nan, 0.0), 0.1, "moving"),
        scene.gauge((0.0, 0.0), 1.0, 1.0, [(math.nan, "moving")], "scale"),
    )
    assert unknown.lacks and {one.role for one in unknown.shapes} == {"note"}
    assert plane.at(9.0, -9.0) == (1.0, -1.0)


# The other plants: lengths stay, points lie on their curves


def scenes_of(
    name: str, every: int = 7
) -> Iterator[tuple[dict[str, float], Settings, scene.Scene]]:
    made, columns, p = golden(name)
    for row in range(0, len(columns["t"]), every):
        now = at(columns, row)
        yield now, p, made.scene(now, p)


ARMS = [name for name in RUNS if name.partition("/")[0].endswith("_arm") or "telerobot" in name]


@pytest.mark.parametrize("name", ARMS)
def test_the_links_of_an_arm_keep_their_lengths_and_end_at_the_masses(name: str) -> None:
    for now, p, found in scenes_of(name):
        (wanted,) = [one for one in roles(found, "line", "reference") if len(one) == 3]
        lengths = [math.dist(a, b) for a, b in pairwise(wanted)]
        assert lengths == pytest.approx([p["a1_m"], p["a2_m"]], rel=1e-12)
        q1, q2 = now["q_1"], now["q_1"] + now["q_2"]
        tip = (p["a1_m"] * math.cos(q1) + p["a2_m"] * math.cos(q2),
               p["a1_m"] * math.sin(q1) + p["a2_m"] * math.sin(q2))  # fmt: skip
        assert roles(found, "disc", "moving")[-1][0] == pytest.approx(tip, abs=1e-12)
        for rod, a in zip(roles(found, "area", "moving"), ("a1_m", "a2_m"), strict=True):
            outer, inner = np.mean([rod[0], rod[6]], axis=0), np.mean([rod[7], rod[13]], axis=0)
            assert math.dist(inner, outer) == pytest.approx(p[a], rel=1e-12), a


@pytest.mark.parametrize("name", [name for name in RUNS if name.startswith("deadzone_arm")])
def test_an_arms_command_and_torque_lie_on_its_deadzone(name: str) -> None:
    for now, p, _ in scenes_of(name):
        for j in (1, 2):
            u, tau = now[f"command_{j}"], now[f"torque_{j}"]
            up = p["m_plus"] * max(u - p["d_plus_Nm"], 0.0)
            down = p["m_minus"] * min(u + p["d_minus_Nm"], 0.0)
            assert tau == pytest.approx(up + down, abs=1e-9), (now["t"], j)


@pytest.mark.parametrize("name", [name for name in RUNS if name.startswith("quarter_car")])
def test_the_wheel_stands_where_the_road_and_the_strut_are_as_long_as_the_log_says(
    name: str,
) -> None:
    module = importlib.import_module("pcpc.plants.quarter_car.drawing")
    for now, p, found in scenes_of(name):
        road = dict(module.road(now, p))
        assert road[0.0] == pytest.approx(now["ground"], abs=1e-12), now["t"]
        (_, hub_y) = roles(found, "disc", "body")[0][0]
        floor = max(one[0][1] for one in roles(found, "area", "moving") if len(one) == 4)
        extension = floor - hub_y - module.STRUT_M
        assert extension == pytest.approx(now["extension"], abs=1e-12)


@pytest.mark.parametrize("name", [name for name in RUNS if name.startswith("backlash_pend")])
def test_the_pendulum_keeps_its_length_and_its_command_stays_in_the_play(name: str) -> None:
    for now, p, found in scenes_of(name):
        bob = roles(found, "disc", "moving")[0][0]
        assert math.hypot(*bob) == pytest.approx(p["length_m"], rel=1e-12)
        assert math.atan2(bob[0], -bob[1]) == pytest.approx(now["q"], abs=1e-12)
        play = now["command"] - now["torque"]
        assert p["d_minus_Nm"] - 1e-9 <= play <= p["d_plus_Nm"] + 1e-9, (now["t"], play)


@pytest.mark.parametrize("name", [name for name in RUNS if "_map/" in name])
def test_a_maps_point_lies_on_its_curve(name: str) -> None:
    for now, p, _ in scenes_of(name, 1):
        u, tau = now["command"], now["tau"]
        if now["t"] == 0.0:
            continue  # nothing has acted
        if "d" in p:
            assert tau == pytest.approx(math.copysign(max(abs(u) - p["d"], 0.0), u), abs=1e-9)
        else:
            low, high = (p["slope"] * (u - p[d]) for d in ("d_plus", "d_minus"))
            assert low - 1e-9 <= tau <= high + 1e-9, (now["t"], u, tau)


# What comes without a golden log, and the README's figures


def test_every_plant_has_a_drawing() -> None:
    rigs = {folder.parent.name for folder in (ROOT / "plants").glob("*/rig.yaml")}
    assert set(DRAWN) == rigs


@pytest.mark.parametrize(
    "folder", ["plants/probe", "tools/make/template", "tools/make/template/cart"]
)
def test_probe_and_templates_are_drawn_where_they_are(folder: str) -> None:
    lean = ["cart.start_rad=0.2"] if folder.endswith("cart") else []
    rig = load_rig(ROOT / folder / "rig.yaml", settings=["duration_s=0.3", *lean])
    made = drawing_of(rig)
    assert made is not None
    columns = columns_of(made, in_memory(rig), rig.config.rate_hz)
    for row in (0, 1, 150, -1):
        now = at(columns, row)
        found = made.scene(now, settings_of(rig))
        assert sound(found) and not any("no data" in word for word in words(found))
        if lean:
            (rod,) = roles(found, "area", "moving")
            (x, y), (top_x, top_y) = np.mean(rod[7:], axis=0), np.mean(rod[:7], axis=0)
            lean_rad = math.atan2(top_x - x, top_y - y)
            assert lean_rad == pytest.approx(now["angle"], abs=1e-12)
            assert top_x + x == pytest.approx(2 * now["x"] + 0.6 * math.sin(lean_rad), abs=1e-12)
        elif "angle" in now:
            (pointer,) = roles(found, "line", "moving")
            angle = math.atan2(pointer[1][1], pointer[1][0])
            assert math.remainder(angle - now["angle"], 2 * math.pi) == pytest.approx(0, abs=1e-12)
        else:
            (box,) = roles(found, "area", "moving")
            assert np.mean(box, axis=0)[0] == pytest.approx(now["x"], abs=1e-12)


@pytest.mark.parametrize("plant", [plant for plant in DRAWN if of(plant).figure])
def test_the_readmes_figure_shows_what_the_drawing_makes_of_its_run(plant: str) -> None:
    folder = ROOT / "plants" / plant
    assert "](figures/drawing.png)" in (folder / "README.md").read_text()
    with Image.open(folder / "figures" / "drawing.png") as picture:
        told = picture.text[drawings.KEY]
    assert told == drawings.scene_hash(drawings.moments(of(plant))), "pcpc experiment drawings"


# What is wrong is told in a line


RIG = """
base: {base}
evaluation: {{file: evaluation.py}}
"""


def rig_with(text: str, folder: Path) -> object:
    (folder / "drawing.py").write_text(text)
    (folder / "evaluation.py").write_text("")
    (folder / "rig.yaml").write_text(RIG.format(base=ROOT / "plants/atb1000/rigs/hull.yaml"))
    return load_rig(folder / "rig.yaml", resolve=False)


HEAD = "from pcpc.plants.drawing import *\nNEEDS = {'a': 'plant:barrel.theta_rad'}\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1/0\n", "drawing.py:1: ZeroDivisionError"),
        ("def scene(\n", "drawing.py:1: SyntaxError"),
        ("NEEDS = {}\n", "drawing.py: no function scene(now, p)"),
        ("NEEDS = ['a']\ndef scene(now, p): pass\n", "drawing.py: expected NEEDS = {"),
        ("NEEDS = {'t': 'time.t_s'}\ndef scene(now, p): pass\n", "any short name but t"),
        (HEAD + "def scene(now, p):\n    return now['b']\n", "drawing.py:4: KeyError: 'b'"),
        (HEAD + "def scene(now, p):\n    return 1\n", "scene returned int, expected a Scene"),
        (HEAD + "def scene(now, p):\n    return Scene((0, 0, 0, 1))\n", "drawing.py:4: ValueError"),
        (HEAD + "def scene(now, p):\n    return line([], 'blue')\n", "no role blue; expected one"),
    ],
)
def test_what_is_wrong_with_a_drawing_is_told_with_its_line(
    text: str, said: str, tmp_path: Path
) -> None:
    with pytest.raises(DrawingError) as told:
        made = drawing_of(rig_with(text, tmp_path))
        made.scene({"a": 0.0}, {})
    assert said in str(told.value) and "\n" not in str(told.value)


def test_a_rig_without_a_drawing_has_none(tmp_path: Path) -> None:
    rig = rig_with("", tmp_path)
    (tmp_path / "drawing.py").unlink()
    assert drawing_of(rig) is None


def test_a_rigs_own_settings_are_those_of_its_log() -> None:
    rig = load_rig(ROOT / "plants/atb1000/rigs/hull.yaml", settings=["duration_s=0.01"])
    assert settings_of(rig) == settings_of_log(in_memory(rig))
