"""What a drive says of a soil: the record of it, misfit, coordinates, mode, population, and where the soil changes."""
