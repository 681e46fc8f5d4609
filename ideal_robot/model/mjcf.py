"""Conversion to and from MuJoCo: identified parameters in an MJCF, and any MuJoCo model as a model of an arm.

MuJoCo is an optional extra and imported on first use.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.bounded_values import read_text
from ideal_robot.command.servo import Servo
from ideal_robot.command.words import described
from ideal_robot.dynamics import base_parameters, link_parameters
from ideal_robot.dynamics.consistent_inertias import BODY, LINK, consistent_parameters, parameter_scales
from ideal_robot.errors import InputError
from ideal_robot.friction import PerJointFriction
from ideal_robot.friction.laws import ViscousCoulomb
from ideal_robot.model.cascade import Cascade, beside_cascade
from ideal_robot.model.model import Model
from ideal_robot.model.model_file import urdf_with_inertials
from ideal_robot.model.parametrisation import coefficient_columns, friction_places, parameter_vector
from ideal_robot.robots.joints import joint_motions, mass_matrix, own_joints, without_followers
from ideal_robot.robots.robot import Robot, spread_postures
from ideal_robot.robots.urdf import LEAST, without_meshes
from ideal_robot.tolerances import WRITTEN
from ideal_robot.whole_file import write_text

_SURE = 3.0
"""Standard deviations by which what a controller adds is other than nothing."""
ELSEWHERE = 2e-3
"""What joints of two descriptions of the same arm may be apart [m, or of a direction cosine]."""
SLOW, FAST = 0.05, 1.0
"""Speeds between which a friction law is brought to MuJoCo's two terms, relative to the joint's limit …"""
USUAL_SPEED = 2.0
"""… or to this where it has none [rad/s or m/s]."""
VAGUE = 100.0
"""What nothing is known of beforehand may be off by, over its size."""
SHARE = 0.1
"""Of gravity's torque, by which drives that add it may differ and count as alike: as masses of data sheets do."""
EXPLICIT = 2.0
"""Step times rate of decay up to which explicit steps are stable."""
LATE = 1e-3
"""Lateness of commands that is worth a word [s]: a step of MuJoCo's."""
TURNS = 2.0 * np.pi
"""Limit of a joint that has none [rad]."""


def mujoco() -> Any:
    """The library MuJoCo; raises InputError where it is not installed."""
    try:
        import mujoco as library
    except ImportError as error:
        raise InputError("MuJoCo is not installed: pip install 'ideal-robot[mujoco]'", field="mujoco") from error
    return library


# Export of a model as an MJCF.

@dataclass(frozen=True)
class Friction:
    """A friction law in MuJoCo's terms: ``frictionloss`` and ``damping`` of one joint with standard deviations.

    Attributes:
        loss, damping: [N m, N m s/rad].
        loss_std, damping_std: their standard deviations.
        off: largest difference from the law over the used speeds [N m].
    """

    loss: float
    damping: float
    loss_std: float
    damping_std: float
    off: float


def friction_of(model: Model, joint: int) -> Friction:
    """MuJoCo's two terms nearest to a joint's law over its speeds; exact for a law without other terms.

    Args:
        model, joint: the model, and the joint counted from 0.
    """
    law = model.friction.laws[joint]
    limit = float(model.kinematics.velocityLimit[joint])
    fastest = limit if 0.0 < limit < 1e6 else USUAL_SPEED
    speed = np.linspace(SLOW, FAST, 40)[:, None] * fastest
    speed = np.concatenate([-speed[::-1], speed])
    # Without load and after presliding, as in fast motion.
    columns = coefficient_columns(law, speed, None, None)
    terms = np.column_stack([np.sign(speed), speed])
    to_terms = np.linalg.pinv(terms) @ columns
    values = to_terms @ law.coefficients[:, 0]
    place = friction_places(model.base, model.friction)[joint]
    variance = np.diag(to_terms @ model.covariance[place, place] @ to_terms.T)
    std = np.sqrt(np.maximum(variance, 0.0))
    off = float(np.abs(terms @ values - columns @ law.coefficients[:, 0]).max())
    return Friction(max(float(values[0]), 0.0), max(float(values[1]), 0.0), float(std[0]), float(std[1]), off)


