"""The tool that puts faults into the code: which it chooses, what it runs, what it makes of it."""

import contextlib
import json
import os
import shutil
import subprocess
import textwrap
from pathlib import Path

import pytest

from tools.mutants import mutant_list, pytest_plugin, relevance, report, trials
from tools.mutants.trees import PytestRun, StoppedError, WorkerTree

CODE = '''
"""Ten is 10."""

from dataclasses import dataclass
import jax.numpy as jnp

type Number = int | float


@dataclass(frozen=True)
class Row:
    """A row."""

    size: int | None = 3

    def __repr__(self):
        return f"{self.size + 1} of {2 * 5}"


def least(a: int | float, *, b: int) -> int | None:
    if a < b:
        raise ValueError(f"{a} is less than {b - 7} by {b - a}", 8)
    for x, y in zip([a], [b], strict=True):
        a = x + y
    return jnp.where(a > 0, jnp.minimum(a, b), -b)
'''


@pytest.fixture
def tree(tmp_path):
    """A project of three modules and their tests."""
    files = {
        "angler_mjx/__init__.py": "",
        "angler_mjx/rooms/__init__.py": "",
        "angler_mjx/rooms/low.py": CODE,
        "angler_mjx/rooms/high.py": "from angler_mjx.rooms import low\n",
        "angler_mjx/rooms/alone.py": "SIZE = 3\n",
        "tests/angler_mjx/rooms/conftest.py": "from angler_mjx.rooms import used\n",
        "angler_mjx/rooms/used.py": "SIZE = 4\n",
        "tests/angler_mjx/rooms/test_used.py": "from angler_mjx.rooms import used\n",
        "tests/angler_mjx/rooms/helper.py": "from angler_mjx.rooms.alone import SIZE\n",
        "tests/angler_mjx/rooms/test_low.py": "from angler_mjx.rooms.low import least\n",
        "tests/angler_mjx/rooms/test_high.py": "import angler_mjx.rooms.high\n",
        "tests/angler_mjx/rooms/test_alone.py": "from .helper import SIZE\n",
        "tests/test_all.py": "from angler_mjx.rooms.low import least\n",
    }
    for name, text in files.items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return tmp_path


def test_relevant_are_those_that_import_a_module_the_nearest_first(tree):
    imports = relevance.ImportGraph(tree)
    low, high, everything = (
        f"tests/{name}.py"
        for name in ("angler_mjx/rooms/test_low", "angler_mjx/rooms/test_high", "test_all")
    )
    far = imports.measure_distances("angler_mjx/rooms/low.py")
    assert far == {low: 1, everything: 1, high: 2}
    seconds = {low: 9.0, high: 1.0, everything: 2.0}
    # At first hand before at second, and beside the module before elsewhere.
    assert imports.rank_tests("angler_mjx/rooms/low.py", seconds) == [low, everything, high]
    assert imports.rank_tests("angler_mjx/rooms/low.py", seconds, 1) == [low]
    assert imports.rank_tests("angler_mjx/rooms/low.py", {high: 1.0}) == [high]
    # Through a helper beside the test.
    assert imports.measure_distances("angler_mjx/rooms/alone.py") == {
        "tests/angler_mjx/rooms/test_alone.py": 1
    }
    # What a conftest imports may not be used: farther than what the test names itself.
    used = imports.measure_distances("angler_mjx/rooms/used.py")
    assert used.pop("tests/angler_mjx/rooms/test_used.py") == 1
    assert set(used.values()) == {2}
    assert len(used) == 3


def sampled(tree, seed=0, count=1000):
    positions = pytest.importorskip("tools.mutants.positions", reason="needs the extra `mutants`")
    return positions.sample(tree, ["angler_mjx/rooms"], count, seed)


def test_every_place_that_a_test_should_judge_is_a_mutant_and_no_other(tree):
    found = {(one.line, one.operator.split("_")[0]) for one in sampled(tree)}
    lines = CODE.splitlines()
    at = {lines[line - 1].strip(): operator for line, operator in found if line > 1}
    assert at.keys() == {
        "size: int | None = 3",
        "if a < b:",
        "for x, y in zip([a], [b], strict=True):",
        "a = x + y",
        "return jnp.where(a > 0, jnp.minimum(a, b), -b)",
    }
    assert sum(line == len(lines) for line, _ in found) == 5
    assert {operator for line, operator in found if line == len(lines)} == {
        *("SwapWhere", "SwapTwin", "NumberReplacer"),
        *("ReplaceComparisonOperator", "ReplaceUnaryOperator"),
    }


