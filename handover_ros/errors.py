"""The errors of the package: one base, a few kinds, each with the code that travels over ROS.

A message names the thing, the value, the valid range and the remedy, in one line. At the ROS boundary an error
becomes ``success: false, error_code, message``; at the command line one line and exit status 2.
"""

from __future__ import annotations

from enum import IntEnum


class ErrorCode(IntEnum):
    """Mirror of ``handover_msgs/ErrorCode`` (a test holds the two together)."""

    NONE = 0
    BAD_REQUEST = 100
    UNKNOWN_NAME = 101
    BAD_RECORDING = 102
    BAD_MODEL = 103
    BUSY = 104
    OBJECT_NOT_FOUND = 200
    NOT_REACHABLE = 201
    IN_COLLISION = 202
    NO_PATH = 203
    PERSON_NOT_TRACKED = 204
    NOT_FEASIBLE_FOR_PERSON = 205
    CANCELLED = 300
    NODE_LOST = 301
    STALE_DATA = 302
    GRASP_FAILED = 303
    NOT_TAKEN = 304
    OBJECT_DROPPED = 305
    TRACKING_ERROR = 306
    TIMEOUT = 307
    STORE_FAILED = 400
    NOT_ENOUGH_DATA = 401
    FIT_FAILED = 402
    INTERNAL = 500


class HandoverError(Exception):
    """Base of every error that is somebody's to mend."""

    code: ErrorCode = ErrorCode.INTERNAL

    def __init__(self, message: str, code: ErrorCode | None = None) -> None:
        super().__init__(message)
        if code is not None:
            self.code = code


class BadRequestError(HandoverError):
    """A request or a live sample has a field that cannot be used."""

    code = ErrorCode.BAD_REQUEST


class UnknownNameError(HandoverError):
    """A name that is not in the list of known names."""

    code = ErrorCode.UNKNOWN_NAME

    def __init__(self, kind: str, name: str, known: list[str] | tuple[str, ...]) -> None:
        super().__init__(f"unknown {kind} {name!r}; known: {', '.join(sorted(known)) or 'none'}")


class BadRecordingError(HandoverError):
    """A recording is cut short, misses a column or has the wrong units."""

    code = ErrorCode.BAD_RECORDING


class BadModelError(HandoverError):
    """A YAML file, URDF or stored profile cannot be used."""

    code = ErrorCode.BAD_MODEL


class InfeasibleError(HandoverError):
    """A valid request that has no solution; the code says which constraint failed."""

    code = ErrorCode.NOT_REACHABLE


class StaleDataError(HandoverError):
    """Live data stopped or is too old to act on."""

    code = ErrorCode.STALE_DATA
