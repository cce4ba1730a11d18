"""Vehicle files from foreign vehicles: frames, centre of mass, water, hull, thrusters."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.robot.importing import estimates
from angler_mjx.robot.importing.build_links import build_arm
from angler_mjx.robot.importing.cover import (
    Capsule,
    capsule_table,
    cover_box,
    cover_shape,
    cover_sphere,
)
from angler_mjx.robot.importing.foreign_vehicle import (
    ForeignVehicle,
    Hydrodynamics,
    Shape,
    ThrusterMount,
)
from angler_mjx.robot.importing.notes import Location, Notes
from angler_mjx.robot.importing.numbers import (
    SMALLEST_SHAPE_M,
    inertia_rows,
    round_number,
    round_vector,
    source_of,
    to_name,
)
from angler_mjx.robot.importing.rigid_groups import Group, find_thrusters, join_bodies, shapes_of
from angler_mjx.robot.importing.thrust_curves import curve_table, limit_thrust
from angler_mjx.robot.vehicles.config import MAX_BODIES
from angler_mjx.robot.vehicles.properties import compute_trim_rad
from angler_mjx.robot.vehicles.thruster_config import ThrusterTable

DEFAULT_DENSITY_KGPM3 = 1000.0
SNAP_STEP_RAD, SNAP_TOLERANCE_RAD = math.radians(15), 1.5e-3
"""Directions within the tolerance of whole multiples of the step, in azimuth and elevation, are
taken as those: files round angles to 0.785 or 1.571."""
_NEUTRAL = 0.25
"""Collision shapes are taken as the displaced volume if their buoyancy is that of the weight within
this fraction."""
_VOLTAGE_V = 16.0
_STALL_RAD = 0.3
_LAG_S = 0.02
_MAX_TRIM_RAD = math.radians(5)
"""Roll or pitch at rest above which the list says so."""
_AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")


@dataclass(frozen=True, kw_only=True)
class Trim:
    """Weight and buoyancy of an imported vehicle."""

    mass_kg: float
    volume_m3: float
    density_kgpm3: float
    """Density of the water at which the net buoyancy is stated."""


def build_vehicle(
    vehicle: ForeignVehicle,
    thruster_model: str,
    thruster: ThrusterTable,
    density: float | None,
    notes: Notes,
) -> tuple[dict[str, Any], Trim]:
    """Return the tables of a vehicle file and its trim.

    Args:
        vehicle: as read.
        thruster_model: name or path of the thruster file in the vehicle file.
        thruster: its table.
        density: of the water, kg/m^3; None: that of the file, or fresh water.
        notes: list to add to.

    Raises:
        ConfigError: the vehicle cannot exist, or does not fit a vehicle file.
    """
    find_thrusters(vehicle, notes)
    groups = join_bodies(vehicle, notes)
    base = groups[0]
    water_density = density or vehicle.density_kgpm3 or DEFAULT_DENSITY_KGPM3
    if density is None and vehicle.density_kgpm3 is None:
        notes.add("assumed", f"water of {water_density:g} kg/m^3: the file states none")
    shapes = shapes_of(base, vehicle, SMALLEST_SHAPE_M, notes)
    capsules, hull_source = _cover_hull(vehicle, base, shapes, water_density, notes)
    size_m = _extent(capsules)
    if vehicle.size_m is not None:
        size_m = np.array(vehicle.size_m)
    parts = _find_buoyancy(vehicle, base, shapes, water_density, notes)
    volume, center = _center(parts)
    _note_trim(center - base.center_of_mass_m, notes)
    trim_volume = volume
    arm = build_arm(vehicle, groups, notes)
    trim_volume += sum(link["buoyancy"]["volume_m3"] for link in arm.get("links", []))
    parameters = {
        "description": f"As in {vehicle.location.file.name}",
        "rigid_body": {
            "mass_kg": round_number(base.mass_kg),
            "inertia_kgm2": inertia_rows(base.inertia_kgm2),
            "source": source_of("mass and inertia of", vehicle, base),
        },
        "buoyancy": {
            "volume_m3": round_number(volume),
            "center_of_buoyancy_m": round_vector(center - base.center_of_mass_m),
            **_build_bodies(vehicle, base, parts, notes),
            "source": source_of("volumes of", vehicle, base),
        },
        **_build_water(vehicle, base, size_m, volume, water_density, notes),
    }
    tables: dict[str, Any] = {
        "name": to_name(vehicle.name),
        "description": f"Imported from {vehicle.location.file.name} ({vehicle.format})",
        "default_set": "imported",
        "base": {
            "center_of_mass_m": round_vector(base.center_of_mass_m),
            "source": source_of("centres of mass of", vehicle, base),
        },
        "hull": {
            "height_m": round_number(_extent(capsules)[2]),
            "capsules": [capsule_table(capsule) for capsule in capsules],
            "source": hull_source,
        },
        "thrusters": _build_thrusters(vehicle, base, thruster, notes),
        **_build_fins(vehicle, base, water_density, notes),
        "rotor": _build_rotor(vehicle, thruster_model, notes),
        "visual": _build_visual(vehicle, base, notes),
        **arm,
        "parameter_sets": {"imported": parameters},
    }
    _note_uncontrolled(tables, notes)
    mass_kg = sum(group.mass_kg for group in groups)
    trim = Trim(mass_kg=mass_kg, volume_m3=trim_volume, density_kgpm3=water_density)
    if vehicle.density_kgpm3 is not None and density not in (None, vehicle.density_kgpm3):
        notes.add(
            "converted",
            f"density {vehicle.density_kgpm3:g} kg/m^3 of the file: net buoyancy "
            f"{vehicle.density_kgpm3 * trim_volume - mass_kg:+.3f} kg there, "
            f"{water_density * trim_volume - mass_kg:+.3f} kg at {water_density:g}; damping and "
            "added mass stay as in the file",
            vehicle.density_location,
        )
    return tables, trim


def _cover_hull(
    vehicle: ForeignVehicle,
    base: Group,
    shapes: Sequence[tuple[Shape, np.ndarray]],
    density: float,
    notes: Notes,
) -> tuple[list[Capsule], str]:
    """Return the capsules of the hull, in the base frame, and their source."""
    capsules: list[Capsule] = []
    for shape, pose in shapes:
        capsules += cover_shape(shape, pose)
    locations = [shape.element.location for shape, _ in shapes]
    if capsules and len(capsules) <= 64:
        notes.add("converted", "collision shapes: capsules of their extents or more", *locations)
        return capsules, f"collision shapes of {vehicle.location.file.name}, covered by capsules"
    if capsules:
        box = np.array([end for a, b, _ in capsules for end in (a, b)])
        radius = max(radius for *_, radius in capsules)
        low, high = box.min(axis=0) - radius, box.max(axis=0) + radius
        pose = np.eye(4)
        pose[:3, 3] = (low + high) / 2
        notes.add(
            "converted",
            f"{len(locations)} collision shapes: the box around them all, as capsules",
            *locations,
        )
        return cover_box((high - low) / 2, pose), "box around the collision shapes"
    pose = np.eye(4)
    pose[:3, 3] = base.center_of_mass_m
    if vehicle.size_m is not None:
        notes.add(
            "assumed", "hull: the box of the file about the centre of mass", vehicle.size_location
        )
        return cover_box(np.array(vehicle.size_m) / 2, pose), "box of the file"
    radius = (base.mass_kg / density / (4 / 3 * math.pi)) ** (1 / 3)
    notes.add(
        "assumed",
        f"hull: no collision shape is read; a ball of {radius:.3f} m that "
        "displaces its weight. Write boxes as collision shapes, or edit [hull]",
        vehicle.location,
    )
    return cover_sphere(radius, pose), "assumed: a ball of the displaced volume"


def _extent(capsules: Sequence[Capsule]) -> np.ndarray:
    """Return the edge lengths [3] of the box around capsules."""
    low = np.min([np.minimum(a, b) - radius for a, b, radius in capsules], axis=0)
    high = np.max([np.maximum(a, b) + radius for a, b, radius in capsules], axis=0)
    extent: np.ndarray = high - low
    return extent


def _find_buoyancy(
    vehicle: ForeignVehicle,
    base: Group,
    shapes: Sequence[tuple[Shape, np.ndarray]],
    density: float,
    notes: Notes,
) -> list[tuple[float, np.ndarray]]:
    """Return the displaced volume of each part, and its centre [3] in the base frame."""
    parts = []
    for name, pose in base.poses.items():
        body = vehicle.bodies[name]
        if body.volume_m3 is not None:
            if body.volume_m3 < 0 and body.water is not None:
                body.water.fail(f"volume {body.volume_m3:g}: it must be positive")
            point = body.center_of_buoyancy_m
            if point is None:
                point = body.center_of_mass_m
                notes.add(
                    "assumed",
                    f"centre of buoyancy of link {name}: its centre of mass",
                    None if body.water is None else body.water.location,
                )
            parts.append((body.volume_m3, (pose @ np.append(point, 1.0))[:3]))
    if sum(volume for volume, _ in parts) > 0:
        return [part for part in parts if part[0] > 0]
    parts = [(shape.volume_m3, pose[:3, 3]) for shape, pose in shapes]
    locations = [shape.element.location for shape, _ in shapes]
    volume = sum(part for part, _ in parts)
    ratio = volume * density / base.mass_kg
    if abs(ratio - 1) <= _NEUTRAL:
        notes.add(
            "assumed",
            f"displaced volume: that of the collision shapes, {volume:.6g} m^3, "
            f"{ratio:.4f} times the weight at {density:g} kg/m^3",
            *locations,
        )
        return [_center(parts)]
    center = _center(parts)[1] if parts else base.center_of_mass_m
    reason = f"collision shapes displace {ratio:.3g} times the weight" if parts else "no volume"
    notes.add(
        "assumed",
        f"displaced volume: that of the weight at {density:g} kg/m^3 ({reason}); "
        "centre of buoyancy: " + ("that of the shapes" if parts else "the centre of mass"),
        *locations,
    )
    return [(base.mass_kg / density, center)]


def _build_bodies(
    vehicle: ForeignVehicle,
    base: Group,
    parts: Sequence[tuple[float, np.ndarray]],
    notes: Notes,
) -> dict[str, Any]:
    """Return the bodies of a hull where several links state volumes: each floats by itself."""
    if len(parts) < 2:
        return {}
    water = [body.water for name in base.poses if (body := vehicle.bodies[name]).volume_m3]
    where = [element.location for element in water if element is not None]
    if len(parts) > MAX_BODIES:
        notes.add(
            "dropped",
            f"the places of {len(parts)} volumes at the surface: the hull leaves the water as one "
            f"body; {MAX_BODIES} are the most",
            *where,
        )
        return {}
    notes.add(
        "assumed",
        f"{len(parts)} volumes leave the water by themselves, each over the height of a ball",
        *where,
    )
    return {
        "bodies": [
            {
                "volume_m3": round_number(volume),
                "center_m": round_vector(point - base.center_of_mass_m),
                "height_m": round_number(float(np.cbrt(6.0 / np.pi * volume))),
            }
            for volume, point in parts
        ]
    }


def _center(parts: Sequence[tuple[float, np.ndarray]]) -> tuple[float, np.ndarray]:
    total = sum(volume for volume, _ in parts)
    return total, sum((volume * point for volume, point in parts), np.zeros(3)) / total


def _build_water(
    vehicle: ForeignVehicle,
    base: Group,
    size_m: np.ndarray,
    volume: float,
    density: float,
    notes: Notes,
) -> dict[str, Any]:
    """Return the tables added_mass and damping."""
    added, linear, quadratic = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6))
    locations = dict[str, list[Location]](added=[], damping=[])
    products = dict[str, float]()
    for water in vehicle.hydrodynamics:
        pose = base.poses.get(water.body)
        if pose is None:
            notes.add(
                "dropped",
                f"hydrodynamics of link {water.body} of an arm: it gets that of its shapes",
                water.element.location,
            )
            continue
        turn = np.kron(np.eye(2), pose[:3, :3])
        arm = pose[:3, 3] - base.center_of_mass_m
        where = water.element.location
        if water.added_mass is not None:
            locations["added"].append(where)
            symmetric = _symmetric_added_mass(water.added_mass, where, notes)
            added += _shift(turn @ symmetric @ turn.T, arm)
            if np.linalg.norm(arm) > 1e-9 and np.any(water.added_mass):
                notes.add(
                    "converted",
                    f"added mass: moved from the origin of {water.body} to the "
                    f"centre of mass, by {_text(-arm)} m",
                    where,
                )
        for name, matrix, total in (
            ("linear", water.linear, linear),
            ("quadratic", water.quadratic, quadratic),
        ):
            if matrix is None:
                continue
            locations["damping"].append(where)
            total += turn @ _coupled_damping(matrix, name, turn, water, notes) @ turn.T
        for name, value in _unturned_products(water, pose, notes).items():
            products[name] = products.get(name, 0.0) + value
        if np.linalg.norm(arm) > 1e-9:
            notes.add(
                "assumed",
                f"damping acts at the centre of mass, {_text(-arm)} m from the "
                f"origin of {water.body}",
                where,
            )
        if not np.allclose(np.abs(turn).max(axis=0), 1.0, atol=1e-6):
            notes.add(
                "assumed",
                f"quadratic damping of {water.body}, which is turned: its part along the vehicle's "
                "axes",
                where,
            )
    return {
        "added_mass": _build_added_mass(added, locations["added"], size_m, volume, density, notes),
        "damping": _build_damping(linear, quadratic, locations["damping"], size_m, density, notes)
        | ({"products": products} if products else {}),
    }


def _unturned_products(water: Hydrodynamics, pose: np.ndarray, notes: Notes) -> dict[str, float]:
    """Return the derivatives by products of velocities; none of a link whose axes are turned."""
    if not water.products or np.allclose(pose[:3, :3], np.eye(3), atol=1e-6):
        return water.products
    listed = ", ".join(f"{name} = {value:g}" for name, value in water.products.items())
    notes.add(
        "dropped",
        f"products of velocities of {water.body} ({listed}): the axes of its link are turned",
        water.element.location,
    )
    return {}


def _coupled_damping(
    matrix: np.ndarray, name: str, turn: np.ndarray, water: Hydrodynamics, notes: Notes
) -> np.ndarray:
    """Return the part of a damping matrix [6, 6] that a vehicle file can hold.

    Linear damping wholly, unless still water would drive the vehicle by it. Quadratic damping
    between axes keeps its form in frames whose axes are along the vehicle's alone.
    """
    diagonal: np.ndarray = np.diag(np.diag(matrix))
    is_aligned = np.allclose(np.abs(turn).max(axis=0), 1.0, atol=1e-6)
    reason = None
    if name == "quadratic" and not is_aligned:
        reason = "the axes of its link are turned"
    elif name == "linear" and np.linalg.eigvalsh(matrix + matrix.T)[0] < -1e-9:
        reason = "with it still water would drive the vehicle"
    for (table, i, j), label in water.names.items():
        if table == name and i != j and matrix[i, j] != 0 and reason:
            notes.add(
                "dropped",
                f"{name} damping {label} = {matrix[i, j]:g}: {reason}",
                water.element.location,
            )
    return diagonal if reason else matrix


def _symmetric_added_mass(added: np.ndarray, where: Location, notes: Notes) -> np.ndarray:
    """Return added mass [6, 6] as a symmetric matrix.

    Raises:
        ConfigError: it is far from symmetric, or negative.
    """
    label = f"{where.file}:{where.line}: added mass"
    skew = np.abs(added - added.T)
    if np.max(skew) > 0.01 * np.max(np.abs(added)):
        i, j = np.unravel_index(np.argmax(skew), skew.shape)
        raise ConfigError(
            f"{label}: entries [{i}][{j}] = {added[i, j]:g} and [{j}][{i}] = {added[j, i]:g} "
            "differ; make the matrix symmetric"
        )
    for i, j in np.argwhere(np.triu(skew) > 1e-9):
        notes.add(
            "snapped",
            f"added mass [{i}][{j}] = {added[i, j]:g} and [{j}][{i}] = {added[j, i]:g}: their mean",
            where,
        )
    symmetric: np.ndarray = (added + added.T) / 2
    low, *_, high = np.linalg.eigvalsh(symmetric)
    if low < -1e-6 * max(high, 0.0):
        raise ConfigError(
            f"{label}: a principal value is negative, {low:.4g}; correct its signs and sizes"
        )
    return symmetric


def _shift(matrix: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Return added mass [6, 6] at the centre of mass, from that at ``arm`` [3] away from it."""
    transform = np.eye(6)
    x, y, z = arm
    transform[:3, 3:] = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    shifted: np.ndarray = transform.T @ matrix @ transform
    return shifted


