"""Change the program in ways that must not go unnoticed, and see whether the tests notice.

python tools/mutants.py                # all of them, a quarter of an hour
python tools/mutants.py gravity kl     # those whose names contain one of the words
python tools/mutants.py --list

Each mutant replaces one piece of text by another in a copy of the tree and runs the tests that must fail then. A mutant survives
if they pass. Its text must occur exactly once: an entry that no longer does is stale, and an error. To add a mutant, add an entry
to `MUTANTS` and see it killed.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
PASSED, FAILED = 0, 1
"""Exit codes of pytest; others mean that the tests did not run."""


@dataclass(frozen=True)
class Mutant:
    """A change that must not go unnoticed."""

    name: str
    """What is wrong with it."""
    file: str
    """The file it is in."""
    old: str
    """Text that occurs exactly once there."""
    new: str
    """What stands there instead."""
    test: str
    """Tests that must fail, as arguments of pytest."""


MUTANTS = (
    # ------------------------------------------------------------------ physics
    Mutant(
        "gravity is not copied in a saved state",
        "maniskill_grpd/physics/world_state.py",
        ".to(torch.float32, copy=True)",
        '.to(torch.float32, copy=name != "gravity")',
        "tests/physics/test_solver.py -k saved_state",
    ),
    # ------------------------------------------------------------------ tasks
    Mutant(
        "RopeWrapping's height is measured along z of the world",
        "maniskill_grpd/tasks/rope_wrapping.py",
        "is_at_height = (rope[..., 2] >= 0.0) & (rope[..., 2] <= POST_HEIGHT)",
        "is_at_height = (solver.positions[..., 2] >= 0.0) & (solver.positions[..., 2] <= POST_HEIGHT)",
        "tests/tasks/test_rope_wrapping.py -k every_frame",
    ),
    Mutant(
        "RopeWrapping's gap is measured in the plane of the table",
        "maniskill_grpd/tasks/rope_wrapping.py",
        "gap = torch.linalg.vector_norm(last - first, dim=-1)",
        "gap = torch.linalg.vector_norm((last - first)[..., :2], dim=-1)",
        "tests/tasks/test_rope_wrapping.py -k every_frame",
    ),
    Mutant(
        "RopeShaping's distances are measured in the plane of the table",
        "maniskill_grpd/tasks/rope_shaping.py",
        "distances = torch.linalg.vector_norm(offsets, dim=-1)",
        "distances = torch.linalg.vector_norm(offsets[..., :2], dim=-1)",
        "tests/tasks/test_rope_shaping.py -k every_frame",
    ),
    Mutant(
        "RopeShaping's distances are the largest along an axis of the world",
        "maniskill_grpd/tasks/rope_shaping.py",
        "distances = torch.linalg.vector_norm(offsets, dim=-1)",
        "distances = offsets.abs().amax(dim=-1)",
        "tests/tasks/test_rope_shaping.py -k every_frame",
    ),
    Mutant(
        "nodes of a thinned graph are the first free ones, not the farthest",
        "maniskill_grpd/tasks/observation/graph_nodes.py",
        "chosen.append(int(distance.argmax()))",
        "chosen.append(int((distance > 0.0).argmax()))",
        "tests/tasks/test_graph_nodes.py -k cover",
    ),
    Mutant(
        "seeding some worlds leaves the generator of their later episodes",
        "maniskill_grpd/tasks/worlds/seeded_worlds.py",
        "        self._batched_main_rng[worlds] = BatchedRNG.from_seeds(seeds).rngs\n",
        "",
        "tests/tasks/test_deformable_env.py -k later_episodes",
    ),
    Mutant(
        "seeds that follow from the first ignore it",
        "maniskill_grpd/tasks/options/seeds.py",
        "np.random.RandomState(seeds[0])",
        "np.random.RandomState(0)",
        "tests/tasks/test_options.py -k seeds",
    ),
    # ------------------------------------------------------------------ trajectories
    Mutant(
        "episodes that fail stay in the recorder of a replay",
        "maniskill_grpd/trajectory/replay.py",
        "        recorder.drop()\n",
        "        pass\n",
        "tests/trajectory/test_replay.py -k 'glued and FTFT and 1'",
    ),
    Mutant(
        "states are replayed a step late",
        "maniskill_grpd/trajectory/recorded_states.py",
        "self.unwrapped.set_state_dict(self._states[self._next])",
        "self.unwrapped.set_state_dict(self._states[max(self._next - 1, 0)])",
        "tests/trajectory/test_replay.py -k 'bitwise and RopeShaping'",
    ),
    # ------------------------------------------------------------------ structure
    Mutant(
        "a policy imports learning from the package itself",
        "maniskill_grpd/policies/policy.py",
        "from __future__ import annotations\n",
        "from __future__ import annotations\n\nfrom maniskill_grpd import learning  # noqa: F401\n",
        "tests/test_import_arrows.py -k lies_below",
    ),
    Mutant(
        "a policy imports learning relatively",
        "maniskill_grpd/policies/policy.py",
        "from __future__ import annotations\n",
        "from __future__ import annotations\n\nfrom ..learning import gae  # noqa: F401\n",
        "tests/test_import_arrows.py -k lies_below",
    ),
    # ------------------------------------------------------------------ policies and learning
    Mutant(
        "eq. 40 runs before eq. 38",
        "maniskill_grpd/policies/grpd.py",
        """        edges = self.actuator_geometry.complete(tools, grippers["mask"], tools, exclude_self=True)
        actuators = self.actuator_round(actuators, actuators, edges)
        edges = self.global_geometry.complete(points, nodes["mask"], tools)
        return objects, self.global_round(objects, actuators, edges)
