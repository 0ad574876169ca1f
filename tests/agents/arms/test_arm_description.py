"""What arms are: names in a URDF file, checked when they are given."""

from dataclasses import replace

import numpy as np
import pytest

from maniskill_grpd.agents.arms import ARMS, register_arm

PANDA = ARMS["panda"]


def test_limits_and_speeds_are_those_of_the_file():
    joints = PANDA.arm_joints
    assert [joint.name for joint in joints] == [f"panda_joint{index}" for index in range(1, 8)]
    assert (joints[3].lower, joints[3].upper, joints[3].speed) == (-3.0718, -0.0698, 2.175)
    assert [finger.upper for finger in PANDA.fingers] == [0.04, 0.04]
    # The hand is turned by 45 degrees and its TCP 0.107 + 0.1034 m out of the last joint.
    np.testing.assert_allclose(PANDA.offsets[-1][:3, 3], [0.0, 0.0, 0.2104], atol=1e-12)
    np.testing.assert_allclose(PANDA.offsets[-1][:2, 0], np.array([1.0, -1.0]) / 2**0.5, atol=1e-12)


def test_what_the_file_does_not_have_is_refused(tmp_path):
    for change, message in (
        ({"tcp_link": "hand"}, "has no link 'hand'; it has panda_link0"),
        ({"tcp_link": "panda_link0"}, "no joint of .* moves 'panda_link0'"),
        ({"rest_qpos": (0.0,)}, "must have 7 numbers, got 1"),
        ({"rest_qpos": (0.0,) * 7}, "out of the limits .* of panda_joint4: 0.0"),
        ({"accelerations": (1.0,)}, "accelerations of 'panda' must be 7 numbers > 0"),
        ({"finger_joints": ("thumb",)}, "has no joints \\['thumb'\\]"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(PANDA, **change)
    slow = tmp_path / "slow.urdf"
    slow.write_text(PANDA.urdf.read_text().replace('velocity="2.1750"', 'velocity="0"'))
    with pytest.raises(ValueError, match="panda_joint1 .* has no largest velocity"):
        replace(PANDA, urdf=slow)
    for text, message in (("<robot", "is no XML file"), ("<sdf/>", "its root is <sdf>, not <robot>")):
        slow.write_text(text)
        with pytest.raises(ValueError, match=message):
            replace(PANDA, urdf=slow)


def test_a_name_belongs_to_one_arm():
    assert register_arm(PANDA) is PANDA
    with pytest.raises(ValueError, match="there is an arm 'panda' already"):
        register_arm(replace(PANDA, finger_joints=()))
