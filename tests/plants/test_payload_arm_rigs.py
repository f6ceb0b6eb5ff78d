"""The rigs of the arm with a payload as they are shipped: what each law reaches, to the digit."""

from functools import cache

import numpy as np
import pytest
from payload_arm_reference import FOLDER

from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.payload_arm import evaluation
from pcpc.plants.payload_arm.book import study


@cache
def metrics(payload: str, controller: str, *settings: str) -> dict[str, float]:
    """Return the metrics of a rig in virtual time."""
    rig = load_rig(FOLDER / f"rigs/payload-{payload}.yaml", controller, [*settings])
    judge = rig.evaluation
    assert judge is not None
    window = judge.window_s if rig.config.duration_s < 60.0 else (50.0, 60.0)
    return evaluation.EVALUATION.judge(in_memory(rig), window, judge.numbers, 1e-3)


def errors(found: dict[str, float], name: str) -> tuple[float, float]:
    """Return a metric of both joints."""
    return found[f"{name}_1_rad"], found[f"{name}_2_rad"]


@pytest.mark.parametrize("label", study.MAIN)
def test_the_cases_are_those_of_an_independent_implementation_to_its_last_digit(label: str) -> None:
    payload, controller = study.MAIN[label]
    expected = study.known("main", label)
    found = metrics(payload, controller)
    for name, text in zip(study.COLUMNS, expected, strict=False):
        shown = " ".join(f"{value:.4f}" for value in errors(found, name))
        assert shown == text, f"{label} {name}: {shown} for {text}"


@pytest.mark.parametrize("label", [label for label in study.PARTS if study.known("parts", label)])
def test_the_parts_do_what_they_did_there(label: str) -> None:
    payload, *settings = study.PARTS[label]
    expected = study.known("parts", label)
    found = metrics(payload, "critic", *(f"controller.{setting}" for setting in settings))
    for name, text in zip(study.COLUMNS, expected, strict=False):
        told = [float(each) for each in text.split()]
        digit = 0.55 * 10.0 ** -max((len(each) - 2 for each in text.split()), default=0)
        for value, other in zip(errors(found, name), told, strict=False):
            assert abs(value - other) <= digit, f"{label} {name}: {value:.5f} for {other}"


def test_the_weights_stay_as_small_as_there() -> None:
    found = metrics("on", "critic")
    norms = [found[f"{name}_max"] for name in ("critic", "w1", "w2", "rho")]
    assert norms == pytest.approx([0.49, 0.26, 18.8, 0.69], rel=0.02), norms
    assert found["torque_peak_Nm"] == pytest.approx(465.0, abs=0.5), found["torque_peak_Nm"]


def test_the_critic_adds_next_to_nothing() -> None:
    on, off = metrics("on", "critic"), metrics("on", "critic", "controller.beta=0.0")
    ratio = np.divide(errors(on, "error_rms"), errors(off, "error_rms"))
    assert 1.005 < ratio[0] < 1.03, f"joint 1 is not a little worse with the critic: {ratio}"
    assert 0.97 < ratio[1] < 0.999, f"joint 2 is not a little better with the critic: {ratio}"
    pd = np.array(errors(metrics("on", "pd"), "error_rms"))
    assert (np.array(errors(off, "error_rms")) < 0.11 * pd).all(), "the action network is not it"


def test_five_samples_of_delay_change_little() -> None:
    now, late = metrics("on", "critic"), metrics("on", "critic", "arm.delay_samples=5.0")
    for name in ("early_error_rms", "payload_error_rms", "error_rms"):
        change = np.abs(np.subtract(errors(late, name), errors(now, name))).max()
        assert change < 2.5e-4, f"{name} by {change:.1e} rad"
    grown = late["after_error_max_2_rad"] - now["after_error_max_2_rad"]
    assert 5e-4 < grown < 1.5e-3, f"{grown:.1e} rad"
    assert late["torque_peak_Nm"] == pytest.approx(493.0, abs=0.5), late["torque_peak_Nm"]


def test_other_first_layers_do_alike() -> None:
    found = [
        errors(metrics("on", "critic", f"controller.network_seed={seed}.0"), "error_rms")
        for seed in range(4)
    ]
    low, high = np.min(found, axis=0), np.max(found, axis=0)
    assert low == pytest.approx((0.0034, 0.0042), abs=5.5e-5), low
    assert high == pytest.approx((0.0067, 0.0069), abs=5.5e-5), high


def test_a_minute_stays_bounded_and_forgets_the_payload() -> None:
    found = metrics("on", "critic", "duration_s=60.0")
    error = errors(found, "error_rms")
    assert error == pytest.approx((0.0064, 0.0103), abs=5.5e-5), error
    assert found["w2_max"] < 20.0, found["w2_max"]


def test_an_integrator_in_place_of_the_action_network_does_as_well() -> None:
    integrator = metrics("on", "critic", "controller.v2_size=0.0", "controller.beta=0.0")
    network = metrics("on", "critic", "controller.beta=0.0")
    for name in ("early_error_rms", "payload_error_rms", "error_rms"):
        ratio = np.divide(errors(integrator, name), errors(network, name))
        assert ((ratio > 0.9) & (ratio < 1.1)).all(), f"{name}: {ratio} times"
