"""The block form of the kernel, which CUDA runs, computes what the lanes compute: run on host threads with a real barrier."""

import ctypes

import numpy as np
import pytest
import torch
import trimesh

from maniskill_grpd.physics import Solver, box, cloth, cloth_from_mesh, cylinder, rope, square_outline
from maniskill_grpd.physics.kernels.block import count_up, synchronize_block
from maniskill_grpd.physics.kernels.step import build_step_kernel

NUM_THREADS = 3
YIELD = ctypes.cast(ctypes.CDLL(None).sched_yield, ctypes.c_void_p).value
BARRIER = f"""
static int count = 0; static int phase = 0;
int mine = __atomic_load_n(&phase, __ATOMIC_ACQUIRE);
if (__atomic_add_fetch(&count, 1, __ATOMIC_ACQ_REL) == {NUM_THREADS}) {{
    count = 0;
    __atomic_store_n(&phase, mine + 1, __ATOMIC_RELEASE);
}} else {{
    while (__atomic_load_n(&phase, __ATOMIC_ACQUIRE) == mine) {{ ((void(*)()){YIELD}UL)(); }}
}}
"""
NO_BARRIER = f"((void(*)()){YIELD}UL)();"
COUNTER = "return __atomic_fetch_add(wp::address(counts, i, j), 1, __ATOMIC_ACQ_REL);"
ROPE = rope(np.linspace([0.0, 0.0, 0.05], [0.4, 0.0, 0.05], 21), num_nodes=21)
CLOTH = cloth(square_outline(0.3), num_nodes=49)
BALL = trimesh.creation.icosphere(1, 0.1)
CURVED = cloth_from_mesh(BALL.vertices + [0.0, 0.0, 0.11], BALL.faces)
OBSTACLES = [box(0.05, 0.05, 0.04), cylinder(0.03, 0.1)]
SCENES = {
    "rope": (ROPE, {}),
    "cloth": (CLOTH, {"patch_radius": 0.05}),
    "curved cloth": (CURVED, {}),
    "colliders": (CLOTH, {"colliders": OBSTACLES}),
    "self-contact": (CLOTH, {"self_collision": True}),
    "rope on itself": (ROPE, {"self_collision": True, "colliders": OBSTACLES}),
}


class BlockSolver(Solver):
    """A solver whose worlds are advanced by blocks of host threads, each launch one thread of all blocks."""

    def _advances_lanes(self) -> bool:
        return False

    def _record_commands(self, num_threads):
        super()._record_commands(1)
        return [self._record_command(0, 1, thread, num_threads) for thread in range(num_threads)]


@pytest.fixture
def in_blocks(monkeypatch):
    """Return a function that puts a barrier and real atomics into kernels that are built from then on."""

    def put(barrier):
        monkeypatch.setattr(synchronize_block, "native_snippet", barrier)
        monkeypatch.setattr(count_up, "native_snippet", COUNTER)
        build_step_kernel.cache_clear()

    build_step_kernel.cache_clear()
    yield put
    build_step_kernel.cache_clear()


def final_state(kind: type[Solver], scene: str) -> dict[str, torch.Tensor]:
    """Return where four worlds are after random motion of two grippers that fold and drop the object."""
    model, options = SCENES[scene]
    solver = kind(model, 4, 2, num_threads=NUM_THREADS, **options)
    positions = solver.positions.clone()
    if scene == "self-contact":  # one half lies over the other
        positions[..., 2] += torch.where(positions[..., 0] > 0.0, 0.0055, 0.0)
        positions[..., 0] = -positions[..., 0].abs()
    solver.reset(torch.arange(4), positions, gripper_nodes=torch.tensor([0, model.num_nodes - 1]))
    generator = torch.Generator().manual_seed(5)
    touches = False
    for step in range(12):
        solver.gripper_targets += 0.02 * (torch.rand(4, 2, 3, generator=generator) - 0.5)
        solver.gripper_targets[:, 1] += 0.1 * (solver.gripper_positions[:, 0] - solver.gripper_positions[:, 1])
        if step == 8:
            solver.grasp(torch.arange(2), torch.tensor([-1, 3]))
        solver.step()
        if options.get("self_collision"):
            touches |= bool(solver._uploaded[-1].masses.numpy().any())
    assert touches == ("self_collision" in options)
    return solver.state() | {"forces": solver.gripper_forces.flatten(1), "dropped": solver.dropped_contacts[:, None]}


def differing(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> list[str]:
    return [name for name in a if not torch.equal(a[name], b[name])]


@pytest.mark.parametrize("scene", SCENES)
def test_blocks_of_threads_compute_the_bits_of_the_lanes(scene, in_blocks):
    lanes = final_state(Solver, scene)
    in_blocks(BARRIER)
    assert differing(lanes, final_state(BlockSolver, scene)) == []


def test_without_the_barrier_they_do_not(in_blocks):
    """Negative control. Threads that happen to run one after the other agree even so: any of several tries has to differ."""
    lanes = final_state(Solver, "rope")
    in_blocks(NO_BARRIER)
    assert any("positions" in differing(lanes, final_state(BlockSolver, "rope")) for _ in range(20))
