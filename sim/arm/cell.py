"""Effects of an arm in a production cell beyond the default world, with sizes in proportion to the arm.

The sizes are those of machines in good order; a worn one has larger ones. Sizes without a source are assumed.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.joints import mass_matrix
from ideal_robot.robots.robot import Robot
from sim.arm.drive import top_of

WAVE_GEAR = 1.0e5
"""Stiffness below which a gear is a strain-wave one, of wrists; above it is of the RV class [N m/rad]."""
ONCE, TWICE, TOOTH = (8.0e-5, 7.0e-5), (4.0e-5, 4.5e-5), (4.0e-5, 3.0e-5)
"""Amplitudes of the transmission error of an RV and of a strain-wave gear [rad]. From peak to peak they come to 0.32
and 0.29 mrad: Harmonic Drive's catalogue (CSF/CSG, table of positional accuracy over one turn of the output) has
2.9e-4 rad (1') for ratios from 50 on, and RV gears of that size are sold as 1' or better."""
PINS, LOBES = 40.0, 2.0
"""Periods of the last per turn: of an RV gear per joint turn, its pins; of a strain-wave gear per motor turn, the lobes
of its wave generator."""
HYSTERESIS = (1.5e-4, 2.0e-4)
"""Width of the loop of an RV and of a strain-wave gear [rad]: half of the 1' of lost motion or hysteresis loss that
both are sold with at most."""
BACKLASH = (1.0e-4, 0.0)
"""Of an RV gear, 20", a third of what it is sold with at most; a strain-wave gear has none [rad]."""
BENDING = 0.3
"""Compliance of bearing and link across a joint over the gear's: catalogues give main bearings three to five times the
stiffness of their gear, and the cast link comes in series. The tool then sinks by a third more than its gears."""
COLUMN = 30.0
"""Stiffness of the column over that of gear 1: about 1e7 N m/rad for arms of 6 to 15 kg, a welded box of 0.3 m on
anchors."""
COLUMN_FREQUENCY, COLUMN_DAMPING = 20.0, 0.03
"""Of arm, column and floor [Hz, relative to critical]: above the arm's own, as mountings should be."""
EXPANSION = 1.2e-5
"""Growth of a link per kelvin of its gear [1/K]: aluminium's 2.3e-5, of a link that is half as warm on average. Ten
kelvins over a reach of a metre are 0.12 mm: the drift of pose repeatability that makers state as 0.05 to 0.1 mm."""
HOSE, HOSE_FRICTION = 0.3, 0.15
"""Spring of a dress pack per radian, and its friction, over the dry friction of its joint; from joint 3 on."""
LARGE, BALANCED = 4000.0, 0.7
"""Weight on joint 2 from which arms have a balancer [N m], and the share that it carries: arms above some 100 kg of
payload have one ([J] section 2, KR 500)."""
COMPENSATED = 0.5
"""Share of dry friction that drives compensate: more, and a warm arm would overshoot."""
SCHEDULED = 0.5
"""Share in which gains follow the posture's inertia."""
COLD = 20.0
"""Temperature at the start and around [°C]: the arm has stood over night."""


def in_a_cell(robot: Robot, world: dict[str, Array], t_velocity: float) -> dict[str, Any]:
    """Keys of ``World`` by which an arm in a cell differs from the default one.

    Args:
        robot: the data sheet.
        world: of the default world ``stiffness``, ``coulomb`` and ``extra_rotor_inertia``, ``(n,)`` each.
        t_velocity: cycle of the velocity loop [s].
    """
    stiffness, n = world["stiffness"], robot.n
    kind = np.where(stiffness < WAVE_GEAR, 1, 0)
    elastic, behind = np.isfinite(stiffness), np.arange(n) >= 2
    turns = np.where(robot.gear_ratio > 1.0, robot.gear_ratio, 100.0)
    sizes = {
        "transmission_once": np.array(ONCE)[kind], "transmission_twice": np.array(TWICE)[kind],
        "transmission_error": np.array(TOOTH)[kind], "transmission_order": np.where(kind == 1, LOBES * turns, PINS),
        "hysteresis": np.array(HYSTERESIS)[kind], "backlash": np.array(BACKLASH)[kind],
        "link_bending": np.where(elastic, BENDING, 0.0),
        "hose": np.where(behind, HOSE * world["coulomb"], 0.0),
        "hose_friction": np.where(behind, HOSE_FRICTION * world["coulomb"], 0.0),
        "friction_compensation": np.full(n, COMPENSATED),
        "notch_frequency": _resonance(robot, stiffness, robot.rotor_inertia + world["extra_rotor_inertia"], t_velocity),
    }
    # A prismatic joint has no angular errors: its errors would be lengths.
    for name in ("transmission_once", "transmission_twice", "transmission_error", "hysteresis", "backlash"):
        sizes[name] = np.where(robot.prismatic, 0.0, sizes[name])
    base = stiffness[0] if np.isfinite(stiffness[0]) else np.inf
    return {name: tuple(float(value) for value in values) for name, values in sizes.items()} | {
        "column_stiffness": float(COLUMN * base), "column_frequency": COLUMN_FREQUENCY,
        "column_damping": COLUMN_DAMPING, "thermal_expansion": EXPANSION, "gain_schedule": SCHEDULED,
        "balancer": _balanced(robot), "start_temperature": COLD, "ambient_temperature": COLD,
    }


def _balanced(robot: Robot) -> float:
    """Torque of the balancer [N m]: none where the arm is small, or its second joint carries no weight."""
    try:
        top = top_of(robot)
    except InputError:
        return 0.0
    q = np.array(robot.home, dtype=float)
    q[1] = top + 0.5 * math.pi
    weight = abs(float(pin.computeGeneralizedGravity(robot.pinocchio, robot.pinocchio.createData(), q)[1]))
    return BALANCED * weight if weight > LARGE else 0.0


def _resonance(robot: Robot, stiffness: Array, rotor: Array, t_velocity: float) -> Array:
    """Frequency ``(n,)`` [Hz] of each rotor on its gear against its link at home; 0 where the loop cannot see it."""
    link = mass_matrix(robot.pinocchio, robot.pinocchio.createData(), np.array(robot.home, dtype=float)).diagonal()
    with np.errstate(divide="ignore", invalid="ignore"):
        frequency = np.sqrt(stiffness * (1.0 / rotor + 1.0 / link)) / (2.0 * math.pi)
    seen = np.isfinite(frequency) & (frequency * t_velocity < 0.2)
    return np.where(seen, frequency, 0.0)
