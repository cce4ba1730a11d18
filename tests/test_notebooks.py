"""Notebooks of docs/notebooks run, and are stored with the outputs of such a run."""

import pytest

nbformat = pytest.importorskip("nbformat", reason="extra docs is missing")
pytest.importorskip("ipykernel", reason="extra docs is missing")

from tools.notebooks import running  # noqa: E402

TEXTS = {
    "first_flight": (" robots that arrive in both, the current costs ", "32 robots, columns:"),
    "own_planner": ("{'reached': ", "'collision_static': "),
}
"""What the outputs of each notebook have to say."""


def outputs_of(notebook):
    return [output for cell in notebook.cells for output in cell.get("outputs", ())]


def texts_of(notebook):
    return "".join(output.get("text", "") for output in outputs_of(notebook))


def test_each_notebook_is_tested():
    assert {path.stem for path in running.list_notebooks()} == set(TEXTS)


@pytest.mark.parametrize("path", running.list_notebooks(), ids=lambda path: path.stem)
def test_outputs_are_stored(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code)
    assert not [output for output in outputs_of(notebook) if output.output_type == "error"]
    assert all(text in texts_of(notebook) for text in TEXTS[path.stem])


@pytest.mark.parametrize("path", running.list_notebooks(), ids=lambda path: path.stem)
def test_a_notebook_runs(path):
    notebook = running.run_notebook(path)  # raises where a cell does
    assert all(text in texts_of(notebook) for text in TEXTS[path.stem])
