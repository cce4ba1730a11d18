"""The page's script selects and shows what Python computed, and its captions state the rule."""

import html
import itertools
import json
import re
import shutil
import subprocess
from importlib import resources
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import pytest

from angler_mjx.studies.benchmark.report import curves, page, paired, rates, scene_maps
from angler_mjx.studies.benchmark.report.profiles import compute_profiles
from angler_mjx.studies.benchmark.report.reading import Runs

from . import synthetic

NODE = shutil.which("node")
WEB = resources.files("angler_mjx.studies.benchmark.report") / "web"
DOCUMENT = Path(__file__).with_name("document.js")
SCENES = (None, "open_fleet", "dense_fleet")
TEAMS = (None, 1, 8)
PAIRS = list(itertools.permutations(("grid", "RRTConnect", "KPIECE1"), 2))


def show(made, **choices):
    """Elements of the page, by id, after its script ran with choices behind #."""
    if NODE is None:
        pytest.skip("no node on PATH runs the page's script")
    given = {
        "page": made.read_text(encoding="utf-8"),
        "hash": urlencode(choices, doseq=True),
        "ids": ["answer", "pair", "by-team", "by-density", "profiles", "cells", "made"],
    }
    ran = subprocess.run(
        [NODE, DOCUMENT], input=json.dumps(given), capture_output=True, text=True, timeout=60
    )
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


def find_texts(element, name):
    """Texts of all elements of that name, in order."""
    if isinstance(element, str):
        return []
    found = [find_text(element)] if element["name"] == name else []
    return found + [text for child in element["children"] for text in find_texts(child, name)]


def find_text(element):
    return element if isinstance(element, str) else "".join(map(find_text, element["children"]))


