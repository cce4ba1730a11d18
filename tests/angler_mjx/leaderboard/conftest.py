"""Problem files of three sets, written once."""

import pytest

from angler_mjx.leaderboard import problem_files, problem_sets
from angler_mjx.progress import Progress

SETS = ("open-still-known-01", "open-ocean-known-01")


@pytest.fixture(scope="session")
def benchmark():
    return problem_sets.load_benchmark()


@pytest.fixture(scope="session")
def sets(benchmark):
    return {entry.name: entry for entry in problem_sets.list_problem_sets(benchmark)}


@pytest.fixture(scope="session")
def manifest():
    return problem_files.public_manifest()


@pytest.fixture(scope="session")
def problems(tmp_path_factory, benchmark, sets, manifest):
    """Folder of the public problems of two sets, which have to be the frozen ones."""
    out = tmp_path_factory.mktemp("problems") / "angler_1"
    chosen = [sets[name] for name in SETS]
    problem_files.write_problem_files(benchmark, chosen, out, Progress(), frozen=manifest)
    return out
