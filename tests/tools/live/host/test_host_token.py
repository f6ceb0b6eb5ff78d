"""The token of a host: kept for its user, and for nobody else."""

from pathlib import Path

from pcpc.tools.live.host import guard


def test_it_stays_until_another_is_asked_for(tmp_path: Path) -> None:
    environment = {"XDG_STATE_HOME": str(tmp_path)}
    first = guard.token_of(environment)
    assert guard.token_of(environment) == first and len(first) >= 32
    assert guard.token_of(environment, anew=True) != first


def test_one_that_others_may_have_read_is_used_no_more(tmp_path: Path) -> None:
    environment, path = {"XDG_STATE_HOME": str(tmp_path)}, tmp_path / "pcpc" / "host-token"
    first = guard.token_of(environment)
    path.chmod(0o640)
    second = guard.token_of(environment)
    assert second != first and guard.token_of(environment) == second
    assert path.stat().st_mode & 0o777 == 0o600


def test_no_link_and_no_short_word_is_taken_for_one(tmp_path: Path) -> None:
    environment, path = {"XDG_STATE_HOME": str(tmp_path)}, tmp_path / "pcpc" / "host-token"
    other = tmp_path / "of somebody"
    other.write_text("x" * 32)
    other.chmod(0o600)
    path.parent.mkdir()
    path.symlink_to(other)
    assert guard.token_of(environment) != "x" * 32
    assert other.read_text() == "x" * 32 and not path.is_symlink()
    path.write_text("short")
    assert len(guard.token_of(environment)) >= 32


def test_without_a_place_for_it_it_lasts_as_long_as_the_server(tmp_path: Path) -> None:
    (tmp_path / "pcpc").write_text("a file where the folder would be")
    environment = {"XDG_STATE_HOME": str(tmp_path)}
    assert guard.token_of(environment) != guard.token_of(environment)
