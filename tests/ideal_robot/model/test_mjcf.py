"""A model in MuJoCo moves as it does here, comes back as it was, and says what the format cannot."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.command.law import PARTS, Column, CommandLaw, JointLaw, Shape
from ideal_robot.command.servo import Servo
from ideal_robot.dynamics import base_parameters, link_parameters
from ideal_robot.dynamics.consistent_inertias import LINK, consistent_parameters
from ideal_robot.errors import InputError
from ideal_robot.friction import PerJointFriction
from ideal_robot.friction.laws import ViscousCoulomb
from ideal_robot.model.mjcf import _matched, arm_of_mjcf, export_mjcf, friction_of, rotor_std, urdf_with_dynamics
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.urdf import without_meshes
from scenes.arms import shipped_model
from tests.arms import urdf, written

mujoco = pytest.importorskip("mujoco", reason="needs the optional package mujoco")


def plain(model: Model, rng: np.random.Generator) -> Model:
    """The model with friction that MuJoCo has, drawn, and its deviations."""
    laws = [ViscousCoulomb(np.array([[v], [f]])) for v, f in rng.uniform(0.5, 5.0, (model.n, 2))]
    count = model.base.count + 2 * model.n
    deviations = np.diag(rng.uniform(0.01, 0.1, count) ** 2)
    return dataclasses.replace(model, friction=PerJointFriction(laws), covariance=deviations, effects=())


def torque(path: Path, states: Array) -> Array:
    """MuJoCo's inverse dynamics of a file, its friction and damping included ``(N, n)``; ``states (3, N, n)``."""
    compiled = mujoco.MjModel.from_xml_path(str(path))
    data, rows = mujoco.MjData(compiled), []
    damping = np.array(compiled.dof_damping).reshape(compiled.nv, -1)[:, 0]
    compiled.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    for q, qd, qdd in zip(*states, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mujoco.mj_inverse(compiled, data)
        rows.append(data.qfrc_inverse + data.qfrc_passive + damping * qd + compiled.dof_frictionloss * np.sign(qd))
    return np.array(rows)


def drawn(robot: Robot, rng: np.random.Generator) -> Array:
    shape = (30, robot.n)
    return np.array([rng.uniform(robot.q_min, robot.q_max, shape), rng.normal(size=shape), rng.normal(size=shape)])


@pytest.mark.parametrize("name", ["kr6", "kr15", "manutec_r15"])
def test_plain_mujoco_asks_for_the_models_torques_and_the_file_comes_back_as_the_model(name: str, tmp_path: Path
                                                                                      ) -> None:
    rng = np.random.default_rng(1)
    model, robot, path = plain(Model.load(shipped_model(name)), rng), Robot.load(name), tmp_path / "arm.xml"
    said = export_mjcf(model, path)
    states = drawn(robot, rng)
    friction = model.friction.torque(states[1])
    full = np.array([model.consistent[10 * model.n : 11 * model.n]])
    chain = dataclasses.replace(model, base_values=model.base.of(np.concatenate(
        [model.consistent[: 11 * model.n], np.zeros(model.n)])))
    ours = chain.rigid_body(*states) + full * states[2] + friction
    theirs = torque(path, states)
    np.testing.assert_allclose(theirs, ours, atol=2e-5 * np.abs(ours).max())
    arm = arm_of_mjcf(path)
    again = arm.model.rigid_body(*states) + arm.model.rotor_inertia * states[2] + arm.model.friction.torque(states[1])
    np.testing.assert_allclose(again, theirs, atol=2e-5 * np.abs(ours).max())
    q = states[0][0]
    np.testing.assert_allclose(arm.robot.pinocchio.lowerPositionLimit, robot.q_min, atol=1e-4)
    assert arm.robot.n == robot.n
    assert not [text for text in said if "frictionloss" in text]
    assert np.isfinite(arm.robot.fk()(q).translation).all()


def test_friction_keeps_its_numbers_and_deviations_and_a_law_with_more_is_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    model = plain(Model.load(shipped_model("kr6")), rng)
    for j, law in enumerate(model.friction.laws):
        own, first = friction_of(model, j), model.base.count + 2 * j
        np.testing.assert_allclose([own.damping, own.loss], law.coefficients[:, 0], rtol=1e-9)
        np.testing.assert_allclose([own.damping_std, own.loss_std],
                                   np.sqrt(np.diag(model.covariance))[first : first + 2], rtol=1e-9)
    path = tmp_path / "arm.xml"
    export_mjcf(model, path)
    text = path.read_text()
    assert text.count("frictionloss ±") == 6
    said = export_mjcf(Model.load(shipped_model("kr6")), path)
    assert any("presliding" in text for text in said)


@pytest.mark.parametrize("prefix", ["", "left_"])
def test_what_is_given_is_kept_in_all_else(prefix: str, tmp_path: Path) -> None:
    """Of a file with its base elsewhere, other body frames and a tool body, joints and masses alone are changed."""
    model = plain(Model.load(shipped_model("kr6")), np.random.default_rng(3))
    spec = mujoco.MjSpec.from_string(without_meshes(model.arm.urdf))
    spec.compiler.fusestatic = False
    for i, joint in enumerate(list(spec.joints)):
        joint.name = f"{prefix}joint_{i + 1}"
    last = list(spec.joints)[-1].parent
    tool = last.add_body(name="tool", pos=[0.0, 0.0, 0.1])
    tool.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0.0, 0.0], mass=1.5)
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1.0, 1.0, 0.1])
    spec.compile()
    given, path = tmp_path / "given.xml", tmp_path / "arm.xml"
    given.write_text(spec.to_xml())
    export_mjcf(model, path, like=given)
    compiled = mujoco.MjModel.from_xml_path(str(path))
    assert compiled.geom("table").size[0] == 1.0
    assert compiled.body("tool").mass[0] == 0.0
    states = drawn(Robot.load("kr6"), np.random.default_rng(4))
    export_mjcf(model, tmp_path / "own.xml")
    np.testing.assert_allclose(torque(path, states), torque(tmp_path / "own.xml", states), atol=1e-2)


