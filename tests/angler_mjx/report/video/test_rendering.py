"""Pictures and videos as they come out, and what happens where OpenGL or PyAV is missing."""

import shutil
import sys
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from angler_mjx.cli.replay import replay as command
from angler_mjx.errors import ConfigError, RunError, UnsupportedError
from angler_mjx.report.video import (
    camera,
    encoder,
    frames,
    overlay,
    recording,
    render_pool,
    scene_model,
    write_picture,
    write_video,
)
from angler_mjx.report.video.recording import View

from ....opengl import reason_without
from .test_scene_model import view_axes

SIZE = (320, 180)


@pytest.fixture(scope="module")
def empty(scene):
    """The scene without rock and obstacles, so that nothing hides anything."""
    environment = scene.environment
    return replace(
        scene,
        environment=replace(
            environment,
            grid=replace(environment.grid, occupied=np.zeros_like(environment.grid.occupied)),
            obstacles=replace(
                environment.obstacles, exists=np.zeros_like(environment.obstacles.exists)
            ),
        ),
    )


def render(scene, time_s, *, kind="above", change=lambda found: found, **options):
    """Pictures [N, height, width, 3], int, reduced as those of runs are, and the camera's path."""
    model = scene_model.build_model(scene)
    path = camera.build_camera_path(kind, scene, scene.robots[0], time_s, SIZE[0] / SIZE[1])
    found = change(frames.build_frames(model, scene, time_s, path, np.ones((len(scene.robots), 4))))
    larger, options = (2 * SIZE[0], 2 * SIZE[1]), {"processes": 1, "line_px": 6, **options}
    with closing(render_pool.render(model, found, larger, **options)) as pictures:
        reduced = [Image.fromarray(picture).reduce(2) for picture in pictures]
    return np.array([np.array(picture, int) for picture in reduced]), path


@pytest.fixture(scope="module")
def opengl():
    if reason := reason_without():
        pytest.skip(reason)


def project(path, point):
    """Column and row of a point in the picture of a camera."""
    eye, forward, right, up = view_axes(path, 0)
    away = point - eye
    scale = 0.5 * SIZE[1] / np.tan(np.radians(camera.VIEW_DEG) / 2) / (away @ forward)
    return np.array([0.5 * SIZE[0] + scale * (away @ right), 0.5 * SIZE[1] - scale * (away @ up)])


def changed_pixels(a, b):
    """Columns and rows [n, 2] where two pictures differ clearly."""
    rows, columns = np.nonzero(np.abs(a - b).max(axis=2) > 12)
    return np.stack([columns + 0.5, rows + 0.5], axis=1)


def test_a_goal_is_where_the_camera_projects_it(opengl, empty):
    place = np.array([5.0, 3.0, -9.0])
    moved = replace(empty.robots[0], goal_m=place)
    away = replace(empty.robots[0], goal_m=np.full(3, np.nan))
    shown, path = render(replace(empty, robots=(moved, *empty.robots[1:])), np.zeros(1))
    hidden, _ = render(replace(empty, robots=(away, *empty.robots[1:])), np.zeros(1))
    pixels = changed_pixels(shown[0], hidden[0])
    assert len(pixels) > 4
    assert np.linalg.norm(np.mean(pixels, axis=0) - project(path, place)) < 1.0


@pytest.mark.parametrize("without_rock", [False, True])
def test_the_fixed_camera_shows_all_that_is_there_and_little_more(scene, empty, without_rock):
    shown = empty if without_rock else scene
    path = camera.build_camera_path("fixed", shown, shown.robots[0], np.zeros(1), SIZE[0] / SIZE[1])
    grid = shown.environment.grid
    centers = (np.argwhere(grid.occupied) + 0.5) * float(grid.cell_m) + np.asarray(grid.origin_m)
    tracks = [robot.p_m[np.isfinite(robot.p_m).all(axis=1)] for robot in shown.robots]
    ends = [np.stack([robot.start_m, robot.goal_m]) for robot in shown.robots]
    pixels = np.array([project(path, point) for point in np.concatenate([*tracks, *ends, centers])])
    assert (pixels >= 0).all()
    assert (pixels <= SIZE).all()
    # They reach from side to side or from bottom to top, but for vehicles and half a cell.
    filled = (pixels.max(axis=0) - pixels.min(axis=0)) / SIZE
    assert filled.max() > 0.8


