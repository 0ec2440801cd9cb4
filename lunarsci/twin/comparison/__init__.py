"""A prediction beside what happened: regions, bands, surprise, and whether it is to be trusted."""
