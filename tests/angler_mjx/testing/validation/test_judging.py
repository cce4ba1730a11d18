"""A number that got worse is caught and named; what is only rounding is not."""

import json
import math
import shutil
from pathlib import Path

import pytest

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError
from angler_mjx.testing.validation import page, terms
from angler_mjx.testing.validation import validate as all_of_it
from angler_mjx.testing.validation.judging import find_faults
from angler_mjx.testing.validation.results import (
    Expected,
    MeasuredDeviations,
    TermResult,
    ValidationResult,
    read_model,
)
from angler_mjx.testing.validation.terms import RegressionTolerance

ROOT = Path(__file__).parents[4]
ABOUT = {
    "versions": {"jax": "1"},
    "python": "3.12",
    "platform": "somewhere",
    "cpu_count": 2,
    "backend": "cpu",
    "device": "cpu",
    "commit": "abcdef0123456",
    "processor": "A Processor",
    "at_utc": "2026-01-02T03:04:05+00:00",
}
TERMS = """
[worse.rounding]
factor = 10.0
floor = 1e-3
reason = "order of summation"
[worse.scheme]
factor = 1.05
floor = 0.0
reason = "no rounding in it"
[worse.count]
factor = 1.0
roots = 3.0
floor = 0.0
reason = "a count"
[[term]]
key = "a.rounding"
part = "terms"
what = "one"
reference = "another"
unit = "m"
reason = "why"
worse = "rounding"
test = "tests/test_a.py::test_one"
quick = true
[[term]]
key = "a.scheme"
part = "energy"
what = "two"
reference = "another"
unit = "J"
reason = "why"
worse = "scheme"
test = "tests/test_a.py::test_two"
[[study]]
name = "study"
module = "nowhere"
"""
PAGE = "".join(
    f"before {name}\n<!-- validation:{name} begin -->\nold\n<!-- validation:{name} end -->\n"
    for name in (*page.TERM_PARTS, "study", "speed")
)


def measured(rounding=1e-13, scheme=0.1):
    values = {"a.rounding": (rounding, 1e-11), "a.scheme": (scheme, 0.2)}
    rows = [
        {"key": key, "value": value, "bound": bound, "tests": ["tests/test_a.py::test_x"]}
        for key, (value, bound) in values.items()
    ]
    return {"about": ABOUT, "deviations": rows}


def study(count=4.0):
    numbers = {"robots": {"value": count, "unit": "robots", "worse": "count"}}
    return TermResult.model_validate({"about": ABOUT, "numbers": numbers, "text": "| a study |"})


@pytest.fixture
def root(tmp_path):
    """A checkout with two terms, expectations of both and of a study, and a page."""
    folder = tmp_path / "docs" / "validation"
    folder.mkdir(parents=True)
    (folder / "terms.toml").write_text(TERMS)
    (tmp_path / page.PAGE_PATH).parent.mkdir()
    (tmp_path / page.PAGE_PATH).write_text(PAGE)
    (tmp_path / "benchmarks").mkdir()
    shutil.copy(ROOT / "benchmarks" / "results.jsonl", tmp_path / "benchmarks")
    at = {"at_utc": ABOUT["at_utc"], "commit": "0123456789"}
    values = {"a.rounding": 1e-13, "a.scheme": 0.1, "study.robots": 4.0}
    held = {key: {"value": value, **at} for key, value in values.items()}
    (folder / "expected.json").write_text(json.dumps({"numbers": held}))
    return tmp_path


def run(root, found, **asked):
    path = root / "measured.json"
    path.write_text(json.dumps(found))
    request = all_of_it.ValidationRequest(measured=path, **asked)
    return all_of_it.run_validation(request, root, lambda line: None)


def test_what_is_as_expected_is_well(root):
    assert run(root, measured(), check=True)[:-1] == []


@pytest.mark.parametrize(
    ("found", "key", "words"),
    [
        (measured(scheme=0.106), "a.scheme", "got worse: 0.106, expected 0.1, allowed 0.105"),
        (measured(rounding=1.1e-12), "a.rounding", "got worse: 1.1e-12"),
        (measured(scheme=0.21), "a.scheme", "exceeds its bound of 0.2"),
        (measured(rounding="nan"), "a.rounding", "is nan"),
    ],
)
def test_a_number_that_got_worse_is_named(root, found, key, words):
    run(root, measured())
    (fault,) = run(root, found, check=True)
    assert fault.key == key
    assert words in fault.message
    if "expected" in words:
        assert "J; tests/test_a.py::test_x" in fault.message
        assert "2026-01-02, commit 012345678" in fault.message


def test_rounding_may_move_and_the_scheme_may_get_better(root):
    run(root, measured())
    assert run(root, measured(rounding=9e-13, scheme=0.01), check=True) == []


def test_an_expectation_that_is_broken_on_purpose_is_caught(root):
    run(root, measured())
    path = root / "docs" / "validation" / "expected.json"
    held = json.loads(path.read_text())
    held["numbers"]["a.scheme"]["value"] /= 2
    path.write_text(json.dumps(held))
    assert [fault.key for fault in run(root, measured(), check=True)] == ["a.scheme"]


def test_a_term_that_no_test_measured_is_named(root):
    found = measured()
    del found["deviations"][1]
    run(root, measured())
    (fault,) = run(root, found, check=True)
    assert fault.key == "a.scheme"
    assert "tests/test_a.py::test_two" in fault.message


def test_a_quick_run_does_without_the_long_tests(root):
    found = measured()
    del found["deviations"][1]
    run(root, measured())
    assert run(root, found, check=True, quick=True) == []


def test_what_is_no_term_is_named(root):
    found = measured()
    found["deviations"].append({**found["deviations"][0], "key": "a.stranger"})
    run(root, measured())
    assert [fault.key for fault in run(root, found, check=True)] == ["a.stranger"]