def test_a_sample_is_that_of_its_seed_and_every_mutant_is_one_fault(tree):
    first, again = sampled(tree, seed=1, count=4), sampled(tree, seed=1, count=4)
    assert first == again
    assert [one.name for one in first] != [one.name for one in sampled(tree, seed=2, count=4)]
    for one in sampled(tree):
        before = (tree / one.file).read_text().splitlines()
        after = one.code.splitlines()
        compile(one.code, one.file, "exec")
        assert sum(a != b for a, b in zip(before, after, strict=True)) == 1


def test_where_takes_the_other_branch(tree):
    code = [one.code for one in sampled(tree) if one.operator == "SwapWhere"]
    assert len(code) == 1
    assert "jnp.where(jnp.logical_not(a > 0), jnp.minimum(a, b), -b)" in code[0]


class Played:
    """A tree whose tests end as told."""

    def __init__(self, root, ends):
        self.root, self.ends, self.held = root, ends, []

    def replace_file(self, file, code):
        self.held.append(file)
        return contextlib.nullcontext()

    def run_tests(self, files, limit_s):
        return self.ends[tuple(files)]


PASSED = PytestRun(code=0, seconds=1.0, failed="")
FAILED = PytestRun(code=1, seconds=1.0, failed="tests/b.py::test_b")
STOPPED = PytestRun(code=None, seconds=1.0, failed="")


@pytest.mark.parametrize(
    ("ends", "outcome", "by", "tried", "left"),
    [
        ({("a", "b"): FAILED}, "caught", FAILED.failed, ("a", "b"), 1),
        ({("a", "b"): PASSED, ("c",): FAILED}, "caught", FAILED.failed, ("a", "b", "c"), 0),
        ({("a", "b"): PASSED, ("c",): STOPPED}, "stuck", "", ("a", "b", "c"), 0),
        ({("a", "b"): PASSED, ("c",): PASSED}, "survived", "", ("a", "b", "c"), 0),
    ],
)
def test_files_are_run_nearest_first_until_one_fails(tree, ends, outcome, by, tried, left):
    one = Faulty("angler_mjx/rooms/low.py")
    seconds = {"a": 10.0, "b": 20.0, "c": 200.0}
    result = trials.try_mutant(Played(tree, ends), one, list(seconds), seconds, 100.0)
    assert (result.outcome, result.by, result.tried, result.left) == (outcome, by, tried, left)


def test_no_file_is_begun_when_the_time_is_up(tree):
    one = Faulty("angler_mjx/rooms/low.py")
    result = trials.try_mutant(Played(tree, {}), one, ["a"], {"a": 1.0}, 0.0)
    assert (result.outcome, result.left) == ("survived", 1)


class Faulty:
    """As much of a mutant as a try needs."""

    def __init__(self, file):
        self.name, self.file, self.line = "abc", file, 3
        self.operator, self.diff, self.code = "Swap", "- a\n+ b", "x = 1\n"


def test_a_cut_line_is_no_result_and_the_next_stands_on_its_own(tmp_path):
    file = tmp_path / "results.jsonl"
    book = trials.MutantLog(file)
    book.write({"mutant": "a"})
    file.write_bytes(file.read_bytes() + b'{"mutant": "b", "outc')
    trials.MutantLog(file).write({"mutant": "c"})
    assert [row["mutant"] for row in trials.read_rows(file)] == ["a", "c"]


class Worker:
    """A tree as far as sharing goes."""

    def __init__(self):
        self.done, self.stopped = [], False

    def stop(self):
        self.stopped = True


def test_work_is_shared_and_an_error_ends_it():
    trees = [Worker(), Worker()]
    trials.run_all(trees, range(20), lambda tree, one: tree.done.append(one))
    assert sorted(trees[0].done + trees[1].done) == list(range(20))
    assert not trees[0].stopped

    def fail(tree, one):
        if one == 1:
            raise ValueError(one)
        tree.done.append(one)

    with pytest.raises(ValueError, match="1"):
        trials.run_all([one := Worker()], range(50), fail)
    assert one.stopped