@pytest.mark.parametrize("word", ["fr3_", "left/"])
def test_joints_behind_a_word_are_matched_beside_fingers_of_the_same_names(word: str) -> None:
    own = [f"joint{i}" for i in range(1, 8)]
    theirs = [word + name for name in own] + ["finger_joint1", "finger_joint2"]
    assert _matched(own, theirs, None) == theirs[:7]
    assert _matched(own, [*theirs, *own], None) == own
    with pytest.raises(InputError, match="joint1"):
        _matched(own, [*theirs, *("right/" + name for name in own)], None)


def behind_servos(model: Model, servos: list[Servo | None]) -> Model:
    """The model behind PD control; a joint without a servo has a cascade."""
    laws = [JointLaw(Shape() if servo else Shape(reset=0.1), (Column("offset"), Column("velocity"), Column("torque")),
                     np.array([0.0, 0.1, 1e-3]), 1e-12 * np.eye(3), np.full(PARTS, 1e-10), 0.02, 1e-3, "joint_pd",
                     servo) for servo in servos]
    ones = np.ones(model.n)
    return dataclasses.replace(model, command=CommandLaw(tuple(laws), 0.001, 0.01 * ones, 0.0 * ones, ones))


def servos_of(rng: np.random.Generator, n: int, share: float, std: float = 0.01) -> list[Servo | None]:
    """Servos of random gains that add a share of gravity."""
    K = rng.uniform(500.0, 5000.0, n)
    return [Servo(k, 0.02 * k, 0.05 * k, 0.001 * k, share + std * float(rng.normal()), std, 0.0, 0.1) for k in K]


