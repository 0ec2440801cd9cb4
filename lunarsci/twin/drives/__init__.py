"""Drives that others recorded: public data sets as they are laid out, and the twin beside what was measured of them."""
