"""The links of the simulated arm as a PyBullet multibody with exactly the inertias of a Pinocchio model."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from types import TracebackType
from typing import Any, NamedTuple

import cv2
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array, G
from ideal_robot.errors import InputError
from ideal_robot.robots.collisions import THICK
from ideal_robot.robots.joints import joint_motions, mass_matrix, without_followers
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.size import reach
from ideal_robot.robots.urdf import without_meshes
from ideal_robot.row_log import temporary_folder
from sim.arm.world import STEP
from sim.bullet import output_dropped, pybullet


def start_physics() -> int:
    """Connects a physics client without window, with the arm's step and gravity; returns its id."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setTimeStep(STEP, physicsClientId=client)
    pybullet.setGravity(0.0, 0.0, -G, physicsClientId=client)
    return int(client)


def load_links(model: pin.Model, client: int, tool: pin.SE3 | None = None, tool_radius: float = 0.0) -> int:
    """Loads the links of a serial arm without PyBullet's default damping and limits; returns the body's id.

    Joints keep their order, those coupled to others move freely (``JointTorques`` leads them); link ``i`` of the body
    is the one that joint ``i`` (from 0) moves, in the joint's frame. Joint limits are checked by the controller: a
    constraint in PyBullet would be a further effect.

    Args:
        model: Pinocchio model with the true inertias.
        client: PyBullet's id of the physics client.
        tool: pose of the TCP in the frame of the last joint, if a ball about it shall collide with other bodies.
        tool_radius: its radius [m].
    """
    with temporary_folder() as folder:
        path = folder / "links.urdf"
        path.write_text(_links_urdf(model, tool, tool_radius), encoding="utf-8")
        body = pybullet.loadURDF(str(path), useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
                                 physicsClientId=client)
    joints = list(range(model.njoints - 1))
    for link in (-1, *joints):
        pybullet.changeDynamics(body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0,
                                lateralFriction=0.0, maxJointVelocity=1.0e6, physicsClientId=client)
    pybullet.setJointMotorControlArray(body, joints, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(joints),
                                       physicsClientId=client)
    return int(body)


def _links_urdf(model: pin.Model, tool: pin.SE3 | None = None, tool_radius: float = 0.0) -> str:
    """A URDF with the bare links of a serial Pinocchio model; tool ball as for ``load_links``.

    One link per joint, inertias about principal axes: PyBullet's own diagonalisation is less exact.
    """
    motions = joint_motions(model)
    parts = ['<robot name="arm">', '<link name="link_0"><inertial><mass value="1"/>'
             '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>']
    for joint in range(1, model.njoints):
        axis, revolute = motions.axis[joint - 1], not motions.prismatic[joint - 1]
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


# Rotors that turn rigidly with their links, and joints that follow others: PyBullet has no term for either.

