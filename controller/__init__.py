"""The AGV control system: tasks, dispatch, planners, deadlock handling, executor. Knows neither SUMO nor files."""
