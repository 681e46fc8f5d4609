"""Conventional identification finds a known truth, says how well it knows it, and reproduces published results."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.dynamics import torques
from ideal_robot.friction import Arctan, CubeRoot, ViscousCoulomb
from ideal_robot.identification.idim import identify
from ideal_robot.identification.joint_fit import regions_of_motion, stiffness_from_arm
from ideal_robot.identification.program import plan_two_step
from ideal_robot.identification.two_step import identify_two_step
from ideal_robot.identification.verdict import JointVerdict, joint_verdicts, told
from ideal_robot.identification.weighted_least_squares import weighted_least_squares
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import Parameter, joined
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.identification.test_excitation import base, logged, motion, record, robot, truth, wrong_by_half
from tests.sources import DATA

EMPS = DATA / "emps" / "emps_estimation.parquet"
UR10E = DATA / "ur10e" / "free_12harm_50s.parquet"


def deviations(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Deviation from the truth in standard deviations, and which base parameters are well excited."""
    rng = np.random.default_rng(seed)
    what = truth()
    result = identify([record(what, rng)], wrong_by_half(rng), friction="viscous_coulomb")
    std = np.sqrt(np.diag(result.model.covariance))[: base().count]
    # Well below one third: otherwise a parameter that is zero would count exactly when it is three σ off.
    good = std < 0.2 * np.abs(result.model.base_values)
    return (result.model.base_values - what.base) / std, good


@pytest.mark.parametrize(("count", "least"), [(3, 0.95 - 1 / 3), pytest.param(50, 0.95, marks=pytest.mark.slow)])
def test_known_truth_from_wrong_start_within_its_own_deviations(count: int, least: float) -> None:
    runs = []
    for z, good in map(deviations, range(count)):
        assert good.sum() >= 15
        runs.append(z[good])
    assert np.mean([np.all(np.abs(z) < 3.0) for z in runs]) >= least
    # Neither too proud nor too humble: σ that are right give 1.
    assert 0.5 < np.sqrt(np.mean(np.concatenate(runs) ** 2)) < 1.3


def test_two_step_method_finds_what_single_axis_moves_show() -> None:
    """On the rigid arm; the simulated one plays the program in ``tests/scenes/identification``."""
    arm, what, rng = robot(), truth(), np.random.default_rng(1)
    q = plan_two_step(arm, rng, points=3, candidates=60).commands(arm.home, 0.004, arm)
    qd = np.gradient(q, 0.004, axis=0)
    moved = logged(what, rng, 0.004 * np.arange(len(q)), (q, qd, np.gradient(qd, 0.004, axis=0)), noise=0.005)
    result, measured = identify_two_step([moved], wrong_by_half(rng))
    gravity = [m for m in measured.measurements if m.quantity == "gravity" and m.joint in (1, 2)]
    assert len(gravity) >= 6
    for m in gravity:
        assert m.value == pytest.approx(float(m.row @ what.base), abs=0.02 * arm.tau_max[m.joint])
    z = (result.model.base_values - what.base) / np.sqrt(np.diag(result.model.covariance))[: base().count]
    assert np.mean(np.abs(z) < 3.0) > 0.9


def test_without_noise_the_truth_is_found() -> None:
    what = truth()
    result = identify([record(what, np.random.default_rng(0), noise=0.0)], robot(), friction="viscous_coulomb")
    exact = result.model.predict(record(what, np.random.default_rng(1), noise=0.0))
    assert np.all(exact.relative_error_percent < 1.0)
    coefficients = result.model.friction.laws[1].coefficients
    np.testing.assert_allclose(coefficients, what.friction.laws[1].coefficients, rtol=0.02)


@pytest.mark.slow
def test_friction_laws_and_refinements_are_found() -> None:
    arm = robot()
    c = [np.array([[0.01 * tau], [0.03 * tau], [0.04 * tau]]) for tau in arm.tau_max]
    laws = [CubeRoot(c[0]), Arctan(c[1], [[8.0]]), Arctan(np.vstack([c[2], [[0.1]]]), [[8.0]], loaded=True),
            ViscousCoulomb(c[3][:2], [[5e-3]], presliding=True), ViscousCoulomb(c[4][:2]), ViscousCoulomb(c[5][:2])]
    what = truth(laws)
    rng = np.random.default_rng(5)
    result = identify([record(what, rng)], arm, validation=[record(what, rng, seed=2)])
    fitted = result.model.friction.laws
    assert fitted[2].loaded
    assert fitted[3].presliding
    assert fitted[3].shape[-1, 0] == pytest.approx(5e-3, rel=0.2)
    plain = identify([record(what, rng)], arm, validation=[record(what, rng, seed=2)], friction="viscous_coulomb")
    errors = [joined(identified.validation).relative_error_percent for identified in (result, plain)]
    assert np.all(errors[0][:4] < errors[1][:4])
    speed = np.linspace(0.05, 1.0, 20)[:, None]
    for j in (0, 1):
        np.testing.assert_allclose(fitted[j].torque(speed), laws[j].torque(speed), rtol=0.08)


