"""Several runs on one machine at once, as users start them: no bus named, and on one bus."""

import os
from contextlib import ExitStack
from pathlib import Path

from processes import RIGS, Running, own_bus

HULL = str(RIGS / "hull.yaml")


def test_runs_of_one_rig_at_once_have_buses_of_their_own_and_two_terminals_meet(
    tmp_path: Path,
) -> None:
    usual = ("--pacing", "lockstep", "--no-figure", "--set", "duration_s=0.3")
    with ExitStack() as stack:
        plant, control, whole = (
            stack.enter_context(Running(*words, *usual))
            for words in (
                ("run", "--only=plant", HULL),
                ("run", "--only=executive", HULL, "--json", "-o", str(tmp_path / "exec")),
                ("run", HULL, "--json", "-o", str(tmp_path / "run")),
            )
        )
        done = [one.done() for one in (plant, control, whole)]
    assert all(one.ran for one in done), "\n".join(map(str, done))
    first, second = (one.summary for one in done[1:])
    assert first["bus"] != second["bus"], str(done[1])
    assert f"hull on {first['bus']}, pacing lockstep" in done[0].err, str(done[0])
    assert first["metrics"] == second["metrics"], f"{first['metrics']} {second['metrics']}"


def test_the_recorder_which_outlives_its_host_holds_nothing_of_it(
    tmp_path: Path,
) -> None:
    bus = own_bus()
    words = ("run", str(RIGS / "slew10.yaml"), "--bus", bus, "--set", "duration_s=3600")
    with Running(*words, "--pacing", "lockstep", "--no-figure", cwd=tmp_path) as run:
        run.in_the_middle("slew10", bus)
        pids = (run.process.pid, run.pid("recorder"))
        host, recorder = (set(map(os.readlink, Path(f"/proc/{pid}/fd").iterdir())) for pid in pids)
    sockets = {name for name in host if name.startswith("socket:")}
    assert len(sockets) >= 2, f"the bus's claim, the line to a node: {host}"
    assert not sockets & recorder, recorder
