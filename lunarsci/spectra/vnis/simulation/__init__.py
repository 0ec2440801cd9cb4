"""Synthetic VNIS observations: a made-up scene, the instrument that looks at it, and the files of its products."""
