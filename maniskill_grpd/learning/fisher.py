"""Bounded policy updates by the natural gradient (paper eq. 67, 68)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import torch

from maniskill_grpd.learning.finite import NonFiniteError
from maniskill_grpd.learning.rollout import Batch, Rollout
from maniskill_grpd.learning.trust_region import BoundOptions, Bounds, activity_metrics, kl_metrics
from maniskill_grpd.learning.update import Algorithm, Learner, Metrics, apply_gradients, spread_metrics, summarize
from maniskill_grpd.policies import ActionDistribution
from maniskill_grpd.policies.divergence import KLParts

if TYPE_CHECKING:
    from maniskill_grpd.learning.config import TrainConfig

_CG_STEPS = 10
"""Conjugate gradient steps; more change the direction little and cost a pass over the samples each."""
_CG_TOLERANCE = 1e-10
"""Squared residual, relative to the first, at which the search for the direction ends."""
_LINE_SEARCH_STEPS = 12
"""Halvings of the step, down to a four-thousandth, before an update is given up."""
_CHUNK_SIZE = 256
"""Graphs per pass: second derivatives hold twice the activations of a gradient."""

Vector = torch.Tensor
"""All policy parameters in one row, (P,)."""


@dataclass(frozen=True, kw_only=True)
class FisherOptions(BoundOptions):
    """Options of the natural gradient."""

    RANGES: ClassVar[Mapping[str, str]] = {"fisher_samples": "[1, inf)", "fisher_damping": "(0, inf)"}

    fisher_samples: int = 1024
    """fisher: transitions the Fisher matrix is estimated with"""
    fisher_damping: float = 0.1
    """fisher: multiple of the identity added to the Fisher matrix"""


@dataclass(kw_only=True)
class FisherBPP(Algorithm):
    """Take the largest step along the natural gradient that stays in the region: `--trust_region fisher`.

        x = (F + damping I)^-1 g,    theta <- theta + 2^-j sqrt(2 bound / x^T F x) x

    g is the gradient of the surrogate (plus the entropy bonus) over the whole rollout, F the
    empirical Fisher matrix (eq. 68) of `num_samples` of its transitions, never formed: conjugate
    gradients need F v = E[s (s . v)] with s the score of a transition. Eq. 67 is a quadratic model
    of the KL; j is the first halving at which the true KL keeps each bound, averaged over states,
    and the surrogate is better than before. If there is none the policy stays.

    The value function then takes `update_epochs` passes of minibatches, but only those of its
    weights that the policy does not use: else it would move the policy out of the region. Give it
    an encoder of its own (`--policy_kwargs value_encoder=separate`) where that is too little.
    """

    bounds: Bounds
    num_samples: int
    damping: float
    ent_coef: float

    @classmethod
    def from_config(cls, config: TrainConfig) -> FisherBPP:
        """See `Algorithm.from_config`."""
        return cls(
            bounds=config.bounds, num_samples=config.fisher_samples, damping=config.fisher_damping, ent_coef=config.ent_coef
        )

    def acting_bound(self, old: ActionDistribution) -> tuple[float, bool]:
        """See `Algorithm.acting_bound`."""
        return self.bounds.acting(old), self.bounds.per_actuator

    def update(self, learner: Learner, rollout: Rollout) -> dict[str, float]:
        """See `Algorithm.update`."""
        rollout = learner.prepare(rollout)
        batch = learner.normalize_advantages(rollout.whole())
        actor, critic = split_parameters(learner, batch)
        metrics = self._step_policy(learner, batch, actor)
        metrics |= _fit_values(learner, rollout, critic)
        return metrics

    def _step_policy(self, learner: Learner, batch: Batch, actor: list[torch.Tensor]) -> dict[str, float]:
        before, gradient = self._objective_gradient(learner, batch, actor)
        if not torch.isfinite(gradient).all():
            raise NonFiniteError(
                "the gradient of the surrogate is not finite. Training stopped before the step; the last checkpoint is untouched."
            )
        samples = self._fisher_samples(learner, batch)
        direction = conjugate_gradient(lambda v: fisher_product(learner, samples, actor, v) + self.damping * v, gradient)
        # x^T F x = 2 KL of the joint action at unit step, of all actuators.
        curvature = (direction @ fisher_product(learner, samples, actor, direction)).clamp_min(1e-20)
        length = (2.0 * self._joint_bound(learner, batch) / curvature).sqrt()
        start = _flatten(actor).detach()
        for halving in range(_LINE_SEARCH_STEPS):
            _assign(actor, start + 0.5**halving * length * direction)
            objective, kl, metrics = self._measure(learner, batch)
            if objective > before and self._is_inside(kl):
                return {**metrics, "step_size": 0.5**halving}
        _assign(actor, start)
        return {**self._measure(learner, batch)[2], "step_size": 0.0}

    def _objective_gradient(self, learner: Learner, batch: Batch, actor: list[torch.Tensor]) -> tuple[float, Vector]:
        """Return the surrogate with entropy bonus, and its gradient, over all processes."""
        value, gradient = torch.zeros((), device=batch.actions.device), 0.0
        for chunk, share in _shares(batch):
            objective = self._objective(learner.evaluate(chunk)[0], chunk) * share
            gradient = gradient + _flatten(torch.autograd.grad(objective, actor))
            value = value + objective.detach()
        size = learner.workers.size
        return (learner.workers.sum(value) / size).item(), learner.workers.sum(gradient) / size

    def _objective(self, dist: ActionDistribution, batch: Batch) -> torch.Tensor:
        ratio = (dist.log_prob(batch.actions) - batch.log_probs).exp()
        return (ratio * batch.advantages).mean() + self.ent_coef * dist.entropy().mean()

    def _fisher_samples(self, learner: Learner, batch: Batch) -> Batch:
        """Draw the transitions that the Fisher matrix is estimated with."""
        wanted = min(self.num_samples // learner.workers.size or 1, len(batch))
        order = torch.randperm(len(batch), generator=learner.generator)[:wanted]
        return batch.select(order.to(batch.actions.device))

    def _joint_bound(self, learner: Learner, batch: Batch) -> float:
        """Return the sum of the bounds, per actuator times the mean number of actuators of a state [nats]."""
        total = self.bounds.mean + self.bounds.cov + (batch.old.gripper_logits is not None) * self.bounds.gripper
        if not self.bounds.per_actuator:
            return total
        count = batch.old.mask.sum(-1).to(batch.actions.dtype).mean()
        return total * (learner.workers.sum(count) / learner.workers.size).item()

    @torch.no_grad()
    def _measure(self, learner: Learner, batch: Batch) -> tuple[float, KLParts, dict[str, float]]:
        """Return the objective, the average KL parts, and what is logged, over all processes."""
        rows: list[Metrics] = []
        for chunk, share in _shares(batch):
            dist = learner.evaluate(chunk)[0]
            parts = dist.kl_parts(chunk.old)
            means = {f"{k}_kl": part for k, part in self.bounds.average(dist, parts)._asdict().items()}
            row = {
                **{"objective": self._objective(dist, chunk), "entropy": dist.entropy().mean()},
                **{**spread_metrics(dist), **means, **kl_metrics("raw", parts)},
                **activity_metrics(dist, parts, self.bounds),
            }
            # Weighted so that the plain mean over rows is the mean over states.
            scale = share * -(-len(batch) // _CHUNK_SIZE)
            rows.append({k: v if k.endswith("_max") else v * scale for k, v in row.items()})
        metrics = summarize(rows, learner.workers)
        kl = KLParts(*(metrics.pop(f"{name}_kl") for name in KLParts._fields))
        objective = metrics.pop("objective")
        policy_loss = self.ent_coef * metrics["entropy"] - objective
        return objective, kl, {"policy_loss": policy_loss, **metrics}

    def _is_inside(self, kl: KLParts) -> bool:
        return all(part <= getattr(self.bounds, name) for name, part in zip(KLParts._fields, kl, strict=True))


def split_parameters(learner: Learner, batch: Batch) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """Return the parameters that the policy depends on, and the others.

    Args:
        learner: Holds the policy.
        batch: Any transitions.
    """
    parameters = [p for p in learner.policy.parameters() if p.requires_grad]
    dist, _ = learner.evaluate(next(_shares(batch))[0])
    probe = sum(tensor.sum() for _, tensor in dist.items() if tensor.is_floating_point())
    gradients = torch.autograd.grad(probe, parameters, allow_unused=True)
    pairs = list(zip(parameters, gradients, strict=True))
    return [p for p, g in pairs if g is not None], [p for p, g in pairs if g is None]


def fisher_product(learner: Learner, samples: Batch, actor: list[torch.Tensor], vector: Vector) -> Vector:
    """Return F v = E[s (s . v)], s the gradient of the log density of a transition (eq. 68).

    No gradient of a single transition is formed: with weights w, J^T w is a gradient; it is linear
    in w, so its own gradient with respect to w, along v, is J v.

    Args:
        learner: Holds the policy and the processes.
        samples: Transitions.
        actor: Parameters of the policy.
        vector: v, (P,).
    """
    product = torch.zeros_like(vector)
    for chunk, _ in _shares(samples):
        log_prob = learner.evaluate(chunk)[0].log_prob(chunk.actions)
        weights = torch.zeros_like(log_prob, requires_grad=True)
        pulled = torch.autograd.grad(log_prob, actor, weights, create_graph=True)
        along = torch.autograd.grad(_flatten(pulled) @ vector, weights, retain_graph=True)[0]
        product += _flatten(torch.autograd.grad(log_prob, actor, along))
    return learner.workers.sum(product / len(samples)) / learner.workers.size


def conjugate_gradient(product: Callable[[Vector], Vector], target: Vector) -> Vector:
    """Solve A x = b approximately for a positive definite A.

    Args:
        product: v -> A v.
        target: b.
    """
    solution = torch.zeros_like(target)
    residual, direction = target.clone(), target.clone()
    square = first = residual @ residual
    for _ in range(_CG_STEPS):
        if square <= _CG_TOLERANCE * first:
            break
        image = product(direction)
        step = square / (direction @ image)
        solution += step * direction
        residual -= step * image
        previous, square = square, residual @ residual
        direction = residual + (square / previous) * direction
    return solution


def _fit_values(learner: Learner, rollout: Rollout, critic: list[torch.Tensor]) -> dict[str, float]:
    """Regress the value function's own weights on the returns."""
    rows: list[Metrics] = []
    for epoch in range(learner.config.update_epochs):
        rows = []
        for number, batch in enumerate(learner.minibatches(rollout)):
            learner.optimizer.zero_grad(set_to_none=True)
            metrics = _accumulate_value_gradients(learner, batch, critic)
            place = f"epoch {epoch}, minibatch {number} of the value function"
            metrics["grad_norm"] = apply_gradients(learner, critic, metrics, place)
            rows.append(metrics)
    return summarize(rows, learner.workers)


