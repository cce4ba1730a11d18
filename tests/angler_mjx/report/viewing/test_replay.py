"""The replay file, read back; and what happens where it cannot be made."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from angler_mjx.errors import UnsupportedError
from angler_mjx.report.viewing import replay
from angler_mjx.runs.storage.folder import REPLAY

rr = pytest.importorskip("rerun", reason="the extra `view` is not installed")


@pytest.fixture
def run(tmp_path, scene, monkeypatch):
    """A run folder whose only world is the hand-made scene."""
    monkeypatch.setattr(replay.scene, "read_scene", lambda run, world: scene)
    return SimpleNamespace(path=tmp_path, scenario=SimpleNamespace(name="reef_fleet", seed=7))


@pytest.fixture(scope="module")
def chunks(scene, tmp_path_factory):
    """The replay's chunks by entity."""
    path = tmp_path_factory.mktemp("replay") / "replay.rrd"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(replay.scene, "read_scene", lambda run, world: scene)
        scenario = SimpleNamespace(name="reef_fleet", seed=7)
        replay.write_replay(SimpleNamespace(path=path.parent, scenario=scenario), [12])
    reader = rr.chunk.RrdReader(path)
    assert len(reader.blueprints()) == 1
    held = {}
    for chunk in reader.stream().to_chunks():
        held.setdefault(chunk.entity_path, []).append(chunk)
    return held


def _column(chunks, entity, name):
    for chunk in chunks[entity]:
        batch = chunk.to_record_batch()
        if name in batch.schema.names:
            return batch.column(name)
    raise KeyError(name)


def _seconds(column):
    return np.asarray(column).astype("timedelta64[ns]").astype(float) * 1e-9


def test_robots_move_as_in_the_run(chunks, scene):
    for robot in scene.robots:
        entity = f"/world_12/space/robot_{robot.index}/vehicle"
        place = _column(chunks, entity, "Transform3D:translation")
        # Rerun stores float32.
        np.testing.assert_allclose(
            np.stack([row[0] for row in place.to_pylist()]), robot.p_m, atol=2e-6
        )
        seconds = _seconds(_column(chunks, entity, "time"))
        np.testing.assert_allclose(seconds, scene.time_s, atol=1e-8)


def test_attitude_is_stored_with_its_scalar_last(chunks):
    q = _column(chunks, "/world_12/space/robot_0/vehicle", "Transform3D:quaternion")
    np.testing.assert_allclose(q.to_pylist()[0][0], [0, 0, 0, 1])


def test_rock_is_a_box_for_each_cell(chunks, scene):
    centers = _column(chunks, "/world_12/space/rock", "Boxes3D:centers").to_pylist()[0]
    assert len(centers) == scene.environment.grid.occupied.sum()


def test_obstacles_move_and_padding_is_left_out(chunks, scene):
    given = scene.environment.obstacles
    shown = 0
    for name, component in (
        ("spheres", "Ellipsoids3D:centers"),
        ("boxes", "Boxes3D:centers"),
        ("capsules", "Capsules3D:translations"),
    ):
        places = _column(chunks, f"/world_12/space/obstacles/{name}", component).to_pylist()
        assert len(places) == scene.time_s.size
        shown += len(places[-1])
    assert shown == given.exists.sum()
    spheres = np.flatnonzero(given.exists & (given.kind == 0))
    last = _column(chunks, "/world_12/space/obstacles/spheres", "Ellipsoids3D:centers")[-1]
    np.testing.assert_allclose(last.as_py(), scene.obstacle_p_m[-1, spheres], atol=2e-6)


def test_trail_grows_to_the_place_of_the_failure(chunks, scene):
    robot = scene.robots[1]
    strips = _column(chunks, "/world_12/space/robot_1/trail", "LineStrips3D:strips").to_pylist()
    lengths = [len(row[0]) for row in strips]
    assert lengths == sorted(set(lengths))
    np.testing.assert_allclose(strips[-1][0][-1], robot.failure_m, atol=2e-6)


