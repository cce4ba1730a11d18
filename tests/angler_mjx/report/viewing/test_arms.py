"""Links of arms in a replay, read back."""

import numpy as np
import pytest

from angler_mjx.report.viewing import replay
from angler_mjx.robot.vehicles import library

from ...armed import ARM, LIMP, RIGID
from ...link_poses import locate_by_mujoco

rr = pytest.importorskip("rerun", reason="the extra `view` is not installed")


@pytest.fixture(scope="module")
def columns(armed_run, tmp_path_factory):
    """Columns of the replay by entity and component."""
    path = tmp_path_factory.mktemp("replay") / "replay.rrd"
    replay.write_replay(armed_run, [0], path)
    held = {}
    for chunk in rr.chunk.RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            held[chunk.entity_path, name] = batch.column(name).to_pylist()
    return held


@pytest.mark.parametrize("robot", [ARM, LIMP])
def test_links_move_with_the_recorded_joints(columns, armed_run, robot):
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    recorded = np.asarray(armed_run.trajectories["joint_position"])[0, :, robot]
    root = f"/world_0/space/robot_{robot}/vehicle/links"
    for k in (0, 15, 30):
        poses = locate_by_mujoco(config, np.zeros(3), [1, 0, 0, 0], recorded[k])
        for name, (origin, rotation) in poses.items():
            place = columns[f"{root}/{name}", "Transform3D:translation"][k][0]
            turn = np.reshape(columns[f"{root}/{name}", "Transform3D:mat3x3"][k][0], (3, 3)).T
            np.testing.assert_allclose(place, origin, atol=2e-6)
            np.testing.assert_allclose(turn, rotation, atol=2e-6)


def test_each_link_has_its_hull(columns):
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    for link in config.links:
        entity = f"/world_0/space/robot_{ARM}/vehicle/links/{link.name}/hull"
        starts = columns[entity, "Capsules3D:translations"][0]
        np.testing.assert_allclose(starts, [one.from_m for one in link.capsules], atol=1e-6)


def test_a_robot_without_arms_has_no_links(columns):
    entities = {entity for entity, _ in columns}
    assert not [entity for entity in entities if f"robot_{RIGID}/vehicle/links" in entity]