def test_the_share_is_that_of_wilson():
    # Wilson 1927 for 8 of 10: 0.490 to 0.943 (as in R's prop.test without correction).
    p, low, high = report.caught_fraction(8, 10)
    assert (p, low, high) == pytest.approx((0.8, 0.4902, 0.9433), abs=1e-4)


DIFF = "--- f\n+++ f\n@@ -1 +1 @@\n-    a = 1\n+    a = 2\n"


def test_equivalent_mutants_do_not_count_and_survivors_are_shown(tmp_path):
    rows = [
        {"mutant": str(i), "file": f"a/b/{name}.py", "line": 1, "operator": "N", "diff": DIFF}
        | {"outcome": outcome, "by": "", "seconds": 1.0, "tried": ["t"], "left": 0}
        for i, (name, outcome) in enumerate(
            [("x", "caught"), ("x", "stuck"), ("y", "survived"), ("z", "survived")]
        )
    ]
    file = tmp_path / "equivalent.toml"
    file.write_text(
        textwrap.dedent(
            '''
            [[equivalent]]
            file = "a/b/y.py"
            why = "a is not used"
            diff = """
            - a = 1
            + a = 2
            """
            '''
        )
    )
    text = report.format_report(["a/b", "a/c"], rows, 2, report.read_equivalents(file))
    assert "| a/b | 4 | 1 | 1 | 1 | 1 | 66.7 %" in text.replace("%", " %")
    assert "| a/c | 0 | 0 | 0 | 0 | 0 |  |" in text
    assert "a/b/z.py:1" in text
    assert "a/b/y.py:1" not in text
    assert "2 of the sample not tried yet" in text


LOW = "angler_mjx/rooms/low.py"
ZIP = """\
--- angler_mjx/rooms/low.py
+++ angler_mjx/rooms/low.py
@@ -21,5 +21,5 @@
     if a < b:
         raise ValueError(f"{a} is less than {b - 7} by {b - a}", 8)
-    for x, y in zip([a], [b], strict=True):
+    for x, y in zip([], [b], strict=True):
         a = x + y
     return jnp.where(a > 0, jnp.minimum(a, b), -b)"""
SUM = """\
--- angler_mjx/rooms/low.py
+++ angler_mjx/rooms/low.py
@@ -23,3 +23,3 @@
     for x, y in zip([a], [b], strict=True):
-        a = x + y
+        a = x - y
     return jnp.where(a > 0, jnp.minimum(a, b), -b)"""


def stored_list(folder, *diffs, file=LOW):
    row = {"room": "angler_mjx/rooms", "commit": "c", "seed": 0, "file": file, "line": 1}
    rows = [row | {"operator": "Any", "diff": diff} for diff in diffs]
    path = folder / "list.jsonl"
    path.write_text("".join(json.dumps(one) + "\n" for one in rows))
    return path


@pytest.mark.skipif(shutil.which("patch") is None, reason="needs patch")
def test_a_stored_mutant_is_what_patch_makes_of_its_diff(tree, tmp_path):
    """Lines were put above it, and one of its context was edited, since it was stored."""
    path = tree / LOW
    path.write_text("SIZE = 2\n\n" + path.read_text().replace("if a < b:", "if b > a:"))
    loaded = mutant_list.load_list(tree, stored_list(tmp_path, ZIP, SUM))
    assert [one.line for one in loaded.mutants] == [25, 26]
    assert loaded.rooms == ("angler_mjx/rooms",)
    assert not loaded.gone
    for one, diff in zip(loaded.mutants, (ZIP, SUM), strict=True):
        made = tmp_path / "made.py"
        shutil.copy(path, made)
        subprocess.run(["patch", "-s", made], input=diff + "\n", text=True, check=True)
        assert one.code == made.read_text()
        assert (one.file, one.operator) == (LOW, "Any")
    assert len({one.name for one in loaded.mutants}) == 2


@pytest.mark.parametrize(
    ("old", "new"),
    [
        pytest.param("a = x + y", "a = y + x", id="edited"),
        pytest.param(
            "-b)\n", "-b)\n\n\ndef twin(x, y):\n    if x:\n        a = x + y\n", id="same"
        ),
    ],
)
def test_a_row_is_gone_when_its_lines_do_not_stand_once(tree, tmp_path, old, new):
    path = tree / LOW
    text = path.read_text().replace(old, new)
    # Without its context and moved, the line has to be the only one of its text.
    path.write_text(
        "\n" + text.replace("strict=True", "strict=False").replace("return jnp", "return  jnp")
    )
    loaded = mutant_list.load_list(tree, stored_list(tmp_path, SUM))
    assert loaded.gone == [f"{LOW}:1"]
    assert not loaded.mutants


