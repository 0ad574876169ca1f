"""What runs inside the fused kernel: functions in Warp for one world, or for the lanes of a group of worlds, and their data."""