@pytest.mark.parametrize("pulled", [(), (3, 5)])
def test_hoses_are_found_on_the_joints_that_they_pull_and_friction_stays_what_it_is(pulled: tuple[int, ...]) -> None:
    """A spring that is not looked for becomes friction that is another one forward and backward."""
    rng, what = np.random.default_rng(3), truth()
    recording = record(what, rng)
    tau, q = recording.joints("tau"), recording.joints("q")
    stiffness = np.array([0.1 * what.friction.laws[j - 1].coefficients[0, 0] / np.std(q[:, j - 1]) * 3.0
                          for j in pulled])
    for j, k in zip(pulled, stiffness, strict=True):
        tau[:, j - 1] += k * q[:, j - 1]
    model = identify([replace(recording, columns={**recording.columns, **{
        f"tau_{j + 1}": tau[:, j] for j in range(6)}})], robot()).model
    springs = {effect.joint: effect for effect in model.effects}
    assert set(springs) == set(pulled)
    for j, k in zip(pulled, stiffness, strict=True):
        assert springs[j].coefficients[0] == pytest.approx(k, abs=3.0 * springs[j].std[0])
        speed = np.linspace(-1.0, 1.0, 20)[:, None] * np.eye(6)[j - 1]
        np.testing.assert_allclose(model.friction.torque(speed)[:, j - 1], what.friction.torque(speed)[:, j - 1],
                                   atol=0.15 * what.friction.laws[j - 1].coefficients[0, 0])


@pytest.mark.parametrize(("factor", "believed"), [(1.2, True), (1e-3, False)])
def test_drive_data_say_what_a_rotor_is_unless_the_motion_contradicts(factor: float, believed: bool) -> None:
    """A table of rotors without their gear ratios is not believed; one that is 20 % off is, where noise hides them."""
    rng, what = np.random.default_rng(2), truth()
    told = replace(robot(), rotor_inertia=factor * robot().rotor_inertia)
    model = identify([record(what, rng)], told).model
    true = robot().rotor_inertia[2:]
    assert np.all(np.abs(model.rotor_inertia[2:] / true - 1.0) < (0.3 if believed else 0.5))


def test_prediction_covers_what_is_measured() -> None:
    what, rng = truth(), np.random.default_rng(9)
    model = identify([record(what, rng)], robot(), friction="viscous_coulomb").model
    p = model.predict(record(what, rng, seed=2))
    inside = np.mean(np.abs(p.measured - p.tau) < 2.0 * p.std, axis=0)
    assert np.all(inside > 0.85)


def test_model_survives_its_file(tmp_path) -> None:  # type: ignore[no-untyped-def]
    what, rng = truth(), np.random.default_rng(3)
    recording = record(what, rng)
    model = identify([recording], robot()).model
    back = Model.load(model.save(tmp_path / "model.json"))
    np.testing.assert_allclose(back.predict(recording).tau, model.predict(recording).tau, atol=1e-6)
    assert [p.name for p in back.parameters] == [p.name for p in model.parameters]
    assert back.provenance["recordings"] == model.provenance["recordings"]


def test_exported_urdf_moves_like_the_consistent_model(tmp_path) -> None:  # type: ignore[no-untyped-def]
    model = identify([record(truth(), np.random.default_rng(3))], robot(), friction="viscous_coulomb").model
    exported = Robot.load(model.export_urdf(tmp_path / "arm.urdf"))
    q = np.random.default_rng(4).normal(size=(20, 6))
    plain = model.dynamics.copy()
    plain.armature = np.zeros(6)
    np.testing.assert_allclose(torques(exported.pinocchio, q, q, q), torques(plain, q, q, q), rtol=1e-6, atol=1e-6)
    for inertia in list(exported.pinocchio.inertias)[1:]:
        assert inertia.mass > 0
        assert np.all(np.linalg.eigvalsh(inertia.inertia) > 0)