def _build_added_mass(
    added: np.ndarray,
    locations: Sequence[Location],
    size_m: np.ndarray,
    volume: float,
    density: float,
    notes: Notes,
) -> dict[str, Any]:
    if not locations:
        values = estimates.estimate_added_mass(size_m.tolist(), volume, density)
        notes.add(
            "assumed",
            f"added mass: that of an ellipsoid of the hull's proportions "
            f"{_text(size_m)} m and of the displaced volume; the file states none",
        )
        return {
            "coefficients": [round_number(x) for x in values],
            "source": "assumed: ellipsoid of the hull's proportions (Lamb)",
        }
    added = added + 0.0
    is_diagonal = np.allclose(added, np.diag(np.diag(added)), rtol=0, atol=1e-9 * np.max(added))
    rows = [[round_number(x) for x in row] for row in added]
    return {
        "coefficients": [rows[i][i] for i in range(6)] if is_diagonal else rows,
        "source": ", ".join(dict.fromkeys(map(str, locations))),
    }


def _build_damping(
    linear: np.ndarray,
    quadratic: np.ndarray,
    locations: Sequence[Location],
    size_m: np.ndarray,
    density: float,
    notes: Notes,
) -> dict[str, Any]:
    empty = [i for i in range(6) if linear[i, i] <= 0 and quadratic[i, i] <= 0]
    source = ", ".join(dict.fromkeys(map(str, locations))) or "assumed"
    quadratic = np.array(quadratic)
    if empty:
        drag = estimates.estimate_quadratic_drag(size_m.tolist(), density)
        quadratic[empty, empty] = drag[empty]
        names = ", ".join(_AXES[i] for i in empty)
        notes.add(
            "assumed",
            f"quadratic damping in {names}: half rho A Cd of the hull's box "
            f"{_text(size_m)} m with Cd {estimates.DRAG_COEFFICIENT:g}; the file states none",
            *locations,
        )
        source += f"; {names}: assumed, drag of the hull's box"
    return {
        "linear": _damping_table(linear),
        "quadratic": _damping_table(quadratic),
        "source": source,
    }


