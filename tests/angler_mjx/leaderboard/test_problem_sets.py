"""The frozen benchmark: its sets, their names and seeds."""

import hashlib
from collections import Counter
from pathlib import Path

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.leaderboard import problem_sets
from angler_mjx.world.config import resolve_world

ROOT = Path(__file__).parents[3]


def test_there_are_300_problems_in_140_sets(sets):
    assert len(sets) == 140
    assert sum(entry.problems for entry in sets.values()) == 300
    assert sum(entry.problems * entry.robots for entry in sets.values()) == 4040
    assert Counter(entry.environment for entry in sets.values()) == dict.fromkeys(
        ("open", "reef", "dense", "corridor"), 35
    )
    assert not any(
        entry.condition == "still" and entry.information == "observed" for entry in sets.values()
    )


def test_every_environment_condition_and_level_has_equally_many_problems(sets):
    problems = Counter()
    for entry in sets.values():
        problems[entry.environment, entry.condition, entry.information] += entry.problems
    assert set(problems.values()) == {15}
    assert len(problems) == 20


def by_definition(secret, text):
    """HMAC-SHA256 as RFC 2104 writes it."""
    key = secret.ljust(64, b"\0")
    inner = hashlib.sha256(bytes(k ^ 0x36 for k in key) + text).digest()
    return hashlib.sha256(bytes(k ^ 0x5C for k in key) + inner).digest()


@pytest.mark.parametrize("secret", [b"", b"sixteen bytes of it"])
def test_a_seed_is_the_first_31_bits_of_the_hmac(benchmark, secret):
    digest = by_definition(secret, b"ANGLER-1 1.0/reef-still-known-04/3")
    expected = int("".join(f"{byte:08b}" for byte in digest)[:31], 2)
    assert problem_sets.derive_seed(benchmark, "reef-still-known-04", secret, 3) == expected


def test_seeds_of_all_sets_differ_so_that_no_known_problem_tells_an_observed_one(benchmark, sets):
    seeds = {problem_sets.derive_seed(benchmark, name, b"", 0) for name in sets}
    assert len(seeds) == len(sets)


@pytest.mark.parametrize(
    ("patterns", "count"),
    [
        ((), 140),
        (("reef-still-known-04",), 1),
        (("reef-04",), 5),
        (("1",), 20),
        (("reef-4", "reef-04"), 5),
        (("open", "observed-64"), 41),
    ],
)
def test_sets_are_selected_by_parts_of_their_names(benchmark, patterns, count):
    assert len(problem_sets.select_problem_sets(benchmark, patterns)) == count


@pytest.mark.parametrize("pattern", ["rif", "reef-05", "still-observed"])
def test_a_name_that_fits_no_set_is_refused(benchmark, pattern):
    with pytest.raises(ConfigError, match=f"--sets '{pattern}'.*open or reef"):
        problem_sets.select_problem_sets(benchmark, (pattern,))


def test_scenarios_have_the_team_the_level_and_the_water_of_their_names(benchmark, sets):
    entry = sets["dense-moving-observed-16"]
    scenario = problem_sets.build_scenario(benchmark, entry, 5)
    assert (len(scenario.members()), scenario.worlds, scenario.seed) == (16, 2, 5)
    assert scenario.world.preset == "dense"
    assert scenario.world.obstacles.dynamic.count == 12
    information = scenario.planner.information
    assert (information.obstacles, information.current) == ("observed", "observed")
    assert scenario.planner.deadline_s == 16.0
    assert scenario.time.record_hz == pytest.approx(1 / scenario.time.control_dt_s)
    still = problem_sets.build_scenario(benchmark, sets["dense-still-known-16"], 5)
    assert still.world.currents == ()
    assert resolve_world(still.world).obstacles.dynamic.count == 0
    assert still.planner.information.current == "truth"


def test_the_page_states_the_tiers_of_the_file(benchmark):
    page = (ROOT / "docs" / "reference" / "angler_1.md").read_text(encoding="utf-8")

    def row(name):
        lines = [line for line in page.splitlines() if line.startswith(f"| {name} |")]
        line = next(line for line in lines if line.count("|") == 1 + 1 + len(benchmark.team))
        return [float(cell) for cell in line.strip("|").split("|")[1:]]

    assert row("robots") == [tier.robots for tier in benchmark.team]
    assert row("problems of a set") == [tier.problems for tier in benchmark.team]
    assert row("planning time for a problem, s") == [tier.limit_s for tier in benchmark.team]
    assert f'benchmark = "{benchmark.title}"' in page
