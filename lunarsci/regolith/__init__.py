"""Wheel and soil: forces on a wheel, and the soil that a rover's wheel states reveal."""
