"""Rovers that differ in a few numbers, driven on the same mission and compared."""
