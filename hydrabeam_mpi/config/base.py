"""What the tables of a job file have in common."""

from __future__ import annotations

import json
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

ONLY_WITH = "only_with"


def key(default: Any, meaning: str, only_with: tuple[str, str] | None = None, **limits: Any) -> Any:
    """Return a field with what ``hydrabeam init`` says of it.

    Parameters
    ----------
    default
    meaning : str
    only_with : (str, str), optional
        Another key of the table and the value of it with which alone this one is used.
    **limits
        As of pydantic's `Field`.
    """
    extra: Any = {ONLY_WITH: only_with} if only_with else None
    return Field(default, description=meaning, json_schema_extra=extra, **limits)


class Section(BaseModel):
    """A table of the job file: frozen, strict about types; a key that is unknown or would not be used is an error."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", validate_default=True, allow_inf_nan=False)

    @model_validator(mode="after")
    def _uses_what_it_is_given(self) -> Self:
        # Keys at their defaults are no matter: resolved jobs have all of them.
        for name, field in type(self).model_fields.items():
            extra: Any = field.json_schema_extra
            if extra and getattr(self, name) != field.default:
                switch, position = extra[ONLY_WITH]
                if (own := getattr(self, switch)) != position:
                    refuse_unused(self, name, f"{switch} = '{position}'", f"'{own}'")
        return self


def refuse_unused(section: Section, name: str, needed: str, instead: str) -> None:
    """Say that a key is given in vain.

    Raises
    ------
    ValueError
        Always.
    """
    raise ValueError(f"{name} = {shown(getattr(section, name))} is for {needed}, not {instead}; leave it out")


def shown(value: Any, longest: int = 60) -> str:
    """Write a value as TOML does, shortened."""
    text = json.dumps(value, default=str)
    return text if len(text) <= longest else f"{text[:longest]}..."
