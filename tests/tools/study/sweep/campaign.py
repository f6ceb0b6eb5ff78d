"""A campaign's table as `pcpc sweep` writes it, of a made-up rig whose answers are known."""

import json
from typing import Any

import numpy as np
import pyarrow as pa

from pcpc.tools.study.sweep import vary

VARIED = ("plant.friction_Nm=x0.5:2", "plant.payload_kg=normal(4,1)", "plant.motor=choice(1,2)")
CONTROLLERS = ("pd", "network<b>")  # a name that has to be escaped
REQUIREMENT = "peak error & co"


def spec(draws: int, **more: Any) -> dict[str, Any]:
    about = {
        "rig": "arm.yaml", "title": "Arm <of> a test", "controllers": list(CONTROLLERS),
        "variations": list(VARIED), "draws": draws, "sampling": "random", "seed": 7,
        "settings": ["plant.gap_rad=0.003"],
    }  # fmt: skip
    return {**about, **more}


def table(draws: int = 50, controllers: tuple[str, ...] = CONTROLLERS) -> pa.Table:
    """Return rows of both controllers: the second's error is 1/3 of the first's, with spread.

    Draw 3 of the first is a fault, draw 4 is refused for both; beyond 14 mrad a run fails.
    """
    variations = vary.parse_variations(VARIED)
    points = vary.points(variations, draws, "random", 7)
    values = vary.values(variations, points, (2.0, 1.0, 1.0))
    rows = []
    for draw in range(draws):
        friction, payload, motor = values[draw].tolist()
        spread = 1.5 ** np.random.default_rng(draw).standard_normal()
        for i, controller in enumerate(controllers):
            error = 2.0 * friction**2 * (1.0 if motor == 1.0 else 2.0) / (1.0, 3.0 * spread)[i]
            fault, refused = draw == 3 and i == 0, draw == 4
            told = not (fault or refused)
            ok = told and error < 14.0
            rows.append({
                "draw": draw, "controller": controller, "seed": vary.run_seed(7, draw),
                **{f"vary:{v.name}": x for v, x in zip(variations, values[draw], strict=True)},
                "metric:error_rms_mrad": error if told else np.nan,
                "metric:settle_s": 0.5 + 0.1 * payload if told and draw % 9 else np.nan,
                "metric:bias_mrad": friction - payload if told else np.nan,
                f"margin:{REQUIREMENT}": 14.0 - error if told else np.nan,
                f"held:{REQUIREMENT}": error < 14.0 if told else None,
                "ok": ok,
                "why": "safety stop" if fault else "" if ok else "refused" if refused else
                       "peak error & co violated",
                "outcome": "fault" if fault else "refused" if refused else "ran",
            })  # fmt: skip
    whole = pa.Table.from_pylist(rows)
    return whole.replace_schema_metadata({"pcpc": json.dumps(spec(draws))})
