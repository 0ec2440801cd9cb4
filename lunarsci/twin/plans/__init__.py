"""What the rover is told: legs, their path and timing, commands of the wheels, position fixes."""
