"""Run the notebook and write it with what it printed and drew: `make notebook`."""

import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

NOTEBOOK = Path(__file__).resolve().parents[1] / "notebooks" / "first_steps.ipynb"
PLAIN = 4  # version of the format


def executed() -> Any:
    """Return the notebook after a run in an empty folder, without what differs each time."""
    notebook = nbformat.read(NOTEBOOK, PLAIN)
    with tempfile.TemporaryDirectory() as folder:
        where = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=600, coalesce_streams=True, resources=where).execute()
    for cell in notebook.cells:
        cell.pop("id", None)  # drawn anew each time
        cell.metadata.clear()
        if cell.cell_type == "code":
            cell.outputs = [one for one in cell.outputs if one.get("name") != "stderr"]
    return notebook


if __name__ == "__main__":
    nbformat.write(executed(), NOTEBOOK)
