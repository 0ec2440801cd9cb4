"""All parameters of a soil from all wheel states at once: problem, mode, posterior, verdict, predictions."""
