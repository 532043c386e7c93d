"""A driver's own keys of the rig file, read into its model."""

from __future__ import annotations

from typing import TypeVar

from pydantic import BaseModel, ValidationError

from common.config.models import CameraConfig
from common.errors import ConfigError

M = TypeVar("M", bound=BaseModel)


def read_options(name: str, config: CameraConfig, model: type[M]) -> M:
    """The keys of camera ``name`` as ``model``; raises ConfigError with one line for each mistake."""
    try:
        return model.model_validate(config.options)
    except ValidationError as error:
        problems = tuple(
            f"{'.'.join(('cameras', name, *map(str, item['loc'])))}: {item['msg']}"
            for item in error.errors(include_url=False)
        )
        raise ConfigError(f"camera {name} can't be used: {'; '.join(problems)}", problems) from error