def _damping_table(matrix: np.ndarray) -> list[float] | list[list[float]]:
    """Return six values of a matrix that is diagonal, six rows of others."""
    rows = [[round_number(x) for x in row] for row in matrix]
    diagonal = [max(rows[i][i], 0.0) for i in range(6)]
    if not np.any(matrix - np.diag(np.diag(matrix))):
        return diagonal
    for i in range(6):
        rows[i][i] = diagonal[i]
    return rows


def _build_thrusters(
    vehicle: ForeignVehicle, base: Group, thruster: ThrusterTable, notes: Notes
) -> dict[str, Any]:
    mounts = vehicle.thrusters
    if all(mount.order is not None for mount in mounts):
        mounts = sorted(mounts, key=lambda mount: mount.order or 0)
    layout, names = [], dict[str, str]()
    differ = len({mount.lag_s for mount in mounts if mount.lag_s}) > 1
    for mount in mounts:
        pose = base.poses.get(mount.body)
        if pose is None:
            mount.element.fail(
                f"thruster {format_value(mount.name)} is on link {format_value(mount.body)}, which "
                "a joint moves; only thrusters that are fixed to the vehicle are read"
            )
        curve = mount.curve_n
        if curve is None:
            curve = limit_thrust(mount, thruster, _VOLTAGE_V, notes)
        name = to_name(re.sub(r"_?joint$", "", mount.name.rpartition("/")[2]))
        if name in names.values():
            name = to_name(mount.name)
        names[mount.name] = name
        layout.append(
            {
                "name": name,
                "position_m": round_vector((pose @ np.append(mount.position_m, 1.0))[:3]),
                "direction": _snap_direction(pose[:3, :3] @ mount.direction, mount, notes),
                "spin": mount.spin or 1,
                **({"time_constant_s": mount.lag_s} if differ and mount.lag_s else {}),
                **({} if curve is None else {"curve": curve_table(curve)}),
            }
        )
        if mount.spin is None:
            notes.add(
                "assumed",
                "spin of thrusters: +1 (without a reaction torque it has no effect)",
                mount.element.location,
            )
    if any(before != after for before, after in names.items()):
        notes.add(
            "converted",
            "names of thrusters: "
            + ", ".join(
                f"{before} -> {after}" for before, after in names.items() if before != after
            ),
        )
    return {
        "layout": layout,
        "source": f"{vehicle.location.file.name}: poses of the thrusters' links and axes of their "
        "joints; spin as stated there",
    }