def test_a_lone_short_flight_fills_the_picture(empty):
    start = np.array([2.0, 1.0, -8.0])
    flown = start + np.linspace(0.0, 1.5, len(empty.time_s))[:, None] * np.array([1.0, 0.0, 0.0])
    alone = replace(empty.robots[0], p_m=flown, start_m=start, goal_m=flown[-1])
    path = camera.build_camera_path(
        "fixed", replace(empty, robots=(alone,)), alone, np.zeros(1), SIZE[0] / SIZE[1]
    )
    assert path.distance_m[0] < 6.0  # a region of 30 m would take 40 m
    low, high = project(path, start), project(path, flown[-1])
    assert abs(high[0] - low[0]) > 0.25 * SIZE[0]


def test_an_arrow_is_as_long_as_the_current(opengl, empty):
    start, arrow = np.array([2.0, 1.0, -8.0]), np.array([2.0, 0.0, 0.0])
    track = np.tile(start, (len(empty.time_s), 1))
    still = replace(empty.robots[0], p_m=track, start_m=start, goal_m=start + arrow)
    alone = replace(empty, robots=(still,))

    def lone(vector):
        return lambda found: replace(found, arrow_m=np.zeros_like(found.arrow_m) + vector)

    at = np.array([20.0])
    shown, path = render(alone, at, change=lone(arrow))
    hidden, _ = render(alone, at, change=lone(0.0))
    pixels = changed_pixels(shown[0], hidden[0])
    above = start + np.array([0.0, 0.0, 0.3])
    tail, tip = project(path, above), project(path, above + arrow)
    assert tip[0] - tail[0] > 60
    assert abs(pixels[:, 0].min() - tail[0]) < 3
    assert abs(pixels[:, 0].max() - tip[0]) < 5  # its point is thinner than a pixel
    pixels_per_m = (tip[0] - tail[0]) / 2.0
    assert np.max(np.abs(pixels[:, 1] - tail[1])) < 0.2 * pixels_per_m


def test_a_trail_lies_on_the_path_behind_the_robot(opengl, empty):
    def without(found):
        return replace(found, trail_count=np.zeros_like(found.trail_count))

    at = np.array([20.0])
    shown, path = render(empty, at)
    hidden, _ = render(empty, at, change=without)
    pixels = changed_pixels(shown[0], hidden[0])
    flown = np.concatenate([robot.p_m[:101] for robot in empty.robots])
    places = np.array([project(path, point) for point in flown])
    distance = np.linalg.norm(pixels[:, None] - places[None], axis=2)
    assert np.max(np.min(distance, axis=1)) < 4  # on it
    assert np.mean(np.min(distance, axis=0) < 4) > 0.8  # all of it, but what robots hide


def test_processes_give_the_frames_in_order(opengl, scene):
    times = np.linspace(0.0, 50.0, 5)
    one, _ = render(scene, times, kind="follow")
    three, _ = render(scene, times, kind="follow", processes=3)
    np.testing.assert_array_equal(one, three)
    assert all((one[i] != one[i + 1]).any() for i in range(4))


PRINTS_ONE = (
    "import sys; w, h = map(int, sys.argv[2:4]); sys.stdout.buffer.write(bytes(3 * w * h));"
    "sys.stdout.flush(); sys.exit('the card went away')"
)


@pytest.mark.parametrize(
    ("code", "kind", "words"),
    [
        ("import sys; sys.exit('no screen here')", UnsupportedError, ("no screen here", "egl1")),
        ("import os; os.kill(os.getpid(), 11)", UnsupportedError, ("signal 11", "MUJOCO_GL")),
        (PRINTS_ONE, RunError, ("frame 1 of 3", "the card went away")),
    ],
)
def test_a_renderer_that_ends_is_one_message(empty, monkeypatch, code, kind, words):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    with pytest.raises(kind) as caught:
        render(empty, np.zeros(3), renderer=[sys.executable, "-c", code])
    for word in words:
        assert word in str(caught.value)


