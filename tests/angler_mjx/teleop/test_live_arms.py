"""Links of arms in the viewer beside a session."""

import numpy as np
import pytest

from angler_mjx.robot.vehicles import library
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.teleop import live_view
from angler_mjx.teleop.pilot import TeleopPilot

from ..armed import LIMP, RIGID
from ..link_poses import locate_by_mujoco

rr = pytest.importorskip("rerun", reason="the extra `view` is not installed")


def test_links_move_with_the_joints_of_the_session(armed_scenario, tmp_path):
    stream = rr.RecordingStream("test", recording_id="test")
    stream.save(tmp_path / "live.rrd")
    session = BatchSession(armed_scenario)
    pilot = TeleopPilot(session.robots, (0,), speed_mps=0.4, turn_radps=0.4)
    view = live_view.LiveView(stream, session, pilot, "world")
    positions = []
    for _ in range(9):
        view.after(session.step())
        positions.append(np.asarray(session.inside().state.vehicles.joints.position)[0, LIMP])
    stream.flush()
    stream.disconnect()
    shown = {}
    for chunk in rr.chunk.RrdReader(tmp_path / "live.rrd").stream().to_chunks():
        batch = chunk.to_record_batch()
        if "Transform3D:translation" in batch.schema.names:
            rows = shown.setdefault(chunk.entity_path, [])
            rows += [row[0] for row in batch.column("Transform3D:translation").to_pylist()]
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    root = f"/world/space/{session.robots[LIMP].name}/vehicle/links"
    for k, position in enumerate(positions[::2]):  # Poses are shown every 0.1 s.
        poses = locate_by_mujoco(config, np.zeros(3), [1.0, 0.0, 0.0, 0.0], position)
        for name, (origin, _) in poses.items():
            np.testing.assert_allclose(shown[f"{root}/{name}"][k], origin, atol=2e-6)
    assert positions[0][1] - positions[-1][1] > 0.05
    rigid = session.robots[RIGID].name
    assert not [entity for entity in shown if f"{rigid}/vehicle/links" in entity]
