"""Pictures of a rover: its cameras, and what can be measured in pairs of pictures."""
