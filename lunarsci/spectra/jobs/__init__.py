"""The jobs of `lunarsci spectra`: one module a command, with its request, its result and the function that does it."""
