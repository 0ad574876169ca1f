"""Kinematics of arms, beside an independent library and beside what limits say."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from maniskill_grpd.agents.arms import ARMS, ArmBodies
from maniskill_grpd.agents.arms.capsules import column_capsule, fit_capsule, link_capsules
from maniskill_grpd.agents.arms.meshes import shape_mesh
from maniskill_grpd.physics import Solver, rope
from maniskill_grpd.tasks.options.arm_bases import arm_bases

UIDS = ("panda", "xarm7")
ALL = slice(0, 2)


def make_arms(num_worlds, uids=UIDS):
    """Return arms that stand about, turned and tilted, with a solver whose grippers are their TCPs."""
    solver = Solver(rope([[-0.4, 0], [0.4, 0]], num_nodes=20), num_worlds, len(uids), num_threads=1)
    bases = np.tile(np.eye(4), (len(uids), 1, 1))
    bases[:, :3, :3] = Rotation.random(len(uids), random_state=1).as_matrix()
    bases[:, :3, 3] = np.random.default_rng(1).normal(size=(len(uids), 3)) + 3.0 * np.arange(len(uids))[:, None]
    solver.plane[:, 3] = -10.0  # neither the table nor the other base is in the way
    arms = ArmBodies([ARMS[uid] for uid in uids], solver, bases)
    start(arms, solver, arms.qpos.clone())
    return arms, solver


def start(arms, solver, qpos):
    """Put arms at joint positions, and grippers to their TCPs."""
    worlds = torch.arange(len(qpos))
    arms.set_qpos(worlds, slice(0, qpos.shape[1]), qpos)
    for points in (solver.gripper_positions, solver.gripper_targets):
        points.copy_(arms.forward(arms.qpos)[..., :3])


def random_qpos(arms, num_worlds, seed=0):
    share = torch.rand(num_worlds, *arms.lower.shape, generator=torch.Generator().manual_seed(seed))
    return arms.lower + share * (arms.upper - arms.lower)


def near_rest(arms, num_worlds, spread=0.2, seed=0):
    noise = spread * torch.randn(num_worlds, *arms.rest.shape, generator=torch.Generator().manual_seed(seed))
    return (arms.rest + noise).clamp(arms.lower, arms.upper)


def random_directions(*shape, seed=0):
    vectors = torch.randn(*shape, 3, generator=torch.Generator().manual_seed(seed))
    return vectors / vectors.norm(dim=-1, keepdim=True)


def reference_poses(arms, qpos):
    """Return positions (B, A, 3) and rotations (B, A, 3, 3) of the TCPs by pytorch_kinematics, in double precision."""
    pytorch_kinematics = pytest.importorskip("pytorch_kinematics")
    positions, rotations = [], []
    for arm, description in enumerate(arms.descriptions):
        chain = pytorch_kinematics.build_serial_chain_from_urdf(description.urdf.read_bytes(), description.tcp_link)
        pose = chain.to(dtype=torch.float64).forward_kinematics(qpos[:, arm].double()).get_matrix()
        base = arms.bases[:, arm].double()
        turn = torch.as_tensor(Rotation.from_quat(base[:, 3:].numpy()).as_matrix())
        positions.append((turn @ pose[:, :3, 3:])[..., 0] + base[:, :3])
        rotations.append(turn @ pose[:, :3, :3])
    return torch.stack(positions, dim=1), torch.stack(rotations, dim=1)


def angles_between(quaternions, rotations):
    """Return the angles between quaternions (x, y, z, w) and rotation matrices [rad]."""
    there = Rotation.from_quat(quaternions.reshape(-1, 4).numpy())
    return (there.inv() * Rotation.from_matrix(rotations.reshape(-1, 3, 3).numpy())).magnitude()


def test_forward_kinematics_are_those_of_an_independent_library():
    arms, _ = make_arms(200)
    qpos = random_qpos(arms, 200)
    tools = arms.forward(qpos)
    positions, rotations = reference_poses(arms, qpos)
    assert (tools[..., :3] - positions).abs().max() < 1e-5
    assert angles_between(tools[..., 3:], rotations).max() < 1e-4


def test_arms_that_are_put_to_a_point_are_there_and_say_so_where_they_are_not():
    arms, _ = make_arms(500)
    points = arms.forward(random_qpos(arms, 500))[..., :3]
    qpos, gaps = arms.solve(torch.arange(500), points)
    found, _ = reference_poses(arms, qpos)
    torch.testing.assert_close(gaps.double(), (found - points).norm(dim=-1), atol=2e-6, rtol=0)
    assert (gaps < 1e-4).float().mean() > 0.9  # all of them can be reached; one search finds most
    assert ((qpos >= arms.lower) & (qpos <= arms.upper)).all()
    _, gaps = arms.solve(torch.arange(500), points + 3.0)
    assert (gaps > 1.0).all()


def test_poses_are_found_as_an_independent_library_has_them():
    """10,000 random poses that can be reached, by joint positions of which the search knows nothing."""
    arms, _ = make_arms(5000)
    positions, rotations = reference_poses(arms, random_qpos(arms, 5000, seed=7))
    quaternions = torch.as_tensor(Rotation.from_matrix(rotations.reshape(-1, 3, 3).numpy()).as_quat()).reshape(5000, 2, 4)
    qpos, _ = arms.solve(torch.arange(5000), positions.float(), quaternions.float())
    assert ((qpos >= arms.lower) & (qpos <= arms.upper)).all()
    found, turned = reference_poses(arms, qpos)
    gaps = (found - positions).norm(dim=-1).flatten()
    there = Rotation.from_matrix(rotations.reshape(-1, 3, 3).numpy())
    angles = (there.inv() * Rotation.from_matrix(turned.reshape(-1, 3, 3).numpy())).magnitude()
    is_there = (gaps.numpy() < 1e-4) & (angles < 1e-3)
    assert is_there.mean() > 0.97
    assert np.median(gaps) < 1e-5


@pytest.mark.parametrize("is_held", [False, True])
def test_tcps_follow_their_targets_and_hands_keep_their_rotation(is_held):
    arms, solver = make_arms(200)
    arms.hold_rotation(ALL, is_held)
    start(arms, solver, near_rest(arms, 200))
    rotations = arms.rotations.clone()
    wanted = solver.gripper_positions + 0.003 * random_directions(200, 2)  # from rest, with what the joints may accelerate
    solver.gripper_targets.copy_(wanted)
    arms.follow()
    followed = (solver.gripper_targets == wanted).all(dim=-1)  # to the bit: what an arm can do is done exactly
    assert followed.float().mean() > 0.95
    assert (arms.errors[followed] == 0).all()
    assert (arms.errors[~followed] > 0).all()
    positions, turned = reference_poses(arms, arms.qpos)
    assert (positions - solver.gripper_targets).norm(dim=-1).max() < 1.2e-5  # also where it did not
    kept = angles_between(rotations, turned).reshape(200, 2)[followed.numpy()]
    assert (kept < 1e-3).all() == is_held


def test_what_is_out_of_reach_is_lost_and_said():
    arms, solver = make_arms(3, ("panda",))
    outward = arms.bases[:, :, :3] + 2.0 * random_directions(3, 1)
    for _ in range(150):
        solver.gripper_targets.add_(0.03 * torch.nn.functional.normalize(outward - solver.gripper_targets, dim=-1))
        arms.follow()
        torch.testing.assert_close(arms.forward(arms.qpos)[..., :3], solver.gripper_targets, atol=1.2e-5, rtol=0)
        solver.gripper_positions.copy_(solver.gripper_targets)
    assert (arms.errors > 0.001).all()
    shoulder = arms.bases[:, :, :3]
    assert ((solver.gripper_targets - shoulder).norm(dim=-1) < 1.3).all()


@pytest.mark.parametrize("is_held", [False, True])
def test_joints_never_leave_their_limits_nor_exceed_their_speeds_and_accelerations(is_held):
    arms, solver = make_arms(100)
    arms.hold_rotation(ALL, is_held)
    start(arms, solver, near_rest(arms, 100, spread=1.0))
    for step in range(100):
        solver.gripper_targets.add_(0.06 * random_directions(100, 2, seed=step))
        before, speeds = arms.qpos.clone(), arms.qvel.clone()
        arms.follow()
        solver.gripper_positions.copy_(solver.gripper_targets)
        assert ((arms.qpos >= arms.lower) & (arms.qpos <= arms.upper)).all()
        way = (arms.qpos - before).abs()
        assert (way <= arms.speeds * solver.control_dt * (1 + 1e-5) + 1e-6).all()
        torch.testing.assert_close(arms.qvel, (arms.qpos - before) / solver.control_dt)
        gained = torch.where(arms.qvel * speeds > 0.0, arms.qvel.abs() - speeds.abs(), arms.qvel.abs())
        assert (gained <= arms.accelerations * solver.control_dt * (1 + 1e-4) + 1e-4).all()


def test_joints_are_drawn_to_rest_while_the_tcp_stays():
    arms, solver = make_arms(20)
    start(arms, solver, near_rest(arms, 20, spread=0.4))
    there, before = solver.gripper_targets.clone(), (arms.qpos - arms.rest).norm(dim=-1)
    for _ in range(100):
        arms.follow()
    assert ((arms.forward(arms.qpos)[..., :3] - there).norm(dim=-1) < 1.2e-5).all()
    after = (arms.qpos - arms.rest).norm(dim=-1)
    assert (after < before).all()
    assert after.mean() < 0.8 * before.mean()


def test_worlds_do_not_depend_on_the_batch():
    many, solvers = make_arms(33)
    start(many, solvers, near_rest(many, 33))
    one, solver = make_arms(1)
    start(one, solver, near_rest(many, 33)[20:21])
    for step in range(10):
        motion = 0.05 * random_directions(33, 2, seed=step)
        solvers.gripper_targets.add_(motion)
        solver.gripper_targets.add_(motion[20:21])
        many.follow(), one.follow()
        solvers.gripper_positions.copy_(solvers.gripper_targets)
        solver.gripper_positions.copy_(solver.gripper_targets)
    assert torch.equal(many.qpos[20:21], one.qpos)
    assert torch.equal(solvers.gripper_targets[20:21], solver.gripper_targets)


def test_arms_turn_with_their_bases():
    arms, solver = make_arms(2)
    turn = Rotation.random(random_state=5)
    moved = arms.bases[1].clone()
    moved[:, :3] = torch.as_tensor(turn.apply(moved[:, :3].numpy()))
    moved[:, 3:] = torch.as_tensor((turn * Rotation.from_quat(moved[:, 3:].numpy())).as_quat())
    arms.bases[1] = moved
    start(arms, solver, near_rest(arms, 1).expand(2, -1, -1))
    matrix = torch.as_tensor(turn.as_matrix(), dtype=torch.float32)
    for step in range(20):
        motion = 0.01 * random_directions(2, seed=step)
        solver.gripper_targets.add_(torch.stack([motion, motion @ matrix.T]))
        arms.follow()
        solver.gripper_positions.copy_(solver.gripper_targets)
    torch.testing.assert_close(arms.qpos[1], arms.qpos[0], atol=1e-3, rtol=0)
    torch.testing.assert_close(solver.gripper_targets[1], solver.gripper_targets[0] @ matrix.T, atol=1e-5, rtol=0)


def test_arms_of_one_object_stay_within_its_length():
    """Arms and leash take turns: no arm goes where it would tear the rope."""
    arms, solver = make_arms(1, ("panda", "panda"))
    start(arms, solver, arms.qpos.clone())
    apart = (solver.gripper_positions[:, 0] - solver.gripper_positions[:, 1]).norm(dim=-1)
    solver.leashes[:, 0, 1] = solver.leashes[:, 1, 0] = apart
    away = solver.gripper_positions[:, :1] - solver.gripper_positions[:, 1:]
    for _ in range(40):
        solver.gripper_targets.add_(0.03 * torch.cat([away, -away], dim=1) / apart)
        arms.follow()
        solver.gripper_positions.copy_(solver.gripper_targets)
        assert (solver.gripper_targets[:, 0] - solver.gripper_targets[:, 1]).norm() <= apart * (1 + 2e-4)
        torch.testing.assert_close(arms.forward(arms.qpos)[..., :3], solver.gripper_targets, atol=1.2e-5, rtol=0)


@pytest.mark.slow
def test_limits_hold_in_a_million_random_steps():
    """Random motions, much larger than arms can follow, of 2 x 2,500 arms in 200 steps."""
    arms, solver = make_arms(2500)
    start(arms, solver, near_rest(arms, 2500, spread=1.0))
    for step in range(200):
        before, speeds = arms.qpos.clone(), arms.qvel.clone()
        solver.gripper_targets.add_(0.06 * random_directions(2500, 2, seed=step))
        arms.follow()
        solver.gripper_positions.copy_(solver.gripper_targets)
        assert ((arms.qpos >= arms.lower) & (arms.qpos <= arms.upper)).all()
        assert ((arms.qpos - before).abs() <= arms.speeds * solver.control_dt * (1 + 1e-5) + 1e-6).all()
        gained = torch.where(arms.qvel * speeds > 0.0, arms.qvel.abs() - speeds.abs(), arms.qvel.abs())
        assert (gained <= arms.accelerations * solver.control_dt * (1 + 1e-4) + 1e-4).all()


def facing_pair(height=0.0):
    """Return two Pandas that face each other on a table, 1.23 m apart, as tasks put them."""
    solver = Solver(rope([[-0.4, 0], [0.4, 0]], num_nodes=20), 1, 2, num_threads=1)
    solver.plane[:, 3] = height
    arms = ArmBodies([ARMS["panda"]] * 2, solver, arm_bases(("panda", "panda"), None))
    start(arms, solver, arms.qpos.clone())
    return arms, solver


def drive(arms, solver, motion, steps, arm=0):
    """Move the target of an arm by a motion (3,) in each step; return the lowest corner of its links, and what was refused."""
    lowest, refused = np.inf, 0
    for _ in range(steps):
        solver.gripper_targets[:, arm] += torch.as_tensor(motion)
        arms.follow()
        solver.gripper_positions.copy_(solver.gripper_targets)
        lowest = min(lowest, lowest_point(arms, arm))
        refused += int(arms.refused[0, arm])
    return lowest, refused


def lowest_point(arms, arm):
    """Return the height of the lowest vertex of the links without the fingers, by the meshes [m]."""
    description = arms.descriptions[arm]
    base = np.eye(4)
    base[:3, :3] = Rotation.from_quat(arms.bases[0, arm, 3:].numpy()).as_matrix()
    base[:3, 3] = arms.bases[0, arm, :3].numpy()
    names = [joint.name for joint in description.arm_joints]
    frames = description.robot.frames(base, dict(zip(names, arms.qpos[0, arm].tolist(), strict=True)))
    links = [description.arm_joints[-2].child, description.arm_joints[-1].child, "panda_hand"]
    shapes = [(frames[link], shape) for link in links for shape in description.robot.shapes[link]]
    return min((shape_mesh(shape)[0] @ frame[:3, :3].T + frame[:3, 3])[:, 2].min() for frame, shape in shapes)


def test_hands_do_not_come_into_the_table():
    arms, solver = facing_pair(height=0.2)
    lowest, refused = drive(arms, solver, [0.0, 0.01, -0.02], 60)
    assert lowest > 0.2 - 1e-4
    free, without = facing_pair(height=-10.0)  # control: there the same motion goes below
    assert drive(free, without, [0.0, 0.01, -0.02], 60)[0] < 0.15
    assert refused or arms.errors[0, 0] > 1e-3


def test_hands_do_not_come_into_the_base_of_another_arm():
    reached = []
    for base in (0.2, 5.0):  # the second is the control
        arms, solver = facing_pair(height=-10.0)
        arms.bases[:, 1, 1] = base
        drive(arms, solver, [0.0, 0.0, -0.02], 15)
        drive(arms, solver, [0.0, 0.02, 0.0], 40)
        reached.append(solver.gripper_positions[0, 0, 1].item())
    assert reached[0] < 0.2 - column_capsule(ARMS["panda"]).radius
    assert reached[1] > reached[0] + 0.05


def test_capsules_contain_the_links():
    for uid in UIDS:
        description = ARMS[uid]
        assert [link.joint for link in link_capsules(description)][:2] == [5, 6]
        for link in link_capsules(description):
            assert 0.02 < link.capsule.radius < 0.1
    points = np.random.default_rng(0).normal(size=(50, 3)) * [0.3, 0.1, 0.1]
    capsule = fit_capsule(points)
    along = capsule.ends[1] - capsule.ends[0]
    share = np.clip((points - capsule.ends[0]) @ along / (along @ along), 0, 1)
    distances = np.linalg.norm(points - capsule.ends[0] - share[:, None] * along, axis=1)
    assert (distances <= capsule.radius + 1e-9).all()
    assert distances.max() > 0.99 * capsule.radius
