"""Chemistry of pyroxene and olivine from the 1 and 2 um bands, by published regressions."""
