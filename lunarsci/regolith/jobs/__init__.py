"""What can be asked of the regolith: the commands of `lunarsci regolith` as functions."""
