"""Plugins of Gazebo in URDF and SDF files: hydrodynamics, thrusters, buoyancy, fins.

Gazebo's Hydrodynamics system states derivatives of the force, so added mass and damping are
negative there. UUV Simulator states added mass positive and damping negative, both along x forward,
y right, z down.
"""

import re
from collections.abc import Callable

import numpy as np

from angler_mjx.errors import format_value
from angler_mjx.robot.importing.foreign_vehicle import (
    FinMount,
    ForeignVehicle,
    Hydrodynamics,
    JointLink,
    ThrusterMount,
)
from angler_mjx.robot.importing.notes import Notes
from angler_mjx.robot.importing.thrust_curves import read_conversion
from angler_mjx.robot.importing.xml_tree import Element

_ROWS, _COLUMNS = "xyzkmn", "UVWPQR"
_ADDED = re.compile(f"^([{_ROWS}])Dot([{_COLUMNS}])$")
_LINEAR = re.compile(f"^([{_ROWS}])([{_COLUMNS}])$")
_QUADRATIC = re.compile(f"^([{_ROWS}])([{_COLUMNS}])(abs)?([{_COLUMNS}])$")

TO_NED = np.diag([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
"""[6, 6] between x forward, y left, z up and x forward, y right, z down."""


def read_plugins(parent: Element, vehicle: ForeignVehicle, notes: Notes) -> None:
    """Read the plugins below an element; the rest stays unread.

    Raises:
        ConfigError: a plugin names what is not there, or contradicts another one.
    """
    for plugin in parent.children:
        if plugin.tag != "plugin":
            continue
        reader = _find_reader(plugin)
        if reader is not None:
            plugin.is_read = True
            plugin.read_attributes.update(("filename", "name"))
            reader(plugin, vehicle, notes)


def _find_reader(plugin: Element) -> Callable[[Element, ForeignVehicle, Notes], None] | None:
    text = plugin.attributes.get("filename", "").lower().replace("_", "-")
    text += " " + plugin.attributes.get("name", "").lower().rpartition("::")[2]
    for word, reader in (
        ("uuv-thruster", _read_uuv_thruster),
        ("uuv-underwater-object", _read_uuv_objects),
        ("uuv-fin", _read_fin),
        ("thruster-system", _read_thruster),
        ("hydrodynamics", _read_hydrodynamics),
        ("lift-drag", _read_fin),
        ("liftdrag", _read_fin),
        ("buoyancyplugin", _read_buoyancy),
        ("buoyancy-system", _read_buoyancy_system),
    ):
        if word in text:
            return reader
    return None


def _read_hydrodynamics(plugin: Element, vehicle: ForeignVehicle, notes: Notes) -> None:
    body = _find_body(plugin, "link_name", vehicle)
    water = Hydrodynamics(
        body=body,
        element=plugin,
        added_mass=np.zeros((6, 6)),
        linear=np.zeros((6, 6)),
        quadratic=np.zeros((6, 6)),
    )
    named = set[str]()
    for child in plugin.children:
        if child.tag in ("water_density", "waterDensity"):
            _set_density(child, vehicle)
        elif child.tag in ("disable_added_mass", "disable_coriolis"):
            child.is_read = True
            is_off = child.text.strip().lower() in ("1", "true")
            if is_off:
                notes.add(
                    "converted",
                    f"<{child.tag}> = true: the terms are flown all the same",
                    child.location,
                )
        elif match := _ADDED.match(child.tag):
            _set_entry(water, "added_mass", match[1], match[2], child, notes)
        elif match := _LINEAR.match(child.tag):
            _set_entry(water, "linear", match[1], match[2], child, notes)
        elif match := _QUADRATIC.match(child.tag):
            _read_quadratic(water, match, child, notes)
        else:
            continue
        named.add(child.tag)
    missing = [
        key
        for row, column in zip(_ROWS, _COLUMNS, strict=True)
        for key in (f"{row}Dot{column}", f"{row}{column}")
        if key not in named
    ]
    if missing:
        notes.add(
            "assumed",
            f"{', '.join(missing)} = 0: the plugin does not state them (Gazebo's default differs "
            "by version)",
            plugin.location,
        )
    notes.add(
        "converted",
        "Gazebo's Hydrodynamics: added mass and damping negated into positive numbers",
        plugin.location,
    )
    _add_hydrodynamics(water, vehicle, notes)


def _set_entry(
    water: Hydrodynamics, table: str, row: str, column: str, child: Element, notes: Notes
) -> None:
    i, j, value = _ROWS.index(row), _COLUMNS.index(column), -child.number()
    if i != j and table != "added_mass":
        water.names[table, i, j] = f"<{child.tag}>"
    if i == j and value < 0:
        notes.add(
            "assumed",
            f"<{child.tag}> = {-value:g} is positive where Gazebo's derivatives are negative: "
            f"taken as {-value:g}",
            child.location,
        )
        value = -value
    getattr(water, table)[i, j] += value + 0.0


def _read_quadratic(
    water: Hydrodynamics, match: re.Match[str], child: Element, notes: Notes
) -> None:
    row, first, absolute, second = match.groups()
    value = child.number()
    if value == 0:
        return
    is_diagonal = first == second == _COLUMNS[_ROWS.index(row)]
    if absolute and first != second:
        notes.add(
            "dropped",
            f"<{child.tag}> = {value:g}: vehicle files hold |v| v of one velocity and products of "
            "two, and no velocity times the size of another",
            child.location,
        )
        return
    if not absolute and not is_diagonal:
        pair = "".join(sorted((first, second), key=_COLUMNS.index)).lower()
        name = f"{row.upper()}_{pair}"
        water.products[name] = water.products.get(name, 0.0) + value
        return
    if not absolute:
        notes.add(
            "converted",
            f"<{child.tag}> = {value:g} has no absolute value (newer Gazebo: drag in one sense "
            "only): read as that of |v| v",
            child.location,
        )
    _set_entry(water, "quadratic", row, first, child, notes)


def _read_thruster(plugin: Element, vehicle: ForeignVehicle, notes: Notes) -> None:
    element = plugin.find("joint_name")
    if element is None:
        plugin.fail("has no <joint_name>; add it")
    joint = _find_joint(element, vehicle)
    coefficient = _optional_number(plugin, "thrust_coefficient")
    for tag in ("propeller_diameter", "fluid_density"):
        value = _optional_number(plugin, tag)
        if value is not None:
            notes.add(
                "dropped",
                f"<{tag}> = {value:g} of thrusters: the thruster file has the thrust",
                plugin.location,
            )
    if coefficient is not None:
        notes.add(
            "converted",
            f"<thrust_coefficient> = {coefficient:g}: its sign gives the spin, the thruster file "
            "the thrust",
            plugin.location,
        )
    _add_thruster(
        ThrusterMount(
            name=joint.name,
            body=joint.child,
            position_m=np.zeros(3),
            direction=joint.axis,
            element=plugin,
            spin=None if coefficient is None else (-1 if coefficient < 0 else 1),
            max_thrust_n=_optional_number(plugin, "max_thrust_cmd"),
            min_thrust_n=_optional_number(plugin, "min_thrust_cmd"),
            joint=joint.name,
        ),
        vehicle,
        notes,
    )


def _read_fin(plugin: Element, vehicle: ForeignVehicle, notes: Notes) -> None:
    for tag in ("link_name", "linkName"):
        element = plugin.find(tag)
        if element is not None:
            vehicle.fins[element.text.strip()] = plugin
    link = plugin.find("link_name") or plugin.find("linkName")
    slope, area = _optional_number(plugin, "cla"), _optional_number(plugin, "area")
    if link is None or not slope or not area:
        missing = "link_name" if link is None else "cla" if not slope else "area"
        notes.add("dropped", f"lift and drag of a fin: it states no {missing}", plugin.location)
        plugin.read()
        return
    zero = _optional_number(plugin, "a0")
    if zero:
        notes.add("dropped", f"a0 = {zero:g} of a fin: foils are symmetric", plugin.location)
    body = _find_body(plugin, link.tag, vehicle)
    vectors = {
        tag: np.array(default if element is None else element.numbers(3), float)
        for tag, default in (("cp", (0, 0, 0)), ("forward", (1, 0, 0)), ("upward", (0, 0, 1)))
        for element in [plugin.find(tag)]
    }
    vehicle.fin_mounts.append(
        FinMount(
            body=body,
            element=plugin,
            position_m=vectors["cp"],
            forward=vectors["forward"],
            upward=vectors["upward"],
            area_m2=area,
            lift_slope=slope,
            stall_rad=_optional_number(plugin, "alpha_stall"),
            drag_slope=_optional_number(plugin, "cda"),
        )
    )
    rest = [
        f"{child.tag} = {child.text.strip()}"
        for child in plugin.children
        if child.tag in ("cla_stall", "cda_stall", "cma", "cma_stall", "cm_delta")
    ]
    if rest:
        notes.add(
            "dropped",
            f"of a fin: {', '.join(rest)}; beyond the stall it is a plate",
            plugin.location,
        )
    plugin.read()


def _read_buoyancy_system(plugin: Element, vehicle: ForeignVehicle, notes: Notes) -> None:
    for tag in ("uniform_fluid_density", "default_density"):
        for child in [plugin, *plugin.children]:
            element = child.find(tag)
            if element is not None:
                child.is_read = True
                _set_density(element, vehicle)


def _read_buoyancy(plugin: Element, vehicle: ForeignVehicle, notes: Notes) -> None:
    density = plugin.find("fluid_density")
    if density is not None:
        _set_density(density, vehicle)
    for link in plugin.find_all("link"):
        body = vehicle.bodies.get(link.attribute("name"))
        if body is None:
            link.fail("there is no such link; correct the name")
        volume, center = link.find("volume"), link.find("center_of_volume")
        if volume is not None:
            body.volume_m3, body.water = volume.number(), volume
        if center is not None:
            body.center_of_buoyancy_m = np.array(center.numbers(3))


def _read_uuv_thruster(plugin: Element, vehicle: ForeignVehicle, notes: Notes) -> None:
    body = _find_body(plugin, "linkName", vehicle)
    element, axis, name = plugin.find("jointName"), np.array([1.0, 0.0, 0.0]), body
    if element is not None:
        joint = _find_joint(element, vehicle)
        axis, name = joint.axis, joint.name
    number = plugin.find("thrusterID")
    dynamics, lag = plugin.find("dynamics"), None
    if dynamics is not None:
        kind = dynamics.find("type")
        lag = _optional_number(dynamics, "timeConstant")
        if kind is not None and kind.text.strip() not in ("FirstOrder", "ZeroOrder"):
            notes.add(
                "converted",
                f"dynamics of type {kind.text.strip()} of thrusters: a first-order lag",
                dynamics.location,
            )
    conversion = plugin.find("conversion")
    curve = None if conversion is None else read_conversion(plugin, conversion, notes)
    _add_thruster(
        ThrusterMount(
            name=name,
            body=body,
            position_m=np.zeros(3),
            direction=axis,
            element=plugin,
            order=None if number is None else int(number.number()),
            lag_s=lag,
            max_thrust_n=_optional_number(plugin, "thrustMax"),
            min_thrust_n=_optional_number(plugin, "thrustMin"),
            curve_n=curve,
            joint=None if element is None else element.text.strip(),
        ),
        vehicle,
        notes,
    )


def _read_uuv_objects(plugin: Element, vehicle: ForeignVehicle, notes: Notes) -> None:
    density = plugin.find("fluid_density")
    if density is not None:
        _set_density(density, vehicle)
    for link in plugin.find_all("link"):
        name = link.attribute("name")
        if name not in vehicle.bodies:
            link.fail("there is no such link; correct the name")
        _read_uuv_link(link, name, vehicle, notes)


def _read_uuv_link(link: Element, name: str, vehicle: ForeignVehicle, notes: Notes) -> None:
    body = vehicle.bodies[name]
    volume, center, box = (link.find(tag) for tag in ("volume", "center_of_buoyancy", "box"))
    neutral = link.find("neutrally_buoyant")
    if volume is not None:
        body.volume_m3, body.water = volume.number(), volume
    if neutral is not None and neutral.text.strip() in ("1", "true"):
        body.volume_m3 = body.mass_kg / (vehicle.density_kgpm3 or 1000.0)
        body.water = neutral
        notes.add(
            "converted", "<neutrally_buoyant>: the volume of its mass in water", neutral.location
        )
    if center is not None:
        body.center_of_buoyancy_m = np.array(center.numbers(3))
    if box is not None:
        sizes = [_optional_number(box, tag) or 0.0 for tag in ("length", "width", "height")]
        if min(sizes) <= 0:
            box.fail("length, width and height must be positive; write all three")
        vehicle.size_m, vehicle.size_location = (sizes[0], sizes[1], sizes[2]), box.location
    model = link.find("hydrodynamic_model")
    if model is None:
        return
    kind = model.find("type")
    if kind is None or kind.text.strip() != "fossen":
        reason = "" if kind is None else kind.text.strip()
        notes.add(
            "dropped", f"hydrodynamic model of type {reason!r}: only fossen is read", model.location
        )
        model.read()
        return
    added = _uuv_matrix(model, "added_mass", notes)
    linear = _uuv_matrix(model, "linear_damping", notes)
    quadratic = _uuv_matrix(model, "quadratic_damping", notes)
    names = {
        (table, i, j): f"{tag}[{i}][{j}]"
        for table, tag in (("linear", "linear_damping"), ("quadratic", "quadratic_damping"))
        for i in range(6)
        for j in range(6)
    }
    for tag, matrix in (("linear_damping", linear), ("quadratic_damping", quadratic)):
        if matrix is not None and np.any(np.diag(matrix) > 0):
            element = model.find(tag)
            notes.add(
                "assumed",
                f"<{tag}> is positive where UUV Simulator's is negative: taken as drag",
                None if element is None else element.location,
            )
    notes.add(
        "converted",
        "UUV Simulator: added mass from x forward, y right, z down to x forward, y left, z up; "
        "damping negated into positive numbers",
        model.location,
    )
    _add_hydrodynamics(
        Hydrodynamics(
            body=name,
            element=model,
            added_mass=added,
            linear=None if linear is None else _as_drag(linear),
            quadratic=None if quadratic is None else _as_drag(quadratic),
            names=names,
        ),
        vehicle,
        notes,
    )


def _as_drag(matrix: np.ndarray) -> np.ndarray:
    """Return the damping [6, 6] of derivatives, positive on the diagonal."""
    result = -matrix
    np.fill_diagonal(result, np.abs(np.diag(matrix)))
    return result + 0.0


def _uuv_matrix(model: Element, tag: str, notes: Notes) -> np.ndarray | None:
    """Return a matrix [6, 6] in x forward, y left, z up; None where the file has none."""
    element = model.find(tag)
    if element is None:
        return None
    values = element.numbers()
    if len(values) not in (1, 6, 36):
        element.fail(f"holds {len(values)} numbers; write 6 or 36")
    matrix = (
        np.diag(values * (6 if len(values) == 1 else 1))
        if len(values) < 36
        else (np.reshape(values, (6, 6)))
    )
    turned: np.ndarray = TO_NED @ matrix @ TO_NED
    return turned


def _set_density(element: Element, vehicle: ForeignVehicle) -> None:
    value = element.number()
    if not 500 <= value <= 2000:
        element.fail(f"density {value:g}: water has about 1000 kg/m^3; correct it")
    vehicle.density_kgpm3, vehicle.density_location = value, element.location


def _find_body(plugin: Element, tag: str, vehicle: ForeignVehicle) -> str:
    element = plugin.find(tag)
    if element is None:
        plugin.fail(f"has no <{tag}>; add it")
    name = element.text.strip().rpartition("::")[2]
    if name not in vehicle.bodies:
        element.fail(f"{format_value(name)}: there is no such link; correct the name")
    return name


def _find_joint(element: Element, vehicle: ForeignVehicle) -> JointLink:
    name = element.text.strip().rpartition("::")[2]
    for joint in vehicle.joints:
        if joint.name == name:
            return joint
    element.fail(
        f"{format_value(name)}: there is no such joint, so the thruster pushes nothing; correct "
        "the name"
    )


def _optional_number(parent: Element, tag: str) -> float | None:
    element = parent.find(tag)
    return None if element is None else element.number()


def _is_same(first: np.ndarray | None, second: np.ndarray | None) -> bool:
    """Return whether two curves are equal, or there are none."""
    if first is None or second is None:
        return first is second
    return np.array_equal(first, second)


def _add_thruster(mount: ThrusterMount, vehicle: ForeignVehicle, notes: Notes) -> None:
    for other in vehicle.thrusters:
        if other.body == mount.body:
            if (other.spin, other.lag_s, other.max_thrust_n, other.min_thrust_n) != (
                mount.spin,
                mount.lag_s,
                mount.max_thrust_n,
                mount.min_thrust_n,
            ) or not _is_same(other.curve_n, mount.curve_n):
                mount.element.fail(
                    f"contradicts the thruster of {format_value(mount.body)} at "
                    f"{other.element.location}; remove one of them"
                )
            notes.add(
                "dropped",
                f"second plugin of thruster {mount.name}, equal to the first",
                mount.element.location,
            )
            return
    vehicle.thrusters.append(mount)


def _add_hydrodynamics(water: Hydrodynamics, vehicle: ForeignVehicle, notes: Notes) -> None:
    for other in vehicle.hydrodynamics:
        if other.body == water.body and other.linear is other.quadratic is None:
            # <fluid_added_mass>: the plugin has the damping.
            if water.added_mass is not None and np.any(water.added_mass):
                water.element.fail(
                    f"states added mass of {format_value(water.body)}, and so does "
                    f"{other.element.location}; remove one of them"
                )
            water.added_mass = None
        elif other.body == water.body:
            pairs = (
                (getattr(other, key), getattr(water, key))
                for key in ("added_mass", "linear", "quadratic")
            )
            if other.products != water.products or any(not np.array_equal(a, b) for a, b in pairs):
                water.element.fail(
                    f"contradicts the hydrodynamics of {format_value(water.body)} at "
                    f"{other.element.location}; remove one of them"
                )
            notes.add(
                "dropped",
                f"second hydrodynamics of {water.body}, equal to the first",
                water.element.location,
            )
            return
    vehicle.hydrodynamics.append(water)
