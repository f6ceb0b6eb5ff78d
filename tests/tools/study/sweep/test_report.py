"""The report of a campaign: its counts are the table's, its lines right, its page whole."""

import json
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from campaign import CONTROLLERS, REQUIREMENT, VARIED, spec, table
from html_page import Page
from matplotlib.figure import Figure

from pcpc.drivers.errors import UserError
from pcpc.tools.cli import parsed_options
from pcpc.tools.study import binomial
from pcpc.tools.study.sweep import figures, reasons
from pcpc.tools.study.sweep.report import report as report_of
from pcpc.tools.study.sweep.results import Counts, Results, comparisons
from pcpc.tools.study.sweep.summary import summary

pytestmark = pytest.mark.deep

ERROR = "metric:error_rms_mrad"
BARE = ["draw", "controller", "seed", "outcome", "ok", "why"]


def drawn(draws: int, **more: Any) -> Results:
    return Results(table(draws), spec(draws, **more))


def report(made: pa.Table, about: dict[str, Any], folder: Path) -> Path:
    return report_of(Results(made, about), folder)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return report(table(50), spec(50), tmp_path_factory.mktemp("report"))


def test_the_page_is_one_file_with_its_pictures_inside(written: Path) -> None:
    page = Page(written)
    assert len(page.sources) == page.tags.count("img") == 5  # failures, three metrics, a margin
    assert all(one.startswith("data:image/png;base64,") for one in page.sources)
    page.check_alone()
    pictures = sorted(path.name for path in written.parent.glob("*.png"))
    assert pictures == ["failures.png", "margin-peak-error---co.png", "metric-bias_mrad.png",
                        "metric-error_rms_mrad.png", "metric-settle_s.png"]  # fmt: skip


def test_names_are_text_and_no_markup(written: Path, tmp_path: Path) -> None:
    page = Page(written)
    assert "b" not in page.tags and "of" not in page.tags
    assert CONTROLLERS[1] in page.text and REQUIREMENT in page.text
    assert page.text.count("Arm <of> a test") == 2  # title and heading
    faulty = table(5, ("<i>x",)).select(BARE)
    page = Page(report(faulty, spec(5, variations=["<i>=1:2"], settings=["<i>=1"]), tmp_path))
    assert "i" not in page.tags and "--controller '<i>x' --set '<i>=1'" in page.text


def test_a_fault_is_a_failure_and_what_was_refused_counts_neither_way() -> None:
    results = drawn(50)
    rows = table(50).to_pylist()
    for controller in CONTROLLERS:
        own = [r for r in rows if r["controller"] == controller and r["outcome"] != "refused"]
        failed = sum(not r["ok"] for r in own)
        assert results.failures(controller) == (failed, len(own)) == (failed, 49)
        assert results.failures(controller, REQUIREMENT) == (failed, 49)
    unjudged = table(50).to_pylist()
    for row in unjudged[10:20]:
        row[f"held:{REQUIREMENT}"] = None  # of runs that ran
    part = Results(pa.Table.from_pylist(unjudged), spec(50))
    assert [part.failures(c, REQUIREMENT)[1] for c in CONTROLLERS] == [44, 44]
    assert [part.failures(c)[1] for c in CONTROLLERS] == [49, 49]


def test_what_a_run_told_until_its_fault_is_no_value_of_it() -> None:
    rows = table(50).to_pylist()
    (faulty,) = (row for row in rows if row["outcome"] == "fault")
    faulty |= {ERROR: 1e-3, f"margin:{REQUIREMENT}": 13.999}  # of the part before
    told, quiet = Results(pa.Table.from_pylist(rows), spec(50)), drawn(50)
    for name in (ERROR, f"margin:{REQUIREMENT}"):
        assert np.isnan(told.values(name, "pd")).tolist() == [i == 3 for i in range(49)]
        found, wanted = (one.pairs(name, *CONTROLLERS) for one in (told, quiet))
        assert np.array_equal(found, wanted), f"{name}: a fault made a pair"


