"""The algorithms by name: what distinguishes one from another is how it uses a rollout.

Rollouts, advantages, the value loss, minibatches and bookkeeping are shared (`update.py`), so that
a comparison of algorithms compares their losses alone. A new algorithm is one file, with a subclass
of `update.FirstOrderAlgorithm` (a loss) or `update.Algorithm` (a step of its own) and its options,
and one line in the table here: `TrainConfig` and the command line then know both.
"""

from __future__ import annotations

from maniskill_grpd.learning.bpp import BPP
from maniskill_grpd.learning.ppo import PPO
from maniskill_grpd.learning.update import Algorithm

ALGORITHMS: dict[str, type[Algorithm]] = {"bpp": BPP, "ppo": PPO}
"""Classes by the name that `--algorithm` takes."""
