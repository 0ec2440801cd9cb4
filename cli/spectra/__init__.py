"""`lunarsci spectra`: what the rock is made of."""
