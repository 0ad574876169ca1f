"""Keeping the policy that acts next inside the trust region (paper eq. 60, 64), whatever moved it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import torch

from maniskill_grpd.learning.rollout import Batch, Rollout
from maniskill_grpd.learning.update import Learner, autocast_policy

_SEARCH_STEPS = 12
"""Most tries of the search; the first guess, from the quadratic growth of the KL, mostly fits."""
_AIM = 0.97
"""Share of the bound that a try aims at."""
_ENOUGH = 0.9
"""Share of the bound at which a policy inside has come far enough."""


@dataclass(frozen=True)
class PolicySnapshot:
    """Weights and observation scales of a policy at one time: all that its actions depend on."""

    tensors: dict[str, torch.Tensor]

    @classmethod
    def of(cls, policy: torch.nn.Module) -> PolicySnapshot:
        """Copy them; counters are left out."""
        return cls({name: tensor.clone() for name, tensor in policy.state_dict().items() if tensor.is_floating_point()})

    @torch.no_grad()
    def mix_into(self, policy: torch.nn.Module, new: PolicySnapshot, share: float) -> None:
        """Set a policy to old + share (new - old); at the ends to the bits of the one or the other.

        Args:
            policy: Changed in place.
            new: The other end of the line.
            share: In [0, 1].
        """
        current = policy.state_dict()
        for name, old in self.tensors.items():
            current[name].copy_(torch.lerp(old, new.tensors[name], share))


@dataclass(frozen=True)
class ActingKL:
    """KL(acting || old) of whole actions over the states of a rollout [nats].

    Attributes:
        mean: Average over the states of all processes, what eq. 64 bounds.
        p99: 99th percentile over them.
        per_actuator: Average over states and actuators.
    """

    mean: float
    p99: float
    per_actuator: float


@torch.no_grad()
def measure_acting_kl(learner: Learner, rollout: Rollout) -> ActingKL:
    """Return how far the policy as it is now stands from the one that collected a rollout.

    Args:
        learner: Holds the policy and the processes.
        rollout: Filled.
    """
    batch = rollout.whole()
    totals = torch.cat([_joint_kl(learner, chunk) for chunk in learner.chunks(batch)])
    totals = torch.cat(learner.workers.gather(totals)).double()
    count = sum(learner.workers.gather(int(batch.old.mask.sum())))
    return ActingKL(totals.mean().item(), torch.quantile(totals, 0.99).item(), totals.sum().item() / max(count, 1))


def confine(
    learner: Learner, rollout: Rollout, before: PolicySnapshot, delta: float, *, per_actuator: bool = False
) -> dict[str, float]:
    """Move a policy back towards the old one until E_s[KL(acting || old)] <= delta holds (eq. 64).

    The search runs on the line between old and new weights and scales of observations. The KL of the
    old end is zero and grows with the square of the way, so that the first guess mostly fits.

    Args:
        learner: Holds the policy, after an update; changed in place.
        rollout: What the old policy collected.
        before: The old policy.
        delta: Bound [nats]; infinite to measure alone.
        per_actuator: Whether the bound is one of the average over actuators instead of whole actions.

    Returns:
        `kl_acting` and `kl_acting_p99`, average and 99th percentile over states of the KL of whole actions, and
        `step_share`, the share of the update that was kept.
    """
    after = PolicySnapshot.of(learner.policy)
    share, inside, outside = 1.0, 0.0, math.inf
    kl = measure_acting_kl(learner, rollout)
    for _ in range(_SEARCH_STEPS):
        value = kl.per_actuator if per_actuator else kl.mean
        if value <= delta:
            inside, kept = share, kl
            if share == 1.0 or value >= _ENOUGH * delta:
                break
        else:
            outside = share
        share = _next_share(share, value, delta, inside, outside)
        before.mix_into(learner.policy, after, share)
        kl = measure_acting_kl(learner, rollout)
    else:
        before.mix_into(learner.policy, after, inside)
        kept = measure_acting_kl(learner, rollout)
    return {"kl_acting": kept.mean, "kl_acting_p99": kept.p99, "step_share": inside}


def _next_share(share: float, value: float, delta: float, inside: float, outside: float) -> float:
    """Return where the KL, taken as quadratic in the share, is nearly delta; halve the bracket where that leads out of it."""
    guess = share * math.sqrt(_AIM * delta / value) if value > 0.0 and math.isfinite(value) else 0.0
    if inside < guess < outside:
        return min(guess, 1.0)
    return 0.5 * (inside + min(outside, 1.0))


def _joint_kl(learner: Learner, batch: Batch) -> torch.Tensor:
    """Return KL(policy || old policy) of whole actions, (M,)."""
    decide = partial(learner.policy.evaluate, actor=True, critic=False)
    dist, _ = autocast_policy(decide, learner.policy.prepare(batch.graph), learner.config.amp)
    return dist.kl_parts(batch.old).total