def test_a_row_whose_lines_stand_twice_is_that_of_the_line_that_was_stored(tree, tmp_path):
    path = tree / LOW
    text = path.read_text()
    path.write_text(text + text[text.index("def least") :])
    assert [
        one.line for one in mutant_list.load_list(tree, stored_list(tmp_path, SUM)).mutants
    ] == [24]


def test_a_row_of_a_removed_file_is_gone_and_in_no_count(tree, tmp_path):
    loaded = mutant_list.load_list(tree, stored_list(tmp_path, SUM, file="angler_mjx/rooms/old.py"))
    text = report.format_report(loaded.rooms, [], len(loaded.mutants), {}, loaded.gone)
    assert "1 of the list gone, in no count: angler_mjx/rooms/old.py:1." in text
    assert "| all | 0 |" in text
    assert "not tried yet" not in text


@pytest.mark.parametrize(
    ("text", "folders", "message"),
    [
        ("{", None, "list.jsonl:1: not JSON"),
        ('{"room": "a"}', None, "list.jsonl:1: 'file' is missing"),
        (None, ["angler_mjx/nowhere"], "no row of angler_mjx/nowhere"),
    ],
)
def test_a_list_that_cannot_be_read_is_refused(tree, tmp_path, text, folders, message):
    path = stored_list(tmp_path, SUM)
    if text is not None:
        path.write_text(text)
    with pytest.raises(mutant_list.ListError, match=message):
        mutant_list.load_list(tree, path, folders)


@pytest.mark.parametrize(
    ("name", "rooms", "count"),
    [("ten_rooms", 10, 200), ("arms_and_kernels", 11, 116), ("doors_and_grips", 5, 96)],
)
def test_the_stored_lists_of_the_project_are_read(name, rooms, count):
    root = Path(__file__).parents[2]
    loaded = mutant_list.load_list(root, root / f"tools/mutants/samples/{name}.jsonl")
    assert len(loaded.rooms) == rooms
    assert len(loaded.mutants) + len(loaded.gone) == count
    assert len(loaded.gone) < count / 2


TEST_SIZE = """
import os

import angler_mjx.runs


def test_size():
    assert os.sched_getaffinity(0) == {{{core}}}
    assert not os.path.exists("runs")
    assert angler_mjx.SIZE == 3
"""


@pytest.mark.nightly(by="the other tests of this file, of places and of what is written there")
def test_a_copy_runs_its_own_code_and_is_put_back(tmp_path):
    """A fault of the same length, put in within the clock's resolution, is what runs."""
    root, core = tmp_path / "root", min(os.sched_getaffinity(0))
    files = {
        "angler_mjx/__init__.py": "SIZE = 3\n",
        **{f"{folder}/empty.py": "" for folder in ("kernels", "sitl_bridge", "experiments")},
        "tools/mutants/__init__.py": "",
        "tools/mutants/pytest_plugin.py": Path(pytest_plugin.__file__).read_text(),
        "pyproject.toml": "[tool.pytest.ini_options]\naddopts = ['--import-mode=importlib']\n"
        "markers = ['gpu', 'sitl']\n",
        "tests/test_size.py": TEST_SIZE.format(core=core),
        "angler_mjx/runs/__init__.py": "",
        "runs/demo/results.parquet": "",
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    copy = WorkerTree(root, tmp_path / "copy", tmp_path / "xla", [core])
    assert copy.run_tests(["tests/test_size.py"], 60.0).has_passed
    with copy.replace_file("angler_mjx/__init__.py", "SIZE = 4\n"):
        ran = copy.run_tests(["tests/test_size.py"], 60.0)
        assert (ran.code, ran.failed) == (1, "tests/test_size.py::test_size")
        assert copy.run_tests(["tests/test_size.py"], 0.01).code is None
    assert copy.run_tests(["tests/test_size.py"], 60.0).has_passed
    copy.stop()
    with pytest.raises(StoppedError):
        copy.run_tests(["tests/test_size.py"], 60.0)
    assert (root / "angler_mjx/__init__.py").read_text() == "SIZE = 3\n"
