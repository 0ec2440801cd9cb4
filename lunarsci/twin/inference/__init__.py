"""What a drive says of a soil: misfit, coordinates, mode and population."""
