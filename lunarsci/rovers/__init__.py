"""Rover description files (TOML): one file serves the wheel models and the multibody model."""
