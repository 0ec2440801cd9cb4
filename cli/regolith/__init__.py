"""`lunarsci regolith`: what the ground is."""
