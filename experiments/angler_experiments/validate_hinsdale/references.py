"""Predictions that need no simulation: a constant, a straight line, and balance of weights."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.validate_hinsdale.tracks import STEP_S, Track
from angler_experiments.validate_hinsdale.vehicle import CampaignVehicle, lift_moment

type Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """Predicted motion of one run; NaN where nothing is predicted."""

    angles_rad: Array
    """[n, 3] roll, pitch, yaw."""
    p_m: Array
    """[n, 3]."""


def predict_constant(track: Track) -> Prediction:
    """Return each coordinate's mean over the judged part: it has seen the run."""
    ones = np.ones((len(track.t_s), 1))
    return Prediction(
        angles_rad=ones * np.nanmean(track.angles_rad, axis=0),
        p_m=ones * np.nanmean(track.p_m, axis=0),
    )


def predict_persistence(track: Track) -> Prediction:
    """Return initial attitude held, and initial velocity held: what the first second gives."""
    t = STEP_S * np.arange(len(track.t_s))[:, None]
    return Prediction(
        angles_rad=np.ones_like(t) * track.initial_angles_rad,
        p_m=track.initial_p_m + t * track.initial_v_mps,
    )


def predict_balance(
    vehicle: CampaignVehicle, track: Track, *, keeps_initial: bool = False
) -> Prediction:
    """Return the attitude at which weight and buoyancy balance for the recorded joints.

    The first moment of all lift points up then. Yaw and position are not predicted.

    Args:
        vehicle: parameters.
        track: run.
        keeps_initial: shift roll and pitch to the attitude of the first second.
    """
    moment = np.asarray(_lift_moments(vehicle, jnp.asarray(track.joint_rad[::2])))
    up = moment / np.linalg.norm(moment, axis=1, keepdims=True)
    up = _turn_to_markers(up, float(vehicle.marker_yaw_rad))
    angles = np.full((len(up), 3), np.nan)
    angles[:, 0] = np.arctan2(up[:, 1], up[:, 2])
    angles[:, 1] = -np.arcsin(up[:, 0])
    if keeps_initial:
        angles += track.initial_angles_rad - angles[0]
    return Prediction(angles_rad=angles, p_m=np.full((len(up), 3), np.nan))


@jax.jit
def _lift_moments(vehicle: CampaignVehicle, joints: jax.Array) -> jax.Array:
    """Return first moments [n, 3] of all lift for joint positions [n, 4]."""
    return jax.vmap(lambda position: lift_moment(vehicle, position)[1])(joints)


def _turn_to_markers(vectors: Array, yaw: float) -> Array:
    """Return vectors [n, 3] of the vehicle's frame in that of the marker body."""
    c, s = np.cos(yaw), np.sin(yaw)
    turned: Array = vectors @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return turned
