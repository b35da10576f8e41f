"""The dissertation's experiments in simulation: their statistics, figures and claims beside ours."""
