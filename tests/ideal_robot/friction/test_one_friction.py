"""One friction: whoever asks for it along the same motion gets the same torque, to the last bit."""

from __future__ import annotations

import ast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ideal_robot.arrays import Array
from ideal_robot.feedforward.inverse import Inverse
from ideal_robot.friction.laws import LAWS, FrictionModel, PerJointFriction, ViscousCoulomb, law_of
from ideal_robot.friction.presliding import (
    dahl,
    friction_torque,
    measured_steps,
    slid,
    sliding_direction,
)
from ideal_robot.friction.table import (
    BACKWARD,
    DRY,
    FLUID,
    FORWARD,
    Friction,
    Presliding,
    friction_along,
    friction_sizes,
    friction_step,
    largest_speeds,
)
from ideal_robot.friction.terms import TERMS, friction_terms, table_terms, with_terms
from ideal_robot.tolerances import ZERO_CROSSING
from tests.arms import ROBOT, a_friction, motion, plant
from tests.sources import ROOT

DISTANCE = 3e-4
SEEDS = st.integers(0, 2**32 - 1)


def a_law(key: str, rng: np.random.Generator, *, presliding: bool = True, loaded: bool = True) -> FrictionModel:
    """A law of one joint with random coefficients, all of which brake."""
    kind = law_of(key)
    rows = len(kind.coefficient_names) + loaded
    coefficients = rng.uniform(0.5, 30.0, rows)
    if loaded:
        coefficients[-1] = rng.uniform(0.0, 0.1)
    shape = [np.sqrt(low * high) for low, high in kind.shape_bounds] + [DISTANCE] * presliding
    return kind(coefficients[:, None], np.array(shape)[:, None], presliding=presliding, loaded=loaded)


def a_motion(friction: Friction, rng: np.random.Generator, count: int = 60) -> tuple[Array, Array, Array, Array]:
    """Velocities at speeds of the table, loads and steps ``(count, n)``: either way, with reversals and rests.

    A step is several times as long as the band within which measured positions may be noisy, or none; positions are the
    sum of the steps. The velocity at a rest is zero.
    """
    n = len(friction.speeds)
    knots = rng.integers(1, friction.speeds.shape[1], (count, n))
    sense = rng.choice([-1.0, 0.0, 1.0], (count, n), p=(0.4, 0.2, 0.4))
    v = np.take_along_axis(friction.speeds.T, knots, axis=0) * sense
    steps = np.sign(v) * DISTANCE * rng.uniform(0.3, 4.0, (count, n))
    return v, rng.uniform(-300.0, 300.0, (count, n)), steps, np.cumsum(steps, axis=0)


@given(SEEDS, st.sampled_from(sorted(LAWS.names())))
@settings(max_examples=25)
def test_table_and_steps_are_the_identified_law_to_the_last_bit(seed: int, key: str) -> None:
    """At speeds of the table, where nothing lies in between; the law takes its steps from positions."""
    rng = np.random.default_rng(seed)
    law = a_law(key, rng)
    friction = Friction.of(PerJointFriction([law]), np.array([3.0]))
    v, load, _, q = a_motion(friction, rng)
    # Noise leaves the band of a twentieth of the distance; what is left of a step is the law's.
    steps = measured_steps(q, np.array([DISTANCE]))
    v[0] = 0.0
    torque, states = friction_along(friction, v, load, steps, Presliding.none(1))
    np.testing.assert_array_equal(law.torque(v, load, q), torque)
    state = 0.0
    for k in range(len(v)):
        one, state = friction_step(friction, 0, v[k, 0], load[k, 0], state, steps[k, 0])
        assert (one, state) == (torque[k, 0], states.force[k, 0])


@given(SEEDS, st.sampled_from(sorted(LAWS.names())))
@settings(max_examples=25)
def test_the_regressor_is_the_torque(seed: int, key: str) -> None:
    """Coefficients times columns, along measured positions."""
    rng = np.random.default_rng(seed)
    law = a_law(key, rng)
    v, load, _, q = a_motion(Friction.of(PerJointFriction([law]), np.array([3.0])), rng)
    columns = law.regressor(v, load, q)[:, 0]
    np.testing.assert_allclose(columns @ law.coefficients[:, 0], law.torque(v, load, q)[:, 0], rtol=1e-9, atol=1e-9)


