"""Numerical tolerances: results do not change if one of them is halved or doubled.

Most were halved and doubled in runs of lines, forces and known paths and in identifications: no figure changed by 10 %.
A number that decides about an arm's behaviour is not one of them; it is defined where it is used, with its reason.
"""

# Rounding errors.

ROUNDING = 1e-9
"""Relative difference of positions, speeds and poses, or for those below one absolute [rad, m], that is arithmetic's.
Double precision has 2e-16, which chains of joints and sums over a path multiply by thousands."""
PRODUCTS = 1e-12
"""Share of a column's squares that is rounding of double precision's products, in sums over some thousand rows."""
UNRESOLVED = 1e-7
"""Difference of commands and positions that no encoder resolves [rad, m]: one of 24 bits has 4e-7 rad."""
DEPENDENT = 1e-8
"""Size of a column over the largest from which on it counts as independent: half of the digits of double precision."""
WRITTEN = 1e-6
"""To which numbers of a file are right that people write, relative to one and their size: six digits."""
REVERSING = 1e-6
"""Speed over the one below which a joint counts as reversing, that is the rounding of a joint at rest."""
ZERO_CROSSING = 1e-4
"""Velocity within which friction that jumps passes through zero [rad/s]: rounding would switch it back and forth."""
CREEP = 1e-300
"""Speed at which friction is that of standstill in the direction of the speed [rad/s]: not zero, and nothing else."""

# Tolerances of equation solvers.

SLIGHT = 1e-10
"""Variance of what inverse kinematics may leave of a place [m²]: no step of Newton's method changes by it, and postures
from which an arm cannot move in all directions have one."""
DAMPING = 1e-6
"""The same near such a posture, where the tool may miss by micrometres rather than a joint run away."""
SETTLED = 1e-6
"""What may be left to change of more than six joints' posture [rad], and of fewer joints' place [m]."""
NEWTON_STEPS = 10
"""Newton steps in which a nearly right solution has to become right; each doubles the digits, so half of them do."""
HALVINGS = 20
"""Halvings of an interval: a millionth of it is left."""
HALF_TURN = -0.9
"""Cosine of a rotation beyond which its axis is taken from the symmetric part: the other one fades at half a turn."""
NOMINAL_WEIGHT = 1e-4
"""Weight of staying near nominal inertias: it decides only what the base parameters leave open."""
LEAST_EIGENVALUE = 1e-3
"""Of a pseudo-inertia, over that of the mean of the nominal link: bodies that can be do not lie on the edge."""
BRAKING_CYCLES = 2000
"""Cycles in which a braking motion has to end: arms need a tenth of them."""

# Resolution of continuous quantities.

PATH_SPACING = 0.002
"""Between points of a path at which its curvature is kept and its limits are looked at [m]."""
TICK = 0.001
"""Between samples of a profile of speed [s]."""
MOST_TICKS = 600_000
"""Samples of a profile at most, ten minutes; of a longer travel they are further apart."""
TRAIL_SPACING = 1e-4
"""Between places of the trail along which an arm goes back [rad, m]: a tenth of a millimetre a metre away."""
TRAIL_LENGTH = 40_000
"""Places of that trail: four radians of the quickest joint."""
FINEST = 64
"""Places into which a cycle of a path is divided at most."""
ROWS_BEFORE = 6
"""Desired positions before an instant from which its derivatives are taken."""
ROWS_AFTER = 4
"""The same behind it."""
COMMANDS_TOGETHER = 7
"""Commands solved for together: what lies further ahead changes the first one by less than 1e-4 of itself."""
CORRECTION_STEPS = 2
"""Newton steps from a drawn arm to the one that it is: of an error of millimetres nanometres are left."""
CORRECTION_SPACING = 0.06
"""Between rows of a horizon at which that correction is solved for, which turns slowly [s]."""
MEASURED_SPACING = 0.012
"""Between measurements that adaptation looks at, at least [s]: a shorter cycle tells no more of friction."""
SMALLEST_GAIN = 0.2
"""Of a learning step: where an eighth of the full one still makes a path worse, learning ends."""
SLOWINGS = 30
"""Times that a path is slowed where it leaves a limit; each takes all of what is too much off."""
SLOWED_BESIDES = 1.02
"""What is taken off over that, since the rate of slowing adds speed of its own."""
SLOWEST_RATE = 1e-3
"""Share of its speed with which a path that is slowed goes on at least, so that it ends."""
PRESLIDING_BAND = 0.05
"""Half width of the band within which a measured position may be noisy, in presliding distances."""
MOVED_BEFORE = 0.1
"""How long a motion is taken to have lasted before its first sample [s]."""
CLOCKS_APART = 10.0
"""Offset between two clocks that is looked for [s]."""
SAME_POINT = 1e-4
"""Difference of two positions that one point given twice may have [rad or m]: text of four decimals."""
SUBSTEP = 0.0005
"""Time step of a model of gears; far below the period of the stiffest gear of an industrial arm [s]."""
LONGEST_PATH = 7200.0
"""Time that a path may last [s]: what is longer was given in another unit."""
