"""Tasks with arms in place of floating grippers."""

import gymnasium as gym
import numpy as np
import pytest
import sapien
import torch
from gymnasium import spaces
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import maniskill_grpd  # noqa: F401  (registers the tasks)
from maniskill_grpd.agents.arms import ARMS
from maniskill_grpd.agents.arms.link_frames import link_frames
from maniskill_grpd.agents.arms.meshes import picture_mesh, shape_mesh
from maniskill_grpd.rendering.labels import Label
from maniskill_grpd.tasks.pictures.arm_solids import arm_solids

PAIR = ("panda", "panda")
KEYS = ("panda-0", "panda-1")


@pytest.fixture
def make_arms():
    made = []

    def make(task="ClothFolding-v1", num_envs=2, robot_uids=PAIR, **settings):
        made.append(
            gym.make(task, num_envs=num_envs, robot_uids=robot_uids, sim_backend="cpu", num_threads=1, **settings).unwrapped
        )
        return made[-1]

    yield make
    for env in made:
        env.close()


def act(env, seed, scale=1.0):
    """Return an action for every arm, by the name of its agent."""
    generator = torch.Generator().manual_seed(seed)
    return {key: scale * (2 * torch.rand(space.shape, generator=generator) - 1) for key, space in env.action_space.items()}


def tool_gaps(env):
    """Return how far the grippers are from where the joints have the TCPs, (B, A) [m]."""
    arms = env.scene.arms
    return (arms.forward(arms.qpos)[..., :3] - env.solver.gripper_positions).norm(dim=-1)


@pytest.mark.parametrize(("task", "num"), [("ClothFolding-v1", 2), ("RopeShaping-v1", 3), ("RopeWrapping-v1", 2)])
def test_grippers_are_the_tools_of_the_arms(make_arms, task, num):
    env = make_arms(task, 3, ("panda",) * num)
    env.reset(seed=4)
    assert (tool_gaps(env) < 1e-3).all()
    for step in range(5):
        *_, info = env.step(act(env, step))
        assert (tool_gaps(env) < 2e-5).all()
        held = env.solver.positions.gather(1, env.start_nodes[..., None].expand(-1, -1, 3))
        torch.testing.assert_close(held, env.solver.gripper_positions)
    assert info["tracking_error"].shape == (3,)


def test_what_arms_can_follow_they_do_to_the_bit(make_arms):
    """The same actions through arms and by floating grippers that hold the same nodes: the same cloth, until an arm cannot."""
    arms = make_arms(num_envs=4, pose_range="quarter", arm_contact=False)
    floating = gym.make("ClothFolding-v1", num_envs=4, num_grippers=2, sim_backend="cpu", num_threads=1, pose_range="quarter")
    arms.reset(seed=3), floating.reset(seed=3)
    grippers = floating.unwrapped
    grippers.solver.set_state(arms.solver.state())
    for step in range(10):
        actions = act(arms, step, 0.1)
        *_, info = arms.step(actions)
        grippers.step(torch.cat([actions[key] for key in KEYS], dim=1))
    assert (info["tracking_error"] == 0).all()
    assert torch.equal(arms.solver.positions, grippers.solver.positions)
    assert torch.equal(arms.solver.gripper_positions, grippers.solver.gripper_positions)
    floating.close()


@pytest.mark.parametrize("mode", ["pd_ee_delta_pos", "pd_ee_delta_pose", "pd_joint_delta_pos", "pd_joint_pos"])
@pytest.mark.parametrize("suffix", ["", "_grip"])
def test_control_modes_have_their_numbers_and_move_what_they_say(make_arms, mode, suffix):
    env = make_arms("RopeWrapping-v1", control_mode=mode + suffix)
    env.reset(seed=1)
    numbers = {"pd_ee_delta_pos": 3, "pd_ee_delta_pose": 6, "pd_joint_delta_pos": 7, "pd_joint_pos": 7}[mode]
    assert [space.shape for space in env.action_space.values()] == [(2, numbers + bool(suffix))] * 2
    assert env.grasp == ("free" if suffix else "fixed")
    arms = env.scene.arms
    before, turned = arms.qpos.clone(), Rotation.from_quat(arms.rotations.reshape(-1, 4).numpy())
    action = torch.zeros(2, numbers)
    if mode == "pd_ee_delta_pose":
        action[:, 3:] = torch.tensor([0.0, 0.0, 0.5])
    elif mode == "pd_joint_delta_pos":
        action[:, 6] = 0.5  # turns the hand about the TCP: no grip needs to move
    elif mode == "pd_joint_pos":
        action = before[:, 0] + torch.tensor([0.0] * 6 + [0.05])
    still = {"pd_joint_pos": before[:, 1]}.get(mode, torch.zeros(2, numbers))
    grip = torch.ones(2, bool(suffix))
    there = env.solver.gripper_positions.clone()
    env.step({KEYS[0]: torch.cat([action, grip], dim=1), KEYS[1]: torch.cat([still, grip], dim=1)})
    torch.testing.assert_close(env.solver.gripper_positions, there, atol=1e-3, rtol=0)
    if mode in ("pd_joint_delta_pos", "pd_joint_pos"):
        torch.testing.assert_close((arms.qpos - before)[:, 0], torch.tensor([0.0] * 6 + [0.05]).expand(2, 7), atol=2e-4, rtol=0)
        torch.testing.assert_close(arms.qpos[:, 1], before[:, 1], atol=2e-4, rtol=0)
    if mode == "pd_ee_delta_pose":
        turns = (Rotation.from_quat(arms.rotations.reshape(-1, 4).numpy()) * turned.inv()).as_rotvec().reshape(2, 2, 3)
        np.testing.assert_allclose(turns[:, 0], [[0.0, 0.0, 0.05]] * 2, atol=1e-3)
        np.testing.assert_allclose(turns[:, 1], 0.0, atol=1e-3)


