"""`pcpc swarm` draws around a rig with an FMU, whose state is in no log."""

from pathlib import Path

from reference_fmus import fmu, rig

from pcpc.tools.study.swarm import cli, draws


def test_seeds_around_an_fmu_keep_every_promise(tmp_path: Path) -> None:
    path = rig(tmp_path, fmu("VanDerPol", 2), "fmu.x0", "", 1000.0, 2.0)
    rows = [cli.checked(draws.world_of(seed, str(path))) for seed in (1, 2, 3)]
    assert [row.found for row in rows] == [{}] * 3
    assert all(row.cycles > 20 for row in rows) and sum(row.cycles for row in rows) > 1000
