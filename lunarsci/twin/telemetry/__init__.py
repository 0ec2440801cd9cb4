"""What a rover sends home of a drive: read with suspicion, smoothed, and made up for trials."""
