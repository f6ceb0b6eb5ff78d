"""XCP on a real vcan0: pyXCP unchanged over SocketCAN, seen by candump, replayed."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import SLOW
from live import CHANNEL, PATIENCE_S, PCPC, RIG, ROOT, candump_into, until

from pcpc.executive.log import reader as logs
from pcpc.executive.nodes import live

pytestmark = pytest.mark.vcan

MASTER = ROOT / "tests" / "tools" / "live" / "xcp" / "xcp_master.py"
RECORDED, GAIN, ROWS = ["time.t_s", "controller.e_rad"], "controller.kv_Nms_rad", 50


def test_pyxcp_measures_and_calibrates_and_the_log_replays(tmp_path: Path) -> None:
    rig, folder, dump = tmp_path / "rig.yaml", tmp_path / "run", tmp_path / "heard.log"
    rig.write_text(f"base: {ROOT / RIG}\nxcp: {{frames: 400}}\n")
    settings = [f"--set={one}" for one in SLOW if "duration_s" not in one]
    words = ["--set=duration_s=600", "--bus", CHANNEL, "--quiet", "--no-figure", "-o", str(folder)]
    with candump_into(dump):
        run = subprocess.Popen(
            [PCPC, "run", str(rig), *settings, *words], stderr=subprocess.PIPE, text=True
        )
        try:
            assert run.stderr is not None
            said = run.stderr.readline()
            told = re.search(r"^executive: XCP over CAN, id 0x(\w+) to it, 0x(\w+) from it", said)
            assert told, (said, run.communicate())
            until(lambda: any(one.under_way for one in live.running().values()), "a cycle")
            where = ",".join(["socketcan", CHANNEL, "0", *told.groups()])
            master = [sys.executable, str(MASTER), where, "can", str(ROWS), json.dumps(RECORDED)]
            done = subprocess.run([*master, GAIN], capture_output=True, text=True, check=False)
            assert done.returncode == 0 and done.stdout, done.stderr[-2000:]
            run.send_signal(signal.SIGINT)
            run.communicate(timeout=PATIENCE_S)
        finally:
            run.kill()
    seen = json.loads(done.stdout.splitlines()[-1])
    assert seen["read"] == [91.0, 92.5, 93.25]
    node = logs.read(folder / "log.mcap").node["executive"]
    assert [one["value"] for one in node.tunings if one["name"] == GAIN] == seen["read"]
    values = np.array([[bytes.fromhex(one) for one in row[1]] for row in seen["rows"]], "V8")
    cycle = np.round(values[:, 0].copy().view(np.float64) * 25).astype(int)
    at = np.searchsorted(node.cycle, cycle)
    assert len(at) >= ROWS and np.array_equal(node.cycle[at], cycle)
    assert np.array_equal(at, at[0] + np.arange(len(at))), "a cycle is missing"
    for i, name in enumerate(RECORDED):
        assert values[:, i].copy().tobytes() == node.columns[name][at].tobytes(), name
    lines = [line.split()[2] for line in dump.read_text().splitlines()]
    assert f"{told[1]}#FF" in "".join(lines) and any(f"{told[2]}#FF" in one for one in lines)
    replayed = subprocess.run([PCPC, "replay", str(folder), "--quiet"], capture_output=True)
    assert replayed.returncode == 0, replayed.stderr
