"""`device=` of `pcpc.running` and of the plugin's `rig`: a command is the executive."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from processes import ROOT, own_bus, until

import pcpc

FOLDER = ROOT / "plants" / "probe" / "device"
DEVICE = (sys.executable, FOLDER / "probe.py", "{bus}")


def words_of_all() -> str:
    """Return the command lines of all processes."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            found.append(path.read_bytes().decode(errors="replace").replace("\0", " "))
        except OSError:
            continue
    return "\n".join(found)


def test_a_run_with_a_device_is_read_as_any(rig: Callable[..., Any]) -> None:
    """The fixture is the plugin's own."""
    settings = {"duration_s": 0.5}
    with rig(FOLDER / "rig.yaml", pacing="lockstep", set=settings, device=DEVICE) as live:
        run = live.wait(120.0)
    assert run.check().summary["device"]["frames"]["CMD"]["ok"] >= 500
    assert run["lag.position"][-1] == pytest.approx(0.8, abs=0.01)
    assert run.summary["cycles"] == 500
    assert all(node.identical for node in run.replay())


def test_the_device_ends_with_the_block(tmp_path: Path) -> None:
    bus, endless = own_bus(), {"duration_s": 100000}
    words = {"pacing": "lockstep", "bus": bus, "folder": tmp_path / "run"}
    rig = FOLDER / "rig.yaml"
    with pcpc.running(rig, set=endless, device=(*DEVICE, "0"), **words) as live:  # type: ignore[arg-type]
        assert live.wait_until("lag.position", above=0.75, within_s=120.0) > 0.75
        assert f"probe.py {bus} 0" in words_of_all()
        until(lambda: live.state == "RUN", "it runs")
    assert live.run.verdict == "interrupted"
    assert bus not in words_of_all()


def test_a_device_that_is_none_is_an_error_of_pcpc() -> None:
    device = ("./no-such-program",)
    with (
        pytest.raises(pcpc.Error, match="no such program"),
        pcpc.running(FOLDER / "rig.yaml", device=device),
    ):
        pass
