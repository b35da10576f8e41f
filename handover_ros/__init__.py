"""A live handover cell: a robot hands objects to a person so that it suits that person."""

__version__ = "0.1.0"
