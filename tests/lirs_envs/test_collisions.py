"""The deepest contact of a robot and whether its body touches."""

import numpy as np
import pytest

from lirs_envs.collisions import compile_contact_state, contact_state

DROPS = np.array((-np.inf, 0.8, np.inf))
"""The ground, a wheel of 1 m, the body."""
CENTERS = np.array(((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_single_contacts_and_several_wait_for_no_compiler(count: int) -> None:
    compile_contact_state()
    # As MuJoCo has them: every contact is a row of many numbers.
    rows = np.zeros((count, 20))
    rows[:, 0] = -0.001 * np.arange(1, count + 1)
    pairs = np.zeros((count, 10), np.int32)[:, :2]
    pairs[:, 1] = 1
    state = rows[:, 0], pairs, rows[:, 1:4], CENTERS, DROPS
    assert contact_state(*state) == (0.001 * count, False)
    pairs[-1] = 2, 0
    assert contact_state(*state) == (0.001 * count, True)
    assert len(contact_state.signatures) == 1


@pytest.mark.parametrize(("height", "collides"), [(0.0, False), (0.19, False), (0.21, True), (1.0, True)])
def test_a_wheel_collides_with_what_it_meets_high(height: float, collides: bool) -> None:
    pairs, points = np.array(((1, 0),), np.int32), np.array(((0.9, 0.0, height),))
    assert contact_state(np.zeros(1), pairs, points, CENTERS, DROPS) == (0.0, collides)
