"""The nines of `pcpc jitter`: ranks of the binomial distribution, known delays, limits."""

import itertools
import math
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy  # loads its parts when they are used
from json_schemas import holds
from logcommand import Done, run_here
from processes import own_bus

from pcpc.drivers.errors import Exit
from pcpc.executive.errors import RigError
from pcpc.tools.machine.jitter import cli as jitter
from pcpc.tools.machine.jitter import nines
from pcpc.tools.machine.jitter.figures import JitterResult
from pcpc.tools.machine.jitter.limits import read_limits
from pcpc.tools.machine.jitter.loops import Setup
from pcpc.tools.machine.jitter.nines import BROKEN, HELD, OPEN, TOO_FEW, WAYS
from pcpc.tools.machine.jitter.probe import Probe, ProbedNode
from pcpc.tools.terminal.screen import json_text

PERCENTS = [Fraction(text) for text in ("0.001", "1", "50", "90", "99", "99.9", "99.999")]
PERIOD_US = 1000.0

# Ranks


@pytest.mark.parametrize("percent", PERCENTS)
@pytest.mark.parametrize("cycles", [1, 2, 36, 367, 368, 369, 3688, 10_000, 1_000_003])
def test_ranks_are_the_tightest_that_cover_the_quantile(cycles: int, percent: Fraction) -> None:
    """Of the times below the quantile there are B of Bin(n, q): P(B >= l), P(B < u) >= 97.5 %."""
    low, middle, high = nines.ranks(cycles, percent)
    below = scipy.stats.binom(cycles, float(percent / 100))
    assert middle == max(math.ceil(percent * cycles / 100), 1)
    if high is None:
        assert below.cdf(cycles - 1) < 0.975
    else:
        assert middle <= high <= cycles and below.cdf(high - 1) >= 0.975 > below.cdf(high - 2)
    if low is None:
        assert below.sf(0) < 0.975
    else:
        assert 1 <= low <= middle and below.sf(low - 1) >= 0.975 > below.sf(low)


@pytest.mark.parametrize("percent", PERCENTS)
def test_the_cycles_needed_are_the_first_with_an_upper_end(percent: Fraction) -> None:
    """Closed form: q^n <= 2.5 %."""
    cycles = nines.cycles_needed(percent)
    assert float(percent / 100) ** cycles <= 0.025 < float(percent / 100) ** (cycles - 1)
    assert nines.ranks(cycles, percent)[2] is not None
    assert cycles == 1 or nines.ranks(cycles - 1, percent)[2] is None


def test_a_day_at_10_khz_has_its_ranks() -> None:
    """So many that a normal distribution says the same."""
    cycles = 864_000_000
    low, middle, high = nines.ranks(cycles, Fraction("99.9"))
    spread = 1.959964 * math.sqrt(cycles * 0.999 * 0.001)
    assert low is not None and middle is not None and high is not None
    assert abs(high - middle - spread) < 3 and abs(middle - low - spread) < 3


def test_intervals_cover_the_true_quantile_as_often_as_they_say() -> None:
    rng, covered, rounds = np.random.default_rng(1), 0, 2000
    for _ in range(rounds):
        found = nines.point(np.sort(rng.exponential(size=1000)), Fraction(99))
        assert found.low is not None and found.high is not None
        covered += found.low <= -math.log(0.01) <= found.high
    assert covered >= scipy.stats.binom(rounds, 0.95).ppf(1e-6), f"{covered} of {rounds}"


def test_nines_go_as_far_as_their_interval_is_known() -> None:
    for cycles, last in ((367, None), (368, "99"), (3687, "99"), (3688, "99.9"), (36_887, "99.99")):
        found = [one.percent for one in nines.nines(np.arange(float(cycles)))]
        assert found[-1:] == ([] if last is None else [Fraction(last)]), cycles
        assert all(one < 100 for one in found)


# A log with known delays


def path(**changed: Any) -> dict[str, Any]:
    """Return times of six cycles of 1 ms: cycle k wakes 10 + k us late and sends 30 us later."""
    cycle = np.array([0, 1, 2, 3, 4, 5])
    given = {"cycle": cycle, "skip": {}, "refused": [], "held": [], "periods": 6} | changed
    cycle = cycle + np.array([given["skip"].get(i, 0) for i in cycle]).cumsum()
    late = 10.0 + np.arange(6)
    wakes = (1e6 * cycle + 1e3 * late).astype(np.int64)
    commands = wakes + 30_000
    syncs = np.concatenate([[-1_000_000], commands[:-1] + 5000])
    refused, held = (np.isin(np.arange(6), given[name]) for name in ("refused", "held"))
    return nines.whole_path(
        cycle, late, wakes, commands, syncs, refused, held, PERIOD_US, given["periods"]
    )


def test_the_three_ways_are_between_the_events_that_they_name() -> None:
    found = path()
    assert set(found) == set(WAYS)
    assert found["wake"] == pytest.approx([10, 11, 12, 13, 14, 15])
    assert found["command"] == pytest.approx([40, 41, 42, 43, 44, 45])
    assert found["response"] == pytest.approx(5 * [996]), "a period, 1 us later, 5 us after SYNC"


