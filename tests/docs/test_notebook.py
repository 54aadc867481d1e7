"""The notebook of docs/examples runs from its first cell to its last, and is stored without what that brings."""

import json

import pytest

from .markdown import ROOT

NOTEBOOK = ROOT / "docs/examples/first_touch.ipynb"
FIGURES = 5
PATIENCE_S = 1200
"""A cell that takes so long is stuck, however busy the machine is."""


def test_the_notebook_is_stored_without_outputs_which_would_go_stale():
    cells = [cell for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert len(cells) > 5
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells)


@pytest.mark.slow
@pytest.mark.process
def test_every_cell_runs_and_the_figures_are_drawn():
    nbclient = pytest.importorskip("nbclient", reason="running a notebook needs the extra 'notebook'")
    nbformat = pytest.importorskip("nbformat", reason="running a notebook needs the extra 'notebook'")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    where = {"metadata": {"path": str(NOTEBOOK.parent)}}
    nbclient.NotebookClient(notebook, timeout=PATIENCE_S, resources=where).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert sum("image/png" in output.get("data", {}) for output in outputs) == FIGURES
