"""Default masses, efforts and speeds by an arm's size, for URDFs without them or with impossible ones.

Many public URDFs are kinematics alone: no masses or the same one everywhere, efforts and speeds of 0. A simulation
needs some; those of its class are used, and listed in ``Robot.assumed``.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ideal_robot.arrays import Array
from ideal_robot.results import listed
from ideal_robot.robots import SHIPPED
from ideal_robot.robots.arm_class import BASE_SPEED, MASS, REACH, SLIDING_SPEED, WRIST_SPEED, class_of
from ideal_robot.robots.joints import mass_matrix, own_joints
from ideal_robot.robots.robot import Robot, _frozen, spread_postures
from ideal_robot.robots.urdf import FEWEST, model_of

ABSURD_MASS = 10.0
"""Factor from the class beyond which the masses of a URDF are not those of its arm …"""
ABSURD_SPEED = 6.0
"""… or a speed limit not that of its joint."""
TAPER = 0.7
"""Mass of a link to that of the one before, of the same length: the motors of the joints before are the larger ones."""
RADIUS = 0.07
"""Of a link taken as a full cylinder, relative to the reach."""
LIFTS = 1.75
"""Effort of a joint relative to the largest gravity torque: UR5e 1.7, UR10e 1.6, Panda 1.2 …"""
RISE = 0.2
"""… besides what takes the joint to its speed limit in this time [s]."""
WEAKEST = 0.15
"""Effort of a wrist joint relative to the strongest one's at least: UR5e 0.19, Panda 0.14,
iiwa 0.13."""
HOLDS = 1.1
"""Effort relative to the gravity torque below which a URDF's effort is not the arm's: it could not hold itself."""
TOO_WEAK = 20.0
"""Factor below what its links and speed ask of a joint beyond which an effort is not the arm's; the least of a maker's,
of 22 public arms, is a fourteenth (the last joint of TX60L), a placeholder of 1 N m on an arm of 1 m a hundredth."""


def of_its_size(robot: Robot) -> Robot:
    """The arm with masses, efforts and speeds of its class where its URDF's are missing or impossible.

    A shipped one is returned as it is, as is one with too few joints for an arm.
    """
    if robot.name in SHIPPED or robot.n < FEWEST:
        return robot
    notes: list[str] = []
    with_mass = _with_masses(robot, notes)
    v_max = _speeds(with_mass, notes)
    with_speed = replace(with_mass, v_max=_frozen(v_max))
    tau_max = _efforts(with_speed, notes)
    return replace(with_speed, tau_max=_frozen(tau_max), assumed=(*robot.assumed, *notes))


def reach(robot: Robot) -> float:
    """Largest distance of the tool from the second joint, or from the only one, over the arm's range [m]."""
    model, data, pivot = robot.pinocchio, robot.pinocchio.createData(), own_joints(robot.pinocchio)[:2][-1]
    largest = REACH[0]
    for q in spread_postures(robot.q_min, robot.q_max):
        pin.framesForwardKinematics(model, data, q)
        away = data.oMf[robot.tool_id].translation - data.oMi[pivot].translation
        largest = max(largest, float(np.linalg.norm(away)))
    return largest


def reach_at_home(robot: Robot) -> float:
    """Distance of the tool from the base at home [m], at least that of the smallest arms."""
    return max(float(np.linalg.norm(robot.fk()(robot.home).translation)), REACH[0])


def _ways(robot: Robot) -> Array:
    """Vector from each joint to the next one, from the last one to the tool, in the joint's frame ``(b, 3)`` [m].

    Of all ``b`` joints, those that follow others, too.
    """
    return np.array([*(place.translation for place in list(robot.pinocchio.jointPlacements)[2:]), robot.tool_place])


# Masses

def _with_masses(robot: Robot, notes: list[str]) -> Robot:
    size = reach(robot)
    usual = class_of(MASS, size)
    bodies = list(robot.pinocchio.inertias)[1:]
    total = sum(body.mass for body in bodies)
    faulty = np.array([not _possible(body, size, usual) for body in bodies])
    if not usual / ABSURD_MASS <= total <= usual * ABSURD_MASS:
        notes.append(f"the links weigh {total:.3g} kg in the URDF: {usual:.3g} kg are taken, as arms of {size:.2g} m "
                     "have")
        faulty[:] = True
    elif faulty.any():
        names = ", ".join(robot.pinocchio.names[int(j) + 1] for j in np.flatnonzero(faulty))
        notes.append(f"no arm's masses or moments of inertia behind {names} in the URDF: those of a link of an arm of "
                     f"{size:.2g} m are taken")
    if not faulty.any():
        return robot
    weights = (np.linalg.norm(_ways(robot), axis=1) + 0.15 * size) * TAPER ** np.arange(len(bodies))
    text = _rewritten(robot, faulty, usual * weights / weights.sum(), RADIUS * size)
    model = model_of(text, robot.urdf)
    return replace(robot, pinocchio=model, description=text)


def _possible(body: pin.Inertia, size: float, usual: float) -> bool:
    """Whether a link can be one of an arm: some mass, and moments of inertia of a body that is no point and no hall."""
    if body.mass < 1e-5 * usual:
        return False
    moments = np.linalg.eigvalsh(body.inertia) / (body.mass * size**2)
    return bool(moments[0] > 1e-6 and moments[-1] < 1.0 and moments[0] + moments[1] > 0.9 * moments[2]
                and np.linalg.norm(body.lever) < size)


