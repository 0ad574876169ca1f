"""A stiffer rope never stretches more, whatever it weighs and however short the substep."""

import numpy as np
import pytest

from . import stiff_ropes

# What one Newton step of the tensions and the rounding of positions leave of an edge of 2 cm: 0.2 micrometres.
FLOOR = 1e-5


@pytest.mark.parametrize("substeps", stiff_ropes.SUBSTEPS)
def test_a_stiffer_rope_does_not_stretch_more(substeps):
    strains = stiff_ropes.largest_strains(substeps)
    assert (np.diff(strains, axis=1) <= FLOOR).all(), strains
    assert strains[:, -1].max() < 1e-4
    # A default rope sags between its ends until EA strain = T and strain = (w L / T)^2 / 24, and strains more while it is shaken.
    weight = np.array(stiff_ropes.DENSITIES) * 9.81 * stiff_ropes.LENGTH
    at_rest = (weight / 100.0) ** (2 / 3) / 24 ** (1 / 3)
    assert (strains[:, 0] > 0.9 * at_rest).all()
