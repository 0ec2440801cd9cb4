"""The compiled rover: kinematics, contact with the ground, time step, settling, driving; many drives at once."""
