"""The commands of the repository: wrong words and places are told as those of `pcpc`."""

import subprocess
import sys
from pathlib import Path

import pytest

from pcpc.tools.dev.bench.options import COMMAND as BENCH
from pcpc.tools.dev.command import main
from pcpc.tools.dev.evidence import report
from pcpc.tools.dev.evidence.options import COMMAND as EVIDENCE
from pcpc.tools.dev.evidence.options import SOAK
from pcpc.tools.terminal.command import Command

ODD = "nan", "-1", "0", "inf"
HOURS = "expected hours, above 0"
SEED = "--seed: expected a whole number from 0 to"


@pytest.mark.parametrize(
    ("command", "words", "said"),
    [
        (BENCH, "cycle --rounds 0", "pcpc.tools.dev.bench --rounds: expected a positive"),
        (BENCH, "cycle --rounds 99999", "pcpc.tools.dev.bench --rounds: expected at most"),
        (BENCH, "cycel", "cycel: no such suite; did you mean cycle?"),
        (EVIDENCE, "matrx", "matrx: no such part; did you mean matrix?"),
        (EVIDENCE, "frames --seed -1", SEED),
        (SOAK, "probe --seed -1", SEED),
        *((EVIDENCE, f"alarms --hours={one}", HOURS) for one in (*ODD, "1e300", "two")),
        *((SOAK, f"probe --hours={one}", HOURS) for one in (*ODD, "")),
    ],
)
def test_a_wrong_word_is_told_in_a_line(
    command: Command, words: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command, words.split()) == 2
    out, err = capsys.readouterr()
    assert out == "" and said in err and err.count("\n") == 1, err


def test_evidence_that_cannot_be_written_is_told_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file/below", Path("/proc/evidence")):
        assert main(EVIDENCE, ["matrix", "-o", str(folder)]) in (2, 4)
        out, err = capsys.readouterr()
        assert out == "" and str(folder) in err and "part 1" not in err, err
        assert err.count("\n") == 1, err


def test_the_page_of_faults_is_what_its_numbers_make(tmp_path: Path) -> None:
    docs = Path(__file__).resolve().parents[3] / "docs"
    page = report.write(tmp_path, report.read(docs))
    assert page.read_bytes() == (docs / report.PAGE).read_bytes()


@pytest.mark.parametrize("name", ["bench", "evidence", "evidence.soak"])
def test_its_help_names_it(name: str) -> None:
    words = [sys.executable, "-P", "-m", f"pcpc.tools.dev.{name}", "--help"]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0 and f"usage: python -m pcpc.tools.dev.{name} " in done.stdout, done
