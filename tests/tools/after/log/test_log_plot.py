"""`pcpc log plot`: what is drawn, what is refused; spikes stay."""

from pathlib import Path

import numpy as np
import pytest
from logcommand import barrel_log, run
from matplotlib.image import imread
from spring import spring_run

from pcpc.executive.log import reader as logs
from pcpc.tools.after.log import drawing, plot, series


def source(path: Path) -> drawing.DrawnLog:
    log = logs.read(path)
    return drawing.DrawnLog(path.stem, log, series.all_series(log), series.start_ns(log))


def test_a_spike_of_one_cycle_in_an_hour_stays_visible() -> None:
    t = np.arange(3_600_000) / 1000
    y = np.sin(t)
    y[1_234_567], y[2_345_678] = 50.0, -40.0
    thin_t, thin = drawing.decimated(t, y)
    assert len(thin) <= 4 * 1100, f"{len(thin)} points"
    assert thin.max() == 50.0 and thin.min() == -40.0, f"{thin.min()} to {thin.max()}"
    assert thin_t[thin.argmax()] == t[1_234_567] and (np.diff(thin_t) > 0).all()


def test_what_is_not_a_number_hides_no_spike_and_no_gap() -> None:
    t = np.arange(100_000.0)
    y = np.where((t > 40_000) & (t < 60_000), np.nan, 0.0)
    y[10_001], y[10_002] = np.nan, 7.0
    thin_t, thin = drawing.decimated(t, y)
    assert np.nanmax(thin) == 7.0, f"{np.nanmax(thin)}"
    gap = thin[(thin_t > 41_000) & (thin_t < 59_000)]
    assert len(gap) and np.isnan(gap).all(), f"{np.isfinite(gap).sum()} values in the gap"


def test_uneven_stamps_are_binned_by_time() -> None:
    t = np.concatenate((np.arange(50_000) * 1e-6, [10.0, 20.0]))
    thin_t, _ = drawing.decimated(t, np.zeros(len(t)))
    assert thin_t[-2:].tolist() == [10.0, 20.0], thin_t[-4:]


def test_no_variables_give_the_figure_of_the_plant(tmp_path: Path) -> None:
    done = run("plot", barrel_log(), "-o", tmp_path / "f.png")
    assert done.code == 0 and "the figure of atb1000, rig slew10" in done.out, done
    assert imread(tmp_path / "f.png").shape[:2] == (1500, 1200)


