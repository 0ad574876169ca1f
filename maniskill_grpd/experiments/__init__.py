"""Statistics, studies, tables and plots. Knows policies and results, not tasks: environments are made by the scripts.

The claims of the paper are tested by `studies`, each a few lines of declaration. A study expands to runs (`study.Run`), whose
folders `records` reads into the rows of `results`; `study_data` picks what answers a study, `claim` compares it with the paper,
`tables`, `plots` and `pages` show it.
"""

from maniskill_grpd.experiments.statistics import estimate, interquartile_mean, performance_profile, probability_of_improvement
from maniskill_grpd.experiments.studies import STUDIES, find_study
from maniskill_grpd.experiments.study import Arm, Condition, Run, Study, Task

__all__ = [
    "STUDIES",
    "Arm",
    "Condition",
    "Run",
    "Study",
    "Task",
    "estimate",
    "find_study",
    "interquartile_mean",
    "performance_profile",
    "probability_of_improvement",
]
