"""Stored profiles to messages and back."""

from __future__ import annotations

from handover_msgs.msg import ActiveProfile, ProfileInfo

from handover_ros.cell.store import StoredProfile
from handover_ros.nodes.convert import float_array, stamp_from_seconds
from handover_ros.skeleton.profile import VERSION, Profile, profile_from_json, profile_to_json


def profile_info(profile: Profile, active: bool) -> ProfileInfo:
    """Return the message that describes a profile."""
    report = profile.report
    return ProfileInfo(
        profile_id=profile.profile_id,
        person=profile.person,
        active=active,
        version=VERSION,
        created=stamp_from_seconds(max(profile.created_seconds, 0.0)),
        marker_set=profile.marker_set,
        skeleton_template=profile.template,
        frames=report.frames,
        fit_rms=float(report.fit_rms),
        heldout_mean=float(report.heldout_mean),
        joint_names=list(profile.skeleton.displacement_names),
        lower_limits=float_array(profile.skeleton.lower),
        upper_limits=float_array(profile.skeleton.upper),
        notes=list(profile.notes),
        source=profile.source,
    )


def stored_profile_info(stored: StoredProfile) -> ProfileInfo:
    """Return the message that describes a file of the store, damaged or not."""
    if stored.profile is not None:
        return profile_info(stored.profile, stored.active)
    nan = float("nan")
    return ProfileInfo(profile_id=stored.profile_id, problem=stored.problem, fit_rms=nan, heldout_mean=nan)


def active_profile_message(profile: Profile | None) -> ActiveProfile:
    """Return the latched message of the active profile; the stamp is left to the node."""
    if profile is None:
        return ActiveProfile()
    return ActiveProfile(info=profile_info(profile, True), document=profile_to_json(profile))


def profile_from_message(message: ActiveProfile) -> Profile | None:
    """Return the active profile of a message, None when none is active.

    Raises:
        BadModelError: The document cannot be used; names the field.
    """
    return profile_from_json(message.document, "calibration/active_profile") if message.document else None