def test_states_are_restored_bitwise_and_worlds_start_alone(make_arms):
    env = make_arms("RopeWrapping-v1", 3, obs_mode="state+graph")
    env.reset(seed=[1, 2, 3])
    env.step(act(env, 0))
    state = env.get_state_dict()
    assert state["articulations"]["panda-agent-0"].shape == (3, 13 + 2 * 9 + 3)
    flat = env.get_state()
    first = [env.step(act(env, step))[0]["graph"] for step in range(1, 4)][-1]
    for restore, value in ((env.set_state_dict, state), (env.set_state, flat)):
        restore(value)
        again = [env.step(act(env, step))[0]["graph"] for step in range(1, 4)][-1]
        for key in ("positions", "velocities"):
            for left, right in zip(_leaves(first), _leaves(again), strict=True):
                assert torch.equal(left, right), key
    alone = make_arms("RopeWrapping-v1", 1)
    alone.reset(seed=2)
    env.reset(seed=2, options={"env_idx": torch.tensor([1])})
    assert torch.equal(alone.scene.arms.qpos[0], env.scene.arms.qpos[1])
    assert torch.equal(alone.solver.positions[0], env.solver.positions[1])


def _leaves(tree):
    return [leaf for value in tree.values() for leaf in (_leaves(value) if isinstance(value, dict) else [value])]


def test_arms_move_with_their_worlds(make_arms):
    """Bases, scene and gravity turned together: the same joints, and positions that are turned."""
    plain, moved = make_arms("RopeWrapping-v1"), make_arms("RopeWrapping-v1")
    plain.reset(seed=5), moved.reset(seed=5)
    rotation = torch.as_tensor(Rotation.random(random_state=2).as_matrix(), dtype=torch.float32)
    shift = torch.tensor([0.3, -0.2, 0.5])
    moved.move_worlds(rotation, shift)
    for step in range(5):
        actions = act(plain, step, 0.4)
        plain.step(actions), moved.step({key: value @ rotation.T for key, value in actions.items()})
    torch.testing.assert_close(moved.scene.arms.qpos, plain.scene.arms.qpos, atol=2e-3, rtol=0)
    expected = plain.solver.gripper_positions @ rotation.T + shift
    torch.testing.assert_close(moved.solver.gripper_positions, expected, atol=2e-4, rtol=0)


def test_scenes_that_turn_without_their_bases_go_elsewhere(make_arms):
    """Negative control of the above: bases and gravity belong to the scene."""
    for left_behind in ("bases", "gravity"):
        plain, moved = make_arms("RopeWrapping-v1"), make_arms("RopeWrapping-v1")
        plain.reset(seed=5), moved.reset(seed=5)
        rotation = torch.as_tensor(Rotation.from_rotvec([0.4, 0.0, 0.3]).as_matrix(), dtype=torch.float32)
        kept = (moved.scene.arms.bases if left_behind == "bases" else moved.solver.gravity).clone()
        moved.move_worlds(rotation, torch.zeros(3))
        (moved.scene.arms.bases if left_behind == "bases" else moved.solver.gravity).copy_(kept)
        for step in range(5):
            actions = act(plain, step, 0.4)
            plain.step(actions), moved.step({key: value @ rotation.T for key, value in actions.items()})
        gaps = (moved.solver.positions - plain.solver.positions @ rotation.T).norm(dim=-1)
        assert gaps.max() > 5e-3


def test_what_pulls_harder_than_the_grip_slips_out_of_hands_too(make_arms):
    env = make_arms("ClothHanging-v1", 2, ("panda",) * 4, grip_strength=0.05, resolution=49)
    env.reset(seed=0)
    still = {key: torch.zeros(space.shape) for key, space in env.action_space.items()}
    for _ in range(5):
        *_, info = env.step(still)
    assert info["slips"].shape == (2, 4)
    assert (info["slips"] > 0).all()
    assert (env.solver.gripper_nodes == -1).all()


