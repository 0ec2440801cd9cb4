"""Heights on grids: their files, units, marks of no data and projections."""
