"""The update phase: epochs of minibatches over one rollout, the same for every algorithm."""

from __future__ import annotations

import torch

from maniskill_grpd.learning.algorithm import Algorithm
from maniskill_grpd.learning.config import TrainConfig
from maniskill_grpd.learning.finite import NonFiniteError
from maniskill_grpd.learning.rollout import Batch, Rollout, map_graph
from maniskill_grpd.learning.value_scale import ValueScale

_CPU_CHUNK_SIZE = 256
"""Larger chunks fall out of the cache: 1600 graphs at once cost a third more per graph than 200."""


def update_policy(
    policy: torch.nn.Module,
    optimizer: torch.optim.Optimizer,
    algorithm: Algorithm,
    rollout: Rollout,
    value_scale: ValueScale,
    config: TrainConfig,
    generator: torch.Generator,
) -> dict[str, float]:
    """Take `update_epochs` passes over a rollout in random minibatches.

    Args:
        policy: The policy, changed in place.
        optimizer: Its optimizer.
        algorithm: The policy loss.
        rollout: Filled, with advantages and returns.
        value_scale: Scale of the value targets, already updated with this rollout.
        config: Sizes and coefficients.
        generator: Source of the minibatch order, a CPU generator.

    Returns:
        Metrics of the last epoch taken, averaged over its minibatches (`*_max`: the largest).

    Raises:
        NonFiniteError: If the gradient of a minibatch is not finite. The weights are not touched
            by that minibatch.
    """
    device = rollout.rewards.device
    rows: list[dict[str, torch.Tensor]] = []
    for epoch in range(config.update_epochs):
        order = torch.randperm(config.batch_size, generator=generator).to(device)
        rows = []
        for number, index in enumerate(order.split(config.minibatch_size)):
            batch = _normalize_advantages(rollout.select(index), config)
            optimizer.zero_grad(set_to_none=True)
            metrics = _accumulate_gradients(policy, algorithm, batch, value_scale, config)
            norm = torch.nn.utils.clip_grad_norm_(policy.parameters(), config.max_grad_norm)
            if not torch.isfinite(norm):
                raise NonFiniteError(_describe(policy, metrics, epoch, number))
            optimizer.step()
            rows.append({**metrics, "grad_norm": norm.detach()})
            if config.target_kl is not None and metrics["kl_raw"] > config.target_kl:
                return _summarize(rows)
    return _summarize(rows)


def _normalize_advantages(batch: Batch, config: TrainConfig) -> Batch:
    if config.norm_adv:
        advantages = batch.advantages
        # The tensor was gathered for this batch alone, so it may be changed in place.
        advantages.sub_(advantages.mean()).div_(advantages.std() + 1e-8)
    return batch


def _accumulate_gradients(
    policy: torch.nn.Module,
    algorithm: Algorithm,
    batch: Batch,
    value_scale: ValueScale,
    config: TrainConfig,
) -> dict[str, torch.Tensor]:
    """Backpropagate the loss of a minibatch, in chunks whose activations stay small."""
    size = batch.actions.shape[0]
    rows, shares = [], []
    for chunk in _chunks(batch, config.chunk_size):
        dist, outputs = policy(chunk.graph)
        policy_loss, metrics = algorithm.policy_loss(dist, chunk)
        # Half the mean squared error, as in CleanRL and ManiSkill.
        value_loss = 0.5 * (outputs - value_scale.normalize(chunk.returns)).square().mean()
        share = chunk.actions.shape[0] / size
        (share * (policy_loss + config.vf_coef * value_loss)).backward()
        rows.append({**metrics, "value_loss": value_loss.detach(), "std": _mean_std(dist)})
        shares.append(share)
    return rows[0] if len(rows) == 1 else _reduce(rows, shares)


def _chunks(batch: Batch, chunk_size: int) -> list[Batch]:
    """Split a minibatch into chunks of nearly equal size."""
    size = batch.actions.shape[0]
    if not chunk_size:
        chunk_size = _CPU_CHUNK_SIZE if batch.actions.device.type == "cpu" else size
    count = -(-size // chunk_size)
    if count == 1:
        return [batch]
    edges = [size * i // count for i in range(count + 1)]
    return [_slice(batch, start, end) for start, end in zip(edges, edges[1:], strict=False)]


def _slice(batch: Batch, start: int, end: int) -> Batch:
    def cut(tensor: torch.Tensor) -> torch.Tensor:
        return tensor[start:end]

    return Batch(
        graph=map_graph(cut, batch.graph),
        actions=cut(batch.actions),
        log_probs=cut(batch.log_probs),
        old_mean=cut(batch.old_mean),
        old_std=cut(batch.old_std),
        advantages=cut(batch.advantages),
        returns=cut(batch.returns),
    )


def _mean_std(dist) -> torch.Tensor:
    """Return the standard deviation averaged over the actuators that exist."""
    return dist.std.detach()[dist.mask].mean()


def _reduce(rows: list[dict[str, torch.Tensor]], shares: list[float]) -> dict[str, torch.Tensor]:
    """Average metrics with weights that sum to one; of `*_max` take the largest."""
    stacked = {key: torch.stack([row[key] for row in rows]) for key in rows[0]}
    weights = torch.tensor(shares, device=next(iter(stacked.values())).device)
    return {k: v.max() if k.endswith("_max") else (v * weights).sum() for k, v in stacked.items()}


def _summarize(rows: list[dict[str, torch.Tensor]]) -> dict[str, float]:
    metrics = _reduce(rows, [1.0 / len(rows)] * len(rows))
    return {key: value.item() for key, value in metrics.items()}


def _describe(
    policy: torch.nn.Module, metrics: dict[str, torch.Tensor], epoch: int, number: int
) -> str:
    """Say what was not finite in a failed minibatch."""
    broken = [name for name, value in metrics.items() if not torch.isfinite(value)]
    weights = [
        name
        for name, parameter in policy.named_parameters()
        if parameter.grad is not None and not torch.isfinite(parameter.grad).all()
    ]
    return (
        f"the gradient is not finite in epoch {epoch}, minibatch {number}: "
        f"non-finite losses {broken or 'none'}, first non-finite gradients {weights[:3]}. "
        "Training stopped before the step; the last checkpoint is untouched."
    )