class JointTorques:
    """Torques of PyBullet's joints that move links and rotors as drives with rigid gears and couplings would.

    The reflected rotor inertia J belongs on the diagonal of the mass matrix and nowhere else: added to the inertia of a
    link it would also load the joints before it. And a coupled joint follows its leader, whatever its mass. So the
    links get the torques that their motion requires, with

        (M + J) q̈ = τ + Gᵀ τ_touch - h(q, q̇)        τ' = rnea'(G q + b, G q̇, G q̈) - τ_touch

    from Pinocchio's model of the same links; without coupled joints (G = 1) that is τ - J q̈. Contacts are not known
    before the step; τ_touch is the excess torque of the step before. Free motion is exact, contacts act on the rotors
    half a millisecond late.

    Args:
        links: the true links.
        inertia: rotor inertia of the joints with rigid gears, 0 elsewhere ``(n,)`` [kg m²].

    Attributes:
        followers: joints, from 0, that follow others.
    """

    def __init__(self, links: pin.Model, inertia: Array) -> None:
        self._motions = joint_motions(links)
        self.followers = np.flatnonzero(~self._motions.own).tolist()
        self._free = without_followers(links) if self.followers else links
        self._free_data = self._free.createData()
        self._with_rotors = links.copy()
        self._with_rotors.armature = inertia
        self._data = self._with_rotors.createData()
        self._inertia = inertia
        self._touch = np.zeros(links.njoints - 1)

    @staticmethod
    def of(links: pin.Model, inertia: Array) -> JointTorques | None:
        """Makes an arm's ``JointTorques``; None where PyBullet's joints get the drive torques unchanged.

        Args:
            links, inertia: see the class.
        """
        return JointTorques(links, inertia) if inertia.any() or links.nv < links.njoints - 1 else None

    def angles(self, q: Array) -> Array:
        """Angles of PyBullet's joints ``(b,)`` at the arm's ``(n,)`` [rad]."""
        return self._motions.angles(q)

    def rates(self, qd: Array) -> Array:
        """Velocities of PyBullet's joints ``(b,)`` at the arm's ``(n,)`` [rad/s]."""
        return self._motions.rates(qd)

    def of_drives(self, q: Array, qd: Array, torque: Array) -> Array:
        """Torques of PyBullet's joints ``(b,)`` [N m] for the drives' torques at ``q, qd``.

        Args:
            q: arm angles ``(n,)`` [rad].
            qd: arm velocities ``(n,)`` [rad/s].
            torque: of the drives ``(n,)`` [N m].
        """
        if not self.followers:
            return np.asarray(torque - self._inertia * pin.aba(self._with_rotors, self._data, q, qd,
                                                               torque + self._touch))
        mass = mass_matrix(self._with_rotors, self._data, q)
        asked = torque + self._motions.torques(self._touch) - pin.nonLinearEffects(self._with_rotors, self._data, q, qd)
        return self._asked(q, self.rates(qd), self.rates(np.linalg.solve(mass, asked))) - self._touch

    def feel(self, q: Array, qd: Array, after: Array, torque: Array) -> None:
        """Estimates the contact torques of a step that led from ``q, qd`` to joint velocities ``after (b,)``.

        Args:
            q: arm angles before the step ``(n,)`` [rad].
            qd: arm velocities before it ``(n,)`` [rad/s].
            after: velocities of PyBullet's joints after it ``(b,)`` [rad/s].
            torque: on the links during it ``(b,)`` [N m].
        """
        rates = self.rates(qd)
        self._touch = self._asked(q, rates, (after - rates) / STEP) - torque

    def _asked(self, q: Array, rates: Array, accelerations: Array) -> Array:
        return np.asarray(pin.rnea(self._free, self._free_data, self.angles(q), rates, accelerations))


# Pictures of the arm in a posture, for reports.

Picture = NDArray[np.uint8]


_SIDES = 8
"""Of a drawn rod; it is a few pixels wide."""


class View(NamedTuple):
    """Camera position and size of a picture of an arm.

    Attributes:
        width, height: of the picture [px].
        azimuth: direction of view about the vertical [°].
        elevation: direction of view above the horizon, negative from above [°].
        distance: of the camera from ``target`` [m]; fitted to the arm if None.
        target: point in the middle of the picture [m]; fitted to the arm if None.
    """

    width: int = 800
    height: int = 600
    azimuth: float = 50.0
    elevation: float = -18.0
    distance: float | None = None
    target: Sequence[float] | None = None


