"""`pcpc new`: a rig of the user's own that runs all four ways at once, and what it refuses."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from copies import program
from processes import Done, Running, own_bus, pcpc

import pcpc as pcpc_api
from pcpc.executive.log import reader as logs
from pcpc.executive.own_laws.modules import module_of
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.make.new import (
    BARE,
    CART,
    DEVICE_FILES,
    DRIVE_FILES,
    FILES,
    MOTOR,
    NEXT,
    NEXT_DEVICE,
    SCHEMA,
    Template,
    write,
)

FIGURES = {  # of a README: its controller, the words around it, the figure
    "motor": (
        ("pid", r"within 30 mrad after (\S+) s", "settled_s"),
        ("pd", r"holds the motor up to (\S+) mrad,", "rest_error_max_mrad"),
    ),
    "cart": (
        ("state_feedback", r"goes back by (\S+) mm", "back_mm"),
        ("state_feedback", r"by (\S+) mrad at most", "lean_max_mrad"),
        ("state_feedback", r"within 4 mm after (\S+) s", "settled_s"),
        ("state_feedback", r"stays within (\S+) mm:", "rest_error_max_mm"),
        ("state_feedback", r"instead of (\S+) N", "force_max_N"),
        ("soft", r"It needs (\S+) s", "settled_s"),
        ("soft", r"and (\S+) N instead", "force_max_N"),
    ),
    "bare": (),
}
LIMITS = {"motor": 5, "cart": 6, "bare": 1}
CYCLES = {"motor": 1000, "cart": 5000, "bare": 1000}


@pytest.fixture(scope="module")
def motor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a new rig."""
    folder = tmp_path_factory.mktemp("elsewhere") / "my-motor"
    done = pcpc("new", str(folder))
    assert done.code == 0, str(done)
    return folder


@pytest.fixture(scope="module", params=[MOTOR, CART, BARE], ids=lambda one: one.rig)
def template(request: pytest.FixtureRequest) -> Template:
    """Return each kind of rig that can be written."""
    return request.param


