"""Finding a device with which SAPIEN can really draw."""

from __future__ import annotations

import platform
import subprocess
import sys
from functools import lru_cache

from mani_skill import logger

from maniskill_grpd.tasks.options.observation_mode import needs_camera

PROBE_TIMEOUT = 120.0
"""Patience with a driver that hangs [s]; most answer in a second, some take a minute."""
AUTOMATIC_DEVICES = ("cuda", "cpu", "pci:0")
"""Devices to try, best first. The first two names miss some GPUs and software drivers."""
WITHOUT_SAPIEN = ("warp", "none", None)
"""Render backends for which SAPIEN is not asked."""
INSTALL_HINT = (
    "SAPIEN needs a Vulkan driver: that of an NVIDIA GPU, or Mesa's software driver from version "
    "23 on (Debian 13 / Ubuntu 24.04: apt-get install mesa-vulkan-drivers libvulkan1)"
)

_PROBE = """
import sys
import sapien
device = sapien.Device(sys.argv[1])
stage = sapien.Scene([sapien.physx.PhysxCpuSystem(), sapien.render.RenderSystem(device)])
builder = stage.create_actor_builder()
builder.add_box_visual(half_size=[1, 1, 1], material=[1, 1, 1])
builder.build_kinematic()
stage.set_ambient_light([1, 1, 1])
sapien.render.set_camera_shader_dir("minimal")
camera = stage.add_camera("probe", width=16, height=16, fovy=1.0, near=0.01, far=10.0)
camera.entity.set_pose(sapien.Pose([-3, 0, 0]))
stage.update_render()
camera.take_picture()
sys.exit(0 if camera.get_picture("Color")[8, 8, :3].max() > 0 else 1)
"""


def choose_render_device(requested: str | None, render_mode: str | None, obs_mode: str) -> str | None:
    """Return SAPIEN's name of the device to draw with, None where nothing is drawn by SAPIEN.

    Where it should draw and cannot, Warp draws pictures and observations, and a browser shows "human".

    Args:
        requested: "auto": image observations without SAPIEN, which draws one world after the other, pictures with whatever can
            draw; "warp", "none" or None: never SAPIEN; or a render backend of ManiSkill ("gpu", "cuda", "cpu", "sapien_cuda",
            "sapien_cpu", "cuda:1", "pci:0").
        render_mode: ManiSkill's render mode.
        obs_mode: ManiSkill's part of the observation mode.
    """
    has_images = needs_camera(obs_mode)
    wants_window = render_mode == "human"
    if (render_mode is None and not has_images) or (requested == "auto" and has_images and not wants_window):
        return None
    device = next((name for name in _candidates(requested) if can_draw(name)), None)
    if device is None and requested not in ("auto", *WITHOUT_SAPIEN):
        logger.warning(f"render_backend {requested!r} cannot draw here; images are drawn without SAPIEN. {INSTALL_HINT}")
    return device


@lru_cache
def can_draw(device: str) -> bool:
    """Tell whether SAPIEN can take a picture with a device ("cuda", "cpu", "pci:0").

    A picture is really taken, in a process of its own: drivers that only pretend to be able, or
    crash, do no harm. The answer is remembered.
    """
    if platform.system() == "Darwin":
        return device == "cpu"  # SAPIEN draws through Metal there, under this name
    try:
        probe = subprocess.run([sys.executable, "-c", _PROBE, device], capture_output=True, timeout=PROBE_TIMEOUT, check=False)
    except subprocess.TimeoutExpired:
        return False
    return probe.returncode == 0


def _candidates(requested: str | None) -> tuple[str, ...]:
    if requested in WITHOUT_SAPIEN:
        return ()
    if requested == "auto":
        return AUTOMATIC_DEVICES
    name, _, index = requested.removeprefix("sapien_").partition(":")
    name = {"gpu": "cuda"}.get(name, name)
    return (f"{name}:{index}" if index else name,)
