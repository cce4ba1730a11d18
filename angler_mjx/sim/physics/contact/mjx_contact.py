"""MuJoCo MJX behind one module: pairs of shapes that meet, and the solver of contact.

MJX's model holds the shapes alone, on bodies without mass: their poses and sizes, the inertia with
added mass, the Jacobian, and the reference accelerations come from the simulator. Its kinematics,
passive forces and integrators are not used.
"""

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from angler_mjx.sim.physics.contact.layout import BodyLayout
from angler_mjx.sim.physics.mjx_engine import import_mjx

if TYPE_CHECKING:
    from mujoco import mjx

ITERATIONS = 20
LINE_SEARCH_ITERATIONS = 12


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Touches:
    """Candidates [k] for contact: nearest points of two shapes, or of a shape and rock."""

    depth_m: jax.Array
    """[k] overlap, m; negative where there is none."""
    position: jax.Array
    """[k, 3] point of contact, m, in W."""
    normal: jax.Array
    """[k, 3] unit vector from the first to the second."""
    first: jax.Array
    """int32 [k] shape; ``layout.shapes`` for rock and ``layout.shapes + 1`` for the floor."""
    second: jax.Array
    """int32 [k] shape."""


@dataclass(frozen=True, kw_only=True)
class Shapes:
    """Where the shapes [G] of a world are."""

    position: jax.Array
    """[G, 3] centre, m, in W."""
    rotation: jax.Array
    """[G, 3, 3] axes, to W; that of a capsule is its third."""
    size: jax.Array
    """[G, 3] radius and half length of a capsule, half extents of a box, m."""


@cache
def _build_model(layout: BodyLayout) -> mujoco.MjModel:
    """Return the model of the shapes of a world, with a pair for all that can touch.

    Joints of robots are sliders, so that MuJoCo counts the velocities of the layout.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "contact"
    option = spec.option
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.iterations, option.ls_iterations = ITERATIONS, LINE_SEARCH_ITERATIONS
    option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)
    spec.add_numeric(name="max_geom_pairs", data=[layout.pairs])
    owners, boxes = layout.shape_bodies(), layout.is_box()
    for body in range(layout.bodies):
        element = _add_unit_body(spec.worldbody)
        element.add_freejoint()
        for shape in np.flatnonzero(owners == body):
            kind = mujoco.mjtGeom.mjGEOM_BOX if boxes[shape] else mujoco.mjtGeom.mjGEOM_CAPSULE
            element.add_geom(
                name=f"shape_{shape}", type=kind, size=[0.1] * 3, contype=0, conaffinity=0
            )
        for _ in range(layout.joints if body < layout.robots else 0):
            element = _add_unit_body(element)
            element.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1.0, 0.0, 0.0])
    for i in range(layout.shapes):
        for j in range(i + 1, layout.shapes):
            if layout.meets(i, j):
                spec.add_pair(geomname1=f"shape_{i}", geomname2=f"shape_{j}", condim=3)
    model = spec.compile()
    # MJX looks at bounds of friction only in models that have any.
    model.dof_frictionloss[:] = float(layout.slips)
    return model


def _add_unit_body(parent: mujoco.MjsBody) -> mujoco.MjsBody:
    """Add a body whose mass is of no account."""
    body = parent.add_body(mass=1.0, inertia=[1.0, 1.0, 1.0])
    body.explicitinertial = True
    return body


def _shape_rows(model: mujoco.MjModel, layout: BodyLayout) -> np.ndarray:
    """Return int [G]: the shape of each of MuJoCo's geoms, which are in the order of bodies."""
    return np.array([int(model.geom(i).name.split("_")[1]) for i in range(layout.shapes)])


def find_touches(layout: BodyLayout, shapes: Shapes) -> Touches | None:
    """Return what of the bodies meets, as MJX finds it; None where nothing can.

    Args:
        layout: of the world.
        shapes: where they are; those that do not exist far apart from all others.
    """
    mjx, host = import_mjx(), _build_model(layout)
    if host.npair == 0:
        return None
    rows = _shape_rows(host, layout)
    with jax.ensure_compile_time_eval():
        model, data = _put_on_device(host)
    size = shapes.size[rows]
    radius = jnp.where(
        jnp.asarray(layout.is_box())[rows],
        jnp.sqrt(jnp.sum(size * size, axis=1)),
        size[:, 0] + size[:, 1],
    )
    model = model.tree_replace({"geom_size": size, "geom_rbound": radius})
    data = data.replace(geom_xpos=shapes.position[rows], geom_xmat=shapes.rotation[rows])
    found = mjx.collision(model, data)._impl.contact
    numbers = jnp.asarray(rows, jnp.int32)
    return Touches(
        depth_m=-found.dist,
        position=found.pos,
        normal=found.frame[:, 0],
        first=numbers[found.geom[:, 0]],
        second=numbers[found.geom[:, 1]],
    )


def _put_on_device(host: mujoco.MjModel) -> "tuple[mjx.Model, mjx.Data]":
    mjx, device = import_mjx(), jax.local_devices()[0]
    return mjx.put_model(host, device=device), mjx.make_data(host, device=device)


@dataclass(frozen=True, kw_only=True)
class ContactProblem:
    """Problem of the solver: [n] velocities, and [m] rows, most of which push and do not pull."""

    M: jax.Array
    """[n, n] inertia."""
    acceleration: jax.Array
    """[n] without contact."""
    J: jax.Array
    """[m, n]."""
    reference: jax.Array
    """[m] accelerations that the rows ask for."""
    D: jax.Array
    """[m] weights of the rows; 1 over the regularisation."""
    equalities: int = 0
    """Number of the first rows, which push and pull."""
    friction_limits: jax.Array | None = None
    """[k] greatest forces of the rows that come first instead, of dry friction, N or N m."""


def solve_contact(layout: BodyLayout, problem: ContactProblem) -> tuple[jax.Array, jax.Array]:
    """Return the accelerations [n] with contact, and the forces [m], by MuJoCo's solver.

    They minimise 1/2 |a - acceleration|^2 in the metric of M and 1/2 D min(J a - reference, 0)^2,
    of equalities without the minimum, of dry friction with forces up to their limits.

    Args:
        layout: of the world.
        problem: of the world.
    """
    mjx = import_mjx()
    m, n = problem.J.shape
    with jax.ensure_compile_time_eval():
        model, data = _put_on_device(_build_model(layout))
    dtype, none = problem.M.dtype, jnp.zeros(m, problem.M.dtype)
    limits, bounded = none, 0
    if problem.friction_limits is not None:
        bounded = problem.friction_limits.shape[0]
        limits = limits.at[:bounded].set(problem.friction_limits)
    inner = data._impl.replace(
        ne=problem.equalities,
        nf=bounded,
        nl=0,
        nefc=m,
        M=problem.M,
        efc_J=problem.J,
        efc_D=problem.D,
        efc_aref=problem.reference,
        efc_frictionloss=limits,
        efc_pos=none,
        efc_margin=none,
        efc_force=none,
    )
    data = data.replace(
        _impl=inner,
        qvel=jnp.zeros(n, dtype),
        qacc=problem.acceleration,
        qacc_smooth=problem.acceleration,
        qacc_warmstart=problem.acceleration,
        qfrc_smooth=problem.M @ problem.acceleration,
        qfrc_constraint=jnp.zeros(n, dtype),
    )
    solved = mjx.solve(model, data)
    return solved.qacc, solved._impl.efc_force
