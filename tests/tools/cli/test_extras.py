"""A package that is missing is named before any work is done, by every command that needs one."""

import re
import shlex
import sys
from pathlib import Path

import pytest
from processes import ROOT, pcpc

from pcpc.drivers.machine import packages
from pcpc.tools.cli import main

PIP = f"{shlex.quote(sys.executable)} -m pip install"
SWEEP = f"a sweep needs {{0}}: {PIP} '{{0}}"


@pytest.mark.parametrize(
    ("module", "words", "said"),
    [
        ("scipy.optimize", "fit hull log.mcap", f"a fit needs scipy: {PIP} 'scipy~=1."),
        ("matplotlib.figure", "fit hull log.mcap", f"a fit needs matplotlib: {PIP} 'matplot"),
        ("matplotlib.figure", "margin hull -o margins", "-o: a figure needs matplotlib: "),
        ("matplotlib.figure", "log plot log.mcap -o a.png", "a picture needs matplotlib: "),
        ("matplotlib.figure", "log plot --moving log.mcap -o a.gif", "a film needs matplotlib: "),
        ("PIL", "log plot --moving log.mcap -o a.gif", f"a film needs PIL: {PIP} pillow\n"),
        ("pyarrow", "log export log.mcap -o a.parquet", f"Parquet needs pyarrow: {PIP} 'pyarrow>="),
        ("asammdf", "log export log.mcap -o a.mf4", f"MDF needs asammdf: {PIP} 'asammdf~="),
        ("matplotlib.figure", "report log.mcap", f"a report needs matplotlib: {PIP} 'matplotlib~="),
        ("matplotlib.figure", "bounds hull --plot a.png", "--plot a.png: a picture needs "),
        ("matplotlib.figure", "bus hull --plot a.png", "--plot a.png: a picture needs "),
        ("matplotlib.figure", "jitter --plot a.png", "--plot a.png: a picture needs "),
        ("matplotlib.figure", "experiment tuning", "tuning: its figures need matplotlib: "),
        ("matplotlib.figure", "compare --against HEAD -o a", "-o a: its figures need matplotlib"),
        ("fmpy", "generate fmu hull", f"an FMU needs fmpy: {PIP} 'fmpy~="),
        ("distributed", "sweep hull --scheduler local", f"--scheduler needs distributed: {PIP}"),
        ("cma", "sweep hull", SWEEP.format("cma")),
        ("pyarrow", "sweep merge a b", SWEEP.format("pyarrow")),
        ("scipy.special", "sweep rerun a 1 pd", SWEEP.format("scipy")),
        ("uvicorn", "host", f"the page needs uvicorn: {PIP} 'uvicorn"),
    ],
)  # fmt: skip
def test_it_is_named_first(
    module: str,
    words: str,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("log.mcap").touch()  # no log at all, which would be said next
    monkeypatch.setitem(sys.modules, module, None)
    assert main(words.split()) == 4
    out, err = capsys.readouterr()
    assert out == "" and err.startswith(said) and err.count("\n") == 1, out + err
    assert [path.name for path in tmp_path.iterdir()] == ["log.mcap"]


def test_a_sweep_without_its_extra_loads_no_compiler(tmp_path: Path) -> None:
    (tmp_path / "cma.py").write_text("raise ImportError('no such thing')\n")
    (tmp_path / "numba.py").write_text("raise AssertionError('the compiler is loaded')\n")
    (tmp_path / "scipy.py").write_text("raise ImportError('nor this')\n")
    done = pcpc("sweep", "hull", environment={"PYTHONPATH": str(tmp_path)})
    what = f"a sweep needs scipy: {PIP} 'scipy~=1.15' (nor this)\n"
    assert (done.code, done.out, done.err) == (4, "", what), done


@pytest.mark.parametrize(
    ("words", "said"),
    [("hull --draws 0", "--draws 0: expected"), ("nix", "nix: no file and no rig of this name"),
     ("hull --threads 0", "--threads 0: expected"),
     ("hull --worst -1", "pcpc sweep --worst: expected")],
)  # fmt: skip
def test_a_sweep_that_its_words_refuse_loads_no_compiler(
    words: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "numba.py").write_text("raise AssertionError('the compiler is loaded')\n")
    done = pcpc("sweep", *words.split(), environment={"PYTHONPATH": str(tmp_path)})
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1), done
    assert done.err.startswith(said), done


def test_run_from_its_sources_it_names_the_packages_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(name: str) -> list[str]:
        raise packages.PackageNotFoundError(name)

    monkeypatch.setattr(packages, "requires", unknown)
    assert packages.pip_install("PIL.Image", "scipy.special", "scipy").endswith(" pillow scipy")


def test_no_hint_installs_a_package_of_the_projects_name() -> None:
    """No index has it: whoever registers the name would get our users."""
    areas = ("drivers", "executive", "plants", "tools", "docs")
    texts = [ROOT / "README.md", *(p for area in areas for p in (ROOT / area).rglob("*.[pm][yd]"))]
    ours = re.compile(r"pip install[^\n]*[ '\"]pcpc\b(?![-/])")
    found = [str(p) for p in texts if ours.search(p.read_text(encoding="utf-8"))]
    assert len(texts) > 700 and not found, found
