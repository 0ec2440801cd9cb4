"""Photometry of the Moon: from the reflectance factor seen at some geometry to that at 30, 0, 30 deg."""
