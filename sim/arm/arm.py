"""The simulated arm: PyBullet's links, our motors, gears and industrial controller, behind the positional interface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.interface import RobotState, checked_command
from ideal_robot.robots.joints import joint_motions, mass_matrix, own_joints
from ideal_robot.robots.robot import Robot
from ideal_robot.row_log import let_go, new_array
from ideal_robot.signals.recording import Recording
from sim import SimError
from sim.arm import kernel
from sim.arm.body import JointTorques, load_links, start_physics
from sim.arm.controllers import CommandPath, TorqueController
from sim.arm.drive import beside_gears, drive_parameters, drive_start, hysteresis_stiffness, output_of
from sim.arm.history import History, recording_of
from sim.arm.kernel import P_ELASTIC, P_ROTOR, P_STIFFNESS
from sim.arm.schedule import GainSchedule
from sim.arm.specimen import draw_specimen, residual_torque
from sim.arm.structure import Structure, moved
from sim.arm.world import STEP, World
from sim.bullet import pybullet

# Errors that the simulated arm raises: for impossible postures and gears.

STRAYED = 0.3
"""How far beyond its limits a joint has diverged [rad or m]: no command leads there, and no drive errs by that much."""


def _checked_posture(robot: Robot, q0: Array) -> Array:
    """A posture to start from, as a new array ``(n,)``."""
    q = np.array(q0, dtype=float)
    if q.shape != (robot.n,) or not np.isfinite(q).all():
        raise InputError(f"expected {robot.n} finite joint angles", field="q0", value=q.tolist())
    if np.any(q < robot.q_min) or np.any(q > robot.q_max):
        raise InputError("posture is outside the joint limits", field="q0", value=np.round(q, 4).tolist())
    return q


def _require_integrable(model: pin.Model, q: Array, p: Array) -> None:
    """Refuses gears whose fastest oscillation the 0.5 ms step cannot follow, of links in posture ``q (n,)`` [rad].

    The oscillations of links M, rotors J and springs K have the squared frequencies √K (M⁻¹ + J⁻¹) √K. Beyond
    1.2 / step semi-implicit integration is about to go wrong (its bound is 2 / step).
    """
    elastic = p[P_ELASTIC] > 0.0
    if not elastic.any():
        return
    mass = mass_matrix(model, model.createData(), q)
    if np.linalg.matrix_rank(mass, hermitian=True) < len(mass):
        raise InputError("a joint turns nothing that has inertia; give the links moments of inertia, or use inf for "
                         "rigid gears", field="inertial")
    root = np.sqrt(p[P_STIFFNESS] + hysteresis_stiffness(p))
    rotor = np.where(elastic, 1.0 / np.where(elastic, p[P_ROTOR], 1.0), 0.0)
    fastest = float(np.sqrt(np.linalg.eigvalsh(root[:, None] * (np.linalg.inv(mass) + np.diag(rotor)) * root).max()))
    if fastest * STEP > 1.2:
        raise InputError(f"gears are too stiff for the {STEP * 1e3} ms step (fastest oscillation "
                         f"{fastest / 2 / np.pi:.0f} Hz); use inf for a rigid gear", field="world.stiffness")


@dataclass(frozen=True)
class TrueState:
    """The true state of the arm at ``t`` [s], which no controller measures.

    Arm angles, motor angles on the joint side ``(n,)`` [rad], and pose of the tool frame in the base frame.
    """

    t: float
    q_a: Array
    q_m: Array
    tcp: pin.SE3


class SimulatedArm:
    """A ``RobotInterface`` to an arm in a ``World``.

    With elastic gears PyBullet's links are driven by the gear torques, with rigid gears by the motor torques less those
    that accelerate the rotors (``JointTorques``).

    Args:
        robot: the robot as its maker describes it.
        world: the true world.
        rng: source of the measurement noise.
        q0: motor angles at the start ``(n,)`` [rad]; the robot's home posture if None.
        tool_radius: radius of a ball about the TCP that collides with other bodies of the physics client [m]; None: the
            arm has no contacts but the forces that ``step_hook`` applies.

    Raises:
        InputError: ``q0`` of wrong size or outside the limits, a world the step cannot integrate.

    Attributes:
        t_ipo: interpolation cycle [s].
        robot, world: as given.
        q_a: true arm angles now ``(n,)`` [rad]; not to be written to.
        client, body: PyBullet's ids of the physics client and of the arm, for contact.
        tool_link: PyBullet's index of the link that carries the tool.
        tool_offset: pose of the tool frame in that link's (joint) frame.
        step_hook: called with the time [s] before every 0.5 ms step, e.g. to apply contact forces.
    """

    def __init__(self, robot: Robot, world: World, rng: np.random.Generator, q0: Array | None = None, *,
                 tool_radius: float | None = None) -> None:
        self.robot, self.world = robot, world
        self.t_ipo = world.t_ipo
        self._rng = rng
        self._extra_torque = residual_torque(world, robot.pinocchio, rng)
        self._specimen = draw_specimen(robot, world)
        self._model = self._specimen.model
        self._p, self._shared, self._counts = drive_parameters(world, robot, self._specimen)
        self._elastic = self._p[kernel.P_ELASTIC] > 0.0
        self._kinematics = self._model.createData()
        _require_integrable(self._model, robot.home, self._p)
        self._steps_per_cycle = round(world.t_ipo / STEP)
        self._joints = list(range(self._model.njoints - 1))
        self._own = [joint - 1 for joint in own_joints(self._model)]
        frame = robot.pinocchio.frames[robot.tool_id]
        self.tool_link = int(frame.parentJoint) - 1
        self.tool_offset: pin.SE3 = frame.placement.copy()
        self.step_hook: Callable[[float], None] | None = None
        self._structure = Structure.of(robot, self._model, world, int(self._counts[kernel.N_LOG]) * STEP)
        self._schedule = GainSchedule.of(robot, world, self._p)
        self._controller, self._path = TorqueController.of(robot, world, self._p), CommandPath.of(world)
        self._touchable = tool_radius is not None
        self.client = start_physics()
        self.body = load_links(self._model, self.client, self.tool_offset if tool_radius else None, tool_radius or 0.0)
        self.reset(robot.home if q0 is None else q0)

    def reset(self, q0: Array) -> None:
        """Puts the arm at rest with its motors at ``q0 (n,)`` [rad]; time, history and delays start anew.

        Temperatures start anew too. Raises ``InputError`` for a posture of wrong size or outside the limits.
        """
        q0 = _checked_posture(self.robot, q0)
        n = self.robot.n
        stiffness = np.where(self._elastic, self._p[kernel.P_STIFFNESS], np.inf)
        output = output_of(self._p, q0)
        q_a = output.copy()
        for _ in range(30):
            holding = pin.computeGeneralizedGravity(self._model, self._kinematics, q_a) - beside_gears(self._p, q_a)
            q_a = output - holding / stiffness
        q_a = q_a - np.sign(holding) * 0.5 * np.where(np.isfinite(stiffness), self.world.per_joint("backlash", n), 0.0)
        temperature = self.world.per_joint("start_temperature", n)
        self._x = drive_start(self._p, q0, q_a, holding, temperature)
        if self._controller is not None:
            self._controller.reset(q0, holding)
        if self._path is not None:
            self._path.reset(q0)
        if self._structure is not None:
            self._structure.reset(q_a, temperature)
        rigid = np.where(self._elastic, 0.0, self._specimen.rotor_inertia)
        self._torques = JointTorques.of(self._model, rigid)
        self._tick = 0
        self._pending = q0.copy()
        self._links = np.zeros((4, n))
        self._links[kernel.L_ANGLE] = q_a
        self.q_a, self._qd_a = self._links[kernel.L_ANGLE], self._links[kernel.L_VELOCITY]
        self._history = History(n, int(self._counts[kernel.N_LOG]) * STEP)
        for joint, angle in enumerate(joint_motions(self._model).angles(q_a).tolist()):
            pybullet.resetJointState(self.body, joint, angle, 0.0, physicsClientId=self.client)

    def cycle(self, q_c: Array) -> RobotState:
        """Executes one interpolation cycle with the commanded joint angles ``q_c (n,)`` [rad].

        They are reached at the end of this cycle, or of the next one with the standard planner's delay.

        Raises:
            InputError: wrong size or not finite.
            LimitError: outside the joint limits, or more than twice the velocity limit away from the last command.
            SimError: the world's numbers make the arm unstable.
        """
        q_c = checked_command(self.robot, q_c, self._pending, self.t_ipo)
        x = self._x
        x[kernel.X_START], x[kernel.X_TOLD_START] = x[kernel.X_END], x[kernel.X_TOLD_END]
        x[kernel.X_TOLD_END] = reached = self._pending if self.world.correction_delay else q_c
        x[kernel.X_END] = reached if self._path is None else self._path.next(reached)
        self._pending = q_c.copy()
        noise = self._rng.standard_normal((self._steps_per_cycle + 1, self.robot.n))
        self._history.reserve(self._steps_per_cycle + 1)
        if self._schedule is not None:
            self._schedule.follow(self._p, x[kernel.X_ENCODER])
        try:
            self._run(noise)
        except (ZeroDivisionError, OverflowError) as error:  # values diverge before the posture shows it
            raise self._unstable() from error
        return self._state(noise[-1])

    def _run(self, noise: Array) -> None:
        """The steps of one cycle: 2000 of them make a second, so names are looked up before the loop."""
        client, body, joints = self.client, self.body, self._joints
        p, s, counts, x, links = self._p, self._shared, self._counts, self._x, self._links
        q_a, qd_a, torque = self.q_a, self._qd_a, links[kernel.L_TORQUE]
        # Element by element through a memoryview takes a third of the time.
        angles, speeds = memoryview(q_a), memoryview(qd_a)
        every, torques, history = int(counts[kernel.N_LOG]), self._torques, self._history
        extra_torque, hook = self._extra_torque, self.step_hook
        touched = hook is not None or self._touchable
        structure, controller = self._structure, self._controller
        asked_every = int(counts[kernel.N_VELOCITY])
        set_torques, step, get_states, mode = (pybullet.setJointMotorControlArray, pybullet.stepSimulation,
                                               pybullet.getJointStates, pybullet.TORQUE_CONTROL)
        drive_step, own = kernel.drive_step, self._own
        for line in noise[:-1]:
            tick = self._tick
            if extra_torque is not None:
                links[kernel.L_EXTRA] = extra_torque(tick * STEP, x[kernel.X_MOTOR].copy(),
                                                     x[kernel.X_MOTOR_VELOCITY].copy(), q_a.copy())
            if controller is not None and tick % asked_every == 0:
                controller.ask(x)
            drive_step(tick, p, s, counts, x, links, line, history.next_row)
            if tick % every == 0:
                history.rows += 1
                if structure is not None:
                    structure.update(q_a, qd_a, x[kernel.X_TEMPERATURE])
            driving = torque if torques is None else torques.of_drives(q_a, qd_a, torque)
            set_torques(body, joints, mode, forces=driving.tolist(), physicsClientId=client)
            if hook is not None:
                hook(tick * STEP)
            step(client)
            states = get_states(body, joints, client)
            if touched and torques is not None:
                torques.feel(q_a, qd_a, np.array([state[1] for state in states]), driving)
            for j, joint in enumerate(own):
                angles[j], speeds[j], _, _ = states[joint]
            if torques is not None and torques.followers:
                self._lead_followers(torques)
            self._tick = tick + 1

    def _lead_followers(self, torques: JointTorques) -> None:
        """Puts the joints that follow others where these lead them: what PyBullet's steps leave does not add up."""
        places, rates = torques.angles(self.q_a), torques.rates(self._qd_a)
        for joint in torques.followers:
            pybullet.resetJointState(self.body, joint, places[joint], rates[joint], physicsClientId=self.client)

    def _state(self, noise: Array) -> RobotState:
        """Encoder and current as the controller last read them, the encoder brought to the end of the cycle."""
        q = np.where(self._elastic, self._x[kernel.X_MOTOR], self.q_a)
        if self.world.quantisation:
            increment = self._p[kernel.C_INCREMENT]
            q = np.floor(q / increment + 0.5) * increment
        inside = (q >= self.robot.q_min - STRAYED) & (q <= self.robot.q_max + STRAYED)
        if not inside.all():
            raise self._unstable(int(np.argmin(inside)), q)
        return RobotState(self.t, q, self._x[kernel.X_CURRENT] + self._p[kernel.P_NOISE] * noise)

    def _unstable(self, joint: int | None = None, q: Array | None = None) -> SimError:
        where = "" if joint is None or q is None else (
            f": joint {joint + 1} is at {q[joint]:.4g}, its limits are {self.robot.q_min[joint]:.4g} and "
            f"{self.robot.q_max[joint]:.4g}")
        return SimError("the simulation has diverged: the simulated arm's joint angles are impossible at "
                        f"t = {self.t:.3f} s{where}; the world's numbers make it unstable (check efforts and masses of "
                        "the URDF, stiffness, damping, controller gains and payload)")

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return self._tick * STEP

    @property
    def truth(self) -> TrueState:
        """The true state of the arm now."""
        q_m = np.where(self._elastic, self._x[kernel.X_MOTOR], self.q_a)
        return TrueState(self.t, self.q_a.copy(), q_m, self.tcp)

    @property
    def tcp(self) -> pin.SE3:
        """Pose of the tool frame now."""
        pose = self.tcp_of(self.q_a)
        return pose if self._structure is None else moved(pose, self._structure.off)

    def touch(self, force: Array) -> None:
        """Sets the force on the tool ``(3,)`` [N, base frame] that deflects the structure between base and tool."""
        if self._structure is not None:
            self._structure.touch = np.array(force)

    def tcp_of(self, q_a: Array) -> pin.SE3:
        """Pose of the tool frame at arm angles ``(n,)`` of an arm whose links and base are rigid."""
        pin.framesForwardKinematics(self._model, self._kinematics, np.asarray(q_a, dtype=float))
        return self._kinematics.oMf[self.robot.tool_id].copy()

    def tcp_at(self, t: float) -> pin.SE3:
        """True pose of the tool frame at a time ``t`` [s] within the history; between samples by cubic Hermite splines.

        Raises ``SimError`` where ``t`` lies before the start or in the future.
        """
        return self.tcp_with(t, self.q_at(t))

    def tcp_with(self, t: float, q_a: Array) -> pin.SE3:
        """True pose of the tool frame with the arm angles ``(n,)`` of a time ``t`` [s] within the history."""
        pose = self.tcp_of(q_a)
        return pose if self._structure is None else moved(pose, self._structure.at(t))

    def q_at(self, t: float) -> Array:
        """True arm angles ``(n,)`` [rad] at a time ``t`` [s] within the history, as ``tcp_at``."""
        return self._history.pose(t, self.t, self.q_a, self._qd_a)

    def history(self) -> dict[str, Array]:
        """The true quantities of the arm, every 2 ms or finer.

        Keys: ``t (N,)``, and ``(N, n)`` each ``q_c`` (as ``recording`` has it), ``q`` (encoder), ``tau``
        (measured), ``q_m``, ``q_a``, ``qd_a``, ``qd_m``, ``tau_motor``, ``tau_gear``, ``temperature``.
        """
        return self._history.columns()

    def tcp_path(self) -> tuple[Array, Array]:
        """Times ``(N,)`` [s] of the history and true positions of the TCP ``(N, 3)`` [m]."""
        t, place = new_array(self._history.rows), new_array(self._history.rows, 3)
        for first, logged in self._history.parts():
            t[first : first + len(logged["t"])] = logged["t"]
            for i, (at, q) in enumerate(zip(logged["t"], logged["q_a"], strict=True), start=first):
                place[i] = self.tcp_with(float(at), q).translation
            let_go(t, place)
        return t, place

    def recording(self, external: bool = False) -> Recording:
        """The recording that a controller would have logged, every ``world.log_cycle``.

        Columns: ``t``, ``q_c_i``, ``q_i``, ``tau_i``, ``current_i``, ``temp_i``. ``q_c_i`` is the command after the
        planner's delay and the interpolation, before the controller's own processing (``command_late``,
        ``command_smoothing``, the low-pass). ``external`` adds ``qa_i`` and ``x y z qx qy qz qw`` from an external
        measuring device with the world's noise.
        """
        return recording_of(self.robot, self.world, self._history, self.tcp_with if external else None)

    def close(self) -> None:
        """Ends the physics client; history and recording are kept."""
        if self.client >= 0:
            pybullet.disconnect(self.client)
            self.client = -1

    def __enter__(self) -> SimulatedArm:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.close()
