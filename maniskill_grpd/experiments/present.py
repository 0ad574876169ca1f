"""What the present code does, for comparison with what runs of the past did."""

from __future__ import annotations

import functools
import json

from maniskill_grpd.experiments.fingerprints import SEEDED, Mark
from maniskill_grpd.experiments.study import Run
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.runs.fingerprint import describe_training


def present_mark(run: Run) -> Mark:
    """Return the mark that a run would have if it were made now, on this machine."""
    config = run.train_config()
    subject = {key: value for key, value in config.to_dict().items() if key not in SEEDED}
    return _present_mark(json.dumps(subject, sort_keys=True))


@functools.cache
def _present_mark(subject: str) -> Mark:
    fingerprint = describe_training(TrainConfig.from_dict(json.loads(subject)))["fingerprint"]
    return Mark.of_run({"config": subject, **fingerprint})
