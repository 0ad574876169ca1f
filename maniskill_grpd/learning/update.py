"""The update phase: epochs of minibatches over one rollout, the same for every first-order algorithm."""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import torch

from maniskill_grpd.learning.compilation import compiled
from maniskill_grpd.learning.finite import NonFiniteError
from maniskill_grpd.learning.options import OptionGroup
from maniskill_grpd.learning.protocols import ActorCritic
from maniskill_grpd.learning.rollout import Batch, Graph, Rollout, cat_graphs, graph_items, map_graph
from maniskill_grpd.learning.rotation_augmentation import random_rotations, rotate_batch
from maniskill_grpd.learning.schedule import Coefficients
from maniskill_grpd.learning.value_scale import ValueScale
from maniskill_grpd.learning.workers import Workers
from maniskill_grpd.policies import ActionDistribution

if TYPE_CHECKING:
    from maniskill_grpd.learning.config import TrainConfig

_CPU_CHUNK_SIZE = 256
"""Larger chunks fall out of the cache: 1600 graphs at once cost a third more per graph than 200."""

_LARGEST_PREPARED = 2**29
"""Most bytes of prepared graphs that are kept during an update; larger ones are prepared anew in every pass."""

Metrics = dict[str, torch.Tensor]
"""Detached scalars by name."""

Forward = Callable[[Graph], tuple[ActionDistribution, torch.Tensor | None]]
"""From graphs to the distribution of actions and value outputs (M,)."""