def test_the_user_chooses_the_opengl(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert render_pool.list_backends() == ["osmesa"]


def test_a_picture_of_a_run(opengl, run, tmp_path):
    path = tmp_path / "a.png"
    path.write_text("older")
    assert write_picture(run, 1, path, at_s=12.0, view=View(size_px=SIZE)) == path
    with Image.open(path) as image:
        assert image.size == SIZE
    command(run.path, world=1, png=tmp_path / "b.png", at=12.0, size=SIZE)
    assert (tmp_path / "b.png").read_bytes() == path.read_bytes()


def test_a_video_of_a_run(opengl, run, tmp_path):
    av = pytest.importorskip("av", reason="the extra `video` is not installed")
    path, seen = tmp_path / "a.mp4", []
    view = View(camera="above", size_px=SIZE, speed=20.0, fps=10)
    write_video(run, 0, path, view=view, report=lambda *done: seen.append(done))
    assert seen == [(i, 41) for i in range(1, 42)]  # 60 s, and one second of the end
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height) == SIZE
        assert stream.average_rate == 10
        shown = [
            frame.to_ndarray(format="rgb24").astype(int) for frame in container.decode(video=0)
        ]
    assert len(shown) == 41
    world = slice(60, 150)  # without the text
    assert np.abs(shown[0][world] - shown[15][world]).max() > 40


def test_the_last_frame_of_a_video_is_the_end(run, scene, tmp_path, monkeypatch):
    def blank(model, frames, size_px, **options):
        return iter(np.zeros((len(frames.qpos), 4, 4, 3), np.uint8))

    def count(path, pictures, size_px, fps):
        path.write_text(str(len(list(pictures))))

    shown = []
    monkeypatch.setattr(render_pool, "render", blank)
    monkeypatch.setattr(recording, "encode_video", count)
    monkeypatch.setattr(
        overlay.Overlay, "write_on", lambda text, picture, time_s: shown.append(time_s)
    )
    write_video(run, 0, tmp_path / "a.mp4", view=View(size_px=SIZE, speed=50.0, fps=1))
    assert shown == [0.0, 50.0, 60.0, 60.0]  # for one second more
    assert (tmp_path / "a.mp4").read_text() == "4"
    # A record in samples may end before the robots do.
    late = [replace(robot, end_time_s=60.0 + robot.index) for robot in scene.robots]
    monkeypatch.setattr(
        recording.worlds, "read_scene", lambda *_: replace(scene, robots=tuple(late))
    )
    shown.clear()
    write_video(run, 0, tmp_path / "b.mp4", view=View(size_px=SIZE, speed=50.0, fps=1))
    assert shown == [0.0, 50.0, 63.0, 63.0]
    shown.clear()
    with pytest.raises(ConfigError, match="--at 64: world 0 was recorded from 0 to 63 s"):
        write_picture(run, 0, tmp_path / "c.png", at_s=64.0)


def test_videos_are_rendered_larger_and_reduced(opengl, run, tmp_path, monkeypatch):
    rendered = []

    def note(model, frames, size_px, **options):
        rendered.append((size_px, options["line_px"]))
        return iter(np.zeros((len(frames.qpos), size_px[1], size_px[0], 3), np.uint8))

    av = pytest.importorskip("av", reason="the extra `video` is not installed")
    monkeypatch.setattr(render_pool, "render", note)
    write_video(run, 0, tmp_path / "a.mp4", view=View(size_px=SIZE, speed=50.0, fps=1))
    write_picture(run, 0, tmp_path / "a.png", view=View(size_px=SIZE))
    assert [size for size, _ in rendered] == [(480, 270), (640, 360)]
    assert rendered[0][1] < rendered[1][1]  # lines are as wide in both
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height) == SIZE
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == SIZE


