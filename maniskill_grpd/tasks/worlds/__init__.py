"""What a batch of worlds is to ManiSkill: a scene, a state, something that can be moved."""
