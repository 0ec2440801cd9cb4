"""What `lunarsci twin` does: one module a job, with its request and its result."""
