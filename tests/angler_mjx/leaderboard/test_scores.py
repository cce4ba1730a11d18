"""Scores and board, from rows that are written by hand."""

import json
import re

import pytest
from scipy import stats

from angler_mjx.errors import ConfigError
from angler_mjx.leaderboard import board, problem_files, problem_sets, scores


def row(name, robots, **more):
    return {
        "problem": f"{name}/0",
        "set": name,
        "robots": robots,
        "solved": True,
        "planned": robots,
        "arrived": robots,
        "makespan_s": 60.0,
        "bound_s": 50.0,
        "energy_j": 1000.0 * robots,
        "clearance_m": 0.5,
        "planning_s": 0.2,
        "time_factor": 1.0,
        "reason": "",
    } | more


ROWS = [
    row("open-still-known-01", 1),
    row("open-still-known-02", 2, makespan_s=100.0, clearance_m=0.1),
    row("reef-moving-known-02", 2, makespan_s=55.0, planning_s=None),
    row(
        "reef-moving-observed-02",
        2,
        solved=False,
        arrived=1,
        makespan_s=None,
        reason="robot 1: collision_dynamic",
    ),
    row(
        "reef-ocean-observed-02",
        2,
        solved=False,
        arrived=0,
        makespan_s=None,
        reason="robot 0: collision_dynamic",
    ),
]


def test_a_tier_counts_its_problems_and_robots():
    tiers = {tier.name: tier for tier in scores.score_tiers(ROWS)}
    assert set(tiers) == {
        "all",
        "1 robot",
        "2 robots",
        "open",
        "reef",
        "still",
        "moving",
        "ocean",
        "known",
        "observed",
    }
    assert {name: tier.problems for name, tier in tiers.items() if tier.problems != 2} == {
        "all": 5,
        "1 robot": 1,
        "2 robots": 4,
        "reef": 3,
        "ocean": 1,
        "known": 3,
    }
    assert tiers["all"].solved.value == pytest.approx(0.6)
    interval = stats.binomtest(3, 5).proportion_ci(method="wilson")
    assert (tiers["all"].solved.low, tiers["all"].solved.high) == pytest.approx(tuple(interval))
    assert tiers["all"].arrived == pytest.approx(6 / 9)
    assert tiers["ocean"].medians == dict.fromkeys(scores.MEDIANS)


def test_medians_are_over_solved_problems_with_known_values():
    medians = scores.score_tier("all", ROWS).medians
    ratio = medians["makespan_ratio"]
    assert ratio.value == pytest.approx(1.2)
    assert ratio.count == 3
    assert 1.1 <= ratio.low <= ratio.value <= ratio.high <= 2.0
    assert medians["energy_j_per_robot"].value == pytest.approx(1000.0)
    assert medians["clearance_m"].value == pytest.approx(0.5)
    assert medians["planning_s"].count == 2


def test_the_bootstrap_interval_of_a_median_is_near_that_of_order_statistics():
    rows = [row("open-still-known-01", 1, makespan_s=50.0 + i) for i in range(101)]
    ratio = scores.score_tier("all", rows).medians["makespan_ratio"]
    # Binomial: the 41st and 61st of 101 values hold the median with 95 %.
    assert ratio.low == pytest.approx(1.0 + 40 / 50, abs=0.06)
    assert ratio.high == pytest.approx(1.0 + 60 / 50, abs=0.06)


def test_reasons_are_counted_without_the_robots_numbers():
    assert scores.count_reasons(ROWS) == [("collision_dynamic", 2)]


def result(name, rows=ROWS, **more):
    return {
        "benchmark": problem_sets.load_benchmark().title,
        "problems_sha256": problem_files.public_manifest().sha256(),
        "hidden": False,
        "card": {
            "benchmark": problem_sets.load_benchmark().title,
            "name": name,
            "authors": ["A. <Author>"],
            "machine": "",
            "kind": "plans",
        },
        "entered": sorted({row["set"] for row in rows}),
        "physics": {"angler-mjx": "0.2.0", "commit": None},
        "judged_on": "cpu",
        "planned_on": {"machine": "", "factor": 1.0},
        "scores": rows,
    } | more


def test_scores_are_printed_with_intervals_and_reasons():
    text = scores.format_scores(result("mine"))
    assert "all                3/5 (23-88 %)     67 %" in text
    assert "  reef-moving-observed-02/0: robot 1: collision_dynamic" in text
    assert "  reef-ocean-observed-02/0: robot 0: collision_dynamic" in text
    assert "angler-mjx 0.2.0" in text
    # Units stand below the names of their columns.
    head, units = text.splitlines()[1:3]
    for name, unit in (("energy", "J"), ("gap", "m"), ("planning", "s")):
        assert units[head.index(name) + len(name) - 1] == unit


