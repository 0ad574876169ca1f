"""Pictures of worlds, by SAPIEN where there is a Vulkan driver and in Warp elsewhere."""