def _rewritten(robot: Robot, faulty: NDArray[np.bool_], masses: Array, radius: float) -> str:
    """The URDF with cylinders in the place of faulty links; what is fixed to such a link weighs nothing of its own."""
    root = ET.fromstring(robot.description)
    model = robot.pinocchio
    of_frame = {frame.name: frame.parentJoint for frame in model.frames if frame.type == pin.FrameType.BODY}
    carried = {str(joint.find("child").get("link")): str(joint.get("name"))  # type: ignore[union-attr]
               for joint in root.findall("joint")}
    for link in root.findall("link"):
        joint = of_frame.get(str(link.get("name")), 0)
        if joint == 0 or not faulty[joint - 1]:
            continue
        for inertial in link.findall("inertial"):
            link.remove(inertial)
        if carried.get(str(link.get("name"))) == model.names[joint]:
            link.append(_cylinder(_ways(robot)[joint - 1], float(masses[joint - 1]), radius))
    return ET.tostring(root, encoding="unicode")


def _cylinder(way: Array, mass: float, radius: float) -> ET.Element:
    """The ``inertial`` of a full cylinder along a way ``(3,)`` [m] from the link's frame."""
    length = float(np.linalg.norm(way))
    along = way / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    # A link is not a flat disc, whose moments PyBullet rejects.
    length = max(length, radius)
    across = mass * (3.0 * radius**2 + length**2) / 12.0
    inertia = across * np.eye(3) + (0.5 * mass * radius**2 - across) * np.outer(along, along)
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "origin", {"xyz": " ".join(f"{v:.9g}" for v in 0.5 * way), "rpy": "0 0 0"})
    ET.SubElement(inertial, "mass", {"value": f"{mass:.9g}"})
    ET.SubElement(inertial, "inertia", {f"i{'xyz'[a]}{'xyz'[b]}": f"{inertia[a, b]:.9g}"
                                        for a in range(3) for b in range(a, 3)})
    return inertial


# Speeds and efforts

def _speeds(robot: Robot, notes: list[str]) -> Array:
    size = reach(robot)
    usual = np.where(np.arange(robot.n) < robot.n - 3, class_of(BASE_SPEED, size), class_of(WRIST_SPEED, size))
    usual = np.where(robot.prismatic, SLIDING_SPEED, usual)
    missing = ~(np.isfinite(robot.v_max) & (robot.v_max < ABSURD_SPEED * usual))
    if missing.any():
        notes.append(f"no arm's speed limit of {_joints(missing)} in the URDF: {listed(usual[missing])} rad/s or m/s "
                     "are taken, as arms of that size have")
    return np.where(missing, usual, robot.v_max)


def _efforts(robot: Robot, notes: list[str]) -> Array:
    """Efforts of the URDF; of the class where a joint's is none, cannot hold the arm or is a placeholder like those."""
    gravity, inertia = loads(robot)
    asked = LIFTS * gravity + inertia * robot.v_max / RISE
    usual = np.maximum(asked, WEAKEST * asked[~robot.prismatic].max(initial=0.0))
    # Relative to the load of the joint itself: the base of a robot has no bearing on its wrist.
    weak = np.isfinite(robot.tau_max) & ~(robot.tau_max > np.maximum(HOLDS * gravity, asked / TOO_WEAK))
    # A number that is a placeholder at one joint is one at all joints, also at light ones.
    missing = ~np.isfinite(robot.tau_max) | np.isin(robot.tau_max, robot.tau_max[weak])
    if missing.any():
        notes.append(f"no effort of {_joints(missing)} in the URDF that could hold and move the arm: "
                     f"{listed(usual[missing])} N m or N are taken, for its masses and speeds")
    return np.where(missing, usual, robot.tau_max)


def loads(robot: Robot) -> tuple[Array, Array]:
    """Largest gravity torque [N m] and moment of inertia [kg m²] of each joint over the arm's range, ``(n,)`` each."""
    model, data = robot.pinocchio, robot.pinocchio.createData()
    postures = spread_postures(robot.q_min, robot.q_max)
    gravity = np.max([np.abs(pin.computeGeneralizedGravity(model, data, q)) for q in postures], axis=0)
    inertia = np.max([mass_matrix(model, data, q).diagonal() for q in postures], axis=0)
    return gravity, inertia


def _joints(which: NDArray[np.bool_]) -> str:
    numbers = [str(j + 1) for j in np.flatnonzero(which)]
    return f"joint {numbers[0]}" if len(numbers) == 1 else f"joints {', '.join(numbers)}"


def shoulder_height(robot: Robot) -> float:
    """Height of the second joint above the base plane z = 0 [m]; below it where an arm hangs."""
    data = robot.pinocchio.createData()
    pin.forwardKinematics(robot.pinocchio, data, robot.home)
    return float(data.oMi[own_joints(robot.pinocchio)[:2][-1]].translation[2])


def mean_height(robot: Robot) -> float:
    """Height of the tool above the base plane z = 0, averaged over the arm's range [m]."""
    fk = robot.fk()
    return float(np.mean([fk(q).translation[2] for q in spread_postures(robot.q_min, robot.q_max)]))
