"""The same small grid of tuning for every policy, on seeds that no other study uses."""

from __future__ import annotations

from maniskill_grpd.experiments.studies.parts import CLOTH_HANGING, ROPE_SHAPING
from maniskill_grpd.experiments.study import PILOT_SEED, Arm, Options, Study

SIZES: dict[str, dict[str, Options]] = {
    "grpd": {
        "wide": {"scalar_dim": 48, "vector_dim": 24, "actuator_scalar_dim": 76, "actuator_vector_dim": 24},
        "deep": {"num_layers": 2},
    },
    "empn": {"wide": {"scalar_dim": 68, "vector_dim": 28}, "deep": {"num_layers": 4}},
    "hetero_gnn": {"wide": {"scalar_dim": 72, "actuator_scalar_dim": 92}, "deep": {"num_layers": 2}},
    "transformer": {"wide": {"scalar_dim": 96, "hidden_dim": 384, "num_heads": 8}, "deep": {"num_layers": 5}},
    "hepi": {"wide": {"scalar_dim": 72}, "deep": {"num_layers": 2}},
}
"""Options of a wider and of a deeper network of each policy: about twice the parameters, and one or two rounds more.

The wide transformer has the proportions of the literature, a second branch four times as wide and twelve channels a head.
"""
STEPS: dict[str, Options] = {
    "slow": {"learning_rate": 2.5e-4},
    "fast": {"learning_rate": 1e-3},
    "small_steps": {"mean_bound": 0.05, "cov_bound": 0.005},
    "large_steps": {"mean_bound": 0.2, "cov_bound": 0.02},
}
"""Learning rate and bounds of BPP at half and at twice their defaults."""


def tuning(policy: str) -> Study:
    """Return the study that tunes a policy: its defaults, and one change at a time."""
    default = Arm(name="default", policy=policy)
    changed = [
        Arm(name=name, policy=policy, policy_options=options, partner="default", difference=f"a {name} network")
        for name, options in SIZES[policy].items()
    ]
    changed += [
        Arm(name=name, policy=policy, train_options=options, partner="default", difference=" and ".join(options))
        for name, options in STEPS.items()
    ]
    return Study(
        name=f"tuning_{policy}",
        title=f"Tuning of {policy}",
        question=f"Which size, learning rate and bounds suit {policy}? Every policy gets the same grid, one change at a time, on "
        f"pilot seeds from {PILOT_SEED} up that no other study uses; what is ahead by more than its spread becomes the default.",
        tasks=(ROPE_SHAPING, CLOTH_HANGING),
        arms=(default, *changed),
        metrics=("training_return", "success_at_end", "return", "iteration_seconds"),
        plots=("bars", "curves"),
        first_seed=PILOT_SEED,
    )


TUNING = tuple(tuning(policy) for policy in SIZES)
