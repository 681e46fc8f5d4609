"""Where the path is: reference paths, fusion of sensed deviations, and the desired joint path over a horizon."""
