"""`pcpc margin` where a loop could look better than it is: stuck, cycling, at a limit, hidden."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pcpc
from pcpc.executive.rig import yamlfile
from pcpc.plants import atb1000
from pcpc.tools.cli import main
from pcpc.tools.study.margin import notes
from pcpc.tools.study.margin.book._linear_rig import PLANTS, RATE_HZ
from pcpc.tools.study.margin.margins import margins
from pcpc.tools.study.margin.visible import visible_margins

LINEAR = dict(yamlfile.load(Path(atb1000.__file__).with_name("linear.yaml")).data)
NAMES = ("gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin")
LOUD = {"controller.kp_V_rad": 120.0, "controller.ki_V_rads": 2400.0, "controller.kd_Vs_rad": 1.88}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("margin") / "lab"
    assert main(["new", str(folder)]) == 0
    return folder


def test_a_loop_that_is_stuck_is_looked_at_in_motion(lab: Path) -> None:
    stuck = pcpc.margin(lab)
    free = pcpc.margin(lab, set={"motor.coulomb_Nm": 0.0})
    said = " ".join(stuck.text().split())
    assert "has no effect on itself: no gain around this loop at this point (stuck" in said
    assert "linearised in motion" in said and "at rest has" not in said
    for name in NAMES:
        assert getattr(stuck, name) == pytest.approx(getattr(free, name), rel=0.02), name
    assert "any" not in said


def test_a_limit_cycle_behind_friction_is_said_so(lab: Path) -> None:
    with pytest.raises(pcpc.Error) as caught:
        pcpc.margin(lab, set=LOUD)
    said = str(caught.value)
    assert "once moved the command goes on, by 20" in said and "% of the time at its limit" in said
    assert "in motion the closed loop is unstable: a pole at |z| = 1.0388" in said
    with pytest.raises(pcpc.Error, match="in motion the closed loop is unstable"):
        pcpc.margin(lab, set=LOUD, method="linearised")


@pytest.mark.parametrize("method", ["linearised", "measured"])
def test_a_sign_that_is_wrong_has_no_margin_or_a_small_one(tmp_path: Path, method: str) -> None:
    path = PLANTS["lag"].write(tmp_path)
    about: dict[str, Any] = {"amplitude": 10.0, "settle_s": 2.0}
    with pytest.raises(pcpc.Error, match=r"unstable|goes on|ended after"):
        pcpc.margin(path, set={"controller.kp": -8.0}, at_s=1.0, method=method, **about)
    about["set"] = {"controller.kp": -0.8}
    if method == "measured":  # no line shows what is at 0 Hz
        with pytest.raises(pcpc.Error, match="lies at the lowest line"):
            pcpc.margin(path, method=method, **about)
        return
    weak = pcpc.margin(path, method=method, **about)
    assert weak.gain_margin == pytest.approx(1.25, rel=0.01)


@pytest.mark.parametrize("rig", ["sin0.5", "hull"])
@pytest.mark.parametrize("seed", [1, 2, 3, 77])
def test_measured_margins_of_the_barrel_are_those_of_its_linear_loop(rig: str, seed: int) -> None:
    one = pcpc.margin(rig, "pd", set=LINEAR, seed=seed)
    assert one.linearised is not None and one.measured is not None
    for name in NAMES:
        ours, seen = (getattr(each.margins, name) for each in (one.linearised, one.measured))
        assert seen == pytest.approx(ours, rel=0.02), name


def test_an_amplitude_that_hides_a_margin_leaves_it_unmeasured() -> None:
    truth = pcpc.margin("sin0.5", "pd", set=LINEAR, method="linearised")
    for amplitude in (0.02, 0.04, 0.1):
        try:
            one = pcpc.margin("sin0.5", "pd", set=LINEAR, amplitude=amplitude, method="measured")
        except pcpc.Error as error:
            assert "hides" in str(error)
            continue
        for name in NAMES:
            seen = getattr(one, name)
            assert np.isnan(seen) or seen == pytest.approx(getattr(truth, name), rel=0.1), name
        assert "not measured" in one.text()


def test_noise_never_shows_a_margin_that_is_not_there() -> None:
    """400 noisy responses of known loops: what is told lies within a quarter, or is not told."""
    f, draw = np.geomspace(0.25, 240.0, 80), np.random.default_rng(5)
    told = wrong = 0
    for name in PLANTS:
        loop = PLANTS[name].loop(f)
        exact = margins(
            np.geomspace(0.1, 249.99, 4000),
            PLANTS[name].loop(np.geomspace(0.1, 249.99, 4000)),
            RATE_HZ,
        )
        for size in np.geomspace(1e-4, 0.5, 130):
            noise = size * np.exp(draw.uniform(-1.0, 1.0)) * (1.0 + 9.0 * (f < draw.choice(f)))
            g = -loop / (1.0 + loop)
            g = g + noise / np.sqrt(2.0) * (draw.normal(size=80) + 1j * draw.normal(size=80))
            one, _ = visible_margins(f, -g / (1.0 + g), noise, RATE_HZ)
            for what in ("gain_margin", "phase_margin_deg", "disk_margin"):
                seen, true = getattr(one, what), getattr(exact, what)
                told += not np.isnan(seen)
                wrong += bool(seen > 1.25 * true)
    assert told > 400, "not all is hidden"
    assert wrong <= 0.02 * told, f"{wrong} of {told}"


def test_a_crossing_that_no_grid_meets_is_no_any(tmp_path: Path) -> None:
    f = np.geomspace(1.0, 249.0, 300)
    near = margins(f, np.full(300, -0.98 + 0.01j) * np.exp(-0.3j * np.log(f)), RATE_HZ)
    assert near.sensitivity_peak > 2.0
    bare = margins(f, np.full(300, -0.98 + 0.1j), RATE_HZ)
    assert bare.gain_margin == np.inf and notes.contradiction(bare)
    known = notes.without_crossings(bare)
    assert np.isnan(known.gain_margin) and np.isnan(known.phase_margin_deg)


def test_a_constant_below_zero_towards_no_frequency_is_a_gain_margin() -> None:
    f = np.geomspace(1e-3, 249.0, 4000)
    for gain, name in ((-0.8, "gain_margin"), (-3.0, "gain_reduction")):
        one = margins(f, gain / (1.0 + 2j * np.pi * f * 0.05), RATE_HZ)
        assert getattr(one, name) == pytest.approx(-1.0 / gain, rel=1e-3)


def test_a_lowest_line_hides_no_crossing_below_it(tmp_path: Path) -> None:
    path = PLANTS["double"].write(tmp_path)
    whole = pcpc.margin(path, amplitude=10.0, lowest_hz=0.5)
    part = pcpc.margin(path, amplitude=10.0, lowest_hz=30.0)
    assert part.linearised is not None and part.measured is None, "four lines know no margin"
    assert part.notes == ["not measured: 4 lines from 31.25 Hz on are too few to know any margin; "
                          "give a lower --lowest"]  # fmt: skip
    some = pcpc.margin(path, amplitude=10.0, lowest_hz=10.0)
    assert some.measured is not None and np.isnan(some.measured.margins.phase_margin_deg)
    for name in NAMES:
        assert getattr(part, name) == pytest.approx(getattr(whole, name), rel=0.01), name
        seen = getattr(some.measured.margins, name)
        assert not seen > 1.05 * getattr(whole, name), name
    assert (part.linearised.f_hz >= 30.0).all()


def test_a_cycle_of_the_loop_s_own_has_no_margins_and_a_fading_one_has(tmp_path: Path) -> None:
    path = PLANTS["lag"].write(tmp_path, relay=50.0)
    with pytest.raises(pcpc.Error, match=r"cycles by itself: the command moves by 1\.99 rms"):
        pcpc.margin(path, set={"controller.kp": 1.0}, at_s=1.0, method="linearised")
    edge = PLANTS["lag"].write(tmp_path)
    about: dict[str, Any] = {"set": {"controller.kp": 25.0}, "at_s": 1.0, "method": "linearised"}
    for settle_s, rests in ((0.2, False), (2.0, True)):  # up to eight times as long
        one = pcpc.margin(edge, settle_s=settle_s, **about)
        assert one.gain_margin == pytest.approx(1.02, rel=0.01)
        assert ("not at rest" in one.text()) != rests, settle_s


def test_a_law_that_ignores_its_input_has_no_margins(lab: Path) -> None:
    none = dict.fromkeys(LOUD, 0.0)
    for method in ("both", "measured"):
        with pytest.raises(pcpc.Error, match=r"peak, 63\.7, lies at the lowest line"):
            pcpc.margin(lab, set=none, method=method)
