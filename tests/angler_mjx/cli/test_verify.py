"""`angler verify`: what it prints, and how it exits."""

import json
import subprocess
import sys

import pytest

from angler_mjx.cli.main import main
from angler_mjx.testing import referee

from ..testing.hand_made import edit_rows, write
from ..testing.test_referee_rules import into_a_rock, to_a_goal


@pytest.fixture
def run(tmp_path):
    return write(tmp_path / "run", to_a_goal(), worlds=3)


def verify(*arguments):
    """Exit code of the command."""
    try:
        main(["verify", *map(str, arguments)])
    except SystemExit as end:
        return end.code or 0
    return 0


def test_a_run_that_agrees_exits_with_0(run, capsys):
    assert verify(run) == 0
    out = capsys.readouterr().out
    assert out.rstrip().endswith("outcomes: 3 of 3 worked out anew\nagrees")
    assert "3 worlds, 3 robots" in " ".join(out.split())


def test_what_does_not_agree_is_named_and_exits_with_1(run, capsys):
    edit_rows(run, 1, 0, path_length_m=2.0)
    assert verify(run) == 1
    out = capsys.readouterr().out
    assert "world 1 robot 0 path_length_m: stored 2, judged 0.72" in out
    assert "1.27 apart, 0.01 allowed" in out
    assert "does not agree: 1 finding" in out
    capsys.readouterr()
    assert verify(run, "--worlds", "0,2") == 0


def test_json_holds_counts_and_all_differences(run, capsys):
    edit_rows(run, 2, 0, energy_j=1.0, outcome="timeout")
    assert verify(run, "--json") == 1
    said = json.loads(capsys.readouterr().out)
    assert not said["agrees"]
    assert said["counts"]["energy_j"]["disagrees"] == 1
    assert {one["quantity"] for one in said["differences"]} >= {"energy_j", "outcome"}
    assert all(one["world"] == 2 for one in said["differences"])


def test_a_sparse_run_is_inconclusive_and_says_what_was_checked(tmp_path, capsys):
    path = write(tmp_path / "run", into_a_rock(), every=4, worlds=3)
    assert verify(path) == 3
    out = " ".join(capsys.readouterr().out.split())
    assert "every 4 control steps" in out
    reason = "(what was between the samples is not known)"
    assert f"outcomes: 0 of 3 worked out anew, 3 held against bounds {reason}" in out
    assert out.endswith("inconclusive: nothing disagrees, but no outcome could be worked out anew")
    assert verify(path, "--json") == 3
    said = json.loads(capsys.readouterr().out)
    assert (said["conclusion"], said["agrees"]) == ("inconclusive", False)
    assert said["counts"]["outcome"]["why"] == {"what was between the samples is not known": 3}
    why = {"robots that have failed are stored at rest": 3}
    assert said["counts"]["impact_speed_mps"]["why"] == why


def test_a_conclusion_counts_the_outcomes_that_were_worked_out(tmp_path):
    verdict = referee.judge(write(tmp_path / "run", to_a_goal(), worlds=2))
    assert verdict.conclusion == "agrees"
    outcomes = verdict.counts["outcome"]
    for exact, undecided, conclusion in (
        (2, 0, "agrees"),
        (1, 0, "agrees in part"),
        (1, 1, "inconclusive"),
        (0, 0, "inconclusive"),
    ):
        outcomes.exact, outcomes.bounded, outcomes.undecided = exact, 2 - exact, undecided
        assert verdict.conclusion == conclusion
        assert verdict.agrees is (conclusion != "inconclusive")
    verdict.counts["energy_j"].disagrees = 1
    assert verdict.conclusion == "disagrees"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "not a run folder"),
        (("--worlds", "9"), "holds worlds 0 to 2"),
        (("--worlds", "x"), "give indices with commas"),
    ],
)
def test_what_cannot_be_judged_exits_with_2(arguments, words, run, tmp_path, capsys):
    assert verify(run if arguments else tmp_path / "nothing", *arguments) == 2
    assert words in capsys.readouterr().err


def test_neither_jax_nor_the_simulator_is_loaded(run):
    program = (
        "import sys; from angler_mjx.testing import referee; "
        f"assert referee.judge({str(run)!r}).agrees; "
        "own = ('angler_mjx.sim', 'angler_mjx.robot', 'angler_mjx.runs', 'angler_kernels');"
        "own += ('jax', 'mujoco', 'pydantic');"
        "print([name for name in sys.modules if name.startswith(own)])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr
