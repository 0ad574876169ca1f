"""Shapes, obstacles and measures that tasks are made of."""
