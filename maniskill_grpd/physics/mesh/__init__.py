"""Geometry in numpy: outlines, triangle meshes, distances within them, and what a solver derives from them before it starts."""
