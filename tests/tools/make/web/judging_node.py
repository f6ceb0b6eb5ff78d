"""page/judge.js asked through node: columns go as a file of float64, its answer comes as JSON."""

import json
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from places import PATIENCE_S

from pcpc.executive.log.reader import Log
from pcpc.tools.make import web

PAGE = Path(web.__file__).parent / "page"
_SCRIPT = """
import { readFileSync } from "node:fs";
import { judge } from "./judge.mjs";
const asked = JSON.parse(readFileSync("asked.json", "utf8"));
const bytes = readFileSync("columns.bin");
const all = new Float64Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
const place = new Map(asked.names.map((name, i) => [name, i]));
const column = (name) => {
  const i = place.get(name);
  return i === undefined ? undefined : all.subarray(asked.begins[i], asked.begins[i + 1]);
};
const told = judge(asked.data, column, asked.cycles, asked.periodS);
told.signals = Object.fromEntries(Object.entries(told.signals).map(([k, v]) => [k, [...v]]));
process.stdout.write(JSON.stringify(told, (_, value) =>
  typeof value === "number" && !Number.isFinite(value) ? String(value) : value));
"""


def page_columns(log: Log) -> dict[str, NDArray[np.float64]]:
    """Return a log's variables by NODE:NAME, each (n,)."""
    return {
        f"{node}:{name}": one.columns[name]
        for node, one in log.node.items()
        for name in one.columns
    }


def judged_in_node(
    folder: Path,
    data: Mapping[str, Any],
    columns: Mapping[str, NDArray[np.float64]],
    cycles: int,
    period_s: float,
) -> dict[str, Any]:
    """Return what judge.js says; numbers that are not finite are words of JavaScript."""
    begins = np.cumsum([0, *(len(one) for one in columns.values())]).tolist()
    asked = {"data": data, "names": list(columns), "cycles": cycles, "periodS": period_s}
    asked["begins"] = begins
    (folder / "asked.json").write_text(json.dumps(asked, allow_nan=False))
    np.concatenate([*columns.values()], dtype=np.float64).tofile(folder / "columns.bin")
    return dict(node_json(folder, _SCRIPT))


def node_json(folder: Path, script: str, more: tuple[str, ...] = ()) -> Any:
    """Return the JSON that a module prints; the page's modules lie beside it as .mjs."""
    if (node := shutil.which("node")) is None:
        pytest.skip("node is not installed")
    for file in ("judge", "monitors", "vectors", *more):
        text = (PAGE / f"{file}.js").read_text().replace('.js";', '.mjs";')
        (folder / f"{file}.mjs").write_text(text)
    (folder / "ask.mjs").write_text(script)
    done = subprocess.run(
        [node, "ask.mjs"], cwd=folder, capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
