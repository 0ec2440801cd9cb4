"""The crater a rock came from: candidate craters, their ejecta, what is left of it, and the rock's composition."""