@pytest.mark.parametrize("seed", range(3))
def test_gains_of_servos_leave_with_their_deviations_and_another_joints_controller_is_said(seed: int, tmp_path: Path
                                                                                          ) -> None:
    rng = np.random.default_rng(seed)
    servos, other = servos_of(rng, 6, 1.0), int(rng.integers(6))
    model = behind_servos(plain(Model.load(shipped_model("kr6")), rng), [
        None if j == other else servo for j, servo in enumerate(servos)])
    path = tmp_path / "arm.xml"
    said = export_mjcf(model, path)
    compiled = mujoco.MjModel.from_xml_path(str(path))
    assert compiled.nu == 5
    for i in range(compiled.nu):
        servo = servos[int(compiled.actuator_trnid[i, 0])]
        assert servo is not None
        np.testing.assert_allclose(compiled.actuator_gainprm[i, 0], servo.stiffness, rtol=1e-4)
        np.testing.assert_allclose(compiled.actuator_biasprm[i, 1:3], [-servo.stiffness, -servo.damping], rtol=1e-4)
    assert any(text.startswith(f"joint {other + 1}: its controller, P/PI cascade") for text in said)
    assert sum("of gravity" in text for text in said) == 5
    deviations = [float(x) for x in re.findall(r"gain [\d.e+]+ ± ([\d.e+]+)", path.read_text())]
    expected = [servo.stiffness_std for j, servo in enumerate(servos) if servo and j != other]
    np.testing.assert_allclose(deviations, expected, rtol=0.06)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_drives_that_add_gravity_hold_the_arm_where_it_was_told(share: float, tmp_path: Path) -> None:
    """In plain MuJoCo it sags by what they do not add over their stiffness."""
    rng = np.random.default_rng(5)
    servos, robot = servos_of(rng, 6, share, 1e-4), Robot.load("kr6")
    model = behind_servos(plain(Model.load(shipped_model("kr6")), rng), servos)
    model = dataclasses.replace(model, friction=PerJointFriction([ViscousCoulomb(np.array([[5.0], [0.0]]))] * 6))
    path = tmp_path / "arm.xml"
    export_mjcf(model, path)
    compiled = mujoco.MjModel.from_xml_path(str(path))
    data, told = mujoco.MjData(compiled), np.array(robot.home)
    data.qpos[:] = told
    data.ctrl[:] = told
    for _ in range(6000):
        mujoco.mj_step(compiled, data)
    stiffness = np.array([servo.stiffness for servo in servos if servo])
    needed = model.rigid_body(data.qpos[None], *np.zeros((2, 1, 6)))[0]
    np.testing.assert_allclose(stiffness * (told - data.qpos), (1.0 - share) * needed, atol=0.02 * np.abs(needed).max())


@pytest.mark.parametrize("seed", range(3))
def test_rotors_that_show_only_with_links_take_what_links_leave(seed: int) -> None:
    """A rotor of which no data sheet tells, of a joint whose links are as described but for what arms differ by."""
    rng = np.random.default_rng(seed)
    robot = Robot.load("kr6")
    n, base = robot.n, base_parameters(robot.pinocchio)
    links = link_parameters(robot.pinocchio)
    own = links * (1.0 + LINK * np.repeat(rng.normal(size=n), 10))
    rotors = rng.uniform(20.0, 60.0, n)
    values = base.of(np.concatenate([own, rotors, np.zeros(n)]))
    covariance = np.diag((1e-3 * (1.0 + np.abs(values))) ** 2)
    nominal = np.concatenate([links, np.zeros(2 * n)])
    full = consistent_parameters(base, values, covariance, nominal, np.full(n, 100.0)).full
    friction = PerJointFriction([ViscousCoulomb(np.array([[5.0], [1.0]]))] * n)
    wide = np.zeros((len(values) + 2 * n,) * 2)
    wide[: len(values), : len(values)] = covariance
    model = Model(Model.nominal(robot).arm, base, values, friction, wide, full, np.zeros(n))
    off = (full[10 * n : 11 * n] - rotors) / rotor_std(model)
    assert np.all(np.abs(off) < 3.5)
    assert np.sqrt(np.mean(off**2)) < 2.0
    assert np.all(np.abs(full[10 * n : 11 * n] - rotors)[3:] < 0.1 * rotors[3:])


