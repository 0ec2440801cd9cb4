"""Image cubes: a spectrum in every pixel, read in blocks, and maps of what is measured on them."""