def _accumulate_value_gradients(learner: Learner, batch: Batch, critic: list[torch.Tensor]) -> Metrics:
    total = torch.zeros((), device=batch.actions.device)
    for chunk in learner.chunks(batch):
        loss = learner.value_loss(learner.evaluate(chunk)[1], chunk) * len(chunk) / len(batch)
        gradients = torch.autograd.grad(learner.config.vf_coef * loss, critic)
        for parameter, gradient in zip(critic, gradients, strict=True):
            parameter.grad = gradient if parameter.grad is None else parameter.grad + gradient
        total += loss.detach()
    return {"value_loss": total}


def _shares(batch: Batch) -> Iterator[tuple[Batch, float]]:
    """Yield parts of a batch with their shares of it."""
    for chunk in batch.split(_CHUNK_SIZE):
        yield chunk, len(chunk) / len(batch)


def _flatten(tensors: Iterable[torch.Tensor]) -> Vector:
    return torch.cat([tensor.reshape(-1) for tensor in tensors])


@torch.no_grad()
def _assign(parameters: list[torch.Tensor], vector: Vector) -> None:
    """Write a row of numbers back into parameters."""
    sizes = [parameter.numel() for parameter in parameters]
    for parameter, part in zip(parameters, vector.split(sizes), strict=True):
        parameter.copy_(part.view_as(parameter))
