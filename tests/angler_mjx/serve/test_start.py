"""The start of a door is not spent on programs of a single operation."""

import logging

import jax

from angler_mjx.serve.messages import SceneMessages
from angler_mjx.serve.scene_view import list_facts, view_scene


def test_instruments_and_messages_are_few_programs(session, scene, caplog):
    seen = session.reset()
    spec = scene.sim_spec()
    messages = SceneMessages(
        session.robots,
        list_facts(scene),
        dt_s=0.0625,  # of no other test: nothing is compiled before
        density_kgpm3=spec.water.density_kgpm3,
        gravity_mps2=spec.water.gravity_mps2,
    )
    jax.clear_caches()
    with jax.log_compiles(), caplog.at_level(logging.WARNING):
        view = view_scene(session, seen)
        messages.reset(session.inside(), 7, view)
        for _, build in messages.build_step(view, [{}] * len(session.robots)):
            build()
    texts = [record.getMessage() for record in caplog.records]
    programs = [text for text in texts if text.startswith("Finished XLA compilation")]
    # Keys, reset and reading of the instruments; an index on the device would be one for each leaf.
    assert 2 <= len(programs) <= 6, programs