def test_many_failures_are_counted_and_the_first_are_named():
    rows = [
        row(
            f"reef-still-known-{i:02d}", 1, solved=False, makespan_s=None, reason="robot 0: timeout"
        )
        for i in range(30)
    ]
    lines = scores.format_scores(result("mine", rows=rows)).splitlines()
    assert sum(line.startswith("  reef-still-known-") for line in lines) == scores.MAX_FAILED_LINES
    assert "  30 x timeout" in lines


def write(folder, name, **more):
    (folder / name).mkdir(parents=True)
    (folder / name / "result.json").write_text(json.dumps(result(name, **more)))
    return folder / name


def test_the_board_orders_submissions_and_keeps_their_results(tmp_path):
    lost = {"solved": False, "makespan_s": None, "arrived": 0, "reason": "robot 0: timeout"}
    worse = [ROWS[0] | lost, *ROWS[1:]]
    paths = [
        write(tmp_path, "b", rows=worse),
        write(tmp_path, "a"),
        write(tmp_path, "c", rows=ROWS[:1]),
    ]
    page = board.build_board(paths, tmp_path / "board", baselines=False).read_text()
    assert page.index("<td>a</td>") < page.index("<td>b</td>")
    assert "A. &lt;Author&gt;" in page
    assert page.index("<td>b</td>") < page.index("<td>c</td>")
    assert page.count("<h2>Public problems, part of the sets</h2>") == 1
    kept = sorted((tmp_path / "board" / "results").iterdir())
    assert [json.loads(path.read_text())["card"]["name"] for path in kept] == ["b", "a", "c"]
    again = board.build_board(paths[:1], tmp_path / "board", baselines=False).read_text()
    assert "<td>a</td>" not in again
    assert len(list((tmp_path / "board" / "results").iterdir())) == 1


def cells_of(page, name):
    """Return texts of the first row of a planner, without marks."""
    text = page.split(f"<td>{name}</td>", 1)[1].split("</tr>", 1)[0]
    return [re.sub(r"<[^>]*>", " ", cell).split() for cell in re.findall(r"<td.*?</td>", text)]


def test_a_tier_that_was_not_entered_is_empty_and_not_failed(tmp_path):
    lost = [
        row("reef-still-known-64", 64, solved=False, makespan_s=None, reason="robot 3: timeout")
    ]
    paths = [write(tmp_path, "few", rows=ROWS[:1]), write(tmp_path, "lost", rows=lost)]
    page = board.build_board(paths, tmp_path / "board", baselines=False).read_text()
    # all; 1, 2, 4, 8, 16, 32, 64 robots; open, reef, dense, corridor; still, moving, ocean; known,
    # observed
    few, fails = cells_of(page, "few"), cells_of(page, "lost")
    dash = ["&ndash;"]
    assert len(few) == len(fails) == 17
    assert few[0] == ["100", "21&ndash;100", "1", "of", "1"]
    assert few[2:8] == [dash] * 6
    assert fails[7] == ["0", "0&ndash;79", "0", "of", "1"]
    assert fails[1:7] == [dash] * 6
    assert few[8:12] == [few[0], dash, dash, dash]


def test_the_board_states_physics_machine_factor_and_time_limits(tmp_path):
    path = write(
        tmp_path,
        "a",
        planned_on={"machine": "A Core", "factor": 1.37},
        rows=[ROWS[0] | {"time_factor": 1.37}, ROWS[1] | {"time_factor": 1.004}],
        physics={"angler-mjx": "0.2.0", "commit": "0123456789abcdef"},
    )
    page = board.build_board([path], tmp_path / "board", baselines=False).read_text()
    assert page.count("Physics: angler-mjx 0.2.0.") == 1
    assert page.count("angler-mjx 0.2.0 (01234567)") == 1
    assert "A Core, factors 1.00 to 1.37" in page
    limits = page.split("<th>time limit, s</th>")[1].split("</tr>")[0]
    assert re.findall(r"\d+", limits) == ["1", "2", "4", "8", "16", "32", "64"]
    assert "1,700 searches/s" in page
    assert 'href="results/000.json"' in page
    # 1000 J of each robot.
    assert ">1<br><small>1&ndash;1</small>" in page


def test_the_board_links_pages_of_submissions_on_the_web_alone(tmp_path):
    paths = []
    for name, url in (("a", "https://a.example/?x=1&y=2"), ("b", "")):
        card = {**result(name)["card"], "url": url}
        paths.append(write(tmp_path, name, card=card))
    page = board.build_board(paths, tmp_path / "board", baselines=False).read_text()
    assert '<a href="https://a.example/?x=1&amp;y=2">page</a>' in page
    assert page.count(">page</a>") == 1
    card = {**result("c")["card"], "url": "javascript:alert(1)"}
    with pytest.raises(ConfigError, match=r"card\.url = .javascript"):
        board.build_board([write(tmp_path, "c", card=card)], tmp_path / "board", baselines=False)