class Stage:
    """An arm on a floor, shown in many postures from one place; raises ``InputError`` for ``q`` of wrong size.

    Args:
        robot: any robot whose URDF holds primitive shapes; an arm without any is drawn as rods from joint to joint.
        q: arm angles ``(n,)`` [rad] that the view is fitted to.
        view: from where it is shown.
        lines: polylines ``(N, 3)`` [m] in the base frame to be drawn as thin rods, e.g. a path.
        surface: corners ``(4, 3)`` [m] of a flat surface to be drawn as a plate, or None.
    """

    def __init__(self, robot: Robot, q: Array, view: View | None = None, *, lines: Sequence[Array] = (),
                 surface: Array | None = None) -> None:
        q = np.asarray(q, dtype=float)
        if q.shape != (robot.n,):
            raise InputError(f"expected {robot.n} joint angles", field="q", value=q.tolist())
        self._names, self._motions = list(robot.pinocchio.names)[1:], joint_motions(robot.pinocchio)
        client = self._client = pybullet.connect(pybullet.DIRECT)
        with output_dropped():  # frames without inertia, which Bullet warns of, are no concern of a picture
            self._body = _load(robot, client)
        self._order = {pybullet.getJointInfo(self._body, i, physicsClientId=client)[1].decode(): i
                       for i in range(pybullet.getNumJoints(self._body, physicsClientId=client))}
        self._place(q)
        for line in lines:
            _draw(np.asarray(line, dtype=float), client)
        if surface is not None:
            _lay(np.asarray(surface, dtype=float), client)
        low, high = _extent(self._body, len(self._order), client)
        # The floor is as large as the shadow map: on an endless plane the map's border would show as a false shadow.
        # The renderer processes every triangle, also of hidden sides.
        size = float(np.linalg.norm(high - low))
        x, y = 0.15 * size + 0.65 * size * np.array([-1, 1, 1, -1]), 0.65 * size * np.array([-1, -1, 1, 1])
        floor = pybullet.createVisualShape(
            pybullet.GEOM_MESH, vertices=np.column_stack([x, y, np.zeros(4)]).tolist(), indices=[0, 1, 2, 0, 2, 3],
            normals=[[0.0, 0.0, 1.0]] * 4, rgbaColor=[0.86, 0.88, 0.90, 1.0], physicsClientId=client)
        pybullet.createMultiBody(0.0, -1, floor, physicsClientId=client)
        view = view or View()
        self._view = view._replace(
            target=[float(x) for x in (0.5 * (low + high) if view.target is None else view.target)],
            distance=1.25 * size if view.distance is None else view.distance)
        self._light = 2.5 * size

    def __enter__(self) -> Stage:
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, tb: TracebackType | None) -> None:
        pybullet.disconnect(self._client)

    def show(self, q: Array) -> Picture:
        """The arm at ``q (n,)`` [rad] as RGB picture ``(height, width, 3)``, rendered by PyBullet's CPU renderer."""
        self._place(q)
        return _render(self._client, self._view, self._light)

    def _place(self, q: Array) -> None:
        for name, angle in zip(self._names, self._motions.angles(q), strict=True):
            pybullet.resetJointState(self._body, self._order[name], angle, physicsClientId=self._client)


def picture(robot: Robot, q: Array, view: View | None = None, **drawn: Any) -> Picture:
    """One RGB picture ``(height, width, 3)`` of an arm in a posture.

    Raises ``InputError`` for ``q`` of wrong size.

    Args:
        robot: the arm.
        q: arm angles ``(n,)`` [rad].
        view: from where it is shown.
        drawn: lines and surface as for ``Stage``.
    """
    with Stage(robot, q, view, **drawn) as stage:
        return stage.show(np.asarray(q, dtype=float))


def _load(robot: Robot, client: int) -> int:
    """The arm with its primitive shapes: Bullet would open whatever file a mesh names."""
    with temporary_folder() as folder:
        path = folder / "arm.urdf"
        path.write_text(_with_rods(without_meshes(robot.description), THICK * reach(robot)), encoding="utf-8")
        return int(pybullet.loadURDF(str(path), useFixedBase=True, physicsClientId=client))


def _with_rods(text: str, radius: float) -> str:
    """The same URDF, its links drawn as rods of ``radius`` [m] to the next joint if it has no shape to be seen."""
    root = ET.fromstring(text)
    if root.find("./link/visual") is not None:
        return text
    links = {link.get("name"): link for link in root.findall("link")}
    for joint in root.findall("joint"):
        origin, parent = joint.find("origin"), joint.find("parent")
        offset = np.array([float(v) for v in ("0 0 0" if origin is None else origin.get("xyz", "0 0 0")).split()])
        length = float(np.linalg.norm(offset))
        if length < 1e-6 or parent is None:
            continue
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), offset / length).matrix()
        visual = ET.SubElement(links[parent.get("link")], "visual")
        ET.SubElement(visual, "origin", {"xyz": _text(0.5 * offset), "rpy": _text(_rpy(turn))})
        ET.SubElement(ET.SubElement(visual, "geometry"), "cylinder", {"length": f"{length}", "radius": f"{radius}"})
        ET.SubElement(ET.SubElement(visual, "material", {"name": "rod"}), "color", {"rgba": "0.88 0.42 0 1"})
    return ET.tostring(root, encoding="unicode")


