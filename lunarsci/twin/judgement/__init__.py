"""What a prediction means: limits and verdict, ends, clearance, spread, tables."""
