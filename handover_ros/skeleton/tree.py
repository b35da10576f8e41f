"""The kinematic skeleton: a rooted tree of joints with twists, and markers fixed to what the joints carry.

S = (J, E, alpha, xi, p) of Bestick 2017, section 2.2. All directions, points and marker positions are given in the
*zero frame*: the frame of the root segment while every displacement is zero. A joint carries a segment and moves it
against the segment it hangs on; ``world`` is what the root hangs on.

Two descriptions of a posture:

* ``displacements`` (n,): theta of the dissertation, one number for each degree of freedom inside the person; a ball
  joint has three, about its axes in sequence (eq. 2.12).
* ``coordinates`` (nq,): what is computed with. A revolute or prismatic joint has 1 number, a ball joint the
  quaternion (x, y, z, w) of its rotation, a free root position [m] and quaternion: no singularity.

A small change of coordinates is a *tangent* vector (nv,): 1 number for a revolute or prismatic joint, a rotation vector
in the frame the joint hangs in for a ball joint, (translation, rotation vector) in the world for a free root.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.geometry import FloatArray
from handover_ros.skeleton.angles import euler_angles, euler_rates, rotation_of

IntArray = npt.NDArray[np.int64]

WORLD = "world"
DIRECTION_TOLERANCE = 1e-6


class JointKind(IntEnum):
    """How a joint moves."""

    REVOLUTE = 0
    PRISMATIC = 1
    BALL = 2
    FREE = 3


DISPLACEMENTS = {JointKind.REVOLUTE: 1, JointKind.PRISMATIC: 1, JointKind.BALL: 3, JointKind.FREE: 0}
TANGENTS = {JointKind.REVOLUTE: 1, JointKind.PRISMATIC: 1, JointKind.BALL: 3, JointKind.FREE: 6}
COORDINATES = {JointKind.REVOLUTE: 1, JointKind.PRISMATIC: 1, JointKind.BALL: 4, JointKind.FREE: 7}


@dataclass(frozen=True, eq=False)
class Joint:
    """One joint and the segment it carries.

    Attributes:
        name: Name of the joint.
        kind: How it moves.
        parent: Segment it hangs on, or ``world``.
        segment: Segment it carries.
        displacement_names: One name for each displacement; none for a free root.
        axes: Unit directions of the displacements in the zero frame, shape (number of displacements, 3).
        point: A point on the axis, or the centre of a ball joint, in the zero frame [m], shape (3,).
    """

    name: str
    kind: JointKind
    parent: str
    segment: str
    displacement_names: tuple[str, ...]
    axes: FloatArray
    point: FloatArray

    def __post_init__(self) -> None:
        """Check the shapes and make the arrays read-only.

        Raises:
            BadModelError: A number is not finite, a direction not of unit length, or a ball's axes not orthogonal.
        """
        count = DISPLACEMENTS[self.kind]
        if len(self.displacement_names) != count:
            raise BadModelError(
                f"joint {self.name!r}: {len(self.displacement_names)} displacement names, a {self.kind.name.lower()} "
                f"joint has {count}"
            )
        axes = np.array(self.axes, dtype=float).reshape(-1, 3)
        point = np.array(self.point, dtype=float)
        if axes.shape != (count, 3) or point.shape != (3,):
            raise BadModelError(
                f"joint {self.name!r}: axes {axes.shape} and point {point.shape}, expected ({count}, 3)"
            )
        if not (np.isfinite(axes).all() and np.isfinite(point).all()):
            raise BadModelError(f"joint {self.name!r}: axes and point must be finite")
        if count and np.abs(axes @ axes.T - np.eye(count)).max() > DIRECTION_TOLERANCE:
            raise BadModelError(
                f"joint {self.name!r}: axes must be of unit length and at right angles, got {axes.tolist()}"
            )
        for name, array in (("axes", axes), ("point", point)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def twists(self) -> FloatArray:
        """Twists (linear, angular) of the displacements in the zero frame (n, 6): xi of eq. 2.1, the map 2.12."""
        if self.kind is JointKind.PRISMATIC:
            return np.concatenate([self.axes, np.zeros_like(self.axes)], axis=1)
        return np.concatenate([np.cross(self.point, self.axes), self.axes], axis=1)


class FlatTree(NamedTuple):
    """A skeleton as flat arrays, for compiled code; joint indices follow ``Skeleton.joints``, -1 is the world."""

    kind: IntArray  # (joints,)
    parent: IntArray  # (joints,)
    axis: FloatArray  # (joints, 3) first axis
    point: FloatArray  # (joints, 3) [m]
    coordinate: IntArray  # (joints,) first coordinate
    tangent: IntArray  # (joints,) first tangent
    marker_joint: IntArray  # (markers,)
    marker: FloatArray  # (markers, 3) [m]


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A person's (or an articulated object's) kinematics.

    Attributes:
        name: Name of the template it was made from.
        joints: Joints, each after the one that carries its parent segment.
        marker_names: The m marker names.
        marker_segments: The segment that carries each marker.
        markers: Marker positions in the zero frame [m], shape (m, 3).
        lower: Lower limits of the displacements [rad] or [m], shape (n,); -inf: unknown.
        upper: Upper limits, shape (n,); inf: unknown.
        hands: Side ("left", "right") and segment of each hand that takes objects.
    """

    name: str
    joints: tuple[Joint, ...]
    marker_names: tuple[str, ...]
    marker_segments: tuple[str, ...]
    markers: FloatArray
    lower: FloatArray
    upper: FloatArray
    hands: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        """Check that it is a tree and that all shapes fit.

        Raises:
            BadModelError: A parent is unknown or comes later, a name appears twice, limits cross, or a number is not
                finite.
        """
        known = {WORLD}
        for index, joint in enumerate(self.joints):
            if joint.parent not in known:
                raise BadModelError(f"joint {joint.name!r}: parent {joint.parent!r} is not carried by an earlier joint")
            if joint.segment in known:
                raise BadModelError(f"joint {joint.name!r}: segment {joint.segment!r} is carried by two joints")
            if joint.kind is JointKind.FREE and (index or joint.parent != WORLD):
                raise BadModelError(f"joint {joint.name!r}: only the root can be free")
            known.add(joint.segment)
        joint_names = [joint.name for joint in self.joints]
        if twice := [name for name in joint_names if joint_names.count(name) > 1]:
            raise BadModelError(f"joint {twice[0]!r} appears twice")
        names = self.displacement_names
        if repeated := {name for name in names if names.count(name) > 1}:
            raise BadModelError(f"displacement {sorted(repeated)[0]!r} appears twice")
        for field, shape in (
            ("markers", (len(self.marker_names), 3)),
            ("lower", (len(names),)),
            ("upper", (len(names),)),
        ):
            array = np.array(getattr(self, field), dtype=float).reshape(shape if field == "markers" else -1)
            if array.shape != shape or np.isnan(array).any():
                raise BadModelError(f"skeleton {self.name!r}: {field} must be numbers of shape {shape}")
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        if not np.isfinite(self.markers).all():
            raise BadModelError(f"skeleton {self.name!r}: marker positions must be finite")
        if len(self.marker_segments) != len(self.marker_names):
            raise BadModelError(f"skeleton {self.name!r}: every marker needs a segment")
        if unknown := [segment for segment in self.marker_segments if segment not in known]:
            raise BadModelError(f"skeleton {self.name!r}: marker segment {unknown[0]!r} is carried by no joint")
        if unknown := [segment for _, segment in self.hands if segment not in known]:
            raise BadModelError(f"skeleton {self.name!r}: hand segment {unknown[0]!r} is carried by no joint")
        if (crossed := self.lower > self.upper).any():
            name = names[int(np.argmax(crossed))]
            raise BadModelError(f"skeleton {self.name!r}: the lower limit of {name} is above its upper limit")

    # Names and sizes

    @cached_property
    def displacement_names(self) -> tuple[str, ...]:
        """Names of the n displacements."""
        return tuple(name for joint in self.joints for name in joint.displacement_names)

    @cached_property
    def displacement_joints(self) -> IntArray:
        """Index of the joint of each displacement, shape (n,)."""
        return np.array([i for i, joint in enumerate(self.joints) for _ in joint.displacement_names], dtype=np.int64)

    @cached_property
    def size(self) -> tuple[int, int]:
        """Numbers of coordinates and of tangents (nq, nv)."""
        kinds = [joint.kind for joint in self.joints]
        return sum(COORDINATES[kind] for kind in kinds), sum(TANGENTS[kind] for kind in kinds)

    @property
    def is_free(self) -> bool:
        """Whether the root moves freely in the world."""
        return bool(self.joints) and self.joints[0].kind is JointKind.FREE

    @property
    def root(self) -> str:
        """The root segment."""
        return self.joints[0].segment if self.is_free else WORLD

    def joint(self, name: str) -> Joint:
        """Return a joint by name.

        Raises:
            UnknownNameError: There is none.
        """
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise UnknownNameError("joint", name, [joint.name for joint in self.joints])

    def joint_carrying(self, segment: str) -> int:
        """Return the index of the joint that carries a segment, -1 for the world.

        Raises:
            UnknownNameError: No joint does.
        """
        if segment == WORLD:
            return -1
        for index, joint in enumerate(self.joints):
            if joint.segment == segment:
                return index
        raise UnknownNameError("segment", segment, [WORLD, *(joint.segment for joint in self.joints)])

    def chain(self, segment: str) -> tuple[int, ...]:
        """Return the joints between the root of the tree and a segment, c(j) of eq. 2.3, the first one first."""
        chain: list[int] = []
        index = self.joint_carrying(segment)
        while index >= 0:
            chain.append(index)
            index = int(self.tree.parent[index])
        return tuple(reversed(chain))

    def slice_of(self, joint: int) -> slice:
        """Return where the displacements of a joint stand among all displacements."""
        start = sum(DISPLACEMENTS[each.kind] for each in self.joints[:joint])
        return slice(start, start + DISPLACEMENTS[self.joints[joint].kind])

    def tangent_slice(self, joint: int) -> slice:
        """Return where the tangents of a joint stand among all tangents."""
        start = sum(TANGENTS[each.kind] for each in self.joints[:joint])
        return slice(start, start + TANGENTS[self.joints[joint].kind])

    @cached_property
    def tree(self) -> FlatTree:
        """The skeleton as flat arrays."""
        kinds = [joint.kind for joint in self.joints]
        carried = {WORLD: -1} | {joint.segment: index for index, joint in enumerate(self.joints)}

        def starts(sizes: dict[JointKind, int]) -> IntArray:
            return np.cumsum([0, *(sizes[kind] for kind in kinds)], dtype=np.int64)[:-1]

        first_axes = [joint.axes[0] if len(joint.axes) else np.zeros(3) for joint in self.joints]
        return FlatTree(
            kind=np.array(kinds, dtype=np.int64),
            parent=np.array([carried[joint.parent] for joint in self.joints], dtype=np.int64),
            axis=np.array(first_axes, dtype=float).reshape(-1, 3),
            point=np.array([joint.point for joint in self.joints], dtype=float).reshape(-1, 3),
            coordinate=starts(COORDINATES),
            tangent=starts(TANGENTS),
            marker_joint=np.array([carried[segment] for segment in self.marker_segments], dtype=np.int64),
            marker=np.array(self.markers),
        )

    # Postures

    @property
    def zero(self) -> FloatArray:
        """Coordinates (nq,) with all displacements zero and the root in the world's origin."""
        return self.coordinates(np.zeros(len(self.displacement_names)))

    @property
    def middle(self) -> FloatArray:
        """Displacements (n,) halfway between the limits, theta* of eq. 2.11; 0 where a limit is unknown."""
        known = np.isfinite(self.lower) & np.isfinite(self.upper)
        return np.where(known, 0.5 * (np.where(known, self.lower, 0.0) + np.where(known, self.upper, 0.0)), 0.0)

    def coordinates(self, displacements: npt.ArrayLike, world_from_root: FloatArray | None = None) -> FloatArray:
        """Return coordinates (..., nq) of displacements (..., n) [rad, m] and root poses (..., 4, 4), if not at 0."""
        values = np.asarray(displacements, dtype=float)
        result = np.zeros((*values.shape[:-1], self.size[0]))
        for index, joint in enumerate(self.joints):
            start = int(self.tree.coordinate[index])
            own = values[..., self.slice_of(index)]
            if joint.kind is JointKind.FREE:
                pose = np.eye(4) if world_from_root is None else world_from_root
                result[..., start : start + 3] = pose[..., :3, 3]
                result[..., start + 3 : start + 7] = Rotation.from_matrix(pose[..., :3, :3]).as_quat()
            elif joint.kind is JointKind.BALL:
                quaternions = Rotation.from_matrix(rotation_of(joint.axes, own).reshape(-1, 3, 3)).as_quat()
                result[..., start : start + 4] = quaternions.reshape(*own.shape[:-1], 4)
            else:
                result[..., start] = own[..., 0]
        return result

    def displacements(self, coordinates: npt.ArrayLike, near: npt.ArrayLike | None = None) -> FloatArray:
        """Return displacements (..., n) [rad, m] of coordinates (..., nq).

        Three angles of a ball joint exist twice, and each may be off by full turns; chosen are those nearest to
        ``near`` (n,) (default: the middle of the limits).
        """
        values = np.asarray(coordinates, dtype=float)
        target = self.middle if near is None else np.asarray(near, dtype=float)
        result = np.zeros((*values.shape[:-1], len(self.displacement_names)))
        for index, joint in enumerate(self.joints):
            start, own = int(self.tree.coordinate[index]), self.slice_of(index)
            if joint.kind is JointKind.BALL:
                matrices = Rotation.from_quat(values[..., start : start + 4].reshape(-1, 4)).as_matrix()
                angles = euler_angles(joint.axes, matrices, target[own])
                result[..., own] = angles.reshape(*values.shape[:-1], 3)
            elif joint.kind is not JointKind.FREE:
                result[..., own] = values[..., start : start + 1]
        return result

    def displacement_mapping(self, displacements: FloatArray) -> FloatArray:
        """Return d(displacements)/d(tangents) (..., n, nv) at displacements (..., n)."""
        mapping = np.zeros((*displacements.shape, self.size[1]))
        for index, joint in enumerate(self.joints):
            own, tangent = self.slice_of(index), self.tangent_slice(index)
            if joint.kind is JointKind.BALL:
                mapping[..., own, tangent] = euler_rates(joint.axes, displacements[..., own])
            elif joint.kind is not JointKind.FREE:
                mapping[..., own, tangent] = 1.0
        return mapping

    def world_from_root(self, coordinates: FloatArray) -> FloatArray:
        """Return the root's pose (..., 4, 4) in the world; the identity for a root that is not free."""
        pose = np.zeros((*coordinates.shape[:-1], 4, 4))
        pose[..., :, :] = np.eye(4)
        if self.is_free:
            pose[..., :3, 3] = coordinates[..., :3]
            quaternions = coordinates[..., 3:7].reshape(-1, 4)
            pose[..., :3, :3] = Rotation.from_quat(quaternions).as_matrix().reshape(*coordinates.shape[:-1], 3, 3)
        return pose

    # Changed copies

    def with_limits(self, lower: npt.ArrayLike, upper: npt.ArrayLike) -> Skeleton:
        """Return a copy with other limits (n,)."""
        return replace(self, lower=np.asarray(lower, dtype=float), upper=np.asarray(upper, dtype=float))

    def with_geometry(self, axes: FloatArray, points: FloatArray, markers: FloatArray) -> Skeleton:
        """Return a copy with other first axes (joints, 3), points (joints, 3) and markers (m, 3), as in ``tree``.

        The axes of ball joints and of the root stay.
        """
        joints = tuple(
            replace(joint, axes=joint.axes if len(joint.axes) != 1 else axes[index : index + 1], point=points[index])
            for index, joint in enumerate(self.joints)
        )
        return replace(self, joints=joints, markers=markers)

    def with_markers(self, names: tuple[str, ...]) -> Skeleton:
        """Return a copy with some of the markers only, in this order.

        Raises:
            UnknownNameError: The skeleton has no such marker.
        """
        for name in names:
            if name not in self.marker_names:
                raise UnknownNameError("marker", name, self.marker_names)
        rows = [self.marker_names.index(name) for name in names]
        segments = tuple(self.marker_segments[row] for row in rows)
        return replace(self, marker_names=names, marker_segments=segments, markers=self.markers[rows])
