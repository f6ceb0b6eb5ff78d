"""`pcpc bounds`: the same of a rig and of its log, exit codes, JSON, a picture, what it refuses."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from json_schemas import holds
from places import ROOT
from processes import pcpc

import pcpc as pcpc_package
from pcpc.drivers.errors import UserError
from pcpc.executive.log import reader as logs
from pcpc.executive.nodes.virtual import simulate
from pcpc.executive.rig.reading import load_rig
from pcpc.plants.lyapunov import Account, Constants, Proof
from pcpc.plants.theorem import NoTheorem
from pcpc.tools.start import rigs
from pcpc.tools.study.bounds import bounds, observed
from pcpc.tools.study.bounds.book import theorems

RIG = ROOT / "plants/friction_arm/rigs/friction-c.yaml"
SHORT = "duration_s=1.5"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a short run."""
    path = tmp_path_factory.mktemp("bounds") / "log.mcap"
    simulate(load_rig(RIG, settings=[SHORT]), path)
    return path


def test_a_log_says_what_its_rig_says(log: Path, tmp_path: Path) -> None:
    """Weights are in no log: they are recomputed."""
    picture = tmp_path / "bounds.png"
    of_log = pcpc("bounds", str(log), "--json", "--plot", str(picture))
    of_rig = pcpc("bounds", "friction-c", "--set", SHORT, "--json")
    assert of_log.code == of_rig.code == 0, of_log
    found = holds("bounds", of_log.out)
    assert found == json.loads(of_rig.out)
    assert found["theorem"] == "Theorem 3.2.2" and found["holds"]
    assert picture.stat().st_size > 20_000


def test_a_violation_ends_with_1_and_is_named() -> None:
    done = pcpc("bounds", "friction-c", "--set", SHORT, "--set", "controller.kappa=0.0")
    assert done.code == 1, done
    assert "VIOLATED   leak kappa above 0: kappa 0" in done.out
    assert max(map(len, done.out.splitlines())) <= 80


def test_a_run_that_dissipates_nothing_has_no_shares() -> None:
    zero, known = np.zeros(4), Constants(1.0, 1.0, 1.0, 0.0)
    proof = Proof("none", "|r|", np.arange(4.0), zero, zero, {"a": zero}, zero, zero, zero, known)
    assert "nan %  a" in str(bounds.Bounds("rig", "pd", Account(proof, 0.0)))


def test_an_infinite_bound_is_not_shown_and_ends_with_1(tmp_path: Path) -> None:
    given = ("--set", "controller.kap1=0.0", "--set", "duration_s=6.0")
    done = pcpc("bounds", "payload-on", *given, "--plot", str(tmp_path / "bounds.png"))
    assert done.code == 1 and (tmp_path / "bounds.png").is_file(), done
    assert "Traceback" not in done.err
    assert "NOT SHOWN  ultimate bound of the error" in done.out
    assert "VIOLATED   beta^2 < 4 Kv |s1|^2 (1 - 1/(4 kap1)), alpha = kap1" in done.out


def test_an_error_outside_its_bound_has_not_settled_and_ends_with_1() -> None:
    """A run that is shorter than the transient: within the level set, but not back in the ball."""
    rig = load_rig(RIG, settings=[SHORT])
    account = bounds.of_rig(rig).account
    error, level = account.own.error, min(account.own.level, account.stated.level)
    for peak, holds_, verdict in (
        (0.99 * error, True, "holds"),
        (0.5 * (error + level), False, "not shown"),
        (1.01 * level, False, "violated"),
    ):
        proof = replace(account.proof, error=np.full_like(account.proof.error, peak))
        own = replace(account, proof=proof)
        check = next(one for one in own.checks() if one.name == "ultimate bound of the error")
        assert (check.holds, check.shown) == (holds_, verdict != "not shown"), check
        assert own.own.error == error and ("not yet within" in check.found) is (
            verdict == "not shown"
        )


def test_a_rate_by_set_is_held_against_the_declared_one() -> None:
    """Also where the rate is none of the law's settings, but follows of one."""
    for given in (
        ("friction-c", "--set", "controller.t_rate=300.0", "--set", SHORT),
        ("suspension-8", "--set", "controller.adaptation_rad_s=600.0", "--set", "duration_s=1.5"),
    ):
        done = pcpc("bounds", *given)
        assert done.code == 1, done
        assert "VIOLATED   weights move as the proof has them move" in done.out, done


def test_a_rate_that_a_log_was_set_to_is_judged_and_told(log: Path, tmp_path: Path) -> None:
    """The log carries the files of its rig, which tell what --set changed."""
    for name, given, told, code in (
        ("friction-c", "t_rate=300.0", "t_rate 300, in the rig 10", 0),
        ("suspension-8", "adaptation_rad_s=600.0", "adaptation_rad_s 600, in the rig 120", 1),
    ):
        settings = [SHORT, f"controller.{given}"]
        path = tmp_path / f"{name}.mcap"
        simulate(load_rig(rigs.find(name), settings=settings), path)
        done = pcpc("bounds", str(path))
        assert f"by --set   {told}: the theorem is judged with" in done.out, done
        assert "holds      weights move as the proof has them move" in done.out, done
        assert done.code == code and max(map(len, done.out.splitlines())) <= 80, done
        assert holds("bounds", pcpc("bounds", str(path), "--json").out)["rates_set"] == [told]
    assert "by --set" not in pcpc("bounds", str(log)).out


