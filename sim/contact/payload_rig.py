"""The alternative to a clamp: known masses hung on the flange; the motors stand and a tracker watches the flange."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from sim.contact.clamp_world import ClampWorld

GRAVITY = 9.81


def hang_payloads(robot: Robot, world: ClampWorld, postures: Array, masses: Array, lever: Array,
                  rng: np.random.Generator, *, samples: int = 50,
                  tracker: tuple[float, float] = (2e-5, 3e-5)) -> Recording:
    """Records motor angles and flange pose under known masses.

    Args:
        robot: kinematics and masses.
        world: truth; gears and links give way, the clamp has no part.
        postures: motor angles that are held ``(p, n)`` [rad].
        masses: hung one after the other in each posture ``(m,)`` [kg].
        lever: where the masses' centre hangs in the tool frame ``(3,)`` [m].
        rng: for the tracker's noise.
        samples: recorded per mass.
        tracker: standard deviation of the measured position [m] and rotation [rad].

    Returns:
        ``t``, ``q_i``, ``payload`` [kg], ``x y z qx qy qz qw``.
    """
    rows_q, rows_pose, rows_mass = [], [], []
    for q_m in postures:
        for mass in masses:
            pose = loaded_pose(robot, world, q_m, float(mass), lever)
            for _ in range(samples):
                error = pin.exp3(tracker[1] * rng.standard_normal(3))
                seen = pin.SE3(error @ pose.rotation, pose.translation + tracker[0] * rng.standard_normal(3))
                rows_q.append(q_m)
                rows_pose.append(pin.SE3ToXYZQUAT(seen))
                rows_mass.append(mass)
    poses = np.array(rows_pose)
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    meta = {"robot": robot.name, "kind": "payload", "payload_lever": [float(x) for x in lever], "source": "simulated"}
    return Recording.from_arrays(
        np.arange(float(len(rows_q))) * 0.1, source="simulated", meta=meta, q=np.array(rows_q),
        payload=np.array(rows_mass), **{name: poses[:, i] for i, name in enumerate(names)})


def loaded_pose(robot: Robot, world: ClampWorld, q_m: Array, mass: float, lever: Array) -> pin.SE3:
    """Flange pose at rest with a mass hung on it: gears by fixed-point iteration, links to first order.

    Args:
        robot: data sheet of the arm.
        world: true stiffness of gears and links.
        q_m: motor angles ``(n,)`` [rad].
        mass: hung on the flange [kg].
        lever: its centre of mass in the flange frame ``(3,)`` [m].
    """
    data = robot.pinocchio.createData()
    q = np.array(q_m, dtype=float)
    for _ in range(50):
        pin.framesForwardKinematics(robot.pinocchio, data, q)
        flange = data.oMf[robot.tool_id].copy()
        force = flange.rotation.T @ np.array([0.0, 0.0, -mass * GRAVITY])
        wrench = np.concatenate([force, np.cross(lever, force)])
        jacobian = pin.computeFrameJacobian(robot.pinocchio, data, q, robot.tool_id, pin.LOCAL)
        load = pin.computeGeneralizedGravity(robot.pinocchio, data, q) - jacobian.T @ wrench
        change = q_m - load / world.stiffness - q
        q = q + change
        if np.max(np.abs(change)) < 1e-13:
            break
    bending = np.zeros(6)
    for joint in range(robot.n):
        across = (flange.inverse() * data.oMi[joint + 1]).action[:, 3:5]
        bending += across @ (across.T @ wrench) / world.link_stiffness[joint]
    return flange * pin.exp6(pin.Motion(bending))
