"""Search for a path of arcs between hazards."""
