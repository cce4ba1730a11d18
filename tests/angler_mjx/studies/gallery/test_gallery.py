"""A gallery from its command to its page: what it makes, keeps, makes again and refuses."""

import json
import re
import shlex
import shutil
import sys
from dataclasses import replace
from html import unescape

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.progress import Progress
from angler_mjx.report.video import recording, render_pool
from angler_mjx.report.video.recording import View
from angler_mjx.scenario.horizon_check import check_reachable
from angler_mjx.scenario.scenario import shipped_scenarios
from angler_mjx.shipped import list_shipped
from angler_mjx.studies.gallery import films, making

from ....opengl import reason_without

SCENARIO = """
schema_version = 1
name = "short"
description = "One robot < 5 m from its goal"
engine = "fused"
kernels = "xla"
worlds = 3
seed = 3
tile = 3

[time]
horizon_s = 12.0

[world]
preset = "open"
placement = "given"
start_m = [[0.0, 0.0, -5.0]]
goal_m = [[4.0, 0.0, -5.0]]

[[fleet]]
vehicle = "bluerov2_heavy"

[[world.currents]]
type = "gauss_markov"
max_speed_mps = 1.5
"""
SIZE = (160, 90)


@pytest.fixture(scope="module")
def opengl():
    pytest.importorskip("av", reason="the extra `video` is not installed")
    if reason := reason_without():
        pytest.skip(reason)


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenarios") / "short.toml"
    path.write_text(SCENARIO)
    return films.Film(
        name="short",
        title="A short way",
        text="One robot.",
        scenario=str(path),
        worlds=3,
        view=View(camera="follow", robot=0, size_px=SIZE, speed=8.0),
        poster_s=4.0,
    )


@pytest.fixture(scope="module")
def made(opengl, film, tmp_path_factory):
    out = tmp_path_factory.mktemp("galleries") / "made"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(films, "FILMS", (film,))
        main(["gallery", "--out", str(out)])
    return out


def stamps(out):
    """Time of writing of each file of the films, ns."""
    names = ("short.mp4", "short.png", "runs/short/summary.json")
    return {name: (out / name).stat().st_mtime_ns for name in names}


def read_columns(path):
    return pq.read_table(path, columns=["world", "outcome", "path_length_m"]).to_pylist()


def commands_of(out):
    text = (out / "index.html").read_text(encoding="utf-8")
    return unescape(re.search(r"<pre>(.*?)</pre>", text, re.DOTALL)[1]).splitlines()


def test_the_page_says_what_the_run_holds(made):
    text = (made / "index.html").read_text(encoding="utf-8")
    rows = pq.read_table(made / "runs/short/episodes.parquet").to_pylist()
    reached = sum(row["outcome"] == "reached" for row in rows)
    assert 0 < reached < 3  # the current decides
    number = {1: "1 robot", 2: "2 robots"}[reached]
    row = f"<td>reached the goal</td><td>{number}</td><td>{100 * reached / 3:.1f} %"
    assert row in text
    assert "seed 3, engine fused" in text
    assert "One robot &lt; 5 m" in text
    assert 'poster="short.png" src="short.mp4"' in text
    shown = int(re.search(r"World (\d+) of 3", text)[1])
    assert [row["outcome"] for row in rows].index("reached") == shown


def test_the_commands_of_the_page_make_the_same(made, tmp_path, monkeypatch):
    rollout, video, png = commands_of(made)
    monkeypatch.chdir(tmp_path)
    for line in (f"{rollout} --no-figures", video, png):
        main(shlex.split(line)[1:])
    flown = tmp_path / "runs/short/episodes.parquet"
    assert read_columns(flown) == read_columns(made / "runs/short/episodes.parquet")
    assert (tmp_path / "short.png").read_bytes() == (made / "short.png").read_bytes()
    with Image.open(made / "short.png") as image:
        assert image.size == SIZE
    av = pytest.importorskip("av")
    lengths = []
    for folder in (made, tmp_path):
        with av.open(str(folder / "short.mp4")) as container:
            lengths.append(container.streams.video[0].frames)
    assert lengths[0] == lengths[1] > 10


@pytest.fixture
def unrendered(monkeypatch):
    """Names of the files that are made from now on; they hold their time of making."""
    written = []

    def write(run, world, path, **options):
        written.append(path.name)
        path.write_text(str(len(written)))

    monkeypatch.setattr(render_pool, "require_opengl", lambda: None)
    monkeypatch.setattr(recording, "write_picture", write)
    monkeypatch.setattr(recording, "write_video", write)
    return written


