"""Runs and checkpoints: their environments, policies, seeds and records; how they are trained, played, drawn and examined."""