def test_pairs_are_the_same_draw_in_any_order_of_rows(written: Path, tmp_path: Path) -> None:
    rows = table(50).to_pylist()
    shuffled = [rows[i] for i in np.random.default_rng(1).permutation(len(rows))]
    again = report(pa.Table.from_pylist(shuffled), spec(50), tmp_path)
    assert again.read_bytes() == written.read_bytes()


def between(values: list[float], share: float) -> float:
    """Return the quantile by hand: linear between the neighbours in the order of size."""
    values, at = sorted(values), share * (len(values) - 1)
    low = int(at)
    high = min(low + 1, len(values) - 1)
    return values[low] + (at - low) * (values[high] - values[low])


def test_quantiles_on_the_page_are_those_of_the_runs_that_told_a_value(written: Path) -> None:
    text = Page(written).text
    for controller in CONTROLLERS:
        rows = [r for r in table(50).to_pylist() if r["controller"] == controller]
        own = [r for r in rows if r["outcome"] != "refused"]
        for name in (ERROR, "metric:settle_s", "metric:bias_mrad"):
            told = [r[name] for r in own if not np.isnan(r[name])]
            points = [f"{between(told, share):.4g}" for share in (0.0, 0.5, 0.95, 1.0)]
            assert f"{controller}{len(told)} of {len(own)}{''.join(points)}" in text, (name, points)


