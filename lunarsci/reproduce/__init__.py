"""The numbers of Ding et al. (2024) beside what lunarsci makes of the same statements, and the demonstration.

Both are commands, `lunarsci reproduce` and `lunarsci demo`, and so part of what is installed.
"""