def test_skipped_periods_waited_for_the_next_cycle() -> None:
    found = path(skip={3: 2}, periods=8)
    assert found["wake"] == pytest.approx([10, 11, 12, 13, 14, 15, 1013, 2013])
    assert found["command"] == pytest.approx([40, 41, 42, 43, 44, 45, 1043, 2043])
    assert found["response"] == pytest.approx([996, 996, 2996, 996, 996])


def test_several_stalls_are_told_apart() -> None:
    found = path(skip={1: 1, 4: 3}, periods=10)
    assert sorted(found["wake"][6:]) == pytest.approx([1011, 1014, 2014, 3014])


def test_a_stall_in_receive_shows_in_the_command_not_in_the_wake_up() -> None:
    cycle = np.arange(4)
    late, wakes = np.full(4, 10.0), 1_000_000 * cycle + 10_000
    commands = wakes + 30_000
    commands[2] += 800_000
    none = np.zeros(4, bool)
    syncs = np.concatenate([[0], commands[:-1]])
    found = nines.whole_path(cycle, late, wakes, commands, syncs, none, none, PERIOD_US, 4)
    assert max(found["wake"]) == 10.0
    assert found["command"] == pytest.approx([40, 40, 840, 40])
    assert found["response"] == pytest.approx([1000, 1800, 200])


def test_periods_that_no_cycle_followed_and_refused_frames_never_came() -> None:
    assert path(periods=8)["command"][-2:].tolist() == [math.inf, math.inf]
    refused = path(refused=[2])
    assert np.flatnonzero(np.isinf(refused["command"])).tolist() == [2]
    assert np.flatnonzero(np.isinf(refused["response"])).tolist() == [1, 2], "of cycles 2 and 3"
    assert not np.isinf(refused["wake"]).any()


def test_a_command_from_a_held_sample_answers_the_sync_of_that_sample() -> None:
    found = path(held=[3, 4])
    assert found["response"] == pytest.approx([996, 996, 1997, 2998, 996])


# Limits


def of_times(times: dict[str, Any], limits: dict[tuple[str, Fraction], float]) -> JitterResult:
    setup, stages = Setup(1_000_000, 4000, 80), {"wake_late": np.zeros(4000)}
    stages |= {name: np.zeros(4000) for name in ("receive", "step", "send", "publish")}
    node = ProbedNode(stages, 0, 0, 1, 80, {way: np.asarray(times[way], float) for way in WAYS})
    return JitterResult(setup, 1, [Probe({"executive": node}, True, False, "")], limits=limits)


