"""How much of which mineral a spectrum shows: unmixing with end members, and ratios of band strengths."""
