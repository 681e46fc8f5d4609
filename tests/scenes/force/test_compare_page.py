"""The page of a comparison shows each method's force where no other one covers it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from scenes.force.page import forces_figure


def test_each_method_has_a_panel_with_its_error_on_one_scale() -> None:
    t = np.linspace(0.0, 6.0, 200)
    results = [SimpleNamespace(method=method, history={"t": t, "normal": 20.0 + size * np.sin(9.0 * t)},
                               figures=SimpleNamespace(rms=size / np.sqrt(2.0)))
               for method, size in (("direct_feedback", 6.0), ("ideal", 1.0), ("adapted", 1.0))]
    figure = forces_figure(SimpleNamespace(results=results, scene=SimpleNamespace(force=20.0)))  # type: ignore[arg-type]
    titles = [axis.get_title(loc="left") for axis in figure.axes]
    assert titles == ["direct_feedback: 4.24 N RMS", "ideal: 0.71 N RMS", "adapted: 0.71 N RMS"]
    assert len({axis.get_ylim() for axis in figure.axes}) == 1
    assert figure.axes[0].get_ylim()[1] < 30.0
