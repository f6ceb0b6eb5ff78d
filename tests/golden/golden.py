"""Golden runs: a short log of every rig, and the bits and figures of its whole run.

    <plant>/<rig>.mcap.zst  the first LOG_CYCLES in virtual time, motion from the start: replayed
    <plant>/figures.yaml    of whole runs: sha256 over all state records of both nodes, and metrics

`make bless` writes both anew and prints old and new figures, for the commit message that says why;
`make bless PLANT=atb1000` those of one plant. The rigs' own two-sided limits (`expect`, with their
reasons) bound what may be blessed. Each run names its controller; a second one of a rig is called
<rig>+<controller>. `make bless PLANT=atb1000/hull=pid` adds one and touches no other; a rig, or a
controller that some rig judges, without a run of its own fails a test that says so.
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
from pcpc.tools.after.verdict.judge import Judge

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
LOG_CYCLES = 30
LOG_BYTES = 50_000


def rigs(plant: str = "*") -> Iterator[tuple[str, Path, str]]:
    """Yield (plant/rig, file, controller) of every golden run, as figures.yaml names them."""
    for folder in sorted((ROOT / "plants").glob(f"{plant}/rigs")):
        for rig, entry in blessed(folder.parent.name).items():
            file = folder / f"{rig.partition('+')[0]}.yaml"
            yield f"{folder.parent.name}/{rig}", file, entry["controller"]


def missing(plant: str = "*") -> list[str]:
    """Return PLANT/RIG=CONTROLLER of each rig, and of each judged controller, without a run."""
    found = []
    for folder in sorted((ROOT / "plants").glob(f"{plant}/rigs")):
        name = folder.parent.name
        known = [(rig.partition("+")[0], e["controller"]) for rig, e in blessed(name).items()]
        for file in sorted(folder.glob("*.yaml")):
            config = load_rig(file, resolve=False).config
            if file.stem not in [rig for rig, _ in known]:
                known.append((file.stem, config.controller))
                found.append(f"{name}/{file.stem}={config.controller}")
            for controller in config.expect:
                if controller not in [law for _, law in known]:
                    known.append((file.stem, controller))
                    found.append(f"{name}/{file.stem}={controller}")
    return found


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
    figures = {key: float(f"{value:.6g}") for key, value in Judge.of(rig).metrics(log).items()}
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


def bless(what: str) -> int:
    """Write golden files anew and print what changed: of a plant, `*` all, or PLANT/RIG=LAW."""
    plant, _, pair = what.partition("/")
    runs = list(rigs(plant))
    if pair:
        rig, _, law = pair.partition("=")
        taken = {name for name, *_ in runs}
        name = f"{plant}/{rig}+{law}" if f"{plant}/{rig}" in taken else f"{plant}/{rig}"
        runs = [(name, ROOT / "plants" / plant / "rigs" / f"{rig}.yaml", law)]
    for name, file, controller in runs:
        folder, _, rig = name.partition("/")
        figures = blessed(folder)
        with tempfile.TemporaryDirectory() as temporary:
            log = Path(temporary) / "log.mcap"
            simulate(short(file, controller), log)
            packed = zstandard.ZstdCompressor(level=19).compress(log.read_bytes())
        new = whole(file, controller)
        for line in changes(name, figures.get(rig, {}), new):
            print(line)
        figures_file(folder).parent.mkdir(exist_ok=True)
        packed_log(name).write_bytes(packed)
        text = yaml.safe_dump(figures | {rig: new}, sort_keys=False)
        figures_file(folder).write_text(text)
        print(f"{name}: {len(packed)} bytes", file=sys.stderr)
    return 0


def blessed(plant: str) -> Any:
    """Return the blessed figures of a plant's rigs; {} if there are none."""
    file = figures_file(plant)
    return yaml.safe_load(file.read_text()) if file.exists() else {}


if __name__ == "__main__":
    sys.exit(bless(*sys.argv[1:] or "*"))
