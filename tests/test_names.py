"""Names in the field's words: no retired word (docs/glossary.md), no two public classes of one."""

import ast
import io
import re
import tokenize
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("angler_mjx", "kernels/angler_kernels", "sitl_bridge/angler_sitl")

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
    "ask": "the ask-and-tell interface of optimisers",
    "tell": "the ask-and-tell interface of optimisers; Progress, which callers implement",
    "way_points": "angler_mjx.way_points, which callers import",
    "waves": "of the sea and of sound",
    "well_known": "rosbags' name",
    "column_shares": "Rerun's name",
    "row_shares": "Rerun's name",
    "active_share": "a column of stored speed rows",
    "draw": "a flag of angler control",
    "fault_known": "a key of scenario files",
    "known": "a key of scenario files",
    "places": "a key of scenario files",
    "places_m": "a key of scenario files",
    "share": "a key of stored comparisons",
    "share_p": "a key of stored comparisons",
    "split_shares": "a key of dataset.json",
    "thrust_share": "a key of planners' tables",
    "variation_known": "a key of stored variants",
}
"""Names that hold a retired word, each with the reason."""


def sources():
    """Every module of the packages, but that of names of before."""
    for package in PACKAGES:
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


def test_no_name_holds_a_retired_word():
    found = defaultdict(set)
    for path in sources():
        for name in retired(path.read_text(encoding="utf-8")):
            found[name].add(str(path.relative_to(ROOT)))
    assert {name: files for name, files in found.items() if name not in KEPT} == {}
    assert set(KEPT) <= set(found), "these are gone: take them out of KEPT"


def test_no_module_is_called_by_a_retired_word():
    assert [path for path in sources() if words(path.stem) & RETIRED] == []


def test_no_two_public_classes_share_a_name():
    modules = defaultdict(list)
    for path in sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                modules[node.name].append(str(path.relative_to(ROOT)))
    assert {name: paths for name, paths in modules.items() if len(paths) > 1} == {}