def export_mjcf(model: Model, path: str | Path, like: str | Path | None = None) -> tuple[str, ...]:
    """Writes the identified model as an MJCF, each number with its standard deviation in a comment.

    Bodies get the identified inertias, joints ``armature``, ``frictionloss`` and ``damping``, and where the controller
    is known two actuators each: one of position, one of the command's speed. All else is kept.

    Args:
        model: identified model.
        path: of the file.
        like: MJCF or URDF of the arm that is kept in all else; the model's own URDF without its meshes if None.

    Returns:
        What the format cannot say, in words.

    Raises:
        InputError: MuJoCo is missing, no such file, a description of another arm, or a model in amperes.
    """
    model.require_torques()
    library = mujoco()
    spec, compiled = _spec(library, like, model)
    every = _matched(list(model.kinematics.names)[1:], [joint.name for joint in spec.joints], like)
    frames, layout = _frames(library, compiled, every, model.kinematics, like), model.base.layout
    comments: dict[str, str] = {}
    rotors = rotor_std(model)
    full = _bodies(model, _carried(library, compiled, every, frames), rotors)
    for i, name in enumerate(every):
        body = spec.joint(name).parent
        _set_inertia(body, frames[i].act(pin.Inertia.FromDynamicParameters(full[layout.link(i)])))
        for fixed in _fixed_bodies(body):
            _set_inertia(fixed, pin.Inertia.Zero())
    _follow(library, spec, model.kinematics, every)
    names = [every[i] for i in layout.own]
    for j, name in enumerate(names):
        joint = spec.joint(name)
        friction, unit = friction_of(model, j), model.units("N m")[j]
        joint.armature, joint.frictionloss = float(full[layout.rotors][j]), friction.loss
        joint.damping = _like(joint.damping, friction.damping)
        comments[name] = (f"frictionloss ± {friction.loss_std:.2g} {unit}, damping ± {friction.damping_std:.2g} "
                          f"{unit} s, {_rotor_words(model, j, rotors[j])}")
    servos = {name: servo for name, servo in zip(names, _servos(model), strict=True) if servo is not None}
    if model.command is None or not model.command.leads:
        _actuators(library, spec, model, names)
    _pd_actuators(library, spec, servos)
    for name, servo in servos.items():
        comments[name] += (f", gain {servo.stiffness:.5g} ± {servo.stiffness_std:.2g}, of the speed "
                           f"{servo.damping:.5g} ± {servo.damping_std:.2g}")
    cycle = _explicit_cycle(model)
    if cycle is not None:
        # A drive uses the rate of the cycle before; implicit steps use that of the next, which would act as an inertia.
        spec.option.integrator = library.mjtIntegrator.mjINT_EULER
        spec.option.timestep = min(spec.option.timestep, cycle)
    if share := _gravity_share(_servos(model)):
        for body in _moved_bodies(spec.joint(names[0]).parent):
            body.gravcomp = share
        for name in names:
            spec.joint(name).actgravcomp = True
    spec.compile()
    write_text(path, _commented(spec.to_xml(), comments, model))
    return tuple(_unsaid(model))


def _spec(library: Any, like: str | Path | None, model: Model) -> tuple[Any, Any]:
    """The editable description and its compiled model."""
    if like is None:
        spec, compiled = _read_urdf(library, model.arm.urdf)
        spec.option.integrator = library.mjtIntegrator.mjINT_IMPLICITFAST
        return spec, compiled
    return _read(library, like)


def _read_urdf(library: Any, text: str) -> tuple[Any, Any]:
    """A URDF's description and its compiled model, without its meshes; links may be without a mass in it."""
    spec = library.MjSpec.from_string(without_meshes(text))
    given = spec.compiler.boundmass, spec.compiler.boundinertia
    # MuJoCo rejects moving bodies without inertia; the identified inertia is set afterwards.
    spec.compiler.boundmass, spec.compiler.boundinertia = LEAST, LEAST
    compiled = spec.compile()
    spec.compiler.boundmass, spec.compiler.boundinertia = given
    return spec, compiled


def _read(library: Any, path: str | Path) -> tuple[Any, Any]:
    """A file's description and its compiled model; without the meshes where their files are not there."""
    text = read_text(Path(path), "an MJCF or URDF")
    try:
        if "<robot" in text:
            return _read_urdf(library, text)
        spec = library.MjSpec.from_file(str(path))
        try:
            return spec, spec.compile()
        except ValueError:
            spec = library.MjSpec.from_file(str(path))
            for geom in [geom for geom in spec.geoms if geom.meshname]:
                spec.delete(geom)
            for mesh in list(spec.meshes):
                spec.delete(mesh)
            return spec, spec.compile()
    except (ValueError, ET.ParseError) as error:
        raise InputError(f"MuJoCo cannot read it ({' '.join(str(error).split())[:200]})", file=path) from error