""",
        """        edges = self.global_geometry.complete(points, nodes["mask"], tools)
        actuators = self.global_round(objects, actuators, edges)
        edges = self.actuator_geometry.complete(tools, grippers["mask"], tools, exclude_self=True)
        return objects, self.actuator_round(actuators, actuators, edges)
""",
        "tests/policies/test_jacobian.py",
    ),
    Mutant(
        "the KL is from the old policy to the new one",
        "maniskill_grpd/policies/distribution.py",
        "gaussian_kl_parts(self.mean, self.std, old.mean, old.std)",
        "gaussian_kl_parts(old.mean, old.std, self.mean, self.std)",
        "tests/policies/test_distribution.py",
    ),
    Mutant(
        "the divergence of grippers loses its digits near the old policy",
        "maniskill_grpd/policies/divergence.py",
        "torch.expm1(near)",
        "(torch.exp(near) - 1.0)",
        "tests/policies/test_distribution.py",
    ),
    Mutant(
        "BPP draws the projection to the policy, too",
        "maniskill_grpd/learning/bpp.py",
        "dist.kl_parts(projected.detach())",
        "dist.kl_parts(projected)",
        "tests/learning/test_algorithms.py",
    ),
    Mutant(
        "the noisy observer sees exact velocities",
        "maniskill_grpd/runs/noisy_observer.py",
        "velocity_std=sigma",
        "velocity_std=0.0",
        "tests/runs/test_noisy_observer.py",
    ),
)


class StaleMutantError(ValueError):
    """The text of a mutant does not occur exactly once; it has to be brought up to date."""


def apply(mutant: Mutant, root: Path) -> str:
    """Change the file of a mutant.

    Returns:
        What the file held before.

    Raises:
        StaleMutantError: If its text does not occur exactly once.
    """
    path = root / mutant.file
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    if (count := text.count(mutant.old)) != 1:
        raise StaleMutantError(f"{mutant.name}: its text occurs {count} times in {mutant.file}, expected once")
    path.write_text(text.replace(mutant.old, mutant.new), encoding="utf-8")
    return text


def copy_tree(root: Path, target: Path) -> None:
    """Copy what git tracks or would track."""
    command = ["git", "-C", str(root), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for name in subprocess.run(command, check=True, capture_output=True, text=True).stdout.split("\0"):
        if name and (root / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(root / name, target / name)


def run_tests(root: Path, tests: str) -> int:
    """Run tests on the tree at `root` and return the exit code of pytest."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *shlex.split(tests)]
    environment = {**os.environ, "PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(command, cwd=root, env=environment, capture_output=True, check=False).returncode


def judge(mutant: Mutant, root: Path) -> str:
    """Return "killed", "survived", or why neither can be said; the tree is as before afterwards."""
    before = apply(mutant, root)
    try:
        code = run_tests(root, mutant.test)
    finally:
        (root / mutant.file).write_text(before, encoding="utf-8")
    return {PASSED: "survived", FAILED: "killed"}.get(code, f"the tests did not run (pytest returned {code})")


def check(mutants: Sequence[Mutant], root: Path) -> int:
    """Judge mutants in the tree at `root`, which is changed meanwhile; return how many were not killed."""
    for mutant in mutants:  # stale entries first: they are found in no time
        (root / mutant.file).write_text(apply(mutant, root), encoding="utf-8")
    healthy: dict[str, bool] = {}
    num_left = 0
    for mutant in mutants:
        if mutant.test not in healthy:
            healthy[mutant.test] = run_tests(root, mutant.test) == PASSED
        verdict = judge(mutant, root) if healthy[mutant.test] else f"its tests fail without it: {mutant.test}"
        num_left += verdict != "killed"
        print(f"{verdict:<10}{mutant.name}", flush=True)
    return num_left


def main(arguments: Sequence[str]) -> int:
    """Judge the mutants that are asked for; 1 if any is not killed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="parts of names; all mutants by default")
    parser.add_argument("--list", action="store_true", help="print the names and stop")
    options = parser.parse_args(arguments)
    mutants = [m for m in MUTANTS if not options.words or any(word.lower() in m.name.lower() for word in options.words)]
    if options.list:
        print("\n".join(mutant.name for mutant in mutants))
        return 0
    if not mutants:
        print(f"error: no mutant is called {' or '.join(options.words)}", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        copy_tree(ROOT, Path(folder))
        try:
            num_left = check(mutants, Path(folder))
        except StaleMutantError as error:
            print(f"error: {error}", file=sys.stderr)
            return 1
    print(f"{len(mutants) - num_left} of {len(mutants)} killed")
    return int(num_left > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
