"""A person's skeleton: kinematic tree, calibration from marker frames, tracking."""
