"""Policies on observation graphs. Torch only: nothing here knows a simulator or a task."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.policies.distribution import ActionDistribution
from maniskill_grpd.policies.empn import EMPN
from maniskill_grpd.policies.grpd import GRPD
from maniskill_grpd.policies.hepi import HEPi
from maniskill_grpd.policies.hetero_gnn import HeteroGNN
from maniskill_grpd.policies.options import parse_options
from maniskill_grpd.policies.policy import Policy
from maniskill_grpd.policies.transformer import TransformerPolicy

POLICIES: dict[str, type[Policy]] = {cls.name: cls for cls in (GRPD, EMPN, HeteroGNN, TransformerPolicy, HEPi)}
"""Policy classes by name."""


def make_policy(name: str, schema: GraphSchema, **options: Any) -> Policy:
    """Build an untrained policy.

    Args:
        name: A key of `POLICIES`.
        schema: What the graphs hold.
        **options: Options of that policy; see its `Options`.

    Returns:
        The policy, on the CPU.

    Raises:
        ValueError: For an unknown name or option, listing what is allowed.
    """
    if name not in POLICIES:
        raise ValueError(f"unknown policy {name!r}; allowed are {sorted(POLICIES)}")
    cls = POLICIES[name]
    return cls(schema, parse_options(cls.Options, options))


def policy_from_config(config: Mapping[str, Any]) -> Policy:
    """Rebuild a policy, without its weights, from its `config`.

    Args:
        config: Name, schema and options as plain types.

    Returns:
        The policy with fresh weights; load its state dict next.
    """
    schema = GraphSchema.from_dict(config["schema"])
    return make_policy(config["name"], schema, **config["options"])


__all__ = ["POLICIES", "ActionDistribution", "Policy", "make_policy", "policy_from_config"]