@pytest.mark.parametrize("rig", ["slew10", "../../../../../../..{folder}/evil"])
def test_no_python_that_only_the_log_names_is_run(
    rig: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    evil, mark = tmp_path / "evil.py", tmp_path / "ran"
    evil.write_text(f"open({str(mark)!r}, 'w')\ndef metrics(*a): return {{}}\n")
    log = logs.read(barrel_log())
    own = "pcpc.plants.atb1000.evaluation"
    text = log.attachments["rig-resolved.yaml"].replace(own, str(evil))
    assert str(evil) in text
    (tmp_path / "evil.yaml").write_text(text)
    log.attachments["rig-resolved.yaml"] = text
    for facts in log.metadata.values():
        facts["rig"] = rig.format(folder=tmp_path)
    monkeypatch.setattr(logs, "read", lambda path: log)
    run("plot", barrel_log(), "-o", tmp_path / "f.png")
    assert not mark.exists(), "the log's evaluation was imported"


def test_variables_of_one_log_share_an_axis_by_unit(tmp_path: Path) -> None:
    words = ["controller.e_rad", "controller.tau_Nm", "barrel.theta_rad", "controller.r_*"]
    found = plot.groups_of([source(barrel_log())], words)
    assert found == [
        ["controller.e_rad", "plant.barrel.theta_rad"],
        ["controller.tau_Nm"],
        ["controller.r_rad_s"],
    ]
    done = run("plot", barrel_log(), *words, "-o", tmp_path / "f.png")
    assert done.code == 0 and imread(tmp_path / "f.png").std() > 0.05, done


def test_several_logs_have_an_axis_for_each_variable_and_a_line_for_each_log() -> None:
    sources = [source(barrel_log()), source(barrel_log("pd"))]
    names = plot.groups_of(sources, ["controller.e_rad", "barrel.theta_rad", "controller.norm_z"])
    assert [len(group) for group in names] == [1, 1, 1], names
    axes = drawing.page_of(sources, names, (-np.inf, np.inf)).axes
    labels = [[str(line.get_label()) for line in ax.lines] for ax in axes]
    both = ["nn_backstepping", "pd"]
    assert labels == [both, both, ["nn_backstepping"]], labels
    colours = {
        str(line.get_color()) for ax in axes for line in ax.lines if line.get_label() == "pd"
    }
    assert len(colours) == 1, colours


def test_a_log_that_lacks_a_variable_is_told(tmp_path: Path) -> None:
    words = [barrel_log(), barrel_log("pd"), "controller.norm_z"]
    done = run("plot", *words, "-o", tmp_path / "f.png")
    assert done.code == 0 and "pd.mcap: no controller.norm_z" in done.err, done


def test_lines_are_the_recorded_values_at_their_times() -> None:
    one = source(barrel_log())
    page = drawing.page_of([one], [["controller.e_rad"]], (0.1, 0.2))
    (line,) = page.axes[0].lines
    node = one.log.node["executive"]
    inside = (node.cycle >= 100) & (node.cycle < 200)
    assert np.array_equal(line.get_ydata(), node.columns["controller.e_rad"][inside])
    late_s = np.abs(np.asarray(line.get_xdata()) - 1e-3 * node.cycle[inside]).max()
    assert late_s < 1e-9, f"{late_s} s off"


def test_a_run_folder_stands_for_its_log_and_names_it(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("before", "after")]
    for folder in folders:
        folder.mkdir()
        (folder / "log.mcap").symlink_to(barrel_log())
    paths, patterns = plot.logs_and_patterns([*map(str, folders), "controller.e_rad"])
    assert plot.names_of(paths) == ["before", "after"] and patterns == ["controller.e_rad"]


def test_a_log_carries_its_evaluation_and_is_drawn_elsewhere_when_trusted(tmp_path: Path) -> None:
    log = spring_run(tmp_path / "spring")
    here = run("plot", log, "-o", tmp_path / "here.png")
    assert here.code == 0 and "the figure of spring" in here.out, here
    log = log.rename(tmp_path / "log.mcap")
    rig = (tmp_path / "spring").rename(tmp_path / "moved") / "spring.yaml"
    foreign = run("plot", log, "-o", tmp_path / "f.png")
    assert foreign.code == 0 and "controller.force_N" in foreign.out, foreign
    assert "evaluation.py (sha256 " in foreign.err and "--trust" in foreign.err, foreign
    beside = run("plot", log, "--rig", rig, "-o", tmp_path / "b.png")
    assert beside.code == 0 and "the figure of" in beside.out, beside
    (tmp_path / "moved" / "words.py").write_text("MASS = 'changed'\n")
    changed = run("plot", log, "--rig", rig, "-o", tmp_path / "c.png")
    assert "words.py (sha256 " in changed.err and "the figure of" not in changed.out, changed
    trusted = run("plot", log, "--trust", "-o", tmp_path / "t.png")
    assert trusted.code == 0 and "the figure of" in trusted.out, trusted
    assert imread(tmp_path / "t.png").shape[:2] == (1500, 1200)


def test_a_mistake_in_an_evaluation_is_one_line_with_its_place(tmp_path: Path) -> None:
    log = spring_run(tmp_path / "spring")
    file = tmp_path / "spring" / "evaluation.py"
    file.write_text(file.read_text().replace("plant:spring.position_m", "plnt:spring.position_m"))
    done = run("plot", log, "--law", file, "-o", tmp_path / "f.png")
    assert done.code == 2 and done.err.count("\n") == 1, done
    assert "evaluation.py:7: no signal plnt:spring.position_m" in done.err, done
    assert not (tmp_path / "f.png").exists()


def test_an_evaluation_of_the_project_is_the_installed_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = logs.read(barrel_log())
    name = "evaluation:\n  file: pcpc.plants.atb1000.evaluation\n"
    assert name in log.attachments["rig-resolved.yaml"], "not by its name"
    for node in log.node.values():
        (entry,) = (entry for entry in node.description["files"] if entry["judges"])
        entry["sha256"] = "0" * 64
    monkeypatch.setattr(logs, "read", lambda path: log)
    done = run("plot", barrel_log(), "-o", tmp_path / "f.png")
    assert done.code == 0 and "the figure of atb1000" in done.out, done
    assert "pcpc.plants.atb1000.evaluation differs from the log's own" in done.err, done
