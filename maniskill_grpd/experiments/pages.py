"""Pages of results: one for each study and one that sums them up, written from the data and from nothing else."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import get_args

from maniskill_grpd.experiments.claim import MIN_RUNS, Verdict
from maniskill_grpd.experiments.fingerprints import Present
from maniskill_grpd.experiments.metrics import METRICS
from maniskill_grpd.experiments.plots import PLOTS
from maniskill_grpd.experiments.results import load_results
from maniskill_grpd.experiments.studies import STUDIES
from maniskill_grpd.experiments.study import Study
from maniskill_grpd.experiments.study_data import StudyData
from maniskill_grpd.experiments.tables import NOT_RUN, claim_table, markdown_table, score_table
from maniskill_grpd.program import command_line

DATA_FOLDER = "data"
"""Folder of the CSV files, beside the pages."""
ALL = "all"
"""What the command line calls all studies."""
NOTES_FOLDER = "notes"
"""Folder of what people wrote about a page, beside the pages; a page ends with its note."""

VERDICTS = get_args(Verdict)
READING = f"""\
*here*: mean over seeds of each side, compared as the paper's figure is; *95 % interval*: Welch's t interval, of ratios Fieller's,
of the claim alone; *IQM*: the same of interquartile means, which the paper reports; *g*: the difference in deviations of a run
(Hedges); *P(better)*: probability that a run of the first side scores more than one of the other; *p*: two-sided, uncorrected. A
claim holds, or does not hold, where p is at most 0.05 after Holm's correction for all claims of its study, against what the claim
needs: the right sign where it compares two arms, else the bound it names, or 85 % kept where the paper names none. Fewer than
{MIN_RUNS} seeds on a side are points, not a verdict. Over all tasks each counts alike. [How far to trust
this](../experiments.md)."""


def write_study_page(study: Study, folder: Path, budget: int | None = None, present: Present | None = None) -> Path:
    """Write the page of a study and its pictures.

    Args:
        study: The study.
        folder: Where pages go; its folder `data` holds the CSV files.
        budget: Environment steps of the runs to compare; None: for each task the largest there are.
        present: What the present code says of a run; see `choose`.

    Returns:
        The page, {study}.md; pictures lie beside it as {study}_{kind}.png.
    """
    data = StudyData(study, load_results(folder / DATA_FOLDER), budget, present)
    parts = [f"# {study.title}", study.question, *_arms(study), _provenance(data), *_cautions(data)]
    if study.claims:
        parts += ["## Claims", claim_table(data.findings()), READING]
    for metric in study.metrics:
        shown = METRICS[metric]
        parts += [f"## {shown.label.capitalize()}", f"{shown.meaning.capitalize()}.", score_table(data, metric)]
    pictures = [_draw(data, kind, folder) for kind in study.plots]
    parts += [f"![{path.stem}]({path.name})" for path in pictures if path is not None]
    return _write(folder, study.name, parts)


def write_summary_page(folder: Path, budget: int | None = None, present: Present | None = None) -> Path:
    """Write README.md: the state of every study, and every claim of the paper with what the data say."""
    results = load_results(folder / DATA_FOLDER)
    studies = [
        ["study", "about", "steps", "runs finished", "failed", "claims that hold", "that do not", "undecided", "points", NOT_RUN]
    ]
    claims = []
    for study in STUDIES.values():
        data = StudyData(study, results, budget, present)
        findings = data.findings()
        verdicts = Counter(finding.verdict for _, finding in findings)
        states = Counter(results.state(run) for task in study.tasks for run in data.runs(task))
        budgets = sorted({data.budget(task) for task in study.tasks} - {None})
        counts = [states["finished"], states["failed"], *(verdicts[verdict] for verdict in VERDICTS)]
        steps = ", ".join(f"{budget:,}" for budget in budgets) or "-"
        studies.append([f"[{study.name}]({study.name}.md)", study.title, steps, *map(str, counts)])
        if findings:
            claims += [f"### [{study.title}]({study.name}.md)", claim_table(findings)]
    parts = [
        "# Results",
        f"Every claim of the paper that can be measured, and what has been measured here. {_command(ALL)}",
        markdown_table(studies, num_text_columns=2),
        "## Claims of the paper",
        READING,
        *claims,
    ]
    return _write(folder, "README", parts)


def _arms(study: Study) -> list[str]:
    """Say in what each arm differs from its partner."""
    arms = [f"- `{arm.name}` differs from `{arm.partner}`: {arm.difference}." for arm in study.arms if arm.partner]
    return ["\n".join(arms)] if arms else []


def _provenance(data: StudyData) -> str:
    """Say what the page is made of."""
    runs = [run for task in data.study.tasks for run in data.runs(task)]
    rows = [data.results.runs[run.name] for run in runs]
    sentences = [_command(data.study.name, is_smoke_test=data.study.is_smoke_test)]
    if data.study.trained_by:
        sentences.append(f"Checkpoints are those of [{data.study.trained_by}]({data.study.trained_by}.md).")
    if not rows:
        return " ".join([*sentences, "**Not run.**"])
    states = Counter(data.results.state(run) for run in runs)
    sentences.append(f"Runs finished: {states['finished']}, failed: {states['failed']}.")
    devices = sorted({row.get("device_name") or row.get("device") or "unknown" for row in rows})
    commits = sorted({row.get("commit", "")[:12] or "unknown" for row in rows})
    names = {run.name for run in runs}
    tests = [row for (run, _), row in data.results.tests.items() if run in names]
    episodes = sorted({row.get("num_episodes") or "unknown" for row in tests})
    if episodes:
        sentences.append(f"Episodes of each test, on seeds that training does not use: {', '.join(episodes)}.")
    sentences.append(f"Device: {', '.join(devices)}. Commit: {', '.join(commits)}.")
    return " ".join(sentences)


def _cautions(data: StudyData) -> list[str]:
    """Say which tasks are of older code than the present one, and what is left out."""
    parts = []
    older = [task.name for task in data.study.tasks if data.is_older(task)]
    if older:
        parts.append(f"**Older than the present code**, which does something else: {', '.join(older)}.")
    if data.left_out:
        rows = [f"- `{name}`: {reason}" for name, reason in sorted(data.left_out.items())]
        parts.append("\n".join(["Left out:", "", *rows]))
    return parts


def _command(study: str, *, is_smoke_test: bool = False) -> str:
    words = ["study", "--study", study, *(["--quick"] if is_smoke_test else ["--report", "--output", "docs/results"])]
    return f"This page is written by `{command_line(words)}`, not by hand."


def _draw(data: StudyData, kind: str, folder: Path) -> Path | None:
    path = folder / f"{data.study.name}_{kind}.png"
    figure = PLOTS[kind](data)
    if figure is None:
        path.unlink(missing_ok=True)  # a picture of data that are no longer there would mislead
        return None
    figure.savefig(path)
    return path


def _write(folder: Path, name: str, parts: Iterable[str]) -> Path:
    note = folder / NOTES_FOLDER / f"{name}.md"
    parts = [*parts, *([note.read_text(encoding="utf-8").strip()] if note.exists() else [])]
    path = folder / f"{name}.md"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return path