@pytest.fixture(scope="module")
def new_rig(template: Template, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a new rig of this kind."""
    folder = tmp_path_factory.mktemp("elsewhere") / f"my-{template.rig}"
    done = pcpc("new", *([f"--{template.rig}"] * (template is not MOTOR)), str(folder))
    assert done.code == 0, str(done)
    return folder


def files_of(folder: Path) -> set[str]:
    found = (path for path in folder.rglob("*") if path.is_file() and path.suffix != ".pyc")
    return {path.relative_to(folder).as_posix() for path in found}


def named(template: Template, *files: str, rig: str = "my-motor") -> set[str]:
    """Return the names that files of a template get."""
    return {template.renamed(file, rig) for file in files}


def test_every_file_of_the_template_is_written_and_named(template: Template, new_rig: Path) -> None:
    others = ("device/", "cart/", "bare/") if template is MOTOR else ("/",)
    known = {name for name in files_of(template.folder) if not name.startswith(others)}
    drives = ("_cia402", "_odrive", "_mit", "_moteus", "_robstride", "")  # that of others' dialects
    known -= {f"drive{kind}.yaml" for kind in drives}
    files = named(template, *template.files, rig=new_rig.name)
    assert known == set(template.files) and files | {SCHEMA} == files_of(new_rig)
    assert {f"my_{template.rig}.dbc", f"test_my_{template.rig}.py"} <= files
    told = (new_rig / "README.md").read_text(encoding="utf-8")
    words = [word for word in (*files, *NEXT) if word != "README.md"]
    assert not [word for word in words if word not in told], told
    text = "".join(path.read_text("utf-8") for path in new_rig.rglob("*") if path.is_file())
    assert not re.search(rf"\b{template.rig}\.dbc|\btest_{template.rig}\b", text)
    assert told.count("## Four ways to run it\n") == 1 and "\n\n\n" not in told
    text = (new_rig / "rig.yaml").read_text(encoding="utf-8")
    assert f"\nrig: my-{template.rig}\n" in text


@pytest.mark.parametrize("more", [[], ["--device"], ["--cart"], ["--bare"]])
def test_what_it_prints_fits_80_columns(tmp_path: Path, more: list[str]) -> None:
    done = pcpc("new", "my-motor", *more, cwd=tmp_path)
    long = [line for line in done.out.splitlines() if len(line) > 80]
    assert done.code == 0 and not long, long
    assert done.out.splitlines()[-len(NEXT) - more.count("--device") - 1] == "  cd my-motor", (
        done.out
    )


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a new rig with a device."""
    folder = tmp_path_factory.mktemp("elsewhere") / "my-motor"
    done = pcpc("new", str(folder), "--device")
    assert done.code == 0, str(done)
    return folder


def test_its_device_runs_at_once_and_has_the_bits_of_the_law(device: Path) -> None:
    folder = device
    assert files_of(folder) == named(MOTOR, *FILES, *DEVICE_FILES, SCHEMA)
    told = (folder / "README.md").read_text(encoding="utf-8")
    assert NEXT_DEVICE in told and all(f"`{file}`" in told for file in DEVICE_FILES)
    words = NEXT_DEVICE.replace("--device python", f"--quiet --bus {own_bus()} --device python")
    words = words.replace(" python ", f" {sys.executable} ").removeprefix("pcpc ")
    done = pcpc(*words.split(), cwd=folder)
    assert done.code == 0 and "verdict  ok (5 limits judged)" in done.out, str(done)
    pytest_of(folder, "test_device.py")


def test_its_law_in_c_is_such_a_device_too(device: Path, tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler; apt-get install gcc libc6-dev")
    text = (device / "README.md").read_text(encoding="utf-8").rpartition("The same in C")[2]
    generate, make, plant = text.split("```")[1].strip().splitlines()
    assert pcpc(*generate.split()[1:], cwd=device).code == 0
    subprocess.run(make.split(), cwd=device, check=True, capture_output=True)
    bus = ("--quiet", "--bus", own_bus(), "-o", str(tmp_path / "run"), "--device")
    words = [word for one in plant.split()[1:] for word in (bus if one == "--device" else [one])]
    done = pcpc(*words, cwd=device)
    assert done.code == 0 and "verdict  ok (5 limits judged)" in done.out, str(done)
    run, virtual = pcpc_api.open(tmp_path / "run"), pcpc_api.simulate(device, quiet=True)
    for name in ("plant:motor.angle_rad", "plant:motor.held_V"):
        assert run[name][: len(virtual.t_s)].tobytes() == virtual[name].tobytes(), name


def test_a_rig_without_a_device_has_none(motor: Path) -> None:
    assert not any((motor / file).exists() for file in (*DEVICE_FILES, *DRIVE_FILES))


@pytest.mark.parametrize("drive", ["cia402", "odrive", "mit", "moteus", "robstride"])
def test_its_drive_is_a_rig_beside_it(tmp_path: Path, drive: str) -> None:
    folder = tmp_path / "my-motor"
    done = pcpc("new", str(folder), "--drive", drive)
    assert done.code == 0 and "pcpc run drive.yaml --only plant" in done.out, str(done)
    assert files_of(folder) == named(MOTOR, *FILES, *DRIVE_FILES, SCHEMA)
    assert pcpc("check", str(folder / "drive.yaml")).code == 0
    assert f"profile: {drive}\n" in (folder / "drive.yaml").read_text(encoding="utf-8")
    done = pcpc("new", str(tmp_path / "pole"), "--cart", "--drive", "cia402")
    assert done.code == 2 and "leave out --cart" in done.err, str(done)
    done = pcpc("new", str(tmp_path / "other"), "--drive", "ethercat")
    assert done.code == 2 and "cia402" in done.err, str(done)
    assert [one.name for one in tmp_path.iterdir()] == ["my-motor"]


def undisturbed(*words: str, folder: Path) -> Done:
    """Run a rig; again, at most twice, where it failed and the machine made it skip cycles."""
    for _ in range(3):
        shutil.rmtree(folder, ignore_errors=True)
        done = pcpc(*words, "-o", str(folder))
        if (
            done.code == 0
            or not json.loads((folder / "summary.json").read_text())["skipped_cycles"]
        ):
            break
    return done


def test_it_runs_all_four_ways_at_once_and_its_log_is_recomputed(
    template: Template, new_rig: Path, tmp_path: Path
) -> None:
    quiet = (str(new_rig), "--quiet", "--no-figure", "--judge")
    limits = LIMITS[template.rig]
    judged = f"verdict  ok ({limits} limit{'s' * (limits > 1)} judged)"
    bus = ("--bus", own_bus())
    lockstep = (*bus, "--pacing", "lockstep")
    patient = ("--set", "supervisor.fault_after_cycles=1000")  # a machine may stand still for 0.1 s
    for way, words in {
        "virtual": ("simulate", *quiet),
        "real": ("run", *quiet, *bus, *patient),
        "lockstep": ("run", *quiet, *lockstep),
    }.items():
        done = undisturbed(*words, folder=tmp_path / way)
        assert done.code == 0 and judged in done.out, f"{way}: {done}"
    with Running("run", "--only=plant", str(new_rig), *lockstep) as plant:
        done = pcpc("run", "--only=executive", *quiet, *lockstep, "-o", str(tmp_path / "two"))
        assert (done.code, plant.done().code) == (0, 0), f"{done}\n{plant}"
    states = [
        logs.payloads(tmp_path / way / "log.mcap", "/state")
        for way in ("virtual", "lockstep", "two")
    ]
    assert len(states[0]) == CYCLES[template.rig] and states[0] == states[1] == states[2]
    again = pcpc("replay", str(tmp_path / "real"), "--quiet")
    assert again.code == 0, str(again)


def test_its_own_tests_pass(new_rig: Path) -> None:
    pytest_of(new_rig)


def pytest_of(folder: Path, *files: str) -> None:
    """Run the tests of a folder as its user does."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_")}
    words = ["-q", "-x", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [program("pytest"), *words, *files],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and " passed" in done.stdout, done.stdout + done.stderr


def test_its_readme_says_the_figures_that_a_run_has(template: Template, new_rig: Path) -> None:
    told = (new_rig / "README.md").read_text(encoding="utf-8")
    for controller, form, name in FIGURES[template.rig]:
        found = re.search(form, told)
        assert found, form
        digits = len(found[1].partition(".")[2])
        run = pcpc_api.simulate(new_rig, controller, quiet=True)
        assert f"{run.metrics[name]:.{digits}f}" == found[1], (controller, name)


def test_the_motor_s_figure_shows_an_error_that_is_never_small() -> None:
    evaluation = module_of("", MOTOR.folder / "evaluation.py")
    swings, step = 500.0 * np.sin(np.arange(100.0)), np.where(np.arange(100) < 20, 3e3, 1.0)
    assert np.isfinite(evaluation.near({"error_mrad": swings})).all()
    assert np.isfinite(evaluation.near({"error_mrad": step})).sum() == 80
    assert evaluation.settled({"settled_s": 0.135}) == "within 30 mrad after 0.135 s"
    assert evaluation.settled({"settled_s": np.inf}) == "beyond 30 mrad at the end"


@pytest.mark.parametrize("name", ["2tanks", "a.b-c", "class", "probe", "_x", "motor", "rig"])
def test_a_rig_of_any_name_is_whole(name: str, tmp_path: Path) -> None:
    """Its files are named by it, as a module of Python can be; its own test is found by pytest."""
    write(tmp_path / name, template=BARE)
    stem = re.sub(r"\W", "_", name)
    assert {f"{stem}.dbc", f"test_{stem}.py"} <= files_of(tmp_path / name)
    loaded = load_rig(tmp_path / name / "rig.yaml")
    assert loaded.config.rig == name and loaded.config.dbc == f"{stem}.dbc"
