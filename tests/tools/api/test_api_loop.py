"""`pcpc.loop`: the rig's own law, written once more in plain Python, gives the same bits."""

import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

import pcpc
from pcpc.executive.nodes.watched import Work

SHORT = {"duration_s": 0.3}


def own_pd(sample: pcpc.Sample, p: SimpleNamespace) -> None:
    """Do what plants/atb1000/laws/pd.py does; its numbers are those of its header."""
    u, y = sample.inputs, sample.command

    def limited(torque: float) -> float:
        return min(max(torque, -p.tau_max_Nm), p.tau_max_Nm)

    y["e_rad"] = u["q_d_rad"] - (u["encoder_rad"] + u["hull_pitch_rad"])  # (1)
    rate = u["q_d_rate_rad_s"] - u["hub_rate_rad_s"]  # (2)
    y["r_rad_s"] = rate + p.lam_per_s * y["e_rad"]  # (3)
    y["tau_Nm"] = limited(p.kv_Nms_rad * y["r_rad_s"])  # (4)
    twist_rate = u["motor_speed_rad_s"] / p.gear_ratio
    twist_rate -= u["hub_rate_rad_s"] - u["hull_rate_rad_s"]
    y["motor_torque_Nm"] = limited(y["tau_Nm"] - p.km_Nms_rad * twist_rate) / p.gear_ratio  # (5)


@pytest.fixture(scope="module")
def reference() -> pcpc.Run:
    """Return a run under the rig's compiled PD."""
    return pcpc.simulate("slew10", "pd", set=SHORT, quiet=True)


def gains(run: pcpc.Run) -> SimpleNamespace:
    blocks = run.rig.nodes()["executive"].blocks
    return SimpleNamespace(**next(b for b in blocks if b.name == "controller").settings)


def test_a_law_in_plain_python_gives_the_bits_of_the_compiled_one(reference: pcpc.Run) -> None:
    p, times = gains(reference), []
    loop = pcpc.loop("slew10", "pd", set=SHORT, quiet=True)
    for sample in loop:
        own_pd(sample, p)
        times.append(sample.t_s)
        assert sample["time.t_s"] == sample.t_s == sample.cycle * sample.dt_s
    assert times == reference.t_s.tolist()
    compared = [name for name in reference.names if "timing." not in name]
    assert len(compared) > 100
    for name in compared:
        assert loop.run[name].tobytes() == reference[name].tobytes(), name
    assert loop.run.verdict == "not judged"
    assert "from outside" in loop.run.summary["not_judged"]["muzzle_error_rms_mrad"]


def test_the_record_of_a_loop_recomputes_but_for_the_commands(reference: pcpc.Run) -> None:
    loop = pcpc.loop("slew10", "pd", set=SHORT, quiet=True)
    for sample in loop:
        sample.command["motor_torque_Nm"] = 0.3 if sample.cycle % 100 < 50 else -0.3
    assert loop.run["controller.motor_torque_Nm"][49:51].tolist() == [0.3, -0.3]
    assert all(node.identical for node in loop.run.replay())


def test_a_folder_keeps_log_and_summary_and_is_not_written_twice(tmp_path: Path) -> None:
    for sample in (loop := pcpc.loop("slew10", set=SHORT, folder=tmp_path / "run", quiet=True)):
        sample.command["motor_torque_Nm"] = 0.0
    again = pcpc.open(tmp_path / "run")
    assert again.verdict == "not judged" and again.summary["changed"] == loop.run.summary["changed"]
    with pytest.raises(pcpc.Error, match="holds a log already"):
        next(iter(pcpc.loop("slew10", set=SHORT, folder=tmp_path / "run", quiet=True)))


def test_a_run_that_is_over_was_not_interrupted_though_its_thread_still_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Work, "is_alive", lambda self: True)
    for sample in (loop := pcpc.loop("slew10", set=SHORT, quiet=True)):
        sample.command["motor_torque_Nm"] = 0.0
    assert loop.run.verdict == "not judged"


def test_a_loop_that_is_left_ends_its_run_and_keeps_the_record() -> None:
    before = threading.active_count()
    loop = pcpc.loop("slew10", set=SHORT, quiet=True)
    for sample in loop:
        if sample.cycle == 50:
            break
    assert loop.run.verdict == "interrupted" and 50 <= len(loop.run.t_s) < 300
    loop = pcpc.loop("slew10", set=SHORT, quiet=True)
    with pytest.raises(ZeroDivisionError):
        for _ in loop:
            raise ZeroDivisionError
    assert loop.run.verdict == "interrupted"
    assert threading.active_count() == before


def test_what_cannot_be_is_a_line() -> None:
    loop = pcpc.loop("slew10", set=SHORT, quiet=True)
    with pytest.raises(pcpc.Error, match="has not ended"):
        loop.run  # noqa: B018  for its message
    with pytest.raises(pcpc.UnknownName, match=r"motor_torq: .*did you mean motor_torque_Nm"):
        for sample in loop:
            sample.command["motor_torq"] = 1.0
    with pytest.raises(pcpc.Error, match="runs once"):
        next(iter(loop))
    loop = pcpc.loop("slew10", set=SHORT, quiet=True)
    with pytest.raises(TypeError, match="only a sample's command can be set"):
        for sample in loop:
            sample["rx.FB_A.encoder"] = 1.0
    with pytest.raises(pcpc.Error, match="did you mean pd"):
        pcpc.loop("slew10", "pdd")


def test_a_command_that_is_no_number_is_a_named_fault() -> None:
    loop = pcpc.loop("slew10", set=SHORT, quiet=True)
    for sample in loop:
        sample.command["motor_torque_Nm"] = float("nan") if sample.cycle == 20 else 0.0
    assert loop.run.verdict == "safety stop"
    assert "was nan in cycle 20" in loop.run.summary["faults"][0]
