"""Which of several drives to take: the chance of each, and the best under a limit of risk."""
