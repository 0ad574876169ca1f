"""Simulations whose outcome has a closed form, shared by the tests and by `tools/docs/measure_physics.py`."""