@given(SEEDS)
@settings(max_examples=25)
def test_adapted_friction_is_the_columns_times_their_values(seed: int) -> None:
    """What friction's terms add to the torque along a motion is their columns' sum, as long as nothing would drive."""
    rng = np.random.default_rng(seed)
    loop = plant()
    friction = loop.friction._replace(per_load=np.tile([0.03, 0.01], (loop.n, 1)))
    values = 0.05 * rng.standard_normal((loop.n, TERMS))
    changed = with_terms(friction, table_terms(loop.friction, loop.path.v_max), values)
    v, load, _, _ = a_motion(friction, rng, 5)
    for i in range(loop.n):
        share, dry = v[:, i] / largest_speeds(loop.path.v_max)[i], loop.friction.dry[i]
        # In gross sliding: what of a term falls with speed turns round as dry friction does.
        z = np.sign(v[:, i])
        columns = dry * friction_terms(share, z)
        expected = columns @ values[i]
        for k in range(len(v)):
            before, after = (friction_sizes(one, i, v[k, i], load[k, i]) for one in (friction, changed))
            by_load = before[0] - friction_sizes(friction, i, v[k, i], 0.0)[0]
            added = z[k] * (after[0] - before[0]) + np.sign(v[k, i]) * (after[1] - before[1])
            assert added == pytest.approx(expected[k] + z[k] * values[i, 0] * by_load, rel=1e-9, abs=1e-9)


def test_the_inverse_plans_with_the_same_steps() -> None:
    """State after a cycle: the one function along the motors' planned motion of that cycle."""
    loop, q_d = plant(), motion()
    inverse = Inverse(loop)
    state = inverse.init(q_d[0])
    forces = []
    for k in range(80):
        _, state = inverse.step(state, q_d[k : k + 30])
        forces.append((state.presliding.force, state.presliding.direction, state.v_m))
    for force, direction, v in forces[60:]:
        for i in range(loop.n):
            # The plant's dry friction is the same at all speeds and loads: the state is it, times the direction.
            dry = friction_sizes(loop.friction, i, v[i], 0.0)[0]
            assert abs(direction[i]) <= 1.0
            assert force[i] == pytest.approx(dry * direction[i], rel=1e-9)


# What the equations say.

def reversal(friction: Friction) -> Array:
    """Friction torques of a motion over 40 mrad forward and 4 mrad back, every 10 µrad, without load ``(N, n)``."""
    v = np.concatenate([np.full(4000, 0.1), np.full(400, -0.1)])[:, None] * np.ones(len(friction.speeds))
    return friction_along(friction, v, np.zeros_like(v), 1e-4 * v, Presliding.none(v.shape[1]))[0]


@pytest.mark.parametrize("key", LAWS.names())
def test_dry_friction_turns_over_the_distance_and_what_rises_with_speed_acts_at_once(key: str) -> None:
    law = a_law(key, np.random.default_rng(1), loaded=False)
    friction = Friction.of(PerJointFriction([law]), np.array([3.0]))
    v = np.concatenate([np.full(4000, 0.1), np.full(400, -0.1)])[:, None]
    dry, fluid = law.sizes(v)
    forward, back = dry[0, 0], dry[-1, 0]
    torque = reversal(friction)[:, 0]
    assert torque[3999] == pytest.approx(forward + fluid[0, 0], rel=1e-3)
    assert torque[4000] == pytest.approx(forward - fluid[-1, 0], rel=0.1)
    assert torque[-1] == pytest.approx(-back - fluid[-1, 0], rel=1e-3)
    # After one distance 1/e of the way is left, where dry friction is that of standstill.
    if key not in ("stribeck", "bell_stribeck", "asymmetric"):
        at = 4000 + round(DISTANCE / 1e-5)
        expected = (forward + back) * np.exp(-1.0) - back - fluid[-1, 0]
        assert torque[at - 1] == pytest.approx(expected, rel=0.02, abs=0.02)


def test_the_state_stays_until_the_joint_has_moved() -> None:
    """The level of dry friction jumps, under load, without a motion: the force follows over the presliding distance."""
    flat = np.full((1, 2), 30.0)
    friction = a_friction(np.array([[0.0, 1.0]]), flat, 0.0 * flat, 1e-3)._replace(per_load=np.array([[0.5, 0.0]]))
    v, load = np.full((4000, 1), 0.1), np.zeros((4000, 1))
    load[2000:] = 40.0
    torque = friction_along(friction, v, load, 1e-4 * v, Presliding.none(1))[0][:, 0]
    assert torque[1999] == pytest.approx(30.0)
    assert torque[2000] == pytest.approx(30.0, rel=0.01)
    assert torque[-1] == pytest.approx(50.0, rel=1e-4)


@pytest.mark.parametrize("dry", [1e-3, 30.0, 70.0])
def test_friction_turns_over_the_same_distance_whatever_its_size_is(dry: float) -> None:
    """After a reversal dF/dq = D/d (1 - F sign(v) / D): twice the slope that it begins with at rest."""
    distance = 1e-3
    flat = np.full((1, 2), dry)
    friction = a_friction(np.array([[0.0, 1.0]]), flat, 0.0 * flat, distance)
    torque = reversal(friction)[:, 0]
    assert torque[3999] == pytest.approx(dry)
    assert torque[4000] - torque[3999] == pytest.approx(-2.0 * dry / distance * 1e-5, rel=0.02)