def concluded(result: JitterResult, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    options: Any = SimpleNamespace(histogram=None, json=None, plot=None)
    return jitter.conclude(result, options), capsys.readouterr().out


# 4000 times 1 ... 4000 us: 99 % is 3960, between x(3947) and x(3973).
LATE = {way: np.arange(1.0, 4001.0)[::-1] for way in WAYS}


@pytest.mark.parametrize(
    ("percent", "limit_us", "verdict"),
    [
        ("99", 3973.5, HELD), ("99", 3973.0, OPEN), ("99", 3947.5, OPEN), ("99", 3947.0, BROKEN),
        ("99.9", 4000.5, HELD), ("99.9", 4000.0, OPEN), ("99.99", 1e9, TOO_FEW),
        ("99.99", 3000.0, BROKEN), ("50", 2100.0, HELD),
    ],
)  # fmt: skip
def test_a_limit_holds_only_if_the_whole_interval_is_below_it(
    percent: str, limit_us: float, verdict: str, capsys: pytest.CaptureFixture[str]
) -> None:
    result = of_times(LATE, {("response", Fraction(percent)): limit_us})
    assert [one[-1] for one in result.verdicts] == [verdict], nines.ranks(4000, Fraction(percent))
    code, out = concluded(result, capsys)
    assert code == (Exit.OK if verdict == HELD else Exit.NOT_MET)
    assert f" {verdict}: " in out and max(map(len, out.splitlines())) <= 80, out
    assert (verdict == TOO_FEW) == ("needs 36,887, -D 38s" in out.partition("limits of")[2]), out


def test_one_limit_that_does_not_hold_is_enough(capsys: pytest.CaptureFixture[str]) -> None:
    limits = {("wake", Fraction(99)): 1e6, ("command", Fraction("99.9999")): 1e6}
    assert concluded(of_times(LATE, limits), capsys)[0] == Exit.NOT_MET


def test_a_command_that_never_came_holds_no_limit(capsys: pytest.CaptureFixture[str]) -> None:
    times = LATE | {"command": np.concatenate([np.ones(3999), [np.inf]])}
    result = of_times(times, {("command", Fraction("99.9")): 1e12})
    code, out = concluded(result, capsys)
    assert code == Exit.NOT_MET and "to never" in out, out
    (told,) = nines.limits(result.verdicts)
    assert told.high is None and "Infinity" not in json_text(told)


def test_an_interrupted_measurement_is_no_pass(capsys: pytest.CaptureFixture[str]) -> None:
    result = of_times(LATE, {("wake", Fraction(99)): 1e6})
    result.interrupted = True
    assert concluded(result, capsys)[0] == Exit.INTERRUPTED


def test_every_verdict_fits_a_terminal_of_80_columns() -> None:
    point = nines.Point(Fraction("99.999999"), 10**8, 1e5, 123456.7, 1234567.8)
    shapes = itertools.product(WAYS, (HELD, BROKEN, OPEN, TOO_FEW))
    found = [(way, point, 123456.7, verdict) for way, verdict in shapes]
    assert [x for x in nines.limit_lines(found, 1_000_000, 5) if len(x) > 80] == []


# The file


def written(folder: Path, text: str) -> Path:
    file = folder / "machine.yaml"
    file.write_text(text)
    return file


def test_limits_are_read_in_their_units_and_over_a_base(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text("wake: {99: 1ms, 99.9: 2ms}\n")
    file = written(tmp_path, "base: base.yaml\nwake: {99.9: null}\nresponse: {99.99: 0.25us}\n")
    assert read_limits(file) == {
        ("wake", Fraction(99)): 1000.0,
        ("response", Fraction("99.99")): 0.25,
    }


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "machine.yaml:1:1: expected a mapping"),
        ("wake: {}", "machine.yaml:1:1: no limit in it; expected like `wake: {99.9: 100us}`"),
        ("wake: null", "1:1: wake: expected a mapping, got null"),
        ("wake: [99]", "1:1: wake: expected a mapping, got [99]"),
        ("wakes: {99: 1us}", "1:1: wakes: unknown key; did you mean wake?"),
        ("wake: {99: 100}", "1:8: wake.99: 100: not a duration above 0; expected like 500us"),
        ("wake: {99: true}", "1:8: wake.99: True: not a duration above 0"),
        ("wake: {99: -1us}", "1:8: wake.99: -1us: not a duration above 0"),
        ("wake: {99: 0us}", "1:8: wake.99: 0us: not a duration above 0"),
        ("wake: {99: 5 us}", "1:8: wake.99: 5 us: not a duration above 0; expected like 500us"),
        ("wake: {99: .nan}", "1:12: .nan is not a value"),
        ("wake: {99: nan}", "1:8: wake.99: nan: not a duration above 0"),
        ("wake: {99: .inf}", "1:8: wake.99: inf: not a duration above 0"),
        ("\nwake: {100: 1us}", "2:8: wake.100: expected a percentage above 0 and below 100"),
        ("wake: {0.0: 1us}", "1:8: wake.0.0: expected a percentage"),
        ("wake: {-1: 1us}", "1:8: wake.-1: expected a percentage"),
        ("wake: {'99.9%': 1us}", "1:8: wake.99.9%: expected a percentage"),
        ("wake: {p99: 1us}", "1:8: wake.p99: expected a percentage"),
        ("wake: {99.99999999999999: 1us}", "at most 12 decimals"),
        ("wake: {99: 1us, 99: 2us}", "1:17: 99: given twice"),
        ("wake: {99.9: 1us, 99.90: 2us}", "1:19: wake.99.90: given twice, in other digits"),
    ],
)
def test_a_wrong_file_is_told_with_place_and_cure(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(RigError) as caught:
        read_limits(written(tmp_path, text))
    assert caught.value.code == Exit.WRONG_INPUT and told in str(caught.value), caught.value


def test_a_wrong_file_is_refused_before_anything_is_measured(tmp_path: Path) -> None:
    for name, told in (("nowhere.yaml", "no such file"), ("", "expected a file")):
        done: Done = run_here("jitter", "-q", "--limits", name and str(tmp_path / name))
        assert (done.code, done.out) == (2, "") and told in done.err, done


def test_limits_are_judged_on_a_measurement_of_the_product(tmp_path: Path) -> None:
    """Half of 400 cycles are never a minute late, and all take longer than 1 ns; 99.9 % are few."""
    text = "wake: {50: 1min}\ncommand: {50: 0.001us}\nresponse: {99.9: 1min}\n"
    file, data = written(tmp_path, text), tmp_path / "jitter.json"
    words = ("-D", "400ms", "--bus", own_bus(), "--limits", str(file), "--json", str(data))
    done = run_here("jitter", "-q", *words)
    assert done.code == 1 and f"limits of {file}\n" in done.out, done
    assert [x for x in done.out.splitlines() if len(x) > 80 and str(file) not in x] == [], done
    told = holds("jitter", data.read_text())
    assert [one["verdict"] for one in told["limits"]] == [HELD, BROKEN, TOO_FEW], told["limits"]
    assert told["nines_us"]["wake"]["cycles"] == 400
    assert set(told["nines_us"]["wake"]) == {"cycles", "99"}
    for way in ("command", "response"):
        assert told["nines_us"][way]["99"]["value"] > told["nines_us"]["wake"]["99"]["value"]
