"""Controllers that are like others: what is taken over, what rules, and where mistakes stand."""

from pathlib import Path
from typing import Any

import pytest
from places import ROOT

from pcpc.executive.errors import RigError
from pcpc.executive.rig import yamlfile
from pcpc.executive.rig.inheritance import inherit_entries
from pcpc.executive.rig.reading import load_rig

RIG = """\
controllers:
  pd: {law: pd, parameters: {kv: 110.0, lam: 16.0}, lockstep_only: why}
  fast: {like: pd, law: fast, parameters: {mode: 74.0}, inputs: {strain: rx.strain}}
  net: {like: pd, law: net, parameters: {lam: 17.0, kappa: 0.01}, lockstep_only: null}
  both: {like: [net, fast], parameters: {kappa: null}}
"""


def resolved(folder: Path, text: str = RIG) -> yamlfile.Document:
    file = folder / "rig.yaml"
    file.write_text(text)
    document = yamlfile.load(file)
    inherit_entries(document)
    return document


def test_own_values_rule_then_the_last_name_and_null_takes_away(tmp_path: Path) -> None:
    controllers: Any = resolved(tmp_path).data["controllers"]
    assert controllers["fast"] == {
        "law": "fast", "parameters": {"mode": 74.0, "kv": 110.0, "lam": 16.0},
        "inputs": {"strain": "rx.strain"}, "lockstep_only": "why",
    }  # fmt: skip
    assert controllers["net"] == {
        "law": "net",
        "parameters": {"lam": 17.0, "kappa": 0.01, "kv": 110.0},
    }
    assert controllers["both"] == {
        "law": "fast", "parameters": {"mode": 74.0, "kv": 110.0, "lam": 16.0},
        "inputs": {"strain": "rx.strain"}, "lockstep_only": "why",
    }  # fmt: skip


def test_what_is_taken_over_keeps_its_place(tmp_path: Path) -> None:
    document = resolved(tmp_path)
    for path, line in (("both.parameters.mode", 3), ("both.parameters.kv", 2), ("both.law", 3)):
        assert document.where(f"controllers.{path}").startswith(f"{tmp_path}/rig.yaml:{line}:")


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("like: pdd", "controllers.x.like: no controller pdd; did you mean pd"),
        ("like: 3", "controllers.x.like: expected the name of a controller, or a list of names"),
        ("like: [pd, [x]]", "controllers.x.like: expected the name of a controller"),
        ("like: x", "the controllers build on each other: x -> x"),
        ("like: y", "the controllers build on each other: "),
    ],
)
def test_a_wrong_like_is_told_with_its_place(tmp_path: Path, entry: str, said: str) -> None:
    with pytest.raises(RigError) as refused:
        resolved(tmp_path, f"{RIG}  x: {{{entry}}}\n  y: {{like: x}}\n")
    assert said in str(refused.value) and "rig.yaml:" in str(refused.value), refused.value


def test_a_mistyped_like_is_told(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(
        f"base: {ROOT}/plants/atb1000/rigs/hull.yaml\ncontrollers: {{mine: {{lik: pd}}}}\n"
    )
    with pytest.raises(RigError, match=r"controllers\.mine\.lik: unknown key; did you mean like"):
        load_rig(tmp_path / "rig.yaml")


def test_a_setting_on_the_command_line_is_of_the_chosen_controller_alone() -> None:
    file = ROOT / "plants/atb1000/rigs/hull.yaml"
    kv = {
        name: load_rig(file, name, ["controller.kv_Nms_rad=99.0"]).config.controllers
        for name in ("pd", "pd_nn_fast")
    }
    assert kv["pd"]["pd"].parameters["kv_Nms_rad"] == 99.0
    assert kv["pd"]["pd_nn_fast"].parameters["kv_Nms_rad"] == 110.0
    assert kv["pd_nn_fast"]["pd"].parameters["kv_Nms_rad"] == 110.0
