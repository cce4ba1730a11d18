"""The page and the figures: what they hold, what they survive, what they refuse."""

import json
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from angler_mjx.errors import ConfigError
from angler_mjx.studies.benchmark.report import page, reading, scenes

from . import synthetic

NASTY = "</script><script>document.title='broken'</script><!-- é & \u2028 @@STYLE@@"


def held(path):
    text = path.read_text(encoding="utf-8")
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)
    return json.loads(found[1])


def test_the_page_asks_nothing_of_any_network(made):
    text = made.read_text(encoding="utf-8")
    assert not re.search(r"https?:|//[a-z]+\.|url\(|@import|\bsrc=|\bhref=|fetch\(|XMLHttp", text)
    assert "default-src 'none'" in text
    assert "@@" not in text


def test_the_numbers_in_the_page_are_those_of_the_table(made):
    table = pq.read_table(made.parent / "runs.parquet").to_pylist()
    data = held(made)
    asked = [row for row in table if row["plan_status"] not in ("closed", "no room")]
    counted = [row for row in table if row["plan_status"] != "no room"]
    assert data["totals"] == {
        "problems": len({(r["scene"], r["robots"], r["problem_seed"], r["world"]) for r in table}),
        "runs": len(table),
        "asked": len(asked),
        "closed": len(counted) - len(asked),
        "no_room": len(table) - len(counted),
    }
    assert len(data["cells"]) == len({(r["planner"], r["scene"], r["robots"]) for r in table})
    for cell in data["cells"]:
        planner, scene = data["planners"][cell["planner"]], data["scenes"][cell["scene"]]
        key = (planner, scene, cell["team"])
        own = [r for r in asked if (r["planner"], r["scene"], r["robots"]) == key]
        given_up = [r for r in counted if r not in asked]
        given_up = [r for r in given_up if (r["planner"], r["scene"], r["robots"]) == key]
        assert (cell["asked"], cell["closed"]) == (len(own), len(given_up))
        for name in ("planned", "success", "flown"):
            assert cell[name] == pytest.approx(np.mean([r[name] for r in own]), rel=5e-5)
        for name in ("planning_s", "makespan_s", "energy_j", "flowtime_s"):
            known = [r[name] for r in own if r[name] is not None]
            assert cell[name] == (pytest.approx(np.median(known), rel=5e-4) if known else None)
    robots = pq.read_table(made.parent / "robots.parquet").to_pylist()
    failed = [row for row in robots if row["outcome"] != "reached"]
    shown = data["failures"]
    assert len(shown["x"]) == shown["total"] == len(failed)
    assert shown["x"] == pytest.approx([row["failure_x_m"] for row in failed], abs=0.006)


def test_problems_are_shared_by_planners_and_by_nothing_else(made, results):
    table = pq.read_table(made.parent / "runs.parquet").to_pylist()
    keys = [(r["scene"], r["robots"], r["problem_seed"], r["world"]) for r in table]
    problem = results.problem.tolist()
    assert len(set(keys)) == len(set(problem)) == len(set(zip(keys, problem, strict=True)))


def test_every_choice_of_scene_and_team_is_in_the_page(made):
    data = held(made)
    scenes, teams = range(-1, len(data["scenes"])), range(-1, len(data["teams"]))
    assert set(data["selections"]) == {f"{scene} {team} -1" for scene in scenes for team in teams}


def test_figures_are_written_and_have_something_on_them(made):
    names = {path.stem for path in (made.parent / "figures").glob("*.png")}
    assert names == {
        "success_by_team",
        "success_by_density",
        "profiles_of_time",
        "profiles_of_cost",
        "planning_time",
        "failures",
        "example_0",
        "example_1",
    }
    for path in (made.parent / "figures").glob("*.png"):
        with Image.open(path) as image:
            assert len(np.unique(np.asarray(image.convert("L")))) > 20