def _build_fins(
    vehicle: ForeignVehicle, base: Group, density: float, notes: Notes
) -> dict[str, Any]:
    """Return the table of fins; none where the file has none."""
    layout: list[dict[str, Any]] = []
    for mount in vehicle.fin_mounts:
        where, pose = mount.element.location, base.poses.get(mount.body)
        if pose is None:
            notes.add("dropped", f"fin {mount.body}: it is on a link of an arm", where)
            continue
        chord = mount.forward / np.linalg.norm(mount.forward)
        span = np.cross(chord, mount.upward)
        if np.linalg.norm(span) < 1e-6:
            mount.element.fail("forward and upward of a fin are along each other; turn one")
        span = span / np.linalg.norm(span)
        joint = next((j for j in vehicle.joints if j.child == mount.body), None)
        limit = 0.0
        if joint is not None and joint.kind != "fixed" and joint.lower is not None:
            limit = max(abs(joint.lower), abs(joint.upper or 0.0))
            if joint.lower + (joint.upper or 0.0) != 0.0:
                notes.add("converted", f"limits of fin {mount.body}: the larger, both ways", where)
        stall = min(max(mount.stall_rad or _STALL_RAD, 0.01), 0.7)
        drag = mount.drag_slope or 0.0
        # The parabola of drag meets the line of the file at the stall.
        induced = drag / (mount.lift_slope**2 * stall) if drag > 0 else 1.0 / (math.pi * 0.9 * 3.0)
        layout.append(
            {
                "name": to_name(mount.body.rpartition("/")[2]),
                "position_m": round_vector((pose @ np.append(mount.position_m, 1.0))[:3]),
                "span": round_vector(pose[:3, :3] @ span, 16),
                "chord": round_vector(pose[:3, :3] @ chord, 16),
                "area_m2": round_number(mount.area_m2),
                "aspect_ratio": round_number(1.0 / (math.pi * 0.9 * induced)),
                "lift_slope_per_rad": round_number(mount.lift_slope),
                "zero_lift_drag": 0.0,
                "stall_rad": round_number(stall),
                "limit_rad": round_number(limit),
                "rate_radps": 1.0,
                "time_constant_s": 0.1,
            }
        )
        notes.add(
            "converted",
            f"fin {mount.body}: drag "
            + (f"as the file's, {drag:g} per radian, at the stall" if drag > 0 else "assumed")
            + f"; force in water of {density:g} kg/m^3",
            where,
        )
    if not layout:
        return {}
    notes.add(
        "assumed", "servos of fins: a lag of 0.1 s and at most 1 rad/s; the file states neither"
    )
    return {
        "fins": {
            "layout": layout,
            "source": f"{vehicle.location.file.name}: lift and drag of its fins; servos assumed",
        }
    }


