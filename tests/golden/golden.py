"""Golden runs: a short log of every rig, and the bits and figures of its whole run.

    <rig>.mcap.zst   the first LOG_S of the rig in virtual time, motion from the start: replayed
    figures.yaml     of the whole run: sha256 over all state records of both nodes, and metrics

`make bless` writes both anew and prints old and new figures, for the commit message that says why.
The rigs' own two-sided limits (`expect`, with their reasons) bound what may be blessed. Controllers
take turns over the rigs, so that each occurs twice.
"""

import hashlib
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
import zstandard

from executive.rig import Rig, load_rig
from executive.virtual import in_memory, simulate
from tools.summary import evaluation_module

FOLDER = Path(__file__).resolve().parent
FIGURES = FOLDER / "figures.yaml"
ROOT = FOLDER.parents[1]
CONTROLLERS = ("pd", "pd_star", "pid", "pd_fast", "pd_nn", "pd_nn_fast", "nn_backstepping")
LOG_S = 0.03
LOG_BYTES = 50_000


def rigs() -> Iterator[tuple[str, Path, str]]:
    """Yield (name, file, controller) of every golden run."""
    files = sorted((ROOT / "plants").glob("*/rigs/*.yaml"))
    for i, file in enumerate(files):
        wanted, config = CONTROLLERS[i % len(CONTROLLERS)], load_rig(file, resolve=False).config
        yield file.stem, file, wanted if wanted in config.expect else config.controller


def packed_log(name: str) -> Path:
    """Return the file of a golden log."""
    return FOLDER / f"{name}.mcap.zst"


def short(file: Path, controller: str) -> Rig:
    """Return the rig of a golden log: motion and network from the start."""
    settings = [f"duration_s={LOG_S}", "schedule=[]"]
    if controller in ("pd_nn", "pd_nn_fast", "nn_backstepping"):
        settings.append("controller.network_on=1.0")
    plain = load_rig(file, controller)
    if "start_s" in plain.nodes()[0].blocks[0].settings:
        settings.append("reference.start_s=0.0")
    return load_rig(file, controller, settings)


def whole(file: Path, controller: str) -> dict[str, Any]:
    """Return controller, digest and metrics of the rig's whole run."""
    rig = load_rig(file, controller)
    log = in_memory(rig)
    digest = hashlib.sha256()
    for node in log.node.values():
        digest.update(np.stack(list(node.columns.values())).tobytes())
    module = evaluation_module(rig)
    metrics: dict[str, float] = {}
    if module is not None and rig.evaluation is not None:
        period_s = 1.0 / rig.config.rate_hz
        window = rig.evaluation.window_s
        metrics = module.metrics(log, window, rig.evaluation.numbers, period_s)
    figures = {key: float(f"{value:.6g}") for key, value in metrics.items()}
    return {"controller": controller, "sha256": digest.hexdigest(), "figures": figures}


def changes(name: str, old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """Return what differs, a line a figure."""
    if old == new:
        return []
    before, after = old.get("figures", {}), new["figures"]
    lines = [f"{name} ({new['controller']}): other bits"]
    for key in {**before, **after}:
        if before.get(key) != after.get(key):
            lines.append(f"  {key}: {before.get(key)} -> {after.get(key)}")
    return lines


def bless() -> int:
    """Write all golden files anew; print what changed."""
    known = yaml.safe_load(FIGURES.read_text()) if FIGURES.exists() else {}
    found = {}
    for name, file, controller in rigs():
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "log.mcap"
            simulate(short(file, controller), log)
            packed = zstandard.ZstdCompressor(level=19).compress(log.read_bytes())
        found[name] = whole(file, controller)
        for line in changes(name, known.get(name, {}), found[name]):
            print(line)
        packed_log(name).write_bytes(packed)
        print(f"{name}: {len(packed)} bytes", file=sys.stderr)
    FIGURES.write_text(yaml.safe_dump(found, sort_keys=False))
    return 0


if __name__ == "__main__":
    sys.exit(bless())
