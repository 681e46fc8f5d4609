"""Stiffness from motor and arm angles: the truth comes back, also from a coarse encoder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.identification.stiffness_from_arm import stiffness_from_arm
from ideal_robot.model.model import Model
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.identification.arm import motion, robot

STIFFNESS = np.array([3e5, 3.5e5, 2e5, 3e4, 3e4, 1.2e4])


@pytest.mark.parametrize("step", [0.0, 4e-4])
def test_the_true_stiffness_comes_back(step: float) -> None:
    """Accelerations from increments of 0.4 mrad once made gears ten times as stiff, or rigid."""
    model = replace(Model.nominal(robot()), provenance={"filters": {"cutoff": 6.0}})
    t = np.arange(0.0, 12.0, 0.002)
    qa, qd, qdd = motion().at(t)
    q = qa + model.rigid_body(qa, qd, qdd) / STIFFNESS
    if step:
        q = step * np.round(q / step)
    recording = Recording.from_arrays(t, meta={}, q=q, qa=qa, tau=np.zeros_like(q))
    k, d = stiffness_from_arm([recording], model)
    # The last joints hardly twist: increments are all that is left of them.
    seen = 4 if step else 6
    np.testing.assert_allclose(k[:seen], STIFFNESS[:seen], rtol=0.1)
    assert np.all(d >= 0)