def test_label_tells_the_outcome_at_its_time(chunks, scene):
    entity = "/world_12/space/robot_1/vehicle/label"
    assert _column(chunks, entity, "Points3D:labels").to_pylist() == [
        ["1"],
        ["1: hit rock or floor"],
    ]
    np.testing.assert_allclose(_seconds(_column(chunks, entity, "time")), [0.0, 20.0], atol=1e-8)


def test_write_replaces_an_older_replay_and_leaves_nothing_else(run):
    (run.path / REPLAY).write_text("old")
    path = replay.write_replay(run, [12])
    assert path == run.path / "replay.rrd"
    assert path.stat().st_size > 10_000
    assert [file.name for file in run.path.iterdir()] == ["replay.rrd"]


def test_without_rerun_it_says_how_to_make_the_replay_later(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(UnsupportedError) as caught:
        replay.write_replay(run, [12])
    message = str(caught.value)
    assert "no replay was written" in message
    assert "angler-mjx[view]" in message
    assert f"angler replay {run.path} --world 12" in message
    assert not list(run.path.iterdir())


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a display")
def test_without_a_display_it_says_what_to_do(run, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(UnsupportedError, match="no display") as caught:
        replay.show_world(run, 12)
    words = " ".join(str(caught.value).split())
    # The file that is named holds the world that was chosen, and its server is not for the network.
    assert f"angler replay {run.path} --world 12 --out world_12.rrd" in words
    assert "rerun --serve-web --bind 127.0.0.1 world_12.rrd" in words
    assert replay.REPLAY not in words


def test_a_chosen_world_is_written_to_a_file_of_its_own(run, tmp_path):
    out = tmp_path / "new" / "world_12.rrd"
    (run.path / REPLAY).write_text("the worst and a good world")
    assert replay.write_replay(run, [12], out) == out
    entities = {chunk.entity_path for chunk in rr.chunk.RrdReader(out).stream().to_chunks()}
    assert {entity.split("/")[1] for entity in entities if "world" in entity} == {"world_12"}
    assert (run.path / REPLAY).read_text() == "the worst and a good world"


def test_a_run_that_planned_anew_says_which_plans_are_shown(scene):
    from angler_mjx.report.viewing import replay_world
    from angler_mjx.report.viewing.maps import legends

    def text(one):
        return replay_world._fleet_table(one).text.as_arrow_array().to_pylist()[0]

    def lines(one):
        return [sign.get_label() for sign in legends.symbol_handles(one)]

    anew = replace(scene, replan_hz=2.0)
    assert "anew" not in text(scene)
    assert "plans before the start" in text(anew)
    assert "at 2 Hz" in text(anew)
    assert "planned way" in lines(scene)
    assert "first plan" in lines(anew)


@pytest.mark.parametrize("count", [16, 17])
def test_of_a_crowd_those_are_named_that_failed(scene, count, tmp_path, monkeypatch):
    """Sixteen are all named; among more, goals and numbers would hide what they name."""
    many = tuple(
        replace(
            scene.robots[0], index=i, outcome="reached" if i else "collision_static", end_time_s=9.0
        )
        for i in range(count)
    )
    crowd = replace(scene, robots=many)
    monkeypatch.setattr(replay.scene, "read_scene", lambda run, world: crowd)
    scenario = SimpleNamespace(name="reef_fleet", seed=7)
    replay.write_replay(SimpleNamespace(path=tmp_path, scenario=scenario), [12])
    held = {}
    for chunk in rr.chunk.RrdReader(tmp_path / REPLAY).stream().to_chunks():
        held.setdefault(chunk.entity_path, []).append(chunk)

    def shown(entity):
        return _column(held, f"/world_12/space/{entity}", "Points3D:show_labels").to_pylist()

    few = count == 16
    assert shown("robot_3/goal") == [[few]]
    assert shown("robot_3/vehicle/label") == [[few], [few]]
    assert shown("robot_0/vehicle/label") == [[few], [True]]
