"""What is kept of each chunk is on the disk until the end; the file is mcap's own to the byte."""

import tempfile
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from pcpc.executive.log.mcap_writer import BulkWriter, message_records

CHANNELS, EACH = 8, 5


def write(path: Path, chunks: int, indices: Any = None) -> int:
    """Write a log of small chunks; return by how many bytes the memory in use grew meanwhile."""
    writer = BulkWriter(path)
    if indices is not None:
        vars(writer)["_Writer__chunk_indices"] = indices
    writer.start("x")
    ids = [writer.register(f"/t{i}", f"s{i}", "float64 x", "cdr") for i in range(CHANNELS)]
    held = 0
    for k in range(chunks):
        stamps = np.arange(EACH) + EACH * k
        data = np.full((EACH, 16), k % 256, np.uint8)
        for i in ids:
            writer.add([message_records(i, stamps, stamps, data)])
        writer.flush()
        if k == 100:  # from here on all is allocated that does not grow
            tracemalloc.start()
            held = tracemalloc.get_traced_memory()[0]
    grown = tracemalloc.get_traced_memory()[0] - held
    tracemalloc.stop()
    writer.finish()
    writer.file.close()
    return grown


def test_the_file_is_as_mcap_writes_it_and_memory_does_not_grow(tmp_path: Path) -> None:
    usual, ours = write(tmp_path / "usual", 600, []), write(tmp_path / "ours", 600)
    assert (tmp_path / "usual").read_bytes() == (tmp_path / "ours").read_bytes()
    assert usual > 500 * 500 > 10 * ours, "0.9 kB a chunk before"
    with (tmp_path / "ours").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and len(summary.chunk_indexes) == 600


def test_a_folder_that_takes_no_such_file_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "ours", 120)

    def refused(**_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(tempfile, "TemporaryFile", refused)
    write(tmp_path / "memory", 120)
    assert (tmp_path / "memory").read_bytes() == (tmp_path / "ours").read_bytes()
