"""Declared parameters of a node: type, range, description and default in one table; nothing undeclared is accepted."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from handover_ros.errors import BadRequestError

BUILT_IN = {"use_sim_time", "start_type_description_service"}


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter.

    Attributes:
        name: As in YAML.
        default: Its type is the parameter's type; floats as ``1.0``.
        description: What it is, with unit and frame.
        minimum: Smallest value, for numbers.
        maximum: Largest value, for numbers.
        choices: Allowed values, for strings; empty: any.
        read_only: Wired once at start; a later change is refused.
    """

    name: str
    default: Any
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = True

    def problem(self, value: Any) -> str | None:
        """Return why ``value`` is not acceptable, or None."""
        numbers = value if isinstance(value, (list, tuple)) else [value]
        for number in numbers:
            if isinstance(number, float) and not math.isfinite(number):
                return f"parameter {self.name}: {number} is not finite"
            below = self.minimum is not None and number < self.minimum
            if below or (self.maximum is not None and number > self.maximum):
                return f"parameter {self.name}: {number} is outside [{self.minimum}, {self.maximum}]"
        if self.choices and value not in self.choices:
            return f"parameter {self.name}: {value!r} is none of {', '.join(map(repr, self.choices))}"
        return None

    def descriptor(self) -> ParameterDescriptor:
        """Return the ROS descriptor."""
        descriptor = ParameterDescriptor(name=self.name, description=self.description, read_only=self.read_only)
        if self.choices:
            descriptor.additional_constraints = "one of " + ", ".join(map(repr, self.choices))
        if self.minimum is None or self.maximum is None:
            return descriptor
        if isinstance(self.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(self.minimum), to_value=float(self.maximum), step=0.0)
            ]
        elif isinstance(self.default, int) and not isinstance(self.default, bool):
            descriptor.integer_range = [IntegerRange(from_value=int(self.minimum), to_value=int(self.maximum), step=1)]
        return descriptor


class ParameterTable:
    """The parameters of one node, declared and checked.

    ``table["name"]`` is the present value. Changes at run time are validated first (accept or reject) and applied
    after, by the function given to ``on_change``.

    Raises:
        BadRequestError: An override names no declared parameter, has the wrong type or is out of range.
    """

    def __init__(self, node: Node, specs: tuple[ParameterSpec, ...]) -> None:
        self._node = node
        self._specs = {spec.name: spec for spec in specs}
        self._apply: Callable[[], None] | None = None
        unknown = sorted(set(node._parameter_overrides) - set(self._specs) - BUILT_IN)
        if unknown:
            raise BadRequestError(
                f"{node.get_name()}: unknown parameter {unknown[0]!r}; known: {', '.join(sorted(self._specs))}"
            )
        for spec in specs:
            self._declare(spec)
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._applied)

    def __getitem__(self, name: str) -> Any:
        value = self._node.get_parameter(name).value
        return list(value) if isinstance(self._specs[name].default, list) else value

    def on_change(self, apply: Callable[[], None]) -> None:
        """Call ``apply`` after accepted changes."""
        self._apply = apply

    def _declare(self, spec: ParameterSpec) -> None:
        try:
            value = self._node.declare_parameter(spec.name, spec.default, spec.descriptor()).value
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            override = self._node._parameter_overrides[spec.name].value
            problem = None
            if type(override) is type(spec.default):
                problem = spec.problem(override)
            expected = type(spec.default).__name__
            raise BadRequestError(
                f"{self._node.get_name()}: "
                + (problem or f"parameter {spec.name}: {override!r} is not a {expected} ({error})")
            ) from None
        if problem := spec.problem(value):
            raise BadRequestError(f"{self._node.get_name()}: {problem}")

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            spec = self._specs.get(parameter.name)
            if spec is not None and (problem := spec.problem(parameter.value)):
                return SetParametersResult(successful=False, reason=problem)
        return SetParametersResult(successful=True)

    def _applied(self, parameters: list[Parameter]) -> None:
        if self._apply is not None and any(parameter.name in self._specs for parameter in parameters):
            self._apply()