def test_a_second_call_makes_only_what_is_missing_or_changed(made, film, unrendered, tmp_path):
    out = tmp_path / "copy"
    shutil.copytree(made, out)
    before = stamps(out)
    assert making.make_gallery([film], out, Progress())
    assert unrendered == []
    (out / "short.png").unlink()
    assert making.make_gallery([film], out, Progress())
    assert unrendered == ["short.png", "short.mp4"]
    (out / "short.mp4").write_text("damaged")
    assert making.make_gallery([film], out, Progress())
    assert len(unrendered) == 4
    slower = replace(film, view=replace(film.view, speed=4.0))
    assert making.make_gallery([slower], out, Progress())
    assert len(unrendered) == 6
    assert making.make_gallery([slower], out, Progress())
    assert len(unrendered) == 6
    assert json.loads((out / "gallery.json").read_text())["short"]["origin"]["view"]["speed"] == 4.0
    assert stamps(out)["runs/short/summary.json"] == before["runs/short/summary.json"]


def test_an_interrupted_film_is_made_by_the_next_call(
    made, film, unrendered, monkeypatch, tmp_path
):
    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    out = tmp_path / "copy"
    shutil.copytree(made, out)
    faster = replace(film, view=replace(film.view, speed=10.0))
    with monkeypatch.context() as patch:
        patch.setattr(recording, "write_video", interrupt)
        with pytest.raises(KeyboardInterrupt):
            making.make_gallery([faster], out, Progress())
    assert unrendered == ["short.png"]
    assert making.make_gallery([faster], out, Progress())
    assert unrendered[1:] == ["short.png", "short.mp4"]


def test_a_run_of_another_scenario_is_refused(made, film, unrendered):
    before = stamps(made)
    with pytest.raises(
        ConfigError, match=r"runs/short: is a run of another .*\(worlds\)"
    ) as caught:
        making.make_gallery([replace(film, worlds=2)], made, Progress())
    assert "delete it, or choose another folder with --out" in str(caught.value)
    assert stamps(made) == before


def test_nothing_is_flown_without_an_encoder(film, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(UnsupportedError, match=r"angler-mjx\[video\]"):
        making.make_gallery([film], tmp_path / "out", Progress())
    assert not list(tmp_path.iterdir())


def test_nothing_is_flown_without_an_opengl(film, tmp_path, monkeypatch):
    pytest.importorskip("av", reason="the extra `video` is not installed")
    monkeypatch.setattr(render_pool, "list_backends", lambda: ["nothing"])
    with pytest.raises(UnsupportedError, match="OpenGL does not work here"):
        making.make_gallery([film], tmp_path / "out", Progress())
    assert not list(tmp_path.iterdir())


def test_unknown_films_are_named(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["gallery", "--only", "whales"])
    assert caught.value.code == 2
    assert "--only whales: films are reef, " in capsys.readouterr().err


class Outcomes:
    """A run of which only the outcomes are known."""

    def __init__(self, *worlds):
        rows = [
            {"world": world, "outcome": outcome}
            for world, outcomes in enumerate(worlds)
            for outcome in outcomes
        ]
        self.episodes = pa.Table.from_pylist(rows)


@pytest.mark.parametrize(
    ("worlds", "chosen"),
    [
        ([("timeout", "reached"), ("reached", "reached"), ("reached", "reached")], 1),
        ([("timeout", "reached"), ("timeout", "failed"), ("reached", "failed")], 0),
        ([("timeout", "timeout"), ("failed", "failed")], 0),
    ],
)
def test_the_first_world_of_most_arrivals_is_shown(worlds, chosen):
    assert making.choose_world(Outcomes(*worlds)) == chosen


def test_every_film_can_be_flown_and_looked_at():
    names = [film.name for film in films.FILMS]
    assert len(set(names)) == len(names)
    shipped = list_shipped("angler_mjx.studies.gallery")
    assert set(shipped) <= {film.scenario for film in films.FILMS}
    assert not set(shipped) & set(shipped_scenarios())
    for film in films.FILMS:
        scenario = film.load_scenario()
        check_reachable(scenario, film.name)
        assert scenario.worlds == film.worlds
        assert 0 <= film.poster_s < scenario.time.horizon_s
        if film.view.robot is not None:
            assert film.view.camera == "follow"
            assert film.view.robot < sum(entry.count for entry in scenario.fleet)
    robots = {film.name: sum(e.count for e in film.load_scenario().fleet) for film in films.FILMS}
    assert robots["robots_64"] == 64