def test_arms_are_observed_as_maniskill_observes_them(make_arms):
    env = make_arms("ClothFolding-v1", obs_mode="state_dict")
    obs, _ = env.reset(seed=0)
    assert isinstance(env.action_space, spaces.Dict)
    agent = obs["agent"]["panda-1"]
    assert [agent[key].shape for key in ("qpos", "qvel", "tcp_pose")] == [(2, 9), (2, 9), (2, 7)]
    assert (agent["qpos"][:, 7:] == 0.0).all()  # closed fingers
    torch.testing.assert_close(agent["tcp_pose"][:, :3], env.solver.gripper_positions[:, 1])
    hand = Rotation.from_quat(agent["tcp_pose"][:, [4, 5, 6, 3]].numpy()).apply([0.0, 0.0, 1.0])
    assert (hand[:, 2] < 0.0).all()  # it looks down


def test_arms_stand_where_they_are_told_and_other_arms_are_descriptions(make_arms):
    poses = [sapien.Pose([-0.6, 0.2, 0.0]), [-0.6, -0.2, 0.0, 1.0, 0.0, 0.0, 0.0]]
    env = make_arms("ClothFolding-v1", robot_uids=("panda", "xarm7"), robot_poses=poses, pose_range="quarter")
    obs, _ = env.reset(seed=0)
    assert set(env.action_space) == {"panda-0", "xarm7-1"}
    np.testing.assert_allclose(env.scene.arms.bases[0, :, :3], [[-0.6, 0.2, 0.0], [-0.6, -0.2, 0.0]], atol=1e-6)
    env.step({key: torch.zeros(space.shape) for key, space in env.action_space.items()})
    assert (tool_gaps(env) < 2e-5).all()


def test_what_cannot_be_is_refused(make_arms):
    for settings, message in (
        ({"robot_uids": ("panda",) * 5}, "this task has grips for .* arms, got 5"),
        ({"robot_uids": ("panda", "pander")}, "or a tuple of"),
        ({"robot_poses": [sapien.Pose()]}, "robot_poses must be 2 poses, one for each arm, got 1"),
        ({"robot_poses": [[0.0] * 7] * 2}, "a position and a unit quaternion"),
        ({"robot_poses": [sapien.Pose([9.0, 0, 0]), sapien.Pose()]}, "do not reach where episodes start"),
        ({"robot_uids": None, "robot_poses": [sapien.Pose()]}, "has no bases"),
        ({"control_mode": "pd_ee_pose"}, "control_mode must be one of"),
        ({"control_mode": "pd_joint_pos", "grasp": "free"}, "goes with control_mode='pd_joint_pos_grip'"),
    ):
        with pytest.raises(ValueError, match=message):
            make_arms(num_envs=1, **settings)
    env = make_arms("RopeWrapping-v1", control_mode="pd_joint_pos")
    env.reset(seed=0)
    still = {key: env.scene.arms.qpos[:, index].clone() for index, key in enumerate(KEYS)}
    wild = still[KEYS[0]].clone()
    wild[1, 3] = 1.0
    with pytest.raises(ValueError, match=r"targets of panda_joint4 must be in \[-3.0718, -0.0698\] rad, got 1.0000 in world 1"):
        env.step({**still, KEYS[0]: wild})
    wild[1, 3] = torch.nan
    with pytest.raises(ValueError, match="must be finite"):
        env.step({**still, KEYS[0]: wild})


def test_pictures_show_the_arms_where_they_are(make_arms):
    env = make_arms("RopeWrapping-v1", render_mode="rgb_array")
    env.reset(seed=1)
    env.step(act(env, 0))
    for index, agent in enumerate(env._agents):
        arm = agent.robot
        base = np.eye(4)
        base[:3, :3] = Rotation.from_quat(env.scene.arms.bases[1, index, 3:].numpy()).as_matrix()
        base[:3, 3] = env.scene.arms.bases[1, index, :3].numpy()
        names = [joint.name for joint in arm.joints]
        frames = arm.description.robot.frames(base, dict(zip(names, arm.get_qpos()[1].tolist(), strict=True)))
        np.testing.assert_allclose(frames["panda_hand_tcp"][:3, 3], env.solver.gripper_positions[1, index], atol=2e-5)
    solids = env.drawing(1).solids
    assert len(solids) == 1 + 2 * 11  # the post; eight links, hand and two fingers of each arm
    assert all(len(solid.faces) <= 625 for solid in solids[1:])
    tips = np.concatenate([solid.vertices for solid in solids[1:12]])
    assert np.linalg.norm(tips - env.solver.gripper_positions[1, 0].numpy(), axis=1).min() < 0.02
    with_arms = env.render()
    env.scene.arms = None
    assert (env.render() != with_arms).any()


