"""The page's script computes what the Python modules compute, and its captions state the rule."""

import csv
import html
import io
import itertools
import json
import re
import shutil
import subprocess
from importlib import resources

import numpy as np
import pytest

from angler_mjx.studies.benchmark.report import curves, page_data, paired, rates, scene_maps

NODE = shutil.which("node")
WEB = resources.files("angler_mjx.studies.benchmark.report") / "web"
COMPARE = """
const { rows, pairs, costs, judged } = JSON.parse(require("fs").readFileSync(0, "utf8"));
const all = () => true;
console.log(JSON.stringify(pairs.map(([first, second]) => {
  const [a, b] = [byProblem(rows, first, all), byProblem(rows, second, all)];
  const found = counts(rows[judged], a, b);
  return {
    counts: found,
    interval: newcombe(...found),
    p: mcnemar(found[1], found[2]),
    ratios: Object.entries(costs).map(([cost, needs]) => ratioOf(rows, a, b, cost, needs)),
  };
})));
"""


@pytest.fixture(scope="module")
def compared(results):
    """Every pair of planners as the page's script compares them."""
    if NODE is None:
        pytest.skip("no node on PATH runs the page's script")
    held = page_data.build_page_data(results)
    pairs = list(itertools.combinations(range(len(held["planners"])), 2))
    problem = {
        "rows": held["rows"],
        "pairs": pairs,
        "costs": paired.RATIOS,
        "judged": held["judged"],
    }
    ran = subprocess.run(
        [NODE, "-e", (WEB / "statistics.js").read_text(encoding="utf-8") + COMPARE],
        input=json.dumps(problem),
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    names = held["planners"]
    return dict(zip([(names[a], names[b]) for a, b in pairs], json.loads(ran.stdout), strict=True))


def test_the_page_and_the_table_show_the_same_intervals(compared, results):
    table = list(csv.DictReader(io.StringIO(paired.format_pairs_csv(results))))
    assert len(table) == len(compared) == 3
    for row in table:
        page = compared[row["first"], row["second"]]
        assert page["counts"] == [
            int(row[k]) for k in ("both", "only_first", "only_second", "neither")
        ]
        assert [f"{x:.4f}" for x in page["interval"]] == [row["low"], row["high"]]
        assert page["p"] == pytest.approx(float(row["mcnemar_p"]), rel=5e-3)
        for cost, ratio in zip(paired.RATIOS, page["ratios"], strict=True):
            if row[f"{cost}_pairs"] == "0":
                assert ratio is None
                continue
            assert ratio["pairs"] == int(row[f"{cost}_pairs"]) > 0
            for key, column in (("median", "ratio"), ("low", "ratio_low"), ("high", "ratio_high")):
                # The table has four digits; the page's costs have seven.
                assert ratio[key] == pytest.approx(float(row[f"{cost}_{column}"]), rel=6e-4)


def test_both_sides_resample_by_mulberry32():
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
