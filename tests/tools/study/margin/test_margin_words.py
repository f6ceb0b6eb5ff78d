"""`pcpc margin`: words that have no effect, or cannot have one, are refused before the work."""

from pathlib import Path

import pytest

from pcpc.tools.cli import main

GROWS = ["--limit-cycle", "controller.kv_Nms_rad"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--linear", "barrel.gap_rad=0"], "--linear: is of --limit-cycle; name the growing"),
        (["--with", "barrel.gap_rad"], "--with: is of --limit-cycle"),
        (["--factors", "1,2"], "--factors: is of --limit-cycle"),
        ([*GROWS, "--at", "1s"], "--at: is not of --limit-cycle; leave one of them out"),
        ([*GROWS, "--settle", "1s"], "--settle: is not of --limit-cycle"),
        ([*GROWS, "--amplitude", "1"], "--amplitude: is not of --limit-cycle"),
        ([*GROWS, "--lowest", "1Hz"], "--lowest: is not of --limit-cycle"),
        ([*GROWS, "--method", "measured"], "--method: is not of --limit-cycle"),
        ([*GROWS, "--seed", "1"], "--seed: is not of --limit-cycle"),
        (["--seed", "-1"], "seed"),
    ],
)
def test_what_would_have_no_effect_is_refused(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["margin", "slew10", *words]) == 2
    found = capsys.readouterr()
    assert said in found.err and "Traceback" not in found.err and not found.out


@pytest.mark.parametrize("name", ["file", "file/below", "file/far/below"])
@pytest.mark.parametrize("more", [[], GROWS])
def test_a_file_is_no_folder_to_write_to(
    tmp_path: Path, name: str, more: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert main(["margin", "slew10", "-o", str(tmp_path / name), *more]) == 2
    found = capsys.readouterr()
    assert found.err.removeprefix("-o ").startswith(f"{tmp_path / name}: ")
    assert "; choose another folder" in found.err and found.err.count("\n") == 1
    assert not found.out