def _render(client: int, view: View, light: float) -> Picture:
    """Renders half as large again and averages, which smooths the edges that TinyRenderer leaves jagged."""
    width, height, azimuth, elevation, distance, target = view
    columns, rows = 3 * width // 2, 3 * height // 2
    eye = pybullet.computeViewMatrixFromYawPitchRoll(target, distance, azimuth, elevation, 0.0, 2,
                                                     physicsClientId=client)
    far = 10.0 * (distance or 0.0)
    lens = pybullet.computeProjectionMatrixFOV(40.0, width / height, 0.05, far, physicsClientId=client)
    image = pybullet.getCameraImage(columns, rows, eye, lens, lightDirection=[1.2, -1.6, 3.0],
                                    lightDistance=light, lightAmbientCoeff=0.55, lightDiffuseCoeff=0.5,
                                    lightSpecularCoeff=0.15, shadow=1,
                                    renderer=pybullet.ER_TINY_RENDERER, physicsClientId=client)[2]
    rgb = np.asarray(image, dtype=np.uint8).reshape(rows, columns, 4)[:, :, :3]
    return np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _extent(body: int, joints: int, client: int) -> tuple[Array, Array]:
    points = [pybullet.getBasePositionAndOrientation(body, physicsClientId=client)[0]]
    points += [pybullet.getLinkState(body, i, physicsClientId=client)[4] for i in range(joints)]
    array = np.array(points)
    # The joints' positions, and the housings and motors around them.
    return array.min(axis=0) - 0.25, array.max(axis=0) + 0.35


def _draw(line: Array, client: int) -> None:
    """A rod of radius 4 mm along a polyline ``(N, 3)`` [m]: one mesh, since Bullet takes over a millisecond a body."""
    start, rod = line[:-1], np.diff(line, axis=0)
    length = np.linalg.norm(rod, axis=1, keepdims=True)
    start, rod, length = (rows[length[:, 0] > 1.0e-9] for rows in (start, rod, length))
    if not len(rod):
        return
    # Any direction across the rod: starts from the coordinate axis that is most perpendicular to it.
    across = np.cross(rod, np.eye(3)[np.argmin(np.abs(rod), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    over = np.cross(rod / length, across)
    angles = 2.0 * np.pi * np.arange(_SIDES) / _SIDES
    normals = np.cos(angles)[:, None] * across[:, None] + np.sin(angles)[:, None] * over[:, None]
    ends = np.stack([start, start + rod], axis=1)
    vertices = ends[:, :, None] + 0.004 * normals[:, None]
    side = np.arange(_SIDES)
    after = (side + 1) % _SIDES
    faces = np.column_stack([side, after, side + _SIDES, after, after + _SIDES, side + _SIDES])
    indices = faces.ravel() + 2 * _SIDES * np.arange(len(rod))[:, None]
    shape = pybullet.createVisualShape(
        pybullet.GEOM_MESH, vertices=vertices.reshape(-1, 3).tolist(), indices=indices.ravel().tolist(),
        normals=np.repeat(normals[:, None], 2, axis=1).reshape(-1, 3).tolist(), rgbaColor=[0.1, 0.1, 0.6, 1.0],
        physicsClientId=client)
    pybullet.createMultiBody(0.0, -1, shape, physicsClientId=client)


def _lay(corners: Array, client: int) -> None:
    """A plate, 10 mm thick, whose upper side is the parallelogram of the corners, given in order."""
    along, across = corners[1] - corners[0], corners[3] - corners[0]
    length, width = float(np.linalg.norm(along)), float(np.linalg.norm(across))
    normal = np.cross(along, across)
    normal *= np.sign(normal[2]) / np.linalg.norm(normal) if normal[2] else 1.0 / np.linalg.norm(normal)
    x = along / length
    rotation = np.column_stack([x, np.cross(normal, x), normal])
    shape = pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=[0.5 * length, 0.5 * width, 0.005],
                                       rgbaColor=[0.97, 0.97, 0.93, 1.0], physicsClientId=client)
    # The line is drawn as a rod with its middle on the surface.
    place = 0.25 * corners.sum(axis=0) - (0.005 + 0.002) * normal
    pybullet.createMultiBody(0.0, -1, shape, place.tolist(), pin.Quaternion(rotation).coeffs().tolist(),
                             physicsClientId=client)
