"""Names in the field's words: no retired word of docs/reference/glossary.md, no twin classes."""

import ast
import io
import re
import tokenize
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("angler_mjx", "kernels/angler_kernels", "sitl_bridge/angler_sitl")
OTHER_FOLDERS = ("experiments/angler_experiments", "tools")
TEST_FOLDERS = (
    "tests/angler_mjx/learning",
    "tests/angler_mjx/robot/sensing",
    "tests/angler_mjx/robot/vehicles",
    "tests/angler_mjx/runs/session",
    "tests/angler_mjx/runs/simulator",
    "tests/commands",
    "tests/experiments",
    "tests/folders",
    "tests/kernels",
    "tests/tools",
)
"""Folders of tests without retired words; the names of tests themselves are sentences."""

RETIRED = frozenset(
    [
        "aboard",
        "admission",
        "air",
        "anew",
        "ask",
        "asked",
        "asking",
        "claim",
        "claims",
        "contestant",
        "draw",
        "drawn",
        "drew",
        "faces",
        "given",
        "harvest",
        "helm",
        "hurry",
        "knowing",
        "known",
        "knows",
        "mine",
        "minds",
        "own",
        "place",
        "placed",
        "places",
        "radio",
        "said",
        "says",
        "share",
        "shares",
        "swimmer",
        "tell",
        "telling",
        "told",
        "wave",
        "waves",
        "way",
        "ways",
    ]
)

KEPT = {
    "Draw": "Pillow's name",
    "ImageDraw": "Pillow's name",
    "ask": "the ask-and-tell interface of optimisers",
    "asked": "a key of stored comparisons",
    "tell": "the ask-and-tell interface of optimisers; Progress, which callers implement",
    "way_points": "angler_mjx.way_points, which callers import",
    "waves": "of the sea and of sound",
    "well_known": "rosbags' name",
    "column_shares": "Rerun's name",
    "row_shares": "Rerun's name",
    "active_share": "a column of stored speed rows",
    "fault_known": "a field of sim.fleet.Variant",
    "share": "a key of stored comparisons",
    "share_p": "a key of stored comparisons",
    "split_shares": "a key of dataset.json",
    "thrust_share": "a key of planners' tables",
    "variation_known": "a field of sim.fleet.Variant",
}
"""Names that hold a retired word, each with the reason."""

KEPT_IN = {
    "experiments/angler_experiments/learned_planner": {
        "draw": "a key of the planner's table",
        "own": "an array of stored examples and weights",
        "told": "a flag of evaluate arrivals",
    },
    "tests/angler_mjx/learning": {
        "given": "of Hypothesis",
        "own": "an array of stored examples and weights",
    },
    "tests/experiments/learned_planner": {"own": "an array of stored examples and weights"},
    "tests/kernels": {"given": "of Hypothesis"},
    "tools/gpu_check": {"asked": "a function of the tests"},
}
"""Names that hold a retired word in one folder alone."""


def sources(folders=PACKAGES):
    """Every module of the folders, but that of names of before."""
    for package in folders:
        for path in sorted((ROOT / package).rglob("*.py")):
            if path.name != "_moved.py":
                yield path


def words(name):
    """Words of a name in snake_case or CamelCase, in lower case."""
    parts = re.findall(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+", name)
    return {part.lower() for part in parts}


def retired(text):
    """Names of a module's text that hold a retired word."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    names = {token.string for token in tokens if token.type == tokenize.NAME}
    return {name for name in names if words(name) & RETIRED}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("told = 1", {"told"}),
        ("def f(most_known_m): ...", {"most_known_m"}),
        ("class ToldState: ...", {"ToldState"}),
        ("always, weather = 'told', drawbridge", set()),
    ],
)
def test_a_retired_word_is_seen_in_names_alone(text, found):
    assert retired(text) == found


def files_by_retired_name(folders):
    found = defaultdict(set)
    for path in sources(folders):
        for name in retired(path.read_text(encoding="utf-8")):
            found[name].add(str(path.relative_to(ROOT)))
    return found


def test_no_name_holds_a_retired_word():
    found = files_by_retired_name(PACKAGES)
    assert {name: files for name, files in found.items() if name not in KEPT} == {}
    assert set(KEPT) <= set(found), "these are gone: take them out of KEPT"


def test_no_name_of_experiments_tools_and_tests_holds_a_retired_word():
    found = files_by_retired_name(OTHER_FOLDERS + TEST_FOLDERS)
    for folder, names in KEPT_IN.items():
        for name in names:
            assert any(file.startswith(folder) for file in found[name]), "gone from KEPT_IN"
            found[name] = {file for file in found[name] if not file.startswith(folder)}
    assert {
        name: files
        for name, files in found.items()
        if files and name not in KEPT and name[:5] != "test_"
    } == {}


def test_no_module_is_called_by_a_retired_word():
    assert [path for path in sources() if words(path.stem) & RETIRED] == []


def test_no_two_public_classes_share_a_name():
    modules = defaultdict(list)
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                modules[node.name].append(str(path.relative_to(ROOT)))
    assert {name: paths for name, paths in modules.items() if len(paths) > 1} == {}