@pytest.mark.parametrize("count", [1, 3, 21, 101])
def test_the_summary_tells_the_value_at_a_share_of_the_runs(count: int) -> None:
    ranks = np.random.default_rng(count).permutation(count).astype(float)
    drawn_rows = table(count, ("pd",)).to_pylist()
    given = {"outcome": "ran", "ok": True, "alone": False}
    rows = [
        {**row, **given, ERROR: rank} for row, rank in zip(drawn_rows, ranks.tolist(), strict=True)
    ]
    rows.append({**rows[0], "draw": count, ERROR: np.nan})  # one that told none
    names = [*BARE, ERROR, "alone"]
    made = pa.Table.from_pylist(rows).select(names)
    lines = summary(Results(made, spec(count, controllers=["pd"])), Path("folder")).splitlines()
    at = lines.index("error_rms_mrad (metric)")
    told = [
        (line.rsplit(None, 1)[0].strip(), float(line.split()[-1]))
        for line in lines[at + 1 : at + 4]
    ]
    last = count - 1
    wanted = [("5 %", round(0.05 * last)), ("median", last // 2), ("95 %", round(0.95 * last))]
    assert told == wanted


def test_ratios_are_counted_pair_by_pair(written: Path) -> None:
    error = {(r["draw"], r["controller"]): r[ERROR] for r in table(50).to_pylist()}
    pairs = [(error[d, CONTROLLERS[0]], error[d, CONTROLLERS[1]]) for d in range(50)]
    pairs = [(a, b) for a, b in pairs if np.isfinite(a) and np.isfinite(b)]
    counts = [sum(a > b for a, b in pairs), *(sum(a >= r * b for a, b in pairs) for r in (2.3, 5))]
    ((other, told, found, median),) = comparisons(drawn(50), ERROR, figures.RATIOS)
    assert (other, told, found) == (CONTROLLERS[1], len(pairs), counts) and told == 48
    assert median == pytest.approx(np.median([a / b for a, b in pairs]))
    row = f"{CONTROLLERS[1]}{counts[0]} of 48{counts[1]}{counts[2]}{median:.3g}"
    assert row in "".join(Page(written).text.split("\n"))


@pytest.mark.parametrize("xscale", ["linear", "log"])
@pytest.mark.parametrize("yscale", ["linear", "log"])
def test_lines_of_equal_ratio_part_the_pairs_on_any_mix_of_axes(xscale: str, yscale: str) -> None:
    """As the eye counts: on the screen, below the line as it is drawn."""
    x, y = drawn(500).pairs(ERROR, *CONTROLLERS)
    ax = Figure().subplots()
    ax.set(xscale=xscale, yscale=yscale, xlim=(x.min() * 0.9, x.max() * 1.1),
           ylim=(y.min() * 0.9, y.max() * 1.1))  # fmt: skip
    for times in figures.RATIOS:
        (line,) = ax.plot(*figures.ratio_line(x.min() * 0.9, x.max() * 1.1, times))
        on_screen = ax.transData.transform(line.get_xydata())
        points = ax.transData.transform(np.column_stack((x, y)))
        below = points[:, 1] < np.interp(points[:, 0], on_screen[:, 0], on_screen[:, 1])
        close = np.abs(x / y / times - 1.0) < 1e-3
        assert np.array_equal(below[~close], (x / y > times)[~close]), f"{times} times"


def test_a_curve_ends_at_the_share_of_runs_that_told_a_value() -> None:
    results = drawn(50)
    ax = Figure().subplots()
    figures.distribution(ax, results, "metric:settle_s")
    for line, controller in zip(ax.get_lines(), CONTROLLERS, strict=True):
        told = np.isfinite(results.values("metric:settle_s", controller))
        assert len(told) == 49 and told.sum() < 45
        y = line.get_ydata()
        assert y[0] == 0.0 and y[-1] == told.mean()
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["pd: 42 of 49", "network<b>: 43 of 49"]


def test_scales_follow_the_values() -> None:
    def scale(*values: float) -> str:
        return figures._scale(np.array(values))

    assert scale(1.0, 29.0) == "linear" and scale(1.0, 31.0) == "log"
    assert scale(0.0, 100.0) == scale(-1.0, 100.0) == scale() == "linear"


def test_labels_tell_the_unit_that_a_name_ends_in() -> None:
    assert figures.label_of("metric:error_rms_mrad") == "error_rms_mrad [mrad]"
    assert figures.label_of("metric:speed_m_s") == "speed_m_s [m/s]"
    assert figures.label_of("metric:count") == "count"
    assert figures.label_of("margin:a $5") == r"margin of a \$5"


def test_worst_cases_come_with_commands_that_give_their_bits(written: Path) -> None:
    results = drawn(50)
    worst = results.worst(f"margin:{REQUIREMENT}", 5)
    margins = [r[f"margin:{REQUIREMENT}"] for r in table(50).to_pylist()]
    lowest = sorted(m for m in margins if np.isfinite(m))[:5]
    assert results.column(f"margin:{REQUIREMENT}")[worst].tolist() == lowest
    commands = Page(written).commands
    assert len(commands) == 6  # five, and the fault
    for command, row in zip(commands[1:], worst, strict=True):
        options = parsed_options(shlex.split(command)[1:])
        given = dict(one.split("=") for one in options.set)
        assert options.controller == results.column("controller")[row]
        assert int(given["seed"]) == results.column("seed")[row]
        for name in (one.split("=")[0] for one in VARIED):
            assert float(given[name]) == results.column(f"vary:{name}")[row]
        assert given["plant.gap_rad"] == "0.003" and given["plant.motor"] in ("1", "2")


def test_the_statement_stands_in_words(tmp_path: Path, written: Path) -> None:
    assert "pd: p_fail < 0.7106 at 95 %: 29 failures in 49 runs" in Page(written).text
    until = f"p_fail({REQUIREMENT}) < 0.3 at 95% against 0.1"
    text = Page(report(table(50), spec(50, until=until), tmp_path)).text
    assert f"pd: p_fail({REQUIREMENT}) < 0.3 is refuted at 95 %: 29 failures in 49 runs" in text
    assert "whenever you look" in text and "whenever you look" not in Page(written).text


@pytest.mark.parametrize("sampling", ["grid", "lhs", "sobol"])
def test_draws_that_are_not_independent_are_told(sampling: str, tmp_path: Path) -> None:
    few = table(30).select(BARE)
    text = Page(report(few, spec(30, sampling=sampling), tmp_path)).text
    assert ("no random sample" in text) is (sampling == "grid")
    assert ("not independent" in text) is (sampling != "grid")


def test_what_varied_decides_as_it_was_made() -> None:
    shares = figures.shares_of(drawn(400), ERROR)
    assert list(shares) == list(CONTROLLERS)
    assert [s.name for s in shares["pd"]] == [VARIED[i].split("=")[0] for i in (0, 2, 1)]


def test_one_controller_few_runs_and_nothing_judged(tmp_path: Path) -> None:
    few = table(3, ("pd",)).drop_columns([f"margin:{REQUIREMENT}", f"held:{REQUIREMENT}"])
    text = Page(report(few, spec(3), tmp_path)).text
    assert "over the other" not in text and "largest error_rms_mrad" in text
    bare = few.select(BARE)
    text = Page(report(bare, spec(3, variations=[]), tmp_path)).text
    assert "Failures" in text and "Metrics" not in text


def test_columns_that_are_all_empty_or_all_refused(tmp_path: Path) -> None:
    rows = table(12).to_pylist()
    for row in rows:
        row.update({ERROR: np.nan, "outcome": "refused", "ok": False, "why": "gap_rad: 3 > 1"})
    text = Page(report(pa.Table.from_pylist(rows), spec(12), tmp_path)).text
    assert "24 runs were refused" in text
    assert "nothing is known of p_fail: 0 failures in 0 runs" in text


def test_where_all_runs_fail_the_bound_is_from_below(tmp_path: Path) -> None:
    rows = table(200, ("pd",)).to_pylist()
    for row in rows:
        row.update({"outcome": "ran", "ok": False, "why": "it fell"})
    text = Page(report(pa.Table.from_pylist(rows), spec(200), tmp_path)).text
    assert "p_fail > 0.9851 at 95 %: 200 failures in 200 runs" in text and "p_fail < 1" not in text


def test_reasons_that_differ_in_numbers_alone_are_one(tmp_path: Path) -> None:
    rows = table(200, ("pd",)).to_pylist()
    for i, row in enumerate(rows):
        said = f"axis 2: violated first at {i / 100} s: rate = {7070 + i % 3} N/s, limit 5,000 N/s"
        row.update({"outcome": "ran", "ok": False, "why": said if i % 50 else f"fell at {i} s"})
    text = Page(report(pa.Table.from_pylist(rows), spec(200), tmp_path)).text
    assert "axis 2: violated first at 0.01 to 1.99 s: rate = 7070 to 7072 N/s, limit 5,000" in text
    assert "fell at 0 to 150 s" in text and "other reasons" not in text


def test_reasons_of_two_requirements_stay_two() -> None:
    texts = ["error at 10 Hz: 3 mm", "error at 20 Hz: 4 mm", "error at 10 Hz: -1e-3 mm", "inf m/s"]
    names = ["error at 10 Hz", "error at 20 Hz"]
    assert reasons.count_reasons(texts, names) == [
        ("error at 10 Hz: -1e-3 to 3 mm", 2),
        ("error at 20 Hz: 4 mm", 1),
        ("inf m/s", 1),
    ]
    assert reasons.count_reasons(texts[:2]) == [("error at 10 to 20 Hz: 3 to 4 mm", 2)]
    assert reasons.count_reasons([]) == []


def test_a_rate_of_1_is_drawn_whole_and_pairs_on_axes_of_one_kind() -> None:
    rows = [("any", "pd", Counts(50, 50)), ("any", "pd", Counts(0, 50))]
    page = figures.failures_page(drawn(50), rows)
    dots = [line for line in page.axes[0].lines if line.get_marker() in ("o", "|")]
    assert len(dots) == 2 and not any(line.get_clip_on() for line in dots)
    for x, y in (([1.0, 100.0], [1.0, 2.0]), ([1.0, 2.0], [1.0, 100.0]), ([1.0, 2.0], [1.0, 3.0])):
        ax = Figure().subplots()
        pair = np.array(x), np.array(y)
        figures.scatter(ax, drawn(50), ERROR, [pair], positive=True)
        assert ax.get_xscale() == ax.get_yscale() == ("log" if 100.0 in x + y else "linear")


def test_of_runs_that_were_not_judged_no_interval_is_drawn() -> None:
    rows = [
        ("any", "pd", Counts(0, 0, 50)),
        ("any", "pd", Counts(0, 40, 10)),
        ("a", "pd", Counts()),
    ]
    ax = figures.failures_page(drawn(50), rows).axes[0]
    assert [text.get_text() for text in ax.texts] == [
        "not judged",
        "0 of 40, 10 not judged",
        "not judged",
    ]
    ((low, high), _) = (line.get_xdata() for line in ax.lines)
    assert low <= 0.1 and high == binomial.clopper_pearson(10, 50, 0.95)[1]


def unjudged_table(controllers: tuple[str, ...] = ("pd",)) -> list[dict[str, object]]:
    rows = [
        {name: value for name, value in row.items() if not name.startswith("metric:")}
        | {f"margin:{REQUIREMENT}": np.nan}
        for row in table(50, controllers).to_pylist()
    ]
    for row in rows:
        row.update({"outcome": "ran", "ok": True, "why": "", f"held:{REQUIREMENT}": True})
    return rows


def test_runs_that_were_not_judged_are_no_good_ones(tmp_path: Path) -> None:
    """A requirement of which nobody knows stays on the page; another controller's does not."""
    rows = unjudged_table(CONTROLLERS)
    for row in rows:
        if row["controller"] == "pd":
            row.update(
                {f"held:{REQUIREMENT}": None, "ok": None, "why": "a was not judged: no step"}
            )
        else:
            row[f"held:{REQUIREMENT}"] = None  # not its own: all of it were judged
    text = Page(report(pa.Table.from_pylist(rows), spec(50), tmp_path)).text
    assert "pd: nothing is known of p_fail: 0 failures in 0 runs; 50 not judged" in text
    assert f"{REQUIREMENT}pd0050not judged" in text and f"{REQUIREMENT}{CONTROLLERS[1]}" not in text
    assert "pda was not judged: no step50" in text and "The intervals allow for both" in text
    rows = unjudged_table()
    for row in rows[:20]:
        row.update({"ok": None, "why": "a was not judged: no step"})
    text = Page(report(pa.Table.from_pylist(rows), spec(50), tmp_path)).text
    bound = binomial.upper_bound(20, 50, 0.95)
    assert f"p_fail < {bound:.4g} at 95 %: 0 failures in 30 runs; 20 not judged, counted as" in text
    low, high = (binomial.clopper_pearson(k, 50, 0.95)[i] for i, k in ((0, 0), (1, 20)))
    assert f"any failurepd030200{low:.3g} to {high:.3g}" in text
    for row in rows[20:]:
        row.update({"ok": False, "why": "it fell"})
    text = Page(report(pa.Table.from_pylist(rows), spec(50), tmp_path)).text
    bound = binomial.lower_bound(30, 50, 0.95)
    assert (
        f"p_fail > {bound:.4g} at 95 %: 30 failures in 30 runs; 20 not judged, counted as no"
        in text
    )


def test_no_runs_and_a_place_that_cannot_be_written_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no run to report on; start"):
        report(table(2).slice(0, 0), spec(0), tmp_path)
    with pytest.raises(UserError, match=r"cannot be written: .*; choose another place"):
        report(table(2), spec(2), tmp_path / "missing")


def test_the_spec_travels_in_the_table() -> None:
    about = json.loads(table(2).schema.metadata[b"pcpc"])
    assert about == spec(2) and re.fullmatch(r"[\w.]+", about["rig"])
