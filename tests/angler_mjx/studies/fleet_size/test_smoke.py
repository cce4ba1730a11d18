"""The shipped studies of tasks by their command: too few robots, enough, and what is said."""

import json

import pyarrow.parquet as pq
import pytest

from angler_mjx.cli import main as cli
from angler_mjx.studies.fleet_size import folder

pytestmark = pytest.mark.nightly(
    by="studies/fleet_size/test_running.py; the printed command of commands/test_run.py"
)
ASKED = {"survey_reef": "still water", "delivery_corridor": "still water"}
"""Of each study one condition: others that need programs of their own take as long again."""


def ask(name, out, *more):
    """Ask by the command, as a user does."""
    given = [name, "--smoke", "--only", ASKED[name], "--out", str(out)]
    cli.main(["study", "fleet_size", *given, *more])


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """A function name -> the folder of its study; made once."""
    made = {}

    def of(name):
        if name not in made:
            made[name] = tmp_path_factory.mktemp(name) / name
            ask(name, made[name])
        return made[name]

    return of


@pytest.mark.parametrize("name", ASKED)
def test_one_robot_is_too_few_and_eight_are_enough_as_far_as_four_worlds_tell(asked, name):
    out = asked(name)
    found = folder.read_results(out)
    rows = pq.read_table(out / folder.RESULTS).to_pylist()
    assert [(row["condition"], row["size"], row["world"]) for row in rows] == [
        (ASKED[name], size, world) for size in (1, 8) for world in range(4)
    ]
    alone, eight = rows[:4], rows[4:]
    assert not any(row["no_room"] or row["lost"] for row in rows)
    # One is not done by the end of the horizon, which is later than the deadline.
    assert [row["completed_s"] for row in alone] == [None] * 4
    deadline_s = found["deadline_s"]
    assert all(0.25 * deadline_s < row["completed_s"] <= deadline_s for row in eight)
    assert all(row["arrived"] == 8 for row in eight)
    assert [row["success"] for row in rows] == [False] * 4 + [True] * 4

    (condition,) = found["conditions"]
    answer = condition["answer"]
    # None of four decides that one is too few, all of four does not decide that eight are enough.
    # The sizes between were not flown, so the interval holds them.
    assert (answer["estimate"], answer["low"], answer["high"]) == (8, 2, None)
    assert answer["text"] == "open: 2 or more (95 %) after 8 worlds"
    assert (found["ended"], found["complete"]) == ("max_worlds", True)
    assert answer["text"] in (out / folder.PAGE).read_text()


def test_a_study_that_was_broken_off_is_asked_again_to_the_same_bytes(asked, tmp_path, capsys):
    """Half of it is flown once more, by programs that are compiled once more."""
    name = "delivery_corridor"
    whole, out = asked(name), tmp_path / name
    hidden = out.with_name(f".{name}.partial")
    hidden.mkdir()
    for file in (folder.SOURCE, folder.RESOLVED, folder.ENVIRONMENT):
        (hidden / file).write_bytes((whole / file).read_bytes())
    batches = (whole / "batches.jsonl").read_text().splitlines(keepends=True)
    assert [json.loads(line)["size"] for line in batches] == [1, 8]
    (hidden / "batches.jsonl").write_text(batches[0])
    capsys.readouterr()
    ask(name, out, "--resume", "--json")
    told = json.loads(capsys.readouterr().out)
    assert told["timing"]["compiled"] == 1
    for file in ("batches.jsonl", folder.RESULTS):
        assert (out / file).read_bytes() == (whole / file).read_bytes()
