"""Several runs on one machine at once, as users start them: no bus named, and on one bus."""

from contextlib import ExitStack
from pathlib import Path

from processes import RIGS, Running

HULL = str(RIGS / "hull.yaml")


def test_runs_of_one_rig_at_once_have_buses_of_their_own_and_two_terminals_meet(
    tmp_path: Path,
) -> None:
    usual = ("--pacing", "lockstep", "--no-figure", "--json", "--set", "duration_s=0.3")
    with ExitStack() as stack:
        plant, control, whole = (
            stack.enter_context(Running(*words, *usual))
            for words in (
                ("plant", HULL),
                ("exec", HULL, "-o", str(tmp_path / "exec")),
                ("run", HULL, "-o", str(tmp_path / "run")),
            )
        )
        done = [one.done() for one in (plant, control, whole)]
    assert [one.code for one in done] == [0, 0, 0], "\n".join(map(str, done))
    first, second = (one.summary for one in done[1:])
    assert first["bus"] != second["bus"], str(done[1])
    assert f"hull on {first['bus']}, pacing lockstep" in done[0].err, str(done[0])
    assert first["metrics"] == second["metrics"], f"{first['metrics']} {second['metrics']}"
