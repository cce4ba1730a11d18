"""Axes, unit and meaning of each array of environments, problems and plans on disk.

Names are those of the files. Every array that is written has an entry; one that lacks it is a fault
of this table. Positions and directions are in W (x east, y north, z up, surface at z = 0) unless a
meaning says otherwise.
"""

from dataclasses import dataclass

from zarr.types import JSON

HALF_SIZE = (
    "sphere: radius, 0, 0; box: half edges along its own x, y, z; capsule: radius, half length of "
    "its axis, 0"
)
"""Of obstacles; full edges stand in scenario files alone."""

XYZ, BODY = ("xyz",), ("uvwpqr",)


@dataclass(frozen=True)
class ArrayMetadata:
    """An array of a file."""

    axes: tuple[str, ...]
    """After ``world``."""
    unit: str
    text: str

    def attributes(self) -> dict[str, JSON]:
        """Return the attributes as stored in the file."""
        return {"unit": self.unit, "description": self.text}


_BODIES = {
    "kind": ArrayMetadata((), "1", "0 sphere, 1 box, 2 capsule"),
    "size_m": ArrayMetadata(("size",), "m", HALF_SIZE),
    "half_size_m": ArrayMetadata(("size",), "m", HALF_SIZE),
    "exists": ArrayMetadata((), "1", "whether the row is an obstacle; else padding, or not known"),
    "motion": ArrayMetadata((), "1", "0 static, 1 drifting, 2 straight, 3 sine, 4 circle"),
    "path": ArrayMetadata(
        ("column",),
        "m/s, m, rad/s or rad by motion and column",
        "of scripted motion; straight: velocity in columns 0 to 2; sine: amplitude in 0 to 2; "
        "circle: arm at angle 0 in 0 to 2, unit axis in 5 to 7; sine and circle: angular rate in "
        "3, angle at t = 0 in 4",
    ),
    "p0": ArrayMetadata(XYZ, "m", "centre at t = 0; of sine and circle the middle of the motion"),
    "q0": ArrayMetadata(("wxyz",), "1", "attitude at t = 0, body to world"),
    "nu0": ArrayMetadata(BODY, "m/s, rad/s", "velocity at t = 0 relative to the water, body frame"),
    "mass_kg": ArrayMetadata((), "kg", "mass"),
    "inertia_kgm2": ArrayMetadata(XYZ, "kg m^2", "principal moments about the centre, body axes"),
    "volume_m3": ArrayMetadata((), "m^3", "displaced volume"),
    "M_A": ArrayMetadata(BODY, "kg, kg m^2", "diagonal of the added mass, body axes"),
    "D_l": ArrayMetadata(BODY, "N s/m, N m s", "linear drag, body axes"),
    "D_q": ArrayMetadata(BODY, "N s^2/m^2, N m s^2", "quadratic drag, body axes"),
    "radius_m": ArrayMetadata(
        (), "m", "sphere about the centre that holds the body, however it turns"
    ),
    "moves": ArrayMetadata((), "1", "whether the obstacle moves"),
    "velocity_mps": ArrayMetadata(
        XYZ, "m/s", "when observed; 0 of still ones and where it is not known"
    ),
    "p_m": ArrayMetadata(("time", "xyz"), "m", "centre at obstacles/time_s; held after the last"),
    "q": ArrayMetadata(("time", "wxyz"), "1", "attitude at obstacles/time_s, body to world"),
}
"""Of obstacles; [obstacle] leads."""

_TEAM = {
    "start_m": ArrayMetadata(XYZ, "m", "start of the centre of mass"),
    "start_yaw_rad": ArrayMetadata((), "rad", "heading at the start, about z up, 0 = east"),
    "goal_m": ArrayMetadata(XYZ, "m", "goal of the centre of mass"),
    "radius_m": ArrayMetadata((), "m", "sphere about the centre of mass that holds the hull"),
    "capsule_a_m": ArrayMetadata(
        ("capsule", "xyz"), "m", "one end of a hull capsule's axis, body frame"
    ),
    "capsule_b_m": ArrayMetadata(("capsule", "xyz"), "m", "the other end, body frame"),
    "capsule_r_m": ArrayMetadata(("capsule",), "m", "radius of a hull capsule"),
    "cruise_speed_mps": ArrayMetadata((), "m/s", "speed over ground that no plan may exceed"),
    "terminal_speed_mps": ArrayMetadata(
        ("surge_sway_heave",), "m/s", "at full thrust in still water; 0 where it cannot push"
    ),
    "acceleration_mps2": ArrayMetadata(
        ("surge_sway_heave",), "m/s^2", "from rest at full thrust, added mass included"
    ),
    "power_w": ArrayMetadata(
        ("surge_sway_heave", "speed"),
        "W",
        "electrical, at speeds through the water of 0 to the terminal one in equal steps",
    ),
}
"""Of a problem's robots; [robot] leads."""

