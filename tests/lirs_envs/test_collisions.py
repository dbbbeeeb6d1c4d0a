"""The deepest contact of a robot and whether its body touches."""

from __future__ import annotations

import numpy as np
import pytest

from lirs_envs.collisions import OWN, WHEEL, compile_contact_state, contact_state

ROLES = np.array((0, OWN | WHEEL, OWN), np.uint8)
"""The ground, a wheel, the body."""


@pytest.mark.parametrize("count", [1, 2, 3])
def test_single_contacts_and_several_wait_for_no_compiler(count: int) -> None:
    compile_contact_state()
    # As MuJoCo has them: every contact is a row of many numbers.
    rows = np.zeros((count, 20))
    rows[:, 0] = -0.001 * np.arange(1, count + 1)
    pairs = np.zeros((count, 10), np.int32)[:, :2]
    pairs[:, 1] = 1
    assert contact_state(rows[:, 0], pairs, ROLES) == (0.001 * count, False)
    pairs[-1] = 2, 0
    assert contact_state(rows[:, 0], pairs, ROLES) == (0.001 * count, True)
    assert len(contact_state.signatures) == 1
