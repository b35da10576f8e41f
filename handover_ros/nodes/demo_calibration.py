"""The demonstration's first part: the simulated person is calibrated as a real one would be."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from handover_msgs.msg import ActiveProfile
from handover_msgs.srv import FitSkeleton, SetPersonBehaviour, StartRecording, StopRecording
from rich.console import Console

from handover_ros.cell.calibration_tables import print_report
from handover_ros.errors import ErrorCode, HandoverError
from handover_ros.nodes.convert_profile import profile_from_message
from handover_ros.nodes.operator import Operator
from handover_ros.nodes.runtime import LATCHED
from handover_ros.skeleton.profile import Profile
from handover_ros.skeleton.prompts import PROMPTS

FIT_LIMIT = 120.0  # [s] of wall time; a first fit compiles its kernels
ACTIVATION_LIMIT = 60.0  # [s] of wall time until the person is tracked with the new profile
SETTLE = 0.5  # [s] of simulated time after a motion

WaitSimulated = Callable[[Operator, Callable[[], bool], float], bool]


def calibrate_person(
    person: str, operator: Operator, console: Console, wait_simulated: WaitSimulated
) -> tuple[Profile, dict[str, float]]:
    """Lead the simulated person through the calibration motions, fit, activate; return profile and metrics.

    Args:
        person: The simulated person.
        operator: Whose graph it is.
        console: Where prompts and report are printed.
        wait_simulated: Waits for simulated time.

    Raises:
        HandoverError: A service refused, or the fit must not be used.
    """
    messages: list[ActiveProfile] = []
    subscription = operator.node.create_subscription(
        ActiveProfile, "calibration/active_profile", messages.append, LATCHED
    )
    profile_id = re.sub(r"[^A-Za-z0-9_-]+", "_", Path(person).stem)[:64]
    console.print(f"calibrating {person} ...", highlight=False)
    for number, prompt in enumerate(PROMPTS, start=1):
        wanted = StartRecording.Request(profile_id=profile_id, person=person, motion=prompt.name)
        checked(operator.call(StartRecording, "calibration/start_recording", wanted))
        console.print(f"  [dim]{number}/{len(PROMPTS)}[/dim] {prompt.text}", highlight=False, soft_wrap=True)
        motion = SetPersonBehaviour.Request(behaviour="calibrate", motion=prompt.name)
        duration = checked(operator.call(SetPersonBehaviour, "sim/set_person", motion)).duration
        wait_simulated(operator, lambda: False, duration + SETTLE)
    checked(operator.call(StopRecording, "calibration/stop_recording", StopRecording.Request()))
    checked(operator.call(SetPersonBehaviour, "sim/set_person", SetPersonBehaviour.Request(behaviour="take")))
    request = FitSkeleton.Request(profile_id=profile_id, activate=True)
    fitted = checked(operator.call(FitSkeleton, "calibration/fit", request, FIT_LIMIT))

    def active() -> Profile | None:
        found = profile_from_message(messages[-1]) if messages else None
        return found if found is not None and found.profile_id == profile_id else None

    profile = operator.wait(active, ACTIVATION_LIMIT, f"profile {profile_id!r} on calibration/active_profile")
    operator.node.destroy_subscription(subscription)
    assert profile is not None
    print_report(console, profile.skeleton, profile.report)
    operator.wait(
        lambda: (
            operator.skeleton is not None and operator.skeleton.valid and operator.skeleton.profile_id == profile_id
        ),
        ACTIVATION_LIMIT,
        f"{person} to be tracked with the new profile",
    )
    return profile, {
        "calibration_fit_rms_mm": 1e3 * fitted.fit_rms,
        "calibration_heldout_mm": 1e3 * fitted.heldout_mean,
        "calibration_frames": int(fitted.frames),
        "calibration_s": fitted.seconds,
    }


def checked(answer: Any) -> Any:
    """Return a service's answer.

    Raises:
        HandoverError: It was refused.
    """
    if not answer.success:
        raise HandoverError(answer.message, ErrorCode(answer.error_code))
    return answer
