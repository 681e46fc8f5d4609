"""What is wanted of a contact: the stiffer it is, the gentler the travel begins."""

from __future__ import annotations

import numpy as np

from planning.force.contact import BEGUN, FORCE_ERRORS, GENTLEST, SLOPE, STAMPS, UNSEEN, ContactSettings


def test_a_slope_that_was_not_felt_yet_costs_no_more_force_on_a_stiff_contact() -> None:
    """From rest with constant jerk: way j t³/6, times slope and stiffness; full acceleration costs 11 N at 50 N/mm."""
    for stiffness in (1e4, 2e4, 3e4, 5e4):
        way = ContactSettings(elasticity=stiffness).jerk(0.3, 40.0) * UNSEEN**3 / 6.0
        assert way * SLOPE * stiffness < BEGUN * (1 + 1e-9)


def test_a_soft_contact_begins_as_it_is_told() -> None:
    assert ContactSettings(elasticity=4e3).jerk(0.3, 40.0) == 40.0


def test_no_contact_is_so_stiff_that_the_travel_does_not_begin() -> None:
    np.testing.assert_equal(ContactSettings(elasticity=1e9).jerk(0.3, 40.0), GENTLEST)


def test_the_stiffer_a_tip_the_less_its_damping_delays_the_force() -> None:
    """A tip of 8 N s/m at 50 N/mm is 0.16 ms late; left free within 2 ms, the estimate wandered by 2 ms."""
    soft, stiff = (ContactSettings(elasticity=k).lateness for k in (4e3, 5e4))
    assert soft == FORCE_ERRORS[1]
    assert STAMPS < stiff < 0.6e-3
