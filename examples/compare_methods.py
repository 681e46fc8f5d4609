"""``ideal-robot compare``: one path with several methods, as a table, a picture and a data frame."""

import pandas as pd

from scenes import compare_scene, load_scene

# A square edge of a path at walking speed; the model was identified from recordings of the simulated arm.
comparison = compare_scene(load_scene("edge"), methods=["none", "precorrected", "ideal"])
print(comparison)

# The table as the command line shows it.
columns, rows = comparison.table()
table = pd.DataFrame(rows, columns=columns)
print(table.to_string(index=False))

# Figures of each run by name; errors are given against time, after one delay is taken out, and as a distance.
for method, run in comparison.runs.items():
    errors = run.errors
    print(f"{method}: {1e3 * errors.time_matched.E_car:.3f} mm at the time, "
          f"{1e3 * errors.aligned.E_car:.3f} mm aligned")

best = min((method for method in comparison.runs if "_delay" not in method),
           key=lambda method: comparison.runs[method].errors.time_matched.E_car)
print(f"smallest error: {best}")
comparison.plot().savefig("methods.png")
