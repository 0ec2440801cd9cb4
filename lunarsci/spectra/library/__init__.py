"""Libraries of end-member spectra: reading, writing, describing and checking them."""
