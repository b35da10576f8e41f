"""What ``./handover`` does before it runs: sets the machine up, examines it, runs the tests. Standard library only."""
