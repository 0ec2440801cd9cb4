"""The rover as a digital twin: predict a drive over uncertain ground and say whether it is safe."""