def test_a_result_with_the_name_of_a_baseline_stands_beside_it(tmp_path):
    # What a stranger gets who plans with a planner of the package, as the benchmark's page shows.
    (stored,) = board.baselines_folder().glob("grid.json")
    path = write(tmp_path, "grid")
    page = board.build_board([path], tmp_path / "board", baselines=True).read_text()
    assert page.count("<td>grid</td>") == 1
    assert page.count("<td>grid<br><small>baseline</small></td>") == 1
    assert page.count(">grid</a><br><small>A. &lt;Author&gt;</small>") == 1
    assert page.count(">grid</a><br><small>baseline</small>") == 1
    kept = [json.loads(p.read_text()) for p in sorted((tmp_path / "board" / "results").iterdir())]
    assert kept[0]["entered"] == sorted({row["set"] for row in ROWS})
    assert json.loads(stored.read_text()) in kept[1:]
    with pytest.raises(ConfigError, match="is called 'grid"):
        board.build_board([path, path], tmp_path / "board", baselines=True)


def test_boards_of_two_results_with_one_name_or_in_a_strange_folder_are_refused(tmp_path):
    path = write(tmp_path, "a")
    with pytest.raises(ConfigError, match="is called 'a"):
        board.build_board([path, path], tmp_path / "board", baselines=False)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("x")
    with pytest.raises(ConfigError, match="is no board"):
        board.build_board([path], tmp_path / "mine", baselines=False)
    with pytest.raises(ConfigError, match="no results"):
        board.build_board([], tmp_path / "board", baselines=False)


def test_submissions_that_cannot_be_compared_stand_in_tables_of_their_own(tmp_path):
    flying = {**result("d")["card"], "kind": "in_flight", "in_flight": {"policy": {"name": "mppi"}}}
    hidden = [{"hidden": True, "problems_sha256": letter * 64} for letter in "bc"]
    again = {**result("b")["card"], "description": "on other hidden problems"}
    paths = [
        write(tmp_path, "a"),
        write(tmp_path, "b", **hidden[0]),
        write(tmp_path, "c", card=again, **hidden[1]),
        write(tmp_path, "d", card=flying),
    ]
    page = board.build_board(paths, tmp_path / "board", baselines=False).read_text()
    heads = re.findall(r"<h2>(.*?)</h2>", page)
    assert heads[:4] == [
        "Public problems, part of the sets",
        "Public problems, in flight, part of the sets",
        "Hidden problems bbbbbbbb, part of the sets",
        "Hidden problems cccccccc, part of the sets",
    ]
    tables = page.split("<h2>")[1:5]
    for name, table in zip("adbb", tables, strict=True):
        assert f"<td>{name}</td>" in table
        assert table.count("<th>planner</th>") == 2
        assert ("their time has no limit" in table) == (name == "d")


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"scores": []}, "scores"),
        ({"scores": [{**ROWS[0], "solved": "yes"}]}, r"scores\[0\]\.solved"),
        (
            {"scores": [{**ROWS[0], "makespan_s": None}]},
            "a solved problem has no reason, a makespan_s",
        ),
        ({"scores": [{**ROWS[0], "reason": "late"}]}, "a solved problem has no reason"),
        ({"scores": [{**ROWS[0], "arrived": 0}]}, "and all robots arrived"),
        ({"scores": [{**ROWS[0], "solved": False}]}, "another has a reason"),
        ({"scores": [{**ROWS[0], "bound_s": 0.0}]}, r"scores\[0\]\.bound_s"),
        ({"scores": [{**ROWS[0], "time_factor": 0.0}]}, r"scores\[0\]\.time_factor"),
        ({"scores": [ROWS[0], ROWS[0]]}, "is there twice"),
        ({"scores": [{**ROWS[0], "set": "x"}]}, "is no problem of the entered sets"),
        ({"scores": [{**ROWS[0], "robots": 2, "arrived": 2}]}, "or has another set or number"),
        (
            {"scores": [{**ROWS[0], "problem": "open-still-known-01/7"}]},
            "is no problem of the enter",
        ),
        ({"entered": ["open-still-known-02"]}, "is no problem of the entered sets"),
        ({"entered": ["open-still-known-03"]}, "there is no problem set 'open-still-known-03'"),
        ({"planned_on": {"machine": "a"}}, "factor"),
        ({"problems_sha256": None}, "problems_sha256"),
        (
            {"problems_sha256": "0" * 64},
            "hidden = False, but problems_sha256 is not that of the pub",
        ),
        ({"hidden": True}, "hidden = True, but problems_sha256 is that of the public"),
        (
            {"card": {**result("a")["card"], "kind": "program"}},
            r"the table \[program\] must be there",
        ),
    ],
)
def test_a_result_with_a_fault_is_refused_by_its_key(tmp_path, change, fault):
    path = write(tmp_path, "a", **change)
    with pytest.raises(ConfigError, match=fault):
        board.build_board([path], tmp_path / "board", baselines=False)
    assert not (tmp_path / "board").exists()
