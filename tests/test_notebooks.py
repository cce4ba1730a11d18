"""Notebooks of docs/notebooks run, and are stored with the outputs of such a run.

One of them runs daily, the others nightly. Daily of all: their stored outputs, the files that they
write, their command lines (commands/test_parsed.py), and names and arguments of what cells call.
"""

import re
from types import SimpleNamespace

import numpy as np
import pytest

nbformat = pytest.importorskip("nbformat", reason="extra docs is missing")
pytest.importorskip("ipykernel", reason="extra docs is missing")

from IPython.core.inputtransformer2 import TransformerManager  # noqa: E402

from angler_mjx.errors import ConfigError  # noqa: E402
from angler_mjx.files import read_toml  # noqa: E402
from angler_mjx.learning.datasets.generation import read_request  # noqa: E402
from angler_mjx.studies.benchmark.problem_settings import read_benchmark  # noqa: E402
from angler_mjx.studies.fleet_size.conditions import read_study  # noqa: E402
from tests.notebook_names import find_faults  # noqa: E402
from tools.notebooks import running  # noqa: E402

TEXTS = {
    "first_flight": (" robots that arrive in both, the current costs ", "32 robots, columns:"),
    "fleet_size": ("robots (95 %: ", "runs/survey/page.md"),
    "learned_policy": (" examples to train with, ", "priority: 16 of 16 teams all arrived"),
    "on_ardusub": ("ArduSub's own estimate is ", "robot 3 ("),
    "own_planner": ("{'reached': ", "'collision_static': "),
    "own_vehicle": ("surge at full thrust", "mass 9 kg, net buoyancy +0 kg", " of 16 arrive"),
}
"""What the outputs of each notebook have to say."""
DAILY = "first_flight"
"""Notebook that runs daily: its program is that of the README."""
READERS = {
    "survey.toml": read_study,
    "crossing.toml": lambda path: read_request(path, 64),
    "unseen.toml": read_benchmark,
}
"""What reads the TOML files that cells write."""


def outputs_of(notebook):
    return [output for cell in notebook.cells for output in cell.get("outputs", ())]


def texts_of(notebook):
    return "".join(output.get("text", "") for output in outputs_of(notebook))


def written_by(notebook):
    """Return the files that cells write, by name."""
    cells = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    written = [cell.split("\n", 1) for cell in cells if cell.startswith("%%writefile ")]
    return {first.split()[1]: text for first, text in written}


def code_of(notebook):
    """Return the Python of the cells, with magics as calls."""
    transform = TransformerManager().transform_cell
    cells = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    return "\n".join(transform(cell) for cell in cells if not cell.startswith("%%"))


def read(path):
    return nbformat.read(path, as_version=4)


def each_notebook():
    return pytest.mark.parametrize("path", running.list_notebooks(), ids=lambda path: path.stem)


def test_each_notebook_is_tested():
    assert {path.stem for path in running.list_notebooks()} == set(TEXTS)


@each_notebook()
def test_outputs_are_stored(path):
    notebook = read(path)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code)
    assert not [output for output in outputs_of(notebook) if output.output_type == "error"]
    assert all(text in texts_of(notebook) for text in TEXTS[path.stem])
    text = path.read_text(encoding="utf-8")
    assert not re.search("/(tmp|home/|root)", text)  # folders of the machine that ran it
    assert "\\u001b" not in text  # colours, and moves of a cursor


@each_notebook()
def test_a_badge_opens_the_notebook_in_colab(path):
    title, _, badge, *_ = read(path).cells[0].source.split("\n")
    assert title.startswith("# ")
    assert badge.endswith(f"{running.REPOSITORY}/blob/main/docs/notebooks/{path.name})")
    install = next(cell for cell in read(path).cells if cell.cell_type == "code").source
    assert "%pip install --quiet" in install


def test_a_badge_replaces_another():
    notebook = read(running.FOLDER / "first_flight.ipynb")
    before = notebook.cells[0].source
    running.set_badge(notebook, "first_flight")
    assert notebook.cells[0].source == before
    running.set_badge(notebook, "other")
    assert notebook.cells[0].source == before.replace("first_flight.ipynb", "other.ipynb")


