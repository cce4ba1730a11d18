"""The page as a browser shows it: filters from the address, numbers as Python has them."""

import html
import re
import shutil
import subprocess
from urllib.parse import urlencode

import pytest

from angler_mjx.studies.benchmark.report import page, paired
from angler_mjx.studies.benchmark.report.profiles import compute_profiles

from . import synthetic
from .test_page import NASTY

CHROMIUM = next(filter(shutil.which, ("chromium", "chromium-browser", "google-chrome")), None)

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on PATH")


def shown(path, place, **state):
    """The page's document after its script ran, with all hosts cut off."""
    asked = subprocess.run(
        [
            CHROMIUM,
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={place}",
            "--dump-dom",
            f"{path.as_uri()}#{urlencode(state, doseq=True)}",
        ],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    document = asked.stdout
    assert 'data-ready="yes"' in document, asked.stderr
    return re.sub(r"<script.*?</script>", "", document, flags=re.S)


def within(document, name):
    """What stands in the element of that id, up to the next heading of a section."""
    return re.search(rf'id="{name}".*?(?=<h2|$)', document, re.S)[0]


def texts(part, tag):
    found = re.findall(rf"<{tag}\b[^>]*>(.*?)</{tag}>", part, re.S)
    return [html.unescape(re.sub(r"<[^>]*>", "", text)) for text in found]


def test_everything_is_drawn_and_a_pair_is_compared_as_in_python(made, results, tmp_path):
    document = shown(made, tmp_path, first="RRTConnect", second="KPIECE1")
    assert len(texts(within(document, "winners"), "tr")) == 1 + 3
    assert len(re.findall("<figure>", within(document, "by-team"))) == 3
    cells = within(document, "cells")
    assert len(texts(cells, "tr")) == 1 + 3 * 3 * 3
    pair = within(document, "pair")
    values = dict(zip(texts(pair, "th"), texts(pair, "td"), strict=True))
    one = paired.compare_planners(results, "RRTConnect", "KPIECE1")
    assert values["problems of both"] == str(one.pairs)
    assert values["only RRTConnect"] == str(one.only_first)
    said = [
        float(x) / 100
        for x in re.findall(
            r"-?\d+\.\d", values["difference of share (success), percentage points"]
        )
    ]
    assert said == pytest.approx([one.difference, one.low, one.high], abs=6e-4)
    # A p of four decimals, or in powers of ten with two digits.
    assert float(values["McNemar's exact p"]) == pytest.approx(one.p, rel=0.06, abs=6e-5)
    for cost, ratio in one.ratios.items():
        words = {"planning_s": "planning time", "makespan_s": "makespan", "energy_j": "energy"}
        (text,) = (v for k, v in values.items() if k.startswith(words[cost]) and "median" in k)
        numbers = [float(x) for x in re.findall(r"\d+(?:\.\d+)?(?:e-?\d+)?", text)]
        assert numbers[0] == pytest.approx(ratio.median, rel=6e-3)
        assert numbers[1:3] == pytest.approx([ratio.low, ratio.high], rel=6e-3)
        assert numbers[3] == ratio.pairs
    found = compute_profiles(results, results.run_table, "makespan_s")
    label = f"grid: best on {100 * found.at('grid', 1.0):.0f} %"
    assert label in html.unescape(within(document, "profiles"))


def test_filters_in_the_address_choose_what_is_shown(made, results, tmp_path):
    document = shown(
        made,
        tmp_path,
        scene="dense_fleet",
        team=8,
        planners=["RRTConnect", "KPIECE1"],
        sort="success",
        down=1,
    )
    table = within(document, "cells")
    rows = [texts(row, "td") for row in re.findall("<tr>.*?</tr>", table, re.S)[1:]]
    assert [row[:4] for row in rows] == [
        ["RRTConnect", "dense_fleet", "dense", "8"],
        ["KPIECE1", "dense_fleet", "dense", "8"],
    ]
    assert rows[1][5:7] == ["5", "7"]
    assert rows[1][7] == "0 % *"
    runs = results.runs
    here = (runs["scene"] == "dense_fleet") & (runs["robots"] == 8)
    won = runs["success"][here & (runs["planner"] == "RRTConnect")]
    assert rows[0][7] == f"{100 * won.mean():.0f} %"
    answer = texts(within(document, "answer"), "li")
    assert answer[0].startswith("RRTConnect succeeds most often")
    assert "ahead of every other planner" in answer[0]


def test_odd_labels_are_shown_as_they_are(tmp_path):
    folder = tmp_path / "results"
    labels = {"grid": NASTY, "PRM": "<b>PRM</b>"}
    given = {"planners": ("grid", "PRM"), "presets": ("reef",), "teams": (2,), "worlds": 4}
    rows = synthetic.write(folder, **given, labels=labels, flown=False, examples=0)
    document = shown(page.write_report(folder), tmp_path / "browser")
    assert "<title>synthetic</title>" in document
    assert {NASTY, "<b>PRM</b>"} < set(texts(within(document, "cells"), "td"))
    assert "Nothing has been flown yet" in document
    assert "These results are not complete" in document
    planned = [
        sum(row["planned"] for row in rows if row["planner"] == name) for name in labels.values()
    ]
    worlds = 4 - 1  # the last has no room for the team
    best = max(zip(planned, labels.values(), strict=True), key=lambda pair: pair[0])
    assert f"plans for all robots most often: {100 * best[0] / worlds:.0f} %" in document
