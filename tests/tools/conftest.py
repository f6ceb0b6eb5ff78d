"""Fixtures of the commands' tests."""

from collections.abc import Iterator

import pytest
from live_run import Run, going_on
from refusing import refused

__all__ = ["refused", "run"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    """Return a run of this file that goes on."""
    with going_on(tmp_path_factory.mktemp("run")) as made:
        yield made
