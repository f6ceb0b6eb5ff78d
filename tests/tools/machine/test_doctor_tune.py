"""`pcpc doctor --tune`: what is set is said to be set, worth is a ratio, rtla is read."""

from pathlib import Path

import pytest

from pcpc.tools.machine.doctor import rtla, tune, worth

SET = "quiet isolcpus=domain,managed_irq,2-3 nohz_full=2,3 rcu_nocbs=1-3"
RTLA = """                                     Timer Latency
  CPU COUNT      |      cur       min       avg       max |      cur       min       avg       max
    7 #100       |       28         0         1        28 |       41         3        11        41
  rtla timerlat hit stop tracing
  ## CPU 7 hit stop tracing, analyzing it ##
  IRQ handler delay:                                        27.49 us (65.52 %)
  IRQ latency:                                              28.13 us
  Timerlat IRQ duration:                                     9.59 us (22.85 %)
  Blocking thread:                                           3.79 us (9.03 %)
                         objtool:49256                       3.79 us
    Blocking thread stacktrace
                -> timerlat_irq
  ------------------------------------------------------------------------
    Thread latency:                                          41.96 us (100%)
  ## CPU 3 hit stop tracing, analyzing it ##
    Blocking thread:       1223.16 us (99.00 %)
                     insync:4048         1223.16 us
    IRQ interference          4.93 us (0.40 %)
                local_timer:236        4.93 us
  ------------------------------------------------------------------------
     Thread latency:       1235.47 us (100%)
"""


@pytest.mark.parametrize(
    ("line", "count", "cpus", "state", "missing"),
    [
        (SET, 4, {2, 3}, "ok", ()),
        ("quiet", 4, {2, 3}, "warn", ("isolcpus=2,3", "nohz_full=2,3", "rcu_nocbs=2,3")),
        ("isolcpus=1 nohz_full=1", 4, {1}, "warn", ("rcu_nocbs=1",)),
        ("isolcpus=2-3 nohz_full=3 rcu_nocbs=2-3", 4, {2, 3}, "warn", ("nohz_full=2,3",)),
        ("isolcpus=nonsense", 8, {6, 7}, "warn", ("isolcpus=6,7",)),
        ("quiet", 2, set(), "ok", ()),
    ],
)
def test_the_kernel_line_lacks_what_does_not_cover_the_cpus(
    line: str, count: int, cpus: set[int], state: str, missing: tuple[str, ...]
) -> None:
    assert tune.rig_cpus(line, count) == cpus
    row = tune.kernel_line(line, cpus, count)
    assert row.state == state and all(option in row.cure for option in missing), row
    assert bool(row.cure) == bool(missing) and row.cure.count("=2,3") <= len(missing), row


def test_interrupts_on_the_cpus_of_a_rig_are_counted(tmp_path: Path) -> None:
    for number, cpus in enumerate(("0-3", "0,1", "3")):
        (tmp_path / str(number)).mkdir()
        (tmp_path / str(number) / "smp_affinity_list").write_text(f"{cpus}\n")
    row = tune.interrupts(tmp_path, {2, 3}, 4)
    assert row.state == "warn" and row.found.startswith("2 of 3 ") and "echo 0,1 |" in row.cure
    assert tune.interrupts(tmp_path, {5}, 6).state == "ok"


def test_worth_is_the_ratio_of_blocks_and_unclear_if_it_may_be_one() -> None:
    def block(without: str, late_us: int, refused: tuple[str, ...] = ()) -> dict[str, object]:
        return {"without": without, "refused": refused, "late_ns": [1000 * late_us] * 100}

    found = [block("", 10), block(worth.FIFO, 30), block("", 10), block(worth.FIFO, 50)]
    told = worth.worth(found, worth.FIFO)
    assert "p50 30 -> 10 us" in told and told.endswith("p99 4 times (3 to 5)"), told
    found += [block("", 20), block(worth.FIFO, 10)]
    assert worth.worth(found, worth.FIFO).endswith("no clear difference now")
    assert worth.worth(found, worth.AWAKE).startswith("not measured")
    refused = [block("", 10, (worth.FIFO,)), block(worth.FIFO, 10)]
    assert worth.worth(refused, worth.FIFO) == "not measured: refused here"


def test_rtla_names_the_greatest_share_and_who_it_was() -> None:
    assert list(rtla.culprits(RTLA)) == [
        "CPU 7: 41.96 us, 66 % of it IRQ handler delay: objtool:49256",
        "CPU 3: 1235.47 us, 99 % of it Blocking thread: insync:4048",
    ]
    for text in ("", "## CPU 1 hit stop tracing, analyzing it ##\n", "Thread latency: x"):
        assert list(rtla.culprits(text)) == []


def test_without_rtla_its_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "install -y rtla" in tune.culprit().cure
