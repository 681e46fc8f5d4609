"""Identifies a model from a DataFrame, here of a simulated arm, and says what the recording could not tell."""

import pandas as pd

import ideal_robot as ir
from scenes import load_scene, run_scene

frame = pd.DataFrame(run_scene(load_scene("iso9283_1"), method="none").recording.columns)
result = ir.identify(ir.Recording.from_frame(frame), ir.Robot.load("kr15"))
print(result)
print("\n".join(result.missing))
result.model.save("kr15_identified.json")