def test_what_other_joints_move_counts_once(tmp_path: Path) -> None:
    """Fingers keep their masses, and all together asks for the torques of the model."""
    rng = np.random.default_rng(7)
    model = plain(Model.load(shipped_model("kr6")), rng)
    spec = mujoco.MjSpec.from_string(without_meshes(model.arm.urdf))
    finger = list(spec.joints)[-1].parent.add_body(name="finger", pos=[0.0, 0.02, 0.1])
    finger.add_joint(name="finger_joint", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 1, 0])
    finger.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0.0, 0.0], mass=2.0)
    spec.compile()
    given, path = tmp_path / "given.xml", tmp_path / "arm.xml"
    given.write_text(spec.to_xml())
    export_mjcf(model, path, like=given)
    compiled = mujoco.MjModel.from_xml_path(str(path))
    assert compiled.body("finger").mass[0] == pytest.approx(2.0)
    data, robot = mujoco.MjData(compiled), Robot.load("kr6")
    for q in rng.uniform(robot.q_min, robot.q_max, (10, 6)):
        data.qpos[:6] = q
        mujoco.mj_forward(compiled, data)
        own = model.rigid_body(q[None], *np.zeros((2, 1, 6)))[0]
        np.testing.assert_allclose(data.qfrc_bias[:6], own, atol=2e-3 * np.abs(own).max() + 0.5)


def test_bad_input_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = Model.load(shipped_model("kr6"))
    other = written(tmp_path, urdf(6))
    moved = written(tmp_path, re.sub(r'name="[a-z]*_?joint_?(\d)"', r'name="joint_\1"', urdf(6, mass=1.0)), "moved")
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody>")
    for like, says in ((moved, "elsewhere than the model's"), (tmp_path / "broken.xml", "cannot read it"),
                       (tmp_path / "none.xml", "no such")):
        with pytest.raises(InputError, match=says):
            export_mjcf(model, tmp_path / "arm.xml", like=like)
    assert not (tmp_path / "arm.xml").exists()
    assert arm_of_mjcf(written(tmp_path, urdf(6, mass=1.0), "plain")).robot.n == 6
    assert other.exists()
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(InputError, match=r"ideal-robot\[mujoco\]"):
        arm_of_mjcf(other)


@pytest.mark.parametrize("sites", [0, 1])
def test_tools_are_held_at_the_end_of_what_the_last_joint_moves(sites: int, tmp_path: Path) -> None:
    spec = mujoco.MjSpec.from_string(without_meshes(Robot.load("kr6").urdf.read_text()))
    spec.compiler.fusestatic = False
    last = list(spec.joints)[-1].parent
    hand = last.add_body(name="hand", pos=[0.0, 0.0, 0.1])
    hand.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0.0, 0.0], mass=1.5)
    hand.add_body(name="finger", pos=[0.0, 0.0, 0.3])
    for _ in range(sites):
        hand.add_site(name="grip", pos=[0.0, 0.01, 0.05])
    path = tmp_path / "held.xml"
    spec.compile()
    path.write_text(spec.to_xml())
    np.testing.assert_allclose(arm_of_mjcf(path).robot.tool_place, [0.0, 0.01, 0.15] if sites else [0.0, 0.0, 0.4],
                               atol=1e-9)


def test_a_urdf_has_the_friction_too(tmp_path: Path) -> None:
    model = plain(Model.load(shipped_model("kr6")), np.random.default_rng(5))
    robot = Robot.load(written(tmp_path, urdf_with_dynamics(model)))
    np.testing.assert_allclose(robot.pinocchio.damping, [law.coefficients[0, 0] for law in model.friction.laws])
    np.testing.assert_allclose(robot.pinocchio.friction, [law.coefficients[1, 0] for law in model.friction.laws])