def find_numbers(text):
    return [float(x) for x in re.findall(r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?", text)]


def select(results, scene, team):
    """Rows of a choice, counted apart from the page's code."""
    runs = results.runs
    rows = np.ones(len(runs), bool)
    if scene is not None:
        rows &= runs["scene"] == scene
    if team is not None:
        rows &= runs["robots"] == team
    return rows


def choose(scene, team, **others):
    chosen = {"scene": scene, "team": team, **others}
    return {key: value for key, value in chosen.items() if value is not None}


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("team", TEAMS)
def test_a_shown_pair_has_the_numbers_of_python(made, results, scene, team):
    table = results.select_runs(select(results, scene, team))
    for first, second in PAIRS[::2] if scene or team else PAIRS:
        shown = show(made, **choose(scene, team, first=first, second=second))["pair"]
        values = dict(zip(find_texts(shown, "th"), find_texts(shown, "td"), strict=True))
        pair = (results.planners.index(first), results.planners.index(second))
        one = paired.compare_pairs(results, [table], [pair])[0][0]
        assert int(values["problems of both"]) == one.pairs
        assert int(values["both succeed"]) == one.both
        assert int(values[f"only {first}"]) == one.only_first
        assert int(values[f"only {second}"]) == one.only_second
        assert find_numbers(values["difference of share (success), percentage points"]) == (
            pytest.approx([100 * x for x in (one.difference, one.low, one.high)], abs=0.0501)
        )
        assert float(values["McNemar's exact p"]) == pytest.approx(one.p, rel=0.06, abs=6e-5)
        ratios = [text for label, text in values.items() if "median ratio" in label]
        for text, ratio in zip(ratios, one.ratios.values(), strict=True):
            if not ratio.pairs:
                assert text == "–"
                continue
            *numbers, pairs = find_numbers(text)
            assert numbers == pytest.approx([ratio.median, ratio.low, ratio.high], rel=5.1e-3)
            assert pairs == ratio.pairs


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("team", TEAMS)
def test_shown_rates_and_profiles_have_the_numbers_of_python(made, results, scene, team):
    rows = select(results, scene, team)
    runs: Runs = results.runs.where(rows)
    shown = show(made, **choose(scene, team))
    found = rates.compute_rates(
        (runs["scene"], runs["planner"], runs["robots"]), runs[results.judged], runs.counted
    )
    expected = []
    for name, planner, robots in found:
        rate = found[name, planner, robots]
        if rate.requested:
            interval = f"{100 * rate.low:.0f} to {100 * rate.high:.0f} %"
            expected.append(
                f"{planner}, {robots} robot{'s' * (robots > 1)}: "
                f"{100 * rate.fraction:.0f} % ({interval}) of {rate.requested} runs"
            )
    titles = [text.split(";")[0] for text in find_texts(shown["by-team"], "title")]
    assert sorted(titles) == sorted(expected)
    lines = []
    for cost in ("planning_s", "makespan_s", "energy_j", "flowtime_s"):
        profiles = compute_profiles(results, results.select_runs(rows), cost)
        for planner, ratios in profiles.ratios.items():
            solved = len(ratios) / profiles.problems
            best = profiles.at(planner, 1.0)
            lines.append(f"{planner}: best on {100 * best:.0f} %, solves {100 * solved:.0f} %")
    assert find_texts(shown["profiles"], "title") == lines


def test_a_planner_that_is_not_shown_stays_in_the_profiles(made):
    every = find_texts(show(made)["profiles"], "title")
    some = find_texts(show(made, planners=["RRTConnect", "KPIECE1"])["profiles"], "title")
    assert some == [text for text in every if not text.startswith("grid")]


def test_the_best_planner_of_a_choice_is_named_with_those_like_it(made, results):
    runs = results.runs
    for scene in ("open_fleet", "reef_fleet", "dense_fleet"):
        rows = select(results, scene, None)
        rate = {
            name: np.mean(runs["success"][rows & (runs["planner"] == name) & runs.counted])
            for name in results.planners
        }
        answer = find_texts(show(made, scene=scene)["answer"], "li")
        assert answer[0].startswith(f"{max(rate, key=rate.get)} succeeds most often")


def test_numbers_of_one_are_in_the_singular(tmp_path):
    given = {"planners": ("grid", "PRM"), "presets": ("open",), "teams": (1,), "worlds": 2}
    synthetic.write(tmp_path / "results", **given, examples=0)
    shown = show(page.write_report(tmp_path / "results"))
    texts = " ".join(find_text(element) for element in shown.values())
    assert "of 1 run" in texts
    assert "1 problem: too few" in texts
    assert "1 common problem" in texts
    assert not re.search(r"\b1 (common )?(runs|problems|robots)\b", texts)


def test_only_cells_that_were_given_up_are_listed_as_such(made):
    (made_from,) = re.findall(r"cells given up(.*?)grid", find_text(show(made)["made"]))
    listed = re.findall(r"(\w+) on (\w+) with (\d+) \((\d+)\)", made_from)
    assert listed == [("KPIECE1", "dense_fleet", "8", "7")]


def test_the_script_computes_no_statistics():
    scripts = {path.name: path.read_text(encoding="utf-8") for path in WEB.iterdir()}
    assert "statistics.js" not in scripts
    for name, text in scripts.items():
        if name.endswith(".js"):
            banned = (
                r"wilson|newcombe|mcnemar\(|quantile|bootstrap|Math\.(sqrt|exp|random)|1\.9[56]"
            )
            assert not re.search(banned, text), name


def test_worlds_are_resampled_by_mulberry32():
    def sequence(seed, count):
        """mulberry32 in whole numbers, one after another."""
        word = 0xFFFFFFFF
        for _ in range(count):
            seed = (seed + 0x6D2B79F5) & word
            t = ((seed ^ (seed >> 15)) * (seed | 1)) & word
            t = ((t + (((t ^ (t >> 7)) * (t | 61)) & word)) & word) ^ t
            yield (t ^ (t >> 14)) / 2**32

    worlds, times = 7, 50
    numbers = list(sequence(1, worlds * times))
    expected = np.zeros((times, worlds), int)
    for i, number in enumerate(numbers):
        expected[i // worlds, int(number * worlds)] += 1
    np.testing.assert_array_equal(paired._resample_worlds(worlds, times), expected)
    assert np.all(expected.sum(axis=1) == worlds)


def test_captions_state_how_problems_count_that_a_planner_did_not_get(results):
    runs = results.runs
    given_up = int(np.sum(runs.counted & ~runs.requested))
    assert given_up > 0
    said = curves._describe_rates(results)
    total = int(np.sum(runs["plan_status"] != "no room"))
    assert f"{given_up} of {total} runs count as failures" in said
    note = " ".join(html.unescape((WEB / "page.html").read_text(encoding="utf-8")).split())
    assert "count as failures in all charts and comparisons" in note
    assert paired.RATIOS["planning_s"] == "planned"
    assert "over problems that both solved (of planning time: both planned)" in note
    # The rates that the charts show follow that rule.
    hit, counted = runs[results.judged], runs.counted
    for (planner,), rate in rates.compute_rates((runs["planner"],), hit, counted).items():
        of = (runs["planner"] == planner) & (runs["plan_status"] != "no room")
        assert (rate.count, rate.requested) == (int(np.sum(hit[of])), int(np.sum(of)))


def test_a_point_is_hollow_below_ten_runs():
    def shown(count):
        return rates.compute_rate(np.ones(count, bool), np.ones(count, bool))

    assert shown(9).few
    assert not shown(10).few
    assert re.search(r"hollow: one\.runs < data\.few", (WEB / "choice.js").read_text())


def test_each_failure_is_one_point_in_the_panel_of_its_scene(results):
    figure = scene_maps.plot_failures(results)
    held = results.failures
    scene_of = dict(zip(results.runs["run"].tolist(), results.runs["scene"], strict=True))
    scenes = [scene_of[run] for run in held.run.tolist()]
    for axes in figure.axes:
        name = axes.get_title(loc="left").split(":")[0]
        points = sum(len(line.get_xdata()) for line in axes.lines)
        assert points == scenes.count(name) > 0


def test_texts_of_profiles_lie_within_their_panels(results):
    figure = curves.profiles_of_time(results)
    (text,) = [text for axes in figure.axes for text in axes.texts if "nothing known" in str(text)]
    figure.draw_without_rendering()
    box, panel = text.get_window_extent(), text.axes.get_window_extent()
    assert panel.x0 <= box.x0 < box.x1 <= panel.x1
    assert panel.y0 <= box.y0 < box.y1 <= panel.y1
