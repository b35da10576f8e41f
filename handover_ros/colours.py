"""Colours that mean the same in every picture."""

PHASE_COLOURS = {
    "planning": "#9aa0a6",
    "fetching": "#4c78a8",
    "presenting": "#72b7b2",
    "waiting": "#eeca3b",
    "releasing": "#f58518",
    "retracting": "#54a24b",
    "returning": "#e45756",
}
OTHER_COLOUR = "#bab0ac"
GOOD, BAD, WARNING, NEUTRAL = "#2e7d32", "#c62828", "#ef8a17", "#4a4f55"
EVENT_COLOURS = {
    "grasped": "#4c78a8",
    "taken": GOOD,
    "released": "#72b7b2",
    "placed": "#54a24b",
    "dropped": BAD,
    "fault": BAD,
    "person": "#b279a2",
    "reset": "#9aa0a6",
}
