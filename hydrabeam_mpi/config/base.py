"""What the tables of a job file have in common."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


def key(default: Any, meaning: str, **limits: Any) -> Any:
    """Return a field with what ``hydrabeam init`` says of it."""
    return Field(default, description=meaning, **limits)


class Section(BaseModel):
    """A table of the job file: frozen, strict about types, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", validate_default=True, allow_inf_nan=False)
