"""Golden runs: a short log of every rig, and the bits and figures of its whole run.

    <plant>/<rig>.mcap.zst  the first LOG_CYCLES in virtual time, motion from the start: replayed
    <plant>/figures.yaml    of whole runs: sha256 over all state records of both nodes, and metrics

`make bless` writes both anew and prints old and new figures, for the commit message that says why;
`make bless PLANT=atb1000` those of one plant. The rigs' own two-sided limits (`expect`, with their
reasons) bound what may be blessed. The controllers of a plant take turns over its rigs, and go on
as <rig>+<controller> where there are more controllers than rigs.
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

from pcpc.executive.nodes.virtual import in_memory, simulate
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.tools.summary import evaluation_module

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
LOG_CYCLES = 30
LOG_BYTES = 50_000


def rigs(plant: str = "*") -> Iterator[tuple[str, Path, str]]:
    """Yield (plant/rig, file, controller) of every golden run."""
    for folder in sorted((ROOT / "plants").glob(f"{plant}/rigs")):
        files = sorted(folder.glob("*.yaml"))
        configs = {file: load_rig(file, resolve=False).config for file in files}
        controllers = list(configs[files[0]].controllers)
        for i in range(max(len(files), len(controllers))):
            file, turn = files[i % len(files)], controllers[i % len(controllers)]
            known = turn in configs[file].expect
            name = f"{folder.parent.name}/{file.stem}"
            if i < len(files):
                yield name, file, turn if known else configs[file].controller
            elif known:
                yield f"{name}+{turn}", file, turn


def packed_log(name: str) -> Path:
    """Return the file of a golden log; `name` as from `rigs`."""
    return FOLDER / f"{name}.mcap.zst"


def figures_file(plant: str) -> Path:
    """Return the file of digests and figures of a plant's rigs."""
    return FOLDER / plant / "figures.yaml"


def short(file: Path, controller: str) -> Rig:
    """Return the rig of a golden log: motion and network from the start."""
    plain = load_rig(file, controller)
    settings = [f"duration_s={LOG_CYCLES / plain.config.rate_hz!r}", "schedule=[]"]
    for block in plain.nodes()["executive"].blocks:
        known = {"network_on": 1.0, "start_s": 0.0}
        settings += [f"{block.name}.{k}={v}" for k, v in known.items() if k in block.settings]
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


def bless(plant: str) -> int:
    """Write the golden files of a plant (`*`: of all) anew; print what changed."""
    found: dict[str, dict[str, Any]] = {}
    for name, file, controller in rigs(plant):
        folder, _, rig = name.partition("/")
        figures_file(folder).parent.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory() as temporary:
            log = Path(temporary) / "log.mcap"
            simulate(short(file, controller), log)
            packed = zstandard.ZstdCompressor(level=19).compress(log.read_bytes())
        new = found.setdefault(folder, {})[rig] = whole(file, controller)
        for line in changes(name, blessed(folder).get(rig, {}), new):
            print(line)
        packed_log(name).write_bytes(packed)
        print(f"{name}: {len(packed)} bytes", file=sys.stderr)
    for folder, figures in found.items():
        figures_file(folder).write_text(yaml.safe_dump(figures, sort_keys=False))
    return 0


def blessed(plant: str) -> Any:
    """Return the blessed figures of a plant's rigs; {} if there are none."""
    file = figures_file(plant)
    return yaml.safe_load(file.read_text()) if file.exists() else {}


if __name__ == "__main__":
    sys.exit(bless(*sys.argv[1:] or "*"))
