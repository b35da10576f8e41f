"""The human arm as a skeleton gives it: the grip frame of a hand and the workspace it reaches."""
