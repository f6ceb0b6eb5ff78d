"""The rig file: values and their precedence, resolved()."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from places import ROOT
from small_rig import LAWS, MODEL, RIG, Write, message

from pcpc.drivers.compiled.compile_cache import user_cache
from pcpc.executive.errors import RigError
from pcpc.executive.own_laws.modules import project_name
from pcpc.executive.rig import law_lookup, yamlfile
from pcpc.executive.rig.reading import Rig, load_rig
from pcpc.executive.rig.roles import ROLES


def test_a_rig_has_its_values_and_defaults(write: Write, tmp_path: Path) -> None:
    rig = load_rig(write())
    config = rig.config
    assert (config.rig, config.rate_hz, config.seed, config.pacing) == ("small", 1000.0, 1, "real")
    assert type(config.rate_hz) is float, "an int is accepted where a float is expected"
    assert (config.bus.interface, config.bus.channel, config.bus.bitrate) == ("auto", None, 1000000)
    assert (config.supervisor.fault_after_cycles, config.realtime.executive.priority) == (3, 80)
    assert config.expect == {"pd": {"error_rms_rad": (3.1, 3.8)}}
    assert rig.dbc == tmp_path.resolve() / "small.dbc" and rig.document.text == RIG
    evaluation = rig.evaluation
    assert evaluation and evaluation.window_s == (3.25, 6.0), evaluation
    assert evaluation.numbers == {"tolerance_rad": 0.01}
    assert evaluation.file == str(tmp_path.resolve() / "evaluation.py")


def test_each_node_has_real_time_settings_which_earlier_rigs_put_elsewhere(write: Write) -> None:
    earlier = "{priority: 60, cpu: 2, local_phase: 0.25, plant_cpu: null, plant_phase: 0.4}"
    now = "{executive: {priority: 60, cpu: 2}, local: {phase: 0.25}, plant: {phase: 0.4}}"
    found = [load_rig(write("bus:", f"realtime: {text}\nbus:")).config for text in (earlier, now)]
    options = ("realtime.priority=60", "realtime.cpu=2", "realtime.local_phase=0.25")
    found.append(load_rig(write(), None, (*options, "realtime.plant_phase=0.4")).config)
    realtime = found[0].realtime
    assert all(one.realtime == realtime for one in found), [one.realtime for one in found]
    control, local, plant = (realtime.of_node(role) for role in ROLES[:3])
    assert (control.priority, control.phase, control.cpu) == (60, 0.0, 2)
    assert (local.priority, local.phase, local.cpu) == (75, 0.25, None), "it has a cpu of its own"
    assert (plant.priority, plant.phase, plant.cpu) == (70, 0.4, None)
    twice = write("bus:", "realtime: {plant_cpu: 1, plant: {priority: 9}}\nbus:")
    told = "realtime.plant_cpu: is realtime.plant.cpu today; write it there, small.yaml:"
    assert told in message(twice)


def test_nodes_are_complete_and_in_order(write: Write) -> None:
    control, plant = load_rig(write()).nodes().values()
    assert (control.name, plant.name) == ("EXEC", "PLANT")
    assert [spec.name for spec in control.blocks] == ["reference", "controller"]
    assert control.blocks[1].settings == {"kv_Nms_rad": 110.0, "lam_per_s": 16.0}
    assert control.blocks[1].inputs == {"q_rad": "rx.FB.angle", "ref_rad": "reference.ref_rad"}
    assert control.transmit == {"CMD.motor_torque": "controller.tau_Nm"}
    assert control.limits["CMD.motor_torque"].high == 2.0
    assert control.limits["CMD.motor_torque"].rate_per_s is None
    assert plant.blocks[0].settings == {"mass_kg": 80.0, "gap_rad": 0.003}
    assert plant.safe == {"CMD.motor_torque": 0.0}


def test_a_setting_comes_from_the_last_that_gives_it(write: Write) -> None:
    path = write()
    gaps = [
        load_rig(write("      parameters: {gap_rad: 0.003}\n", "")).nodes()["plant"].blocks[0],
        load_rig(write()).nodes()["plant"].blocks[0],
        load_rig(path, settings=["barrel.gap_rad=0.05"]).nodes()["plant"].blocks[0],
    ]
    assert [spec.settings["gap_rad"] for spec in gaps] == [0.002, 0.003, 0.05]
    assert [spec.where("parameters.gap_rad") for spec in gaps] == [
        "parameters.yaml:3:3",
        "small.yaml:30:20",
        "--set barrel.gap_rad=0.05",
    ]


def test_blocks_and_paths_know_their_place(write: Write) -> None:
    rig = load_rig(write(), "nn")
    controller = rig.nodes()["executive"].blocks[1]
    assert controller.settings == {"w_0": 0.5, "w_1": 0.5, "w_2": 0.5}
    assert controller.inputs["extra"] == "barrel.rate_rad_s"
    places = [controller.where(path) for path in ("", "law", "inputs.extra", "inputs.q_rad")]
    assert places == ["small.yaml:19:5", "small.yaml:13:5", "small.yaml:14:14", "small.yaml:20:16"]
    assert rig.where("executive.transmit.CMD.motor_torque") == "small.yaml:21:14"
    assert str(rig.error("plant.safe", "why")) == "small.yaml:32:3: plant.safe: why"


def test_a_controller_and_settings_apply(write: Write) -> None:
    options = ["rate_hz=2e3", "supervisor.ramp_s=1", "bus.bitrate=null", "bus.channel=can0"]
    options += ["controller=nn", "controller.w_1=7", "evaluation.window_s=[1, 2]", "seed=0"]
    options += ["executive.limits.CMD.motor_torque.high=1.5"]
    rig = load_rig(write(), settings=options)
    config = rig.config
    assert (config.rate_hz, config.supervisor.ramp_s, config.seed) == (2000.0, 1.0, 0)
    assert (config.bus.bitrate, config.bus.channel, config.controller) == (None, "can0", "nn")
    assert rig.nodes()["executive"].blocks[1].settings == {"w_0": 0.5, "w_1": 7.0, "w_2": 0.5}
    assert config.executive.limits["CMD.motor_torque"].high == 1.5
    assert rig.evaluation and rig.evaluation.window_s == (1.0, 2.0)


def test_paths_start_from_the_file_that_says_them(write: Write, tmp_path: Path) -> None:
    write()
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "model.py").write_text(MODEL.replace('"clearance"', '"other"'))
    child = tmp_path / "sub" / "child.yaml"
    child.write_text(
        "base: ../small.yaml\nrig: child\nplant: {blocks: {barrel: {law: 'model.py:BARREL'}}}\n"
    )
    rig = load_rig(child)
    help_text = rig.nodes()["plant"].blocks[0].block.parameters[1].help
    assert (rig.config.rig, rig.dbc.name, help_text) == ("child", "small.dbc", "other")
    assert rig.where("rig") == "sub/child.yaml:2:1" and rig.where("dbc") == "small.yaml:3:1"
    again = load_rig(child, text=rig.resolved())
    assert effective(again) == effective(rig) and "../small.dbc" in rig.resolved()


def test_laws_are_found_by_name_module_or_file(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "laws_of_this_test"
    own.mkdir()
    (own / "pd_of_this_test.py").write_text(LAWS)
    monkeypatch.setattr(
        law_lookup, "shipped_laws", lambda: {"bare": "laws_of_this_test.pd_of_this_test"}
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    by_name = load_rig(write('"laws.py:PD"', "bare:PD"))
    by_module = load_rig(write('"laws.py:PD"', "laws_of_this_test.pd_of_this_test:PD"))
    by_file = load_rig(write())
    for rig in (by_name, by_module, by_file):
        assert rig.nodes()["executive"].blocks[1].settings["lam_per_s"] == 16.0


def test_a_file_of_the_project_is_imported_under_its_own_name(write: Write) -> None:
    block = ROOT / "executive" / "laws" / "block.py"
    rig = load_rig(write("law: model.py:BARREL", f"law: {block}:Block"), resolve=False)
    with pytest.raises(RigError, match=r"block.py is of type type, not Block"):
        rig.nodes()
    twins = [name for name in sys.modules if name.startswith("block_")]
    assert not twins, f"imported twice: {twins}"


def test_reading_a_rig_imports_nothing_of_laws_until_one_is_needed(write: Write) -> None:
    write()
    code = (
        "import sys; from pcpc.executive.rig.reading import load_rig\n"
        "rig = load_rig('small.yaml', settings=['barrel.gap_rad=0.05'], resolve=False)\n"
        "assert rig.config.plant.blocks['barrel'].parameters == {'gap_rad': 0.05}\n"
        "print('pcpc.executive.laws.block' in sys.modules); rig.nodes()\n"
        "print('pcpc.executive.laws.block' in sys.modules)\n"
    )
    project = str(ROOT)
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={"PYTHONPATH": project, "HOME": ".", "XDG_CACHE_HOME": str(user_cache())},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["False", "True"], done.stdout + done.stderr


def with_lists(data: Any) -> Any:
    """Return plain data as a file has it, where a pair is a list."""
    if isinstance(data, dict):
        return {key: with_lists(child) for key, child in data.items()}
    return [with_lists(child) for child in data] if isinstance(data, list | tuple) else data


def effective(rig: Rig) -> Any:
    """All that a rig says, in plain data: its values, files and complete settings."""
    config = msgspec.to_builtins(rig.config)
    for section in ("executive", "plant"):
        config[section].pop("blocks")
    config["plant"].pop("parameters_file")
    config.pop("controllers")
    nodes = [
        (n.name, [(b.name, b.settings, b.inputs) for b in n.blocks], n.transmit, n.limits, n.safe)
        for n in rig.nodes().values()
    ]
    for name in ("dbc", "evaluation"):
        config.pop(name)
    return config, nodes, rig.dbc, rig.evaluation


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    title=st.text(st.characters(codec="utf-8"), max_size=12),
    rate_hz=st.floats(1, 20000),
    gain=st.floats(0, 500),
    gap=st.floats(0, 0.1),
    seed=st.integers(0, 2**63 - 1),
    channel=st.none() | st.integers(0, 9) | st.sampled_from(["vcan0", "010", "1e3", "yes", ""]),
    controller=st.sampled_from(["pd", "nn"]),
)
def test_resolved_text_loads_to_equal_values(
    write: Write,
    title: str,
    rate_hz: float,
    gain: float,
    gap: float,
    seed: int,
    channel: str | int | None,
    controller: str,
) -> None:
    path = write()
    options = [f"rate_hz={rate_hz!r}", f"barrel.gap_rad={gap!r}", f"seed={seed}"]
    options += [f"controller.kv_Nms_rad={gain!r}"] if controller == "pd" else []
    options += [f"title={msgspec.json.encode(title).decode()}"] if title.isprintable() else []
    options += [f"bus.channel={msgspec.json.encode(channel).decode()}"]
    rig = load_rig(path, controller, options)
    assert rig.config.bus.channel == channel and rig.config.rate_hz == rate_hz
    again = load_rig(path, text=rig.resolved())
    assert effective(again) == effective(rig), rig.resolved()
    assert again.resolved() == rig.resolved()
    assert yamlfile.load(path, rig.resolved()).data == with_lists(rig.effective())


def test_a_law_beside_the_packages_has_one_name_whatever_the_path(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`python -m` puts the working folder on the path; the compile cache stores the name."""
    monkeypatch.syspath_prepend(str(ROOT))
    assert project_name(ROOT / "tests" / "executive" / "relay" / "law.py") is None
    assert project_name(ROOT / "plants" / "probe" / "law.py") == "pcpc.plants.probe.law"