def _follow(library: Any, spec: Any, kinematics: pin.Model, names: list[str]) -> None:
    """Makes joints that follow others do so by equality constraints, where the description has none of theirs yet."""
    motions, own = joint_motions(kinematics), own_joints(kinematics)
    held = {name for equality in spec.equalities if equality.type == library.mjtEq.mjEQ_JOINT
            for name in (equality.name1, equality.name2)}
    for i in np.flatnonzero(~motions.own).tolist():
        joint = spec.joint(names[i])
        joint.armature, joint.frictionloss, joint.damping = 0.0, 0.0, _like(joint.damping, 0.0)
        if names[i] not in held:
            followed = names[own[motions.coordinate[i]] - 1]
            polynomial = [float(motions.offset[i]), float(motions.ratio[i]), *[0.0] * 9]
            spec.add_equality(type=library.mjtEq.mjEQ_JOINT, objtype=library.mjtObj.mjOBJ_JOINT, name1=names[i],
                              name2=followed, data=polynomial)


def _matched(own: list[str], theirs: list[str], file: str | Path | None) -> list[str]:
    """Their names of our joints: the same, all of them with one word before, or the only ones that end so."""
    before = {other.removesuffix(own[0]) for other in theirs if other.endswith(own[0])}
    # Gripper joints have the same names with another prefix, but not all of them.
    whole = sorted(word for word in before if {word + name for name in own} <= set(theirs))
    if whole and (len(whole) == 1 or whole[0] == ""):
        return [whole[0] + name for name in own]
    found = []
    for name in own:
        ends = [other for other in theirs if other == name] or [
            other for other in theirs if other.endswith(name) or (other and name.endswith(other))]
        if len(ends) != 1:
            own_joints = f"its joints are {', '.join(theirs)[:200]}" if theirs else "it has no joints"
            raise InputError(f"no joint, or more than one, is {name} of the model; {own_joints}", file=file,
                             field="joint", value=name)
        found.append(ends[0])
    return found


def _frames(library: Any, compiled: Any, names: list[str], kinematics: pin.Model, file: str | Path | None
            ) -> list[pin.SE3]:
    """Where our joint frames are in the bodies that carry these joints, both with all joints at zero."""
    # The angles of the MJCF are zero at its own reference, whatever the couplings.
    motions, free = joint_motions(kinematics), without_followers(kinematics)
    data, own = library.MjData(compiled), free.createData()
    for name in names:
        data.qpos[compiled.joint(name).qposadr] = 0.0
    library.mj_forward(compiled, data)
    pin.forwardKinematics(free, own, pin.neutral(free))
    theirs, mine = [], []
    for j, name in enumerate(names):
        place, axis = data.xanchor[compiled.joint(name).id], data.xaxis[compiled.joint(name).id]
        ours = own.oMi[j + 1]
        theirs += [place, place + axis]
        mine += [ours.translation, ours.translation + ours.rotation @ motions.axis[j]]
    moved = _fitted(np.array(mine), np.array(theirs))
    away = np.array(mine) @ moved.rotation.T + moved.translation - np.array(theirs)
    off = float(np.linalg.norm(away, axis=1).max())
    if off > ELSEWHERE:
        raise InputError(f"its joints are elsewhere than the model's, by up to {1e3 * off:.1f} mm: it describes "
                         "another arm, or one whose zeros are others", file=file, field="joint")
    frames = []
    for j, name in enumerate(names):
        body = compiled.jnt_bodyid[compiled.joint(name).id]
        place = pin.SE3(data.xmat[body].reshape(3, 3), data.xpos[body])
        frames.append(place.inverse() * moved * own.oMi[j + 1])
    return frames


def _fitted(points: Array, onto: Array) -> pin.SE3:
    """The rigid motion that takes points ``(N, 3)`` nearest to others."""
    middle, other = points.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((onto - other).T @ (points - middle))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return pin.SE3(rotation, other - rotation @ middle)


def _bodies(model: Model, carried: Array, rotors: Array) -> Array:
    """Physically possible full parameters ``(p,)`` of the links without what other joints move.

    Args:
        model: identified; its links hold all that moves with them.
        carried: parameters ``(10 b,)`` of what other joints move, by the ``b`` links that it hangs on.
        rotors: standard deviations of the rotor inertias ``(n,)``.
    """
    if not np.any(carried):
        return model.consistent
    carried = np.concatenate([carried, np.zeros(2 * model.n)])
    base, count = model.base, model.base.count
    return consistent_parameters(base, model.base_values - base.of(carried), model.covariance[:count, :count],
                                 model.consistent, rotors).full