_WORLD = {
    "grid/occupied": ArrayMetadata(("x", "y", "z"), "1", "whether each cell is rock"),
    "grid/origin_m": ArrayMetadata(XYZ, "m", "lower corner of cell (0, 0, 0)"),
    "grid/cell_m": ArrayMetadata((), "m", "edge of a cell"),
    "floor_z_m": ArrayMetadata((), "m", "height of the sea floor"),
    "start_m": ArrayMetadata(("robot", "xyz"), "m", _TEAM["start_m"].text),
    "start_yaw_rad": ArrayMetadata(("robot",), "rad", _TEAM["start_yaw_rad"].text),
    "goal_m": ArrayMetadata(("robot", "xyz"), "m", _TEAM["goal_m"].text),
    "density": ArrayMetadata((), "1", "fraction of cells that are rock"),
    "path_ratio": ArrayMetadata(
        ("robot",), "1", "shortest free path over the straight line, at least 1"
    ),
    "line_free": ArrayMetadata(
        ("robot",), "1", "whether the straight line to the goal meets no rock"
    ),
    "redraws": ArrayMetadata((), "1", "samples that were rejected before this world"),
    "valid": ArrayMetadata((), "1", "false where no sample could hold the fleet"),
    "seed": ArrayMetadata((), "1", "for the planner's random numbers"),
    "obstacles/time_s": ArrayMetadata(
        ("time",), "s", "of obstacles/p_m and q, since the observation"
    ),
    "current/begin_s": ArrayMetadata(
        (), "s", "time of the observation since the start of the flight"
    ),
    **{
        f"{group}/{name}": ArrayMetadata((lead, *one.axes), one.unit, one.text)
        for group, lead, table in (("obstacles", "obstacle", _BODIES), ("team", "robot", _TEAM))
        for name, one in table.items()
    },
}
"""Of environments and problems, but for the current."""

_EDDIES = {
    "centre_m": ArrayMetadata(("vortex", "xy"), "m", "vertical axis of each vortex"),
    "circulation_m2ps": ArrayMetadata(
        ("vortex",), "m^2/s", "outside the core, positive anticlockwise seen from above"
    ),
    "core_m": ArrayMetadata(("vortex",), "m", "radius of the core"),
}
_CURRENTS = {
    "Uniform": {"velocity_mps": ArrayMetadata(XYZ, "m/s", "velocity of the water")},
    "GaussMarkov": {
        "knots_mps": ArrayMetadata(
            ("knot", "xyz"), "m/s", "velocity at each knot; held after the last"
        ),
        "knot_dt_s": ArrayMetadata((), "s", "time between knots"),
    },
    "Vortices": {
        **_EDDIES,
        "core_m": ArrayMetadata(("vortex",), "m", "radius a of the core exp(-r^2/a^2)"),
    },
    "Rankine": _EDDIES,
    "DoubleGyre": {
        "lo_m": ArrayMetadata(("xy",), "m", "lower corner of the rectangle"),
        "extent_m": ArrayMetadata(("xy",), "m", "lengths of its sides"),
        "stream_m2ps": ArrayMetadata((), "m^2/s", "greatest value of the stream function"),
        "epsilon": ArrayMetadata((), "1", "how far the wall between the gyres sways"),
        "period_s": ArrayMetadata((), "s", "of the swaying"),
    },
    "DepthProfile": {
        "depth_m": ArrayMetadata(("knot",), "m", "of the knots below the surface"),
        "knots_mps": ArrayMetadata(("knot", "xy"), "m/s", "velocity at each knot"),
        "slopes_1ps": ArrayMetadata(("knot", "xy"), "1/s", "derivative of the velocity by depth"),
    },
    "Tide": {
        "speed_radps": ArrayMetadata(("constituent",), "rad/s", "of the phase"),
        "phase_rad": ArrayMetadata(("constituent",), "rad", "at t = 0"),
        "cosine_mps": ArrayMetadata(("constituent", "xy"), "m/s", "velocity at phase 0"),
        "sine_mps": ArrayMetadata(
            ("constituent", "xy"), "m/s", "velocity a quarter of a turn later"
        ),
    },
    "Gridded": {
        "knot": ArrayMetadata(("yxdt",), "1", "knots of the file from which the world is counted"),
        "rest": ArrayMetadata(
            ("yxdt",), "1", "fraction of a step of the file's axes beyond these knots"
        ),
        "rate": ArrayMetadata(
            ("yxdt",), "1/m, 1/s", "steps of the file's axes by metre along y, x and z, by second"
        ),
        "factor": ArrayMetadata(XYZ, "1", "factor of the velocity"),
    },
}
"""Of components of a current, by the names of their classes in the attribute ``current``."""


def describe_array(name: str, current: tuple[str, ...] = ()) -> ArrayMetadata:
    """Return what an array is.

    Args:
        name: of an environment or a problem, with "/" between levels.
        current: classes of the current's components, in order.

    Raises:
        KeyError: no array has that name.
    """
    *head, number, field = ("", *name.split("/"))[-4:]
    if "current" in head and number.isdecimal():
        kind = current[int(number)]
        metadata = _CURRENTS[kind][field]
        return ArrayMetadata(metadata.axes, metadata.unit, f"{kind}: {metadata.text}")
    return _WORLD[name]
