"""Simulations whose outcome has a closed form, shared by the tests and by `examples/plot_physics_validation.py`."""
