"""The observation graph, built from the state of the solver."""
