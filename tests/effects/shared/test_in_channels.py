"""Effects that all channels may have alike are restored in either form, and told by their titles."""

from __future__ import annotations

import numpy as np
import pytest

from hydrabeam_mpi.effects.registry import EFFECTS, make_effect
from hydrabeam_mpi.effects.shared.in_channels import InChannels
from tests.effects.small import small_setup

KINDS = [kind for kind in EFFECTS if issubclass(EFFECTS[kind], InChannels)]


def test_which_they_are() -> None:
    assert set(KINDS) == {"antenna_gains", "nonredundant_beams", "compression"}


@pytest.mark.parametrize("kind", KINDS)
def test_both_forms(kind: str) -> None:
    each, setup = make_effect(kind, {}), small_setup()
    alike = each.same_in_all_channels()
    assert alike is not None
    assert (each.shared, alike.shared) == (False, True)
    assert alike.title == f"{each.title}, the same in all channels"
    assert alike.same_in_all_channels() is None
    assert make_effect(kind, alike.describe()).describe() == alike.describe() == {"channels": "alike"}
    assert each.parameters(setup).names == alike.parameters(setup).names
    np.testing.assert_array_equal(each.degenerate_directions(setup), alike.degenerate_directions(setup))


def test_what_changes_in_time_has_both_forms_too() -> None:
    jumps = {"law": "piecewise", "jumps": [2459866.7]}
    alike = make_effect("antenna_gains", jumps).same_in_all_channels()
    assert alike is not None
    assert alike.title == "antenna gains that jump, the same in all channels"
    assert make_effect("antenna_gains", alike.describe()).describe() == alike.describe()
    assert make_effect("antenna_pointing", jumps).same_in_all_channels() is None
