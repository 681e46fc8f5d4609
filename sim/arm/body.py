"""The links of the simulated arm as a PyBullet multibody with exactly the inertias of a Pinocchio model."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.file_array import temporary_folder
from sim.arm.world import STEP
from sim.bullet import pybullet

GRAVITY = 9.81
"""[m/s²], the value Pinocchio has too."""


def start_physics() -> int:
    """Connects a physics client without window, with the arm's step and gravity; returns its id."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setTimeStep(STEP, physicsClientId=client)
    pybullet.setGravity(0.0, 0.0, -GRAVITY, physicsClientId=client)
    return int(client)


def load_links(model: pin.Model, client: int, tool: pin.SE3 | None = None, tool_radius: float = 0.0) -> int:
    """Loads the links of a serial arm and switches off whatever PyBullet adds of its own.

    Joints keep their order; link ``i`` of the body is the one that joint ``i`` (from 0) moves, in the joint's frame.
    Joint limits are left to the controller: a limit constraint would be an effect of its own.

    Args:
        model: Pinocchio model with the true inertias.
        client: PyBullet's id of the physics client.
        tool: pose of the TCP in the frame of the last joint, if a ball about it shall collide with other bodies.
        tool_radius: its radius [m].

    Returns:
        PyBullet's id of the body.
    """
    with temporary_folder() as folder:
        path = folder / "links.urdf"
        path.write_text(links_urdf(model, tool, tool_radius), encoding="utf-8")
        body = pybullet.loadURDF(str(path), useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                                 physicsClientId=client)
    for link in range(-1, model.nv):
        pybullet.changeDynamics(body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0,
                                lateralFriction=0.0, maxJointVelocity=1.0e6, physicsClientId=client)
    pybullet.setJointMotorControlArray(body, list(range(model.nv)), pybullet.VELOCITY_CONTROL,
                                       forces=[0.0] * model.nv, physicsClientId=client)
    return int(body)


def links_urdf(model: pin.Model, tool: pin.SE3 | None = None, tool_radius: float = 0.0) -> str:
    """A URDF with the bare links of a serial Pinocchio model: one link per joint, inertias about principal axes.

    Principal axes spare PyBullet its own diagonalisation, which is less exact.

    Args:
        model: Pinocchio model of ``n`` joints.
        tool: pose of the TCP in the frame of the last joint, if a ball about it shall collide with other bodies.
        tool_radius: its radius [m].
    """
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    parts = ['<robot name="arm">', '<link name="link_0"><inertial><mass value="1"/>'
             '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>']
    for joint in range(1, model.njoints):
        column = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL).reshape(6, -1)[:, joint - 1]
        revolute = np.linalg.norm(column[3:]) > 0.5
        axis = column[3:] if revolute else column[:3]
        inertia, placement = model.inertias[joint], model.jointPlacements[joint]
        moments, directions = np.linalg.eigh(np.array(inertia.inertia))
        directions[:, 2] *= np.linalg.det(directions)
        parts.append(
            f'<link name="link_{joint}"><inertial>'
            f'<origin xyz="{_text(inertia.lever)}" rpy="{_text(_rpy(directions))}"/><mass value="{inertia.mass:.17g}"/>'
            f'<inertia ixx="{moments[0]:.17g}" ixy="0" ixz="0" iyy="{moments[1]:.17g}" iyz="0" '
            f'izz="{moments[2]:.17g}"/></inertial>')
        if tool is not None and joint == model.njoints - 1:
            parts.append(f'<collision><origin xyz="{_text(tool.translation)}"/><geometry>'
                         f'<sphere radius="{tool_radius:.17g}"/></geometry></collision>')
        parts.append("</link>")
        kind = ('type="continuous"', "") if revolute else (
            'type="prismatic"', '<limit lower="-1e6" upper="1e6" effort="0" velocity="0"/>')
        parts.append(
            f'<joint name="joint_{joint}" {kind[0]}><parent link="link_{model.parents[joint]}"/>'
            f'<child link="link_{joint}"/><origin xyz="{_text(placement.translation)}" '
            f'rpy="{_text(_rpy(placement.rotation))}"/><axis xyz="{_text(axis)}"/>{kind[1]}</joint>')
    return "\n".join([*parts, "</robot>"])


def _rpy(rotation: Array) -> Array:
    return np.asarray(pin.rpy.matrixToRpy(np.ascontiguousarray(rotation)))


def _text(values: Array) -> str:
    return " ".join(f"{value:.17g}" for value in values)