@pytest.mark.skipif(not EMPS.exists(), reason="measured data (../shared/data/emps) are not there")
@pytest.mark.parametrize(("law", "published", "error"), [
    ("viscous_coulomb", {"m_1": 95.1089, "Fv_1": 203.5034, "Fc_1": 20.3935, "offset_1": -3.1648}, 4.0834),
    ("asymmetric", {"m_1": 95.1540, "Fv+_1": 166.7061, "Fc+_1": 20.1440, "Fv-_1": 240.4236, "Fc-_1": 20.6277}, 3.1117),
])
def test_published_estimates_of_the_emps_axis(law: str, published: dict[str, float], error: float) -> None:
    axis = Robot.load(DATA / "emps" / "emps.urdf")
    result = identify([Recording.read(EMPS)], axis, friction=law, cutoff=100.0, cutoff_decimation=50.0)
    assert joined(result.estimation).relative_error_percent[0] == pytest.approx(error, rel=1e-3)
    estimates = {p.name: p for p in result.model.parameters}
    for name, value in published.items():
        assert abs(estimates[name].value - value) < estimates[name].std


@pytest.mark.slow
@pytest.mark.skipif(not UR10E.exists(), reason="measured data (../shared/data/ur10e) are not there")
def test_a_real_arm_better_than_plain_least_squares() -> None:
    """The bounds are what a plain fit with Coulomb and viscous friction reaches on the same recordings."""
    arm = Robot.load(DATA / "ur10e" / "ur10e.urdf")
    free50, free30, free20, points = (Recording.read(DATA / "ur10e" / f"{name}.parquet") for name in (
        "free_12harm_50s", "free_12harm_30s", "free_8harm_20s", "ptp_10_points"))
    result = identify([free50, free30], arm, validation=[free20, points])
    assert np.all(result.validation[0].residual_std_percent < [12.1, 5.9, 6.0, 13.4, 20.9, 16.2])
    assert np.all(result.validation[1].residual_std_percent < [23, 9, 5.5, 17, 36, 54])


# What a motion repeats does not make a model that is not quite right any surer.

def line(cycles: int, bend: float, *, regional: bool = True) -> tuple[Array, Array]:
    """Offset and slope, and their covariance, of a line through what is bent, seen along one cycle again and again."""
    rng, phase = np.random.default_rng(3), np.linspace(0.0, 2.0 * np.pi * cycles, 100 * cycles, endpoint=False)
    q, qd = np.sin(phase)[:, None], np.cos(phase)[:, None]
    W = np.stack([np.ones_like(q), q], axis=2)
    y = 1.0 + 2.0 * q + bend * q**3 + 0.01 * rng.normal(size=q.shape)
    regions = regions_of_motion(q, qd) if regional else []
    solution = weighted_least_squares(W, y, np.zeros(2), np.zeros((2, 2)), segments=np.zeros(len(y)), regions=regions)
    return solution.value, solution.covariance


def test_regions_part_the_samples_evenly_and_keep_what_repeats_together() -> None:
    phase = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False) + 0.001
    q, qd = np.column_stack([np.sin(phase), np.sin(2.0 * phase)]), np.column_stack([np.cos(phase), np.cos(2.0 * phase)])
    regions = regions_of_motion(np.tile(q, (5, 1)), np.tile(qd, (5, 1)))
    assert [len(rows) for rows in regions] == [250] * 8
    assert sorted(np.concatenate(regions)) == list(range(2000))
    for rows in regions:
        # All repetitions of a sample are in its region, but for the few at the borders.
        assert len(set(rows % 400)) <= 50 + 8


def test_repeating_a_cycle_tells_no_more_of_a_model_that_is_not_right() -> None:
    few, many = (np.sqrt(np.diag(line(cycles, 0.3)[1])) for cycles in (4, 64))
    assert np.all(many > 0.8 * few)
    plain = np.sqrt(np.diag(line(64, 0.3, regional=False)[1]))
    # The same range passed at an even pace gives another slope, 2 + 3/5 of the bend.
    other = abs(line(64, 0.3)[0][1] - (2.0 + 0.6 * 0.3))
    assert other > 5.0 * plain[1]
    assert other < 3.0 * many[1]


def test_a_model_that_is_right_is_as_sure_as_without_regions() -> None:
    assert np.allclose(line(16, 0.0)[1], line(16, 0.0, regional=False)[1], rtol=0.0, atol=1e-15)


# Stiffness from motor and arm angles: the truth comes back, also from a coarse encoder.

STIFFNESS = np.array([3e5, 3.5e5, 2e5, 3e4, 3e4, 1.2e4])


@pytest.mark.parametrize("step", [0.0, 4e-4])
def test_the_true_stiffness_comes_back(step: float) -> None:
    """Accelerations from increments of 0.4 mrad once made gears ten times as stiff, or rigid."""
    model = replace(Model.nominal(robot()), provenance={"filters": {"cutoff": 6.0}})
    t = np.arange(0.0, 12.0, 0.002)
    qa, qd, qdd = motion().at(t)
    q = qa + model.rigid_body(qa, qd, qdd) / STIFFNESS
    if step:
        q = step * np.round(q / step)
    recording = Recording.from_arrays(t, meta={}, q=q, qa=qa, tau=np.zeros_like(q))
    gears = stiffness_from_arm([recording], model)
    # The last joints hardly twist: increments are all that is left of them.
    twisting = 4 if step else 6
    np.testing.assert_allclose(gears.stiffness[:twisting], STIFFNESS[:twisting], rtol=0.1)
    assert np.all(gears.known_damping >= 0)