def test_links_look_as_large_as_what_they_collide_with():
    """Both files of a link describe one body: the boxes about them differ by less than 2 cm."""
    robot = ARMS["panda"].robot
    for link in ("panda_link1", "panda_link4", "panda_link6", "panda_hand"):
        bounds = []
        for mesh, shapes in ((shape_mesh, robot.shapes), (picture_mesh, robot.visuals)):
            points = np.concatenate([mesh(shape)[0] for shape in shapes[link]])
            bounds.append(np.stack([points.min(axis=0), points.max(axis=0)]))
        np.testing.assert_allclose(bounds[0], bounds[1], atol=0.02)


def test_cameras_see_the_arms_where_they_are(make_arms):
    env = make_arms("RopeWrapping-v1", obs_mode="position+segmentation", sensor_configs={"width": 64, "height": 64})
    obs, _ = env.reset(seed=1)
    images, params = obs["sensor_data"]["base_camera"], obs["sensor_param"]["base_camera"]
    assert set(images["segmentation"].unique().tolist()) >= {Label.TABLE, Label.ARM}
    for world in range(2):
        seen = images["segmentation"][world, ..., 0] == Label.ARM
        points = images["position"][world][seen].double() / 1000.0
        frame = params["cam2world_gl"][world].double()
        points = (points @ frame[:3, :3].T + frame[:3, 3]).numpy()
        vertices = np.concatenate([solid.vertices for agent in env._agents for solid in arm_solids(agent.robot, world)])
        distances, _ = cKDTree(vertices).query(points)
        assert seen.sum() > 100
        assert np.quantile(distances, 0.99) < 0.05  # triangles are up to some centimetres large


def test_links_are_where_their_joints_have_them(make_arms):
    env = make_arms("RopeWrapping-v1")
    env.reset(seed=1)
    arm = env._agents[1].robot
    base = np.eye(4)
    base[:3, :3] = Rotation.from_quat(env.scene.arms.bases[1, 1, 3:].numpy()).as_matrix()
    base[:3, 3] = env.scene.arms.bases[1, 1, :3].numpy()
    names = [joint.name for joint in arm.joints]
    expected = arm.description.robot.frames(base, dict(zip(names, arm.get_qpos()[1].tolist(), strict=True)))
    for name, frame in link_frames(arm).items():
        np.testing.assert_allclose(frame[1], expected[name], atol=1e-5)


def test_episodes_that_arms_cannot_do_are_drawn_anew_and_counted(make_arms):
    env = make_arms("RopeShaping-v1", 40, ("panda",) * 4)
    _, info = env.reset(seed=0)
    assert 0 < (info["num_redrawn"] > 0).sum() < 40
    everywhere = torch.arange(40)
    goals = env.points_to_reach(everywhere, env.start_nodes)
    torch.testing.assert_close(goals[:, :, 0], env.at_start_nodes(env.goal_positions))
    for points in (goals[:, :, 0], env.solver.gripper_positions):
        assert (env.scene.arms.solve(everywhere, points)[1] < 1e-3).all()


@pytest.mark.parametrize(("num", "hanger"), [(4, "peg"), (3, "peg"), (4, "bar")])
def test_arms_beside_the_way_reach_cloth_and_hanger(make_arms, num, hanger):
    env = make_arms("ClothHanging-v1", 30, ("panda",) * num, resolution=49, hanger=hanger)
    _, info = env.reset(seed=0)
    assert info["num_redrawn"].max() < 50
    distances = env.solver.collider_positions.mean(dim=1).norm(dim=-1)
    assert (distances < 0.8).all()
    assert (tool_gaps(env) < 1e-3).all()
    env.step(act(env, 0))
    assert (tool_gaps(env) < 2e-5).all()


def test_the_object_lies_on_links_unless_it_is_told_to_pass(make_arms):
    """A hand that presses a rope down beside where it is held moves it, without contact it does not."""
    ends = []
    for arm_contact in (True, False):
        env = make_arms("RopeShaping-v1", 4, PAIR, arm_contact=arm_contact, pose_range="quarter")
        env.reset(seed=3)
        for step in range(15):
            env.step(act(env, step))
        ends.append(env.solver.positions.clone())
        assert len(env.solver.links) == (8 if arm_contact else 0)
    assert not torch.equal(*ends)


def test_a_single_arm_is_one_agent(make_arms):
    env = make_arms("ClothFolding-v1", robot_uids="panda")
    env.reset(seed=0)
    assert env.action_space.shape == (2, 3)
    np.testing.assert_allclose(env.scene.arms.bases[0, 0, :3], [-0.615, 0.0, 0.0])
    env.step(torch.zeros(2, 3))
    assert (tool_gaps(env) < 2e-5).all()
