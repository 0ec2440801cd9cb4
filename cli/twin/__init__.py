"""`lunarsci twin`: whether the next drive is safe."""
