"""Reading YAML files into checked values: one clear line naming file and field when something is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from handover_ros.errors import BadModelError

Vector3 = Annotated[
    tuple[
        Annotated[float, Field(allow_inf_nan=False)],
        Annotated[float, Field(allow_inf_nan=False)],
        Annotated[float, Field(allow_inf_nan=False)],
    ],
    Field(description="three finite numbers"),
]


class Schema(BaseModel):
    """Base of the file schemas: unknown keys refused, values frozen, NaN and infinity refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


SchemaType = TypeVar("SchemaType", bound=BaseModel)


def first_problem(error: ValidationError) -> str:
    """Return the first problem of a validation as ``field: what is wrong (got value)``."""
    problem = error.errors()[0]
    field = ".".join(str(part) for part in problem["loc"]) or "the file"
    got = "" if problem["type"] == "missing" else f" (got {str(problem.get('input'))[:60]!r})"
    return f"{field}: {problem['msg']}{got}"


def read_yaml(path: Path, schema: type[SchemaType]) -> SchemaType:
    """Return the content of a YAML file, checked against ``schema``.

    Raises:
        BadModelError: The file is missing, is no YAML mapping, or a field is unknown, missing or out of range.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadModelError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise BadModelError(f"{path}: is not valid YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise BadModelError(f"{path}: must hold a mapping of fields, holds {type(content).__name__}")
    try:
        return schema.model_validate(content)
    except ValidationError as error:
        raise BadModelError(f"{path}: {first_problem(error)}") from None
