"""`pcpc generate c`: files that compile, a table of builds that agree, one that must be refused."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from fd_rig import fd_rig

from pcpc.executive.nodes.virtual import in_memory
from pcpc.executive.rig.reading import load_rig
from pcpc.tools.cli import main
from pcpc.tools.make.generate import builds
from pcpc.tools.make.generate.closed import ClosedLoop, digest_of
from pcpc.tools.make.generate.cost import step_cost
from pcpc.tools.make.generate.library import WARNINGS, run, write
from pcpc.tools.make.generate.translator import elementary
from pcpc.tools.make.new import TEMPLATE
from pcpc.tools.start.rigs import find, shipped_rigs

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc here: apt install gcc")


@pytest.mark.parametrize(
    ("what", "step"),
    [("pd", "pd_step"), ("references:sine", "sine_step"), ("fuzzy-d01", "fuzzy_d01_rig_step")],
)
def test_what_is_written_compiles_and_needs_no_library(
    what: str, step: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["generate", "c", what, "-o", str(tmp_path)]) == 0
    assert str(tmp_path) in capsys.readouterr().out
    run(["gcc", *elementary.FLAGS, *WARNINGS, "-O2", "-ffreestanding", "-nostdlib", "-r", "-o",
         tmp_path / "all.o", *tmp_path.glob("*.c")])  # fmt: skip
    symbols = run(["nm", tmp_path / "all.o"])
    assert f" T {step}\n" in symbols
    assert re.findall(r" U (\w+)", symbols) == [], symbols


def test_equations_names_and_units_of_the_law_stand_in_its_c(tmp_path: Path) -> None:
    assert main(["generate", "c", "pd", "-o", str(tmp_path)]) == 0
    header, source = ((tmp_path / f"pd.{end}").read_text() for end in "hc")
    assert "    double kv_Nms_rad; /* [N m s/rad] gain on the filtered error */\n" in header
    assert "r     = e' + Lam e                                filtered error" in source
    said = "    y->e_rad = u->q_d_rad - (u->encoder_rad + u->hull_pitch_rad); /* (1) */\n"
    assert said in source


def test_every_build_of_this_machine_gives_the_bits_of_python(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["generate", "c", "probe", "--check", "--cycles", "40", "-q"]) == 0
    told = capsys.readouterr().out
    digests = set(re.findall(r" ([0-9a-f]{16})  ", told))
    assert len(digests) == 1, told
    assert "gcc -O2" in told and "Python, interpreted" in told, told
    joins = "fma" in Path("/proc/cpuinfo").read_text().split()
    assert ("refused, as it has to be" in told) is joins, told
    for build in builds.builds():
        absent = re.search(rf"{re.escape(build.name)} +- +not here: ", told)
        assert bool(absent) is not build.possible, (build.name, told)


def test_a_law_that_differs_in_the_13th_digit_is_another_digest(tmp_path: Path) -> None:
    rig = load_rig(Path(find("hull")), "pd_fast")
    closed = ClosedLoop(rig)
    files = closed.files(60)
    expected = digest_of(in_memory(rig), closed.columns(), 60)
    gcc = next(build for build in builds.builds() if build.name == "gcc -O0")
    lag, next_lag = "GATE_LAG_S = 0.03;", "GATE_LAG_S = 0.03000000000001;"
    changed = files["executive_controller.c"].replace(lag, next_lag)
    assert changed != files["executive_controller.c"]
    found = []
    for name, law in (("same", files["executive_controller.c"]), ("other", changed)):
        write({**files, "executive_controller.c": law}, tmp_path / name)
        builds.fixed_files(tmp_path / name)
        found.append(gcc.digest(tmp_path / name))
    assert found[0] == expected != found[1], (expected, found)


def test_frames_of_can_fd_in_c_carry_the_bits_of_python(tmp_path: Path) -> None:
    """Signals over 48 and 64 bytes, Intel and Motorola; one moved by a byte is another loop."""
    rig = load_rig(fd_rig(tmp_path), None, [])
    closed = ClosedLoop(rig)
    files = closed.files(60)
    assert "uint32_t pack_FB(const FB_signals *s, uint8_t data[64])" in files["frames.h"]
    assert "uint32_t pack_CMD(const CMD_signals *s, uint8_t data[48])" in files["frames.h"]
    gcc = next(build for build in builds.builds() if build.name == "gcc -O2")
    expected, found = digest_of(in_memory(rig), closed.columns(), 60), []
    shifted = files["frames.c"].replace("add_words(&data[37]", "add_words(&data[36]")
    assert shifted != files["frames.c"]
    for name, text in (("same", files["frames.c"]), ("other", shifted)):
        write({**files, "frames.c": text}, tmp_path / name)
        builds.fixed_files(tmp_path / name)
        found.append(gcc.digest(tmp_path / name))
    assert found[0] == expected != found[1], (expected, found)


def test_a_digest_is_of_every_recorded_state_and_output_of_every_block() -> None:
    closed = ClosedLoop(load_rig(Path(find("hull")), "pd_nn_fast"))
    columns = closed.columns()
    for role, wiring in closed.nodes.items():
        kinds = {v.name: v.kind for v in wiring.plan.table.variables if v.recorded}
        wanted = {name for name, kind in kinds.items() if kind in ("state", "output")}
        assert {name for name, _ in columns[role]} == wanted
        assert {kinds[name] for name in wanted} == {"state", "output"}, role


def test_a_check_says_which_build_differs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    files = ClosedLoop.files

    def changed(closed: ClosedLoop, cycles: int) -> dict[str, str]:
        found = files(closed, cycles)
        name = "plant_lag.c"
        assert "u->command" in found[name], found[name]
        return found | {name: found[name].replace("u->command", "(1.0 + 1e-13) * u->command")}

    monkeypatch.setattr(ClosedLoop, "files", changed)
    assert main(["generate", "c", "probe", "--check", "--cycles", "40", "-q"]) == 1
    told = capsys.readouterr().out
    assert re.search(r"gcc -O2 +[0-9a-f]{16}  DIFFERS\n", told), told
    assert re.search(r"Python, interpreted +[0-9a-f]{16}  equal\n", told), told
    assert not re.search(r"gcc.* equal", told), told


def test_builds_with_floats_that_disagree_fail(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    digest = builds.Build.digest

    def other(build: builds.Build, folder: Path) -> str:
        return "0" * 16 if build.name == "gcc -O3" else digest(build, folder)

    monkeypatch.setattr(builds.Build, "digest", other)
    assert main(["generate", "c", "probe", "--single", "--check", "--cycles", "9", "-q"]) == 1
    told = capsys.readouterr().out
    assert re.findall(r"(\S+ \S+) +0{16}  DIFFERS\n", told) == ["gcc -O3"], told


@pytest.mark.parametrize("said", ["", "Segmentation fault", "0123456789abcdef and more"])
def test_a_program_that_prints_no_digest_fails(
    said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(builds.Build, "digest", lambda *_: said)
    assert main(["generate", "c", "probe", "--check", "--cycles", "9", "-q"]) == 1
    assert "FAILS: no digest" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "here"), [([], []), (["--single"], []), (["--single"], ["gcc -O0"])]
)
def test_a_check_in_which_no_c_was_compared_is_no_pass(
    words: list[str],
    here: list[str],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(builds.Build, "possible", property(lambda build: build.name in here))
    code = main(["generate", "c", "probe", "--check", "--cycles", "9", "-q", *words])
    told = capsys.readouterr()
    assert code == 4, told
    assert re.fullmatch(r".*no C was compared.*apt install gcc\n", told.err), told.err
    assert told.out.count("not here:") == len(builds.builds()) - len(here), told.out


def test_a_rig_that_records_nothing_is_not_compared(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ClosedLoop, "columns", lambda closed: {"executive": [], "plant": []})
    assert main(["generate", "c", "probe", "--check", "--cycles", "9", "-q"]) == 2
    assert "nothing to be compared" in capsys.readouterr().err


@pytest.mark.parametrize("in_single", [False, True])
@pytest.mark.parametrize("name", [rig.name for rig in shipped_rigs()])
def test_what_a_closed_loop_counts_is_used(name: str, in_single: bool) -> None:
    """Clang warns of, gcc is silent about a variable that is added to and never read."""
    rig = load_rig(Path(find(name)), None)
    settings = [f"losses.{name}.share=0" for name in rig.config.losses]
    text = ClosedLoop(load_rig(rig.path, None, settings), in_single).files(3)["main.c"]
    for body in text.split("static uint32_t clamped;")[1:]:
        assert "(clamped != 0U)" in body.partition("\n}\n")[0], name


@pytest.mark.parametrize("name", ["telerobot-u1", "fuzzy-d01"])
def test_a_loop_of_three_nodes_and_a_slow_one_have_the_digest_of_their_logs(
    name: str, tmp_path: Path
) -> None:
    rig = load_rig(Path(find(name)), None)
    closed = ClosedLoop(rig)
    write(closed.files(90), tmp_path)
    builds.fixed_files(tmp_path)
    gcc = next(build for build in builds.builds() if build.name == "gcc -O0")
    assert gcc.digest(tmp_path) == digest_of(in_memory(rig), closed.columns(), 90)


@pytest.mark.parametrize("written", ["my-motor", "2 carts.new"])
def test_a_folder_may_have_a_name_that_c_does_not_know(written: str, tmp_path: Path) -> None:
    source = TEMPLATE / "cart" if "cart" in written else TEMPLATE
    folder = shutil.copytree(source, tmp_path / written)
    rig = load_rig(folder / "rig.yaml")
    closed = ClosedLoop(rig)
    write(closed.files(200), tmp_path / "c")
    builds.fixed_files(tmp_path / "c")
    gcc = next(build for build in builds.builds() if build.name == "gcc -O0")
    assert gcc.digest(tmp_path / "c") == digest_of(in_memory(rig), closed.columns(), 200)


def test_the_cost_of_a_step_is_counted() -> None:
    build = next(one for one in builds.builds() if one.name.startswith("Cortex-M7"))
    if not build.possible:
        pytest.skip(f"no Cortex-M7 here: {build.cure}")
    rig = load_rig(Path(find("probe")), None)
    instructions, stack = step_cost(rig, "Cortex-M7", 20)
    assert 10 <= instructions <= 60, instructions  # three loads, a product, a store; twice a call
    assert 0 < stack <= 256, stack


def test_a_folder_that_is_a_file_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "there").write_text("")
    assert main(["generate", "c", "pd", "-o", str(tmp_path / "there")]) == 2
    assert "is not a folder; choose another folder" in capsys.readouterr().err


def test_the_program_of_a_closed_loop_has_no_warning_as_c_of_every_kind(tmp_path: Path) -> None:
    files = ClosedLoop(load_rig(Path(find("probe")), None)).files(3)
    sources = write(files, tmp_path)
    builds.fixed_files(tmp_path)
    done = subprocess.run(
        ["gcc", *elementary.FLAGS, *WARNINGS, "-Wshadow=local", "-fsyntax-only", *sources],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_a_build_that_must_refuse_and_gives_other_bits_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    joins = builds.Build("joins", ("cc",), (), (), "", refuses=True)
    monkeypatch.setattr(builds, "builds", lambda: [joins])
    monkeypatch.setattr(builds.Build, "digest", lambda *_: "0" * 16)
    (row,) = builds.table(tmp_path, [("Python", lambda: "1" * 16)])[1]
    assert row.wrong and row.verdict == "DIFFERS", row


@pytest.mark.parametrize(
    ("compiler", "runner", "cure"),
    [((), None, "get cc; get qemu"), (("cc",), None, "get qemu"), ((), (), "get cc")],
)
def test_a_build_names_only_what_this_machine_lacks(
    compiler: tuple[str, ...], runner: tuple[str, ...] | None, cure: str
) -> None:
    assert builds.Build("it", compiler, (), runner, "get cc", "get qemu").cure == cure
