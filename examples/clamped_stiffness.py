"""``ideal-robot stiffness``: joint stiffness of an arm whose flange is clamped, from its motors and a force sensor."""

import ideal_robot as ir
from scenes import load_scene, run_scene

# A simulated arm stands in for the recordings: its flange is clamped, its motors push one joint after the other.
clamped = run_scene(load_scene("clamped_kr500_1"))
print(clamped)

# The same analysis on recordings of your own:
#   ir.analyse_stiffness([ir.Recording.read("clamped.parquet")], ir.Robot.load("my_arm.urdf"))
analysis = clamped.analysis
for joint in analysis.joints:
    low, high = joint.interval
    print(f"joint {joint.joint}, by {joint.method}: {joint.stiffness:.3g} N m/rad, "
          f"95 % between {low:.3g} and {high:.3g}")

# Beside the simulated truth, which recordings of a real arm do not have.
for row in clamped.errors():
    print(f"joint {row['joint']}, {row['method']}: {row['error_percent']:+.1f} %, "
          f"{'within' if row['covered'] else 'outside of'} its interval")
analysis.plot().savefig("stiffness.png")
print(ir.Robot.load("kr500"))
