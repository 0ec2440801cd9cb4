"""Missions: targets in order, reached by legs between which the rover finds out where it is."""
