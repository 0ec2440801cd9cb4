"""The numbers of Ding et al. (2024) beside what lunarsci makes of the same statements, and the demonstration."""
