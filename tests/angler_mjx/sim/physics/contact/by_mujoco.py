"""Steps with contact by MuJoCo C, its constraints replaced by numpy.

MuJoCo C finds contacts and solves; inertia with added mass, Jacobian, weights and reference
accelerations are written here. Solutions of the same problem by non-negative least squares too.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import nnls

SCENE = """
<mujoco>
  <option jacobian="dense" cone="pyramidal" solver="Newton" tolerance="1e-15" iterations="200"
          ls_iterations="200" gravity="0 0 -9.81">
    <flag warmstart="disable" island="disable"/>
  </option>
  <worldbody>
    <geom type="plane" size="9 9 1"/>
    <body><freejoint/>
      <inertial pos="1e-3 2e-3 1e-3" mass="2" diaginertia=".02 .021 .022" quat=".9 .1 .2 .3"/>
      <geom type="sphere" size=".1"/></body>
    <body><freejoint/>
      <inertial pos="1e-3 2e-3 1e-3" mass="3" diaginertia=".03 .031 .012" quat=".9 .1 .2 .3"/>
      <geom type="capsule" size=".08 .2"/></body>
    <body><freejoint/>
      <inertial pos="1e-3 2e-3 1e-3" mass="4" diaginertia=".03 .031 .04" quat=".9 .1 .2 .3"/>
      <geom type="box" size=".15 .2 .1"/></body>
  </worldbody>
</mujoco>
"""
ADDED = np.array([[1.0, 1.0, 1.0, 0.0, 0.0, 0.0]] + [[3.0, 2.0, 0.4, 0.02, 0.01, 0.0]] * 2)
"""Diagonals of the added mass, in the bodies' frames."""
SOFTNESS = 5e-4


MAX_REBOUND = 3.0
"""Speed, m/s, at which springs throw apart what overlaps, at the most."""


@dataclass(frozen=True)
class Settings:
    """Coefficients of all contacts."""

    friction: float = 0.4
    zeta: float = 0.6
    rate: float = 50.0
    dt: float = 0.005


@dataclass
class Problem:
    """Problem of one step, in numpy."""

    M: np.ndarray
    a0: np.ndarray
    J: np.ndarray
    """[4 k, n] rows of pyramids, contact by contact."""
    D: np.ndarray
    reference: np.ndarray


class Reference:
    """A scene of MuJoCo C."""

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(SCENE)
        self.data = mujoco.MjData(self.model)

    def place(self, qpos, qvel):
        """Find contacts and bias forces at a state."""
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        mujoco.mj_fwdPosition(self.model, self.data)
        mujoco.mj_fwdVelocity(self.model, self.data)

    def inertia(self):
        """Return M [n, n] with added mass."""
        n = self.model.nv
        M = np.zeros((n, n))
        mujoco.mj_fullM(self.model, self.data, M)
        for body, diagonal in enumerate(ADDED):
            T = np.eye(6)
            T[:3, :3] = self.data.xmat[body + 1].reshape(3, 3).T
            rows = slice(6 * body, 6 * body + 6)
            M[rows, rows] += T.T @ np.diag(diagonal) @ T
        return M

    def problem(self, settings, push):
        """Return the problem of a step under generalised forces ``push`` [n] and gravity."""
        model, data, dt, mu = self.model, self.data, settings.dt, settings.friction
        M, v = self.inertia(), data.qvel.copy()
        a0 = np.linalg.solve(M, push - data.qfrc_bias)
        rows, weights, wanted = [], [], []
        for contact in data.contact:
            first, second = (model.geom_bodyid[g] for g in contact.geom)
            jacobians = []
            for body in (first, second):
                jacobians.append(np.zeros((3, model.nv)))
                mujoco.mj_jac(model, data, jacobians[-1], None, contact.pos, body)
            J = jacobians[1] - jacobians[0]
            normal = contact.frame[:3]
            slip = J @ (v + dt * a0)
            slip -= normal * (normal @ slip)
            along = slip / np.linalg.norm(slip)
            across = np.cross(normal, along)
            mass = 1.0 / (normal @ J @ np.linalg.solve(M, J.T @ normal))
            asked = settings.rate * min(-settings.rate * contact.dist, MAX_REBOUND)
            bounce = np.hypot(normal @ J @ v, settings.rate * contact.dist)
            rests = bounce < 2 * dt * max(0.0, -normal @ J @ a0)
            zeta = max(settings.zeta, 1.0) if rests else settings.zeta
            asked -= 2 * zeta * settings.rate * (normal @ J @ v)
            asked = min(asked, (MAX_REBOUND - normal @ J @ v) / settings.dt)
            for tangent in (along, -along, across, -across):
                rows.append((normal + mu * tangent) @ J)
                wanted.append(asked - mu * (tangent @ J @ v) / (2 * dt))
                weights.append(mass / (4 * SOFTNESS))
        shape = (-1, model.nv)
        return Problem(M, a0, np.reshape(rows, shape), np.array(weights), np.array(wanted))

    def solve(self, problem):
        """Return accelerations [n] and forces [4 k] by MuJoCo C's solver."""
        model, data = self.model, self.data
        assert data.nefc == len(problem.D)
        assert [c.efc_address for c in data.contact] == list(range(0, data.nefc, 4))
        lower = np.repeat(np.arange(model.nv), model.M_rownnz)
        for row in range(model.nv):  # every row holds all earlier columns of its body
            assert model.M_rownnz[row] == row % 6 + 1
        data.M[:] = problem.M[lower, model.M_colind]
        if data.nefc:
            data.efc_J[:] = problem.J.ravel()
            data.efc_D[:], data.efc_R[:] = problem.D, 1 / problem.D
            data.efc_aref[:] = problem.reference
        data.qacc_smooth[:] = problem.a0
        data.qfrc_smooth[:] = problem.M @ problem.a0
        data.qacc_warmstart[:] = problem.a0
        mujoco.mj_fwdConstraint(model, data)
        return data.qacc.copy(), data.efc_force.copy()

    def advance(self, qpos, velocity, dt):
        """Return positions after dt at a velocity."""
        later = qpos.copy()
        for body in range(len(ADDED)):
            at, v = 7 * body, velocity[6 * body : 6 * body + 6]
            later[at : at + 3] += dt * v[:3]
            angle = np.linalg.norm(v[3:]) * dt
            axis = v[3:] * dt / angle if angle > 0.0 else np.zeros(3)
            turn = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])
            w, x, y, z = later[at + 3 : at + 7]
            left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
            turned = left @ turn
            later[at + 3 : at + 7] = turned / np.linalg.norm(turned)
        return later


def solve_dual(problem):
    """Return accelerations and forces by non-negative least squares of the dual problem."""
    if not len(problem.D):
        return problem.a0, problem.D
    by_force = np.linalg.solve(problem.M, problem.J.T)
    A = problem.J @ by_force + np.diag(1 / problem.D)
    U = np.linalg.cholesky(A).T
    missing = np.linalg.solve(U.T, problem.reference - problem.J @ problem.a0)
    force, _ = nnls(U, missing, maxiter=10_000)
    return problem.a0 + by_force @ force, force