def test_where_there_is_no_theorem_a_line_says_so() -> None:
    done = pcpc("bounds", "friction-c", "--controller", "pd", "--set", SHORT)
    assert done.code == 0, done
    assert done.out == (
        "no theorem: none is known here of the law arm_pd; its plant has those of friction_nn\n"
    )


def test_what_it_refuses(log: Path) -> None:
    done = pcpc("bounds", "friction-c", "--as", "friction_n")
    assert done.code == 2 and "did you mean friction_nn" in done.err, done
    done = pcpc("bounds", str(log), "--set", "controller.kappa=0.1")
    assert done.code == 2 and "a log cannot be changed" in done.err, done


@pytest.mark.parametrize("command", ["bounds", "report", "host", "replay"])
@pytest.mark.parametrize("option", ["--law", "--fmu"])
def test_a_file_that_is_not_there_is_refused_also_where_none_is_needed(
    command: str, option: str, log: Path
) -> None:
    for name, what in (("none.py", "no such file"), (".", "is a folder; expected a file")):
        done = pcpc(command, str(log), option, name)
        assert done.code == 2 and f"{option} {name}: {what}" in done.err, done


def test_a_log_whose_description_is_damaged_is_refused(log: Path) -> None:
    head = logs.head(log)
    one = head.node["executive"]
    for gone in ("state_columns", "timing_columns"):
        left = {key: value for key, value in one.description.items() if key != gone}
        damaged = replace(head, node={"executive": replace(one, description=left)})
        with pytest.raises(logs.LogError, match="description of the executive is damaged"):
            observed._Node(damaged, load_rig(RIG), "executive", ())


def test_python_says_the_same(log: Path, tmp_path: Path) -> None:
    found = pcpc_package.bounds(log)
    of_rig = pcpc_package.bounds("friction-c", set={"duration_s": 1.5})
    assert found.holds and found.to_dict() == of_rig.to_dict()
    assert found.draw(tmp_path / "bounds.png").stat().st_size > 20_000
    with pytest.raises(
        pcpc_package.Error, match="no theorem: none is known here of the law arm_pd"
    ):
        pcpc_package.bounds("friction-c", "pd")


def test_a_theorem_of_ones_own_is_found_beside_the_model_or_in_its_book(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = tmp_path / "model.py"
    monkeypatch.setattr(bounds, "model_files", lambda rig: [model])
    for place, law in (("theorem.py", "mine"), ("book/theorem.py", "other")):
        file = tmp_path / place
        file.parent.mkdir(exist_ok=True)
        file.write_text(f"THEOREMS = {{{law!r}: {law!r}}}\n")
    assert bounds.known_theorems(load_rig(RIG)) == {"mine": "mine", "other": "other"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", 'theorem.py: expected THEOREMS = {"law": Theorem(...)} of pcpc.plants.theorem'),
        ("THEOREMS = 3", "theorem.py: expected THEOREMS"),
        ("THEOREMS = {", "theorem.py:1: SyntaxError"),
        ("import nothing_of_that_name", "theorem.py:1: ModuleNotFoundError"),
        ("raise SystemExit(2)", "theorem.py:1: ends the process; it must not"),
        ("THEOREMS = {'friction_nn': 3}", "friction_nn: no Theorem(...) of pcpc.plants.theorem"),
        (
            "from pcpc.plants.theorem import Theorem\n"
            "THEOREMS = {'friction_nn': Theorem(lambda run: 1 / 0)}",
            "theorem.py:2: ZeroDivisionError: division by zero",
        ),
        (
            "from pcpc.plants.theorem import Theorem\n"
            "THEOREMS = {'friction_nn': Theorem(lambda run: run.column('plant:arm.none'))}",
            "plant: no variable arm.none; did you mean",
        ),
    ],
)
def test_a_theorem_of_ones_own_that_is_wrong_is_told_in_a_line(
    text: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "theorem.py").write_text(text)
    monkeypatch.setattr(bounds, "model_files", lambda rig: [tmp_path / "model.py"])
    with pytest.raises(UserError) as told:
        bounds.of_rig(load_rig(RIG, settings=["duration_s=0.1"]))
    assert expected in str(told.value) and "\n" not in str(told.value), told.value


def test_without_the_book_it_says_where_the_proofs_of_shipped_systems_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(bounds, "PLACES", ("theorem.py", "no-book/theorem.py"))
    with pytest.raises(NoTheorem, match="in the repository of pcpc only"):
        bounds.theorem_of(load_rig(RIG))


def test_the_experiment_finds_what_is_mistuned_and_what_is_switched_off() -> None:
    rig = str(RIG.parents[2] / "deadzone_map/rigs/fuzzy-d03.yaml")
    rows = theorems.rows_of((rig, "fuzzy"))
    assert [bool(row.violated) for row in rows] == [False, True, True, True], rows
    off = theorems.rows_of(
        (str(RIG.parents[2] / "backlash_map/rigs/backlash-map.yaml"), "inversion")
    )
    assert len(off) == 1 and off[0].off, off
    text = theorems.report([*rows, *off])
    assert "fuzzy-d03 | fuzzy | theorem of chapter 4.3" in text
    assert "which violates: backlash-map inversion" in text


def test_a_picture_is_drawn_of_each_plant_that_has_a_theorem() -> None:
    plants = {path.parents[1].name for path in theorems.PLANTS.glob("*/book/theorem.py")}
    assert plants == set(theorems.SHOWN)
