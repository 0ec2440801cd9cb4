"""`lunarsci images`: from the rover's pictures to terrain, positions and tracks."""
