"""Identifies a model from a DataFrame, here of a simulated arm, and says what the recording could not determine."""

import pandas as pd

import ideal_robot as ir
from scenes import load_scene, run_scene

# A log as any program may hold it: t [s], q_1 … q_6 [rad], tau_1 … tau_6 [N m], and commands q_c_1 …
log = run_scene(load_scene("iso9283_1"), method="none").recording
frame = pd.DataFrame(log.columns)
print(frame[["t", "q_1", "q_c_1", "tau_1"]].describe().loc[["min", "max"]])

result = ir.identify(ir.Recording.from_frame(frame), ir.Robot.load("kr15"))
print(result)

# The parameters that are known best, with their standard deviations.
for p in sorted(result.model.parameters, key=lambda p: p.std_percent)[:5]:
    print(f"{p.name}: {p.value:.4g} ± {p.std:.2g} {p.unit}, {p.meaning}")

# A path was not made for identification: what it leaves open is said, joint by joint.
print("\n".join(result.missing))
result.model.save("kr15_identified.json")