def test_labels_cannot_break_out_of_the_page(tmp_path):
    labels = {"grid": NASTY, "PRM": "$\\frac{$"}
    synthetic.write(
        tmp_path, planners=("grid", "PRM"), presets=("reef",), teams=(2,), worlds=4, labels=labels
    )
    about = json.loads((tmp_path / "about.json").read_text()) | {"name": NASTY}
    (tmp_path / "about.json").write_text(json.dumps(about))
    path = page.write_report(tmp_path)
    text = path.read_text(encoding="utf-8")
    assert held(path)["planners"] == [NASTY, "$\\frac{$"]
    assert text.count("</script>") == 2
    assert "<!-- é" not in text
    assert "document.title='broken'</script>" not in text


@pytest.mark.parametrize(
    "given",
    [
        {"flown": False, "examples": 0},
        {"planners": ("RRTConnect",), "teams": (1,), "worlds": 1},
        {"planners": ("grid",), "presets": ("dense",), "teams": (8,), "worlds": 2, "examples": 1},
    ],
    ids=["nothing flown", "one run of one planner", "no planning time"],
)
def test_results_that_are_not_complete_have_a_page(tmp_path, given):
    few = {"planners": ("grid", "PRM"), "presets": ("reef",), "teams": (1, 2), "worlds": 3}
    rows = synthetic.write(tmp_path, **(few | given))
    data = held(page.write_report(tmp_path))
    assert data["totals"]["runs"] == len(rows)
    json.dumps(data, allow_nan=False)


def test_where_no_robot_has_a_row_the_first_failures_of_runs_are_shown(tmp_path):
    rows = synthetic.write(tmp_path, planners=("PRM",), teams=(8,), worlds=30, examples=0)
    (tmp_path / "robots.parquet").unlink()
    found = reading.read_results(tmp_path).failures
    failed = [row for row in rows if row["failure"]]
    assert failed
    assert found.run.tolist() == [row["run"] for row in failed]
    assert found.outcome.tolist() == [row["failure"] for row in failed]


def test_examples_are_thinned_and_keep_their_ends(made):
    path = made.parent / "examples" / "0.npz"
    shown = held(made)["examples"][0]
    with np.load(path) as file:
        flown, occupied = file["flown_0"], file["occupied"]
    ways = shown["paths"][0]["flown"]
    assert all(len(way) <= 80 for way in ways)
    np.testing.assert_allclose([way[-1] for way in ways], flown[-1, :, :2], atol=0.006)
    for i, j in np.ndindex(occupied.shape[:2]):
        (rock,) = np.nonzero(occupied[i, j])
        assert shown["top"][i][j] == (rock.max() + 1 if len(rock) else 0)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda folder: folder / "nowhere", "nowhere: no folder"),
        (lambda folder: (folder / "runs.parquet").unlink(), "holds no runs.parquet"),
        (lambda folder: (folder / "about.json").unlink(), "holds no about.json"),
        (lambda folder: (folder / "about.json").write_text("{"), "not valid JSON"),
        (lambda folder: (folder / "about.json").write_text("[]"), "holds no table"),
        (lambda folder: (folder / "runs.parquet").write_bytes(b"x"), "cannot be read"),
        (lambda folder: (folder / "examples" / "0.npz").write_bytes(b"x"), "no example"),
        (
            lambda folder: pq.write_table(
                pq.read_table(folder / "runs.parquet").drop_columns(["success"]),
                folder / "runs.parquet",
            ),
            "lacks the columns success",
        ),
        (
            lambda folder: pq.write_table(
                pq.read_table(folder / "runs.parquet").slice(0, 0), folder / "runs.parquet"
            ),
            "holds no run yet",
        ),
    ],
)
def test_a_folder_that_is_none_is_refused_in_one_message(tmp_path, spoil, said):
    synthetic.write(tmp_path, planners=("PRM",), presets=("open",), teams=(1,), worlds=2)
    spoiled = spoil(tmp_path)
    folder = spoiled if said.startswith("nowhere") else tmp_path
    with pytest.raises(ConfigError, match=re.escape(said)) as caught:
        scenes.build_page_scenes(reading.read_results(folder))
    assert str(tmp_path) in str(caught.value)
