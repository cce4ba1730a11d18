"""Materials against published coefficients of pairs, and damping against an integrated contact."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from angler_mjx.errors import ConfigError
from angler_mjx.world import materials
from angler_mjx.world.presets import list_presets

SHIPPED = {"aluminium", "concrete", "hdpe", "pvc", "rock", "rubber", "sand", "steel"}

PUBLISHED = {
    # Friction factors of NAVFAC DM 7.02, table 1.
    ("concrete", "rock"): (0.68, 0.72),
    ("concrete", "sand"): (0.55, 0.60),
    ("steel", "sand"): (0.30, 0.40),
    # Between dressed hard rocks there, and Byerlee's law.
    ("rock", "rock"): (0.55, 0.85),
    # ACI 318M-11, 11.6.4.3.
    ("concrete", "concrete"): (0.59, 0.61),
    # Submerged and dry angles of repose.
    ("sand", "sand"): (math.tan(math.radians(28)), math.tan(math.radians(34))),
    # Engineering ToolBox: lubricated to dry; wet rubber; polythene.
    ("steel", "steel"): (0.16, 0.42),
    ("steel", "aluminium"): (0.30, 0.47),
    ("rubber", "concrete"): (0.45, 0.75),
    ("rubber", "steel"): (0.64 * 0.7, 0.86 * 0.8),
    # Burke and Malloy 1991; manufacturers of rigid PVC.
    ("hdpe", "steel"): (0.12, 0.22),
    ("pvc", "steel"): (0.23, 0.50),
}


@pytest.fixture
def shipped():
    return materials.load_materials()


def test_every_shipped_material_names_the_sources_of_both_numbers(shipped):
    assert set(shipped) == SHIPPED
    for name, material in shipped.items():
        assert material.name == name
        friction, separator, restitution = material.source.partition("restitution: ")
        assert friction.startswith("friction: ")
        assert separator
        assert restitution
        assert "\n" not in material.source


@pytest.mark.parametrize("pair", PUBLISHED, ids="-".join)
def test_friction_of_pairs_is_as_published(pair, shipped):
    low, high = PUBLISHED[pair]
    a, b = (shipped[name].friction for name in pair)
    assert low <= materials.pair_friction(a, b) <= high
    assert materials.pair_friction(a, b) == materials.pair_friction(b, a)


def test_pairs_of_arrays_are_those_of_their_entries():
    a, b = np.array([0.0, 0.2, 0.8]), np.array([0.5, 0.8, 0.8])
    np.testing.assert_allclose(materials.pair_friction(a, b), [0.0, 0.4, 0.8])
    np.testing.assert_array_equal(materials.pair_restitution(a, b), [0.0, 0.2, 0.8])
    np.testing.assert_array_equal(materials.pair_restitution(0.3, b), [0.3, 0.3, 0.3])
    assert materials.pair_restitution(0.6, 0.1) == 0.1


def test_materials_are_found_by_name_and_are_no_presets(shipped):
    assert materials.find_material("sand") == shipped["sand"]
    assert "materials" not in list_presets()
    with pytest.raises(ConfigError) as caught:
        materials.find_material("wood")
    assert "'wood'" in str(caught.value)
    assert all(name in str(caught.value) for name in SHIPPED)


def test_a_changed_result_leaves_the_shipped_materials_as_they_are(shipped):
    shipped.clear()
    assert set(materials.load_materials()) == SHIPPED


ENTRY = '[[material]]\nname = "ice"\nfriction = 0.1\nrestitution = 0.2\nsource = "estimate"\n'


def test_a_file_of_a_user_is_read(tmp_path):
    path = tmp_path / "ice.toml"
    path.write_text(ENTRY)
    for named in (path, str(path)):
        found = materials.load_materials(named)
        assert found == {
            "ice": materials.Material(name="ice", friction=0.1, restitution=0.2, source="estimate")
        }


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (ENTRY.replace("0.1", "-0.1"), ["material[0].friction", "-0.1"]),
        (ENTRY.replace("0.1", "2.5"), ["material[0].friction", "2.5"]),
        (ENTRY.replace("0.2", "1.1"), ["material[0].restitution", "1.1"]),
        (ENTRY.replace("0.2", "nan"), ["material[0].restitution"]),
        (ENTRY.replace('"estimate"', '""'), ["material[0].source"]),
        (ENTRY.replace("friction", "grip"), ["material[0].friction", "material[0].grip"]),
        (ENTRY + ENTRY, ["material", "'ice'", "twice"]),
        ("", ["material"]),
    ],
)
def test_faults_are_named_with_file_and_key(text, words, tmp_path):
    path = tmp_path / "faulty.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        materials.load_materials(path)
    assert all(word in str(caught.value) for word in ["faulty.toml", *words])


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.toml"):
        materials.load_materials(tmp_path / "none.toml")


def integrated_restitution(z):
    """Speed after a contact of unit mass and stiffness that ends where its force would pull."""

    def force(_, state):
        return -state[0] - 2 * z * state[1]

    def let_go(t, state):
        return force(t, state) if t > 0 else 1.0

    let_go.terminal, let_go.direction = True, -1
    # Penetration is negative here and the force positive; at the first instant the damper acts.
    found = solve_ivp(
        lambda t, state: [state[1], force(t, state)],
        (0, 200),
        [0.0, -1.0],
        events=let_go,
        method="LSODA",
        rtol=1e-11,
        atol=1e-13,
    )
    assert found.status == 1
    return found.y_events[0][0][1]


@pytest.mark.parametrize(
    "z", [0.01, 0.1, 0.3, 0.6, math.sqrt(0.5), 0.8, 0.999, 1.0, 1.001, 1.5, 3.0, 4.9]
)
def test_the_damping_ratio_gives_the_restitution_of_an_integrated_contact(z):
    e = integrated_restitution(z)
    # Some hundred steps of the integrator at a tolerance of 1e-11.
    assert materials.restitution_of_damping(z) == pytest.approx(e, abs=1e-9)
    # The restitution falls by 0.004 for each unit at the greatest ratio.
    assert materials.damping_ratio(e) == pytest.approx(z, abs=1e-6)


def test_restitution_falls_with_damping():
    z = np.concatenate([np.linspace(0, 5, 4001), 1 + np.array([-1e-9, 1e-9])])
    z.sort()
    e = materials.restitution_of_damping(z)
    assert e[0] == 1.0
    assert np.all(np.diff(e) < 0)


def test_the_damping_ratio_is_the_inverse_down_to_its_cap():
    lowest = materials.restitution_of_damping(materials.MAX_DAMPING_RATIO)
    e = np.linspace(lowest, 1.0, 2001)
    z = materials.damping_ratio(e)
    np.testing.assert_allclose(materials.restitution_of_damping(z), e, atol=1e-15)
    assert np.all(np.diff(z) < 0)
    assert z[-1] == materials.damping_ratio(1.0) == 0.0
    np.testing.assert_array_equal(
        materials.damping_ratio([0.0, 1e-9, 0.009]), materials.MAX_DAMPING_RATIO
    )
    assert 0.0092 < lowest < 0.0093


@pytest.mark.parametrize("wrong", [-0.1, 1.1, math.nan, [0.5, 2.0]])
def test_numbers_that_are_no_restitution_are_refused(wrong):
    with pytest.raises(ConfigError, match="restitution"):
        materials.damping_ratio(wrong)
