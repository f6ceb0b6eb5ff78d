"""A package that is missing is named before any work is done, by every command that needs one."""

import sys
from pathlib import Path

import pytest
from processes import pcpc

from pcpc.tools.cli import main

SWEEP = "a sweep needs {}: pip install 'pcpc[sweep]'"


@pytest.mark.parametrize(
    ("module", "words", "said"),
    [
        ("scipy.optimize", "fit hull log.mcap", "a fit needs scipy: pip install 'pcpc[sweep]'"),
        ("matplotlib.figure", "fit hull log.mcap", "a fit needs matplotlib: pip install"),
        ("matplotlib.figure", "margin hull -o margins", "-o: a figure needs matplotlib: "),
        ("matplotlib.figure", "log plot log.mcap -o a.png", "a picture needs matplotlib: "),
        ("matplotlib.figure", "log animate log.mcap -o a.gif", "a film needs matplotlib: "),
        ("PIL", "log animate log.mcap -o a.gif", "a film needs PIL: pip install 'pcpc[plot]'"),
        ("pyarrow", "log export log.mcap -o a.parquet", "Parquet needs pyarrow: pip install"),
        ("matplotlib.figure", "report log.mcap", "a report needs matplotlib: pip install"),
        ("matplotlib.figure", "bounds hull --plot a.png", "--plot a.png: a picture needs "),
        ("matplotlib.figure", "bus hull --plot a.png", "--plot a.png: a picture needs "),
        ("matplotlib.figure", "jitter --plot a.png", "--plot a.png: a picture needs "),
        ("matplotlib.figure", "experiment tuning", "tuning: its figures need matplotlib: "),
        ("matplotlib.figure", "compare --against HEAD -o a", "-o a: its figures need matplotlib"),
        ("fmpy", "generate fmu hull", "an FMU needs fmpy: pip install 'pcpc[fmu]'"),
        ("distributed", "sweep hull --scheduler local", "--scheduler needs distributed: pip "),
        ("cma", "sweep hull", SWEEP.format("cma")),
        ("pyarrow", "sweep merge a b", SWEEP.format("pyarrow")),
        ("scipy.special", "sweep rerun a 1 pd", SWEEP.format("scipy")),
        ("uvicorn", "host", "the page needs uvicorn: pip install 'pcpc[web]'"),
    ],
)  # fmt: skip
def test_it_is_named_first(
    module: str, words: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
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
    what = "a sweep needs scipy: pip install 'pcpc[sweep]' (nor this)\n"
    assert (done.code, done.out, done.err) == (4, "", what), done