def _snap_direction(direction: np.ndarray, mount: ThrusterMount, notes: Notes) -> list[float]:
    length = float(np.linalg.norm(direction))
    if not length > 1e-9:
        mount.element.fail(
            f"thruster {format_value(mount.name)} pushes along an axis of length zero; write a "
            "unit vector as the axis of its joint"
        )
    unit = direction / length
    azimuth, elevation = math.atan2(unit[1], unit[0]), math.asin(np.clip(unit[2], -1, 1))
    elevation = round(elevation / SNAP_STEP_RAD) * SNAP_STEP_RAD
    azimuth = round(azimuth / SNAP_STEP_RAD) * SNAP_STEP_RAD
    flat = math.cos(elevation)
    snapped = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])
    angle = math.atan2(float(np.linalg.norm(np.cross(unit, snapped))), float(unit @ snapped))
    if angle > SNAP_TOLERANCE_RAD:
        return round_vector(unit, 16)
    if angle > 1e-9:
        notes.add(
            "snapped",
            f"direction of {mount.name}: {_text(unit, 6)} to {_text(snapped, 6)}, by "
            f"{angle:.2g} rad",
            mount.element.location,
        )
    return round_vector(np.where(np.abs(snapped) < 1e-12, 0.0, snapped), 16)


def _note_trim(center_of_buoyancy_m: np.ndarray, notes: Notes) -> None:
    trim_rad = compute_trim_rad(center_of_buoyancy_m)
    if trim_rad is not None and max(np.abs(trim_rad)) > _MAX_TRIM_RAD:
        roll, pitch = np.degrees(trim_rad)
        notes.add(
            "assumed",
            f"the vehicle rests with a roll of {roll:.0f} and a pitch of {pitch:.0f} degrees: its "
            f"centre of buoyancy is {_text(center_of_buoyancy_m)} m from the centre of mass; if it "
            "floats level, correct masses or volumes",
        )


