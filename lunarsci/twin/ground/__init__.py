"""Terrain: heights and soil on a grid, files, made-up ground, maps of hazards."""