def _carried(library: Any, compiled: Any, names: list[str], frames: list[pin.SE3]) -> Array:
    """Link parameters ``(10 b,)`` of what other joints than the identified ones move, where the file has them.

    Args:
        library, compiled: MuJoCo, and the description.
        names, frames: the identified joints along the chain, and where their frames are in the bodies that carry them.
    """
    data, parameters = library.MjData(compiled), np.zeros(10 * len(names))
    library.mj_forward(compiled, data)
    carriers = {int(compiled.jnt_bodyid[compiled.joint(name).id]): j for j, name in enumerate(names)}
    for body in range(1, compiled.nbody):
        way = [body]
        while way[-1] and way[-1] not in carriers:
            way.append(int(compiled.body_parentid[way[-1]]))
        if not way[-1] or not any(compiled.body_jntnum[step] for step in way[:-1]):
            continue
        j = carriers[way[-1]]
        link = pin.SE3(data.xmat[way[-1]].reshape(3, 3), data.xpos[way[-1]]) * frames[j]
        place = link.inverse() * pin.SE3(data.ximat[body].reshape(3, 3), data.xipos[body])
        own = pin.Inertia(float(compiled.body_mass[body]), np.zeros(3), np.diag(compiled.body_inertia[body]))
        parameters[10 * j : 10 * j + 10] += place.act(own).toDynamicParameters()
    return parameters


def _set_inertia(body: Any, inertia: pin.Inertia) -> None:
    body.explicitinertial = True
    body.mass = float(inertia.mass)
    body.ipos = inertia.lever if inertia.mass > 0.0 else np.zeros(3)
    body.iquat, body.inertia = [1.0, 0.0, 0.0, 0.0], np.zeros(3)
    moments = inertia.inertia
    # NaN means that none is given.
    body.fullinertia = np.full(6, np.nan) if inertia.mass == 0.0 else [
        moments[0, 0], moments[1, 1], moments[2, 2], moments[0, 1], moments[0, 2], moments[1, 2]]


def _fixed_bodies(body: Any) -> Iterator[Any]:
    """Bodies that move with a body and have no joint of their own: the identified inertia holds them."""
    for child in body.bodies:
        if not list(child.joints):
            yield child
            yield from _fixed_bodies(child)


def _moved_bodies(body: Any) -> Iterator[Any]:
    """A body and all that move with it."""
    yield body
    for child in body.bodies:
        yield from _moved_bodies(child)


def _like(old: Any, value: float) -> Any:
    """A value as MuJoCo's version has it: damping became a polynomial of the speed."""
    return value if np.isscalar(old) else [value, *([0.0] * (len(old) - 1))]


def rotor_std(model: Model) -> Array:
    """Standard deviation of each rotor inertia ``(n,)`` [kg m²], also of those determined only in a sum with links.

    The links' deviations have the prior of another arm of the type, or a larger one if the identified parameters need
    it; rotors have no prior. ``(G Σ G' + C)`` is the covariance of the parameters' deviations, with G the grouping and
    C their covariance.
    """
    base, layout = model.base, model.base.layout
    nominal = np.concatenate([link_parameters(model.kinematics), model.rotor_inertia, np.zeros(model.n)])
    scale = parameter_scales(nominal, layout)
    spread = (BODY * scale) ** 2
    links = np.zeros((layout.bodies, len(nominal)))
    for i in range(layout.bodies):
        links[i, layout.link(i)] = LINK * nominal[layout.link(i)]
    rotors = layout.rotors
    spread[rotors] = (VAGUE * np.maximum(model.rotor_inertia, scale[rotors])) ** 2
    spread[layout.offsets] = (VAGUE * np.maximum(np.abs(model.offset), 1.0)) ** 2
    prior = np.diag(spread) + links.T @ links
    G, C = base.grouping, model.covariance[: base.count, : base.count]
    off = model.base_values - base.of(nominal)
    # The scale of the links' spread that explains the parameters' deviations.
    for _ in range(3):
        whole = G @ prior @ G.T + C
        larger = max(1.0, float(off @ np.linalg.solve(whole, off)) / base.count)
        bodies = np.ones(len(nominal))
        bodies[layout.links] = np.sqrt(larger)
        prior = bodies[:, None] * prior * bodies
    whole = G @ prior @ G.T + C
    left = prior - prior @ G.T @ np.linalg.solve(whole, G @ prior)
    return np.sqrt(np.maximum(np.diag(left)[rotors], 0.0))


