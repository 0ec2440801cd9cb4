"""Jobs on pictures, one module each."""
