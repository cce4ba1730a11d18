"""The terms of this checkout: every key is recorded by the test it names, and the reverse."""

import re
from pathlib import Path

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.testing.validation import page, running, terms
from angler_mjx.testing.validation.terms import Terms

ROOT = Path(__file__).parents[4]
CALL = re.compile(r'deviation(?:\.close)?\(\s*(?:deviation, )?f?"([a-z0-9_.{}\[\]]+)"')


@pytest.fixture(scope="module")
def held():
    return terms.read_terms(ROOT)


def sources():
    return {
        path.relative_to(ROOT).as_posix(): path.read_text()
        for path in (ROOT / "tests").rglob("test_*.py")
        if "validation" not in path.parts
    }


def test_every_term_names_a_test_that_is_there(held):
    found = sources()
    for term in held.term:
        file, _, name = term.test.partition("::")
        assert file in found, term.key
        assert f"def {name}(" in found[file] if name else True, term.test
        # The key or its beginning (keys that are put together) stands in the file.
        stem = term.key.split(".")[0]
        assert f'"{stem}.' in found[file], term.key


def test_every_key_that_a_test_writes_out_is_a_term(held):
    keys = {term.key for term in held.term}
    written = {key for text in sources().values() for key in CALL.findall(text)}
    assert len(written) > 50
    for key in written:
        # A key that is put together: its fixed parts.
        pattern = re.compile(re.sub(r"\\\{.*?\\\}", "[a-z_0-9]+", re.escape(key)) + r"\Z")
        assert any(pattern.match(known) for known in keys), key


def test_keys_are_given_once():
    row = {
        "key": "a",
        "part": "terms",
        "what": "",
        "reference": "",
        "unit": "",
        "reason": "",
        "worse": "w",
        "test": "t",
    }
    kinds = {"w": {"factor": 1.0, "floor": 0.0, "reason": ""}}
    with pytest.raises(ConfigError, match="a: given twice"):
        parse_model(Terms, {"worse": kinds, "term": [row, row]}, source="terms")
    with pytest.raises(ConfigError, match=r"no \[worse"):
        parse_model(Terms, {"worse": kinds, "term": [{**row, "worse": "x"}]}, source="terms")
    both = {**row, "quick": True, "nightly": True}
    with pytest.raises(ConfigError, match="both quick and nightly"):
        parse_model(Terms, {"worse": kinds, "term": [both]}, source="terms")


def test_the_page_has_a_place_for_everything(held):
    text = (ROOT / page.PAGE_PATH).read_text()
    for name in (*page.TERM_PARTS, "speed", *(one.name for one in (*held.study, *held.stored))):
        assert [text.count(mark) for mark in page.part_markers(name)] == [1, 1], name


def test_tests_are_compiled_as_by_make():
    makefile = (ROOT / "Makefile").read_text()
    for flag in running.TEST_XLA_FLAGS.split():
        assert flag in makefile