def _rotor_words(model: Model, j: int, std: float) -> str:
    own = next((one for one in model.parameters if one.name == f"Ia_{j + 1}"), None)
    if own is not None and own.std > 0.0:
        return f"armature ± {own.std:.2g} {own.unit}"
    return f"armature ± {std:.2g} {model.units('kg m²')[j]} by what the links' description leaves"


def _servos(model: Model) -> list[Servo | None]:
    """Each joint as PD control; None where it is not, or nobody knows."""
    return [None] * model.n if model.command is None else [own.servo for own in model.command.joints]


def _pd_actuators(library: Any, spec: Any, servos: dict[str, Servo]) -> None:
    """Position actuators of joints behind PD control; those that were there are replaced."""
    for actuator in [actuator for actuator in spec.actuators if actuator.target in servos]:
        spec.delete(actuator)
    for name, servo in servos.items():
        actuator = spec.add_actuator(name=f"{name}_position", target=name, trntype=library.mjtTrn.mjTRN_JOINT)
        actuator.gainprm[0], actuator.biastype = servo.stiffness, library.mjtBias.mjBIAS_AFFINE
        actuator.biasprm[1:3] = [-servo.stiffness, -servo.damping]


def _explicit_cycle(model: Model) -> float | None:
    """Time from command to command [s] where steps of it, with the rate before each, are stable for all drives."""
    command, servos = model.command, _servos(model)
    if command is None or None in servos:
        return None
    data, low, high = model.dynamics.createData(), *(np.clip(limit, -np.pi, np.pi) for limit in (
        model.kinematics.lowerPositionLimit, model.kinematics.upperPositionLimit))
    damping = np.diag([servo.damping for servo in servos if servo is not None])
    fastest = [np.linalg.eigvals(np.linalg.solve(mass_matrix(model.dynamics, data, q), damping)).real.max()
               for q in spread_postures(low, high)]
    return command.t_cycle if command.t_cycle * float(np.max(fastest)) < EXPLICIT else None


def _gravity_share(servos: Sequence[Servo | None]) -> float:
    """Share of gravity's torque that all drives add alike; 0 where they do not, or are not all known.

    MuJoCo compensates the weight of bodies, not the torque of joints: only a common share can be said.
    """
    known = [servo for servo in servos if servo is not None]
    if len(known) < len(servos) or not known:
        return 0.0
    share, std = np.array([[servo.gravity, servo.gravity_std] for servo in known]).T
    common = float(np.average(share, weights=1.0 / std**2))
    alike = np.abs(share - common) <= np.maximum(_SURE * std, SHARE)
    return common if np.all(alike) and common > _SURE / np.sqrt(np.sum(1.0 / std**2)) else 0.0


def _actuators(library: Any, spec: Any, model: Model, names: list[str]) -> None:
    """Position and speed of the command as the joint controllers take them; those that were there are replaced."""
    if model.controller is None:
        return
    gains = Cascade.of(model.controller)
    for actuator in [actuator for actuator in spec.actuators if actuator.target in names]:
        spec.delete(actuator)
    for j, name in enumerate(names):
        effort = float(model.kinematics.effortLimit[j])
        for kind, gain, bias in (
                ("position", gains.velocity_gain[j] * gains.position_gain[j],
                 [-gains.velocity_gain[j] * gains.position_gain[j], -gains.velocity_gain[j]]),
                ("speed", gains.velocity_gain[j] * gains.velocity_feedforward[j], None)):
            actuator = spec.add_actuator(name=f"{name}_{kind}", target=name, trntype=library.mjtTrn.mjTRN_JOINT)
            actuator.gainprm[0] = gain
            if bias is not None:
                actuator.biastype = library.mjtBias.mjBIAS_AFFINE
                actuator.biasprm[1:3] = bias
        if 0.0 < effort < 1e9:
            joint = spec.joint(name)
            joint.actfrclimited, joint.actfrcrange = True, [-effort, effort]


