"""The lower bound on entropy."""

import pytest
import torch

from maniskill_grpd.learning.bpp import BPP
from maniskill_grpd.learning.entropy_floor import raise_entropy
from maniskill_grpd.learning.trust_region import Bounds
from maniskill_grpd.policies import ActionDistribution


@pytest.mark.parametrize("width", [1, 3])
def test_entropies_end_at_or_above_the_floor(width):
    std = 10 ** torch.empty(1000, width, dtype=torch.float64).uniform_(-4, 2)
    raised = raise_entropy(std, 0.5, 3).expand(-1, 3)
    entropy = torch.distributions.Normal(torch.zeros(3), raised).entropy().sum(-1)
    assert entropy.min() >= 0.5 - 1e-9
    before = torch.distributions.Normal(torch.zeros(3), std.expand(-1, 3)).entropy().sum(-1)
    high = before >= 0.5
    assert 100 < high.sum() < 900
    assert torch.equal(raised[high], std.expand(-1, 3)[high])
    torch.testing.assert_close(entropy[~high], torch.full_like(entropy[~high], 0.5))


def test_the_trust_region_goes_before_the_floor():
    mask = torch.ones(4, 2, dtype=torch.bool)
    old = ActionDistribution(torch.zeros(4, 2, 3), torch.full((4, 2, 1), 0.05), mask)
    bounds = Bounds(mean=0.05, cov=0.005, gripper=0.01)
    algorithm = BPP(bounds=bounds, trust_region_coef=1.0, ent_coef=0.0, entropy_floor=2.0)
    projected = algorithm.project(old, old)
    assert (projected.std > old.std).all()
    assert projected.kl_parts(old).cov.max() <= 0.005 * (1 + 1e-5)