@each_notebook()
def test_names_and_arguments_of_cells_are_there(path):
    notebook = read(path)
    assert find_faults(code_of(notebook)) == []
    for name, text in written_by(notebook).items():
        if name.endswith(".py"):
            assert find_faults(text) == []


def test_a_wrong_name_or_argument_is_found():
    begin = "import angler_mjx as angler\nfrom angler_mjx.testing import check_planner\n"
    assert find_faults(begin + "angler.load_scenario('x', worlds=3)\ncheck_planner(A, b)") == []
    assert find_faults(begin + "angler.Simulater") == ["angler.Simulater: is not there"]
    (fault,) = find_faults(begin + "angler.rollout(s, oot='x')")
    assert fault.startswith("angler.rollout: ")
    assert len(find_faults("from angler_mjx.testing import nothing")) == 1


@each_notebook()
def test_files_that_cells_write_are_read(path, tmp_path):
    files = written_by(read(path))
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    for name in files:
        if name.endswith(".toml"):
            READERS[name](tmp_path / name)
            key = next(iter(read_toml(tmp_path / name)))
            (tmp_path / name).write_text(files[name].replace(key, f"{key}_x", 1))
            with pytest.raises(ConfigError):
                READERS[name](tmp_path / name)


def test_the_learned_policy_flies_to_the_goal(tmp_path):
    """With a network of zeros and without noise it flies straight on, at the problem's speed."""
    text = written_by(read(running.FOLDER / "learned_policy.ipynb"))["cloned.py"]
    module = {"__file__": str(tmp_path / "cloned.py")}
    exec(compile(text, "cloned.py", "exec"), module)
    sizes = (109, 8, 8, 3)
    zeros = {f"b{i}": np.zeros(n) for i, n in enumerate(sizes[1:])}
    zeros |= {f"w{i}": np.zeros(sizes[i : i + 2]) for i in range(3)}
    np.savez(tmp_path / "weights.npz", **zeros)
    occupied = np.zeros((8, 8, 8), bool)
    occupied[4] = True
    team = SimpleNamespace(
        start_m=np.array([[1.0, 1.0, 1.0], [1.0, 6.0, 6.0]]),
        goal_m=np.array([[1.0, 9.0, 1.0], [4.0, 6.0, 6.0]]),
        cruise_speed_mps=np.array([0.5, 0.25]),
    )
    grid = SimpleNamespace(occupied=occupied, origin_m=np.zeros(3), cell_m=1.5)
    problem = SimpleNamespace(grid=grid, team=team, points=16, seed=0)
    module["Cloned"].noise = 0.0
    cloned, straight = (module[name]().plan(problem) for name in ("Cloned", "Straight"))
    for path, same, goal_m, time_s in zip(cloned, straight, team.goal_m, (16, 12), strict=True):
        np.testing.assert_allclose(path.position_m[-1], goal_m)
        assert path.time_s[-1] == pytest.approx(time_s)
        np.testing.assert_allclose(path.position_m, same.position_m)
    rock = module["Rock"](occupied, grid.origin_m, grid.cell_m)
    assert rock(np.array([[6.75, 5.0, 5.0], [5.25, 5.0, 5.0]])) == pytest.approx([0, 1.5])


def list_runs():
    nightly = pytest.mark.nightly(by="the tests above: outputs, names, arguments, files, commands")
    return [
        pytest.param(path, marks=() if path.stem == DAILY else nightly, id=path.stem)
        for path in running.list_notebooks()
    ]


@pytest.mark.parametrize("path", list_runs())
def test_a_notebook_runs(path):
    if reason := running.reason_to_skip(path):
        pytest.skip(reason)
    notebook = running.run_notebook(path)  # raises where a cell does
    assert all(text in texts_of(notebook) for text in TEXTS[path.stem])


def test_a_notebook_without_its_program_is_skipped(monkeypatch, tmp_path):
    monkeypatch.setenv("ANGLER_ARDUSUB", str(tmp_path / "none"))
    assert "none" in running.reason_to_skip(running.FOLDER / "on_ardusub.ipynb")
    assert running.reason_to_skip(running.FOLDER / "first_flight.ipynb") is None
