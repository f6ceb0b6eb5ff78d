"""A study's result as JSON: every kind of number that a study has, and none that is no number."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pcpc.plants.pages import sheet
from pcpc.tools.study.result import Result


@dataclass(frozen=True)
class Part:
    """A data class within."""

    size: float


class Made(Result):
    """A result of every kind."""

    name = "made"

    def facts(self) -> Mapping[str, Any]:
        return {
            "scalar": np.float64(0.1), "flag": np.bool_(True), "count": np.int64(3),
            "array": np.array([[1.0, math.nan], [math.inf, 0.1]]), "part": Part(math.nan),
            "tuple": (1, "a"), "none": None, "nan": math.nan,
        }  # fmt: skip

    def lines(self) -> Iterator[str]:
        yield from ("a", "", "b", "")

    def pictures(self) -> Mapping[str, Figure]:
        return {"seen": sheet((1.0, 1.0), 50)[0]}


def test_every_kind_of_number_is_json_and_what_is_none_is_null(tmp_path: Path) -> None:
    found = Made().json()
    assert found == {
        "scalar": 0.1, "flag": True, "count": 3, "array": [[1.0, None], [None, 0.1]],
        "part": {"size": None}, "tuple": [1, "a"], "none": None, "nan": None,
    }  # fmt: skip
    assert Made().save(tmp_path / "new" / "folder") == tmp_path / "new" / "folder"
    assert json.loads((tmp_path / "new/folder/made.json").read_text("utf-8")) == found
    assert (tmp_path / "new/folder/seen.png").read_bytes().startswith(b"\x89PNG")


def test_a_text_ends_in_one_line_end() -> None:
    assert Made().text() == "a\n\nb\n"