def test_a_gear_that_does_not_give_way_is_rigid_and_without_load_none_is_known() -> None:
    model = replace(Model.nominal(robot()), provenance={"filters": {"cutoff": 6.0}})
    t = np.arange(0.0, 12.0, 0.002)
    qa = motion().at(t)[0]
    qa[:, 0] = qa[0, 0]
    load = model.rigid_body(qa, 0.0 * qa, 0.0 * qa)
    moving = Recording.from_arrays(t, q=qa - 1e-9 * load, qa=qa, tau=0.0 * qa)
    still = replace(moving, columns={name: np.full_like(values, values[0]) if name != "t" else values
                                     for name, values in moving.columns.items()})
    gears = stiffness_from_arm([moving], model)
    assert np.isinf(gears.stiffness[1])
    assert gears.known_damping[1] == 0.0
    # A vertical axis carries no weight.
    assert np.isnan(stiffness_from_arm([still], model).stiffness[0])

# Verdicts on identified joints: usable, weak with the motion that would tell, unusable.

def verdicts(recording: Recording, *unseen: Recording) -> tuple[JointVerdict, ...]:
    result = identify([recording], robot(), validation=unseen, friction="viscous_coulomb")
    return joint_verdicts(result.model, result, robot())


def with_tau(recording: Recording, joint: int, tau: np.ndarray) -> Recording:
    return replace(recording, columns={**recording.columns, f"tau_{joint}": tau})


@pytest.fixture(scope="module")
def good() -> Recording:
    return record(truth(), np.random.default_rng(0), rate=100.0)


def test_a_motion_that_excites_gives_usable_joints(good: Recording) -> None:
    joints = verdicts(good)
    assert [joint.verdict for joint in joints] == 6 * ["usable"]
    assert not any(joint.reason or joint.would_tell for joint in joints)


def test_torque_of_other_causes_makes_a_joint_weak_then_unusable(good: Recording) -> None:
    spread, wave = np.std(good.columns["tau_6"]), np.sin(5.0 * good.t) + np.sin(7.3 * good.t)
    weak, unusable = (verdicts(with_tau(good, 6, good.columns["tau_6"] + share * spread * wave)) for share in (0.5, 3))
    assert [joint.verdict for joint in weak[:3]] == 3 * ["usable"]
    assert (weak[5].verdict, unusable[5].verdict) == ("weak", "unusable")
    assert "diagnose" in weak[5].reason


def test_what_only_the_validation_leaves_asks_for_its_motion(good: Recording) -> None:
    other = record(truth(), np.random.default_rng(1), rate=100.0, seed=2)
    shifted = with_tau(other, 6, other.columns["tau_6"] * 2.0)
    joint = verdicts(good, shifted)[5]
    assert joint.verdict != "usable"
    assert "the validation's motion" in joint.would_tell


def test_a_joint_that_stands_still_or_is_not_measured_is_unusable(good: Recording) -> None:
    joint = verdicts(replace(good, columns={**good.columns, "q_6": np.full(len(good.t), 0.3)}))[5]
    assert (joint.verdict, joint.reason) == ("unusable", "it does not move")
    assert "joint 6" in joint.would_tell
    dead = np.where(np.random.default_rng(4).random(len(good.t)) < 0.8, 0.0, good.columns["tau_6"])
    joint = verdicts(with_tau(good, 6, dead))[5]
    assert (joint.verdict, joint.would_tell) == ("unusable", "")


def test_three_seconds_of_motion_say_which_motion_would_tell_more() -> None:
    noisy = record(truth(), np.random.default_rng(1), noise=0.02)
    here = (noisy.t >= 6.0) & (noisy.t < 9.25)
    joints = verdicts(replace(noisy, columns={name: values[here] for name, values in noisy.columns.items()}))
    asking = [joint for joint in joints if "beyond the recorded postures" in joint.reason]
    assert asking
    assert all(joint.verdict == "weak" and f"joint {joint.joint}" in joint.would_tell for joint in asking)


def test_parameters_within_two_deviations_of_zero_are_not_told() -> None:
    named = Parameter("Fc_1", 1, 2.0, 0.5, "N m", "friction")
    assert told(named)
    assert not told(replace(named, std=1.5))
    assert not told(replace(named, value=0.0, std=0.0))
