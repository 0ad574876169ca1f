"""Pictures of worlds, by SAPIEN where there is a Vulkan driver and by numpy elsewhere."""
