"""A log's size an hour: what docs/howto/run.md says, to 10 %."""

import re
from pathlib import Path

from processes import RIGS, ROOT

from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig


def test_the_page_on_running_states_the_size_of_a_log_an_hour(tmp_path: Path) -> None:
    sizes = {}
    for seconds in (1, 4):
        log = tmp_path / f"{seconds}.mcap"
        simulate(load_rig(RIGS / "hull.yaml", settings=[f"duration_s={seconds}.0"]), log)
        sizes[seconds] = log.stat().st_size
    measured = 3600 * (sizes[4] - sizes[1]) / 3 / 1e9
    text = " ".join((ROOT / "docs/howto/run.md").read_text().split())
    stated = re.search(r"A log takes about ([0-9.]+) GB an hour", text)
    assert stated is not None
    assert abs(measured / float(stated[1]) - 1.0) < 0.1, f"{measured:.2f} GB/h, page {stated[1]}"