@dataclass(kw_only=True)
class Learner:
    """What an update changes and what it needs for that.

    Attributes:
        policy: The policy, changed in place.
        optimizer: Its optimizer.
        value_scale: Scale of the value targets, already updated with the rollout.
        config: Sizes and coefficients.
        generator: Source of the minibatch order, a CPU generator.
        workers: The processes that share the update.
    """

    policy: ActorCritic
    optimizer: torch.optim.Optimizer
    value_scale: ValueScale
    config: TrainConfig
    generator: torch.Generator
    workers: Workers = field(default_factory=Workers)

    def __post_init__(self) -> None:
        self._evaluate = self.policy.evaluate
        if self.config.compile:
            self._evaluate = compiled(self.policy.evaluate, next(self.policy.parameters()).device)

    def evaluate(self, batch: Batch) -> tuple[ActionDistribution, torch.Tensor]:
        """Return the policy's distribution and value outputs (M,) at the states of a batch."""
        graph = batch.graph if batch.is_prepared else self.policy.prepare(batch.graph)
        return autocast_policy(partial(self._evaluate, actor=True, critic=True), graph, self.config.amp)

    @torch.no_grad()
    def prepare(self, rollout: Rollout) -> Rollout:
        """Do once what all passes over a rollout share, if it is not too large to keep; turned graphs share nothing."""
        if self.config.rotation_augmentation != "none":
            return rollout
        flat = rollout.flat_graph()
        count, size = rollout.num_steps * rollout.num_envs, self._chunk_size(rollout.actions.device)
        parts: list[Graph] = []
        for start in range(0, count, size):
            parts.append(self.policy.prepare(map_graph(lambda tensor, start=start: tensor[start : start + size], flat)))
            if start == 0 and _num_bytes(parts[0]) * count > min(size, count) * _LARGEST_PREPARED:
                return rollout
        return rollout.with_prepared(cat_graphs(parts))

    def minibatches(self, rollout: Rollout) -> Iterator[Batch]:
        """Yield the minibatches of one epoch, in random order, advantages normalised if so configured."""
        size = self.workers.share("num_envs * num_steps", self.config.batch_size)
        order = torch.randperm(size, generator=self.generator).to(rollout.rewards.device)
        indices = order.split(size // self.config.num_minibatches)
        # All minibatches at once: every exchange between processes lets the fast wait for the slow.
        advantages = self._normalized([rollout.advantages.flatten()[index] for index in indices])
        for index, normalized in zip(indices, advantages, strict=True):
            batch = dataclasses.replace(rollout.select(index), advantages=normalized)
            augmentation = self.config.rotation_augmentation
            if augmentation != "none":
                batch = rotate_batch(batch, random_rotations(len(batch), augmentation, self.generator))
            yield batch

    def normalize_advantages(self, batch: Batch) -> Batch:
        """Bring the advantages of a batch to mean 0 and deviation 1, if so configured."""
        return dataclasses.replace(batch, advantages=self._normalized([batch.advantages])[0])

    def _normalized(self, advantages: list[torch.Tensor]) -> list[torch.Tensor]:
        if not self.config.norm_adv:
            return advantages
        moments = _moments(advantages, self.workers)
        return [(a - mean) / (std + 1e-8) for a, (mean, std) in zip(advantages, moments, strict=True)]

    def chunks(self, batch: Batch) -> list[Batch]:
        """Split a batch into parts whose activations stay small."""
        return batch.split(self._chunk_size(batch.actions.device))

    def _chunk_size(self, device: torch.device) -> int:
        return self.config.chunk_size or (_CPU_CHUNK_SIZE if device.type == "cpu" else self.config.batch_size)

    def value_loss(self, outputs: torch.Tensor, batch: Batch) -> torch.Tensor:
        """Return half the mean squared error of value outputs, as CleanRL and ManiSkill have it."""
        return 0.5 * (outputs - self.value_scale.normalize(batch.returns)).square().mean()


class Algorithm(abc.ABC):
    """Changes a policy after each rollout.

    Attributes:
        Options: What can be set of it; `TrainConfig` inherits from it.
        ent_coef: Weight of the entropy bonus.
    """

    Options: ClassVar[type[OptionGroup]] = OptionGroup
    ent_coef: float

    @classmethod
    @abc.abstractmethod
    def from_config(cls, config: TrainConfig) -> Algorithm:
        """Build the algorithm that a config describes."""

    def adopt(self, coefficients: Coefficients) -> None:
        """Take over what the schedules say for the next update."""
        self.ent_coef = coefficients.ent_coef

    @abc.abstractmethod
    def update(self, learner: Learner, rollout: Rollout) -> dict[str, float]:
        """Learn from a rollout.

        Args:
            learner: Policy, optimizer and what else is needed.
            rollout: Filled, with advantages and returns.

        Returns:
            Metrics of the last epoch taken, averaged over its minibatches (`*_max`: the largest).

        Raises:
            NonFiniteError: If a gradient is not finite. The weights are not touched by it.
        """

    def acting_bound(self, old: ActionDistribution) -> tuple[float, bool]:
        """Return the bound of E_s[KL(acting || old)] [nats], and whether it is one per actuator; none by default.

        Args:
            old: The policy that collected.
        """
        return math.inf, False

    def state_dict(self) -> dict[str, Any]:
        """Return what changes from update to update, as plain types; nothing by default."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        if state:
            raise ValueError(f"{type(self).__name__} keeps no state, got {sorted(state)}")


@dataclass(kw_only=True)
class FirstOrderAlgorithm(Algorithm):
    """Descends the gradient of a loss in minibatches."""

    ent_coef: float

    def project(self, dist: ActionDistribution, old: ActionDistribution) -> ActionDistribution:
        """Return the policy whose surrogate is maximised: `dist` itself unless the algorithm projects it.

        Args:
            dist: The current policy at M states, differentiable.
            old: The policy that collected, there.
        """
        return dist

    @abc.abstractmethod
    def policy_loss(self, dist: ActionDistribution, projected: ActionDistribution, batch: Batch) -> tuple[torch.Tensor, Metrics]:
        """Compute the loss of a minibatch.

        Args:
            dist: Action distribution of the current policy for `batch.graph`, differentiable.
            projected: What `project` made of it.
            batch: Transitions of the rollout.

        Returns:
            The scalar loss without the value term, and scalars to log.
        """

    @abc.abstractmethod
    def diagnose(self, dist: ActionDistribution, projected: ActionDistribution, batch: Batch) -> Metrics:
        """Return further scalars to log, `kl_raw` among them; computed only where they are used.

        Args:
            dist: As for `policy_loss`.
            projected: The projection of which the loss was made.
            batch: Transitions of the rollout.
        """

    def update(self, learner: Learner, rollout: Rollout) -> dict[str, float]:
        """Take `update_epochs` passes over a rollout in random minibatches; see `Algorithm.update`."""
        return update_policy(learner, self, rollout)


def update_policy(learner: Learner, algorithm: FirstOrderAlgorithm, rollout: Rollout) -> dict[str, float]:
    """Take `update_epochs` passes over a rollout; see `Algorithm.update`."""
    config, policy = learner.config, learner.policy
    rollout = learner.prepare(rollout)
    rows: list[Metrics] = []
    for epoch in range(config.update_epochs):
        rows = []
        is_last = epoch == config.update_epochs - 1
        for number, batch in enumerate(learner.minibatches(rollout)):
            learner.optimizer.zero_grad(set_to_none=True)
            diagnose = is_last or config.target_kl is not None
            metrics = _accumulate_gradients(learner, algorithm, batch, diagnose)
            metrics["grad_norm"] = apply_gradients(
                learner, list(policy.parameters()), metrics, f"epoch {epoch}, minibatch {number}"
            )
            rows.append(metrics)
            if config.target_kl is not None and _mean_kl(learner, metrics) > config.target_kl:
                return summarize(rows, learner.workers)
    return summarize(rows, learner.workers)


def apply_gradients(learner: Learner, parameters: list[torch.Tensor], metrics: Metrics, place: str) -> torch.Tensor:
    """Average the gradients over the processes, clip their norm and take a step of the optimizer.

    Args:
        learner: Optimizer and processes.
        parameters: Those that have a gradient.
        metrics: Losses, for the message.
        place: Where in the update this is, for the message.

    Returns:
        The norm before clipping.

    Raises:
        NonFiniteError: If it is not finite; the step is not taken then.
    """
    learner.workers.average_gradients(parameters)
    norm = torch.nn.utils.clip_grad_norm_(parameters, learner.config.max_grad_norm)
    if not torch.isfinite(norm):
        raise NonFiniteError(_describe(learner.policy, metrics, place))
    learner.optimizer.step()
    return norm.detach()


def _num_bytes(graph: Graph) -> int:
    return sum(tensor.numel() * tensor.element_size() for _, tensor in graph_items(graph))


def autocast_policy(forward: Forward, graph: Graph, enabled: bool) -> tuple[ActionDistribution, torch.Tensor | None]:
    """Evaluate a policy, its matrix products in bfloat16 if enabled; the results are float32.

    Args:
        forward: The policy, or the part of it that takes prepared graphs.
        graph: What it takes.
        enabled: Whether to use bfloat16.
    """
    if not enabled:
        return forward(graph)
    with torch.autocast(graph["object"]["mask"].device.type, dtype=torch.bfloat16):
        dist, outputs = forward(graph)
    dist = dist.map(lambda tensor: tensor.float() if tensor.is_floating_point() else tensor)
    return dist, None if outputs is None else outputs.float()


def summarize(rows: list[Metrics], workers: Workers) -> dict[str, float]:
    """Average the metrics of minibatches and of processes; of `*_max` take the largest."""
    metrics = workers.average_metrics(_reduce(rows, [1.0 / len(rows)] * len(rows)))
    return {key: value.item() for key, value in metrics.items()}


def _accumulate_gradients(learner: Learner, algorithm: FirstOrderAlgorithm, batch: Batch, diagnose: bool) -> Metrics:
    """Backpropagate the loss of a minibatch, in chunks whose activations stay small."""
    rows, shares = [], []
    for chunk in learner.chunks(batch):
        dist, outputs = learner.evaluate(chunk)
        projected = algorithm.project(dist, chunk.old)
        policy_loss, metrics = algorithm.policy_loss(dist, projected, chunk)
        value_loss = learner.value_loss(outputs, chunk)
        share = len(chunk) / len(batch)
        (share * (policy_loss + learner.config.vf_coef * value_loss)).backward()
        if diagnose:
            metrics |= {**spread_metrics(dist), **algorithm.diagnose(dist, projected, chunk)}
        rows.append({**metrics, "value_loss": value_loss.detach()})
        shares.append(share)
    return rows[0] if len(rows) == 1 else _reduce(rows, shares)


@torch.no_grad()
def spread_metrics(dist: ActionDistribution) -> Metrics:
    """Return deviation, radial and angular entropy, averaged over the actuators that exist."""
    radial, angular = dist.spherical_entropies()
    count = dist.mask.sum().clamp(min=1)
    return {"std": dist.std[dist.mask].mean(), "radial_entropy": radial.sum() / count, "angular_entropy": angular.sum() / count}


def _moments(batches: list[torch.Tensor], workers: Workers) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Return mean and (unbiased) standard deviation of each batch over the processes."""
    if workers.size == 1:
        return [(values.mean(), values.std()) for values in batches]
    # In float64 the difference of the two sums keeps more digits than float32 has.
    values = torch.stack(batches).double()
    count = values.shape[1] * workers.size
    totals = workers.sum(torch.stack([values.sum(dim=1), values.square().sum(dim=1)]))
    mean = totals[0] / count
    std = ((totals[1] - count * mean.square()) / (count - 1)).clamp(min=0.0).sqrt()
    return list(zip(mean.float(), std.float(), strict=True))


def _mean_kl(learner: Learner, metrics: Metrics) -> float:
    """Return `kl_raw` of a minibatch over the processes, so that all of them stop together."""
    return learner.workers.average_metrics({"kl_raw": metrics["kl_raw"]})["kl_raw"].item()


def _reduce(rows: list[Metrics], shares: list[float]) -> Metrics:
    """Average metrics with weights that sum to one; of `*_max` take the largest."""
    stacked = {key: torch.stack([row[key] for row in rows]) for key in rows[0]}
    weights = torch.tensor(shares, device=next(iter(stacked.values())).device)
    return {k: v.max() if k.endswith("_max") else (v * weights).sum() for k, v in stacked.items()}


def _describe(policy: ActorCritic, metrics: Metrics, place: str) -> str:
    """Say what was not finite in a failed minibatch."""
    broken = [name for name, value in metrics.items() if not torch.isfinite(value)]
    weights = [
        name
        for name, parameter in policy.named_parameters()
        if parameter.grad is not None and not torch.isfinite(parameter.grad).all()
    ]
    return (
        f"the gradient is not finite in {place}: "
        f"non-finite losses {broken or 'none'}, first non-finite gradients {weights[:3]}. "
        "Training stopped before the step; the last checkpoint is untouched."
    )