@given(SEEDS)
@settings(max_examples=25)
def test_friction_is_the_sum_of_its_parts(seed: int) -> None:
    """Each part of dry friction with a state of its own: why a law stays linear in its coefficients."""
    rng = np.random.default_rng(seed)
    friction = Friction.of(PerJointFriction([a_law("stribeck", rng)]), np.array([3.0]))
    v, load, steps, _ = a_motion(friction, rng)
    share = rng.uniform(0.0, 1.0, (1, 1, friction.speeds.shape[1], 2))
    parts = [friction._replace(sizes=friction.sizes * s, per_load=p * friction.per_load)
             for s, p in ((share, 0.3), (1.0 - share, 0.7))]
    whole, *own = (friction_along(one, v, load, steps, Presliding.none(1))[0] for one in (friction, *parts))
    np.testing.assert_allclose(sum(own), whole, rtol=1e-12, atol=1e-12)


def test_without_presliding_friction_jumps_and_passes_through_zero_at_rest() -> None:
    for v, share in ((2.0 * ZERO_CROSSING, 1.0), (0.5 * ZERO_CROSSING, 0.5), (0.0, 0.0), (-ZERO_CROSSING, -1.0)):
        torque, force = friction_torque(30.0, 0.0, v, 17.0, 0.0, 0.0)
        assert torque == force == pytest.approx(30.0 * share)


@given(SEEDS)
@settings(max_examples=50)
def test_between_the_speeds_of_a_table_it_is_linear_and_beyond_constant(seed: int) -> None:
    rng = np.random.default_rng(seed)
    speeds = np.concatenate([[0.0], np.sort(rng.uniform(0.0, 3.0, 39))])[None]
    sizes = rng.uniform(0.0, 1.0, (1, 2, 40, 2))
    friction = Friction(speeds, sizes, np.array([[0.1, 0.05]]), np.ones(1))
    for speed in (0.0, *speeds[0, 1:3], *rng.uniform(0.0, 4.0, 20)):
        for side, v, load in ((FORWARD, speed, -2.0), (BACKWARD, -max(speed, 1e-9), -2.0)):
            dry, fluid = friction_sizes(friction, 0, v, load)
            table = [np.interp(abs(v), speeds[0], sizes[0, side, :, part]) for part in (DRY, FLUID)]
            # The motor drives the load where load and velocity have one sign.
            per_load = 0.15 if load * v > 0.0 else 0.1
            assert (dry, fluid) == pytest.approx((table[0] + per_load * 2.0, table[1]))


def test_exact_positions_and_measured_ones_walk_alike() -> None:
    """The band of measured positions lags by its half width on either side: at a reversal by twice its share."""
    q = 0.002 * np.sin(np.linspace(0.0, 12.0, 4000))[:, None]
    exact, measured = dahl(q[:, 0], DISTANCE), sliding_direction(q, np.zeros((1, 1)), np.array([DISTANCE]))[:, 0]
    assert np.max(np.abs(exact - measured)) < 0.2
    direction, one_by_one = np.zeros(1), []
    for step in np.diff(q, axis=0, prepend=q[:1]):
        direction = slid(direction, step, np.array([DISTANCE]))
        one_by_one.append(direction[0])
    np.testing.assert_array_equal(one_by_one, exact)
    # Without presliding the direction is that of the step.
    np.testing.assert_array_equal(slid(np.zeros(2), np.array([1e-7, -1e-7]), np.zeros(2)), [1.0, -1.0])
    rng = np.random.default_rng(2)
    still = sliding_direction(1e-6 * rng.standard_normal((500, 1)), np.zeros((1, 1)), np.array([DISTANCE]))
    assert not still.any()


def test_a_law_that_would_drive_is_no_friction_in_the_table() -> None:
    law = ViscousCoulomb(np.array([[5.0], [-3.0]]))
    friction = Friction.of(PerJointFriction([law]), np.array([2.0]))
    assert np.all(friction.sizes[..., DRY] == 0.0)
    assert np.all(friction.sliding >= 0.0)
    assert friction.speeds[0, -1] == pytest.approx(2.4)
    assert len(ROBOT.v_max) == 6


def test_the_equation_has_one_caller():
    """What composes table, load and presliding is ``friction.table``; nothing else takes the equation apart."""
    primitives = {"friction_torque", "presliding_state"}
    texts = {path: path.read_text(encoding="utf-8") for folder in ("ideal_robot", "planning", "sensing", "scenes")
             for path in (ROOT / folder).rglob("*.py")}
    callers = {path.stem for path, text in texts.items() if any(name in text for name in primitives)
               for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)
               and primitives & {alias.name for alias in node.names}}
    assert callers == {"table"}