def test_the_encoder_reduces_by_the_mean(tmp_path):
    av = pytest.importorskip("av", reason="the extra `video` is not installed")
    rows = np.repeat(np.array([40, 200], np.uint8), 60)  # dark above, bright below
    stripes = np.broadcast_to(rows[:, None, None], (120, 160, 3)).copy()
    stripes[:, ::2] //= 2  # columns of 20 and 40, of 100 and 200
    encoder.encode_video(tmp_path / "a.mp4", [stripes], (80, 60), 1)
    with av.open(str(tmp_path / "a.mp4")) as container:
        shown = next(container.decode(video=0)).to_ndarray(format="rgb24").astype(float)
    assert shown.shape == (60, 80, 3)
    assert np.abs(shown[:26, 4:-4] - 30).mean() < 4
    assert np.abs(shown[34:, 4:-4] - 150).mean() < 4


def test_a_run_without_trajectories_has_no_film(run, tmp_path):
    bare = tmp_path / "bare"
    shutil.copytree(run.path, bare, ignore=shutil.ignore_patterns("trajectories.zarr"))
    for kind in ("video", "png"):
        with pytest.raises(ConfigError) as caught:
            command(bare, world=0, **{kind: tmp_path / "a"})
        assert "stored no trajectories" in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["bare"]


def test_an_interrupted_video_leaves_the_older_one(opengl, run, tmp_path):
    pytest.importorskip("av", reason="the extra `video` is not installed")
    path = tmp_path / "a.mp4"
    path.write_text("older")

    def interrupt(done, total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(run, 0, path, view=View(size_px=SIZE), report=interrupt)
    assert [file.name for file in tmp_path.iterdir()] == ["a.mp4"]
    assert path.read_text() == "older"


def test_without_pyav(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(UnsupportedError, match=r"angler-mjx\[video\]"):
        encoder.encode_video(tmp_path / "a.mp4", [], SIZE, 24)


def test_what_the_text_says(scene):
    text = overlay.Overlay(scene, "title", 180)
    current = "current 0.11 m/s"
    assert text.describe(10.0) == ["10.0 s", current, "0 of 4 robots arrived"]
    assert text.describe(21.0)[3:] == ["robot 1 hit rock or floor"]
    assert text.describe(27.0)[3:] == []
    assert text.describe(56.0)[2:] == ["1 of 4 robots arrived", "robot 0 reached the goal"]
    assert current not in text.describe(60.0)  # nobody flies
    picture = np.zeros((180, 320, 3), np.uint8)
    written = text.write_on(picture, 10.0)
    assert written[:60, :120].max() > 200
    assert written[160:, :120].max() > 200
    assert not written[60:150].any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"png": "a.png", "out": "a.rrd"}, "--out and --png: choose one"),
        ({"at": 3.0}, "--at: belongs to --png"),
        ({"video": "a.mp4", "at": 3.0}, "--at: belongs to --png"),
        ({"png": "a.png", "speed": 3.0}, "--speed: belongs to --video"),
        ({"out": "a.rrd", "camera": "above"}, "--camera: belongs to --png and --video"),
        ({"png": "a.png", "robot": 1}, "--camera follow"),
        ({"png": "a.png", "robot": 9, "camera": "follow"}, "--robot 9: robots 0 to 3"),
        ({"png": "a.png", "at": 61.0}, "--at 61: world 0 was recorded from 0 to 60 s"),
        ({"png": "a.png", "at": -1.0}, "--at -1"),
        ({"png": "a.png", "size": (321, 180)}, "--size 321 180: must be even"),
        ({"png": "a.png", "size": (320, 2000)}, "--size 320 2000"),
        ({"video": "a.mp4", "speed": 0.0}, "--speed 0: must be positive"),
        ({"png": "a.png", "world": 7}, "--world 7"),
    ],
)
def test_what_cannot_be_shown(run, tmp_path, options, message):
    options = {
        name: tmp_path / value if name in ("png", "out", "video") else value
        for name, value in options.items()
    }
    with pytest.raises(ConfigError) as caught:
        command(run.path, **{"world": 0, **options})
    assert message in str(caught.value)
    assert not list(tmp_path.iterdir())