def _commented(xml: str, comments: dict[str, str], model: Model) -> str:
    """The text with a comment before each joint, and one about where it comes from."""
    root = ET.fromstring(xml, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag == "joint" and child.get("name") in comments:
                parent.insert(list(parent).index(child), ET.Comment(f" {comments[child.get('name', '')]} "))
    std = {} if model.controller is None else model.controller.std
    gains = "; ".join(f"{name} ± {', '.join(f'{value:.2g}' for value in values)}" for name, values in std.items())
    note = f" identified: {model.arm.name}, {model.provenance.get('method', 'idim')}{'; ' + gains if gains else ''} "
    root.insert(0, ET.Comment(note.replace("--", "-")))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _unsaid(model: Model) -> Iterator[str]:
    """What an MJCF cannot say of a model."""
    for j, law in enumerate(model.friction.laws):
        off = friction_of(model, j).off
        unit = model.units("N m")[j]
        if off > 0.0 and len(law.coefficients) > 2:
            yield f"joint {j + 1}: the law {law.label}; frictionloss and damping leave it by up to {off:.3g} {unit}"
        if law.loaded:
            yield f"joint {j + 1}: friction that grows with the load"
        if law.presliding:
            yield f"joint {j + 1}: presliding; MuJoCo's friction holds at once"
    for j in np.flatnonzero(np.abs(model.offset) > 3.0 * np.maximum(model.noise_std, 1e-12)).tolist():
        yield f"joint {j + 1}: a constant torque of {model.offset[j]:.3g} {model.units('N m')[j]}"
    stiffness = model.known_stiffness
    if stiffness is not None and np.isfinite(stiffness).any():
        yield "the gears' stiffness: motor and link are one joint in MuJoCo"
    yield from _unsaid_of_controllers(model)
    for effect in model.effects:
        yield f"joint {effect.joint}: {effect.name}" if effect.joint else effect.name


def _unsaid_of_controllers(model: Model) -> Iterator[str]:
    """What an MJCF cannot say of the joint controllers."""
    servos, command = _servos(model), model.command
    leads = command is not None and command.leads
    if model.controller is not None and not leads and None in servos:
        if np.any(model.controller.k_i > 0.0):
            yield "the integrators of the velocity loops"
        if words := beside_cascade(model.controller):
            yield f"functions of the drives themselves: {words}"
        if np.any(model.controller.filter_time > 0.0) or model.controller.delay > 0.0:
            yield "the commands' low-pass and dead time"
    if command is None:
        return
    share, rest = _gravity_share(servos), []
    for j, (own, servo) in enumerate(zip(command.joints, servos, strict=True)):
        if servo is None:
            if leads:
                yield f"joint {j + 1}: its controller, {described(own, model.units('N m/rad')[j])}"
            continue
        if servo.late > LATE:
            yield f"joint {j + 1}: commands act {1e3 * servo.late:.2g} ms late"
        if not share and servo.gravity > _SURE * servo.gravity_std:
            yield f"joint {j + 1}: its controller compensates {100.0 * servo.gravity:.0f} % of gravity"
        if servo.coriolis > _SURE * servo.coriolis_std:
            rest.append(j + 1)
    if rest:
        yield (f"centrifugal and Coriolis torques that the drives of joint {', '.join(map(str, rest))} add; where they "
               "matter, set data.qfrc_applied = data.qfrc_bias" + (" - data.qfrc_gravcomp" if share else
               " less gravity's") + " of these joints before each step")


def urdf_with_dynamics(model: Model) -> str:
    """The URDF with the consistent inertias and ``<dynamics damping friction>`` of each joint."""
    model.require_torques()
    text = urdf_with_inertials(model.arm.urdf, model.kinematics, model.consistent[model.base.layout.links])
    root = ET.fromstring(text)
    names = [model.kinematics.names[j] for j in own_joints(model.kinematics)]
    for joint in root.findall("joint"):
        if joint.get("name") not in names:
            continue
        friction = friction_of(model, names.index(str(joint.get("name"))))
        for old in joint.findall("dynamics"):
            joint.remove(old)
        ET.SubElement(joint, "dynamics", {"damping": f"{friction.damping:.9g}", "friction": f"{friction.loss:.9g}"})
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


# Import of an MJCF as a model.

@dataclass(frozen=True)
class MujocoArm:
    """The arm of a MuJoCo model.

    Attributes:
        robot: its kinematics and limits.
        model: its inertias, rotors and friction as a model; nothing of it is identified.
        left_out: parts of it that the model does not have, in words.
    """

    robot: Robot
    model: Model
    left_out: tuple[str, ...]


def arm_of_mjcf(path: str | Path) -> MujocoArm:
    """The longest chain of joints of a MuJoCo model as an arm and its model; other joints are fixed.

    Raises InputError: MuJoCo is missing, no readable model, or one without a chain of joints that turn or slide.
    """
    library = mujoco()
    _, compiled = _read(library, path)
    chain = _chain(library, compiled, path)
    mimics = _mimics(library, compiled, chain)
    text = _urdf(library, compiled, chain, mimics, Path(path).stem)
    with TemporaryDirectory() as folder:
        urdf = Path(folder) / f"{Path(path).stem}.urdf"
        urdf.write_text(text, encoding="utf-8")
        robot = Robot.load(urdf)
        nominal = Model.nominal(robot)
    own = [joint for joint in chain if joint not in mimics]
    dofs = [int(compiled.jnt_dofadr[j]) for j in own]
    damping = np.array(compiled.dof_damping).reshape(compiled.nv, -1)[dofs, 0]
    loss, armature = compiled.dof_frictionloss[dofs], compiled.dof_armature[dofs]
    full = np.concatenate([link_parameters(robot.pinocchio), armature, np.zeros(robot.n)])
    base = base_parameters(robot.pinocchio)
    friction = PerJointFriction([ViscousCoulomb(np.array([[v], [c]])) for v, c in zip(damping, loss, strict=True)])
    values = base.of(full)
    # Numbers of the file are exact up to rounding.
    covariance = np.diag((WRITTEN * (1.0 + np.abs(parameter_vector(values, friction)))) ** 2)
    model = Model(nominal.arm, base, values, friction, covariance, full, np.zeros(robot.n),
                  provenance={"method": "MuJoCo model", "file": str(path)})
    springs = [j + 1 for j, joint in enumerate(own) if np.any(np.atleast_1d(compiled.jnt_stiffness[joint]) != 0.0)]
    held = [compiled.joint(j).name or str(j) for j in range(compiled.njnt) if j not in chain]
    resisting = [compiled.joint(j).name or str(j) for j in mimics if _resists(compiled, j)]
    left_out = [*([f"springs of joint {', '.join(map(str, springs))}"] if springs else []),
                *([f"friction, springs and armature of {', '.join(resisting)}, which follow"] if resisting else []),
                *([f"motion of {', '.join(held)}"] if held else [])]
    return MujocoArm(robot, model, tuple(left_out))


def _chain(library: Any, compiled: Any, path: str | Path) -> list[int]:
    """Joints from the world to the end of the longest chain."""
    single = {int(library.mjtJoint.mjJNT_HINGE), int(library.mjtJoint.mjJNT_SLIDE)}
    best: list[int] = []
    for body in range(compiled.nbody):
        joints, here = [], body
        while here:
            first, count = int(compiled.body_jntadr[here]), int(compiled.body_jntnum[here])
            joints += list(range(first, first + count))[::-1] if count else []
            here = int(compiled.body_parentid[here])
        if len(joints) > len(best) and all(int(compiled.jnt_type[j]) in single for j in joints):
            best = joints[::-1]
    # A gripper ends the chain: prismatic joints after revolute ones are its fingers.
    while len(best) > 1 and compiled.jnt_type[best[-1]] != compiled.jnt_type[best[-2]]:
        best.pop()
    if not best:
        raise InputError("it has no chain of joints that turn or slide", file=path, field="joint")
    return best


def _mimics(library: Any, compiled: Any, chain: list[int]) -> dict[int, dict[str, str]]:
    """Joints of the chain that equality constraints lead by others of it, in proportion: their ``mimic`` of a URDF."""
    found = {}
    for k in range(compiled.neq):
        follower, leader = int(compiled.eq_obj1id[k]), int(compiled.eq_obj2id[k])
        offset, ratio, *bent = compiled.eq_data[k][:5]
        if (compiled.eq_type[k] == library.mjtEq.mjEQ_JOINT and compiled.eq_active0[k]
                and {follower, leader} <= set(chain) and not np.any(bent)):
            # MuJoCo's angles start from the pose in the description.
            zeros = compiled.qpos0[[compiled.jnt_qposadr[follower], compiled.jnt_qposadr[leader]]]
            found[follower] = {"joint": _name(compiled, chain, leader), "multiplier": f"{ratio:.12g}",
                               "offset": f"{offset + zeros[0] - ratio * zeros[1]:.12g}"}
    return found


def _resists(compiled: Any, joint: int) -> bool:
    """Whether a joint has armature, friction, damping or a spring of its own."""
    dof = int(compiled.jnt_dofadr[joint])
    return any(np.any(np.atleast_1d(values) != 0.0) for values in (
        compiled.dof_armature[dof], compiled.dof_frictionloss[dof], compiled.dof_damping.reshape(compiled.nv, -1)[dof],
        compiled.jnt_stiffness[joint]))


def _name(compiled: Any, chain: list[int], joint: int) -> str:
    return str(compiled.joint(joint).name or f"joint_{chain.index(joint) + 1}")


def _urdf(library: Any, compiled: Any, chain: list[int], mimics: dict[int, dict[str, str]], name: str) -> str:
    """The chain as a URDF: frames in the joints, each with the inertia of all bodies that move with it."""
    data = library.MjData(compiled)
    for joint in chain:
        data.qpos[compiled.jnt_qposadr[joint]] = 0.0
    library.mj_forward(compiled, data)
    carriers = {int(compiled.jnt_bodyid[joint]): index for index, joint in enumerate(chain)}
    bodies: list[list[int]] = [[] for _ in chain]
    for body in range(1, compiled.nbody):
        here = body
        while here and here not in carriers:
            here = int(compiled.body_parentid[here])
        if here:
            bodies[carriers[here]].append(body)
    root = ET.Element("robot", {"name": name})
    ET.SubElement(root, "link", {"name": "base_link"})
    before, parent = pin.SE3.Identity(), "base_link"
    for index, joint in enumerate(chain):
        body = int(compiled.jnt_bodyid[joint])
        frame = pin.SE3(data.xmat[body].reshape(3, 3), data.xanchor[joint])
        link = ET.SubElement(root, "link", {"name": f"link_{index + 1}"})
        link.append(_inertial(compiled, data, bodies[index], frame))
        kind = "revolute" if compiled.jnt_type[joint] == library.mjtJoint.mjJNT_HINGE else "prismatic"
        element = ET.SubElement(root, "joint", {"name": _name(compiled, chain, joint), "type": kind})
        if joint in mimics:
            ET.SubElement(element, "mimic", mimics[joint])
        ET.SubElement(element, "parent", {"link": parent})
        ET.SubElement(element, "child", {"link": f"link_{index + 1}"})
        ET.SubElement(element, "origin", _placed(before.inverse() * frame))
        ET.SubElement(element, "axis", {"xyz": _words(frame.rotation.T @ data.xaxis[joint])})
        limited = bool(compiled.jnt_limited[joint])
        low, high = compiled.jnt_range[joint] if limited else (-TURNS, TURNS)
        effort = float(compiled.jnt_actfrcrange[joint][1]) if compiled.jnt_actfrclimited[joint] else 0.0
        ET.SubElement(element, "limit", {"lower": f"{low:.12g}", "upper": f"{high:.12g}", "effort": f"{effort:.12g}",
                                         "velocity": "0"})
        before, parent = frame, f"link_{index + 1}"
    ET.SubElement(root, "link", {"name": "tool"})
    element = ET.SubElement(root, "joint", {"name": "tool_joint", "type": "fixed"})
    ET.SubElement(element, "parent", {"link": parent})
    ET.SubElement(element, "child", {"link": "tool"})
    ET.SubElement(element, "origin", _placed(before.inverse() * _tool(compiled, data, bodies[-1], before)))
    return ET.tostring(root, encoding="unicode")


def _tool(compiled: Any, data: Any, bodies: list[int], last: pin.SE3) -> pin.SE3:
    """Where tools are held: the site that is farthest from the last joint, or else the body, turned as the joint is.

    Args:
        compiled, data: the model, and its state.
        bodies: that move with the last joint.
        last: the joint's frame.
    """
    sites = [data.site_xpos[site] for site in range(compiled.nsite) if int(compiled.site_bodyid[site]) in bodies]
    places = sites or [data.xpos[body] for body in bodies]
    return pin.SE3(last.rotation, max(places, key=lambda place: float(np.linalg.norm(place - last.translation))))


def _inertial(compiled: Any, data: Any, bodies: list[int], frame: pin.SE3) -> ET.Element:
    """The inertia of bodies together, in a frame."""
    total = pin.Inertia.Zero()
    for body in bodies:
        place = pin.SE3(data.ximat[body].reshape(3, 3), data.xipos[body])
        own = pin.Inertia(float(compiled.body_mass[body]), np.zeros(3), np.diag(compiled.body_inertia[body]))
        if own.mass > 0.0:
            total = total + (frame.inverse() * place).act(own)
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "origin", {"xyz": _words(total.lever), "rpy": "0 0 0"})
    ET.SubElement(inertial, "mass", {"value": f"{total.mass:.12g}"})
    ET.SubElement(inertial, "inertia", {f"i{'xyz'[a]}{'xyz'[b]}": f"{total.inertia[a, b]:.12g}"
                                        for a in range(3) for b in range(a, 3)})
    return inertial


def _placed(place: pin.SE3) -> dict[str, str]:
    return {"xyz": _words(place.translation), "rpy": _words(pin.rpy.matrixToRpy(place.rotation))}


def _words(values: Array) -> str:
    return " ".join(f"{value:.12g}" for value in values)
