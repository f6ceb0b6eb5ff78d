"""Today's code against the golden runs: every bit of short logs and of whole runs."""

from pathlib import Path

import golden
import pytest
import zstandard
from golden import LOG_BYTES, blessed, changes, missing, packed_log, rigs, whole
from replays import replayed

RUNS = {name: (file, controller) for name, file, controller in rigs()}
BLESS = "if this is meant, `make bless` and say why in the commit"


@pytest.mark.parametrize("name", RUNS)
def test_a_golden_log_is_recomputed_bit_for_bit(name: str, tmp_path: Path) -> None:
    packed = packed_log(name).read_bytes()
    assert len(packed) < LOG_BYTES, f"{name}: {len(packed)} bytes"
    log = tmp_path / "log.mcap"
    log.write_bytes(zstandard.ZstdDecompressor().decompress(packed, max_output_size=1 << 24))
    for verdict in replayed(log):
        assert verdict.cycles >= 30, verdict.cycles
        assert verdict.identical, f"{name}: {verdict.first()} {verdict.incomplete}; {BLESS}"


@pytest.mark.quick
@pytest.mark.parametrize("name", RUNS)
def test_a_whole_run_has_the_blessed_bits(name: str) -> None:
    plant, _, rig = name.partition("/")
    found = changes(name, blessed(plant)[rig], whole(*RUNS[name]))
    assert not found, "\n".join((*found, BLESS))


def test_every_rig_and_every_judged_controller_has_a_golden_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    without = missing()
    assert not without, f"make bless PLANT={' PLANT='.join(without)}"
    monkeypatch.setattr(golden, "blessed", lambda plant: {"engage": {"controller": "pd_nn_fast"}})
    without = missing("atb1000")
    assert {"atb1000/hull=pd", "atb1000/bang10=pid"} <= set(without), without
    assert not any("engage" in pair for pair in without), without