def test_a_count_has_room_for_chance(root):
    here, expected = (
        all_of_it.open_checkout(root),
        read_model(Expected, root / "docs/validation/expected.json"),
    )
    # 4 + 3 sqrt(5) = 10.7.
    for count, caught in ((10.0, False), (11.0, True), (0.0, False)):
        listed = find_faults(here.terms, expected, None, {"study": study(count)}, set())
        assert [fault.key for fault in listed] == ["study.robots"] * caught


def test_what_has_no_expectation_asks_for_one(root):
    (root / "docs" / "validation" / "expected.json").unlink()
    assert all("--store" in fault.message for fault in run(root, measured()))
    assert run(root, measured(), store=True) == []
    run(root, measured())
    assert run(root, measured(), check=True) == []


def test_what_exceeds_its_bound_is_not_stored(root):
    assert [f.key for f in run(root, measured(scheme=0.3), store=True)] == ["a.scheme"]
    held = read_model(Expected, root / "docs/validation/expected.json").numbers
    assert held["a.scheme"].value == 0.1


def test_allowed_is_never_more_than_the_bound():
    worse = RegressionTolerance(factor=10.0, floor=1e-3, reason="")
    assert worse.max_allowed(0.0, 1.0) == 1e-3
    assert worse.max_allowed(0.5, 1.0) == 1.0
    assert worse.max_allowed(0.01, 1.0) == pytest.approx(0.1)
    assert math.isnan(worse.max_allowed(math.nan, None))


def test_the_page_is_written_between_its_marks_alone(root):
    run(root, measured())
    text = (root / "docs" / "generated" / "validation.md").read_text()
    for name in (*page.TERM_PARTS, "study", "speed"):
        assert f"before {name}\n" in text
    assert "old" not in text
    assert "| one | another | m | 1e-11 | 1e-13 | why | `test_a.py::test_one` |" in text
    assert "2026-01-02, A Processor, 2 cores, jax 1, commit abcdef012" in text
    # Twice is once.
    run(root, measured())
    assert (root / "docs" / "generated" / "validation.md").read_text() == text
    kept = read_model(ValidationResult, root / "docs" / "validation" / "validation.json")
    assert set(kept.tests) == {"a.rounding", "a.scheme"}


def test_a_page_that_was_written_by_hand_is_caught(root):
    run(root, measured())
    path = root / "docs" / "generated" / "validation.md"
    path.write_text(path.read_text().replace("| 1e-13 |", "| 1e-14 |"))
    (fault,) = run(root, measured(), check=True)
    assert fault.key == "docs/generated/validation.md"
    assert "--page" in fault.message


def test_check_writes_nothing(root):
    before = {path: path.read_bytes() for path in (root / "docs").rglob("*") if path.is_file()}
    run(root, measured(scheme=0.15), check=True)
    assert before == {p: p.read_bytes() for p in (root / "docs").rglob("*") if p.is_file()}


def test_out_leaves_the_checkout_alone(root, tmp_path):
    run(root, measured(), out=tmp_path / "other")
    assert (root / "docs" / "generated" / "validation.md").read_text() == PAGE
    assert "1e-13" in (tmp_path / "other" / "validation.md").read_text()
    assert read_model(ValidationResult, tmp_path / "other" / "validation.json").tests


def test_rows_measured_at_another_time_say_so(root):
    run(root, measured())
    later = measured()
    later["about"] = {**ABOUT, "at_utc": "2026-02-03T00:00:00+00:00", "commit": "fedcba"}
    terms_file = root / "docs" / "validation" / "terms.toml"
    terms_file.write_text(terms_file.read_text().replace('part = "energy"', 'part = "terms"'))
    del later["deviations"][1]
    run(root, later)
    text = (root / "docs" / "generated" / "validation.md").read_text()
    assert "Measured 2026-02-03" in text
    assert "| 0.1 (1) |" in text
    assert "\n(1) 2026-01-02" in text


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda text: text.replace("<!-- validation:energy end -->", ""), "validation:energy"),
        (lambda text: text + page.part_markers("strange")[0], "strange"),
        (lambda text: text.replace("validation:study", "validation:other"), "other"),
    ],
)
def test_a_page_without_its_marks_is_refused(root, spoil, words):
    path = root / "docs" / "generated" / "validation.md"
    path.write_text(spoil(PAGE))
    with pytest.raises(ConfigError, match=words):
        run(root, measured())


@pytest.mark.parametrize(
    "asked",
    [{"check": True, "store": True}, {"page_only": True}, {"check": True, "page_only": True}],
)
def test_what_does_not_go_together_is_refused(root, asked):
    with pytest.raises(ConfigError, match="leave out"):
        run(root, measured(), **asked)


@pytest.mark.parametrize("text", ["{", "[]", '{"deviations": []}'])
def test_a_file_that_is_no_measurement_is_named(root, text):
    path = root / "measured.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"measured\.json"):
        read_model(MeasuredDeviations, path)


def test_an_installed_package_says_what_it_needs(monkeypatch, tmp_path):
    monkeypatch.setattr(terms, "__file__", str(tmp_path / "a" / "b" / "terms.py"))
    with pytest.raises(ConfigError, match="needs a checkout"):
        terms.find_checkout()


def test_the_command_ends_with_one_and_names_the_number(root, monkeypatch, capsys):
    monkeypatch.setattr(terms, "find_checkout", lambda: root)
    path = root / "measured.json"
    path.write_text(json.dumps(measured(scheme=0.15)))
    with pytest.raises(SystemExit) as left:
        main(["validate", "--from", str(path)])
    assert left.value.code == 1
    assert "a.scheme: got worse: 0.15, expected 0.1" in capsys.readouterr().out
