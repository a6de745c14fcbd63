"""What the settings of an effect may be; the registry holds those of jobs to it."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

Count = Annotated[int, Field(ge=1)]
Azimuth = Annotated[float, Field(ge=-360, le=720)]
"""Degrees; from one turn before to one after."""
Elevation = Annotated[float, Field(ge=-90, le=90)]
"""Degrees, as declinations are."""