def _build_rotor(vehicle: ForeignVehicle, model: str, notes: Notes) -> dict[str, Any]:
    lags = [mount.lag_s for mount in vehicle.thrusters if mount.lag_s]
    lag, source = _LAG_S, "assumed: as the T200 of the shipped vehicles"
    if lags:
        lag, source = float(np.mean(lags)), f"{vehicle.location.file.name}: first-order dynamics"
    else:
        notes.add("assumed", f"lag of thrusters: {lag:g} s; the file states none")
    notes.add(
        "assumed",
        f"reaction torque of thrusters: 0; PWM, thrust and power: those of thruster {model}",
    )
    return {
        "model": model,
        "lag": {"time_constant_s": lag, "source": source},
        "reaction_torque": {"coefficient_m": 0.0, "source": "assumed: the file states none"},
    }


def _build_visual(vehicle: ForeignVehicle, base: Group, notes: Notes) -> dict[str, Any]:
    shapes: list[dict[str, Any]] = []
    for name, base_pose in base.poses.items():
        for shape in vehicle.bodies[name].visuals:
            pose = base_pose @ shape.pose
            label = f"{to_name(name.rpartition('/')[2])[:50]}_{len(shapes)}"
            table: dict[str, Any] = {"name": label, "shape": shape.kind}
            permuted = np.abs(pose[:3, :3])
            if min(shape.size) <= 0 or np.linalg.norm(shape.half_extents_m) < SMALLEST_SHAPE_M:
                notes.add("dropped", "visual shapes below 1 mm", shape.element.location)
                continue
            if shape.kind == "box" and np.any(np.abs(permuted.max(axis=0) - 1) > 1e-3):
                notes.add(
                    "dropped",
                    "visual boxes that are turned: vehicle files hold them along the axes",
                    shape.element.location,
                )
                continue
            if shape.kind == "box":
                table |= {
                    "position_m": round_vector(pose[:3, 3]),
                    "size_m": round_vector(np.round(permuted) @ np.array(shape.size)),
                }
            elif shape.kind == "cylinder":
                along = pose[:3, 2] * shape.size[1] / 2
                table |= {
                    "from_m": round_vector(pose[:3, 3] - along),
                    "to_m": round_vector(pose[:3, 3] + along),
                    "radius_m": round_number(shape.size[0]),
                }
            else:
                table |= {
                    "position_m": round_vector(pose[:3, 3]),
                    "radius_m": round_number(shape.size[0]),
                }
            shapes.append(table | {"rgba": list(shape.rgba or (0.5, 0.55, 0.6, 1.0))})
    if len(shapes) > 256:
        notes.add("dropped", f"visual shapes after the first 256 of {len(shapes)}")
    return {
        "shapes": shapes[:256],
        "source": f"{vehicle.location.file.name}: boxes, cylinders and balls of its visuals",
    }


def _note_uncontrolled(tables: dict[str, Any], notes: Notes) -> None:
    center = np.array(tables["base"]["center_of_mass_m"])
    columns = []
    for thruster in tables["thrusters"]["layout"]:
        force = np.array(thruster["direction"])
        moment = np.cross(np.array(thruster["position_m"]) - center, force)
        columns.append(np.concatenate([force, moment]))
    matrix = np.array(columns).T
    scale = np.array([1, 1, 1] + 3 * [max(np.max(np.abs(matrix[3:])), 1e-3)])
    reach = np.linalg.pinv(matrix / scale[:, None]) if matrix.size else np.zeros((1, 6))
    product = matrix / scale[:, None] @ reach
    weak = [name for i, name in enumerate(_AXES) if product[i, i] < 0.2]
    if weak:
        notes.add(
            "assumed",
            f"the thrusters do not push in {', '.join(weak)}: the vehicle is left "
            "to its restoring moment and drag there",
        )


def _text(vector: np.ndarray, digits: int = 4) -> str:
    return (
        "("
        + ", ".join(f"{x + 0.0:.{digits}g}" for x in np.where(np.abs(vector) < 1e-12, 0.0, vector))
        + ")"
    )
