"""Numerical tolerances: numbers that follow from arithmetic, or are fine enough. Half or twice of one changes nothing.

Most were halved and doubled while lines, forces and known paths were played and arms identified: no figure changed by
10 %. A number that decides what an arm does, or what counts as known, is none of these: it stands where it is used,
with its reason.
"""

# Rounding.

ROUNDING = 1e-9
"""Relative difference of positions, speeds and poses, or for those below one absolute [rad, m], that is arithmetic's.
Double precision has 2e-16, which chains of joints and sums over a path multiply by thousands."""
UNRESOLVED = 1e-7
"""Difference of commands and positions that no encoder resolves [rad, m]: one of 24 bits has 4e-7 rad."""
DEPENDENT = 1e-8
"""Size of a column over the largest from which on it counts as independent: half of the digits of double precision."""
REVERSING = 1e-6
"""Speed over the one below which a joint counts as reversing, that is the rounding of a joint at rest."""
ZERO_CROSSING = 1e-4
"""Velocity within which friction that jumps passes through zero [rad/s]: rounding would switch it back and forth."""
CREEP = 1e-300
"""Speed at which friction is that of standstill in the direction of the speed [rad/s]: not zero, and nothing else."""

# Equations that are solved.

DAMPING = 1e-6
"""Damping of the least-squares inverse at a pose from which six joints cannot move in all directions."""
SLIGHT = 1e-10
"""Damping of that of more than six joints: of what is wished besides it lets this share of the pose's error stand."""
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

# How finely what is continuous is looked at.

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
SUBSTEP = 0.0005
"""Time step of a model of gears; far below the period of the stiffest gear of an industrial arm [s]."""
LONGEST_PATH = 7200.0
"""Time that a path may last [s]: what is longer was given in another unit."""
